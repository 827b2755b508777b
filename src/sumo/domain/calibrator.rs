//! Calibrators.

domain! {
    /// Calls for calibrators.
    Calibrator, "calibrator", CALIBRATOR
}
identifiers! { Calibrator, "calibrator" }

/// What a calibrator brings about in a time, see [`Calibrator::set_flow`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flow<'a> {
    /// Begin and end \[s\].
    pub interval: [f64; 2],
    /// Number of vehicles per hour; -1: the calibrator leaves it as it is.
    pub vehs_per_hour: f64,
    /// Speed \[m/s\]; -1: the calibrator leaves it as it is.
    pub speed: f64,
    /// Type of the vehicles that the calibrator adds.
    pub type_id: &'a str,
    /// Their route.
    pub route_id: &'a str,
    /// Their lane: a number, `first`, `free`, `best`…
    pub depart_lane: &'a str,
    /// Their speed \[m/s\], `max`, `random`…
    pub depart_speed: &'a str,
}

getters! { Calibrator, "calibrator";
    /// The edge of the calibrator.
    get_edge_id "getEdgeID" VAR_ROAD_ID 0x50 -> String;
    /// The lane of the calibrator; empty if it is for an edge.
    get_lane_id "getLaneID" VAR_LANE_ID 0x51 -> String;
    /// Number of vehicles per hour that the calibrator brings about in the present interval.
    get_vehs_per_hour "getVehsPerHour" VAR_VEHSPERHOUR 0x13 -> f64;
    /// Speed that the calibrator brings about in the present interval \[m/s\].
    get_speed "getSpeed" VAR_SPEED 0x40 -> f64;
    /// Type of the vehicles that the calibrator adds in the present interval.
    get_type_id "getTypeID" VAR_TYPE 0x4f -> String;
    /// Begin of the present interval \[s\].
    get_begin "getBegin" VAR_BEGIN 0x1c -> f64;
    /// End of the present interval \[s\].
    get_end "getEnd" VAR_END 0x1d -> f64;
    /// Route of the vehicles that the calibrator adds in the present interval.
    get_route_id "getRouteID" VAR_ROUTE_ID 0x53 -> String;
    /// The route probe from which the calibrator takes routes; empty if there is none.
    get_route_probe_id "getRouteProbeID" VAR_ROUTE_PROBE 0x17 -> String;
    /// Types of the vehicles that the calibrator counts; empty if it counts all.
    get_vtypes "getVTypes" VAR_VTYPES 0x1e -> Vec<String>;
    /// Number of vehicles that passed in the present interval.
    get_passed "getPassed" VAR_PASSED 0x14 -> i32;
    /// Number of vehicles that the calibrator added in the present interval.
    get_inserted "getInserted" VAR_INSERTED 0x15 -> i32;
    /// Number of vehicles that the calibrator removed in the present interval.
    get_removed "getRemoved" VAR_REMOVED 0x16 -> i32;
}

setters! { Calibrator, "calibrator";
    /// Sets what the calibrator brings about in an interval, in place of an interval with the same
    /// begin and end.
    set_flow "setFlow" 0x18 {flow: &Flow<'_>} => (
        flow.interval[0], flow.interval[1], flow.vehs_per_hour, flow.speed, flow.type_id,
        flow.route_id, flow.depart_lane, flow.depart_speed
    );
}

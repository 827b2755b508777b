//! Route probes.

domain! {
    /// Calls for route probes.
    RouteProbe, "routeprobe", ROUTE_PROBE
}
identifiers! { RouteProbe, "routeprobe" }

getters! { RouteProbe, "routeprobe";
    /// The edge of the probe.
    get_edge_id "getEdgeID" VAR_ROAD_ID 0x50 -> String;
    /// A route, drawn from those of the vehicles that passed in the last interval.
    sample_last_route_id "sampleLastRouteID" 0x20 -> String;
    /// A route, drawn from those of the vehicles that have passed in the present interval.
    sample_current_route_id "sampleCurrentRouteID" 0x21 -> String;
}

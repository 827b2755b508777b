//! Filters of context subscriptions. A filter restricts the context subscription of a vehicle that
//! was made last, so call it right after the subscription. SUMO's manual lists the combinations of
//! filters that are possible.

use super::{Side, Vehicle};
use crate::sumo::{
    batch::{Batch, Call},
    codec::Writer,
    constants::CMD_ADD_SUBSCRIPTION_FILTER,
    domain::{Scope, done},
};

const LANES: u8 = 0x01;
const NO_OPPOSITE: u8 = 0x02;
const DOWNSTREAM_DISTANCE: u8 = 0x03;
const UPSTREAM_DISTANCE: u8 = 0x04;
const LEAD_FOLLOW: u8 = 0x05;
const TURN: u8 = 0x07;
const VEHICLE_CLASS: u8 = 0x08;
const VEHICLE_TYPE: u8 = 0x09;
const FIELD_OF_VISION: u8 = 0x0a;
const LATERAL_DISTANCE: u8 = 0x0b;

fn push(batch: &mut Batch, name: &'static str, filter: u8, content: impl FnOnce(&mut Writer)) {
    batch.command(Call::new(name, CMD_ADD_SUBSCRIPTION_FILTER), |w| {
        w.u8(filter);
        content(w);
    });
}

fn push_lanes(batch: &mut Batch, name: &'static str, lanes: &[i8]) {
    push(batch, name, LANES, |w| {
        let once = || lanes.iter().enumerate().filter(|(i, lane)| !lanes[..*i].contains(lane));
        // The number of lanes fits into a byte: there are only 256 different `i8` values, and an
        // edge has fewer lanes than that.
        w.u8(once().count() as u8);
        for (_, lane) in once() {
            w.u8(lane.cast_unsigned());
        }
    });
}

impl<S: Scope> Vehicle<'_, S> {
    /// Restricts the subscription to vehicles on given lanes: 0 is the vehicle's own lane, -1 the
    /// next lane to the right, 1 the next lane to the left…
    pub fn add_subscription_filter_lanes(&mut self, lanes: &[i8]) -> S::Output<()> {
        self.0.request(|batch| push_lanes(batch, "vehicle.addSubscriptionFilterLanes", lanes), done)
    }

    /// Excludes vehicles on the lanes of the opposite direction.
    pub fn add_subscription_filter_no_opposite(&mut self) -> S::Output<()> {
        self.filter("vehicle.addSubscriptionFilterNoOpposite", NO_OPPOSITE, |_| {})
    }

    /// Sets how far ahead along the roads SUMO looks for vehicles \[m\].
    pub fn add_subscription_filter_downstream_distance(&mut self, distance: f64) -> S::Output<()> {
        self.distance(
            "vehicle.addSubscriptionFilterDownstreamDistance",
            DOWNSTREAM_DISTANCE,
            distance,
        )
    }

    /// Sets how far behind along the roads SUMO looks for vehicles \[m\].
    pub fn add_subscription_filter_upstream_distance(&mut self, distance: f64) -> S::Output<()> {
        self.distance("vehicle.addSubscriptionFilterUpstreamDistance", UPSTREAM_DISTANCE, distance)
    }

    /// Restricts the subscription to the leader and the follower on the vehicle's own lane, which
    /// matter for car following.
    pub fn add_subscription_filter_cf_maneuver(&mut self) -> S::Output<()> {
        self.lead_follow("vehicle.addSubscriptionFilterCFManeuver", &[0])
    }

    /// Restricts the subscription to leaders and followers on the vehicle's own lane and on the
    /// neighbouring lane on one side, or on both sides (`None`), which matter for a lane change.
    pub fn add_subscription_filter_lc_maneuver(&mut self, side: Option<Side>) -> S::Output<()> {
        let lanes: &[i8] = match side {
            None => &[-1, 0, 1],
            Some(side) => &[0, side.offset()],
        };
        self.lead_follow("vehicle.addSubscriptionFilterLCManeuver", lanes)
    }

    /// Restricts the subscription to leaders and followers on given lanes, numbered as in
    /// [`Vehicle::add_subscription_filter_lanes`].
    pub fn add_subscription_filter_lead_follow(&mut self, lanes: &[i8]) -> S::Output<()> {
        self.lead_follow("vehicle.addSubscriptionFilterLeadFollow", lanes)
    }

    /// Restricts the subscription to vehicles that approach the same junctions on conflicting
    /// links, up to a distance before the junction \[m\].
    pub fn add_subscription_filter_turn(&mut self, foe_distance_to_junction: f64) -> S::Output<()> {
        self.distance("vehicle.addSubscriptionFilterTurn", TURN, foe_distance_to_junction)
    }

    /// Restricts the subscription to vehicles of these classes.
    pub fn add_subscription_filter_vclass(&mut self, classes: &[impl AsRef<str>]) -> S::Output<()> {
        self.filter("vehicle.addSubscriptionFilterVClass", VEHICLE_CLASS, |w| {
            w.string_list(classes);
        })
    }

    /// Restricts the subscription to vehicles of these types.
    pub fn add_subscription_filter_vtype(&mut self, types: &[impl AsRef<str>]) -> S::Output<()> {
        self.filter("vehicle.addSubscriptionFilterVType", VEHICLE_TYPE, |w| {
            w.string_list(types);
        })
    }

    /// Restricts the subscription to vehicles within an angle that opens ahead \[deg\].
    pub fn add_subscription_filter_field_of_vision(&mut self, opening_angle: f64) -> S::Output<()> {
        self.distance("vehicle.addSubscriptionFilterFieldOfVision", FIELD_OF_VISION, opening_angle)
    }

    /// Restricts the subscription to vehicles up to a lateral distance from the vehicle's route
    /// \[m\].
    pub fn add_subscription_filter_lateral_distance(&mut self, distance: f64) -> S::Output<()> {
        self.distance("vehicle.addSubscriptionFilterLateralDistance", LATERAL_DISTANCE, distance)
    }

    fn filter(
        &mut self,
        name: &'static str,
        filter: u8,
        content: impl FnOnce(&mut Writer),
    ) -> S::Output<()> {
        self.0.request(|batch| push(batch, name, filter, content), done)
    }

    fn distance(&mut self, name: &'static str, filter: u8, distance: f64) -> S::Output<()> {
        self.filter(name, filter, |w| {
            w.double(distance);
        })
    }

    fn lead_follow(&mut self, name: &'static str, lanes: &[i8]) -> S::Output<()> {
        let fill = |batch: &mut Batch| {
            push(batch, name, LEAD_FOLLOW, |_| {});
            push_lanes(batch, name, lanes);
        };
        self.0.request(fill, done)
    }
}

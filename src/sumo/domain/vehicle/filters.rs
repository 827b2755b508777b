//! Filters of context subscriptions. A filter restricts the context subscription of a vehicle that
//! was made last, so call it right after the subscription. SUMO's manual lists the combinations of
//! filters that are possible.

use super::{Side, Vehicle};
use crate::sumo::{
    batch::{Batch, Call},
    codec::Writer,
    constants::CMD_ADD_SUBSCRIPTION_FILTER,
    domain::{Scope, done},
    value::{Argument, Nothing},
};

const LANES: u8 = 0x01;
const LEAD_FOLLOW: u8 = 0x05;

fn push(batch: &mut Batch, name: &'static str, filter: u8, argument: impl Argument) {
    batch.command(Call::new(name, CMD_ADD_SUBSCRIPTION_FILTER), |w| {
        w.u8(filter);
        argument.write(w);
    });
}

/// Lanes relative to the vehicle's own.
struct Lanes<'a>(&'a [i8]);

impl Argument for Lanes<'_> {
    fn write(self, w: &mut Writer) {
        let Lanes(lanes) = self;
        let once = || lanes.iter().enumerate().filter(|(i, lane)| !lanes[..*i].contains(lane));
        // The number of lanes fits into a byte: there are only 256 different `i8` values, and an
        // edge has fewer lanes than that.
        w.u8(once().count() as u8);
        for (_, lane) in once() {
            w.u8(lane.cast_unsigned());
        }
    }
}

/// Defines filters; the columns are as in [`setters`].
macro_rules! filters {
    ($(
        $(#[$doc:meta])* $method:ident $sumo:literal $filter:literal
        $(($argument:ident: $kind:ty))? $({$given:ident: $given_kind:ty} => $value:expr)?;
    )+) => {
        impl<S: Scope> Vehicle<'_, S> {
            $(
                $(#[$doc])*
                pub fn $method(
                    &mut self,
                    $($argument: $kind)? $($given: $given_kind)?
                ) -> S::Output<()> {
                    let name = concat!("vehicle.", $sumo);
                    let argument = arguments!($(($argument))? $({$value})?);
                    self.0.request(|batch| push(batch, name, $filter, argument), done)
                }
            )+
        }
    };
}

filters! {
    /// Restricts the subscription to vehicles on given lanes: 0 is the vehicle's own lane, -1 the
    /// next lane to the right, 1 the next lane to the left…
    add_subscription_filter_lanes "addSubscriptionFilterLanes" 0x01 {lanes: &[i8]} => Lanes(lanes);
    /// Excludes vehicles on the lanes of the opposite direction.
    add_subscription_filter_no_opposite "addSubscriptionFilterNoOpposite" 0x02;
    /// Sets how far ahead along the roads SUMO looks for vehicles \[m\].
    add_subscription_filter_downstream_distance "addSubscriptionFilterDownstreamDistance" 0x03
        (distance: f64);
    /// Sets how far behind along the roads SUMO looks for vehicles \[m\].
    add_subscription_filter_upstream_distance "addSubscriptionFilterUpstreamDistance" 0x04
        (distance: f64);
    /// Restricts the subscription to vehicles that approach the same junctions on conflicting
    /// links, up to a distance before the junction \[m\].
    add_subscription_filter_turn "addSubscriptionFilterTurn" 0x07 (foe_distance_to_junction: f64);
    /// Restricts the subscription to vehicles of these classes.
    add_subscription_filter_vclass "addSubscriptionFilterVClass" 0x08 (classes: &[impl AsRef<str>]);
    /// Restricts the subscription to vehicles of these types.
    add_subscription_filter_vtype "addSubscriptionFilterVType" 0x09 (types: &[impl AsRef<str>]);
    /// Restricts the subscription to vehicles within an angle that opens ahead \[deg\].
    add_subscription_filter_field_of_vision "addSubscriptionFilterFieldOfVision" 0x0a
        (opening_angle: f64);
    /// Restricts the subscription to vehicles up to a lateral distance from the vehicle's route
    /// \[m\].
    add_subscription_filter_lateral_distance "addSubscriptionFilterLateralDistance" 0x0b
        (distance: f64);
}

impl<S: Scope> Vehicle<'_, S> {
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

    fn lead_follow(&mut self, name: &'static str, lanes: &[i8]) -> S::Output<()> {
        let fill = |batch: &mut Batch| {
            push(batch, name, LEAD_FOLLOW, Nothing);
            push(batch, name, LANES, Lanes(lanes));
        };
        self.0.request(fill, done)
    }
}

//! What an agent observes.

use super::attribute::{element, words};

/// How an agent observes other vehicles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObservationGroups {
    /// The nearest vehicles, in any direction (paper).
    Nearest,
    /// The vehicle ahead, and on each route that crosses or merges with the agent's own route, the
    /// vehicles nearest to the conflict point.
    Conflict,
    /// Both: first the nearest vehicles, then the conflict group.
    Both,
}

impl ObservationGroups {
    /// Returns whether the observation contains the nearest vehicles.
    pub fn nearest(self) -> bool {
        self != Self::Conflict
    }

    /// Returns whether the observation contains the vehicle ahead and the conflicting streams.
    pub fn conflict(self) -> bool {
        self != Self::Nearest
    }
}

words!(ObservationGroups { Nearest: "nearest", Conflict: "conflict", Both: "both" });

/// Order of the nearest vehicles in the observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NeighbourOrder {
    /// Nearest first (paper).
    #[default]
    Distance,
    /// From the vehicles straight ahead to those behind, so that a vehicle keeps its index as
    /// distances change; of vehicles in the same direction, the nearest first. Positions appear on
    /// a second, finer scale as well, on which the gaps of a queue differ.
    Bearing,
}

words!(NeighbourOrder { Distance: "distance", Bearing: "bearing" });

/// What an agent knows of another vehicle's intention: the part of that vehicle's route that the
/// vehicle has not yet begun.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Intention {
    /// The whole route.
    #[default]
    Seen,
    /// The direction at the next junction, which the agent observes from the vehicle's indicator:
    /// within [`Observation::signal_distance`] of the junction, within the detection range and with
    /// no other vehicle in between. Otherwise nothing.
    Signalled,
    /// Nothing: the vehicle may take any route that its position leaves open (paper).
    Hidden,
}

words!(Intention { Seen: "seen", Signalled: "signalled", Hidden: "hidden" });

element! {
    /// What an agent observes.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Observation {
        /// How the observation describes other vehicles.
        pub groups: ObservationGroups,
        /// Distance beyond which an agent does not observe other vehicles \[m\].
        pub detection_range: f64,
        /// Distance that far features show as 1 \[m\]; those of near gaps show three tenths of it
        /// as 1, those of the agent's own route twice as much.
        pub distance_scale: f64,
        /// Whether an agent observes its compass heading.
        pub heading: bool,
        /// Whether an agent observes the time since the start of the episode.
        pub clock: bool,
        /// Whether an agent observes whether its own route turns left or right at the next junction.
        pub own_turn: bool,
        /// Number of nearest vehicles, which are described one by one.
        pub neighbours: usize,
        /// Order of the nearest vehicles.
        pub neighbour_order: NeighbourOrder,
        /// What an agent knows of the intentions of other vehicles.
        pub intention: Intention,
        /// Distance before a junction at which a vehicle switches its indicator on \[m\]. Without
        /// [`Intention::Signalled`] it has no effect and is [`Observation::SIGNAL_DISTANCE`].
        pub signal_distance: f64,
        /// Number of crossing or merging streams, in the order of their conflict points along the
        /// agent's route.
        pub conflict_streams: usize,
        /// Number of vehicles described per stream, those nearest to the conflict point first.
        pub stream_vehicles: usize,
        /// Number of encounters: vehicles that are ahead of the agent or whose routes cross or
        /// merge with the agent's route, described one by one, in ascending order of the longer of
        /// the two vehicles' distances to the conflict point.
        pub encounters: usize,
        /// Time over which encounters predict how closely the two vehicles pass each other if both
        /// keep to their paths and speeds \[s\]. 0: no prediction.
        pub foresight: f64,
        /// Distance before the first conflict point of its path at which a vehicle gets its
        /// priority, first come, first served \[m\]. Encounters then contain which of the two
        /// vehicles has priority. 0: they do not.
        pub priority_distance: f64,
        /// Distance up to which an agent observes how close its sides are to the lines that it must
        /// not touch \[m\]. 0: not observed.
        pub borders: f64,
        /// Whether agents observe the next signal on their routes. It has no effect where no signal
        /// rules a route.
        pub signals: bool,
        /// Lidar, which measures distances to vehicles and road borders.
        pub lidar: Lidar,
    }
}

impl Observation {
    /// Default of [`Observation::signal_distance`] \[m\].
    pub const SIGNAL_DISTANCE: f64 = 30.0;
}

element! {
    /// Lidar beams in all directions, which end at vehicles and where the road ends.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Lidar {
        /// Number of beams; 0: no lidar.
        pub beams: usize,
        /// Range of the beams \[m\].
        pub range: f64,
    }
}

impl Lidar {
    /// Largest number of beams.
    pub const MOST: usize = 360;
}

impl Default for Lidar {
    fn default() -> Self {
        Self { beams: 0, range: 50.0 }
    }
}

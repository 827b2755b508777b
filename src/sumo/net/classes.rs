//! SUMO's vehicle classes, and which of them may use a lane.

/// SUMO's vehicle class of the agents.
pub(super) const CARS: &str = "passenger";

/// SUMO's vehicle class of pedestrians.
pub(super) const PEDESTRIANS: &str = "pedestrian";

/// SUMO's class of vehicles to which no permission applies.
const IGNORING: &str = "ignoring";

/// SUMO's vehicle classes, up to those of release 1.24.
const NAMES: [&str; 36] = [
    "private",
    "emergency",
    "authority",
    "army",
    "vip",
    PEDESTRIANS,
    CARS,
    "hov",
    "taxi",
    "bus",
    "coach",
    "delivery",
    "truck",
    "trailer",
    "motorcycle",
    "moped",
    "bicycle",
    "evehicle",
    "tram",
    "rail_urban",
    "rail",
    "rail_electric",
    "rail_fast",
    "ship",
    "container",
    "cable_car",
    "subway",
    "aircraft",
    "wheelchair",
    "scooter",
    "drone",
    "custom1",
    "custom2",
    "bike",
    "public_transport",
    IGNORING,
];

/// A set of vehicle classes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Classes(u64);

impl Classes {
    /// Returns the classes that the attributes `allow` and `disallow` of a lane leave.
    pub(super) fn of(allow: Option<&str>, disallow: Option<&str>) -> Self {
        let named = |list: &str| {
            list.split_whitespace().fold(0, |set, name| match name {
                "all" => u64::MAX,
                name => set | NAMES.iter().position(|known| *known == name).map_or(0, |i| 1 << i),
            })
        };
        Self(allow.map_or(u64::MAX, named) & !disallow.map_or(0, named))
    }

    /// Returns whether the set contains a class.
    pub fn contain(self, class: &str) -> bool {
        class == IGNORING
            || NAMES.iter().position(|known| *known == class).is_some_and(|i| self.0 >> i & 1 == 1)
    }
}

//! SUMO's vehicle classes, and which of them may use a lane or a connection.

/// SUMO's vehicle class of the agents.
pub const CARS: &str = "passenger";

/// SUMO's vehicle class of pedestrians.
pub const PEDESTRIANS: &str = "pedestrian";

/// SUMO's class of vehicles to which no permission applies.
const IGNORING: &str = "ignoring";

/// SUMO's vehicle classes, up to those of release 1.24.
const NAMES: [&str; 33] = [
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
];

/// Names of classes in nets of older versions of SUMO, and their names today.
const OLD_NAMES: [(&str, &str); 9] = [
    ("public_emergency", "emergency"),
    ("public_authority", "authority"),
    ("public_army", "army"),
    ("public_transport", "bus"),
    ("transport", "truck"),
    ("bike", "bicycle"),
    ("lightrail", "tram"),
    ("cityrail", "rail_urban"),
    ("rail_slow", "rail"),
];

/// A set of vehicle classes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Classes(u64);

impl Classes {
    /// Returns the classes that the attributes `allow` and `disallow` of a lane or connection
    /// leave. As in SUMO, `disallow` counts only without `allow`.
    ///
    /// # Errors
    /// The name of the attribute with a class that SUMO does not have.
    pub(super) fn of(allow: Option<&str>, disallow: Option<&str>) -> Result<Self, &'static str> {
        let read = |list: &str| {
            let bits = list.split_whitespace().map(|name| match name {
                "all" => Some(u64::MAX),
                IGNORING => Some(0),
                name => bit(name),
            });
            bits.reduce(|a, b| Some(a? | b?)).unwrap_or(Some(0))
        };
        let given = |list: Option<&'_ str>| list.is_some_and(|list| !list.trim().is_empty());
        match (allow, disallow) {
            (Some(list), _) if given(allow) => read(list).map(Self).ok_or("allow"),
            (_, Some(list)) if given(disallow) => {
                read(list).map(|bits| Self(!bits)).ok_or("disallow")
            }
            _ => Ok(Self(u64::MAX)),
        }
    }

    /// Returns whether the set contains a class.
    pub fn contain(self, class: &str) -> bool {
        class == IGNORING || bit(class).is_some_and(|bit| self.0 & bit != 0)
    }

    /// Returns the classes that are in both sets.
    #[must_use]
    pub(super) fn and(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

/// Returns SUMO's name of a vehicle class, which may be that of an older release; `None` if SUMO has
/// no such class.
pub fn class_of_sumo(class: &str) -> Option<&'static str> {
    bit(class).map(|bit| NAMES[bit.trailing_zeros() as usize])
}

fn bit(class: &str) -> Option<u64> {
    let old = OLD_NAMES.iter().find(|(old, _)| *old == class);
    let name = old.map_or(class, |(_, name)| name);
    NAMES.iter().position(|known| *known == name).map(|bit| 1 << bit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn allow_counts_before_disallow() {
        let may = |allow, disallow, class: &str| {
            Classes::of(allow, disallow).expect("known classes").contain(class)
        };
        assert!(may(None, None, "bus") && may(Some("bus"), Some("bus"), "bus"));
        assert!(may(None, Some("bus tram"), CARS) && !may(None, Some("bus tram"), "tram"));
        assert!(!may(Some(" "), Some("all"), CARS) && may(Some(""), Some("all"), IGNORING));
        assert!(may(Some("public_transport"), None, "bus"), "the name of older nets");
        assert_eq!(Classes::of(Some("bus buss"), None), Err("allow"));
        assert_eq!(Classes::of(None, Some("buss")), Err("disallow"));
    }
}

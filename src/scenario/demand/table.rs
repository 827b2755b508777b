//! Which elements and attributes of SUMO's route files are taken, have no effect, or leave out the
//! vehicle or person that has them.
//! The reader decides by this table, and the documentation is made from it.

use std::fmt::Write as _;

use roxmltree::Node;

use super::super::Error;
use super::super::reader::Reader;
use super::Demand;
use crate::sumo::net::{nearest, shorten};

/// Returns the value of a truth value in SUMO's notation.
pub(super) fn flag(text: &str) -> Option<bool> {
    match text {
        "true" | "1" | "yes" | "on" | "t" | "True" => Some(true),
        "false" | "0" | "no" | "off" | "f" | "False" => Some(false),
        _ => None,
    }
}

/// An element of route files. Names in a text are separated by spaces.
pub(super) struct Known {
    pub(super) name: &'static str,
    /// Attributes that are taken.
    pub(super) taken: &'static str,
    /// Attributes that have no effect here, which a warning counts.
    pub(super) idle: &'static str,
    /// Attributes with which the vehicle or person is left out, and what to do instead.
    pub(super) left_out: &'static [(&'static str, &'static str)],
    /// Elements within it that are taken.
    pub(super) children: &'static str,
    /// Elements within it that have no effect here, which a warning counts.
    pub(super) idle_children: &'static str,
    /// Elements within it with which the vehicle or person is left out, or which the root element
    /// must not have, and what to do instead.
    pub(super) left_out_children: &'static [(&'static str, &'static str)],
}

const ZONES: &str = "zones are not taken: make trips or routes of the zones with SUMO's duarouter \
    (or od2trips), and name that file";
const COORDINATES: &str =
    "places by coordinates are not taken: make routes of them with SUMO's duarouter";
const BY_JUNCTIONS: &str = "name edges to pass in `via`, or make routes with SUMO's duarouter";
const WAITING: &str =
    "stops that wait for persons, containers or vehicles are not taken: give a `duration`";
pub(super) const ONE_WALK: &str =
    "a person has one <walk> here: delete the element, or split the person";

const NOTHING: Known = Known {
    name: "",
    taken: "",
    idle: "",
    left_out: &[],
    children: "",
    idle_children: "",
    left_out_children: &[],
};

/// All elements of route files but those within the types of vehicles.
pub(super) const ELEMENTS: [&Known; 15] = [
    &ROOT,
    &TYPE,
    &CAR_FOLLOWING,
    &TYPES,
    &ROUTE,
    &ROUTES,
    &VEHICLE,
    &TRIP,
    &FLOW,
    &INTERVAL,
    &STOP,
    &STOPPING_PLACE,
    &PERSON,
    &PERSON_FLOW,
    &WALK,
];

pub(super) const ROOT: Known = Known {
    name: "routes",
    children: "vType vTypeDistribution route routeDistribution vehicle trip flow interval person \
        personFlow busStop trainStop containerStop chargingStation parkingArea",
    // What else SUMO's route files and additional files contain.
    idle_children: "container containerFlow overheadWire overheadWireSegment overheadWireClamp \
        tractionSubstation e1Detector inductionLoop e2Detector laneAreaDetector e3Detector \
        entryExitDetector instantInductionLoop edgeData laneData routeProbe vTypeProbe timedEvent \
        poi poly polygon location type taz tazs param calibrator rerouter vaporizer \
        variableSpeedSign tlLogic WAUT wautJunction railSignalConstraints",
    left_out_children: &[("include", "name the file in `files` of <traffic> instead")],
    ..NOTHING
};

/// Types of vehicles and persons, of which SUMO reads the whole element. SUMO ignores attributes
/// that it does not know in silence; here a warning counts them.
pub(super) const TYPE: Known = Known {
    name: "vType",
    taken: "Mbegin Mflatness accel actionStepLength adaptFactor adaptTime apProb apparentDecel \
        applyDriverState boardingDuration c1 carFollowModel cc1 cc2 cc3 cc4 cc5 cc6 cc7 cc8 cc9 \
        ccAccel ccDecel ccoolness collisionAvoidanceGainGap collisionAvoidanceGainGapDot \
        collisionAvoidanceGainSpace collisionAvoidanceGainSpeed collisionAvoidanceOverride \
        collisionMinGapFactor color constSpacing containerCapacity decel delta desiredMaxSpeed \
        emergencyDecel emissionClass epsilonacc estimation flatbedD flatbedH flatbedKa flatbedKp \
        flatbedKv gapClosingControlGainGap gapClosingControlGainGapDot gapClosingControlGainSpace \
        gapClosingControlGainSpeed gapControlGainGap gapControlGainGapDot gapControlGainSpace \
        gapControlGainSpeed guiShape hasDriverState height id imgFile impatience jerkmax \
        jmCrossingGap jmDriveAfterRedTime jmDriveAfterYellowTime jmDriveRedSpeed jmIgnoreFoeProb \
        jmIgnoreFoeSpeed jmIgnoreJunctionFoeProb jmIgnoreKeepClearTime jmSigmaMinor jmStoplineGap \
        jmTimegapMinor k kp lambda laneChangeModel lanesCount latAlignment lcAccelLat lcAssertive \
        lcCooperative lcCooperativeRoundabout lcCooperativeSpeed lcImpatience lcKeepRight \
        lcKeepRightAcceptanceTime lcLaneDiscipline lcLookaheadLeft lcMaxDistLatStanding \
        lcMaxSpeedLatFactor lcMaxSpeedLatStanding lcOpposite lcOvertakeDeltaSpeedFactor \
        lcOvertakeRight lcPushy lcPushyGap lcSigma lcSpeedGain lcSpeedGainLookahead lcSpeedGainRight \
        lcStrategic lcSublane lcTimeToImpatience lcTurnAlignmentDistance length loadingDuration \
        maneuverAngleTimes maxSpeed maxSpeedLat maxvehpreview minGap minGapLat omegaN osgFile \
        personCapacity phi ploegH ploegKd ploegKp probability scale security sigma sigmaStep \
        sigmaerror sigmagap sigmaleader speedControlGain speedControlGainCACC speedControlMinGap \
        speedDev speedFactor startupDelay stepping tPersDrive tPersEstimate taccmax tau \
        tauCACCToACC tauEngine tauLast timeToTeleport timeToTeleportBidi tpreview trainType \
        treaction vClass vehdynamics width xi",
    children: "param carFollowing-IDM carFollowing-IDMM carFollowing-EIDM carFollowing-Krauss \
        carFollowing-KraussPS carFollowing-KraussOrig1 carFollowing-SmartSK carFollowing-Daniel1 \
        carFollowing-PWagner2009 carFollowing-BKerner carFollowing-Wiedemann carFollowing-W99 \
        carFollowing-ACC carFollowing-CACC carFollowing-CC",
    ..NOTHING
};

/// Parameters of a car-following model within a type: attributes of types.
pub(super) const CAR_FOLLOWING: Known = Known { name: "carFollowing-*", ..TYPE };

pub(super) const TYPES: Known = Known {
    name: "vTypeDistribution",
    taken: "id vTypes probabilities",
    idle: "deterministic",
    children: "vType",
    ..NOTHING
};

pub(super) const ROUTE: Known = Known {
    name: "route",
    taken: "id edges repeat probability refId",
    idle: "color exitTimes cost savings cycleTime routeLength reason replacedOnEdge replacedOnIndex \
        replacedAtTime",
    children: "stop",
    idle_children: "param",
    ..NOTHING
};

pub(super) const ROUTES: Known = Known {
    name: "routeDistribution",
    taken: "id routes probabilities",
    idle: "last",
    children: "route",
    ..NOTHING
};

/// Attributes of vehicles, trips and flows.
macro_rules! vehicle {
    ($more:literal) => {
        concat!(
            "id type route from to via fromJunction toJunction departLane departPos departSpeed \
             departEdge arrivalLane arrivalPos arrivalSpeed arrivalEdge line personNumber \
             speedFactor",
            $more
        )
    };
}
const VEHICLE_IDLE: &str = "color arrival departPosLat arrivalPosLat containerNumber insertionChecks reroute cost routeLength \
    parkingBadges";
const VEHICLE_LEFT_OUT: [(&str, &str); 3] = [
    ("fromTaz toTaz", ZONES),
    ("fromLonLat toLonLat viaLonLat fromXY toXY viaXY", COORDINATES),
    ("viaJunctions", BY_JUNCTIONS),
];

pub(super) const VEHICLE: Known = Known {
    name: "vehicle",
    taken: vehicle!(" depart"),
    idle: VEHICLE_IDLE,
    left_out: &VEHICLE_LEFT_OUT,
    children: "route routeDistribution stop",
    idle_children: "param",
    ..NOTHING
};

pub(super) const TRIP: Known = Known { name: "trip", ..VEHICLE };

pub(super) const FLOW: Known = Known {
    name: "flow",
    taken: vehicle!(" begin end number period vehsPerHour perHour probability"),
    ..VEHICLE
};

pub(super) const INTERVAL: Known =
    Known { name: "interval", taken: "begin end", children: "flow", ..NOTHING };

/// SUMO's places where vehicles stop.
pub(super) const STOPPING_PLACES: [&str; 5] =
    ["busStop", "trainStop", "containerStop", "chargingStation", "parkingArea"];

pub(super) const STOP: Known = Known {
    name: "stop",
    taken: "lane edge startPos endPos friendlyPos duration until parking busStop trainStop \
        containerStop chargingStation parkingArea",
    idle: "posLat index arrival extension expected permitted expectedContainers actType tripId line \
        priorEdges priorEdgesLength started ended onDemand actualArrival depart collision priority",
    left_out: &[
        ("triggered containerTriggered split join", WAITING),
        ("speed", "waypoints are not taken: delete the stop"),
        ("jump jumpUntil", "vehicles do not jump: split the route into two vehicles"),
        ("lon lat x y", "give `lane` and `endPos`"),
    ],
    idle_children: "param",
    ..NOTHING
};

/// A place where vehicles stop.
pub(super) const STOPPING_PLACE: Known = Known {
    name: "busStop",
    taken: "id lane startPos endPos friendlyPos onRoad",
    idle: "name lines color personCapacity containerCapacity parkingLength roadsideCapacity width \
        length angle departPos power efficiency chargeInTransit chargeDelay",
    idle_children: "param access space",
    ..NOTHING
};

pub(super) const PERSON: Known = Known {
    name: "person",
    taken: "id type depart departPos",
    idle: "color arrival arrivalPos modes vTypes speedFactor",
    children: "walk",
    idle_children: "param",
    left_out_children: &[("personTrip ride stop", ONE_WALK)],
    ..NOTHING
};

pub(super) const PERSON_FLOW: Known = Known {
    name: "personFlow",
    taken: "id type departPos begin end number period personsPerHour vehsPerHour perHour \
        probability",
    ..PERSON
};

pub(super) const WALK: Known = Known {
    name: "walk",
    taken: "edges from to arrivalPos",
    idle: "speed duration departPos departPosLat departLane cost routeLength exitTimes started ended \
        waitingTime",
    left_out: &[
        ("fromTaz toTaz", ZONES),
        ("fromLonLat toLonLat fromXY toXY", COORDINATES),
        (
            "busStop trainStop containerStop chargingStation parkingArea",
            "give `edges` and `arrivalPos`",
        ),
        ("fromJunction toJunction viaJunctions route", "give `edges`, or `from` and `to`"),
    ],
    idle_children: "param",
    ..NOTHING
};

/// Returns whether elements of this name in a route file or additional file are taken.
pub(in crate::scenario) fn is_taken(name: &str) -> bool {
    ROOT.children.split_whitespace().any(|known| known == name)
}

/// Returns the reason that a list has for a name.
fn reason(list: &[(&str, &'static str)], name: &str) -> Option<&'static str> {
    let named = |(names, _): &&(&str, _)| names.split_whitespace().any(|known| known == name);
    list.iter().find(named).map(|(_, why)| *why)
}

/// Returns why the vehicle or person with an element is left out; `None` if the table has no
/// reason.
pub(super) fn left_out(node: Node, known: &Known) -> Option<String> {
    let element = node.tag_name().name();
    let attribute = node.attributes().find_map(|attribute| {
        let name = attribute.name();
        let why = reason(known.left_out, name).filter(|_| !is_void(node, name))?;
        Some(format!("{name} of <{element}> is not taken: {why}"))
    });
    let child = || {
        node.children().filter(Node::is_element).find_map(|child| {
            let name = child.tag_name().name();
            let why = reason(known.left_out_children, name)?;
            Some(format!("<{name}> in <{element}> is not taken: {why}"))
        })
    };
    attribute.or_else(child)
}

/// Whether such an attribute says nothing here: a zone beside the edge, route or walk that SUMO
/// takes in its place (duarouter writes both), and a `false`.
fn is_void(node: Node, name: &str) -> bool {
    let routed = || {
        let route = ["route", "edges"].iter().any(|key| node.has_attribute(*key));
        let child = |child: Node| ["route", "routeDistribution"].contains(&child.tag_name().name());
        route || node.children().any(child)
    };
    match name {
        "fromTaz" => node.has_attribute("from") || routed(),
        "toTaz" => node.has_attribute("to") || routed(),
        "triggered" | "containerTriggered" => {
            node.attribute(name).is_some_and(|value| flag(value) == Some(false))
        }
        _ => false,
    }
}

impl Demand {
    /// Checks that an element has only the child elements that the table has for it and no misspelt
    /// attributes, and counts the attributes without effect, unknown ones included.
    pub(super) fn expect(
        &mut self,
        reader: &Reader,
        node: Node,
        known: &'static Known,
    ) -> Result<(), Error> {
        for attribute in node.attributes().filter(|a| a.namespace().is_none()) {
            let name = attribute.name();
            let zone = ["fromTaz", "toTaz"].contains(&name) && is_void(node, name);
            if zone || known.idle.split_whitespace().any(|idle| idle == name) {
                self.count(reader, node, name);
            }
        }
        let left_out = known.left_out.iter().map(|entry| entry.0);
        let all: Vec<&'static str> =
            [known.taken, known.idle].into_iter().chain(left_out).collect();
        let valid: Vec<_> = all.iter().flat_map(|list| list.split_whitespace()).collect();
        // Something else than it says would happen with a misspelt attribute.
        let is_misspelt = |a: &roxmltree::Attribute| {
            a.namespace().is_none()
                && !valid.contains(&a.name())
                && nearest(a.name(), valid.iter().copied()).is_some()
        };
        if node.attributes().any(|attribute| is_misspelt(&attribute)) {
            return reader.expect_attributes(node, &valid);
        }
        self.count_unknown(reader, node, &all);
        self.expect_children(reader, node, known)
    }

    /// As [`Demand::expect`], for the child elements only.
    pub(super) fn expect_children(
        &mut self,
        reader: &Reader,
        node: Node,
        known: &'static Known,
    ) -> Result<(), Error> {
        for child in node.children().filter(Node::is_element) {
            let (element, name) = (node.tag_name().name(), child.tag_name().name());
            if known.idle_children.split_whitespace().any(|idle| idle == name) {
                let entry = self.unused.entry((element.into(), format!("<{}>", shorten(name))));
                entry.or_insert_with(|| (0, reader.at(child.range().start))).0 += 1;
            }
        }
        let all = [known.children, known.idle_children];
        let left_out = known.left_out_children.iter().flat_map(|entry| entry.0.split_whitespace());
        let valid: Vec<_> =
            all.into_iter().flat_map(str::split_whitespace).chain(left_out).collect();
        reader.expect_children(node, &valid, false)
    }

    /// Counts the attributes that none of these lists has, which SUMO does not know either.
    pub(super) fn count_unknown(&mut self, reader: &Reader, node: Node, lists: &[&str]) {
        for attribute in node.attributes().filter(|a| a.namespace().is_none()) {
            let name = attribute.name();
            if !lists.iter().any(|list| list.split_whitespace().any(|known| known == name)) {
                self.count(reader, node, name);
            }
        }
    }

    /// Counts an attribute without effect.
    pub(super) fn count(&mut self, reader: &Reader, node: Node, key: &str) {
        let entry = self.unused.entry((node.tag_name().name().into(), shorten(key)));
        entry.or_insert_with(|| (0, reader.place(node, key))).0 += 1;
    }
}

/// Returns the table as Markdown.
pub fn route_files() -> String {
    let mut out = String::from(
        "| element | taken | without effect, with a warning | leaves the vehicle or person out; `<include>` is refused |\n|---|---|---|---|\n",
    );
    let list = |texts: &[&str], tag: bool| {
        let mut names: Vec<&str> = texts.iter().flat_map(|text| text.split_whitespace()).collect();
        names.sort_unstable();
        let quote = |name: &&str| if tag { format!("`<{name}>`") } else { format!("`{name}`") };
        names.iter().map(quote).collect::<Vec<_>>()
    };
    for known in ELEMENTS {
        let left_out = |list: &[(&'static str, _)]| -> Vec<&'static str> {
            list.iter().map(|entry| entry.0).collect()
        };
        let taken = match known.name {
            "carFollowing-*" => vec!["attributes of `<vType>`".to_owned()],
            _ => list(&[known.taken], false),
        };
        let children = if known.name == "carFollowing-*" { "" } else { known.children };
        let cells = [
            [taken, list(&[children], true)].concat(),
            [list(&[known.idle], false), list(&[known.idle_children], true)].concat(),
            [
                list(&left_out(known.left_out), false),
                list(&left_out(known.left_out_children), true),
            ]
            .concat(),
        ];
        let cells = cells.map(|names| names.join(", "));
        let _ = writeln!(out, "| `<{}>` | {} |", known.name, cells.join(" | "));
    }
    out
}

//! Tests of route files: what is read, what is planned, and the places of mistakes.

mod episodes;
mod mistakes;
mod paths;
mod reading;
mod schema;
mod unusable;

use super::*;

fn demand(text: &str) -> Result<Demand, Error> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.rou.xml");
    std::fs::write(&file, text).unwrap();
    Demand::load(&[file])
}

fn mistake(text: &str) -> String {
    let message = demand(text).unwrap_err().to_string();
    message.split_once("a.rou.xml:").map_or(message.clone(), |(_, rest)| rest.to_owned())
}

fn crossing() -> net::Net {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    net::Net::load(&root.join("sumo_nets/intersection_turns/two_lanes.net.xml")).unwrap()
}

/// Returns the plan of a file for the crossing, with the edges that it has for `IN` and `OUT`.
fn plan(text: &str) -> DemandPlan {
    let found = demand(&format!("<routes>{text}</routes>")).unwrap();
    found.plan(&crossing(), 0.0, 100.0).unwrap()
}

//! Makes scenarios from a template ([`create`]), from a map ([`import`]) or from a configuration of
//! SUMO ([`import_configuration`]), as files for further editing, and builds their nets ([`build`]).

mod configuration;
mod error;
mod files;
mod import;
mod left_out;
mod netconvert;
mod plan;
mod site;
mod template;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use configuration::import_configuration;
pub use error::Error;
pub use import::{Choices, Imported, Map, import};
pub use netconvert::{Built, State, build, state};
pub use site::Candidate;
pub use template::{Sizes, Template};

use super::Route;
use crate::record::write_atomic;
use crate::sumo::net::Net;
use files::{Layout, Row, Site, Steers};

/// Position of the first spawn place on a lane, with room for half a vehicle and the jitter behind
/// it \[m\].
const FIRST: f64 = 4.0;
/// Distance between spawn places \[m\].
const SPACING: f64 = 8.0;
/// netconvert's options: coordinates as in the sources, no U-turns, and smooth turns that are not
/// too tight.
const OPTIONS: [(&str, &str); 4] = [
    ("offset.disable-normalization", "true"),
    ("no-turnarounds", "true"),
    ("default.junctions.radius", "6"),
    ("junctions.internal-link-detail", "15"),
];

/// Writes a scenario `name` from a template below the folder `root`, builds its net and loads it.
/// Returns the path of the scenario file.
///
/// # Errors
/// [`Error`]; no file is left behind in this case.
pub fn create(
    root: &Path,
    name: &str,
    template: Template,
    sizes: &Sizes,
) -> Result<PathBuf, Error> {
    let layout = Layout::new(root, name)?;
    let (plan, places) = template.plan(sizes)?;
    layout.fill(|| {
        let mut inputs = Vec::new();
        let options = ["node-files", "edge-files", "connection-files", "type-files"];
        for (option, (ending, text)) in
            options.into_iter().zip(plan.sources(template.lanes(sizes)?, sizes.speed))
        {
            write_atomic(&layout.file(ending), text.as_bytes())?;
            inputs.push((option, format!("{name}.{ending}")));
        }
        if let Some(text) = plan.additional() {
            write_atomic(&layout.file("add.xml"), text.as_bytes())?;
        }
        layout.configure(&inputs, &OPTIONS)?;
        netconvert::convert(&layout.net)?;
        let net = Net::load(&layout.net)?;
        let path = |route: &Route| net.route_path_from(&route.edges, route.lane);
        let paths = plan.routes.iter().map(path).collect::<Result<_, _>>()?;
        let row = |routes: Vec<usize>| {
            let edge = &plan.routes[routes[0]].edges[0];
            let ahead = plan.ahead.get(edge).copied().unwrap_or(0.0);
            Row {
                routes,
                first: FIRST + ahead,
                spacing: SPACING,
                count: if plan.single.contains(edge) { 1 } else { places },
            }
        };
        let site = Site {
            has_signals: template == Template::Signals,
            description: template.description().into(),
            rows: starts(&plan.routes).into_values().map(row).collect(),
            routes: plan.routes,
            paths,
            agents: sizes.agents,
            speed: sizes.speed,
            steers: match (plan.lot, sizes.steering) {
                (true, _) => Steers::Lot,
                (false, true) => Steers::Road,
                (false, false) => Steers::No,
            },
        };
        layout.write(&layout.scenario(site)?)?;
        Ok(layout.scenario.clone())
    })
}

/// Returns the routes that begin on each lane, in the order of the routes.
fn starts(routes: &[Route]) -> BTreeMap<(usize, u32), Vec<usize>> {
    let mut starts = BTreeMap::<(usize, u32), Vec<usize>>::new();
    for (i, route) in routes.iter().enumerate() {
        let edge = routes.iter().position(|other| other.edges[0] == route.edges[0]).unwrap_or(i);
        starts.entry((edge, route.lane.unwrap_or(0))).or_default().push(i);
    }
    starts
}

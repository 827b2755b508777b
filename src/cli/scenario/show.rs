//! `iwol scenario show`

use std::path::PathBuf;

use anyhow::bail;

use crate::env::Task;
use crate::inspect::{page, picture};
use crate::record::write_atomic;
use crate::scenario::Scenario;
use crate::sumo::net::Net;

use super::Verdict;

/// Draws the net, the polygons that block sight or radio, the spawn places, the routes, their
/// conflict points, and the radio range of one vehicle.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Scenario file.
    scenario: PathBuf,
    /// Picture to write: .svg, .png, or .html with a table of the routes.
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
    /// Number of vehicles, which determines the net [default: the scenario's].
    #[arg(long)]
    agents: Option<u32>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let scenario = Scenario::load(&args.scenario)?;
    let task = Task::new(&scenario, args.agents.unwrap_or(scenario.agents.default))?;
    let net = Net::load(task.map.net_file())?;
    match args.out.extension().and_then(|ending| ending.to_str()) {
        Some("svg") => write_atomic(&args.out, picture(&task, &net).svg().as_bytes())?,
        Some("png") => picture(&task, &net).png(&args.out)?,
        Some("html") => write_atomic(&args.out, page(&task, &net).as_bytes())?,
        _ => bail!(
            "`{}` is not a picture file: give a name that ends in .svg, .png or .html",
            args.out.display()
        ),
    }
    tell!("{}", args.out.display());
    Ok(Verdict::Good)
}

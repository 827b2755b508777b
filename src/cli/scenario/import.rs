//! `iwol scenario import`

use std::path::PathBuf;

use crate::scenario::author::{Candidate, Choices, Imported, Map, import, import_configuration};
use crate::words::counted;

use super::Verdict;

/// Maximum number of junctions, and of warnings, that are listed.
const LISTED: usize = 8;

/// Of a map or a net, the scenario contains one junction or roundabout, all routes of cars across it
/// that need no lane change, and spawn places on the lanes that lead to it. Of a configuration of SUMO,
/// it contains the whole net with its demand, of which 20 % of the cars are agents. What it leaves out
/// is printed.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("source").required(true).args(["osm", "net", "sumocfg"]))]
pub(super) struct Args {
    /// OpenStreetMap extract (XML), which netconvert converts to a net.
    #[arg(long, value_name = "FILE")]
    osm: Option<PathBuf>,
    /// SUMO net (.net.xml or .net.xml.gz).
    #[arg(long, value_name = "FILE")]
    net: Option<PathBuf>,
    /// Configuration of SUMO (.sumocfg), with a net and demand.
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with_all = ["junction", "steering", "left_hand", "whole_net"]
    )]
    sumocfg: Option<PathBuf>,
    /// Name of the scenario and of its files.
    #[arg(long, value_name = "NAME")]
    out: String,
    /// Id of the junction, or of one of a roundabout [default: the one with the most arms and spawn
    /// places].
    #[arg(long, value_name = "ID")]
    junction: Option<String>,
    /// Default number of agents of the scenario, limited by its number of spawn places [default: 8;
    /// of a configuration, as many as its demand needs].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=2500))]
    agents: Option<u32>,
    /// Let vehicles steer instead of following their lanes.
    #[arg(long)]
    steering: bool,
    /// Let vehicles drive on the left, on a map of OpenStreetMap [default: as the map's
    /// driving_side says, else on the right].
    #[arg(long, conflicts_with = "net")]
    left_hand: bool,
    /// Keep all of a large net (from 500 kB). By default, only the roads at junctions up to 100 m
    /// from the routes stay, so that SUMO does not simulate a whole city.
    #[arg(long)]
    whole_net: bool,
    /// Folder in which the folders scenarios and sumo_nets are created.
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    root: PathBuf,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    if let Some(file) = &args.sumocfg {
        return Ok(told(&import_configuration(&args.root, &args.out, file, args.agents)?));
    }
    let map = match (&args.osm, &args.net) {
        (Some(file), _) => Map::Osm(file),
        (None, Some(file)) => Map::Net(file),
        (None, None) => unreachable!("one of them is required"),
    };
    let choices = Choices {
        junction: args.junction.as_deref(),
        agents: args.agents.unwrap_or(8),
        steering: args.steering,
        left_hand: args.left_hand,
        whole_net: args.whole_net,
    };
    let imported = import(&args.root, &args.out, map, &choices)?;
    for warning in imported.warnings.iter().take(LISTED) {
        say!("netconvert: {warning}");
    }
    if imported.warnings.len() > LISTED {
        say!("netconvert: {}", counted(imported.warnings.len() - LISTED, "more warning"));
    }
    say!("{:<32} {:<20} {:>5} {:>7} {:>7}", "junction", "type", "arms", "routes", "places");
    for (i, Candidate { junction, kind, arms, routes, places }) in
        imported.candidates.iter().enumerate().take(LISTED)
    {
        let chosen = if i == 0 { "  chosen" } else { "" };
        say!("{junction:<32} {kind:<20} {arms:>5} {routes:>7} {places:>7}{chosen}");
    }
    if imported.candidates.len() > LISTED {
        say!(
            "and {}; choose one with --junction",
            counted(imported.candidates.len() - LISTED, "more junction")
        );
    }
    Ok(told(&imported))
}

/// Prints what the scenario does not have, where it is, and what to do next.
fn told(imported: &Imported) -> Verdict {
    imported.notes.iter().for_each(|note| say!("{note}"));
    super::next(&imported.scenario);
    Verdict::Good
}

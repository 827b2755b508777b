//! `iwol scenario new`

use std::path::PathBuf;

use anyhow::Context as _;

use crate::scenario::author::{Sizes, Template, create};

use super::Verdict;

/// Writes SUMO's plain XML, the net that is built from it, and the scenario, with comments for
/// editing.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Name of the scenario and of its files.
    name: String,
    /// Template: cross, signals, tee, roundabout, merge, grid, bottleneck or parking.
    #[arg(long, short)]
    template: String,
    /// Number of lanes per direction: 1 to 4, in a bottleneck 2 to 4, in a parking lot 1 [default:
    /// the minimum].
    #[arg(long)]
    lanes: Option<u32>,
    /// Minimum length of the lanes on which vehicles start, in metres [default: the length that the
    /// number of agents requires].
    #[arg(long, value_name = "METRES")]
    arm_length: Option<f64>,
    /// Number of vehicles.
    #[arg(long, default_value_t = 8)]
    agents: u32,
    /// Speed limit and maximum speed of vehicles, in metres per second.
    #[arg(long, value_name = "M/S", default_value_t = 13.889)]
    speed: f64,
    /// Let vehicles steer instead of following their lanes. In a parking lot, they always steer.
    #[arg(long)]
    steering: bool,
    /// Folder in which the folders scenarios and sumo_nets are created.
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    root: PathBuf,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let template = Template::by_name(&args.template).with_context(|| {
        let names: Vec<&str> = Template::ALL.iter().map(|template| template.name()).collect();
        format!("there is no template `{}`; choose one of {}", args.template, names.join(", "))
    })?;
    let sizes = Sizes {
        lanes: args.lanes,
        arm_length: args.arm_length,
        agents: args.agents,
        speed: args.speed,
        steering: args.steering,
    };
    super::next(&create(&args.root, &args.name, template, &sizes)?);
    Ok(Verdict::Good)
}

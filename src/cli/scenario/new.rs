//! `iwol scenario new`

use std::path::PathBuf;

use anyhow::Context as _;
use iwol_sumo::scenario::author::{Sizes, Template, create};

use super::Verdict;

/// SUMO's plain XML, the net built of it, and the scenario, all commented and ready to edit.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Name of the scenario, also of its files
    name: String,
    /// cross, tee, roundabout, merge, grid, bottleneck or parking
    #[arg(long, short)]
    template: String,
    /// Lanes per direction, 1 to 4; of a bottleneck 2 to 4, of a parking lot 1 [default: the
    /// fewest]
    #[arg(long)]
    lanes: Option<u32>,
    /// Length of the lanes on which vehicles begin, at least, in metres [default: what the agents
    /// need]
    #[arg(long, value_name = "METRES")]
    arm_length: Option<f64>,
    /// Number of vehicles
    #[arg(long, default_value_t = 8)]
    agents: u32,
    /// Speed limit and top speed, in m/s
    #[arg(long, value_name = "M/S", default_value_t = 13.889)]
    speed: f64,
    /// Vehicles steer, instead of following their lanes (in a parking lot always)
    #[arg(long)]
    steering: bool,
    /// Folder in which scenarios/ and sumo_nets/ are
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

//! `iwol scenario`: make, build, check and show scenarios.

mod build;
mod check;
mod import;
mod new;
mod show;

use clap::Subcommand;

use super::Verdict;

/// Subcommands for scenarios.
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = true)]
pub(super) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Write a scenario from a template, and build its net.
    New(new::Args),
    /// Write a draft scenario for a junction of an OpenStreetMap extract or a SUMO net.
    Import(import::Args),
    /// Build the nets of a scenario whose sources have changed.
    Build(build::Args),
    /// Report errors in a scenario, and run a trial of it.
    Check(check::Args),
    /// Draw a scenario.
    Show(show::Args),
    /// Print the documentation of all elements and attributes of scenario files as Markdown.
    Reference,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    match &args.verb {
        Verb::New(args) => new::run(args),
        Verb::Import(args) => import::run(args),
        Verb::Build(args) => build::run(args),
        Verb::Check(args) => check::run(args),
        Verb::Show(args) => show::run(args),
        Verb::Reference => {
            super::print(format_args!("{}", crate::scenario::markdown()));
            Ok(Verdict::Good)
        }
    }
}

/// Prints the path of a new scenario, and which commands to run next.
fn next(scenario: &std::path::Path) {
    tell!("{}", scenario.display());
    let file = super::word(scenario);
    say!(
        "\nnext: iwol scenario check {file}\n      iwol scenario show {file} -o picture.png\n      iwol train --scenario {file}"
    );
}

//! The command line of the program `iwol` and of applications: one file per verb. All printing
//! happens here: results go to stdout, everything else to stderr.

/// Writes a message for the user to stderr. A write that fails, e.g. to a closed terminal, is
/// ignored.
macro_rules! say {
    ($($text:tt)*) => {{
        use std::io::Write as _;
        if !$crate::cli::is_quiet() {
            let _ = writeln!(std::io::stderr(), $($text)*);
        }
    }};
}

/// Prints a line of results to stdout; see [`print()`].
macro_rules! tell {
    ($($text:tt)*) => {
        $crate::cli::print(format_args!("{}\n", format_args!($($text)*)))
    };
}

// Verbs that need libtorch leave themselves out of builds without the feature `learn`. There the
// module `absent` takes their places.
#[cfg(not(feature = "learn"))]
mod absent;
mod bench;
mod config;
mod doctor;
mod evaluate;
mod export;
mod plot;
#[cfg(feature = "learn")]
mod progress;
mod replay;
mod report;
mod scenario;
mod sweep;
mod train;
#[cfg(feature = "learn")]
mod work;

use std::io::IsTerminal as _;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

#[cfg(not(feature = "learn"))]
#[allow(clippy::wildcard_imports, reason = "in place of the modules that are left out")]
use absent::*;
use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use crate::{env, scenario as scenarios, sumo};

/// Multi-vehicle coordination in SUMO: train, evaluate and plot.
#[derive(Debug, Parser)]
#[command(name = "iwol", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
    /// Print log messages about the program's work (-v), and messages for debugging (-vv).
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Stop, as after SIGTERM, when the parent process with this id ends
    #[arg(long, global = true, hide = true, value_name = "PID")]
    die_with_parent: Option<i32>,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Train agents on a scenario.
    Train(train::Args),
    /// Evaluate trained and untrained policies without a window.
    Evaluate(evaluate::Args),
    /// Copy a policy to a small folder that `evaluate` and `train --init-from` accept, or write it
    /// as an ONNX model.
    Export(export::Args),
    /// Train and evaluate a grid of settings and seeds.
    Sweep(sweep::Args),
    /// Make tables and figures from the results of a sweep.
    Report(report::Args),
    /// Convert a recorded episode to a player in one HTML file, or to a picture.
    Replay(replay::Args),
    /// Draw learning curves.
    Plot(plot::Args),
    /// Print the settings that a run would use, and where each comes from.
    Config(config::Args),
    /// Create, import, build, check and draw scenarios.
    Scenario(scenario::Args),
    /// Measure the speed of simulation, decisions and updates.
    Bench(bench::Args),
    /// Check the installation and report problems.
    Doctor,
}

/// Outcome of a verb that ran without an error.
enum Verdict {
    Good,
    /// The work was done, and its result is negative, e.g. `doctor` found a fault.
    Bad,
    /// The user asked the program to stop.
    Interrupted,
}

/// Exit code of a verb that was asked to stop: the code that shells use for Ctrl-C.
const INTERRUPTED: u8 = 130;

/// Runs the command line of the program `iwol` with the arguments of this process, and returns its
/// exit code. An application that registers its own environments ([`crate::env::register`]) and
/// methods (`algo::register`) and then calls this function has the verbs for them, but for `bench`,
/// which is for scenarios, and for ONNX and PyTorch models of registered methods.
pub fn main() -> ExitCode {
    ignore_file_limit();
    let matches = with_negative_numbers(Cli::command()).get_matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let level = match cli.verbose {
        0 => tracing::Level::WARN,
        1 => tracing::Level::INFO,
        _ => tracing::Level::DEBUG,
    };
    // An application may have its own way of logging, which stays.
    tracing_subscriber::fmt()
        .with_max_level(level)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .without_time()
        .log_internal_errors(false)
        .try_init()
        .ok();
    if let Some(parent) = cli.die_with_parent {
        // Only Linux supports this; on other systems the children of a killed sweep run to their
        // end.
        let _ =
            rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM));
        if rustix::process::getppid().is_none_or(|now| now.as_raw_nonzero().get() != parent) {
            return ExitCode::from(INTERRUPTED);
        }
    }
    // Learners work on shards in parallel; libtorch's own threads would compete with them.
    #[cfg(feature = "learn")]
    tch::set_num_threads(1);
    let result = match &cli.verb {
        Verb::Train(args) => train::run(args),
        Verb::Evaluate(args) => evaluate::run(args),
        Verb::Export(args) => export::run(args),
        Verb::Sweep(args) => sweep::run(args),
        Verb::Report(args) => report::run(args),
        Verb::Replay(args) => replay::run(args),
        Verb::Plot(args) => plot::run(args),
        Verb::Config(args) => config::run(args),
        Verb::Scenario(args) => scenario::run(args),
        Verb::Bench(args) => bench::run(args),
        Verb::Doctor => Ok(if doctor::run() { Verdict::Good } else { Verdict::Bad }),
    };
    match result {
        Ok(Verdict::Good) => ExitCode::SUCCESS,
        Ok(Verdict::Bad) => ExitCode::from(1),
        Ok(Verdict::Interrupted) => ExitCode::from(INTERRUPTED),
        Err(error) => {
            say_error(&error);
            ExitCode::from(2)
        }
    }
}

/// Prints an error, and what can be done about it.
fn say_error(error: &anyhow::Error) {
    say!("error: {error:#}");
    if let Some(hint) = hint_of_path(error).or_else(|| hint(error)) {
        say!("\nhint: {hint}");
    }
}

/// Lets the options of a command and of its subcommands take negative numbers, so that an error
/// says which values are allowed. Otherwise `-3` counts as an unknown option.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let takes = |arg: clap::Arg| {
        let takes_value = arg.get_action().takes_values();
        arg.allow_negative_numbers(takes_value)
    };
    command.mut_args(takes).mut_subcommands(with_negative_numbers)
}

/// Returns the path that an argument of the command line was most likely meant to be, if the error
/// is that a file does not exist.
fn hint_of_path(error: &anyhow::Error) -> Option<String> {
    let missing = |e: &std::io::Error| e.kind() == std::io::ErrorKind::NotFound;
    error.chain().find(|cause| cause.downcast_ref().is_some_and(missing))?;
    let text = chain(error.as_ref());
    let mut arguments =
        std::env::args_os().skip(2).filter_map(|argument| argument.into_string().ok());
    arguments.find_map(|argument| {
        // A path is an argument of its own or the value of a setting, as in `--set scenario=FILE`.
        let path = argument.rsplit('=').next().filter(|path| text.contains(path))?;
        let near = crate::suggest::nearest_path(std::path::Path::new(path))?;
        Some(format!("did you mean `{}`?", near.display()))
    })
}

/// Returns the first hint along the chain of causes of an error.
fn hint(error: &anyhow::Error) -> Option<String> {
    error.chain().find_map(|cause| {
        (cause.downcast_ref::<sumo::Error>().and_then(sumo::Error::hint))
            .or_else(|| cause.downcast_ref::<env::Error>()?.hint())
            .or_else(|| cause.downcast_ref::<scenarios::Error>()?.hint())
            .or_else(|| cause.downcast_ref::<scenarios::author::Error>()?.hint())
            .or_else(|| hint_of_learning(cause))
    })
}

#[cfg(feature = "learn")]
fn hint_of_learning(cause: &(dyn std::error::Error + 'static)) -> Option<String> {
    use crate::{config, train};
    match (cause.downcast_ref::<config::Error>(), cause.downcast_ref::<train::Error>()) {
        (Some(config::Error::Scenario(e) | config::Error::Overridden { error: e, .. }), _) => {
            e.hint()
        }
        (_, Some(train::Error::Env(e))) => e.hint(),
        (_, Some(train::Error::Locked { .. })) => crate::ranks::tasks_without_mpi().map(|count| {
            format!(
                "this process is one of {count} tasks of `srun`, which started them without MPI: for one training in {count} processes \
                 use `srun --mpi=pmix`; for {count} trainings, give each a folder of its own with --out"
            )
        }),
        _ => None,
    }
}

#[cfg(not(feature = "learn"))]
fn hint_of_learning(_: &(dyn std::error::Error + 'static)) -> Option<String> {
    None
}

/// Formats an error and its causes in one line.
fn chain(error: &(dyn std::error::Error + 'static)) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// Installs a handler for Ctrl-C and termination signals and returns the flag that the first signal
/// raises; a second signal ends the program at once.
fn stop_flag() -> anyhow::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&flag);
    let stays = hangup_is_ignored();
    ctrlc::set_handler(move || {
        if raised.swap(true, Ordering::Relaxed) {
            leave(130);
        }
        say!("\nstopping in order; a second signal ends the program at once");
    })?;
    if stays {
        ignore_hangup();
    }
    Ok(flag)
}

/// Returns whether this process was started to outlive its terminal (`nohup`).
#[allow(unsafe_code, reason = "std does not tell what is done about a signal")]
fn hangup_is_ignored() -> bool {
    let mut now = std::mem::MaybeUninit::<libc::sigaction>::zeroed();
    // SAFETY: without a new action the call only writes the present one, to memory that is ours and
    // large enough; zeros are a valid value.
    let now = unsafe {
        libc::sigaction(libc::SIGHUP, std::ptr::null(), now.as_mut_ptr());
        now.assume_init()
    };
    now.sa_sigaction == libc::SIG_IGN
}

/// Lets a write beyond the largest size of a file (`ulimit -f`) fail, as on a full disk, instead of
/// ending the program without a word.
#[allow(unsafe_code, reason = "std cannot ignore a signal")]
fn ignore_file_limit() {
    // SAFETY: ignoring a signal needs no handler.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}

#[allow(unsafe_code, reason = "std cannot ignore a signal")]
fn ignore_hangup() {
    // SAFETY: ignoring a signal needs no handler.
    unsafe { libc::signal(libc::SIGHUP, libc::SIG_IGN) };
}

/// Returns the name of this program, for commands that users are told to run.
#[cfg(feature = "learn")]
fn program() -> String {
    let path = std::env::args_os().next().map(std::path::PathBuf::from).unwrap_or_default();
    path.file_name().map_or_else(|| "iwol".to_owned(), |name| name.to_string_lossy().into_owned())
}

/// Returns a path as a word for a shell: in quotes, if it contains characters that shells
/// interpret.
fn word(path: &std::path::Path) -> String {
    let text = path.to_string_lossy();
    let plain = |c: char| c.is_alphanumeric() || "/._-+=,:@%".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        return text.into_owned();
    }
    format!("'{}'", text.replace('\'', "'\\''"))
}

/// Whether this process prints nothing, because another one of the same training does.
static QUIET: AtomicBool = AtomicBool::new(false);

fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

#[cfg(feature = "learn")]
fn be_quiet(quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
}

/// Prints a result to stdout. If nobody reads stdout any more, the program ends with exit code 0;
/// if the write fails for another reason, the program ends with an error.
fn print(text: std::fmt::Arguments<'_>) {
    use std::io::Write as _;
    if is_quiet() {
        return;
    }
    let mut out = std::io::stdout().lock();
    if let Err(error) = out.write_fmt(text).and_then(|()| out.flush()) {
        if error.kind() == std::io::ErrorKind::BrokenPipe {
            leave(0);
        }
        say!("error: cannot write to stdout: {error}");
        leave(2);
    }
}

/// Ends the program without C's exit handlers: they release what libtorch's threads still use,
/// which can crash the program.
#[allow(unsafe_code, reason = "std ends a program by way of C's exit handlers only")]
fn leave(code: i32) -> ! {
    // SAFETY: the function takes a number and does not return.
    unsafe { libc::_exit(code) }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::process::Command;

    /// A shell reads the word as the path.
    #[cfg(feature = "learn")]
    #[test]
    fn words_are_what_a_shell_reads_as_one_argument() {
        assert_eq!(super::word(Path::new("runs/a_b/seed-0,x=1")), "runs/a_b/seed-0,x=1");
        for path in ["läufe/zwei lauf", "it's", "a&b", "$HOME", "~/run", "a\"b", "", "*", "a\nb"] {
            let line = format!("printf %s {}", super::word(Path::new(path)));
            let output = Command::new("sh").args(["-c", &line]).output().expect("a shell");
            assert_eq!(String::from_utf8_lossy(&output.stdout), path, "{line}");
        }
    }
}

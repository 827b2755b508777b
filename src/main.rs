//! The program `iwol`.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}

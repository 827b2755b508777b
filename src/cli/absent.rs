//! The verbs that a build without the feature `learn` lacks: each names the feature.

/// Returns the message that `what` is not in this build.
pub(super) fn needs_learn(what: &str) -> String {
    format!(
        "{what} needs the feature `learn`: build without `--no-default-features` (scripts/bootstrap fetches libtorch, which it links)"
    )
}

macro_rules! absent {
    ($($verb:ident)*) => {$(
        pub(super) mod $verb {
            /// Any arguments.
            #[derive(Debug, clap::Args)]
            pub(in crate::cli) struct Args {
                #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
                _rest: Vec<std::ffi::OsString>,
            }

            pub(in crate::cli) fn run(_: &Args) -> anyhow::Result<crate::cli::Verdict> {
                Err(anyhow::Error::msg(super::needs_learn(concat!("`", stringify!($verb), "`"))))
            }
        }
    )*};
}
absent!(bench config export plot report sweep train);

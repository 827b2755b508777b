//! Build script. It tells the program the commit from which it is built, and the linker where
//! libtorch is, so that programs, tests, examples and benches find libtorch at run time without
//! environment variables. The folder of libtorch is `LIBTORCH`, which `.cargo/config.toml` sets to
//! the link `.libtorch` that `scripts/bootstrap` creates. Without the feature `learn`, libtorch is
//! neither needed nor looked for.

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio, exit};

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    describe_checkout();
    println!("cargo::rerun-if-env-changed=LIBTORCH");
    if env::var_os("CARGO_FEATURE_LEARN").is_some() {
        link_libtorch();
    }
    #[cfg(feature = "libsumo")]
    name_python();
}

/// Sets `IWOL_PYTHON` to the Python interpreter that the program embeds.
#[cfg(feature = "libsumo")]
fn name_python() {
    let Some(python) = pyo3_build_config::get().executable() else {
        fail("pyo3 does not name the Python that it was built for: set PYO3_PYTHON to its path");
    };
    println!("cargo::rustc-env=IWOL_PYTHON={python}");
}

/// Tells the linker and the program where libtorch is.
fn link_libtorch() {
    let Some(libtorch) = env::var_os("LIBTORCH").map(PathBuf::from) else {
        fail(
            "LIBTORCH is not set, and .cargo/config.toml, which sets it, was not read: run cargo inside the repository",
        );
    };
    // The path is not resolved, so that it still holds when the link points elsewhere later.
    let lib = libtorch.join("lib");
    // Cargo watches missing files, too; scripts/bootstrap touches this one when it relinks
    // libtorch.
    println!("cargo::rerun-if-changed={}", libtorch.join("build-version").display());
    if !lib.join("libtorch_cpu.so").exists() {
        fail(&format!(
            "there is no libtorch in {}: run scripts/bootstrap first",
            libtorch.display()
        ));
    }
    // With the old tag the path goes before LD_LIBRARY_PATH, in which other programs may have put
    // another libtorch.
    println!("cargo::rustc-link-arg=-Wl,--disable-new-dtags,-rpath,{}", lib.display());
    if lib.join("libtorch_cuda.so").exists() {
        // The program uses no symbol of this library, but CUDA devices appear only if it is loaded.
        println!("cargo::rustc-link-arg=-L{}", lib.display());
        println!("cargo::rustc-link-arg=-Wl,--push-state,--no-as-needed,-ltorch_cuda,--pop-state");
    }
}

/// Sets `IWOL_COMMIT` to the commit of the checkout and `IWOL_DIRTY` to whether the sources differ
/// from it. Both are `unknown` if the sources are not in a repository of their own or git is
/// missing.
fn describe_checkout() {
    const SOURCES: [&str; 4] = ["src", "build.rs", "Cargo.toml", "Cargo.lock"];
    for path in SOURCES {
        println!("cargo::rerun-if-changed={path}");
    }
    let package = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let git = |arguments: &[&str]| {
        let mut command = Command::new("git");
        command
            .arg("--no-optional-locks")
            .arg("-C")
            .arg(&package)
            .args(arguments)
            .stderr(Stdio::null());
        // In a build within a git hook, these variables name the hook's repository.
        for variable in ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"] {
            command.env_remove(variable);
        }
        let output = command.output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8(output.stdout).ok()?.trim_end_matches('\n').to_owned())
    };
    let same =
        |a: &Path, b: &Path| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    let own = git(&["rev-parse", "--show-toplevel"]).filter(|top| same(Path::new(top), &package));
    let commit = own.and_then(|_| git(&["rev-parse", "HEAD"]));
    let changes = commit
        .as_ref()
        .and_then(|_| git(&[&["status", "--porcelain", "--"][..], &SOURCES].concat()));
    let dirty =
        changes.map_or("unknown", |changes| if changes.is_empty() { "false" } else { "true" });
    println!("cargo::rustc-env=IWOL_COMMIT={}", commit.as_deref().unwrap_or("unknown"));
    println!("cargo::rustc-env=IWOL_DIRTY={dirty}");
    // A commit alone changes no source. A development build is not made again for it, and keeps
    // naming the commit before, with changes, from which it was built. A release build is made
    // again, so that its results name their commit.
    if env::var("PROFILE").is_ok_and(|profile| profile == "release") {
        for file in ["HEAD", "logs/HEAD"] {
            let watched = git(&["rev-parse", "--git-path", file]).map(|path| package.join(path));
            if let Some(path) = watched.filter(|path| path.exists()) {
                println!("cargo::rerun-if-changed={}", path.display());
            }
        }
    }
}

/// Ends the build with a message that cargo shows as an error of its own, without a backtrace.
fn fail(message: &str) -> ! {
    println!("cargo::error={message}");
    exit(1)
}

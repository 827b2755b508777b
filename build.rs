//! Tells the program from which commit it is built, and the linker where libtorch lies, so that programs, tests, examples
//! and benches find it when they run, with no environment variable set. Its folder is `LIBTORCH`, which `.cargo/config.toml` sets to the link `.libtorch` that
//! `scripts/bootstrap` makes.

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio, exit};

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    describe_checkout();
    println!("cargo::rerun-if-env-changed=LIBTORCH");
    let Some(libtorch) = env::var_os("LIBTORCH").map(PathBuf::from) else {
        fail(
            "LIBTORCH is not set, and .cargo/config.toml, which sets it, was not read: run cargo inside the repository",
        );
    };
    // The path stays as it is, link and all, so that it holds wherever the link points later.
    let lib = libtorch.join("lib");
    // Missing files are watched, too. scripts/bootstrap renews this one's time when it links another libtorch.
    println!("cargo::rerun-if-changed={}", libtorch.join("build-version").display());
    if !lib.join("libtorch_cpu.so").exists() {
        fail(&format!(
            "there is no libtorch in {}: run scripts/bootstrap first",
            libtorch.display()
        ));
    }
    println!("cargo::rustc-link-arg=-Wl,-rpath,{}", lib.display());
    if lib.join("libtorch_cuda.so").exists() {
        // No symbol of it is named anywhere, but loading it is what makes CUDA devices appear.
        println!("cargo::rustc-link-arg=-L{}", lib.display());
        println!("cargo::rustc-link-arg=-Wl,--push-state,--no-as-needed,-ltorch_cuda,--pop-state");
    }
}

/// Sets `IWOL_COMMIT` to the checkout's commit and `IWOL_DIRTY` to whether the sources differ from it; both are `unknown`
/// where the sources are in no repository of their own, or there is no git.
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
        // A hook of git's that builds has its own repository in these.
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
    // A commit alone changes no source, and no development build is made again for it: that one goes on to name the commit
    // before, and changes, from which it was built. A release is, so that its results name their commit.
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

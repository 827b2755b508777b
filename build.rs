//! Tells the linker where libtorch lies, so that programs, tests, examples and benches find it when they run, with no
//! environment variable set. Its folder is `LIBTORCH`, which `.cargo/config.toml` sets to the link `.libtorch` that
//! `scripts/bootstrap` makes.

use std::env;
use std::path::PathBuf;
use std::process::exit;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
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
        fail(&format!("there is no libtorch in {}: run scripts/bootstrap first", libtorch.display()));
    }
    println!("cargo::rustc-link-arg=-Wl,-rpath,{}", lib.display());
    if lib.join("libtorch_cuda.so").exists() {
        // No symbol of it is named anywhere, but loading it is what makes CUDA devices appear.
        println!("cargo::rustc-link-arg=-L{}", lib.display());
        println!("cargo::rustc-link-arg=-Wl,--push-state,--no-as-needed,-ltorch_cuda,--pop-state");
    }
}

/// Ends the build with a message that cargo shows as an error of its own, without a backtrace.
fn fail(message: &str) -> ! {
    println!("cargo::error={message}");
    exit(1)
}

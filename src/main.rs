//! The program `iwol`.

mod cli;

use std::ffi::{c_int, c_long};

/// For libtorch as well: it overrides that of the C library.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    keep_memory();
    cli::main()
}

/// Freed memory goes back to the kernel after ten seconds instead of one, unless `MIMALLOC_PURGE_DELAY` says otherwise: what an update
/// frees it takes again in the next, and training among 48 vehicles takes 4 to 11 % less time where the kernel need not clear it.
#[allow(unsafe_code, reason = "the crate does not bind options that mimalloc calls advanced")]
fn keep_memory() {
    /// `mi_option_purge_delay` in milliseconds (mimalloc 3, `mimalloc.h`).
    const PURGE_DELAY: c_int = 15;
    unsafe extern "C" {
        fn mi_option_set_default(option: c_int, value: c_long);
    }
    // SAFETY: as the header declares it; it writes to a table, and no other thread is there yet.
    unsafe { mi_option_set_default(PURGE_DELAY, 10_000) };
}

//! The program `iwol`: the command line of the library, with another allocator.

/// The allocator of libtorch, too: it overrides that of the C library.
#[cfg(feature = "learn")]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    #[cfg(feature = "learn")]
    keep_memory();
    iwol_sumo::cli::main()
}

/// Keeps freed memory for ten seconds, instead of one, before it goes back to the kernel, unless
/// `MIMALLOC_PURGE_DELAY` is set. Each update allocates what the last one freed, and training with
/// 48 vehicles takes 4 to 11 % less time if the kernel need not clear that memory.
#[cfg(feature = "learn")]
#[allow(unsafe_code, reason = "the crate does not bind options that mimalloc calls advanced")]
fn keep_memory() {
    use std::ffi::{c_int, c_long};

    /// Index of the option `mi_option_purge_delay` (in milliseconds; mimalloc 3, `mimalloc.h`).
    const PURGE_DELAY: c_int = 15;
    unsafe extern "C" {
        fn mi_option_set_default(option: c_int, value: c_long);
    }
    // SAFETY: the declaration is that of the header; the function writes to a table, and no other
    // thread exists yet.
    unsafe { mi_option_set_default(PURGE_DELAY, 10_000) };
}

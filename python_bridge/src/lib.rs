//! The native half of the Python package `iwol_sumo`: it converts arguments, releases the
//! interpreter lock while Rust works, and fills NumPy's arrays. What users see is in
//! `python/iwol_sumo`.

mod env;
mod error;
mod evaluation;
mod task;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    use super::*;

    #[pymodule_export]
    use super::env::NativeEnv;
    #[pymodule_export]
    use super::evaluation::evaluate;
    #[pymodule_export]
    use super::task::NativeTask;
    #[pymodule_export]
    use super::task::also_look_in;
    #[pymodule_export]
    use super::task::overridable;
    #[pymodule_export]
    use super::task::sumo;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        pyo3_log::init();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

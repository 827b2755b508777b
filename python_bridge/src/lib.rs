//! The native half of the Python package `iwol_sumo`: it converts arguments, releases the
//! interpreter lock while Rust works, and fills NumPy's arrays. What users see is in
//! `python/iwol_sumo`.

mod authoring;
mod env;
mod error;
mod evaluation;
mod picture;
mod task;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    use super::*;

    #[pymodule_export]
    use super::authoring::check_scenario;
    #[pymodule_export]
    use super::authoring::import_map;
    #[pymodule_export]
    use super::authoring::import_sumocfg;
    #[pymodule_export]
    use super::authoring::new_scenario;
    #[pymodule_export]
    use super::authoring::show_scenario;
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

    /// Ends the messages to Python's logging, which does not outlive the interpreter: SUMO's last words
    /// may come later.
    #[pyfunction]
    fn silence() {
        log::set_max_level(log::LevelFilter::Off);
    }

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        pyo3_log::init();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

//! The Python interpreter in this process, and the module libsumo that it imports.
//!
//! The interpreter is the one that this program was built with. No Python that is first in `PATH`,
//! no activated virtual environment and no variable such as `PYTHONHOME` has an influence on it.
//!
//! A libsumo of the Python package index is used if it is made for this interpreter and of the same
//! release as the program `sumo`, but never beside libtorch: both contain templates of the C++
//! library, of compilers whose objects differ, and calls of one end in the code of the other.
//! Releases 1.18 to 1.25 crash so, and vehicles that steer move otherwise in 1.28.

use std::{
    ffi::{CStr, CString},
    fs,
    mem::MaybeUninit,
    path::{Path, PathBuf},
    sync::{Once, OnceLock},
};

use pyo3::{ffi, prelude::*, types::PyList};

use super::failed;
use crate::sumo::{Error, Installation, process::sites};

/// The interpreter that this program was built with (`build.rs`).
const PYTHON: &str = env!("IWOL_PYTHON");

/// Whether this program contains libtorch.
const BESIDE_LIBTORCH: bool = cfg!(feature = "learn");

/// The Python module libsumo that this process has loaded.
#[derive(Debug)]
pub struct LibsumoModule {
    /// SUMO's release, for example `1.15.0`.
    pub release: String,
    /// The module's file.
    pub file: PathBuf,
    /// Path and version of the Python interpreter, in words.
    pub python: String,
    /// How the module differs from the program `sumo`, in words; `None` if both have the same
    /// release, or if there is no program.
    pub difference: Option<String>,
    bridge: Py<PyModule>,
}

impl LibsumoModule {
    /// Loads the module, once per process.
    ///
    /// # Errors
    /// [`Error::Libsumo`] if Python does not start or finds no module that it can import.
    pub fn load() -> Result<&'static Self, Error> {
        static MODULE: OnceLock<Result<LibsumoModule, String>> = OnceLock::new();
        let module = MODULE.get_or_init(|| {
            start_python()?;
            Python::attach(import)
        });
        let failed =
            |message: &String| Error::Libsumo { doing: "import it", message: message.clone() };
        module.as_ref().map_err(failed)
    }

    /// Warns once if the module differs from the program `sumo`.
    pub(super) fn warn(&self) {
        static WARNED: Once = Once::new();
        if let Some(difference) = &self.difference {
            WARNED.call_once(|| {
                tracing::warn!(
                    "{difference}; validations and SUMO's own driver use the program, and may differ"
                );
            });
        }
    }

    pub(super) fn bridge<'py>(&self, py: Python<'py>) -> &Bound<'py, PyModule> {
        self.bridge.bind(py)
    }
}

/// Imports libsumo and runs the module of the bridge.
fn import(py: Python<'_>) -> Result<LibsumoModule, String> {
    let text = |e: PyErr| failed("import it", py, &e).to_string();
    let version = py.version_info();
    let tag = format!("cp{}{}", version.major, version.minor);
    let sumo = Installation::find().ok();
    let release = sumo.as_ref().and_then(|sumo| Some(sumo.version().ok()?.release().to_owned()));
    let mut folders: Vec<PathBuf> = sumo.iter().filter_map(Installation::site).collect();
    folders.extend(sites(&|name| std::env::var_os(name)));
    let packages: Vec<Package> = folders.iter().filter_map(|folder| Package::of(folder)).collect();
    let fits = |package: &&Package| {
        !BESIDE_LIBTORCH && package.tag == tag && release.as_ref() == Some(&package.release)
    };
    let fitting = packages.iter().find(fits).map(|package| package.folder);
    if BESIDE_LIBTORCH
        && let Some(site) = own_site(py)
        && let Some(package) = Package::of(&site)
    {
        return Err(format!("{package} does not work in one process with libtorch"));
    }
    let bridge = run_bridge(py, fitting).map_err(|e| {
        let others = packages.iter().map(|package| format!("; {package} is not used"));
        format!("{} (Python: {PYTHON}, {tag}){}", e.value(py), others.collect::<String>())
    })?;
    let of_bridge = || -> PyResult<(String, PathBuf)> {
        let (_, name): (i32, String) = bridge.call_method0("version")?.extract()?;
        Ok((name, bridge.getattr("libsumo")?.getattr("__file__")?.extract()?))
    };
    let (name, file) = of_bridge().map_err(text)?;
    let found = name.strip_prefix("SUMO ").unwrap_or(&name).to_owned();
    let difference = match (&sumo, release) {
        (Some(sumo), Some(release)) if release != found => Some(format!(
            "libsumo is SUMO {found} (`{}`), and the program sumo is {release} (`{}`)",
            file.display(),
            sumo.binary().display()
        )),
        _ => None,
    };
    Ok(LibsumoModule {
        release: found,
        file,
        python: format!("{PYTHON}, {}.{}.{}", version.major, version.minor, version.patch),
        difference,
        bridge: bridge.unbind(),
    })
}

/// Returns the folder in which the interpreter itself finds libsumo.
fn own_site(py: Python<'_>) -> Option<PathBuf> {
    let spec = py.import("importlib.util").ok()?.call_method1("find_spec", ("libsumo",)).ok()?;
    let file: PathBuf = spec.getattr("origin").ok()?.extract().ok()?;
    Some(file.ancestors().nth(2)?.to_owned())
}

/// Runs the bridge's code, which imports libsumo, in `folder` first.
fn run_bridge<'py>(py: Python<'py>, folder: Option<&Path>) -> PyResult<Bound<'py, PyModule>> {
    const NAME: &CStr = c"iwol_sumo_libsumo_bridge";
    let code = CString::new(include_str!("../../../python_bridge/libsumo_bridge.py"))?;
    let path = py.import("sys")?.getattr("path")?.cast_into::<PyList>()?;
    if let Some(folder) = folder {
        // As a string: Python passes over entries of other types.
        path.insert(0, folder.as_os_str())?;
    }
    let module = PyModule::from_code(py, &code, c"python_bridge/libsumo_bridge.py", NAME);
    if folder.is_some() {
        path.del_item(0)?;
    }
    module
}

/// A libsumo of the Python package index.
struct Package<'a> {
    folder: &'a Path,
    release: String,
    /// Python for which it is made, such as `cp311`.
    tag: String,
}

impl std::fmt::Display for Package<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "libsumo {} for {} in `{}`", self.release, self.tag, self.folder.display())
    }
}

impl<'a> Package<'a> {
    /// Returns the package in a folder of Python packages, if there is one.
    fn of(folder: &'a Path) -> Option<Self> {
        fs::read_dir(folder).ok()?.flatten().find_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            let release = name.strip_prefix("libsumo-")?.strip_suffix(".dist-info")?;
            let wheel = fs::read_to_string(entry.path().join("WHEEL")).ok()?;
            let tag =
                wheel.lines().find_map(|line| line.strip_prefix("Tag: ")?.split('-').next())?;
            Some(Package { folder, release: release.to_owned(), tag: tag.to_owned() })
        })
    }
}

/// Starts the interpreter, unless this process has one.
#[allow(unsafe_code, reason = "pyo3 cannot start an interpreter with a configuration")]
fn start_python() -> Result<(), String> {
    let program = CString::new(PYTHON).map_err(|e| e.to_string())?;
    // SAFETY: the calls come in the order that Python's documentation prescribes (Python
    // Initialization Configuration). `LibsumoModule::load` makes them once, no other code in this
    // program starts Python, and after the last call this thread no longer holds the interpreter.
    unsafe {
        if ffi::Py_IsInitialized() != 0 {
            return Ok(());
        }
        let mut before = MaybeUninit::<ffi::PyPreConfig>::uninit();
        ffi::PyPreConfig_InitIsolatedConfig(before.as_mut_ptr());
        let mut before = before.assume_init();
        // Paths are UTF-8, whatever the locale is.
        before.utf8_mode = 1;
        succeeded(ffi::Py_PreInitialize(&raw const before))?;
        let mut config = MaybeUninit::<ffi::PyConfig>::uninit();
        ffi::PyConfig_InitIsolatedConfig(config.as_mut_ptr());
        let mut config = config.assume_init();
        // A name with a slash is not looked up in `PATH`.
        let name = &raw mut config.program_name;
        let named = ffi::PyConfig_SetBytesString(&raw mut config, name, program.as_ptr());
        let started = succeeded(named)
            .and_then(|()| succeeded(ffi::Py_InitializeFromConfig(&raw const config)));
        ffi::PyConfig_Clear(&raw mut config);
        started?;
        ffi::PyEval_SaveThread();
    }
    Ok(())
}

/// Returns the message of a failed step of Python's start.
#[allow(unsafe_code, reason = "Python's status is a C struct")]
fn succeeded(status: ffi::PyStatus) -> Result<(), String> {
    // SAFETY: the function reads the struct, whose message is a static string.
    unsafe {
        if ffi::PyStatus_Exception(status) == 0 {
            return Ok(());
        }
        let message = if status.err_msg.is_null() {
            "no reason given".into()
        } else {
            CStr::from_ptr(status.err_msg).to_string_lossy()
        };
        Err(format!("the Python interpreter {PYTHON} does not start: {message}"))
    }
}

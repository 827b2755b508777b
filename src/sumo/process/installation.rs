//! Finds SUMO: its real programs, its data, and where they come from.
//!
//! The program `sumo` of the Python package `eclipse-sumo` is a script that runs the real one as a
//! child. [`Installation`] finds the real one behind it. Every other program of SUMO, and the data
//! that SUMO's programs read, come from the same installation, whatever `SUMO_HOME` says.

use std::{
    ffi::{OsStr, OsString},
    fs,
    io::Read as _,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::OnceLock,
};

use super::{Error, Options, Process, empty_net};
use crate::sumo::client::Version;

/// Folder of Python packages of the interpreter that this library runs in.
static OWN_SITE: OnceLock<PathBuf> = OnceLock::new();

/// Lets [`Installation::find`] look for the Python package `eclipse-sumo` in this folder as well,
/// before those of the environment. The first call counts.
pub fn also_look_in(site: &Path) {
    OWN_SITE.get_or_init(|| site.to_owned());
}

/// An installation of SUMO.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Installation {
    binary: PathBuf,
    /// The script in whose place `binary` is used.
    script: Option<PathBuf>,
    reason: String,
}

impl Installation {
    /// Finds SUMO in `$SUMO_HOME/bin`, then in `PATH`, then in a Python package `eclipse-sumo` in
    /// the folder of [`also_look_in`], `PYTHONPATH`, `VIRTUAL_ENV`, `CONDA_PREFIX` or `~/.local`.
    ///
    /// # Errors
    /// [`Error::NotFound`] with the folders that were searched.
    pub fn find() -> Result<Self, Error> {
        Self::find_by(|name| std::env::var_os(name))
    }

    /// As [`Installation::find`], with the values of environment variables from `variable`.
    pub(super) fn find_by(variable: impl Fn(&str) -> Option<OsString>) -> Result<Self, Error> {
        let home = variable("SUMO_HOME").filter(|home| !home.is_empty());
        let home = home.as_deref().map(|home| Path::new(home).join("bin"));
        let path = folders(variable("PATH"));
        let sites: Vec<PathBuf> =
            OWN_SITE.get().cloned().into_iter().chain(sites(&variable)).collect();
        let packages = sites.iter().map(|site| site.join("sumo/bin"));
        let passed_over = match &home {
            Some(bin) => {
                format!("; SUMO_HOME is not used: `{}` has no program sumo", bin.display())
            }
            None => String::new(),
        };
        let places = (home.iter().cloned().map(|bin| (bin, "in SUMO_HOME".to_owned())))
            .chain(path.iter().cloned().map(|bin| (bin, format!("first in PATH{passed_over}"))))
            .chain(packages.map(|bin| {
                (bin, format!("in a Python package, as PATH has no program sumo{passed_over}"))
            }));
        for (folder, reason) in places {
            let file = folder.join("sumo");
            if is_executable(&file) {
                return Ok(Self::at(&file, reason));
            }
        }
        let looked_in = home.into_iter().chain(path).collect();
        Err(Error::NotFound { binary: "sumo".to_owned(), looked_in })
    }

    /// Returns the installation whose program `sumo` is `file`, or behind it if `file` is the
    /// script of the Python package.
    pub(super) fn at(file: &Path, reason: impl Into<String>) -> Self {
        let (file, reason) = (std::path::absolute(file).unwrap_or(file.to_owned()), reason.into());
        match behind_script(&file) {
            Some(binary) => Self { binary, script: Some(file), reason },
            None => Self { binary: file, script: None, reason },
        }
    }

    /// Returns the path of the program `sumo`.
    pub fn binary(&self) -> &Path {
        &self.binary
    }

    /// Says in words why this installation is the one that is used.
    pub fn reason(&self) -> String {
        match &self.script {
            Some(script) => {
                format!("the program behind the script `{}`, {}", script.display(), self.reason)
            }
            None => self.reason.clone(),
        }
    }

    /// Whether the program `sumo` is a script, which may run SUMO as a child.
    pub(super) fn is_script(&self) -> bool {
        is_script(&self.binary)
    }

    /// Returns the path of another program of this installation, such as `netconvert`.
    ///
    /// # Errors
    /// [`Error::NotFound`] with the folders that were searched.
    pub fn program(&self, name: &str) -> Result<PathBuf, Error> {
        let real = fs::canonicalize(&self.binary).unwrap_or_default();
        let mut looked_in = Vec::new();
        for program in [&self.binary, &real] {
            looked_in.extend(program.parent().map(Path::to_owned));
        }
        looked_in.dedup();
        if self.is_script() {
            // What the script starts is unknown, and so is the installation.
            looked_in.extend(folders(std::env::var_os("PATH")));
        }
        let files = looked_in.iter().map(|folder| folder.join(name));
        match files.into_iter().find(|file| is_executable(file)) {
            Some(file) => Ok(behind_script(&file).unwrap_or(file)),
            None => Err(Error::NotFound { binary: name.to_owned(), looked_in }),
        }
    }

    /// Returns the folder with SUMO's data and its folder `tools`, the value of `SUMO_HOME` for
    /// SUMO's programs; `None` if it is not known.
    pub fn home(&self) -> Option<PathBuf> {
        let real = fs::canonicalize(&self.binary).ok()?;
        let prefix = real.parent()?.parent()?;
        let folders = [prefix.to_owned(), prefix.join("share/sumo"), prefix.join("../sumo_data")];
        folders.into_iter().find(|folder| folder.join("data/xsd").is_dir())
    }

    /// Returns the folder of Python packages that contains this installation; `None` if it is not
    /// one of the Python package `eclipse-sumo`.
    pub fn site(&self) -> Option<PathBuf> {
        let site = fs::canonicalize(&self.binary).ok()?.ancestors().nth(3)?.to_owned();
        (site.join("sumo/__init__.py").is_file() && self.binary.ends_with("sumo/bin/sumo"))
            .then_some(site)
    }

    /// Returns a command that runs a program of this installation with its data, with messages in
    /// English, and without standard input.
    pub fn command(&self, program: &Path) -> Command {
        let mut command = Command::new(program);
        command.stdin(Stdio::null()).env("LC_ALL", "C.UTF-8").env_remove("LANGUAGE");
        if let Some(home) = self.home() {
            let proj = home.join("data/proj");
            if proj.is_dir() {
                command.env("PROJ_LIB", &proj).env("PROJ_DATA", &proj);
            }
            command.env("SUMO_HOME", home);
        }
        command
    }

    /// Starts SUMO on an empty net and returns the version in its TraCI reply, because the text
    /// that SUMO prints about itself differs between releases.
    ///
    /// # Errors
    /// As [`Process::start`].
    pub fn version(&self) -> Result<Version, Error> {
        let (_net, arguments) = empty_net()?;
        let options =
            Options { binary: Some(self.binary.clone()), arguments, ..Options::default() };
        Process::start(&options).map(|(_, _, version)| version)
    }
}

/// Finds another program of SUMO, such as `netconvert`, in the installation of
/// [`Installation::find`].
///
/// # Errors
/// [`Error::NotFound`] with the folders that were searched.
pub fn find_program(name: &str) -> Result<PathBuf, Error> {
    Installation::find()?.program(name)
}

/// Returns the folders of Python packages of the user's environment, the first of them those in
/// which Python looks first.
pub(in crate::sumo) fn sites(variable: &impl Fn(&str) -> Option<OsString>) -> Vec<PathBuf> {
    let prefix = |name: &str| variable(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let user = prefix("HOME").map(|home| home.join(".local"));
    let prefixes = prefix("VIRTUAL_ENV").into_iter().chain(prefix("CONDA_PREFIX")).chain(user);
    let mut all = folders(variable("PYTHONPATH"));
    all.extend(prefixes.flat_map(|prefix| packages_below(&prefix)));
    all
}

/// Returns the folders of Python packages of an installation of Python.
fn packages_below(prefix: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for lib in ["lib", "lib64"] {
        for entry in fs::read_dir(prefix.join(lib)).into_iter().flatten().flatten() {
            if entry.file_name().to_string_lossy().starts_with("python3") {
                found
                    .extend(["site-packages", "dist-packages"].map(|name| entry.path().join(name)));
            }
        }
    }
    found.retain(|folder| folder.is_dir());
    found.sort();
    found
}

/// Returns the real program that a script of the Python package `eclipse-sumo` runs; `None` if the
/// file is no such script.
fn behind_script(file: &Path) -> Option<PathBuf> {
    let mut start = Vec::new();
    fs::File::open(file).ok()?.take(4096).read_to_end(&mut start).ok()?;
    let text = String::from_utf8_lossy(&start);
    if !text.starts_with("#!") || !text.contains("from sumo import") {
        return None;
    }
    // Tools such as pipx link to the script.
    let script = fs::canonicalize(file).ok()?;
    let prefix = script.parent()?.parent()?;
    // `pip install --target` puts the packages beside the folder of the scripts.
    let sites = packages_below(prefix).into_iter().chain([prefix.to_owned()]);
    let name = script.file_name()?;
    let mut programs = sites.map(|site| site.join("sumo/bin").join(name));
    programs.find(|program| is_executable(program) && !is_script(program))
}

fn is_script(file: &Path) -> bool {
    let mut start = [0; 2];
    fs::File::open(file).and_then(|mut file| file.read_exact(&mut start)).is_ok() && &start == b"#!"
}

fn is_executable(file: &Path) -> bool {
    fs::metadata(file).is_ok_and(|m| m.is_file() && m.permissions().mode() & 0o111 != 0)
}

/// Splits a list of folders, such as `PATH`.
fn folders(list: Option<OsString>) -> Vec<PathBuf> {
    let list = list.unwrap_or_default();
    std::env::split_paths::<OsStr>(&list).filter(|f| !f.as_os_str().is_empty()).collect()
}

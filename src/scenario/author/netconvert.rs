//! Builds nets from the sources beside them. `<net>.netccfg`, a configuration of SUMO's netconvert,
//! names the sources.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use super::super::Scenario;
use super::Error;
use super::files::{beside, show_traffic};
use crate::markup;
use crate::record::write_atomic;
use crate::sumo::Installation;
use crate::sumo::net::xml;

/// Largest configuration that is read \[bytes\].
const MAX_BYTES: u64 = 1 << 20;
/// Largest number of netconvert's error lines in a message.
const LAST_LINES: usize = 6;

/// State of a net in relation to its sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// There is no configuration beside the net: it was made elsewhere.
    NoSources,
    /// The net is as new as its sources.
    UpToDate,
    /// The net is missing or older than one of its sources, or a source is missing.
    OutOfDate,
}

/// A net of a scenario after a build.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Built {
    /// Path of the `.net.xml`.
    pub net: PathBuf,
    /// State before the build, which has built the net if it was out of date.
    pub before: State,
    /// Warnings of netconvert, if it ran.
    pub warnings: Vec<String>,
}

/// Builds the nets of a scenario that are out of date or, with `all`, every net that has sources.
/// The same sources give the same bytes. Also updates the vehicles that SUMO alone shows
/// (`.rou.xml`).
///
/// # Errors
/// [`Error`] if the scenario cannot be read, netconvert is missing, or netconvert rejects the
/// sources.
pub fn build(scenario: &Path, all: bool) -> Result<Vec<Built>, Error> {
    let scenario = Scenario::read(scenario)?;
    let mut built = Vec::new();
    for net in &scenario.nets {
        let before = state(&net.file)?;
        if before == State::NoSources && !net.file.exists() {
            return Err(Error::NoNet { net: net.file.clone(), config: configuration(&net.file) });
        }
        let warnings = match before {
            State::NoSources => Vec::new(),
            State::UpToDate if !all => Vec::new(),
            _ => convert(&net.file)?,
        };
        if before != State::NoSources {
            show_traffic(&scenario, net)?;
        }
        built.push(Built { net: net.file.clone(), before, warnings });
    }
    Ok(built)
}

/// Returns the state of a net in relation to its sources.
///
/// # Errors
/// [`Error::Configuration`] or [`Error::Read`] if there is a configuration that cannot be read.
pub fn state(net: &Path) -> Result<State, Error> {
    let config = configuration(net);
    if !config.exists() {
        return Ok(State::NoSources);
    }
    let age = |path: &Path| fs::metadata(path).and_then(|data| data.modified()).ok();
    let Some(built) = age(net) else { return Ok(State::OutOfDate) };
    let sources = sources(&config)?;
    let older = |path: &PathBuf| age(path).is_some_and(|age| age <= built);
    let up_to_date = sources.iter().chain([&config]).all(older);
    Ok(if up_to_date { State::UpToDate } else { State::OutOfDate })
}

/// Returns the path of a net's configuration.
fn configuration(net: &Path) -> PathBuf {
    beside(net, "netccfg")
}

/// Returns the files that a configuration names as its input.
fn sources(config: &Path) -> Result<Vec<PathBuf>, Error> {
    let text = markup::read(config, MAX_BYTES)
        .map_err(|source| Error::Read { path: config.into(), source })?;
    let refused = |why: String| Error::Configuration { path: config.into(), why };
    let text = text.ok_or_else(|| refused(format!("the file is larger than {MAX_BYTES} bytes")))?;
    let document =
        xml::parse(&text).map_err(|(error, at)| refused(format!("line {}: {error}", at.row)))?;
    let folder = config.parent().unwrap_or(Path::new(""));
    let inputs = document
        .descendants()
        .filter(|node| node.parent().is_some_and(|parent| parent.has_tag_name("input")));
    let files =
        inputs.filter_map(|node| node.attribute("value")).flat_map(|value| value.split(','));
    Ok(files.map(|file| folder.join(file.trim())).collect())
}

/// Runs netconvert for one net; returns its warnings.
pub(super) fn convert(net: &Path) -> Result<Vec<String>, Error> {
    let config = configuration(net);
    let folder =
        net.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let sumo = Installation::find()?;
    let program = sumo.program("netconvert")?;
    let temporary = tempfile::Builder::new().suffix(".net.xml").tempfile_in(folder);
    let temporary =
        temporary.map_err(|source| Error::Write { path: folder.into(), source })?.into_temp_path();
    let name = |path: &Path| path.file_name().map(OsString::from).unwrap_or_default();
    let output = sumo
        .command(&program)
        .arg("--configuration-file")
        .arg(name(&config))
        .arg("--output-file")
        .arg(name(&temporary))
        .current_dir(folder)
        .output()
        .map_err(|source| crate::sumo::Error::Spawn { binary: program, source })?;
    let said = String::from_utf8_lossy(&output.stderr);
    let lines = || said.lines().map(str::trim).filter(|line| !line.is_empty());
    if !output.status.success() {
        let errors: Vec<&str> =
            lines().filter(|line| !line.starts_with("Warning")).take(LAST_LINES).collect();
        // The user knows the net by its own name.
        let [temporary, own] = [name(&temporary), name(net)].map(|name| name.display().to_string());
        let message = errors.join(" ").replace(&temporary, &own);
        return Err(Error::Netconvert { config, message });
    }
    let text = fs::read_to_string(&temporary)
        .map_err(|source| Error::Read { path: temporary.to_path_buf(), source })?;
    write_atomic(net, without_comments(&text).as_bytes())?;
    Ok(lines().filter_map(|line| line.strip_prefix("Warning: ")).map(Into::into).collect())
}

/// Removes the comments of a net, in which netconvert writes the date and the machine's paths.
fn without_comments(text: &str) -> String {
    let (mut plain, mut rest) = (String::with_capacity(text.len()), text);
    while let Some((before, comment)) = rest.split_once("<!--") {
        let Some((_, after)) = comment.split_once("-->") else { break };
        plain.push_str(before.trim_end());
        plain.push_str("\n\n");
        rest = after.trim_start();
    }
    plain + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::SystemTime;

    #[test]
    fn comments_go_and_all_else_stays() {
        assert_eq!(without_comments("<a>\n\n<!-- x\n y -->\n\n<b/></a>\n"), "<a>\n\n<b/></a>\n");
        assert_eq!(without_comments("<a/>"), "<a/>");
    }

    #[test]
    fn a_net_is_out_of_date_when_a_source_is_newer_or_gone() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        let net = file("a.net.xml");
        assert_eq!(state(&net).unwrap(), State::NoSources);
        fs::write(
            file("a.netccfg"),
            "<configuration><input><node-files value=\"a.nod.xml, b.xml\"/></input></configuration>",
        )
        .unwrap();
        assert_eq!(state(&net).unwrap(), State::OutOfDate);
        fs::write(file("a.nod.xml"), "").unwrap();
        fs::write(file("b.xml"), "").unwrap();
        fs::write(&net, "").unwrap();
        assert_eq!(state(&net).unwrap(), State::UpToDate);
        fs::remove_file(file("a.nod.xml")).unwrap();
        assert_eq!(state(&net).unwrap(), State::OutOfDate);
        fs::write(file("a.nod.xml"), "").unwrap();
        fs::write(&net, "").unwrap();
        assert_eq!(state(&net).unwrap(), State::UpToDate);
        let later = SystemTime::now() + std::time::Duration::from_secs(10);
        fs::File::create(file("b.xml")).unwrap().set_modified(later).unwrap();
        assert_eq!(state(&net).unwrap(), State::OutOfDate);
        fs::write(file("a.netccfg"), "<configuration>").unwrap();
        assert!(matches!(state(&net), Err(Error::Configuration { .. })));
    }
}

//! Tests of the documentation: links lead somewhere, the book has every page, the page on the
//! command line is what the program says, and commands in pages run.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::support::{in_parallel, root};

/// Stands for `iwol` while a page's commands run: passes each call on to the program, with few
/// steps, cells and episodes, so that it ends in a second or two.
const IWOL: &str = r#"#!/bin/sh
set -eu
case "$*" in
train*--resume*) ;;
train*)
    set -- "$@" --set steps=40 --set train.rollout_steps=20 --set train.validate_every=40 \
        --set train.envs=1 --set train.validation_episodes=1
    case "$*" in
    *--environment*) ;;
    *) set -- "$@" --set scenario.termination.horizon=80 ;;
    esac
    ;;
evaluate*--episodes*)
    case "$*" in *--scenario*) set -- "$@" --set scenario.termination.horizon=80 ;; esac
    # Writes 2 instead of a number above 10, in a round of all arguments.
    set -- "$@" end
    while [ "$1" != end ]; do
        argument=$1
        shift
        if [ "$argument" = --episodes ] && [ "$1" -gt 10 ]; then
            shift
            set -- 2 "$@"
        fi
        set -- "$@" "$argument"
    done
    shift
    ;;
evaluate*) set -- "$@" --episodes 2 ;;
sweep*--slurm*) set -- sweep --help ;;
sweep*--dry-run*) ;;
sweep*) set -- "$@" --dry-run ;;
bench*) set -- "$@" --help ;;
report*)
    # Nothing is trained, but everything that the call names is there.
    if answer=$("$IWOL" "$@" 2>&1); then exit; fi
    case $answer in *"has no result yet"*) exit ;; esac
    ;;
esac
exec "$IWOL" "$@"
"#;

/// A map with a junction of four arms.
const MAP: &str = r#"<osm version="0.6"><bounds minlat="52.0" minlon="13.0" maxlat="52.01" maxlon="13.01"/>
<node id="1" lat="52.0050" lon="13.0000"/><node id="2" lat="52.0050" lon="13.0050"/><node id="3" lat="52.0050" lon="13.0100"/>
<node id="4" lat="52.0000" lon="13.0050"/><node id="5" lat="52.0100" lon="13.0050"/>
<way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="residential"/></way>
<way id="11"><nd ref="4"/><nd ref="2"/><nd ref="5"/><tag k="highway" v="residential"/></way></osm>"#;

fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_iwol"));
    command.current_dir(root()).env("NO_COLOR", "1");
    command
}

/// A page of the documentation.
struct Page {
    /// Path from the root of the repository.
    path: PathBuf,
    text: String,
}

impl Page {
    fn read(path: &Path) -> Self {
        let text = fs::read_to_string(root().join(path)).expect("text");
        Self { path: path.to_owned(), text }
    }

    /// Returns the code blocks that are marked with a language.
    fn blocks(&self, language: &str) -> Vec<String> {
        let mut blocks = Vec::new();
        let mut lines = self.text.lines();
        while let Some(line) = lines.next() {
            if let Some(marked) = line.strip_prefix("```") {
                let block: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
                if marked == language {
                    blocks.push(block.join("\n"));
                }
            }
        }
        blocks
    }

    /// Returns the text without code blocks.
    fn prose(&self) -> String {
        let parts = self.text.split("\n```");
        parts.step_by(2).collect::<Vec<_>>().join("\n")
    }

    /// Returns the anchors of the headings, as GitHub and mdBook make them.
    fn anchors(&self) -> BTreeSet<String> {
        let prose = self.prose();
        let headings = prose.lines().filter(|line| line.starts_with('#'));
        headings
            .map(|line| {
                let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
                let title = line.trim_start_matches('#').trim().to_lowercase();
                title.chars().filter(kept).map(|c| if c == ' ' { '-' } else { c }).collect()
            })
            .collect()
    }

    /// Returns the targets of links to files of the repository.
    fn links(&self) -> Vec<String> {
        let prose = self.prose();
        let targets = prose.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
        targets
            .map(|(target, _)| target.to_owned())
            .filter(|target| !target.contains("://"))
            .collect()
    }
}

/// Returns all pages: those of the book, and those that stand beside what they describe.
fn pages() -> Vec<Page> {
    let mut folders = vec![PathBuf::from("docs"), PathBuf::from("policies")];
    let mut paths = ["README.md", "ARCHITECTURE.md", "CHANGELOG.md"].map(PathBuf::from).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root().join(&folder)).expect("a folder") {
            let path = folder.join(entry.expect("an entry").file_name());
            if root().join(&path).is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|end| end == "md") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    paths.iter().map(|path| Page::read(path)).collect()
}

#[test]
fn no_link_is_dead() {
    let mut dead = Vec::new();
    let mut links = 0;
    for page in pages() {
        for link in page.links() {
            links += 1;
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let folder = page.path.parent().expect("a folder");
            let target = if file.is_empty() { page.path.clone() } else { folder.join(file) };
            let good = root().join(&target).exists()
                && (anchor.is_empty() || Page::read(&target).anchors().contains(anchor));
            // The book has what is in `docs` only.
            let outside = page.path.starts_with("docs")
                && !fs::canonicalize(root().join(&target))
                    .is_ok_and(|path| path.starts_with(root().join("docs")));
            if !good || outside {
                dead.push(format!("{}: {link}", page.path.display()));
            }
        }
    }
    assert!(links > 100, "the scan finds links");
    assert!(dead.is_empty(), "{}", dead.join("\n"));
}

#[test]
fn the_book_has_every_page() {
    let listed: BTreeSet<PathBuf> = Page::read(Path::new("docs/SUMMARY.md"))
        .links()
        .iter()
        .map(|link| Path::new("docs").join(link))
        .collect();
    let written: BTreeSet<PathBuf> = pages()
        .into_iter()
        .map(|page| page.path)
        .filter(|path| path.starts_with("docs") && !path.ends_with("SUMMARY.md"))
        .collect();
    assert_eq!(listed, written);
}

#[test]
fn pages_name_every_experiment() {
    let [sweeps, status] = ["guide/sweeps.md", "results/status.md"]
        .map(|page| Page::read(&Path::new("docs").join(page)).text);
    for folder in ["paper", "ablations", "beyond"] {
        for entry in fs::read_dir(root().join("experiments").join(folder)).expect("a folder") {
            let name = entry.expect("an entry").file_name().into_string().expect("text");
            let file = format!("`experiments/{folder}/{name}`");
            assert!(status.contains(&file), "{file}: run scripts/experiment-status");
            // One line stands for all ablations.
            let listed = folder == "ablations" || sweeps.contains(&format!("`{name}`"));
            assert!(listed, "{file} is not in docs/guide/sweeps.md");
        }
    }
}

/// The table of scenarios has a row for each, with its numbers of agents, and each trained policy.
#[test]
fn the_table_of_scenarios_is_complete() {
    let page = Page::read(Path::new("docs/guide/scenarios.md")).text;
    let mut scenarios = 0;
    for entry in fs::read_dir(root().join("scenarios")).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|end| end == "xml") {
            let name = path.file_stem().and_then(|name| name.to_str()).expect("a name");
            let file = iwol_sumo::scenario::ScenarioFile::read(&path).expect("a scenario");
            let agents = &file.scenario.agents;
            let row = format!("| `{name}` | {}, {}, {} |", agents.min, agents.default, agents.max);
            assert!(page.contains(&row), "docs/guide/scenarios.md lacks `{row}`");
            scenarios += 1;
        }
    }
    assert!(scenarios >= 17, "the scan finds scenarios: {scenarios}");
    for entry in fs::read_dir(root().join("policies")).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().and_then(|name| name.to_str()).expect("a name");
        // The policy of the traffic junction belongs to a task without SUMO.
        if path.is_dir() && name != "traffic-junction-ex-iwol" {
            assert!(page.contains(&format!("`{name}`")), "docs/guide/scenarios.md lacks `{name}`");
        }
    }
}

/// Rows of tables that are copied from the report on four to 48 vehicles are as they stand there.
#[test]
fn tables_of_results_are_those_of_the_report() {
    let page = Page::read(Path::new("docs/results/README.md")).text;
    let report = Page::read(Path::new("results/scalability/report.md")).text;
    let begin = page.find("## Four to 48 vehicles").expect("the first section");
    let end = page.find("## Vehicles that steer").expect("the section after them");
    let mut rows = 0;
    for row in page[begin..end].lines().filter(|line| line.starts_with("| ")) {
        // Names come before numbers; the paper's values are in italics.
        let is_number = |cell: &&str| cell.starts_with(|c: char| c.is_ascii_digit() || c == '>');
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let Some(first) = cells.iter().position(is_number) else { continue };
        let has_interval = cells.iter().any(|cell| cell.contains('±') || cell.contains('['));
        if has_interval {
            rows += 1;
            let numbers = cells[first..].join(" | ");
            assert!(report.contains(&numbers), "results/scalability/report.md lacks `{numbers}`");
        }
    }
    assert!(rows >= 30, "the scan finds rows: {rows}");
}

/// Returns the help of a verb and of the verbs below it, as Markdown.
fn help(verbs: &[&str], page: &mut String) {
    let output = program().args(verbs).arg("--help").output().expect("it runs");
    let text = String::from_utf8(output.stdout).expect("text");
    let text: Vec<&str> = text.lines().map(str::trim_end).collect();
    let title = [&["iwol"], verbs].concat().join(" ");
    let shown = text.join("\n");
    write!(page, "\n## `{title}`\n\n```text\n{}\n```\n", shown.trim_end()).expect("a string");
    let below = text.iter().skip_while(|line| **line != "Commands:").skip(1);
    for line in below.take_while(|line| !line.is_empty()) {
        // The description of a verb may go on in lines that are indented further.
        if let Some(verb) = line.strip_prefix("  ").filter(|line| !line.starts_with(' ')) {
            let verb = verb.split_whitespace().next().expect("a verb");
            if verb != "help" {
                help(&[verbs, &[verb]].concat(), page);
            }
        }
    }
}

#[test]
fn the_page_on_the_command_line_is_what_the_program_says() {
    let mut page = String::from(
        "# Command line\n\nThis page is for everyone who looks up a flag: it has what `--help` of each verb prints. A test \
         makes it (`IWOL_UPDATE=1 cargo test --features libsumo command_line`); do not edit it.\n",
    );
    help(&[], &mut page);
    let path = root().join("docs/reference/command_line.md");
    if std::env::var_os("IWOL_UPDATE").is_some() {
        fs::write(&path, &page).expect("written");
    }
    let written = fs::read_to_string(&path).unwrap_or_default();
    assert!(written == page, "{} is out of date: run with IWOL_UPDATE=1", path.display());
}

/// Calls of `iwol` within sentences name verbs and flags that exist.
#[test]
fn calls_in_sentences_parse() {
    let mut calls = BTreeSet::new();
    for page in pages() {
        // The changelog and the lab notes speak of earlier versions as well.
        if page.path.starts_with("docs/lab") || page.path.ends_with("CHANGELOG.md") {
            continue;
        }
        let prose = page.prose().replace('\n', " ");
        let call = |code: &str| code.strip_prefix("iwol ").map(str::to_owned);
        calls.extend(prose.split('`').skip(1).step_by(2).filter_map(call));
    }
    assert!(calls.len() > 20, "the scan finds calls: {calls:?}");
    for call in calls {
        // The shell splits words. `--help` ends the call once all before it is read.
        let line = format!("\"$IWOL\" {} --help", call.split(" > ").next().expect("a call"));
        let output = Command::new("sh")
            .args(["-c", &line])
            .env("IWOL", env!("CARGO_BIN_EXE_iwol"))
            .output()
            .expect("it runs");
        assert!(output.status.success(), "`iwol {call}`: {}", said(&output));
    }
}

fn said(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes)).concat()
}

/// A copy of what commands in pages read, with folders on the `PATH` that hold `iwol` and stand-ins
/// for what builds and for windows.
struct Workplace {
    folder: tempfile::TempDir,
}

impl Workplace {
    fn new() -> Self {
        let place = Self { folder: tempfile::tempdir().expect("a folder") };
        let at = |name: &str| place.folder.path().join(name);
        fs::create_dir_all(at("bin")).expect("made");
        for (name, script) in [
            ("iwol", IWOL),
            ("make", "#!/bin/sh\n"),
            ("cargo", "#!/bin/sh\n"),
            ("sumo-gui", "#!/bin/sh\n"),
        ] {
            fs::write(at("bin").join(name), script).expect("written");
            let executable = fs::Permissions::from_mode(0o755);
            fs::set_permissions(at("bin").join(name), executable).expect("set");
        }
        for name in ["experiments", "policies", "presets"] {
            symlink(root().join(name), at(name)).expect("linked");
        }
        place.shell(&format!("cp -r {0}/scenarios {0}/sumo_nets .", root().display()));
        fs::write(at("map.osm"), MAP).expect("written");
        fs::copy(at("sumo_nets/parking_lot/parking_lot.net.xml"), at("town.net.xml"))
            .expect("copied");
        place
    }

    fn shell(&self, block: &str) {
        let path = std::env::var("PATH").expect("a path");
        let output = Command::new("sh")
            .args(["-euc", block])
            .current_dir(self.folder.path())
            .env("PATH", format!("{}:{path}", self.folder.path().join("bin").display()))
            .env("IWOL", env!("CARGO_BIN_EXE_iwol"))
            .output()
            .expect("it runs");
        assert!(output.status.success(), "{block}\n{}", said(&output));
    }
}

/// The example of a sweep file is one.
#[test]
fn the_sweep_file_of_the_guide_can_be_run() {
    let place = Workplace::new();
    let page = Page::read(&root().join("docs/guide/sweeps.md"));
    let file = place.folder.path().join("example.toml");
    fs::write(file, &page.blocks("toml")[0]).expect("written");
    place.shell("iwol sweep example.toml --dry-run | grep -q '15 cells'");
}

/// Runs the commands of each page in order, and several pages at the same time. Each page has a
/// folder of its own with the scenarios, experiments and policies of the repository. Pages that begin
/// with trained runs find them there.
#[test]
fn commands_of_pages_run() {
    let trained = Workplace::new();
    trained.shell(
        "iwol train --scenario scenarios/intersection.xml --algorithm im-iwol --out runs/demo",
    );
    let ran = AtomicUsize::new(0);
    let run = |page: Page| {
        let blocks = page.blocks("sh");
        if blocks.is_empty() {
            return;
        }
        let place = Workplace::new();
        place.shell(&format!("cp -r {}/runs .", trained.folder.path().display()));
        if !page.text.contains("iwol train --scenario scenarios/intersection.xml") {
            place.shell("mkdir -p runs/intersection/im-iwol");
            place.shell("cp -r runs/demo runs/intersection/im-iwol/seed_1");
        }
        for block in &blocks {
            place.shell(&format!("# {}\n{block}", page.path.display()));
        }
        ran.fetch_add(blocks.len(), Ordering::Relaxed);
    };
    in_parallel(pages(), run);
    let ran = ran.into_inner();
    assert!(ran > 20, "the scan finds blocks: {ran}");
}

//! Sweeps: a grid of settings. Each combination is a training run in its own folder, evaluated in
//! one or more ways.
//!
//! ```toml
//! title = "Success against the number of vehicles"
//! [settings]                              # of every run, as in `--config`
//! scenario = "scenarios/intersection.xml"
//! [grid]                                  # every combination is a cell
//! algorithm = ["im-iwol", "mappo"]
//! agents = [4, 8]
//! seed = [0, 1, 2]
//! [[rule]]                                # settings of the cells that match
//! when = { agents = [32, 48] }
//! set = { "train.envs" = 8 }
//! [[skip]]                                # combinations that are no cells
//! when = { agents = 4, seed = 2 }
//! [[evaluate]]                            # an evaluation of each policy, for each combination
//! name = "range"
//! episodes = 200
//! grid = { "env.communication_range" = [100.0, 10.0] }
//! ```
//!
//! A file may name another file as its `base` and then contains only what differs from it.
//!
//! The progress of a sweep follows only from the files in the cells' folders, so that a sweep can
//! be interrupted at any moment, divided over machines, and continued.

mod base;
mod cell;
mod error;
mod file;

use std::path::Path;

use serde::Deserialize;
use toml::{Table, Value};

pub use cell::{Cell, Job, State};
pub use error::Error;

use file::File;

pub use crate::config::plain;

/// A sweep file.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// Name of the sweep: the file name without its extension.
    pub name: String,
    /// Title of the report.
    pub title: String,
    /// Keys of the grid, in the file's order, each with its number of values.
    pub keys: Vec<(String, usize)>,
    /// The cells. Seeds vary slowest, so that an interrupted sweep has complete rows for its first
    /// seeds.
    pub cells: Vec<Cell>,
    /// Evaluations of each trained policy.
    pub evaluations: Vec<Evaluate>,
    /// Published values to compare with.
    pub references: Vec<Reference>,
}

/// One way of evaluating the policy of each cell.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evaluate {
    /// Name, in file names and headings.
    #[serde(default = "Evaluate::default_name")]
    pub name: String,
    /// Heading in the report.
    #[serde(default)]
    pub title: String,
    /// Number of episodes, the same for all cells and combinations.
    #[serde(default = "Evaluate::default_episodes")]
    pub episodes: u64,
    /// Which checkpoint is evaluated: the last one, or the one with the best validation.
    #[serde(default)]
    pub checkpoint: Which,
    /// Settings of the task and of the policy that differ from training. Each combination is a
    /// separate evaluation.
    #[serde(default)]
    pub grid: Table,
    /// Selects the cells that are evaluated: those with these values, or with one of a list of
    /// values [default: all].
    #[serde(default)]
    pub when: Table,
    /// The key along the horizontal axis of the figure [default: the only key of this grid, or
    /// `agents`].
    #[serde(default)]
    pub x: Option<String>,
    /// A key whose values each get their own panel in the figure, which then shows only success.
    #[serde(default)]
    pub panels: Option<String>,
}

impl Evaluate {
    fn default_name() -> String {
        "evaluation".to_owned()
    }

    fn default_episodes() -> u64 {
        200
    }

    /// Returns whether this evaluation applies to a cell.
    pub fn applies(&self, cell: &Cell) -> bool {
        holds(&self.when, |key| cell.value(key))
    }

    /// Returns the combinations of this grid, each a list of keys and values; a single empty
    /// combination without a grid.
    pub fn combinations(&self) -> Vec<Vec<(String, Value)>> {
        combinations(&self.grid)
    }

    /// Returns a combination as values of `--set`.
    pub fn sets(&self, combination: &[(String, Value)]) -> Vec<String> {
        combination.iter().map(|(key, value)| format!("{key}={}", plain(value))).collect()
    }
}

/// Which checkpoint is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Which {
    /// The checkpoint at the end of training.
    #[default]
    Last,
    /// The checkpoint with the best validation.
    Best,
}

impl Which {
    /// Returns the file name of the checkpoint.
    pub fn file(self) -> &'static str {
        match self {
            Self::Last => "last.safetensors",
            Self::Best => "best.safetensors",
        }
    }
}

/// Published values, drawn and tabulated beside those of the sweep.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Name in legend and table.
    pub label: String,
    /// Label of the series of this sweep with which the values are compared; they are drawn in its
    /// colour.
    #[serde(default)]
    pub beside: String,
    /// Metric, as in the JSON of `iwol evaluate`.
    pub metric: String,
    /// Values along the horizontal axis; empty if the evaluation has no axis.
    #[serde(default)]
    pub x: Vec<f64>,
    /// The published values at `x`, in the metric's unit (rates from 0 to 1).
    pub y: Vec<f64>,
    /// Name of the evaluation to which the values belong [default: the first].
    #[serde(default)]
    pub evaluate: Option<String>,
}

impl Sweep {
    /// Reads a sweep file and resolves every cell. The run folders lie below `out`.
    ///
    /// # Errors
    /// An [`Error`] that names file, cell and key.
    pub fn load(path: &Path, out: &Path) -> Result<Self, Error> {
        let text = base::read(path)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self::parse(&text, &path.display().to_string(), &name, out)
    }

    /// Does the same as [`Sweep::load`] for a given text. Messages call the text `file`; the path
    /// of its base is relative to the folder of `file`.
    ///
    /// # Errors
    /// See [`Sweep::load`].
    pub fn parse(text: &str, file: &str, name: &str, out: &Path) -> Result<Self, Error> {
        let parsed = File::read(text, file)?;
        let cells = parsed.cells(file, &out.join(name))?;
        let count = |value: &Value| value.as_array().map_or(1, Vec::len);
        Ok(Self {
            name: name.to_owned(),
            title: if parsed.title.is_empty() { name.to_owned() } else { parsed.title },
            keys: parsed.grid.iter().map(|(key, value)| (key.clone(), count(value))).collect(),
            cells,
            evaluations: parsed.evaluate,
            references: parsed.reference,
        })
    }

    /// Returns the cell that must be trained before this one; `None` if there is none or it is
    /// trained.
    pub fn waits_for(&self, cell: &Cell) -> Option<&Cell> {
        let first = self.cells.iter().find(|other| cell.after.as_ref() == Some(&other.id))?;
        (cell.trained().is_none() && first.trained().is_none()).then_some(first)
    }
}

/// Returns whether every key has the wanted value, or one of a list of wanted values.
fn holds<'a>(when: &Table, value: impl Fn(&str) -> Option<&'a Value>) -> bool {
    when.iter().all(|(key, wanted)| {
        value(key)
            .is_some_and(|own| wanted.as_array().map_or(own == wanted, |any| any.contains(own)))
    })
}

fn value_of<'a>(values: &'a [(String, Value)], key: &str) -> Option<&'a Value> {
    values.iter().find(|(own, _)| own == key).map(|(_, value)| value)
}

/// Returns all combinations of a grid's values; the last key varies fastest.
fn combinations(grid: &Table) -> Vec<Vec<(String, Value)>> {
    let mut all = vec![Vec::new()];
    for (key, values) in grid {
        let values = values.as_array().map_or(&[][..], Vec::as_slice);
        all = all
            .into_iter()
            .flat_map(|chosen: Vec<(String, Value)>| {
                values
                    .iter()
                    .map(move |value| [&chosen[..], &[(key.clone(), value.clone())]].concat())
            })
            .collect();
    }
    all
}

/// Returns `key=value` pairs joined by `_`, fit for a file name, with the last part of each key; of
/// the algorithm only the value.
fn label(values: &[(String, Value)]) -> String {
    let safe = |text: String| {
        text.chars()
            .map(|c| if c.is_alphanumeric() || "-.+=".contains(c) { c } else { '-' })
            .collect::<String>()
    };
    let part = |(key, value): &(String, Value)| {
        let value = safe(plain(value));
        if key == "algorithm" {
            value
        } else {
            format!("{}={value}", key.rsplit('.').next().unwrap_or(key))
        }
    };
    values.iter().map(part).collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    const FILE: &str = r#"
        [settings]
        scenario = "scenarios/intersection.xml"
        steps = 4096
        [settings.train]
        envs = 4
        [grid]
        algorithm = ["im-iwol", "mappo"]
        agents = [4, 8]
        seed = [0, 1]
        [[rule]]
        when = { agents = [8, 16], algorithm = "mappo" }
        set = { "train.envs" = 2, ppo = { gamma = 0.9 }, agents = 48 }
        [[evaluate]]
        name = "range"
        grid = { "env.communication_range" = [100.0, 10.0] }
    "#;

    fn parse(text: &str) -> Result<Sweep, Error> {
        Sweep::parse(text, "s.toml", "s", Path::new("out"))
    }

    #[test]
    fn a_grid_becomes_cells_in_the_order_of_seeds() {
        let sweep = parse(FILE).unwrap();
        let ids: Vec<&str> = sweep.cells.iter().map(|cell| cell.id.as_str()).collect();
        assert_eq!(
            ids[..5],
            [
                "im-iwol_agents=4/seed_0",
                "im-iwol_agents=8/seed_0",
                "mappo_agents=4/seed_0",
                "mappo_agents=8/seed_0",
                "im-iwol_agents=4/seed_1"
            ]
        );
        assert_eq!(ids.len(), 8);
        assert_eq!(sweep.cells[0].folder, Path::new("out/s/im-iwol_agents=4/seed_0"));
        assert_eq!(sweep.evaluations[0].combinations().len(), 2);
    }

    #[test]
    fn rules_set_what_the_grid_does_not() {
        let sweep = parse(FILE).unwrap();
        let of = |id: &str| &sweep.cells.iter().find(|cell| cell.id == id).unwrap().config;
        let (ruled, free) = (of("mappo_agents=8/seed_1"), of("mappo_agents=4/seed_1"));
        assert_eq!((ruled.train.envs, ruled.ppo.gamma, ruled.agents), (2, 0.9, 8));
        assert_eq!((free.train.envs, free.agents), (4, 4));
    }

    #[test]
    fn a_cell_may_begin_with_the_policy_of_another() {
        let with =
            |change: &str| FILE.replace("agents = 48 }", &format!("init_from = {{ {change} }} }}"));
        let sweep = parse(&with("agents = 4")).unwrap();
        let after: Vec<_> = sweep
            .cells
            .iter()
            .filter_map(|cell| Some((cell.id.as_str(), cell.after.as_deref()?)))
            .collect();
        let expected = [0, 1].map(|seed| {
            (format!("mappo_agents=8/seed_{seed}"), format!("mappo_agents=4/seed_{seed}"))
        });
        assert_eq!(after, expected.each_ref().map(|(cell, first)| (cell.as_str(), first.as_str())));
        for cell in &sweep.cells {
            let first = sweep.cells.iter().find(|other| cell.after.as_ref() == Some(&other.id));
            let path = first.map_or_else(PathBuf::new, |first| first.folder.clone());
            assert_eq!(cell.config.init_from, path);
            assert_eq!(
                sweep.waits_for(cell).map(|first| &first.id),
                cell.after.as_ref(),
                "nothing is trained"
            );
        }
        let refused = |change: &str| parse(&with(change)).expect_err("must be refused").to_string();
        assert!(
            refused("agents = 5").contains("init_from = { agents = 5 }: the grid has no such cell")
        );
        assert!(refused("steps = 1").contains("the grid has no such cell"));
        assert!(refused("agents = 8").contains("names the cell itself"));
        let grid = FILE.replace("agents = [4, 8]", "agents = [8]\n\"ppo.gamma\" = [0.9, 0.99]");
        let grid = grid.replace("ppo = { gamma = 0.9 }, agents = 48", "steps = 8");
        let rule = "[[rule]]\nwhen = { \"ppo.gamma\" = 0.99 }\nset = { init_from = { \"ppo.gamma\" = 0.9 } }";
        let sweep = parse(&format!("{grid}\n{rule}")).unwrap();
        let begins =
            |id: &str| sweep.cells.iter().find(|cell| cell.id == id).unwrap().after.as_deref();
        assert_eq!(
            begins("mappo_agents=8_gamma=0.99/seed_0"),
            Some("mappo_agents=8_gamma=0.9/seed_0")
        );
        let back = format!(
            "{}\n[[rule]]\nwhen = {{ agents = 4 }}\nset = {{ init_from = {{ agents = 8 }} }}",
            with("agents = 4")
        );
        let circle = parse(&back).expect_err("must be refused").to_string();
        assert!(circle.contains("init_from forms a cycle"), "{circle}");
    }

    #[test]
    fn cells_may_be_left_out_and_evaluated_by_choice() {
        let with = |lines: &str| parse(&FILE.replace("name = \"range\"", lines));
        let sweep =
            with("name = \"range\"\nwhen = { algorithm = \"mappo\", agents = [4, 5] }").unwrap();
        let applies: Vec<&str> = (sweep.cells.iter())
            .filter(|cell| sweep.evaluations[0].applies(cell))
            .map(|cell| cell.id.as_str())
            .collect();
        assert_eq!(applies, ["mappo_agents=4/seed_0", "mappo_agents=4/seed_1"]);
        let message = with("when = { agents = 5 }").expect_err("must be refused").to_string();
        assert!(message.contains("[[evaluate]] `evaluation`: no cell has agents = 5"), "{message}");

        let skip = |when: &str| {
            parse(&FILE.replace("[[rule]]", &format!("[[skip]]\nwhen = {{ {when} }}\n[[rule]]")))
        };
        let ids: Vec<String> = skip("agents = 8, seed = [1, 2]")
            .unwrap()
            .cells
            .into_iter()
            .map(|cell| cell.id)
            .collect();
        assert_eq!(ids.len(), 6);
        assert!(
            !ids.contains(&"mappo_agents=8/seed_1".to_owned())
                && ids.contains(&"mappo_agents=8/seed_0".to_owned())
        );
        let message = skip("agents = 5").expect_err("must be refused").to_string();
        assert!(message.contains("[[skip]]: no combination has agents = 5"), "{message}");
        let chain = FILE.replace("agents = 48 }", "init_from = { agents = 4 } }");
        let broken =
            chain.replace("[[rule]]", "[[skip]]\nwhen = { agents = 4, seed = 1 }\n[[rule]]");
        let message = parse(&broken).expect_err("must be refused").to_string();
        assert!(message.contains("a [[skip]] removes the cell mappo_agents=4/seed_1"), "{message}");
    }

    #[test]
    fn a_run_of_a_scenario_that_has_changed_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).unwrap();
        let cell = &sweep.cells[0];
        std::fs::create_dir_all(&cell.folder).unwrap();
        std::fs::write(cell.run().config(), cell.config.to_toml()).unwrap();
        cell.mark_trained().unwrap();
        let check = |meta: &str| {
            std::fs::write(cell.run().meta(), meta).unwrap();
            cell.check()
        };
        check("{}").expect("older runs do not say");
        check(&format!("{{\"scenario\": \"{}\"}}", cell.fingerprint)).expect("the same");
        assert!(matches!(check("{\"scenario\": \"0\"}"), Err(Error::Scenario { .. })));
    }

    #[test]
    fn what_is_kept_replaces_no_run() {
        let folder = tempfile::tempdir().unwrap();
        let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).unwrap();
        let cell = &sweep.cells[0];
        std::fs::create_dir_all(cell.folder.join("checkpoints")).unwrap();
        std::fs::write(cell.run().last(), "weights").unwrap();
        cell.mark_trained().unwrap();
        assert!(matches!(cell.keep(folder.path(), "s"), Err(Error::Kept { .. })));
    }

    /// Combinations of policy and evaluation that cannot work are refused when the file is read,
    /// before hours of training.
    #[test]
    fn what_cannot_be_done_with_a_policy_is_refused_before_it_is_trained() {
        let with = |algorithms: &str, grid: &str| {
            let file = FILE
                .replace("[\"im-iwol\", \"mappo\"]", algorithms)
                .replace("agents = 48", "steps = 8");
            parse(&file.replace("\"env.communication_range\" = [100.0, 10.0]", grid))
                .map_err(|error| error.to_string())
        };
        let refused = |algorithms: &str, grid: &str, why: &str| {
            let error = with(algorithms, grid).expect_err("must be refused");
            assert!(error.contains(why), "{error}");
        };
        let (many, lost) = ("agents = [4, 6]", "\"channel.loss\" = [0.0, 0.5]");
        refused(
            "[\"mappo\", \"commformer\"]",
            many,
            "`range`, cell commformer_agents=4/seed_0: commformer has parameters",
        );
        refused(
            "[\"mappo\", \"mat\"]",
            lost,
            "cell mat_agents=4/seed_0: [channel] applies to messages",
        );
        refused(
            "[\"mappo\"]",
            "seed = [7, 8]",
            "seed=7: has no effect in an evaluation: --seed determines the episodes",
        );
        refused("[\"mappo\"]", "algorithm = [\"mat\"]", "the checkpoint determines the algorithm");
        assert!(
            with("[\"mappo\", \"magic\"]", many).is_ok()
                && with("[\"mappo\", \"magic\", \"ex-iwol\"]", lost).is_ok()
        );
        let rule = |algorithms: &str, change: &str| {
            let file = FILE.replace("[\"im-iwol\", \"mappo\"]", algorithms);
            parse(&file.replace("agents = 48 }", &format!("init_from = {{ {change} }} }}")))
                .map_err(|e| e.to_string())
        };
        let other = rule("[\"im-iwol\", \"mappo\"]", "algorithm = \"im-iwol\"")
            .expect_err("must be refused");
        assert!(
            other.contains("im-iwol_agents=8/seed_0 trains im-iwol, which has other networks"),
            "{other}"
        );
        let file = FILE
            .replace("\"mappo\"", "\"commformer\"")
            .replace("agents = 48 }", "init_from = { agents = 4 } }");
        let fixed = parse(&file).expect_err("must be refused").to_string();
        assert!(fixed.contains("each of 4 agents and cannot be used with 8"), "{fixed}");
        let disturbed =
            parse(&FILE.replace("steps = 4096", "steps = 4096\nchannel = { loss = 0.5 }"))
                .expect_err("refused");
        assert!(
            disturbed.to_string().contains("[channel] applies only to evaluation"),
            "{disturbed}"
        );
    }

    #[test]
    fn mistakes_are_named() {
        let message = |change: (&str, &str)| {
            let error = parse(&FILE.replace(change.0, change.1)).expect_err("must be refused");
            let source =
                std::error::Error::source(&error).map(|e| format!(": {e}")).unwrap_or_default();
            format!("{error}{source}")
        };
        assert!(message(("[grid]", "[gird]")).contains("unknown field `gird`"));
        assert!(message(("seed = [0, 1]", "seed = 0")).contains("[grid] seed: give a list"), "");
        let unknown = message(("steps = 4096", "stepz = 4096"));
        assert!(
            unknown.contains("did you mean `steps`")
                && unknown.contains("cell im-iwol_agents=4/seed_0: its settings: "),
            "{unknown}"
        );
        assert_eq!(unknown.matches("seed_0").count(), 1, "the cell is named twice: {unknown}");
        assert!(
            message(("[grid]\n", "[settings.train.more]\n"))
                .contains("there is no [grid]; give it a list")
        );
        assert!(message(("seed = [0, 1]", "seed = [1, 1]")).contains("two cells are called"));
        assert!(message(("name = \"range\"", "episodes = 0")).contains("1 or more episodes"));
        assert!(message(("\"mappo\"]", "\"mapo\"]")).contains("did you mean `mappo`"));
        assert!(
            message(("agents = [8, 16]", "agents = [16]"))
                .contains("[[rule]] number 1: no cell has agents = [16]")
        );
        assert!(
            message(("env.communication_range", "env.comunication_range")).contains("did you mean")
        );
        assert!(
            message(("name = \"range\"", "panels = \"agent\""))
                .contains("panels = \"agent\" must be a key with several values")
        );
        assert!(
            message(("name = \"range\"", "x = \"agents\"\npanels = \"agents\""))
                .contains("x and panels must differ")
        );
        assert!(
            message(("[[rule]]", "[[skip]]\nwhen = { seed = [0, 1] }\n[[rule]]"))
                .contains("leaves no cell")
        );
    }
}

//! Tests of reports that are made from hand-written results: the intervals that tables name, and
//! the provenance of results.

use std::path::Path;

use iwol_sumo::plot::Format;
use iwol_sumo::report;
use iwol_sumo::sweep::{Cell, Sweep};
use serde_json::{Value, json};

use crate::support::folder;

const FILE: &str = r#"
title = "Hand-written"
[settings]
scenario = "scenarios/intersection.xml"
steps = 4096
[grid]
algorithm = ["im-iwol", "mappo", "magic"]
agents = [4, 8]
seed = [0, 1, 2]
[[skip]]
when = { algorithm = "magic", seed = [1, 2] }
[[evaluate]]
name = "last"
episodes = 100
"#;

/// Returns an estimate as `iwol evaluate` writes it.
fn estimate(mean: f64, low: f64, high: f64) -> Value {
    json!({ "mean": mean, "low": low, "high": high })
}

/// Writes files as if every cell were trained and evaluated; `success` gives the mean of each cell.
fn results(sweep: &Sweep, success: impl Fn(&Cell) -> f64, run: impl Fn(&Cell) -> Value) {
    for cell in &sweep.cells {
        std::fs::create_dir_all(cell.folder.join("evaluations")).expect("a folder");
        let write =
            |name: &str, text: &str| std::fs::write(cell.folder.join(name), text).expect("written");
        write("trained.json", r#"{"steps": 4096, "seconds": 60.0}"#);
        let rate = success(cell);
        let validation =
            json!({ "step": 64, "validation/success": rate / 2.0, "time/total_s": 1.0 });
        write("metrics.jsonl", &format!("{validation}\n"));
        write("config.toml", &cell.config.to_toml());
        let crashes = ((1.0 - rate) * 1000.0).round() as u64;
        let found = json!({
            "episodes": 100, "checkpoint": "last.safetensors", "seed": 0, "run": run(cell),
            "policy": cell.config.algorithm,
            "program": { "version": "0.4.0", "commit": "unknown", "sumo": "1.20.0" },
            "metrics": {
                "success": estimate(rate, rate - 0.03, (rate + 0.01).min(1.0)),
                "safety": estimate(rate, rate - 0.03, (rate + 0.01).min(1.0)),
                "window_reward": estimate(600.0 + rate, 590.0, 610.0),
                "loitering": estimate(0.01, 0.0, 0.02),
                "km_per_crash": { "km": 40.0, "crashes": crashes, "mean": null, "low": 10.0, "high": null },
                "reconstruction": [{
                    "name": "world", "error": 0.01, "explained": 0.93,
                    "probe": {
                        "samples": 5000, "features": 60, "explained": 0.9, "undetermined": 20,
                        "undetermined_explained": 0.4 + 0.1 * f64::from(u8::from(cell.config.seed == 1)),
                        "undetermined_probe_explained": 0.3,
                    },
                }],
            },
        });
        let evaluate = &sweep.evaluations[0];
        for combination in evaluate.combinations() {
            let mut found = found.clone();
            found["set"] = json!(evaluate.sets(&combination));
            let file = cell.result(evaluate, &combination);
            std::fs::write(file, found.to_string()).expect("written");
        }
    }
}

/// Returns the report in Markdown, and `summary.json`.
fn report(sweep: &Sweep, folder: &Path) -> (String, Value) {
    let out = folder.join("report");
    report::write(sweep, "iwol report", &out, Format::Png).expect("a report");
    let read = |name: &str| std::fs::read_to_string(out.join(name)).expect("written");
    (read("report.md"), serde_json::from_str(&read("summary.json")).expect("JSON"))
}

/// Returns the tables of a report as rows of cells; the header comes first.
fn tables(markdown: &str) -> Vec<Vec<Vec<String>>> {
    let mut tables: Vec<Vec<Vec<String>>> = vec![Vec::new()];
    for line in markdown.lines() {
        if !line.starts_with('|') {
            tables.push(Vec::new());
        } else if !line.starts_with("|---") {
            let cells = line.trim_matches('|').split(" | ").map(|cell| cell.trim().to_owned());
            tables.last_mut().expect("one is open").push(cells.collect());
        }
    }
    tables.retain(|table| !table.is_empty());
    tables
}

#[test]
fn figures_of_a_report_can_be_svg() {
    let folder = folder();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).expect("a sweep");
    results(&sweep, |_| 0.9, |_| Value::Null);
    let out = folder.path().join("report");
    let written = report::write(&sweep, "iwol report", &out, Format::Svg).expect("a report");
    let figures: Vec<_> =
        written.iter().filter(|path| path.extension().is_some_and(|end| end == "svg")).collect();
    assert!(figures.len() > 1 && !written.iter().any(|path| path.ends_with(".png")), "{written:?}");
    for figure in figures {
        let text = std::fs::read_to_string(figure).expect("written");
        roxmltree::Document::parse(&text).expect("XML");
    }
    let page = std::fs::read_to_string(out.join("report.html")).expect("written");
    assert!(page.contains("data:image/svg+xml;base64,") && !page.contains("image/png"));
}

#[test]
fn every_table_has_one_unit_of_interval_and_names_it() {
    let folder = folder();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).expect("a sweep");
    // All seeds of MAPPO with 4 agents have the same result, those of Im-IWoL differ, and MAGIC has
    // one seed.
    let success = |cell: &Cell| match (cell.config.algorithm.as_str(), cell.config.agents) {
        ("mappo", 4) => 1.0,
        _ => 0.9 + 0.02 * cell.config.seed as f64,
    };
    results(&sweep, success, |_| Value::Null);
    let (markdown, _) = report(&sweep, folder.path());
    let tables = tables(&markdown);
    for table in tables.iter().filter(|table| table[0][0].starts_with("success %")) {
        let cells: Vec<&String> = table[1..].iter().flat_map(|row| &row[1..]).collect();
        let (over_seeds, brackets) = (
            cells.iter().any(|cell| cell.contains('±')),
            cells.iter().any(|cell| cell.contains('[')),
        );
        assert!(!(over_seeds && brackets), "two units of interval in one table: {table:?}");
        let named =
            ["over seeds", "over the episodes, which all runs play", "episodes of a single run"];
        assert_eq!(
            named.iter().filter(|unit| table[0][0].contains(*unit)).count(),
            1,
            "{:?}",
            table[0]
        );
    }
    let titled = |part: &str| {
        let mut found = tables
            .iter()
            .filter(|table| table[0][0].starts_with("success %") && table[0][0].contains(part));
        found.next().unwrap_or_else(|| panic!("no table of success {part} in {markdown}"))
    };
    let row = |table: &[Vec<String>], name: &str| table.iter().find(|row| row[0] == name).cloned();
    // If all seeds have the same result, the interval over seeds is a point; a separate table gives
    // the interval over episodes.
    let seeds = titled("over seeds");
    assert_eq!(row(seeds, "mappo").expect("a row")[1..], ["100.0 ± 0.0", "92.0 ± 5.0"]);
    assert_eq!(row(seeds, "im-iwol").expect("a row")[1], "92.0 ± 5.0");
    assert_eq!(row(seeds, "magic"), None, "one seed says nothing about others");
    // Wilson's lower bound for 100 episodes that all succeed is 100 / (100 + 1.96²). The three runs
    // are evaluated in the same 100 episodes.
    let pooled = row(titled("which all runs play"), "mappo").expect("a row");
    assert_eq!(
        pooled[1],
        format!("100.0 [{:.1}, 100.0]", 100.0 * 100.0 / (100.0 + 1.959_964_f64.powi(2)))
    );
    let alone = titled("episodes of a single run");
    assert_eq!(alone.len(), 2, "MAGIC alone: {alone:?}");
    assert_eq!(row(alone, "magic").expect("a row")[1], "90.0 [87.0, 91.0]");
}

/// Returns the provenance that the cells of the test were trained with.
fn trained_with() -> Value {
    json!({
        "version": "0.3.0", "commit": "0123456789abcdef0123456789abcdef01234567", "dirty": false, "sumo": "1.18.0",
        "libtorch": "2.13.0",
    })
}

#[test]
fn results_name_versions_and_commits() {
    let folder = folder();
    let sweep = Sweep::parse(FILE, "s.toml", "s", &folder.path().join("runs")).expect("a sweep");
    results(&sweep, |_| 0.9, |_| trained_with());
    // One run was resumed by another version.
    let resumed =
        sweep.cells.iter().find(|cell| cell.id == "mappo_agents=8/seed_1").expect("a cell");
    let mut meta = trained_with();
    (meta["version"], meta["earlier"]) =
        ("0.3.1".into(), json!([{ "version": "0.3.0", "sumo": "1.15.0" }]));
    std::fs::write(resumed.run().meta(), meta.to_string()).expect("written");
    let (markdown, summary) = report(&sweep, folder.path());
    for row in [
        "| im-iwol_agents=4 | 3 | 4096 | 1.0 ± 0.0 | 68 | 0.3.0 (0123456789) | 1.18.0 |",
        "| mappo_agents=8 | 3 | 4096 | 1.0 ± 0.0 | 68 | 0.3.0 (0123456789); 0.3.0; 0.3.1 (0123456789) | 1.18.0; 1.15.0 |",
    ] {
        assert!(markdown.contains(row), "{row} is missing in {markdown}");
    }
    assert!(markdown.contains("Evaluated by iwol 0.4.0 with SUMO 1.20.0."), "{markdown}");
    let rows = summary["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 14);
    for row in rows {
        assert!(row["run"]["version"].is_string() && row["run"]["commit"].is_string(), "{row}");
        assert_eq!(row["run"]["sumo"], "1.18.0");
        assert_eq!(row["program"]["version"], "0.4.0");
    }

    // The files that are kept without weights include the versions.
    let kept = folder.path().join("kept");
    resumed.keep(&kept, "s").expect("copied");
    let again = Sweep::parse(FILE, "s.toml", "s", &kept).expect("a sweep");
    let copy = again.cells.iter().find(|cell| cell.id == resumed.id).expect("a cell");
    assert_eq!(copy.run().training(), resumed.run().training());
}

#[test]
fn kilometres_and_knowledge_have_tables() {
    let folder = folder();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).expect("a sweep");
    let success = |cell: &Cell| match cell.config.algorithm.as_str() {
        "mappo" => 1.0,
        _ => 0.9 + 0.02 * cell.config.seed as f64,
    };
    results(&sweep, success, |_| Value::Null);
    let (markdown, _) = report(&sweep, folder.path());
    for part in [
        // Several runs may have different rates, so that there is no interval; without a crash
        // there is only a lower bound.
        "| im-iwol | 0.50 (100, 80, 60 in 120.0 km) | 0.50 (100, 80, 60 in 120.0 km) |",
        "| mappo | > 32.53 (0, 0, 0 in 120.0 km) | > 32.53 (0, 0, 0 in 120.0 km) |",
        "| magic | 0.40 [0.33, 0.49] (100 in 40.0 km) | 0.40 [0.33, 0.49] (100 in 40.0 km) |",
        "| explained variance of the world, % (± t-interval over seeds) |",
        "| im-iwol, 4 | 93.0 ± 0.0 | 90.0 ± 0.0 | 20 of 60 | 43.3 ± 14.3 | 30.0 ± 0.0 |",
        "| magic, 8 | 93.0 | 90.0 | 20 of 60 | 40.0 | 30.0 |",
        "| loitering % at agents (± t-interval over seeds) | 4 | 8 |",
    ] {
        assert!(markdown.contains(part), "{part} is missing in {markdown}");
    }
    assert!(!markdown.contains("variance of the interaction"), "{markdown}");

    // Where a run is missing, every table says so.
    let lost =
        sweep.cells.iter().find(|cell| cell.id == "im-iwol_agents=4/seed_1").expect("a cell");
    std::fs::remove_file(lost.result(&sweep.evaluations[0], &[])).expect("removed");
    let (markdown, _) = report(&sweep, folder.path());
    for part in
        ["| im-iwol | 0.50 (100, 60 in 80.0 km) (2 of 3) |", "| im-iwol, 4 (2 of 3) | 93.0 ± 0.0 |"]
    {
        assert!(markdown.contains(part), "{part} is missing in {markdown}");
    }
}

#[test]
fn published_values_stand_beside_a_series_that_exists() {
    let folder = folder();
    let of = |beside: &str| {
        let reference = format!(
            "[[reference]]\nlabel = \"paper\"\nbeside = \"{beside}\"\nmetric = \"success\"\nx = [4]\ny = [0.5]"
        );
        let text = format!("{FILE}\n{reference}");
        let sweep = Sweep::parse(&text, "s.toml", "s", folder.path()).expect("a sweep");
        results(&sweep, |_| 0.9, |_| Value::Null);
        report::write(&sweep, "iwol report", &folder.path().join("report"), Format::Png)
    };
    of("magic").expect("a report");
    assert_eq!(
        of("magik").expect_err("refused").to_string(),
        "[[reference]] `paper`: beside = \"magik\" must be one of `im-iwol`, `mappo`, `magic`"
    );
    // The lines of an evaluation with a grid of its own have longer names than those of the
    // learning curves.
    let text = r#"
        [settings]
        scenario = "scenarios/intersection.xml"
        steps = 4096
        [grid]
        algorithm = ["mappo"]
        "scenario.reward.time" = [0.0, 0.2]
        [[evaluate]]
        name = "last"
        episodes = 100
        grid = { "scenario.reward.time" = [0.0] }
        [[reference]]
        label = "paper"
        beside = "mappo, trained with reward time 0.2"
        metric = "success"
        x = [0.0]
        y = [0.5]
    "#;
    let sweep = Sweep::parse(text, "s.toml", "t", folder.path()).expect("a sweep");
    results(&sweep, |_| 0.9, |_| Value::Null);
    let out = folder.path().join("report");
    report::write(&sweep, "iwol report", &out, Format::Png).expect("a report");
}

#[test]
fn comparisons_are_made_as_the_file_names_them() {
    let folder = folder();
    let few = "seed = [0, 1, 2]";
    let five = "seed = [0, 1, 2, 3, 4]";
    let file = FILE.replace(few, five).replace("seed = [1, 2]", "seed = [1, 2, 3, 4]");
    let text = format!(
        r#"{file}
[[contrast]]
title = "Im-IWoL against MAPPO among 4"
metric = "success"
plus = [{{ algorithm = "im-iwol", agents = 4 }}]
minus = [{{ algorithm = "mappo", agents = 4 }}]
[[contrast]]
title = "is it more among 8?"
metric = "success"
plus = [{{ algorithm = "im-iwol", agents = 8 }}, {{ algorithm = "mappo", agents = 4 }}]
minus = [{{ algorithm = "mappo", agents = 8 }}, {{ algorithm = "im-iwol", agents = 4 }}]
[[contrast]]
title = "who learns sooner"
metric = "success"
of = "training"
plus = [{{ algorithm = "im-iwol", agents = 4 }}]
minus = [{{ algorithm = "mappo", agents = 4 }}]
[[contrast]]
title = "a run without a value"
metric = "loitering"
plus = [{{ algorithm = "im-iwol", agents = 4 }}]
minus = [{{ algorithm = "mappo", agents = 4 }}]
"#
    );
    let sweep = Sweep::parse(&text, "s.toml", "s", folder.path()).expect("a sweep");
    // Among 4, the methods differ by 30 points, among 8 by 50.
    let success = |cell: &Cell| {
        let gain = if cell.config.agents == 4 { 0.3 } else { 0.5 };
        let own = if cell.config.algorithm == "im-iwol" { 0.4 + gain } else { 0.4 };
        own + 0.01 * cell.config.seed as f64
    };
    results(&sweep, success, |_| Value::Null);
    // One run lacks a metric.
    let (cell, evaluate) = (&sweep.cells[0], &sweep.evaluations[0]);
    assert_eq!(cell.id, "im-iwol_agents=4/seed_0");
    let file = cell.result(evaluate, &[]);
    let mut found: Value =
        serde_json::from_str(&std::fs::read_to_string(&file).expect("written")).expect("JSON");
    found["metrics"].as_object_mut().expect("an object").remove("loitering");
    std::fs::write(&file, found.to_string()).expect("written");
    let (markdown, _) = report(&sweep, folder.path());
    let tables = tables(&markdown);
    let table = tables.iter().find(|table| table[0][0] == "comparison").expect("a table");
    let [_, first, second, sooner, lacking] = &table[..] else { panic!("{table:?}") };
    assert_eq!(lacking[2..], ["5 (1 without a value), 5", "–", "–", "–"]);
    // The permutation test of two groups of five has p = 4/252 at least. Holm's correction is for all
    // four, made or not.
    assert_eq!(first[5], "0.063", "{first:?}");
    assert_eq!(first[..3], ["Im-IWoL against MAPPO among 4", "success %", "5, 5"], "{first:?}");
    assert!(first[3].starts_with("30.0 [2") && first[4] == "0.016", "{first:?}");
    assert!(second[3].starts_with("20.0 [1") && second[2] == "5, 5, 5, 5", "{second:?}");
    assert_eq!(second[4..], ["–", "–"], "four groups of five have no p-value");
    assert!(
        sooner[1] == "success % over training" && sooner[3].starts_with("15.0 [1"),
        "{sooner:?}"
    );

    // 30 points are more than 2; where no margin is named, the column is empty.
    let title = "title = \"Im-IWoL against MAPPO among 4\"";
    let with_margin = text.replace(title, &format!("{title}\nmargin = 2"));
    let sweep = Sweep::parse(&with_margin, "s.toml", "s", folder.path()).expect("a sweep");
    let (markdown, _) = report(&sweep, folder.path());
    let row = |of: &str| {
        let row = markdown.lines().find(|line| line.contains(of)).expect("a row");
        row.rsplit('|').nth(1).expect("a cell").trim().to_owned()
    };
    assert_eq!(["Im-IWoL against MAPPO", "who learns sooner"].map(row), ["beyond ±2", ""]);

    // With three seeds, the largest difference has p = 2/20.
    let small = folder.path().join("small");
    let three = text.replace(five, few).replace("seed = [1, 2, 3, 4]", "seed = [1, 2]");
    let sweep = Sweep::parse(&three, "s.toml", "s", &small).expect("a sweep");
    results(&sweep, success, |_| Value::Null);
    let (markdown, _) = report(&sweep, &small);
    let row = markdown.lines().find(|line| line.contains("Im-IWoL against MAPPO")).expect("a row");
    assert!(row.contains("| 3, 3 | 30.0 [") && row.ends_with("| 0.100 | 0.400 |"), "{row}");

    let wrong = |from: &str, to: &str| {
        let text = text.replace(from, to);
        Sweep::parse(&text, "s.toml", "s", folder.path()).expect_err("refused").to_string()
    };
    let metric = wrong("metric = \"success\"", "metric = \"sucess\"");
    assert!(metric.contains("`Im-IWoL against MAPPO among 4`: metric must be one of success"));
    let endless = wrong("metric = \"loitering\"", "metric = \"km_per_crash\"");
    assert!(endless.contains("a run without a crash has no number"), "{endless}");
    let unseen = wrong("metric = \"success\"\nof", "metric = \"others.pet\"\nof");
    assert!(unseen.contains("the metric of validations must be one of success"), "{unseen}");
    let named = wrong("of = \"training\"", "of = \"training\"\nevaluate = \"last\"");
    assert!(named.contains("omit `evaluate` and `at`"), "{named}");
    let margin = wrong(title, &format!("{title}\nmargin = 0"));
    assert!(margin.contains("margin must be above 0"), "{margin}");
    let minus = "minus = [{ algorithm = \"mappo\", agents = 4 }]\n[[contrast]]\ntitle = \"is it";
    let other = |group: &str| {
        wrong(minus, &format!("minus = [{{ {group} }}]\n[[contrast]]\ntitle = \"is it"))
    };
    let several = other("algorithm = \"mappo\"");
    assert!(several.contains("give more conditions"), "{several}");
    let none = other("algorithm = \"magik\"");
    assert!(none.contains("no cell that is evaluated has"), "{none}");
    let single = other("algorithm = \"mappo\", agents = 4, seed = 0");
    assert!(single.contains("a group needs two runs or more"), "{single}");
    let shared = wrong(
        "agents = 8 }, { algorithm = \"mappo\", agents = 4 }]",
        "agents = 8 }, { algorithm = \"mappo\", agents = 8 }]",
    );
    assert!(shared.contains("is in two of its groups"), "{shared}");
    let alone = wrong("minus = [{ algorithm = \"mappo\", agents = 4 }]", "minus = []");
    assert!(alone.contains("as many conditions in `minus`"), "{alone}");
}

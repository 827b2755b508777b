mod mistakes;

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
    when = { agents = [8], algorithm = "mappo" }
    set = { "train.envs" = 2, ppo = { gamma = 0.9 }, steps = 9 }
    [[evaluate]]
    name = "range"
    grid = { "scenario.communication.range" = [100.0, 10.0] }
"#;

fn parse(text: &str) -> Result<Sweep, Error> {
    Sweep::parse(text, "s.toml", "s", Path::new("out"))
}

/// The guide has every key of the tables of a sweep file.
#[test]
fn every_key_is_in_the_guide() {
    let page = include_str!("../../docs/guide/sweeps.md");
    let refused = |table: &str| {
        let found = match table {
            "evaluate" => toml::from_str::<Evaluate>("no = 1").map(|_| ()),
            "reference" => toml::from_str::<Reference>("no = 1").map(|_| ()),
            _ => toml::from_str::<Contrast>("no = 1").map(|_| ()),
        };
        found.expect_err("there is no such key").message().to_owned()
    };
    for (table, next) in
        [("evaluate", "`[[reference]]`"), ("reference", "`[[contrast]]`"), ("contrast", "A `when`")]
    {
        let (from, to) = (format!("| `[[{table}]]` |"), page.find(next).expect("a table"));
        let rows = &page[page.find(&from).expect("a row")..to];
        let known = refused(table);
        let keys: Vec<&str> = known.split('`').skip(3).step_by(2).collect();
        assert!(keys.len() > 4, "{known}");
        for key in keys {
            assert!(rows.contains(&format!("`{key}`")), "{table}: {key}");
        }
    }
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
    assert_eq!((ruled.train.envs, ruled.learner.ppo.gamma, ruled.agents), (2, 0.9, 8));
    assert_eq!((free.train.envs, free.agents), (4, 4));
}

#[test]
fn the_scenario_can_be_changed_beside_its_short_form() {
    let sweep = |more: &str| {
        let short = FILE.replace("seed = [0, 1]", &format!("seed = [0, 1]\n{more}"));
        // A file of the grid stands in the place of that in the settings.
        let settings = "scenario = \"scenarios/intersection.xml\"\n";
        let file =
            if more.starts_with("scenario = ") { short.replacen(settings, "", 1) } else { short };
        parse(&file).unwrap().cells
    };
    for cell in sweep("\"scenario.observation.detectionRange\" = [50]") {
        let range = cell.config.scenario.value("observation", "detectionRange");
        assert_eq!(range.and_then(toml::Value::as_float), Some(50.0));
        assert!(cell.id.contains("detectionRange=50"), "{}", cell.id);
    }
    let files = sweep("scenario = [\"scenarios/intersection.xml\", \"scenarios/mixed_cross.xml\"]");
    assert!(files.iter().any(|cell| cell.config.scenario.file.ends_with("mixed_cross.xml")));
}

#[test]
fn a_cell_may_begin_with_the_policy_of_another() {
    let with =
        |change: &str| FILE.replace("steps = 9 }", &format!("init_from = {{ {change} }} }}"));
    let sweep = parse(&with("agents = 4")).unwrap();
    let after: Vec<_> = sweep
        .cells
        .iter()
        .filter_map(|cell| Some((cell.id.as_str(), cell.after.as_deref()?)))
        .collect();
    let expected = [0, 1]
        .map(|seed| (format!("mappo_agents=8/seed_{seed}"), format!("mappo_agents=4/seed_{seed}")));
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
    let grid = grid.replace("ppo = { gamma = 0.9 }, steps = 9", "steps = 8");
    let rule =
        "[[rule]]\nwhen = { \"ppo.gamma\" = 0.99 }\nset = { init_from = { \"ppo.gamma\" = 0.9 } }";
    let sweep = parse(&format!("{grid}\n{rule}")).unwrap();
    let begins = |id: &str| sweep.cells.iter().find(|cell| cell.id == id).unwrap().after.as_deref();
    assert_eq!(begins("mappo_agents=8_gamma=0.99/seed_0"), Some("mappo_agents=8_gamma=0.9/seed_0"));
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
    let sweep = with("name = \"range\"\nwhen = { algorithm = \"mappo\", agents = [4] }").unwrap();
    let applies: Vec<&str> = (sweep.cells.iter())
        .filter(|cell| sweep.evaluations[0].applies(cell))
        .map(|cell| cell.id.as_str())
        .collect();
    assert_eq!(applies, ["mappo_agents=4/seed_0", "mappo_agents=4/seed_1"]);
    let message = with("when = { agents = 5 }").expect_err("must be refused").to_string();
    assert!(message.contains("[[evaluate]] `evaluation`: `when` names agents = 5"), "{message}");
    let message = with("when = { steps = 5 }").expect_err("must be refused").to_string();
    assert!(message.contains("[[evaluate]] `evaluation`: no cell has steps = 5"), "{message}");

    let skip = |when: &str| {
        parse(&FILE.replace("[[rule]]", &format!("[[skip]]\nwhen = {{ {when} }}\n[[rule]]")))
    };
    let ids: Vec<String> =
        skip("agents = 8, seed = [1]").unwrap().cells.into_iter().map(|cell| cell.id).collect();
    assert_eq!(ids.len(), 6);
    assert!(
        !ids.contains(&"mappo_agents=8/seed_1".to_owned())
            && ids.contains(&"mappo_agents=8/seed_0".to_owned())
    );
    let message = skip("agents = 5").expect_err("must be refused").to_string();
    assert!(message.contains("[[skip]]: no combination has agents = 5"), "{message}");
    let chain = FILE.replace("steps = 9 }", "init_from = { agents = 4 } }");
    let broken = chain.replace("[[rule]]", "[[skip]]\nwhen = { agents = 4, seed = 1 }\n[[rule]]");
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

/// Without its settings, nobody knows which run a folder contains.
#[test]
fn a_run_without_readable_settings_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).unwrap();
    let cell = &sweep.cells[0];
    std::fs::create_dir_all(&cell.folder).unwrap();
    cell.check().expect("nothing was trained");
    cell.mark_trained().unwrap();
    assert!(matches!(cell.check(), Err(Error::Record(_))));
    std::fs::write(cell.run().config(), "agents = [").unwrap();
    assert!(matches!(cell.check(), Err(Error::Settings { .. })));
    std::fs::write(cell.run().config(), cell.config.to_toml()).unwrap();
    cell.check().expect("the same settings");
}

/// Results belong to the weights that were evaluated.
#[test]
fn a_run_that_went_on_is_evaluated_again() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).unwrap();
    let cell = &sweep.cells[0];
    let results = cell.folder.join("evaluations");
    std::fs::create_dir_all(&results).unwrap();
    let log = |step: u64| std::fs::write(cell.run().metrics(), format!("{{\"step\": {step}}}\n"));
    log(4096).unwrap();
    cell.mark_trained().unwrap();
    assert!(cell.trained().is_some_and(|trained| trained.steps == 4096));
    std::fs::create_dir_all(&results).unwrap();
    std::fs::write(results.join("range.json"), "{}").unwrap();
    log(8192).unwrap();
    assert!(cell.trained().is_none());
    cell.mark_trained().unwrap();
    assert!(cell.trained().is_some() && !results.join("range.json").exists());
}

/// Writes a cell as if it were trained, with the result of each evaluation on the scenario with
/// this fingerprint.
fn write_results(sweep: &Sweep, cell: &Cell, fingerprint: Option<&str>) {
    std::fs::create_dir_all(&cell.folder).unwrap();
    std::fs::write(cell.run().config(), cell.config.to_toml()).unwrap();
    std::fs::write(cell.run().metrics(), "").unwrap();
    cell.mark_trained().unwrap();
    std::fs::create_dir_all(cell.folder.join("evaluations")).unwrap();
    for evaluate in &sweep.evaluations {
        for combination in evaluate.combinations() {
            let result = serde_json::json!({
                "episodes": evaluate.episodes, "checkpoint": evaluate.checkpoint.file(),
                "set": evaluate.sets(&combination), "fingerprint": fingerprint, "metrics": {},
                "policy": cell.config.algorithm,
            });
            std::fs::write(cell.result(evaluate, &combination), result.to_string()).unwrap();
        }
    }
}

/// Results of other files than those that the scenario of an evaluation names now do not count.
#[test]
fn results_of_a_scenario_that_has_changed_are_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let files = r#"scenario = ["scenarios/intersection.xml", "scenarios/mixed_cross.xml"]"#;
    let text = FILE.replace("\"scenario.communication.range\" = [100.0, 10.0]", files);
    let sweep = Sweep::parse(&text, "s.toml", "s", folder.path()).unwrap();
    let cell = &sweep.cells[0];
    let state = |fingerprint: Option<&str>| {
        write_results(&sweep, cell, fingerprint);
        cell.state(&sweep.evaluations)
    };
    assert_eq!(state(None), State::Finished, "results of earlier versions do not say");
    assert_eq!(state(Some("0")), State::Trained(2));
    // Each of the two evaluations has a scenario of its own.
    assert_eq!(state(Some(&cell.fingerprint)), State::Trained(1));
}

/// A run that goes on, or is trained anew in the same folder, has no results until it is trained.
#[test]
fn runs_that_are_not_finished_have_no_results() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).unwrap();
    let (cell, evaluate) = (&sweep.cells[0], &sweep.evaluations[0]);
    write_results(&sweep, cell, None);
    let found = || cell.evaluation(evaluate, &evaluate.combinations()[0]).unwrap();
    assert!(found().is_some());
    std::fs::write(cell.run().metrics(), "{\"step\": 9999999}\n").unwrap();
    assert!(found().is_none());
}

/// A result of another method, or of other episodes, is not this cell's, wherever it comes from.
#[test]
fn results_of_others_do_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).unwrap();
    let (cell, evaluate) = (&sweep.cells[0], &sweep.evaluations[0]);
    let combination = &evaluate.combinations()[0];
    write_results(&sweep, cell, None);
    let file = cell.result(evaluate, combination);
    let own: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    for (key, other) in [("policy", serde_json::json!("mat")), ("seed", 5.into())] {
        let mut changed = own.clone();
        changed[key] = other;
        std::fs::write(&file, changed.to_string()).unwrap();
        assert!(cell.evaluation(evaluate, combination).unwrap().is_none(), "{key}");
    }
    let mut damaged = own;
    damaged["metrics"]["counted"] = u64::MAX.into();
    std::fs::write(&file, damaged.to_string()).unwrap();
    let error = cell.evaluation(evaluate, combination).expect_err("damaged");
    assert!(matches!(error, Error::Damaged { .. }), "{error}");
}

/// What is kept of a trained cell is what there is now, not what an earlier copy had besides. An
/// earlier copy of a cell that is not trained here stays, and is told.
#[test]
fn a_second_copy_replaces_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).unwrap();
    let (one, other) = (&sweep.cells[0], &sweep.cells[1]);
    let kept = folder.path().join("kept");
    let copy = |cell: &Cell, is_left: bool| {
        assert_eq!(cell.keep(&kept, "s").unwrap(), is_left);
        kept.join("s").join(&cell.id)
    };
    for cell in [one, other] {
        write_results(&sweep, cell, None);
        std::fs::write(cell.folder.join("evaluations/.tmp1"), "half").unwrap();
        assert_eq!(std::fs::read_dir(copy(cell, false).join("evaluations")).unwrap().count(), 2);
    }
    one.mark_trained().unwrap();
    std::fs::create_dir_all(one.folder.join("evaluations")).unwrap();
    std::fs::remove_dir_all(&other.folder).unwrap();
    assert_eq!(std::fs::read_dir(copy(one, false).join("evaluations")).unwrap().count(), 0);
    assert!(copy(other, true).exists());
}

/// A cell that fails again is reported with what its last attempt wrote.
#[test]
fn a_failure_is_told_from_its_own_part_of_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = Sweep::parse(FILE, "s.toml", "s", folder.path()).unwrap();
    let cell = &sweep.cells[0];
    std::fs::create_dir_all(&cell.folder).unwrap();
    let first = "error: the first attempt\n";
    std::fs::write(cell.log(), format!("{first}begun again\n")).unwrap();
    let told = cell.mark_failed("was killed", first.len() as u64).unwrap();
    assert_eq!(told, "was killed\nbegun again");
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

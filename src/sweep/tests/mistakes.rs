//! Mistakes in sweep files.

use super::*;

#[test]
fn two_evaluations_do_not_write_the_same_file() {
    let more = |name: &str| {
        let text = format!("{FILE}\n[[evaluate]]\nname = \"{name}\"");
        parse(&text).map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!(more("other"), Ok(()));
    let label = label(&[("scenario.communication.range".to_owned(), Value::Float(10.0))]);
    let error = more(&format!("range_{label}")).expect_err("must be refused");
    assert!(error.contains("both write"), "{error}");
}

/// Combinations of policy and evaluation that cannot work are refused when the file is read,
/// before hours of training.
#[test]
fn what_cannot_be_done_with_a_policy_is_refused_before_it_is_trained() {
    let with = |algorithms: &str, grid: &str| {
        let file =
            FILE.replace("[\"im-iwol\", \"mappo\"]", algorithms).replace("steps = 9", "steps = 8");
        parse(&file.replace("\"scenario.communication.range\" = [100.0, 10.0]", grid))
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
        parse(&file.replace("steps = 9 }", &format!("init_from = {{ {change} }} }}")))
            .map_err(|e| e.to_string())
    };
    let other =
        rule("[\"im-iwol\", \"mappo\"]", "algorithm = \"im-iwol\"").expect_err("must be refused");
    assert!(
        other.contains("im-iwol_agents=8/seed_0 trains im-iwol, which has other networks"),
        "{other}"
    );
    let file = FILE
        .replace("\"mappo\"", "\"commformer\"")
        .replace("steps = 9 }", "init_from = { agents = 4 } }");
    let fixed = parse(&file).expect_err("must be refused").to_string();
    assert!(fixed.contains("each of 4 agents and cannot be used with 8"), "{fixed}");
    let disturbed =
        parse(&FILE.replace("steps = 4096", "steps = 4096\nchannel = { shuffled = true }"))
            .expect_err("refused");
    assert!(disturbed.to_string().contains("for evaluation only: omit it"), "{disturbed}");
    let delayed = "steps = 4096\nchannel = { delay = 2 }\nnetwork = { encoder = \"gru\" }";
    let delayed = parse(&FILE.replace("steps = 4096", delayed)).expect_err("refused").to_string();
    assert!(delayed.contains("set network.encoder to \"mlp\" or \"attention\""), "{delayed}");
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
        message(("steps = 4096", "steps = 4096\nseed = 3"))
            .contains("[settings] seed has no effect, because each cell has the value of the grid")
    );
    assert!(
        message(("[grid]\n", "[settings.train.more]\n"))
            .contains("there is no [grid]; give it a list")
    );
    assert!(message(("seed = [0, 1]", "seed = [1, 1]")).contains("two cells are called"));
    let alike = message(("seed = [0, 1]", "\"iwol.latent\" = [8, 16]"));
    assert!(
        alike.contains("mappo_agents=4_latent=8 and mappo_agents=4_latent=16 are the same training, because mappo with these settings does not read iwol.latent"),
        "{alike}"
    );
    assert!(message(("name = \"range\"", "episodes = 0")).contains("1 or more episodes"));
    assert!(message(("\"mappo\"]", "\"mapo\"]")).contains("did you mean `mappo`"));
    assert!(
        message(("agents = [8]", "agents = [8, 16]")).contains(
            "[[rule]] number 1: `when` names agents = 16, and [grid] agents has only 4, 8"
        )
    );
    assert!(
        message(("agents = [8]", "agents = [8], seed = 1, \"train.envs\" = 3"))
            .contains("[[rule]] number 1: no cell has")
    );
    let seeds = message(("algorithm = \"mappo\" }", "algorithm = \"mappo\", seed = 1 }"));
    assert!(
        seeds.contains(
            "mappo_agents=8/seed_0 and mappo_agents=8/seed_1 differ in more than their seed"
        ),
        "{seeds}"
    );
    assert!(
        message(("steps = 9", "agents = 48"))
            .contains("[[rule]] number 1 sets agents, which has no effect")
    );
    assert!(
        message(("[[rule]]", "[[skip]]\nwhen = { seed = [1, 2] }\n[[rule]]"))
            .contains("[[skip]] number 1: `when` names seed = 2, and [grid] seed has only 0, 1")
    );
    assert!(
        message(("scenario.communication.range", "scenario.comunication.range"))
            .contains("did you mean")
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

#[test]
fn a_grid_value_that_the_scenario_does_not_read_is_refused() {
    let idle = FILE.replace("seed = [0, 1]", "\"scenario.observation.foresight\" = [1, 2]");
    let refused = parse(&idle).expect_err("must be refused").to_string();
    assert!(
        refused.contains("scenario.observation.foresight has no effect in cell")
            && refused.contains("because encounters is 0"),
        "{refused}"
    );
    let table =
        FILE.replace("agents = [4, 8]\n", "agents = [4, 8]\nppo = { gamma = [0.9, 0.99] }\n");
    let refused = parse(&table).expect_err("must be refused").to_string();
    assert!(refused.contains("\"ppo.gamma\" = [0.9, 0.99]"), "{refused}");
}

/// The grid of a base may be narrowed; a file's own conditions are checked all the same.
#[test]
fn own_rules_of_a_file_with_a_base_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("base.toml"), FILE).unwrap();
    let file = folder.path().join("own.toml");
    let load = |text: &str| {
        std::fs::write(&file, text).unwrap();
        Sweep::load(&file, Path::new("out")).map(|sweep| sweep.cells.len())
    };
    assert_eq!(load("base = \"base.toml\"\n[grid]\nalgorithm = [\"mappo\"]").unwrap(), 4);
    // The rule of the base is for MAPPO.
    assert_eq!(load("base = \"base.toml\"\n[grid]\nalgorithm = [\"im-iwol\"]").unwrap(), 4);
    let rule = "base = \"base.toml\"\n[[rule]]\nwhen = { agents = 99 }\nset = { steps = 9 }";
    let refused = load(rule).expect_err("must be refused").to_string();
    assert!(refused.contains("`when` names agents = 99"), "{refused}");
}

#[test]
fn contrasts_are_of_two_groups_and_published_values_are_possible() {
    let contrast = |minus: &str| {
        format!(
            "{FILE}\n[[contrast]]\ntitle = \"c\"\nmetric = \"success\"\nplus = [{{ algorithm = \"mappo\", agents = 4 }}]\n\
             minus = [{{ algorithm = \"{minus}\", agents = 4 }}]\nat = {{ \"scenario.communication.range\" = 10.0 }}"
        )
    };
    assert!(parse(&contrast("im-iwol")).is_ok());
    let refused = parse(&contrast("mappo")).expect_err("must be refused").to_string();
    assert!(refused.contains("plus and minus both select"), "{refused}");
    let published = |y: &str| {
        parse(&format!(
            "{FILE}\n[[reference]]\nlabel = \"p\"\nmetric = \"success\"\nx = [100.0]\ny = [{y}]"
        ))
    };
    assert!(published("0.97").is_ok());
    let refused = published("97.1").expect_err("must be refused").to_string();
    assert!(refused.contains("lie between 0 and 1"), "{refused}");
    let one = "[[reference]]\nlabel = \"p\"\nmetric = \"success\"\nx = [100.0]\ny = [0.5]\n";
    for wrong in [format!("{FILE}\n{one}{one}"), format!("{FILE}\n{}", one.replace("0.5", ""))] {
        let refused = parse(&wrong).expect_err("must be refused").to_string();
        assert!(refused.contains("in one entry, with at least one y"), "{refused}");
    }
}

//! Tests that the results of a world do not depend on its hosting: a SUMO process of its own, a
//! tile among others, or libsumo. The tests compare bits, over runs with crashes, arrivals and
//! respawns, against the real SUMO.

use std::path::Path;
use std::sync::Arc;

use iwol_sumo::env::{Driver, EpisodeRecord, Task, VecEnv, VecOptions};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::sumo::{Backend, Command, Hosting, VehicleState, start};

use crate::support::{agents_drive, task, turn};

fn hosting(backend: Backend, processes: usize) -> Hosting {
    Hosting { backend, processes, ..Hosting::default() }
}

/// Returns a hash of everything that learners observe, for each step and world, and the records of
/// the finished episodes.
fn play(
    task: &Arc<Task>,
    driver: Driver,
    worlds: usize,
    steps: u64,
    hosting: Hosting,
) -> (Vec<u64>, Vec<EpisodeRecord>) {
    let _turn = turn(hosting.backend);
    let options = VecOptions { driver, ..agents_drive(worlds, 11, hosting) };
    let mut env = VecEnv::new(task, &options).expect("SUMO runs");
    let mut actions = vec![0.0; worlds * task.agents * task.spec.actions.len()];
    let (mut bits, mut records) = (Vec::new(), Vec::new());
    for step in 0..steps {
        // Actions around a moderate speed make vehicles crash, arrive and queue.
        rng::fill_normal(&mut Seed::new(5).index(step).rng(), &mut actions);
        for (k, action) in actions.iter_mut().enumerate() {
            // With two action components, steering is the first.
            let steers = task.spec.actions.len() == 2 && k % 2 == 0;
            *action = if steers { 0.3 * *action } else { 0.6 + 0.5 * *action };
        }
        env.step(&actions).expect("a step");
        for world in env.worlds() {
            let frame = world.frame();
            let all = [
                &frame.observation,
                &frame.state,
                &frame.comm,
                &frame.active,
                &frame.reward,
                &frame.terminated,
            ];
            // FNV-1a hash, so that a long run needs little memory.
            let hash = all
                .into_iter()
                .flatten()
                .chain(&frame.truncated)
                .fold(0xcbf2_9ce4_8422_2325_u64, |hash, value| {
                    (hash ^ u64::from(value.to_bits())).wrapping_mul(0x0100_0000_01b3)
                });
            bits.push(hash);
        }
        records.extend(env.take_finished());
    }
    // Only SUMO's own driver loads or restarts SUMO for a new episode.
    assert!(driver == Driver::Sumo || env.resets().loads + env.resets().restarts == 0);
    (bits, records)
}

fn hostings() -> Vec<Hosting> {
    let mut all =
        vec![hosting(Backend::Traci, 6), hosting(Backend::Traci, 1), hosting(Backend::Traci, 4)];
    if cfg!(feature = "libsumo") {
        all.push(hosting(Backend::Libsumo, 1));
    }
    all
}

fn agree(task: &Arc<Task>, driver: Driver, steps: u64, least_episodes: usize) {
    let mut runs =
        hostings().into_iter().map(|hosting| (hosting, play(task, driver, 6, steps, hosting)));
    let (_, (bits, records)) = runs.next().expect("a first hosting");
    assert!(records.len() >= least_episodes, "only {} episodes", records.len());
    for (hosting, (other_bits, other_records)) in runs {
        let first = bits.iter().zip(&other_bits).position(|(a, b)| a != b);
        assert_eq!(
            first.map(|i| (i / 6, i % 6)),
            None,
            "(step, world) that differs first with {hosting:?}"
        );
        // `assert_eq!` would print both lists of records, which are long.
        assert!(records == other_records, "the records differ with {hosting:?}");
    }
}

#[test]
fn eight_agents_see_the_same_wherever_their_world_runs() {
    agree(&task("intersection", 8), Driver::Agents, 600, 20);
}

/// Tests agents that steer: this program's vehicle model moves them, and SUMO receives their speeds
/// and, through `moveToXY`, their poses.
#[test]
fn agents_that_steer_see_the_same_wherever_their_world_runs() {
    agree(&task("parking_lot", 5), Driver::Agents, 600, 20);
    agree(&task("intersection_turns", 8), Driver::Agents, 400, 10);
}

#[test]
fn agents_see_the_same_signals_wherever_their_world_runs() {
    agree(&task("signals", 8), Driver::Agents, 400, 10);
}

#[test]
fn forty_eight_agents_see_the_same_wherever_their_world_runs() {
    agree(&task("intersection", 48), Driver::Agents, 250, 4);
}

#[test]
fn sumos_own_driver_does_the_same_wherever_its_world_runs() {
    agree(&task("intersection", 8), Driver::Sumo, 400, 4);
}

/// Returns the reports of vehicles that are placed by their poses, in `worlds` identical worlds.
#[test]
fn another_stream_in_a_sumo_that_goes_on_has_the_same_episodes() {
    for scenario in ["intersection", "parking_lot", "flow_cross"] {
        let task = task(scenario, 5);
        let hosting = hosting(Backend::Traci, 2);
        let mut env = VecEnv::new(&task, &agents_drive(3, 11, hosting)).expect("SUMO runs");
        let actions = vec![0.7; 3 * task.agents * task.spec.actions.len()];
        let frames = |env: &mut VecEnv| {
            let frames = (0..120).map(|_| {
                env.step(&actions).expect("a step");
                env.worlds().map(|world| world.frame().clone()).collect::<Vec<_>>()
            });
            frames.collect::<Vec<_>>()
        };
        frames(&mut env);
        let other = agents_drive(3, 12, hosting);
        env.restart(other.seed, other.episodes.clone());
        env.step(&actions).expect("a step");
        let restarted = frames(&mut env);
        drop(env);
        let mut new = VecEnv::new(&task, &other).expect("SUMO runs");
        assert!(restarted == frames(&mut new), "{scenario}");
    }
}

fn steer(task: &Task, backend: Backend, worlds: u32) -> Vec<Vec<Option<VehicleState>>> {
    let _turn = turn(backend);
    let mut simulation =
        start(backend, task.simulation_config(1, worlds, &Hosting::default())).expect("SUMO runs");
    let (half, interval) = (task.scenario.vehicle.length / 2.0, task.scenario.control.interval);
    let mut reports = Vec::new();
    for step in 0..60_u32 {
        let mut commands = Vec::new();
        for (world, slot) in (0..worlds).flat_map(|w| (0..8).map(move |s| (w, s))) {
            let place = &task.places[slot as usize];
            let front = place.pos + half;
            if step == 0 {
                let route = place.routes[0] as u32;
                commands.push(Command::Add {
                    world,
                    slot,
                    route,
                    vehicle_type: 0,
                    depart_pos: front,
                    depart_speed: 0.0,
                });
                commands.push(Command::SpeedMode { world, slot, mode: 32 });
                commands.push(Command::LaneChangeMode { world, slot, mode: 0 });
            } else {
                let way = f64::from(step) * (5.0 + 0.37 * f64::from(slot)) * interval;
                let ([x, y], heading, _) =
                    task.map.routes[place.routes[0]].path.body(front + way, 2.0 * half);
                commands.push(Command::MoveTo { world, slot, x, y, heading, keep_route: 1 });
            }
        }
        reports.push(simulation.step(&commands).expect("a step").vehicles.clone());
    }
    reports
}

#[test]
fn steered_vehicles_are_where_they_were_put_wherever_their_world_runs() {
    let task = task("intersection", 8);
    let alone = steer(&task, Backend::Traci, 1);
    for (step, report) in alone.iter().enumerate() {
        for (slot, vehicle) in report.iter().enumerate() {
            let way = step as f64 * (5.0 + 0.37 * slot as f64) * task.scenario.control.interval;
            let expected = task.places[slot].pos + task.scenario.vehicle.length / 2.0 + way;
            let found = vehicle.expect("on the road").distance;
            assert!(
                (found - expected).abs() < 1e-6,
                "slot {slot}, step {step}: {found} m, not {expected} m"
            );
        }
    }
    // SUMO derives the position on the lane from coordinates, whose rounding differs in a tile.
    let tiled = steer(&task, Backend::Traci, 3);
    for (one, three) in alone.iter().zip(&tiled) {
        for (a, b) in three.iter().zip(one.iter().cycle()) {
            let (a, b) = (a.expect("on the road"), b.expect("on the road"));
            assert!(
                (a.distance - b.distance).abs() < 1e-9 && (a.speed - b.speed).abs() < 1e-7,
                "{a:?} {b:?}"
            );
        }
    }
    if cfg!(feature = "libsumo") {
        assert!(
            steer(&task, Backend::Libsumo, 3) == tiled
                && steer(&task, Backend::Libsumo, 1) == alone
        );
    }
}

#[cfg(feature = "libsumo")]
#[test]
fn libsumo_takes_one_simulation_at_a_time_and_says_so() {
    use iwol_sumo::sumo::Error;
    let _turn = turn(Backend::Libsumo);
    let config = task("intersection", 8).simulation_config(1, 2, &Hosting::default());
    let first = start(Backend::Libsumo, config.clone()).expect("libsumo runs");
    let second = start(Backend::Libsumo, config.clone());
    assert!(
        matches!(&second, Err(e @ Error::Occupied) if e.hint().is_some()),
        "{:?}",
        second.err()
    );
    drop(first);
    start(Backend::Libsumo, config).expect("the place is free again");
}

#[cfg(not(feature = "libsumo"))]
#[test]
fn a_backend_that_is_not_built_in_is_refused_with_advice() {
    use iwol_sumo::sumo::Error;
    let config = task("intersection", 8).simulation_config(1, 2, &Hosting::default());
    let error = start(Backend::Libsumo, config).err();
    assert!(
        matches!(&error, Some(e @ Error::NotBuiltIn { .. }) if e.hint().is_some()),
        "{error:?}"
    );
}

#[test]
fn an_episode_of_sumos_own_driver_does_not_depend_on_the_one_before() {
    let task = task("intersection", 24);
    let second = |first: u64| {
        let options = VecOptions {
            driver: Driver::Sumo,
            episodes: first..2,
            ..agents_drive(1, 3, Hosting::default())
        };
        let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
        let mut records = Vec::new();
        while !env.is_finished() {
            env.step(&[0.0; 24]).expect("a step");
            records.extend(env.take_finished());
        }
        records.pop().expect("an episode")
    };
    let (alone, after_another) = (second(1), second(0));
    assert_eq!((alone.episode, after_another.episode), (1, 1));
    assert!(
        alone == after_another,
        "{} and {} steps",
        alone.episode_length,
        after_another.episode_length
    );
}

/// Returns the lines of a run's metrics, without those of time.
fn metrics(run: &Path) -> Vec<String> {
    let metrics = std::fs::read_to_string(run.join("metrics.jsonl")).expect("metrics");
    let lines = metrics.lines().map(|line| {
        let mut line: serde_json::Map<_, _> = serde_json::from_str(line).expect("a line");
        line.retain(|key, _| !key.starts_with("time/") && key != "steps_per_second");
        serde_json::to_string(&line).expect("a line")
    });
    lines.collect()
}

/// Sets variables as they are on machines of people who use other Pythons, libraries and languages.
fn disturb(command: &mut std::process::Command, folder: &Path) {
    use std::{fs, os::unix::fs::symlink};
    let venv = folder.join("venv");
    if !venv.exists() {
        // A virtual environment of the Python that the program embeds, without packages.
        let python = fs::canonicalize("/usr/bin/python3").expect("Python");
        let lib = venv.join("lib").join(python.file_name().expect("a name"));
        fs::create_dir_all(lib.join("site-packages")).expect("a folder");
        fs::create_dir_all(venv.join("bin")).expect("a folder");
        symlink("/usr/bin/python3", venv.join("bin/python3")).expect("a link");
        fs::write(venv.join("pyvenv.cfg"), "home = /usr/bin\n").expect("a file");
        // Modules and a library that cannot be loaded.
        for module in ["libsumo.py", "traci.py", "encodings.py", "collections.py"] {
            fs::write(folder.join(module), "raise ImportError('the wrong module')\n")
                .expect("a file");
        }
        for library in ["libtorch_cpu.so", "libtorch.so", "libc10.so"] {
            fs::write(folder.join(library), "no library").expect("a file");
        }
    }
    let mut path = venv.join("bin").into_os_string();
    path.push(":");
    path.push(std::env::var_os("PATH").expect("PATH"));
    command.env("PATH", path).env("VIRTUAL_ENV", &venv).env("PYTHONHOME", "/nowhere");
    command.env("PYTHONPATH", folder).env("LD_LIBRARY_PATH", folder);
    command.env("OMP_NUM_THREADS", "many").env("LC_ALL", "de_DE.UTF-8").env("LANG", "de_DE.UTF-8");
}

#[test]
fn training_is_the_same_in_any_environment() {
    use crate::support::{folder, iwol, succeeds, text, train};
    let folder = folder();
    let train = |name: &str, backend: &str, change: &dyn Fn(&mut std::process::Command)| {
        let run = folder.path().join(name);
        let settings = ["train.envs=2", "train.rollout_steps=16", "network.hidden=8"];
        let more = ["--agents", "4", "--algorithm", "mappo", "--steps", "64"];
        let mut command = train(&run, &settings, &more);
        change(command.args(["--backend", backend]));
        succeeds(&mut command);
        metrics(&run)
    };
    let plain = train("plain", "traci", &|_| {});
    let disturbed = |command: &mut std::process::Command| disturb(command, folder.path());
    let ascii = |command: &mut std::process::Command| {
        command.env("LC_ALL", "C").env("LANG", "C").env("OMP_NUM_THREADS", "64");
    };
    assert_eq!(train("disturbed", "traci", &disturbed), plain);
    assert_eq!(train("ascii", "traci", &ascii), plain);
    if cfg!(feature = "libsumo") {
        assert_eq!(train("disturbed-libsumo", "libsumo", &disturbed), plain);
        assert_eq!(train("ascii-libsumo", "libsumo", &ascii), plain);
    }
    let mut doctor = iwol(&["doctor"]);
    disturb(&mut doctor, folder.path());
    let said = text(&succeeds(&mut doctor).stdout);
    assert!(said.contains("first in PATH"), "{said}");
    assert!(!said.contains("not usable"), "{said}");
}

#[cfg(feature = "libsumo")]
#[test]
fn a_measurement_leaves_out_a_backend_that_is_not_there() {
    use crate::support::{iwol, succeeds, text};
    let measure = ["bench", "sim", "--agents", "4", "--worlds", "1/1", "--seconds", "0.05"];
    let mut command = iwol(&measure);
    let output = succeeds(command.env("PATH", "/nowhere").env_remove("SUMO_HOME"));
    let (out, errors) = (text(&output.stdout), text(&output.stderr));
    assert!(errors.contains("traci is left out: sumo was not found"), "{errors}");
    assert!(out.contains("libsumo") && !out.contains("traci"), "{out}");
}

#[cfg(feature = "libsumo")]
#[test]
fn training_is_the_same_with_either_backend_validations_included() {
    use crate::support::{folder, succeeds, train};
    let folder = folder();
    let train = |backend: &str| -> Vec<String> {
        let run = folder.path().join(backend);
        let settings = [
            "train.envs=4",
            "train.rollout_steps=32",
            "train.validate_every=256",
            "train.validation_episodes=2",
            "network.hidden=8",
            "scenario.termination.horizon=40",
        ];
        let more = ["--agents", "4", "--algorithm", "im-iwol", "--steps", "512"];
        succeeds(train(&run, &settings, &more).args(["--backend", backend]));
        metrics(&run)
    };
    let traci = train("traci");
    assert!(
        traci.iter().filter(|line| line.contains("validation/success")).count() == 2,
        "{traci:?}"
    );
    assert_eq!(traci, train("libsumo"));
}

"""One world by PettingZoo's conventions."""

import copy
import logging
import pickle

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import iwol_sumo


def full_throttle(env):
    return {agent: np.ones(len(env.actions), np.float32) for agent in env.agents}


def play(env, seed, episode):
    """Plays an episode at random and returns all that is observed."""
    rng = np.random.default_rng(0)
    seen = [env.reset(seed=seed, options={"episode": episode})]
    while env.agents:
        actions = {agent: rng.uniform(-0.2, 1, len(env.actions)).astype(np.float32) for agent in env.agents}
        seen.append(env.step(actions))
    return seen, env.last_episode


def same(a, b):
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    return np.array_equal(a, b)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("scenario", ["intersection", "parking_lot", "flow_cross"])
def test_pettingzoo_accepts_the_environment(scenario):
    with iwol_sumo.parallel_env(scenario) as env:
        parallel_api_test(env, num_cycles=300)


def test_pettingzoo_accepts_the_seeds():
    parallel_seed_test(lambda: iwol_sumo.parallel_env("intersection"))


def test_a_seed_and_a_number_give_the_same_episode():
    with iwol_sumo.parallel_env("intersection") as one, iwol_sumo.parallel_env("intersection") as two:
        first = [play(one, 3, k) for k in (0, 1, 4)]
        # The other one has played something else before.
        play(two, 8, 2)
        again = [play(two, 3, k) for k in (0, 1, 4)]
        assert same(first, again)
        assert not same(first[0], first[1])
        assert not same(first[0], play(two, 4, 0))


def test_reset_without_a_seed_takes_the_next_episode(intersection):
    wanted = play(intersection, 3, 1)
    intersection.reset(seed=3)
    rng = np.random.default_rng(0)
    seen = [intersection.reset()]
    while intersection.agents:
        actions = {a: rng.uniform(-0.2, 1, 1).astype(np.float32) for a in intersection.agents}
        seen.append(intersection.step(actions))
    assert same(seen, wanted[0])


def test_observations_stay_within_their_spaces(intersection):
    for observations, *rest in play(intersection, 0, 0)[0]:
        for agent, observation in observations.items():
            assert intersection.observation_space(agent).contains(observation)
    assert intersection.state_space.contains(intersection.state())
    assert intersection.observation_space("vehicle_0") is intersection.observation_space("vehicle_0")


def test_crashes_and_the_horizon_are_told_apart(intersection):
    intersection.reset(seed=0)
    ended = {}
    while intersection.agents:
        _, rewards, terminations, truncations, infos = intersection.step(full_throttle(intersection))
        for agent, done in terminations.items():
            assert not truncations[agent]
            if done:
                ended[agent] = infos[agent]
                assert rewards[agent] == (-10 if infos[agent]["crashed"] else 10)
    assert len(ended) == 8
    assert any(info["crashed"] for info in ended.values())
    with iwol_sumo.parallel_env("intersection", overrides={"termination.horizon": 50}) as short:
        short.reset(seed=0)
        steps = 0
        while short.agents:
            steps += 1
            _, _, terminations, truncations, _ = short.step({a: np.full(1, -1.0) for a in short.agents})
        assert steps == 50 and all(truncations.values()) and not any(terminations.values())
        assert short.step({}) == ({}, {}, {}, {}, {})


def test_agents_of_route_files_come_and_go():
    with iwol_sumo.parallel_env("flow_cross", agents=4) as env:
        env.reset(seed=0)
        seen, gone = set(env.agents), set()
        while env.agents:
            assert not gone & set(env.agents), "an agent came back"
            before = set(env.agents)
            _, _, terminations, truncations, _ = env.step(full_throttle(env))
            gone |= {agent for agent in before if terminations[agent] or truncations[agent]}
            seen |= set(env.agents)
        # The four slots were used again.
        assert len(seen) > 4
        assert env.last_episode["flow"]["departed"] == len(seen)


def test_mistakes_are_named(intersection):
    with pytest.raises(iwol_sumo.Error, match="call reset"):
        intersection.step({})
    intersection.reset(seed=0)
    actions = full_throttle(intersection)
    for change, message in [
        ({"vehicle_3": np.full(1, np.nan)}, "vehicle_3 is NaN"),
        ({"vehicle_3": np.zeros(2)}, r"vehicle_3 has the shape \(2,\) instead of \(1,\)"),
        ({"car": np.zeros(1)}, "there is no agent 'car'"),
    ]:
        with pytest.raises(iwol_sumo.Error, match=message):
            intersection.step({**actions, **change})
    del actions["vehicle_2"]
    with pytest.raises(ValueError, match="vehicle_2 is live and has no action"):
        intersection.step(actions)
    with pytest.raises(iwol_sumo.ScenarioError, match="did you mean 'intersection'"):
        iwol_sumo.parallel_env("intersecton")
    with pytest.raises(iwol_sumo.ScenarioError, match="4 to 48"):
        iwol_sumo.parallel_env("intersection", agents=49)
    with pytest.raises(iwol_sumo.ScenarioError, match="did you mean `termination.horizon`"):
        iwol_sumo.parallel_env("intersection", overrides={"termination.horizn": 3})
    with pytest.raises(ValueError, match="horizon"):
        iwol_sumo.parallel_env("intersection", overrides={"termination.horizon": -3})
    with pytest.raises(iwol_sumo.Error, match="render_mode"):
        iwol_sumo.parallel_env("intersection", render_mode="human")


def test_a_copy_is_an_environment_of_its_own(intersection):
    wanted = play(intersection, 3, 0)
    for other in (copy.deepcopy(intersection), pickle.loads(pickle.dumps(intersection))):
        with other:
            assert same(play(other, 3, 0), wanted)


def test_environments_without_a_seed_play_episodes_of_their_own(intersection):
    first = intersection.reset()
    again = pickle.loads(pickle.dumps(intersection))
    with iwol_sumo.parallel_env("intersection") as other, again:
        assert not same(first, other.reset()) and not same(first, again.reset())
        assert same(first, other.reset(seed=intersection.episode_seed))
    with iwol_sumo.parallel_env("intersection", seed=4) as one, iwol_sumo.parallel_env("intersection", seed=4) as two:
        assert one.episode_seed is None
        assert same(one.reset(), two.reset()) and same(one.reset(), two.reset())
        assert one.episode_seed == 4


def test_a_step_that_was_interrupted_ends_the_episode(intersection, monkeypatch):
    intersection.reset(seed=0)
    decide = intersection._decide

    def interrupted():
        decide()
        raise KeyboardInterrupt

    monkeypatch.setattr(intersection, "_decide", interrupted)
    with pytest.raises(KeyboardInterrupt):
        intersection.step(full_throttle(intersection))
    monkeypatch.undo()
    with pytest.raises(iwol_sumo.Error, match="interrupted.*call reset"):
        intersection.step(full_throttle(intersection))
    intersection.reset()
    intersection.step(full_throttle(intersection))


def test_exceptions_of_log_handlers_arrive_as_themselves(intersection, kill_sumo):
    def raises(_):
        raise KeyboardInterrupt

    logger = logging.getLogger("iwol_sumo.env.driving.vec")
    intersection.reset(seed=0)
    kill_sumo()
    logger.addFilter(raises)
    try:
        with pytest.raises(KeyboardInterrupt):
            intersection.step(full_throttle(intersection))
    finally:
        logger.removeFilter(raises)
    intersection.reset(seed=0)


def test_after_close_an_environment_says_so():
    env = iwol_sumo.parallel_env("intersection", render_mode="svg")
    env.reset(seed=0)
    actions = full_throttle(env)
    env.close()
    for use in (lambda: env.step(actions), env.render, lambda: env.save_replay("episode.json")):
        with pytest.raises(iwol_sumo.Error, match="close"):
            use()
    assert env._repr_html_()
    with env:
        env.reset(seed=0)
        assert env.render().startswith("<svg")


def test_closing_twice_is_fine(intersection):
    intersection.reset()
    intersection.close()
    intersection.close()
    assert len(intersection.reset(seed=1)[0]) == 8


def test_an_episode_is_drawn():
    with iwol_sumo.parallel_env("intersection", render_mode="html") as env:
        assert env.render() is None
        play(env, 0, 0)
        assert env.render().lstrip().startswith("<!doctype html>") or "<html" in env.render()
        assert env._repr_html_().startswith("<svg")


def test_a_step_is_drawn_as_pixels():
    with iwol_sumo.parallel_env("intersection", render_mode="rgb_array") as env:
        assert env.render() is None
        env.reset(seed=0)
        frames = [env.render()]
        for _ in range(20):
            env.step(full_throttle(env))
            frames.append(env.render())
    assert all(frame.shape == frames[0].shape and frame.dtype == np.uint8 for frame in frames)
    height, width, channels = frames[0].shape
    assert (width, channels, height % 2) == (900, 3, 0)
    # Agents that drive are blue (the palette's #0072b2), and move.
    blue = [(frame == (0x00, 0x72, 0xB2)).all(-1) for frame in frames]
    assert blue[0].any() and not np.array_equal(blue[0], blue[-1])
    assert (frames[0][0, 0] == 255).all()


def test_the_aec_form_plays(intersection):
    env = iwol_sumo.env("intersection", agents=8)
    env.reset(seed=0)
    assert env.last()[4]["slot"] == 0
    for agent in env.agent_iter(100):
        _, _, terminated, truncated, _ = env.last()
        env.step(None if terminated or truncated else np.ones(1, np.float32))
    env.close()


@pytest.mark.parametrize("scenario", ["flow_cross", "blind_crossing"])
def test_agents_that_are_still_to_come_show_nothing(scenario):
    with iwol_sumo.parallel_env(scenario) as env:
        observations, infos = env.reset(seed=0)
        assert list(infos) == env.agents and len(env.agents) < len(env.possible_agents)
        assert list(observations) == env.agents
        absent = [agent for agent in env.possible_agents if agent not in env.agents]
        # TorchRL looks infos of all possible agents up, in a copy.
        for found in (infos, copy.deepcopy(infos)):
            assert found[absent[0]].keys() == found[env.agents[0]].keys()
        assert list(infos) == env.agents
        for found in (observations, copy.deepcopy(observations)):
            assert env.observation_space(absent[0]).contains(found[absent[0]]) and not found[absent[0]].any()
        assert list(observations) == env.agents
    env = iwol_sumo.env(scenario)
    env.reset(seed=0)
    assert env.last()[4]["comm"].any()
    env.close()


def test_states_and_masks_are_indexed_by_slot():
    with iwol_sumo.parallel_env("blind_crossing") as env:
        for seed in range(3):
            _, infos = env.reset(seed=seed)
            rows = {infos[agent]["slot"]: infos[agent]["comm"] for agent in env.agents}
            present = np.flatnonzero(env.state().any(1))
            assert list(rows) == present.tolist()
            assert all(comm[slot] == 1 for slot, comm in rows.items())


def test_rejected_numbers_change_nothing(intersection):
    for number in (-1, 2**64, 1.5, "3"):
        with pytest.raises(iwol_sumo.Error, match="^seed is .*; allowed: whole numbers from 0 to"):
            iwol_sumo.parallel_env("intersection", seed=number)
        with pytest.raises(iwol_sumo.Error, match="^seed is"):
            intersection.reset(seed=number)
        with pytest.raises(iwol_sumo.Error, match="^episode is"):
            intersection.reset(options={"episode": number})
    with pytest.raises(iwol_sumo.Error, match="call reset"):
        intersection.step({})
    wanted = intersection.reset(seed=0)
    with pytest.raises(iwol_sumo.Error, match="^seed is"):
        intersection.reset(seed=-1)
    assert same(intersection.reset(options={"episode": 0}), wanted)


def test_a_reset_after_the_death_of_sumo_starts_another(intersection, kill_sumo):
    wanted = intersection.reset(seed=7)
    intersection.reset(seed=0)
    for _ in range(20):
        intersection.step(full_throttle(intersection))
    kill_sumo()
    assert same(intersection.reset(seed=7), wanted)
    intersection.step(full_throttle(intersection))


def test_a_folder_does_not_hide_a_scenario(tmp_path, monkeypatch):
    (tmp_path / "intersection").mkdir()
    monkeypatch.chdir(tmp_path)
    assert iwol_sumo.scenario_file("intersection").name == "intersection.xml"


def test_settings_may_be_none_or_of_numpy():
    settings = iwol_sumo.settings("intersection")
    nothing = {name: value for name, (value, _) in settings.items() if value is None}
    given = iwol_sumo.parallel_env("intersection", overrides={**nothing, "control.drag": None})
    assert nothing and given.features == iwol_sumo.parallel_env("intersection").features
    # All settings can be given back.
    for name in ("intersection", "parking_lot", "blind_crossing"):
        present = {key: value for key, (value, _) in iwol_sumo.settings(name).items()}
        assert iwol_sumo.parallel_env(name, overrides=present).features == iwol_sumo.parallel_env(name).features
    for heading in (True, False):
        overrides = [{"observation.heading": kind(heading)} for kind in (bool, np.bool_)]
        envs = [iwol_sumo.parallel_env("intersection", overrides=each) for each in overrides]
        assert envs[0].features == envs[1].features
    with pytest.raises(iwol_sumo.ScenarioError, match="did you mean `termination.horizon`"):
        iwol_sumo.parallel_env("intersection", overrides={"termination.horizn": None})


def test_notebooks_show_the_name_of_what_is_not_recorded(intersection):
    assert "&lt;" in intersection._repr_html_() and "<iwol" not in intersection._repr_html_()

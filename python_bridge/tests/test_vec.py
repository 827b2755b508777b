"""Many worlds as NumPy arrays."""

import os
import signal
import threading
import time

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import iwol_sumo


def play(env, steps, **reset):
    """Plays at random; the actions of world e follow from the steps of its own episode."""
    frames = [env.reset(**reset)]
    rng = np.random.default_rng(0)
    table = rng.uniform(-0.2, 1, (steps, 1, env.agents, len(env.actions))).astype(np.float32)
    for t in range(steps):
        frames.append(env.step(np.repeat(table[t], env.num_envs, 0)))
    return frames


def test_worlds_are_the_episodes_of_the_stream():
    with iwol_sumo.vec_env("intersection", 3, 8) as env, iwol_sumo.parallel_env("intersection", 8) as one:
        frames = play(env, 40, seed=5, options={"episode": 2})
        for e in range(3):
            observations, _ = one.reset(seed=5, options={"episode": 2 + e})
            rng = np.random.default_rng(0)
            table = rng.uniform(-0.2, 1, (40, 1, 8, 1)).astype(np.float32)
            for t in range(40):
                for i in range(8):
                    if (name := f"vehicle_{i}") in one.agents:
                        assert np.array_equal(frames[t].observation[e, i], observations[name])
                if not one.agents:
                    break
                observations = one.step({f"vehicle_{i}": table[t, 0, i] for i in range(8)})[0]


@pytest.mark.parametrize("processes", [1, 3])
def test_results_do_not_depend_on_the_processes(processes):
    with iwol_sumo.vec_env("parking_lot", 3, processes=processes) as env:
        frames = play(env, 60, seed=1)
    with iwol_sumo.vec_env("parking_lot", 3, processes=2) as env:
        for one, other in zip(frames, play(env, 60, seed=1)):
            assert all(map(np.array_equal, one, other))


def test_worlds_reset_themselves_in_the_next_step():
    with iwol_sumo.vec_env("intersection", 2, 8, overrides={"termination.horizon": 30}) as env:
        assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        brake = np.full((2, 8, 1), -1, np.float32)
        frame = env.reset(seed=0)
        assert frame.active.all() and frame.start.all()
        for _ in range(30):
            last = frame
            frame = env.step(brake)
        assert frame.truncated.all() and not frame.active.any() and not frame.terminated.any()
        assert [record["env"] for record in env.episodes] == [0, 1]
        assert [record["episode"] for record in env.episodes] == [0, 1]
        assert np.allclose(frame.observation, last.observation, atol=0.2)
        frame = env.step(brake)
        assert frame.start.all() and frame.active.all() and not frame.reward.any()
        assert not env.episodes


def test_single_worlds_are_not_reset():
    with iwol_sumo.vec_env("intersection", 2, 8) as env:
        for resettable in (env, env.flatten()):
            with pytest.raises(iwol_sumo.Error, match="single worlds cannot be reset"):
                resettable.reset(options={"reset_mask": np.array([True, False])})


def test_arrays_are_fresh_the_same_or_the_users():
    with iwol_sumo.vec_env("intersection", 2, 8) as fresh, iwol_sumo.vec_env("intersection", 2, 8, copy=False) as same:
        throttle = np.ones((2, 8, 1), np.float32)
        a, b = fresh.reset(seed=0), fresh.step(throttle)
        assert not np.shares_memory(a.observation, b.observation)
        c = same.reset(seed=0)
        assert np.array_equal(a.observation, c.observation)
        assert same.step(throttle).observation is c.observation
        assert np.array_equal(b.observation, c.observation)
        # A rollout of the user's own.
        rollout = [np.zeros((3, *array.shape), array.dtype) for array in a]
        out = iwol_sumo.Frame(*(array[1] for array in rollout))
        d = fresh.step(throttle, out=out)
        assert d is out and np.array_equal(rollout[0][1], same.step(throttle).observation)
        bad = out._replace(observation=np.zeros((2, 8, 3), np.float32))
        with pytest.raises(iwol_sumo.Error, match="`observation` must be C-contiguous"):
            fresh.step(throttle, out=bad)


def test_wrong_actions_are_refused():
    with iwol_sumo.vec_env("intersection", 2, 8) as env:
        env.reset(seed=0)
        with pytest.raises(iwol_sumo.Error, match=r"shape \[2, 8\] instead of \[2, 8, 1\]"):
            env.step(np.zeros((2, 8), np.float32))
        actions = np.zeros((2, 8, 1), np.float32)
        actions[1, 3] = np.nan
        with pytest.raises(iwol_sumo.Error, match="vehicle_3 in environment 1 is NaN"):
            env.step(actions)
        # Float64 and other orders in memory are converted.
        actions = np.random.default_rng(0).uniform(-1, 1, (2, 8, 1)).astype(np.float32)
        wanted = env.step(actions)
        for other in (actions.astype(np.float64), np.asfortranarray(actions)):
            env.reset(options={"episode": 0})
            assert all(map(np.array_equal, env.step(other), wanted))


def test_flat_slots_are_a_gymnasium_vector_environment():
    env = iwol_sumo.vec_env("intersection", 2, 8).flatten()
    observation, infos = env.reset(seed=0)
    assert env.observation_space.contains(observation) and infos["active"].all()
    for _ in range(20):
        observation, reward, terminated, truncated, infos = env.step(np.ones((16, 1), np.float32))
        assert env.observation_space.contains(observation)
    assert reward.shape == terminated.shape == truncated.shape == infos["active"].shape == (16,)
    env.close()


def test_flat_actions_of_another_shape_are_refused():
    env = iwol_sumo.vec_env("parking_lot", 2).flatten()
    env.reset(seed=0)
    # As many numbers, with steering and throttle mixed up.
    with pytest.raises(ValueError, match=r"shape \(2, 10\) instead of \(10, 2\)"):
        env.step(np.zeros((2, 10), np.float32))
    env.close()


def test_resets_without_a_seed_go_on_with_new_episodes():
    overrides = {"termination.horizon": 20}
    with iwol_sumo.vec_env("intersection", 2, 8, overrides=overrides) as env, iwol_sumo.parallel_env("intersection", 8) as one:
        begun = [env.reset(seed=3), env.reset()]
        for _ in range(21):
            begun.append(env.step(np.ones((2, 8, 1), np.float32)))
        begun = [*begun[:2], begun[-1], env.reset(), env.flatten().reset()[0].reshape(2, 8, -1)]
        for k, frame in enumerate(begun):
            observation = frame if isinstance(frame, np.ndarray) else frame.observation
            for e in range(2):
                wanted = one.reset(seed=3, options={"episode": 2 * k + e})[0]
                assert np.array_equal(observation[e], np.stack(list(wanted.values()))), (k, e)
        first = env.reset(seed=3)
        assert env.episode_seed == 3 and np.array_equal(first.observation, begun[0].observation)
    with iwol_sumo.vec_env("intersection", 1, 8) as one, iwol_sumo.vec_env("intersection", 1, 8) as two:
        assert not np.array_equal(one.reset().observation, two.reset().observation)
        assert np.array_equal(two.reset(seed=one.episode_seed).observation, one.reset(options={"episode": 0}).observation)


def test_features_are_named():
    with iwol_sumo.vec_env("intersection", 1, 8) as env:
        assert env.features[0].name == "ego.speed" and env.features[0].unit
        assert env.actions == ["throttle"]
        assert "observation.neighbours" in iwol_sumo.settings("intersection")


@pytest.mark.parametrize("steps", [0, 3])
def test_a_reset_after_the_death_of_sumo_starts_another(kill_sumo, steps):
    throttle = np.ones((2, 8, 1), np.float32)
    with iwol_sumo.vec_env("intersection", 2, 8) as env:
        wanted = [env.reset(seed=7), env.step(throttle)]
        env.reset(seed=0)
        for _ in range(steps):
            env.step(throttle)
        kill_sumo()
        found = [env.reset(seed=7), env.step(throttle)]
        for one, other in zip(wanted, found):
            assert all(map(np.array_equal, one, other))


def test_a_reset_after_an_error_of_sumo_starts_another(kill_sumo):
    throttle = np.ones((2, 8, 1), np.float32)
    with iwol_sumo.vec_env("intersection", 2, 8, processes=1) as env:
        wanted = env.reset(seed=7)
        kill_sumo()
        assert env.step(throttle).interrupted.all()
        kill_sumo()
        with pytest.raises(iwol_sumo.SumoError):
            env.step(throttle)
        with pytest.raises(iwol_sumo.Error, match="call reset"):
            env.step(throttle)
        assert all(map(np.array_equal, wanted, env.reset(seed=7)))


def test_a_step_whose_arrays_cannot_be_written_is_not_taken():
    throttle = np.ones((2, 8, 1), np.float32)
    with iwol_sumo.vec_env("intersection", 2, 8) as env:
        env.reset(seed=0)
        wanted = env.step(throttle)
        env.reset(seed=0)
        out = iwol_sumo.Frame(*map(np.zeros_like, wanted))
        fixed = np.zeros_like(out.reward)
        fixed.flags.writeable = False
        for bad in (
            out._replace(reward=fixed),
            out._replace(outcome=np.zeros((2, 8, 2), np.bool_)),
            out._replace(comm=np.asfortranarray(out.comm)),
        ):
            with pytest.raises(iwol_sumo.Error, match="the array `"):
                env.step(throttle, out=bad)
            assert not any(array.any() for array in bad)
        assert all(map(np.array_equal, env.step(throttle, out=out), wanted))


def test_a_close_that_another_thread_prevents_can_be_repeated(sumos):
    env = iwol_sumo.vec_env("intersection", 1, 8)
    env.reset(seed=0)
    [pid] = sumos()
    # The step waits for SUMO.
    os.kill(pid, signal.SIGSTOP)
    thread = threading.Thread(target=env.step, args=(np.ones((1, 8, 1), np.float32),))
    thread.start()
    time.sleep(0.3)
    with pytest.raises(iwol_sumo.Error, match="in use by another thread"):
        env.close()
    os.kill(pid, signal.SIGCONT)
    thread.join()
    env.close()
    assert not sumos()


def test_flat_slots_can_be_closed_again(sumos):
    env = iwol_sumo.vec_env("intersection", 1, 8).flatten()
    for _ in range(2):
        env.reset(seed=0)
        assert sumos()
        env.close()
        assert not sumos()


def test_rejected_numbers_change_nothing():
    for number in (
        {"num_envs": 0},
        {"num_envs": 2.0},
        {"agents": -1},
        {"seed": -1},
        {"processes": -1},
        {"timeout": np.inf},
    ):
        [name] = number
        with pytest.raises(iwol_sumo.Error, match=f"^{name} is .*; allowed: "):
            iwol_sumo.vec_env("intersection", **number)
    with iwol_sumo.vec_env("intersection", 1, 8) as env:
        wanted = env.reset(seed=3)
        for number in (-1, 2**64, 1.5, "3"):
            with pytest.raises(iwol_sumo.Error, match="^seed is"):
                env.reset(seed=number)
            with pytest.raises(iwol_sumo.Error, match="^episode is"):
                env.reset(options={"episode": number})
        assert all(map(np.array_equal, wanted, env.reset(options={"episode": 0})))

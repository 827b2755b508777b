"""Shared by the tests."""

import os
import signal
import subprocess

import pytest

import iwol_sumo


@pytest.fixture
def intersection():
    """One world of the straight intersection among 8."""
    with iwol_sumo.parallel_env("intersection", agents=8) as env:
        yield env


@pytest.fixture
def sumos():
    """Returns a function that lists the SUMO processes which this process has started since."""

    def running():
        command = ["ps", "-o", "pid=,stat=,comm=", "--ppid", str(os.getpid())]
        rows = subprocess.run(command, capture_output=True, text=True).stdout.splitlines()
        parts = [row.split(maxsplit=2) for row in rows]
        lives = [part for part in parts if part[2].startswith("sumo") and part[1][0] != "Z"]
        return {int(part[0]) for part in lives}

    before = running()
    return lambda: running() - before


@pytest.fixture
def kill_sumo(sumos):
    """Returns a function that kills these processes."""

    def kill():
        found = sumos()
        assert found
        for pid in found:
            os.kill(pid, signal.SIGKILL)

    return kill

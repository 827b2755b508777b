"""Shared by the tests."""

import pytest

import iwol_sumo


@pytest.fixture
def intersection():
    """One world of the straight intersection among 8."""
    with iwol_sumo.parallel_env("intersection", agents=8) as env:
        yield env

"""Checks of arguments."""

from __future__ import annotations

import operator
import secrets
from typing import Any

from .errors import ArgumentError, Error


def whole(name: str, value: Any, low: int = 0, high: int = 2**64 - 1, error: type[Error] = ArgumentError) -> int:
    """Returns an argument that is a whole number.

    Raises:
        error: if it is no whole number from `low` to `high`.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    if not low <= number <= high:
        raise error(f"{name} is {value!r}; allowed: whole numbers from {low} to {high}")
    return number


def optional_seed(seed: Any) -> int | None:
    """Returns a seed that may be left out."""
    return None if seed is None else whole("seed", seed)


def drawn_seed() -> int:
    """Returns a seed that no other environment has, from the operating system's randomness."""
    return secrets.randbits(63)

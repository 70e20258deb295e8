"""Checks of arguments that are single numbers or names, for the native module."""

from __future__ import annotations

import operator
from collections.abc import Collection
from typing import Any

import numpy as np

#: The largest count that the native module accepts.
LARGEST = 2**63 - 1


def integer(value: Any, name: str, least: int = 0, most: int = LARGEST) -> int:
    """Return an integer within limits."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {value!r}") from None
    if not least <= number <= most:
        limits = f"at least {least}" if number < least else f"at most {most}"
        raise ValueError(f"{name} must be {limits}, got {number}")
    return number


def integer_or_none(value: Any, name: str, least: int = 0, most: int = LARGEST) -> int | None:
    """Return an integer within limits, or None."""
    return None if value is None else integer(value, name, least, most)


def real(value: Any, name: str) -> float:
    """Return a real number."""
    # A string is refused even if it could be read as a number, because it is probably a mistake.
    if not isinstance(value, (str, bytes)) and np.ndim(value) == 0:
        try:
            return float(value)
        except (TypeError, ValueError):
            pass
    raise TypeError(f"{name} must be a number, got {value!r}")


def real_or_none(value: Any, name: str) -> float | None:
    """Return a real number, or None."""
    return None if value is None else real(value, name)


def boolean(value: Any, name: str) -> bool:
    """Return a bool."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def text(value: Any, name: str) -> str:
    """Return a string."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {value!r}")
    return str(value)


def choice(value: Any, name: str, known: Collection[str]) -> str:
    """Return one of the known strings."""
    if text(value, name) not in known:
        *most, last = known
        raise ValueError(f"{name} must be {', '.join(most)} or {last}, got {value}")
    return str(value)


def choice_or_none(value: Any, name: str, known: Collection[str]) -> str | None:
    """Return one of the known strings, or None."""
    return None if value is None else choice(value, name, known)

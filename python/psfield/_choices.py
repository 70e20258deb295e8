"""Arguments that are single numbers or words, as the native module takes them."""

from __future__ import annotations

import operator
from collections.abc import Collection
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

#: The largest number of things that the native module counts.
MOST = 2**63 - 1


def whole(value: Any, name: str, least: int = 0, most: int = MOST) -> int:
    """Return a whole number within limits."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be a whole number, got {value!r}") from None
    if not least <= number <= most:
        limits = f"at least {least}" if number < least else f"at most {most}"
        raise ValueError(f"{name} must be {limits}, got {number}")
    return number


def whole_or_none(value: Any, name: str, least: int = 0, most: int = MOST) -> int | None:
    """Return a whole number within limits, or None."""
    return None if value is None else whole(value, name, least, most)


def real(value: Any, name: str) -> float:
    """Return a real number."""
    # A text that reads as a number is a mistake.
    if not isinstance(value, (str, bytes)) and np.ndim(value) == 0:
        try:
            return float(value)
        except (TypeError, ValueError):
            pass
    raise TypeError(f"{name} must be a number, got {value!r}")


def real_or_none(value: Any, name: str) -> float | None:
    """Return a real number, or None."""
    return None if value is None else real(value, name)


def pair_or_none(value: Any, name: str) -> tuple[float, float] | None:
    """Return two real numbers x and y, or None."""
    if value is None:
        return None
    try:
        x, y = value
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be two numbers (x, y), got {value!r}") from None
    return real(x, f"{name}: x"), real(y, f"{name}: y")


def yes_or_no(value: Any, name: str) -> bool:
    """Return a bool."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def word(value: Any, name: str, known: Collection[str] = ()) -> str:
    """Return a text; one of those that are known, where these are given."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a text, got {value!r}")
    if known and value not in known:
        *most, last = known
        raise ValueError(f"{name} must be {', '.join(most)} or {last}, got {value}")
    return str(value)


def word_or_none(value: Any, name: str) -> str | None:
    """Return a text, or None."""
    return None if value is None else word(value, name)

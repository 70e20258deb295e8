"""American spellings, accepted for arguments that the package spells the British way."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, Literal, ParamSpec, TypedDict, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class American(TypedDict, total=False):
    """The American keyword arguments, for type checkers."""

    center: tuple[float, float] | None
    centering: Literal["mean", "none"] | None
    field_center: tuple[float, float] | None
    normalize: Literal["unit", "keep"] | None


#: The British spelling of each American keyword argument.
_ARGUMENTS = {
    "center": "centre",
    "centering": "centring",
    "field_center": "field_centre",
    "normalize": "normalise",
}
#: The British spelling of each American value.
_VALUES = {"neighbors": "neighbours", "natural-neighbor": "natural-neighbour"}


def american(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function accept American spellings of its keyword arguments.

    The function declares ``**american: Unpack[American]`` for type checkers. It never receives
    values through this parameter.
    """
    signature = inspect.signature(function)
    parameters = [p for p in signature.parameters.values() if p.name != "american"]
    known = {p.name for p in parameters}

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        renamed: dict[str, Any] = {}
        for name, value in kwargs.items():
            british = name if name in known else _ARGUMENTS.get(name)
            if british not in known:
                raise TypeError(f"{function.__name__}() has no argument {name!r}")
            if british in renamed:
                raise TypeError(f"{british} is given in two spellings: give one of them")
            renamed[british] = value
        return function(*args, **renamed)

    call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return call


def british(value: Any) -> Any:
    """Return the British spelling of a value that has an American one, else the value itself."""
    return _VALUES.get(value, value) if isinstance(value, str) else value

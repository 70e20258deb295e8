"""Progress of long calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias


class Bar(Protocol):
    """A progress bar, such as those of tqdm."""

    total: Any

    def update(self, n: float = ...) -> Any: ...


#: A function ``progress(done, total)``, or a bar of tqdm.
Progress: TypeAlias = Callable[[int, int], object] | Bar


def as_callback(progress: Progress | None) -> Callable[[int, int], object] | None:
    """Return the function that the native module calls with the steps done and their total."""
    if progress is None or callable(progress):
        return progress
    bar = progress
    if not hasattr(bar, "update"):
        kind = type(bar).__name__
        raise TypeError(f"progress must be a function or a bar with a method update, got {kind}")
    seen = 0

    def update(done: int, total: int) -> None:
        nonlocal seen
        bar.total = total
        bar.update(done - seen)
        seen = done

    return update

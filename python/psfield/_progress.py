"""Progress of long calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias


class Bar(Protocol):
    """A progress bar as tqdm makes them."""

    total: Any

    def update(self, n: float = ...) -> Any: ...


#: ``progress(done, total)``, or a bar of tqdm.
Progress: TypeAlias = Callable[[int, int], object] | Bar


def as_callback(progress: Progress | None) -> Callable[[int, int], object] | None:
    """Return what the native module calls with the steps done and their total."""
    if progress is None or callable(progress):
        return progress
    bar = progress
    if not hasattr(bar, "update"):
        raise TypeError(f"progress must be callable, or a bar with a method update, got {type(bar).__name__}")
    seen = 0

    def told(done: int, total: int) -> None:
        nonlocal seen
        bar.total = total
        bar.update(done - seen)
        seen = done

    return told

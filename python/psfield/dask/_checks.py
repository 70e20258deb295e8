"""What is refused before any worker sees it."""

from __future__ import annotations

from typing import Any

from psfield._arrays import DTYPES
from psfield._model import PsfModel


def check_choices(
    model: Any, tolerance: Any, precision: Any, device: Any, anchor: Any, method: Any, oversample: Any, stamp_size: Any
) -> None:
    """Refuse early what the workers' plans would refuse late."""
    if not isinstance(model, PsfModel):
        raise TypeError(f"model must be a PsfModel, got {type(model).__name__}")
    if not 0 <= tolerance < 1:
        raise ValueError(f"tolerance must be at least 0 and below 1, got {tolerance}")
    for name, value, known in (
        ("precision", precision, tuple(DTYPES)),
        ("device", device, ("auto", "cpu", "gpu")),
        ("anchor", anchor, ("source", "output")),
        ("method", method, ("auto", "lowrank")),
    ):
        if value not in known:
            raise ValueError(f"{name} must be {', '.join(known[:-1])} or {known[-1]}, got {value!r}")
    for name, value in (("oversample", oversample), ("stamp_size", 1 if stamp_size is None else stamp_size)):
        if value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}")

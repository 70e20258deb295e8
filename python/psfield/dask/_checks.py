"""What is refused before any worker sees it."""

from __future__ import annotations

from typing import Any

from psfield._arrays import DTYPES
from psfield._choices import real, whole, whole_or_none, word
from psfield._model import PsfModel


def check_choices(
    model: Any, tolerance: Any, precision: Any, device: Any, anchor: Any, method: Any, oversample: Any, stamp_size: Any, memory: Any
) -> None:
    """Refuse early what the workers' plans would refuse late."""
    if not isinstance(model, PsfModel):
        raise TypeError(f"model must be a PsfModel, got {type(model).__name__}")
    if not 0 <= real(tolerance, "tolerance") < 1:
        raise ValueError(f"tolerance must be at least 0 and below 1, got {tolerance}")
    word(precision, "precision", DTYPES)
    word(device, "device", ("auto", "cpu", "gpu"))
    word(anchor, "anchor", ("source", "output"))
    word(method, "method", ("auto", "lowrank"))
    whole(oversample, "oversample", 1)
    whole_or_none(stamp_size, "stamp_size", 1)
    whole(memory, "memory")

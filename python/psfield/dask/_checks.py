"""What is refused before any worker sees it."""

from __future__ import annotations

from typing import Any

from psfield._model import PsfModel
from psfield._plan import checked


def checked_for_workers(model: Any, **words: Any) -> dict[str, Any]:
    """Return the arguments of the workers' plans by name; refuse early what these would refuse late."""
    if not isinstance(model, PsfModel):
        raise TypeError(f"model must be a PsfModel, got {type(model).__name__}")
    found = checked(words)
    if not 0 <= found["tolerance"] < 1:
        raise ValueError(f"tolerance must be at least 0 and below 1, got {words['tolerance']}")
    return found

"""Checks of arguments on the client, before any worker receives them."""

from __future__ import annotations

from typing import Any

from psfield._model import PsfModel
from psfield._plan import checked


def checked_for_workers(model: Any, **settings: Any) -> dict[str, Any]:
    """Return the arguments of the plans by name. Refuse values that workers would refuse later."""
    if not isinstance(model, PsfModel):
        raise TypeError(f"model must be a PsfModel, got {type(model).__name__}")
    found = checked(settings)
    if not 0 <= found["tolerance"] < 1:
        tolerance = settings["tolerance"]
        raise ValueError(f"tolerance must be at least 0 and below 1, got {tolerance}")
    return found

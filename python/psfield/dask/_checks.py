"""Checks of arguments on the client, before any worker receives them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from psfield._model import PsfModel
from psfield._plan import checked


def checked_for_workers(model: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of the plans among others. Refuse what workers would refuse later."""
    if not isinstance(model, PsfModel):
        raise TypeError(f"model must be a PsfModel, got {type(model).__name__}")
    return checked(given)

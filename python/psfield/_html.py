"""Tables that notebooks show in place of the text of an object."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from html import escape
from typing import Any


def table(title: str, rows: Mapping[str, Any]) -> str:
    """Return an HTML table of names and values. Rows without a value are left out."""
    lines = (
        f"<tr><th>{escape(name)}</th><td>{escape(_text(value))}</td></tr>"
        for name, value in rows.items()
        if value is not None
    )
    return f"<table><caption>{escape(title)}</caption>{''.join(lines)}</table>"


def size(shape: tuple[int, int]) -> str:
    """Return rows and columns in words."""
    rows, columns = shape
    return f"{rows} x {columns} (rows x columns)"


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class FieldsAsTable:
    """A dataclass that notebooks show as a table of its fields."""

    def _repr_html_(self) -> str:
        assert dataclasses.is_dataclass(self)
        names = [field.name for field in dataclasses.fields(self)]
        return table(type(self).__name__, {name: getattr(self, name) for name in names})

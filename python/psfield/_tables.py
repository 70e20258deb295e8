"""Tables of any kind, by the names of their columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

#: Other names of columns. Photutils calls positions x_0 and y_0.
OTHER_NAMES = {"x": "x_0", "y": "y_0"}


def column_names(table: Any) -> list[Any] | None:
    """Return the names of the columns, or None for anything that is not a table.

    Tables are astropy Tables, structured arrays, dicts of columns and data frames.
    """
    names = getattr(table, "colnames", None)
    if names is None:
        names = getattr(getattr(table, "dtype", None), "names", None)
    if names is None and hasattr(table, "keys"):
        names = table.keys()
    if names is None:
        names = getattr(table, "columns", None)
    return None if names is None else list(names)


def find_columns(names: list[Any], roles: Sequence[str], table: str) -> dict[str, Any]:
    """Return the name of the column of each role that the table has.

    Upper and lower case are the same, unless columns differ only in case. Then the column with
    exactly the name of the role is used.
    """
    found: dict[str, Any] = {}
    for role in roles:
        for wanted in (role, OTHER_NAMES.get(role)):
            same = [name for name in names if str(name).lower() == wanted]
            exact = [name for name in same if str(name) == wanted]
            if len(same) > 1 and not exact:
                raise ValueError(
                    f"{table}: {same[0]} and {same[1]} could both be the column {role}:"
                    " rename one of them"
                )
            if same:
                found[role] = (exact or same)[0]
                break
    return found

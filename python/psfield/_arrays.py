"""Arrays as the native module takes them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from psfield._astropy import in_unit

#: The types of the two precisions.
DTYPES: dict[str, np.dtype[Any]] = {"f32": np.dtype(np.float32), "f64": np.dtype(np.float64)}


def plain(values: Any, name: str) -> NDArray[Any]:
    """Return an array without its unit, mask or wrapping; what a mask hides is an error."""
    if not isinstance(values, np.ndarray) and isinstance(getattr(values, "data", None), np.ndarray):
        # astropy's NDData and CCDData.
        mask, values = getattr(values, "mask", None), values.data
    elif isinstance(values, np.ma.MaskedArray):
        mask, values = np.ma.getmaskarray(values), values.data
    elif hasattr(values, "unit") and hasattr(values, "mask") and hasattr(values, "unmasked"):
        # astropy's Masked.
        mask, values = values.mask, values.unmasked
    elif hasattr(values, "array") and not isinstance(values, np.ndarray):
        # GalSim's Image.
        mask, values = None, values.array
    else:
        mask = None
    if mask is not None and np.any(mask):
        raise ValueError(f"{name}: {np.count_nonzero(mask)} values are masked: fill them first")
    # A Quantity is an array whose subclass holds the unit.
    return np.asarray(getattr(values, "value", values) if hasattr(values, "unit") else values)


def check_real(array: Any, name: str) -> None:
    """Refuse what is no array of real numbers."""
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name} must be real numbers, got {array.dtype}")


def reals(values: Any, name: str) -> NDArray[np.float64]:
    """Return doubles of any shape, aligned, in the machine's byte order; without a copy where they are that already."""
    array = plain(values, name)
    check_real(array, name)
    return np.require(array, dtype=DTYPES["f64"], requirements="A")


def numbers(values: Any, name: str, dtype: np.dtype[Any], axes: str) -> NDArray[Any]:
    """Return real numbers of a type, aligned, in the machine's byte order; without a copy where they are that already.

    ``axes`` names the axes that there must be, as in ``"[y, x]"``.
    """
    array = plain(values, name)
    check_real(array, name)
    expected = axes.count(",") + 1
    if array.ndim != expected:
        raise ValueError(f"{name} must be an array {axes}, got one of shape {array.shape}")
    if array.size == 0:
        raise ValueError(f"{name} is empty: its shape is {array.shape}")
    with np.errstate(over="ignore"):
        converted = np.require(array, dtype=dtype, requirements="A")
    if converted is not array and not np.all(np.isfinite(converted)) and np.all(np.isfinite(array)):
        raise ValueError(f"{name}: values beyond single precision: choose precision='f64'")
    return converted


def doubles(values: Any, name: str, axes: str) -> NDArray[np.float64]:
    """Return doubles, as `numbers` does."""
    return numbers(values, name, DTYPES["f64"], axes)


def column(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return a column of doubles, which may be empty."""
    return np.atleast_1d(reals(values, name))


def points(positions: Any, name: str = "positions") -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the coordinates x and y of positions: an array ``[position, (x, y)]``, or a table with columns x and y."""
    columns = getattr(positions, "colnames", None) or getattr(getattr(positions, "dtype", None), "names", None)
    if columns is not None or isinstance(positions, dict) or hasattr(positions, "columns"):
        try:
            x, y = positions["x"], positions["y"]
        except (KeyError, ValueError, IndexError):
            raise ValueError(f"{name} must be a table with columns x and y, or an array [position, 2]") from None
        return column(in_unit(x, "pix", f"{name}: x"), f"{name}: x"), column(in_unit(y, "pix", f"{name}: y"), f"{name}: y")
    array = doubles(in_unit(positions, "pix", name), name, "[position, 2]")
    if array.shape[1] != 2:
        raise ValueError(f"{name} must be an array [position, 2] of x and y, got one of shape {array.shape}")
    return np.ascontiguousarray(array[:, 0]), np.ascontiguousarray(array[:, 1])


def shape_of(shape: Any, name: str) -> tuple[int, int]:
    """Return rows and columns of a shape ``(ny, nx)``, or of a square where it is one number."""
    try:
        ny, nx = (shape, shape) if np.ndim(shape) == 0 else shape
        rows, columns = (int(np.asarray(n).__index__()) for n in (ny, nx))
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be (ny, nx), two whole numbers, got {shape!r}") from None
    if rows < 1 or columns < 1:
        raise ValueError(f"{name} must be at least (1, 1), got {(rows, columns)}")
    return rows, columns


def shape_or_none(shape: Any, name: str) -> tuple[int, int] | None:
    """Return rows and columns of a shape, or None."""
    return None if shape is None else shape_of(shape, name)

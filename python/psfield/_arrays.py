"""Arrays in the form that the native module accepts."""

from __future__ import annotations

import contextlib
from typing import Any, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from psfield._astropy import in_unit
from psfield._tables import column_names, find_columns

#: The working precision: single or double.
Precision: TypeAlias = (
    Literal["f32", "f64", "float32", "float64"]
    | type[np.float32]
    | type[np.float64]
    | np.dtype[np.float32]
    | np.dtype[np.float64]
)

#: The types of the two precisions.
DTYPES: dict[str, np.dtype[Any]] = {"f32": np.dtype(np.float32), "f64": np.dtype(np.float64)}


def precision_of(precision: Any, name: str) -> Literal["f32", "f64"]:
    """Return the name of a precision that is given by its name or as a type of NumPy."""
    dtype = DTYPES.get(precision) if isinstance(precision, str) else None
    if dtype is None and precision is not None:
        with contextlib.suppress(TypeError):
            dtype = np.dtype(precision).newbyteorder("=")
    for known, of_known in DTYPES.items():
        if dtype is not None and dtype == of_known:
            return cast(Literal["f32", "f64"], known)
    error = TypeError if dtype is None and not isinstance(precision, str) else ValueError
    raise error(f"{name} must be f32 or f64 (float32, numpy.float64, ...), got {precision!r}")


def plain(values: Any, name: str) -> NDArray[Any]:
    """Return an array without its unit, mask or container. Masked values are an error."""
    if not isinstance(values, np.ndarray) and isinstance(getattr(values, "data", None), np.ndarray):
        # astropy's NDData and CCDData.
        mask, values = getattr(values, "mask", None), values.data
    elif isinstance(values, np.ma.MaskedArray):
        mask, values = np.ma.getmaskarray(values), values.data
    elif hasattr(values, "mask") and hasattr(values, "unmasked"):
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
    """Refuse an array of anything but real numbers."""
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name} must be real numbers, got {array.dtype}")


def reals(values: Any, name: str) -> NDArray[np.float64]:
    """Return an aligned array of doubles of any shape, in the byte order of the machine.

    An array that is already of this form is not copied.
    """
    array = plain(values, name)
    check_real(array, name)
    return np.require(array, dtype=DTYPES["f64"], requirements="A")


def with_missing(values: Any, name: str) -> NDArray[np.float64]:
    """Return an array of doubles, as `reals` does, in which missing and masked values are NaN."""
    if hasattr(values, "isna") and hasattr(values, "to_numpy"):
        # A column of pandas. Whole numbers with missing values are objects for NumPy.
        with contextlib.suppress(TypeError, ValueError):
            values = values.to_numpy(dtype=np.float64, na_value=np.nan)
    mask = getattr(values, "mask", None)
    known = np.ma.isMaskedArray(values) or hasattr(values, "unmasked")
    if not known or not isinstance(mask, np.ndarray) or not mask.any():
        return reals(values, name)
    shown = np.ma.getdata(values) if np.ma.isMaskedArray(values) else values.unmasked
    return np.where(mask, np.nan, reals(shown, name))


def numbers(values: Any, name: str, dtype: np.dtype[Any], axes: str) -> NDArray[Any]:
    """Return an aligned array of real numbers of one type, in the byte order of the machine.

    An array that is already of this form is not copied. ``axes`` names the axes that the array must
    have, as in ``"[y, x]"``.
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
        raise ValueError(f"{name}: values beyond single precision (3.4e38): choose precision='f64'")
    return converted


def doubles(values: Any, name: str, axes: str) -> NDArray[np.float64]:
    """Return doubles, as `numbers` does."""
    return numbers(values, name, DTYPES["f64"], axes)


def stack(stamps: Any, name: str, axes: str) -> NDArray[np.float64]:
    """Return stamps ``[stamp, y, x]`` as doubles. A single stamp ``[y, x]`` is a stack of one."""
    if isinstance(stamps, (list, tuple)):
        arrays = [plain(stamp, f"{name}[{i}]") for i, stamp in enumerate(stamps)]
        if not arrays:
            raise ValueError(f"{name} is empty: give at least one stamp")
        if shapes := {array.shape for array in arrays} - {arrays[0].shape}:
            raise ValueError(
                f"{name} must all have one shape, got {arrays[0].shape} and {min(shapes)}"
            )
        stamps = np.stack(arrays)
    array = plain(stamps, name)
    return doubles(array[np.newaxis] if array.ndim == 2 else array, name, axes)


def column(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return a column of doubles, which may be empty."""
    return np.atleast_1d(reals(values, name))


def points(
    positions: Any, name: str = "positions"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the coordinates x and y of positions.

    Positions are an array ``[position, (x, y)]``, a single pair ``(x, y)``, or a table with columns
    x and y.
    """
    names = column_names(positions)
    if names is not None:
        found = find_columns(names, ("x", "y"), name)
        if len(found) < 2:
            raise ValueError(
                f"{name} must be a table with columns x and y, or an array [position, 2]"
            )
        x, y = (
            column(in_unit(positions[found[axis]], "pix", f"{name}: {axis}"), f"{name}: {axis}")
            for axis in ("x", "y")
        )
        return x, y
    array = plain(in_unit(positions, "pix", name), name)
    array = doubles(array[np.newaxis] if array.shape == (2,) else array, name, "[position, 2]")
    if array.shape[1] != 2:
        raise ValueError(
            f"{name} must be an array [position, 2] of x and y, got one of shape {array.shape}"
        )
    return np.ascontiguousarray(array[:, 0]), np.ascontiguousarray(array[:, 1])


def shape_of(shape: Any, name: str) -> tuple[int, int]:
    """Return rows and columns of a shape ``(ny, nx)``. A single number is the side of a square."""
    try:
        ny, nx = (shape, shape) if np.ndim(shape) == 0 else shape
        rows, columns = (int(np.asarray(n).__index__()) for n in (ny, nx))
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be (ny, nx), two integers, got {shape!r}") from None
    if rows < 1 or columns < 1:
        raise ValueError(f"{name} must be at least (1, 1), got {(rows, columns)}")
    return rows, columns


def shape_or_none(shape: Any, name: str) -> tuple[int, int] | None:
    """Return rows and columns of a shape, or None."""
    return None if shape is None else shape_of(shape, name)

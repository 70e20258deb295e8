"""Catalogues of stars and galaxies."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._arrays import reals
from psfield._astropy import check_linear, in_unit
from psfield._errors import PsfieldWarning

Column = NDArray[np.float64]
#: x, y, flux, re, n, q, angle by name; what there is not is None.
Columns = dict[str, Column | None]

_NEEDED = ("x", "y", "flux")
_SHAPE = ("re", "n", "q", "angle")


def read_catalog(
    path: str | os.PathLike[str],
    *,
    columns: str | None = None,
    one_based: bool = False,
    zero_point: float | None = None,
    skip_invalid: bool = False,
    table: str | int | None = None,
    wcs: str | os.PathLike[str] | None = None,
    wcs_extension: str | int | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Read stars and galaxies from a CSV, text or FITS table, as ``psfield simulate --catalog`` does.

    Parameters
    ----------
    path : path
        CSV, blank-separated text, SExtractor (``ASCII_HEAD``, ``FITS_LDAC``) or a FITS table.
    columns : str, optional
        Which columns mean what, as in ``"x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO"``. The roles are x, y (or ra, dec), flux (or mag), and for
        galaxies re, n, q, angle; without it each role uses the column of its own name.
    one_based : bool
        Pixels count from 1, as SExtractor's and those of FITS do.
    zero_point : float, optional
        The magnitude of flux 1.
    skip_invalid : bool
        Leave out rows that make no source, with a warning, in place of an error.
    table : str or int, optional
        Which table of a FITS file: its number from 0, or its name.
    wcs : path, optional
        A FITS file whose header has the frame's world coordinates, for ``ra`` and ``dec`` in degrees.
    wcs_extension : str or int, optional
        Which header of that file.

    Returns
    -------
    dict of str to numpy.ndarray
        Columns ``x``, ``y`` (0-based pixels) and ``flux``, and where there are galaxies ``re`` (half-light radius along the major
        axis in pixels; 0 for a star), ``n``, ``q`` and ``angle`` (degrees from +x towards +y). Stars come first.

    Raises
    ------
    OSError
        The file cannot be read, or a row or column of it is not as it should be.
    ValueError
        Options that contradict each other.
    """
    stars, galaxies, invalid, off_projection = _native.read_catalog(
        os.fspath(path),
        columns,
        one_based,
        zero_point,
        skip_invalid,
        None if table is None else str(table),
        None if wcs is None else os.fspath(wcs),
        None if wcs_extension is None else str(wcs_extension),
    )
    if invalid:
        warnings.warn(f"{os.fspath(path)}: {invalid} rows make no source and were left out", PsfieldWarning, stacklevel=2)
    if off_projection:
        warnings.warn(
            f"{os.fspath(path)}: {off_projection} rows lie on a part of the sky that the projection does not show",
            PsfieldWarning,
            stacklevel=2,
        )
    catalog = dict(zip(_NEEDED, stars, strict=True))
    if len(galaxies[0]):
        of_star = {"re": 0.0, "n": np.nan, "q": 1.0, "angle": 0.0}
        catalog = {name: np.concatenate([stars[i], galaxies[i]]) for i, name in enumerate(_NEEDED)}
        for i, name in enumerate(_SHAPE):
            catalog[name] = np.concatenate([np.full(len(stars[0]), of_star[name]), galaxies[len(_NEEDED) + i]])
    return catalog


def columns_of(catalog: Any, unit: Any = None) -> Columns | None:
    """Return the columns of a table of any kind; fluxes in ``unit`` where they have one."""
    if catalog is None:
        return None
    names = _names(catalog)
    if missing := [name for name in _NEEDED if name not in names]:
        there = ", ".join(map(str, names.values())) or "none"
        raise ValueError(f"catalog: there is no column {missing[0]} (needed: x, y, flux; for galaxies re, n, q, angle); there are {there}")
    columns = {name: _column(catalog[names[name]], name, unit) if name in names else None for name in (*_NEEDED, *_SHAPE)}
    if columns["re"] is not None and columns["n"] is None:
        raise ValueError("catalog: galaxies (column re) need their Sersic index (column n)")
    return columns


def _names(catalog: Any) -> dict[str, Any]:
    """Return the names of the columns by their lower case."""
    if (colnames := getattr(catalog, "colnames", None)) is not None:
        names: Iterable[Any] = colnames
    elif getattr(getattr(catalog, "dtype", None), "names", None):
        names = catalog.dtype.names
    elif hasattr(catalog, "keys"):
        names = catalog.keys()
    else:
        kinds = "a dict of arrays, an astropy Table, a structured array, a data frame"
        raise TypeError(f"catalog must be a table with columns x, y, flux ({kinds}), got {type(catalog).__name__}")
    found: dict[str, Any] = {}
    for name in names:
        role = str(name).lower()
        # A column of the very name comes before those that differ in case.
        if role not in found or str(name) == role:
            found[role] = name
        elif str(found[role]) != role and role in (*_NEEDED, *_SHAPE):
            raise ValueError(f"catalog: which column is {role}: {found[role]} or {name}? Rename one of them")
    return found


def _column(values: Any, name: str, unit: Any) -> Column:
    if name == "flux":
        check_linear(getattr(values, "unit", None), "catalog: flux")
    wanted = {"x": "pix", "y": "pix", "re": "pix", "angle": "deg", "flux": unit}.get(name)
    values = in_unit(values, wanted, f"catalog: {name}")
    if name in _SHAPE and np.ma.isMaskedArray(values):
        # No shape: a star.
        values = np.ma.asarray(values, dtype=np.float64).filled(np.nan)
    array = reals(values, f"catalog: {name}")
    if array.ndim != 1:
        raise ValueError(f"catalog: {name} must be a column, got an array of shape {array.shape}")
    return array

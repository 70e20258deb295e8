"""Catalogues of stars and galaxies."""

from __future__ import annotations

import contextlib
import os
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._arrays import reals
from psfield._astropy import check_linear, in_unit
from psfield._errors import PsfieldWarning
from psfield._sky import Sky, is_sky, sky_of
from psfield._tables import OTHER_NAMES, column_names, find_columns

Column = NDArray[np.float64]
#: The columns x, y, flux, re, n, q, angle, g1 and g2 by name. A missing column is None.
Columns = dict[str, Column | None]

_NEEDED = ("x", "y", "flux")
_SHAPE = ("re", "n", "q", "angle")
_SHEAR = ("g1", "g2")
_OFF_PROJECTION = "outside the projection of the world coordinates"


def read_catalog(
    path: str | os.PathLike[str],
    *,
    columns: str | None = None,
    one_based: bool = False,
    zero_point: float | None = None,
    skip_invalid: bool = False,
    table: str | int | None = None,
    wcs: Any = None,
    wcs_extension: str | int | None = None,
) -> dict[str, NDArray[np.float64]]:
    r"""Read stars and galaxies from a text table or a FITS table.

    Parameters
    ----------
    path : path
        CSV, ECSV, text separated by blanks, SExtractor's ``ASCII_HEAD`` and ``FITS_LDAC``, or a
        binary table of a FITS file.
    columns : str, optional
        The column of each role, as in ``"x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO"``. The roles are x and y
        (or ra and dec), flux (or mag), and re, n, q, angle, g1 and g2 for galaxies. By default each
        role uses the column of its own name. Positions may also be called ``x_0`` and ``y_0``.
    one_based : bool
        The first pixel is 1, as in SExtractor and FITS.
    zero_point : float, optional
        The magnitude of flux 1.
    skip_invalid : bool
        Skip rows that are not valid sources, with a warning, instead of raising an error. A row
        without ``re`` in a table of galaxies, or with flux 0, is not valid.
    table : str or int, optional
        The table of a FITS file: its number from 0, or its name.
    wcs : astropy.wcs.WCS or path, optional
        World coordinates of the frame, or a FITS file with them, for positions ``ra`` and ``dec``
        in degrees.
    wcs_extension : str or int, optional
        The extension of the file ``wcs``: its number or its name.

    Returns
    -------
    dict of str to numpy.ndarray
        Columns ``x``, ``y`` (0-based pixels) and ``flux``. If there are galaxies, also ``re``
        (half-light radius along the major axis in pixels, 0 for a star), ``n``, ``q`` and ``angle``
        (degrees from +x towards +y). They include the reduced shear ``g1``, ``g2`` of the file.
        Stars come first.

    Raises
    ------
    OSError
        The file cannot be read, a column is missing, or a row is invalid.
    ValueError
        An argument is invalid, or arguments contradict each other.

    Warns
    -----
    PsfieldWarning
        Rows were skipped.

    Examples
    --------
    >>> import pathlib
    >>> import psfield
    >>> _ = pathlib.Path("stars.csv").write_text("X_IMAGE,Y_IMAGE,MAG_AUTO\n3,2,20\n")
    >>> stars = psfield.read_catalog(
    ...     "stars.csv", columns="x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO", one_based=True, zero_point=25
    ... )
    >>> stars["x"].tolist(), stars["y"].tolist(), stars["flux"].round(6).tolist()
    ([2.0], [1.0], [100.0])
    """
    path = os.fspath(path)
    wcs_path = os.fspath(wcs) if is_path(wcs) else None
    sky = None if is_path(wcs) else sky_of(None, wcs, 1, (0, 0))
    cards = None if sky is None else sky.cards()

    def read(columns: str | None) -> tuple[list[Column], list[Column], int, int]:
        return _native.read_catalog(
            path,
            columns,
            one_based,
            zero_point,
            skip_invalid,
            None if table is None else str(table),
            wcs_path,
            None if wcs_extension is None else str(wcs_extension),
            cards,
        )

    found = None
    try:
        found = read(columns)
    except OSError:
        others = [f"{role}={name}" for role, name in OTHER_NAMES.items()]
        with contextlib.suppress(OSError, ValueError):
            found = read(",".join(others if columns is None else [*others, columns]))
        if found is None:
            raise
    stars, galaxies, invalid, outside = found
    _warn_of_skipped(invalid, path, "invalid", 2)
    _warn_of_skipped(outside, path, _OFF_PROJECTION, 2)
    catalog = dict(zip(_NEEDED, stars, strict=True))
    if len(galaxies[0]):
        of_star = {"re": 0.0, "n": np.nan, "q": 1.0, "angle": 0.0}
        catalog = {name: np.concatenate([stars[i], galaxies[i]]) for i, name in enumerate(_NEEDED)}
        for i, name in enumerate(_SHAPE):
            in_stars = np.full(len(stars[0]), of_star[name])
            catalog[name] = np.concatenate([in_stars, galaxies[len(_NEEDED) + i]])
    return catalog


def _warn_of_skipped(count: int, catalog: str, problem: str, stacklevel: int) -> None:
    """Warn of rows that were left out, if there are any. ``stacklevel`` is that of the caller."""
    if count:
        rows = "row" if count == 1 else "rows"
        text = f"{catalog}: {count} {rows} skipped: {problem}"
        warnings.warn(text, PsfieldWarning, stacklevel=stacklevel + 1)


def is_path(value: Any) -> bool:
    """Return whether a value is the path of a file."""
    return isinstance(value, (str, os.PathLike))


def columns_of(catalog: Any, unit: Any = None, sky: Sky | None = None) -> Columns | None:
    """Return the columns of a catalogue: a table of any kind, or the path of a file.

    Fluxes that have a unit are converted to ``unit``. A single number in place of a column holds
    for every row. ``sky`` gives positions on the sky their pixels.
    """
    if catalog is None:
        return None
    if is_path(catalog):
        # A file of pixel positions needs no world coordinates, and gwcs has none for files.
        has_cards = sky is not None and hasattr(sky.wcs, "to_header")
        catalog = read_catalog(catalog, wcs=sky if has_cards else None)
    names = column_names(catalog)
    if names is None:
        raise TypeError(
            "catalog must be the path of a file or a table with columns x, y and flux (a dict of"
            " arrays, an astropy Table, a structured array, a data frame),"
            f" got {type(catalog).__name__}"
        )
    roles = (*_NEEDED, *_SHAPE, *_SHEAR)
    found = find_columns(names, roles, "catalog")
    place = None if "x" in found or "y" in found else _place_on_sky(catalog, names)
    if place is not None:
        # From here on, the pixels are columns of the table.
        catalog = {name: catalog[name] for name in names}
        catalog["x"], catalog["y"] = _pixels_of(place, sky)
        found |= {"x": "x", "y": "y"}
    if missing := [role for role in _NEEDED if role not in found]:
        if missing == ["flux"] and find_columns(names, ("mag",), "catalog"):
            raise ValueError(
                "catalog: there is no column flux, only magnitudes: set flux = 10**(-0.4 * (mag -"
                " zero_point)), or read the file with read_catalog(..., zero_point=)"
            )
        raise ValueError(
            f"catalog: there is no column {missing[0]}. A catalogue needs x and y (or ra and dec,"
            " or a SkyCoord) and flux, and for galaxies re and n. The columns are"
            f" {', '.join(map(str, names)) or 'none'}"
        )
    if "re" in found and "n" not in found:
        raise ValueError("catalog: galaxies (column re) need their Sersic index (column n)")
    if "re" not in found:
        # Stars have no shear. A column g1 or g2 of a table of stars may mean anything.
        found = {role: name for role, name in found.items() if role not in _SHEAR}
    elif ("g1" in found) != ("g2" in found):
        lacking = "g2" if "g1" in found else "g1"
        raise ValueError(f"catalog: a shear needs both columns g1 and g2, there is no {lacking}")
    arrays = {role: _column(catalog[name], role, unit) for role, name in found.items()}
    rows = max((array.size for array in arrays.values() if array.ndim == 1), default=1)
    columns: Columns = dict.fromkeys(roles)
    columns |= {
        role: array if array.ndim else np.full(rows, array) for role, array in arrays.items()
    }
    return columns if place is None else _on_projection(columns)


def _place_on_sky(catalog: Any, names: list[Any]) -> Any:
    """Return the SkyCoord of a table, or its columns ra and dec in degrees, or None."""
    found = find_columns(names, ("ra", "dec"), "catalog")
    if len(found) == 2:
        return tuple(
            reals(in_unit(catalog[name], "deg", f"catalog: {role}"), f"catalog: {role}")
            for role, name in found.items()
        )
    places = [name for name in names if is_sky(catalog[name])]
    if len(places) > 1:
        raise ValueError(
            f"catalog: {places[0]} and {places[1]} are both positions on the sky: remove one"
        )
    return catalog[places[0]] if places else None


def _pixels_of(place: Any, sky: Sky | None) -> tuple[Column, Column]:
    if sky is None:
        raise ValueError(
            "catalog: its positions are on the sky: give the world coordinates of the image, wcs=,"
            " or a scene that has them (CCDData)"
        )
    return sky.pixels(place)


def _on_projection(columns: Columns) -> Columns:
    """Leave out the sources for which the projection has no pixel, with a warning."""
    known = np.isfinite(columns["x"]) & np.isfinite(columns["y"])  # type: ignore[arg-type]
    if known.all():
        return columns
    _warn_of_skipped(int(np.count_nonzero(~known)), "catalog", _OFF_PROJECTION, 6)
    return {role: None if column is None else column[known] for role, column in columns.items()}


def _column(values: Any, role: str, unit: Any) -> Column:
    """Return a column of doubles, or one double without axes."""
    if role == "flux":
        check_linear(getattr(values, "unit", None), "catalog: flux")
    wanted = {"x": "pix", "y": "pix", "re": "pix", "angle": "deg", "flux": unit}.get(role)
    values = in_unit(values, wanted, f"catalog: {role}")
    if role in (*_SHAPE, *_SHEAR) and np.ma.isMaskedArray(values):
        # A star (re = 0) needs no shape. In a galaxy, NaN is an error that names the row.
        values = np.ma.asarray(values, dtype=np.float64).filled(np.nan)
    array = reals(values, f"catalog: {role}")
    if array.ndim > 1:
        raise ValueError(f"catalog: {role} must be a column, got an array of shape {array.shape}")
    return array

"""Catalogues of stars and galaxies."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._arrays import with_missing
from psfield._astropy import check_linear, in_unit
from psfield._errors import PsfieldWarning
from psfield._sky import FrameSky, Sky, is_sky, sky_of
from psfield._tables import column_names

Column = NDArray[np.float64]
#: Columns by their roles. Those of ``sed`` are lists of texts.
Columns = dict[str, Any]

#: How a file is read that is given as a catalogue.
_PLAIN = {
    "columns": None,
    "one_based": False,
    "zero_point": None,
    "skip_invalid": False,
    "table": None,
    "wcs_extension": None,
    "date": None,
    "epoch": None,
}
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
    date: Any = None,
    epoch: float | None = None,
    spectra: bool = False,
    velocities: bool = False,
) -> dict[str, Any]:
    r"""Read stars and galaxies from a text table or a FITS table.

    Parameters
    ----------
    path : path
        CSV, ECSV, text separated by blanks, SExtractor's ``ASCII_HEAD`` and ``FITS_LDAC``, or a
        binary table of a FITS file.
    columns : str, optional
        The column of each role, as in ``"x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO"``. The roles are x and y
        (or ra and dec), flux (or mag), and re, n, q, angle, g1 and g2 for galaxies. On the sky also
        re_arcsec and pa_deg, and pmra, pmdec, parallax, radial_velocity and epoch: see Notes. By
        default each role uses the column of its own name, or of Gaia's. Positions may also be
        called ``x_0`` and ``y_0``. A unit that the file states is converted (angles to degrees),
        or refused.
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
    date : str, float or astropy.time.Time, optional
        Date of the frame: UTC as in ``"2031-05-17T12:00:00"``, a Julian year (2031.25), or a
        modified Julian date. Default: that of ``wcs`` (``wcs.wcs.mjdobs`` or ``dateobs``).
    epoch : float, optional
        Epoch of the positions (Julian year), without a column ``epoch`` or ``ref_epoch``.
    spectra : bool
        Read the column ``sed`` (names of spectra) or, without it, ``teff`` (kelvin), too.
    velocities : bool
        Read the columns ``vx`` and ``vy`` (pixels per second), too.

    Returns
    -------
    dict of str to numpy.ndarray
        Columns ``x``, ``y`` (0-based pixels) and ``flux``. If there are galaxies, also ``re``
        (half-light radius along the major axis in pixels, 0 for a star), ``n``, ``q`` and ``angle``
        (degrees from +x towards +y). They include the reduced shear ``g1``, ``g2`` of the file.
        ``sed`` is a list. Stars come first.

    Raises
    ------
    OSError
        The file cannot be read, a column is missing, or a row is invalid.
    ValueError
        An argument is invalid, or arguments contradict each other.

    Warns
    -----
    PsfieldWarning
        Rows were skipped, or columns that may change the sources were not read.

    Notes
    -----
    Sources with ``ra`` and ``dec`` move with ``pmra`` (with the factor cos(dec)) and ``pmdec``
    (mas per year), ``parallax`` (mas) and ``radial_velocity`` (km/s) from their epoch to the date
    of the frame, if both are known. ``re_arcsec`` (half-light radius in arcseconds) replaces
    ``re``. The shape is then that on the sky: ``pa_deg`` is the position angle of the major axis,
    from north towards east, and ``g1 > 0`` stretches east-west, ``g2 > 0`` along the diagonal
    between north and west, as in GalSim. The world coordinates map it to pixels.

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
    settings = {
        "columns": columns,
        "one_based": one_based,
        "zero_point": zero_point,
        "skip_invalid": skip_invalid,
        "table": None if table is None else str(table),
        "wcs_extension": None if wcs_extension is None else str(wcs_extension),
        "date": _date(date),
        "epoch": epoch,
    }
    read = Reads(spectra=spectra, velocities=velocities)
    return _read(os.fspath(path), settings, wcs, None, read, 3).columns()


def _date(date: Any) -> str | None:
    """Return the text of a date: a text, a number, a datetime, or a ``Time`` of astropy."""
    if date is None or isinstance(date, str):
        return date
    if hasattr(date, "tdb"):
        return repr(float(date.tdb.jyear))
    if getattr(date, "tzinfo", None) is not None:
        from datetime import timezone

        date = date.astimezone(timezone.utc).replace(tzinfo=None)
    return str(date.isoformat()) if hasattr(date, "isoformat") else repr(float(date))


@dataclass(frozen=True)
class Reads:
    """The columns that a catalogue may have beside those of its sources."""

    spectra: bool = False
    velocities: bool = False


def _read(
    path: str, settings: dict[str, Any], wcs: Any, unit: Any, read: Reads, stacklevel: int
) -> _native.Sources:
    """Read a file, as `read_catalog` does. Fluxes that have a unit are converted to ``unit``."""
    sky: Sky | FrameSky | None
    if isinstance(wcs, FrameSky):
        # A frame may lack them, if its catalogue has positions in pixels.
        sky = wcs if wcs.known_cards() is not None else None
    else:
        sky = None if is_path(wcs) else sky_of(None, wcs, 1, (0, 0))
    more = {
        "wcs": os.fspath(wcs) if is_path(wcs) else None,
        "wcs_cards": None if sky is None else sky.cards(),
        "flux_unit": None if unit is None else str(unit),
        "spectra": read.spectra,
        "velocities": read.velocities,
    }
    sources = _native.Sources.read(path, settings | more)
    invalid, outside, ignored = sources.left_out()
    _warn_of_skipped(invalid, path, "invalid", stacklevel)
    _warn_of_skipped(outside, path, _OFF_PROJECTION, stacklevel)
    _warn_of_ignored(ignored, path, stacklevel)
    return sources


def _warn_of_skipped(count: int, catalog: str, problem: str, stacklevel: int) -> None:
    """Warn of rows that were left out, if there are any. ``stacklevel`` is that of the caller."""
    if count:
        rows = "row" if count == 1 else "rows"
        text = f"{catalog}: {count} {rows} skipped: {problem}"
        warnings.warn(text, PsfieldWarning, stacklevel=stacklevel + 1)


def _warn_of_ignored(columns: list[str], catalog: str, stacklevel: int) -> None:
    """Warn of columns that change a source and are not read, if there are any."""
    if columns:
        names = ", ".join(columns)
        text = f"{catalog}: not read, though they may change the sources: the columns {names}"
        warnings.warn(text, PsfieldWarning, stacklevel=stacklevel + 1)


def is_path(value: Any) -> bool:
    """Return whether a value is the path of a file."""
    return isinstance(value, (str, os.PathLike))


def sources_of(
    catalog: Any, unit: Any, sky: Sky | FrameSky | None, read: Reads, stacklevel: int
) -> _native.Sources | None:
    """Return the sources of a catalogue: a table of any kind, or the path of a file.

    Fluxes that have a unit are converted to ``unit``. A single value in place of a column holds for
    every row. ``sky`` gives positions on the sky their pixels. What the columns mean is decided by
    the native module, as for files. ``stacklevel`` is that of the user's line, for warnings.
    """
    if catalog is None:
        return None
    if is_path(catalog):
        # A file of pixel positions needs no world coordinates, and gwcs has none for files.
        wcs = sky if sky is not None and sky.has_cards() else None
        return _read(os.fspath(catalog), _PLAIN, wcs, unit, read, stacklevel + 1)
    return _sources_of_table(catalog, unit, sky, read, stacklevel + 1)


def columns_of(
    catalog: Any,
    unit: Any = None,
    sky: Sky | FrameSky | None = None,
    read: Reads = Reads(),
    *,
    stacklevel: int = 3,
) -> Columns | None:
    """Return the columns by their roles of what `sources_of` takes, stars first."""
    sources = sources_of(catalog, unit, sky, read, stacklevel + 1)
    return None if sources is None else sources.columns()


def _sources_of_table(
    catalog: Any, unit: Any, sky: Sky | FrameSky | None, read: Reads, stacklevel: int
) -> _native.Sources:
    table = column_names(catalog)
    if table is None:
        raise TypeError(
            "catalog must be the path of a file or a table with columns x, y and flux (a dict of"
            " arrays, an astropy Table, a structured array, a data frame),"
            f" got {type(catalog).__name__}"
        )
    named = {str(name): catalog[name] for name in table}
    cards = None if sky is None else sky.known_cards()
    place = _sky_coord(named)
    if place is not None:
        # From here on, the positions are columns of the table.
        if sky is None or cards is None:
            named["x"], named["y"] = _pixels_of(place, sky)
        else:
            _check_known(place)
            named["ra"], named["dec"] = sky.degrees(place)
    _check_magnitudes(named)
    picked, ignored = _native.catalog_columns(list(named), read.spectra, read.velocities, cards)
    columns: Columns = {
        role: texts_of(named[name], name)
        if role == "sed"
        else column_of(named[name], name, unit if of_column is None else of_column)
        for role, name, of_column in picked
    }
    rows = max((array.size for array in columns.values() if array.ndim == 1), default=1)
    columns = {
        role: array if array.ndim else np.full(rows, array) for role, array in columns.items()
    }
    if "sed" in columns:
        columns["sed"] = columns["sed"].tolist()
    if "ra" in columns:
        _check_known((columns["ra"], columns["dec"]))
    if cards is None and "ra" in columns:
        place = columns.pop("ra"), columns.pop("dec")
        columns["x"], columns["y"] = _pixels_of(place, sky)
    if place is not None and getattr(getattr(place, "data", None), "differentials", None):
        ignored.append("of the motion of the SkyCoord (take its apply_space_motion)")
    _warn_of_ignored(ignored, "catalog", stacklevel)
    numbers = None
    if cards is None and place is not None:
        columns, numbers = _on_projection(columns, stacklevel)
    sources = _native.Sources(list(columns.items()), numbers, cards)
    _warn_of_skipped(sources.left_out()[1], "catalog", _OFF_PROJECTION, stacklevel)
    return sources


def _sky_coord(named: dict[str, Any]) -> Any:
    """Return the SkyCoord of a table without other positions, or None."""
    lower = {name.lower() for name in named}
    if lower & {"x", "y", "x_0", "y_0"} or {"ra", "dec"} <= lower:
        return None
    places = [name for name, values in named.items() if is_sky(values)]
    if len(places) > 1:
        raise ValueError(
            f"catalog: {places[0]} and {places[1]} are both positions on the sky: remove one"
        )
    return named[places[0]] if places else None


def _pixels_of(place: Any, sky: Sky | FrameSky | None) -> tuple[Column, Column]:
    """Return the pixels of a SkyCoord, or of right ascensions and declinations in degrees."""
    if sky is None:
        raise ValueError(
            "catalog: its positions are on the sky: give the world coordinates of the image, wcs=,"
            " or a scene that has them (CCDData)"
        )
    _check_known(place)
    return sky.pixels(place)


def _check_known(place: Any) -> None:
    """Refuse positions on the sky that are masked or NaN."""
    mask = (
        np.isnan(place[0]) | np.isnan(place[1])
        if isinstance(place, tuple)
        else np.asarray(getattr(place, "mask", False))
    )
    if mask.any():
        raise ValueError(
            f"catalog: {np.count_nonzero(mask)} positions on the sky are masked or NaN: remove"
            f" these rows, the first of which is row {np.flatnonzero(mask)[0]} (0-based)"
        )


def _on_projection(columns: Columns, stacklevel: int) -> tuple[Columns, list[int] | None]:
    """Leave out the sources for which the projection has no pixel, with a warning."""
    known = np.isfinite(columns["x"]) & np.isfinite(columns["y"])
    if known.all():
        return columns, None
    _warn_of_skipped(int(np.count_nonzero(~known)), "catalog", _OFF_PROJECTION, stacklevel + 1)
    rows: list[int] = np.flatnonzero(known).tolist()
    columns = {
        name: [column[row] for row in rows] if isinstance(column, list) else column[known]
        for name, column in columns.items()
    }
    return columns, rows


def texts_of(values: Any, name: str) -> NDArray[np.str_]:
    """Return a column of texts, in which missing and masked values are empty."""
    array = np.asarray(np.ma.getdata(values), dtype=object)
    if array.ndim > 1:
        raise ValueError(f"catalog: {name} must be a column, got an array of shape {array.shape}")
    masked = np.broadcast_to(np.ma.getmaskarray(values), array.shape)
    is_text = np.array([isinstance(text, str) for text in array.flat], bool).reshape(array.shape)
    return np.where(is_text & ~masked, array, "").astype(np.str_)


def _check_magnitudes(named: dict[str, Any]) -> None:
    """Refuse magnitudes in place of fluxes. Only for a file can a zero point be given."""
    lower = {name.lower() for name in named}
    if lower & {"mag", "phot_g_mean_mag"} and "flux" not in lower:
        raise ValueError(
            "catalog: there is no column flux, only magnitudes: set flux = 10**(-0.4 * (mag -"
            " zero_point)), or read the file with read_catalog(..., zero_point=)"
        )


def column_of(values: Any, name: str, unit: Any) -> Column:
    """Return a column of doubles in ``unit``, or one double without axes. Missing values are NaN.

    ``unit`` is None for fluxes in their own unit.
    """
    array = _numbers_of(values, name, unit)
    if array.ndim > 1:
        raise ValueError(f"catalog: {name} must be a column, got an array of shape {array.shape}")
    return array


def _numbers_of(values: Any, name: str, unit: Any) -> Column:
    """Return doubles in ``unit`` as `column_of` does, with any axes."""
    if unit is None:
        check_linear(getattr(values, "unit", None), f"catalog: {name}")
    return with_missing(in_unit(values, unit, f"catalog: {name}"), f"catalog: {name}")


#: The columns of sources with derivatives. Stars have no ``re``.
SOURCE_COLUMNS = ("x", "y", "flux", "re", "n", "q", "angle")
_OF_STAR = {"re": 0.0, "n": 1.0, "q": 1.0, "angle": 0.0}


def source_columns(catalog: Any, kept: type | tuple[type, ...] = ()) -> dict[str, Any]:
    """Return the `SOURCE_COLUMNS` of a catalogue in their order.

    Values become NumPy doubles in the unit of the column, except those of the types ``kept``.
    """
    if not isinstance(catalog, Mapping):
        raise TypeError(
            f"catalog must be a dict of the columns {', '.join(SOURCE_COLUMNS)}, got"
            f" {type(catalog).__name__}"
        )
    if unknown := [name for name in catalog if name not in SOURCE_COLUMNS]:
        raise ValueError(
            f"catalog has a column {unknown[0]!r}, but the columns with derivatives are"
            f" {', '.join(SOURCE_COLUMNS)}"
        )
    needed = SOURCE_COLUMNS if _OF_STAR.keys() & catalog.keys() else SOURCE_COLUMNS[:3]
    if missing := [name for name in needed if name not in catalog]:
        raise ValueError(f"catalog needs a column {missing[0]!r}")
    picked, _ = _native.catalog_columns(list(catalog), False, False, None)
    units = {name: unit for _, name, unit in picked}
    found = {**_OF_STAR, **catalog}
    return {
        name: found[name]
        if isinstance(found[name], kept)
        else _numbers_of(found[name], name, units.get(name))
        for name in SOURCE_COLUMNS
    }

"""Series of exposures, during which the PSF, the pointing and the sources change."""

from __future__ import annotations

import math
import operator
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from psfield import _native
from psfield._arrays import Precision, column, shape_of
from psfield._astropy import in_unit, unit_of
from psfield._catalog import Reads, sources_of
from psfield._choices import integer, real
from psfield._colour import COLOUR, first_image, native_colour
from psfield._defaults import DEFAULTS, arguments
from psfield._errors import PsfieldWarning
from psfield._html import FieldsAsTable
from psfield._model import PsfModel
from psfield._plan import checked, images_of
from psfield._progress import Progress, as_callback
from psfield._sky import sky_of
from psfield._tables import column_names, find_columns


@dataclass(frozen=True, eq=False)
class SeriesExposure(FieldsAsTable):
    """An exposure of a series. `Series` makes it.

    Attributes
    ----------
    image : numpy.ndarray
        ``[y, x]``, without noise.
    start_s, end_s : float
        Its times in seconds.
    shift_px : (float, float)
        Mean shift by the pointing along x and y, in pixels.
    sources : dict of str to numpy.ndarray
        Every source of the catalogue as it is in this exposure: its ``row``, mean position ``x``,
        ``y``, and ``flux``.

    Examples
    --------
    >>> import psfield
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> star = {"x": [3], "y": [2], "flux": [8]}
    >>> exposures = psfield.series(model, catalog=star, shape=(5, 7), exposure_s=30, count=2)
    >>> exposures[1].start_s, exposures[1].sources["flux"].tolist()
    (30.0, [8.0])
    """

    image: NDArray[Any]
    start_s: float
    end_s: float
    shift_px: tuple[float, float]
    sources: dict[str, NDArray[Any]]


class Series(Sequence[SeriesExposure]):
    """A sequence of exposures, each of which is simulated when it is taken. `series` makes it.

    Examples
    --------
    >>> import psfield
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> star = {"x": [3], "y": [2], "flux": [8]}
    >>> exposures = psfield.series(model, catalog=star, shape=(5, 7), exposure_s=30, count=2)
    >>> len(exposures), [exposure.end_s for exposure in exposures]
    (2, [30.0, 60.0])
    """

    def __init__(
        self, handle: _native.Series, starts_s: Sequence[float], exposure_s: float
    ) -> None:
        self._handle, self._starts_s, self._exposure_s = handle, starts_s, exposure_s

    def __len__(self) -> int:
        return len(self._starts_s)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            numbers = range(*number.indices(len(self)))
            return list(map(self.exposure, numbers))
        at = operator.index(number)
        if not -len(self) <= at < len(self):
            raise IndexError(f"the series has {len(self)} exposures, got number {number}")
        return self._exposure(at % len(self), None, 3)

    def __iter__(self) -> Iterator[SeriesExposure]:
        return (self._exposure(number, None, 3) for number in range(len(self)))

    def __repr__(self) -> str:
        return f"<Series: {len(self)} exposures of {self._exposure_s:g} s>"

    def exposure(self, number: int, *, progress: Progress | None = None) -> SeriesExposure:
        """Simulate an exposure.

        Models and plans are used again from one exposure to the next, as far as the PSFs agree, so
        take exposures in their order.

        Parameters
        ----------
        number : int
            Its number, from 0.
        progress : callable or tqdm bar, optional
            ``progress(done, total)``, called a few times per second.

        Returns
        -------
        SeriesExposure

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> star = {"x": [3], "y": [2], "flux": [8]}
        >>> exposures = psfield.series(model, catalog=star, shape=(5, 7), exposure_s=30, count=2)
        >>> exposures.exposure(0).image.sum().round(3).item()
        8.0
        """
        number = integer(number, "number", 0, len(self) - 1)
        return self._exposure(number, progress, 3)

    def _exposure(self, number: int, progress: Progress | None, stacklevel: int) -> SeriesExposure:
        image, shift, columns, texts = self._handle.exposure(number, as_callback(progress))
        for text in texts:
            warnings.warn(text, PsfieldWarning, stacklevel=stacklevel)
        sources = dict(zip(("row", "x", "y", "flux"), columns, strict=True))
        sources["row"] = sources["row"].astype(np.int64)
        start = float(self._starts_s[number])
        return SeriesExposure(image, start, start + self._exposure_s, (shift[0], shift[1]), sources)


def series(
    model: PsfModel,
    scene: Any = None,
    catalog: Any = None,
    *,
    exposure_s: float,
    count: int | None = None,
    cadence_s: float | None = None,
    starts_s: ArrayLike | None = None,
    drift_px_per_s: tuple[float, float] = (0.0, 0.0),
    jitter_px: float = 0.0,
    path: Any = None,
    light_curves: Any = None,
    wcs: Any = None,
    shape: tuple[int, int] | None = None,
    precision: Precision = DEFAULTS.precision,
    **settings: Any,
) -> Series:
    """Simulate a series of exposures, during which the PSF, the pointing and the sources change.

    This is what the command ``psfield series`` does. Samples of the PSF at several times give each
    exposure its mean PSF, samples in several frames give exposure ``n`` the PSF of frame ``n``.

    Parameters
    ----------
    model : PsfModel
        The PSF.
    scene, catalog, wcs
        The light, as for `Plan.simulate`. Positions are those at time 0. Columns ``vx`` and ``vy``
        of the catalogue are velocities in pixels per second. Moving sources leave trails.
    exposure_s : float
        Exposure time in seconds. Fluxes are those of one exposure.
    count : int, optional
        Number of exposures, unless ``starts_s`` is given.
    cadence_s : float, optional
        Seconds from start to start. Default: ``exposure_s``.
    starts_s : array_like, optional
        The start of each exposure in seconds, in place of ``count`` and ``cadence_s``.
    drift_px_per_s : (float, float)
        Drift of the pointing along x and y: by how far light moves on the frame.
    jitter_px : float
        The r.m.s. along each axis of fast random motion, in pixels.
    path : table, optional
        Columns ``time``, ``dx``, ``dy``: shifts of the light in pixels. Between the rows, it moves
        along straight lines.
    light_curves : table, optional
        Columns ``row`` (of the catalogue, from 0), ``time``, ``factor``: the flux is that of the
        catalogue times the factor, which is linear between the times.
    shape : (int, int), optional
        Rows and columns of the images, if there is only a catalogue. Default:
        ``model.field_shape``.
    precision : {'f32', 'f64'} or dtype
        Precision of the computation and of the images.
    **settings
        Arguments of `PsfModel.plan`, such as ``tolerance``, ``frame``, ``bandpass``, ``sed``.

    Returns
    -------
    Series
        A sequence of `SeriesExposure`. Images are plain arrays, in the unit of the scene.

    Raises
    ------
    ValueError
        The times, the path or the light curves do not fit together, the PSF is not known at one of
        the times, or an argument of the plan is invalid.

    Examples
    --------
    >>> import psfield
    >>> y, x = [[i - 8.0] for i in range(17)], [i - 8.0 for i in range(17)]
    >>> import numpy as np
    >>> stamp = np.exp(-(np.square(x) + np.square(y)) / 8)
    >>> model = psfield.PsfModel.from_samples(stamp, (0, 0))
    >>> star = {"x": [20], "y": [15], "flux": [100]}
    >>> night = psfield.series(
    ...     model, catalog=star, shape=(30, 40), exposure_s=10, count=3, drift_px_per_s=(0.1, 0)
    ... )
    >>> [exposure.sources["x"].round(2).item() for exposure in night]
    [20.5, 21.5, 22.5]
    """
    if not isinstance(model, PsfModel):
        raise TypeError(f"model must be a PsfModel, got {type(model).__name__}")
    if unknown := sorted(set(settings) - {*arguments("plan", settings), *COLOUR}):
        raise TypeError(
            f"series() has no argument {unknown[0]!r}: it takes the arguments of PsfModel.plan"
        )
    if scene is None and catalog is None:
        raise ValueError("there is nothing to simulate: give a scene, a catalog, or both")
    plain = checked({**settings, "precision": precision})
    exposure_s = real(exposure_s, "exposure_s")
    starts = _starts(exposure_s, count, cadence_s, starts_s)
    changes = {
        "starts_s": starts,
        "exposure_s": exposure_s,
        "drift_px_per_s": _pair(drift_px_per_s, "drift_px_per_s"),
        "jitter_px": real(jitter_px, "jitter_px"),
        "path": _columns(path, "path", ("time", "dx", "dy")),
        "light_curves": _columns(light_curves, "light_curves", ("row", "time", "factor")),
    }
    images = images_of(scene, plain)
    first = first_image(scene)
    if images:
        if shape is not None:
            raise TypeError("shape is that of the scene's images: leave it out")
        scene_shape = images[0][1].shape
    else:
        shape = model.field_shape if shape is None else shape
        if shape is None:
            raise ValueError("shape: give rows and columns, because the model has no field_shape")
        finer = plain.get("oversample", 1)
        rows, columns = shape_of(shape, "shape")
        scene_shape = (rows * finer, columns * finer)
    sky = sky_of(first, wcs, plain.get("oversample", 1), (0, 0))
    reads = Reads(spectra=plain["bandpass"] is not None, velocities=True)
    sources = sources_of(catalog, unit_of(first), sky, reads, 3)
    if sources is not None and not len(sources):
        warnings.warn("catalog: there are no sources", PsfieldWarning, stacklevel=2)
    handle = _native.Series(
        model._handle,
        scene_shape,
        plain["precision"],
        arguments("plan", plain),
        native_colour(plain),
        images,
        sources,
        changes,
    )
    return Series(handle, starts, exposure_s)


def _starts(
    exposure_s: float, count: int | None, cadence_s: float | None, starts_s: ArrayLike | None
) -> list[float]:
    """Return the start of each exposure."""
    if starts_s is not None:
        if count is not None or cadence_s is not None:
            raise ValueError("give either starts_s, or count and cadence_s")
        starts: list[float] = _column(starts_s, "s", "starts_s")
        return starts
    if count is None:
        raise ValueError("count: give the number of exposures, or starts_s")
    cadence = exposure_s if cadence_s is None else real(cadence_s, "cadence_s")
    return [number * cadence for number in range(integer(count, "count", 1, 1_000_000))]


def _columns(
    table: Any, name: str, columns: tuple[str, str, str]
) -> tuple[list[float], ...] | None:
    """Return these columns of a table."""
    if table is None:
        return None
    names = column_names(table)
    found = {} if names is None else find_columns(names, columns, name)
    if len(found) < len(columns):
        raise ValueError(f"{name} must be a table with columns {', '.join(columns)}")
    return tuple(_column(table[found[of]], _UNITS[of], f"{name}: {of}") for of in columns)


#: The units of the columns of tables.
_UNITS = {"time": "s", "dx": "pix", "dy": "pix", "row": "", "factor": ""}


def _column(values: Any, unit: str, name: str) -> list[float]:
    """Return a column of numbers in a unit."""
    array = column(in_unit(values, unit, name), name)
    if array.ndim > 1:
        raise ValueError(f"{name} must be a column, got an array of shape {array.shape}")
    numbers: list[float] = array.tolist()
    return numbers


def _pair(values: Any, name: str) -> tuple[float, float]:
    """Return two finite numbers, along x and y."""
    try:
        x, y = (real(value, name) for value in values)
    except TypeError:
        raise TypeError(f"{name} must be two numbers (x, y), got {values!r}") from None
    except ValueError:
        raise ValueError(f"{name} must be two numbers (x, y), got {values!r}") from None
    if not math.isfinite(x) or not math.isfinite(y):
        raise ValueError(f"{name} must be finite, got {values!r}")
    return x, y

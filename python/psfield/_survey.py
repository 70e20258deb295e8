"""Surveys: the frames of a camera, from a catalogue of the sky."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from psfield import _native
from psfield._astropy import cards_of
from psfield._catalog import column_of, is_path, texts_of
from psfield._errors import PsfieldWarning
from psfield._progress import Progress, as_callback
from psfield._sky import is_sky
from psfield._tables import column_names


@dataclass(frozen=True)
class SurveyFrame:
    """A frame of a survey: an exposure of one detector.

    Attributes
    ----------
    exposure, detector : str
        Their names.
    shape : (int, int)
        Rows and columns.
    output : str
        File of the frame.
    extension : str or None
        Extension of that file, if it holds all detectors.
    band, date : str or None
        Band and date.
    exposure_s : float or None
        Exposure time in seconds.
    seed : int
        Seed of its noise.
    centre_deg : (float, float)
        Right ascension and declination of its centre.
    corners_deg : list of (float, float)
        Right ascensions and declinations of its corners, around the frame.
    header : str
        Cards with the world coordinates, for ``astropy.io.fits.Header.fromstring``.

    Examples
    --------
    >>> import psfield
    >>> detector = {"name": "N", "shape": [40, 30], "psf": "psf.fits"}
    >>> detector["geometry"] = {"pixel_scale_arcsec": 0.5}
    >>> survey = psfield.Survey("sky.csv", [detector], [{"ra": 10, "dec": 20}], "{exposure}.fits")
    >>> [frame.extension for frame in survey.frames]
    ['N']
    """

    exposure: str
    detector: str
    shape: tuple[int, int]
    output: str
    extension: str | None
    band: str | None
    date: str | None
    exposure_s: float | None
    seed: int
    centre_deg: tuple[float, float]
    corners_deg: list[tuple[float, float]]
    header: str


@dataclass(frozen=True)
class FrameReport:
    """The result of a frame of a survey.

    Attributes
    ----------
    exposure, detector, output : str
        Its exposure, detector and file.
    status : {'done', 'skipped', 'failed'}
        It was made, exists already (or another process makes it), or could not be made.
    reason : str or None
        Why it was skipped.
    error : str or None
        Why it failed.
    warnings : list of str
        Warnings about it.
    sources, in_frame : int
        Sources whose light may reach the frame, and those on its pixels.
    invalid_rows : int
        Rows near the frame that were skipped.
    reused : bool
        Whether the plan was made for an earlier frame.
    seconds : float
        Time that it took.

    Examples
    --------
    >>> from psfield import FrameReport
    >>> FrameReport("1", "N", "1_N.fits", "skipped", reason="exists").in_frame
    0
    """

    exposure: str
    detector: str
    output: str
    status: Literal["done", "skipped", "failed"]
    reason: str | None = None
    error: str | None = None
    warnings: list[str] | None = None
    sources: int = 0
    in_frame: int = 0
    invalid_rows: int = 0
    reused: bool = False
    seconds: float = 0.0


class Survey:
    """A camera, its pointings, and a catalogue of the sky.

    Parameters
    ----------
    catalog : path or table
        Stars and galaxies with ``ra``, ``dec`` and ``flux`` or magnitudes, as for `read_catalog`.
    camera : list of dict, or path
        The detectors: dicts with the keys of ``[[detector]]`` in a survey file (``name``,
        ``shape`` with columns and rows, ``psf``, ``wcs`` or ``geometry``, ``settings``), or a file
        with them. ``wcs`` may be an `astropy.wcs.WCS` that refers to the boresight.
    pointings : list of dict, or path
        The pointings: dicts with the keys of ``[[pointing]]`` (``ra``, ``dec``, ``rotation_deg``,
        ``date``, ``band``, ``exposure_s``, ``dithers_arcsec``, ``name``), or a CSV table of them.
    output : str
        Name of the frames' files, with ``{exposure}``, ``{detector}`` and ``{band}``. Without
        ``{detector}``, each exposure is one file with an extension for each detector.
    bands : dict of dict, optional
        The bands by their names, with the keys of ``[band.NAME]`` (``zero_point``, ``mag``,
        ``sky_e_per_s``, ``bandpass``, ``sed``).
    **settings
        Further keys of a survey file: ``epoch``, ``columns``, ``table``, ``skip_invalid``,
        ``truth_table``, ``noise_free``, ``quality``, ``frames``, ``seed``, ``precision``,
        ``shoot_below``, ``boresight``, and ``simulate`` and ``fit``, dicts of settings such as
        ``{"tolerance": 1e-3}``.

    Raises
    ------
    ValueError
        A key is unknown, a detector, an exposure or a file appears twice, or a value is out of
        range.

    Examples
    --------
    >>> import psfield
    >>> detector = {"name": "N", "shape": [40, 30], "psf": "psf.fits"}
    >>> detector["geometry"] = {"pixel_scale_arcsec": 0.5}
    >>> pointings = [{"ra": 10.0, "dec": 20.0, "dithers_arcsec": [[0, 0], [4, 0]]}]
    >>> survey = psfield.Survey("sky.csv", [detector], pointings, "{exposure}_{detector}.fits")
    >>> [frame.output for frame in survey.frames]
    ['001-1_N.fits', '001-2_N.fits']
    """

    def __init__(
        self,
        catalog: Any,
        camera: Any,
        pointings: Any,
        output: str | os.PathLike[str],
        *,
        bands: Mapping[str, Mapping[str, Any]] | None = None,
        **settings: Any,
    ) -> None:
        keys: dict[str, Any] = {"output": os.fspath(output), **settings}
        columns = None
        if is_path(catalog):
            keys["catalog"] = os.fspath(catalog)
        elif column_names(catalog) is None:
            kind = type(catalog).__name__
            raise TypeError(f"catalog must be the path of a file or a table, got {kind}")
        else:
            columns = _columns_of(catalog)
        for key, file, value in (
            ("detector", "camera", camera),
            ("pointing", "pointings", pointings),
        ):
            if is_path(value):
                keys[file] = os.fspath(value)
            elif isinstance(value, Sequence) and all(isinstance(each, Mapping) for each in value):
                keys[key] = [dict(each) for each in value]
            else:
                raise TypeError(
                    f"{file} must be a path or a list of dicts, got {type(value).__name__}"
                )
        for detector in keys.get("detector", ()):
            if hasattr(detector.get("wcs"), "to_header"):
                detector["cards"] = cards_of(detector.pop("wcs"))
        if bands is not None:
            keys["band"] = {name: dict(band) for name, band in bands.items()}
        self._set((json.dumps(keys, default=_plain), "", columns))

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Survey:
        """Read a survey file, as of the command ``psfield observe``.

        Parameters
        ----------
        path : path
            TOML file. Relative paths refer to the folder of the file that names them.

        Returns
        -------
        Survey

        Examples
        --------
        >>> import pathlib
        >>> import psfield
        >>> _ = pathlib.Path("survey.toml").write_text('''
        ... catalog = "sky.csv"
        ... output = "{exposure}_{detector}.fits"
        ... [[detector]]
        ... name = "N"
        ... shape = [40, 30]
        ... psf = "psf.fits"
        ... geometry = { pixel_scale_arcsec = 0.5 }
        ... [[pointing]]
        ... ra = 10.0
        ... dec = 20.0
        ... ''')
        >>> len(psfield.Survey.read("survey.toml").frames)
        1
        """
        survey = cls.__new__(cls)
        survey._set((os.fspath(path),))
        return survey

    def _set(self, state: tuple[Any, ...]) -> None:
        """Take the path of a file, or the JSON of its keys, their folder and a catalogue."""
        self._state = state
        of_file = len(state) == 1
        self._handle = _native.Survey.read(*state) if of_file else _native.Survey(*state)

    def __reduce__(self) -> tuple[Any, ...]:
        # Workers of a cluster may have another working directory.
        if len(self._state) == 1:
            return _restored, ((os.path.abspath(self._state[0]),),)
        keys, folder, columns = self._state
        return _restored, ((keys, os.path.abspath(folder), columns),)

    @property
    def frames(self) -> list[SurveyFrame]:
        """The frames, in the order in which they are made: those with equal PSFs together.

        Examples
        --------
        >>> import psfield
        >>> detector = {"name": "N", "shape": [40, 30], "psf": "psf.fits"}
        >>> detector["geometry"] = {"pixel_scale_arcsec": 0.5}
        >>> pointings = [{"ra": 10, "dec": 20}]
        >>> survey = psfield.Survey("sky.csv", [detector], pointings, "{exposure}.fits")
        >>> survey.frames[0].shape
        (30, 40)
        """
        return [SurveyFrame(**frame) for frame in self._handle.frames()]

    def observe(
        self, *, overwrite: bool = False, progress: Progress | None = None
    ) -> list[FrameReport]:
        """Make all frames and their files.

        Frames whose files exist are skipped, so that an interrupted call can be repeated. The files
        equal those of the command ``psfield observe``. On a cluster: `psfield.dask.observe`.

        Parameters
        ----------
        overwrite : bool
            Make all frames again and replace files that exist.
        progress : callable or tqdm bar, optional
            ``progress(done, total)``, called after each frame.

        Returns
        -------
        list of FrameReport
            In the order of `frames`.

        Warns
        -----
        PsfieldWarning
            Some frames failed, or there are warnings about frames. The reports hold them.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> _ = model.write("psf.fits", overwrite=True)
        >>> detector = {"name": "N", "shape": [41, 31], "psf": "psf.fits"}
        >>> detector["geometry"] = {"pixel_scale_arcsec": 0.5}
        >>> sky = {"ra": [10.0], "dec": [20.0], "flux": [100.0]}
        >>> pointings = [{"ra": 10.0, "dec": 20.0}]
        >>> survey = psfield.Survey(sky, [detector], pointings, "{exposure}_{detector}.fits")
        >>> report = survey.observe(overwrite=True)[0]
        >>> report.status, report.in_frame
        ('done', 1)
        """
        callback = as_callback(progress)
        count = len(self._handle)
        reports: list[FrameReport] = []
        for number in range(count):
            reports.append(self._observe(number, overwrite))
            if callback is not None:
                callback(number + 1, count)
        self._finish(reports, overwrite, 3)
        return reports

    def _observe(self, number: int, overwrite: bool) -> FrameReport:
        return FrameReport(**json.loads(self._handle.observe(number, overwrite)))

    def _finish(self, reports: list[FrameReport], overwrite: bool, stacklevel: int) -> None:
        """Join frames to files, write the list of frames, and warn."""
        problems = []
        for exposure in dict.fromkeys(report.exposure for report in reports):
            try:
                self._handle.join(exposure)
            except (OSError, ValueError) as error:
                problems.append(f"exposure {exposure}: {error}")
        self._handle.write_list(overwrite)
        failed = [report for report in reports if report.status == "failed"]
        if failed:
            first = f"{failed[0].exposure}, {failed[0].detector}: {failed[0].error}"
            text = f"{len(failed)} of {len(reports)} frames failed, the first of them {first}"
            warnings.warn(text, PsfieldWarning, stacklevel=stacklevel)
        of_frames = [text for report in reports for text in report.warnings or ()]
        for text in dict.fromkeys(problems + of_frames):
            warnings.warn(text, PsfieldWarning, stacklevel=stacklevel)


def observe(
    catalog: Any,
    camera: Any,
    pointings: Any,
    output: str | os.PathLike[str],
    *,
    bands: Mapping[str, Mapping[str, Any]] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> list[FrameReport]:
    """Simulate the frames of a camera from a catalogue of the sky.

    This is ``Survey(catalog, camera, pointings, output, ...).observe(...)``.

    Parameters
    ----------
    catalog, camera, pointings, output, bands, **settings
        As for `Survey`.
    overwrite, progress
        As for `Survey.observe`.

    Returns
    -------
    list of FrameReport

    Examples
    --------
    >>> import psfield
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> _ = model.write("psf.fits", overwrite=True)
    >>> detector = {"name": "N", "shape": [41, 31], "psf": "psf.fits"}
    >>> detector["geometry"] = {"pixel_scale_arcsec": 0.5}
    >>> sky = {"ra": [10.0], "dec": [20.0], "r": [20.0]}
    >>> pointings = [{"ra": 10.0, "dec": 20.0, "band": "r", "exposure_s": 30.0}]
    >>> bands = {"r": {"zero_point": 25.0, "mag": "r"}}
    >>> reports = psfield.observe(
    ...     sky, [detector], pointings, "{exposure}_{band}.fits", bands=bands, overwrite=True
    ... )
    >>> reports[0].status
    'done'
    """
    survey = Survey(catalog, camera, pointings, output, bands=bands, **settings)
    return survey.observe(overwrite=overwrite, progress=progress)


def _restored(state: tuple[Any, ...]) -> Survey:
    survey = Survey.__new__(Survey)
    survey._set(state)
    return survey


def _columns_of(catalog: Any) -> list[tuple[str, Any, str]]:
    """Return the names, values and units of the columns of a table.

    A single value holds for every row. Columns that hold neither numbers nor texts are left out.
    """
    named = {str(name): catalog[name] for name in column_names(catalog) or ()}
    lower = {name.lower() for name in named}
    for name, values in list(named.items()):
        if is_sky(values):
            if {"ra", "dec"} & lower:
                raise ValueError(f"catalog: {name}, ra and dec are all positions: remove some")
            place = named.pop(name).icrs
            named["ra"], named["dec"] = place.ra.deg, place.dec.deg
            lower |= {"ra", "dec"}
    columns: list[tuple[str, Any, str]] = []
    for name, values in named.items():
        unit = getattr(values, "unit", None)
        objects = np.asarray(np.ma.getdata(getattr(values, "value", values)))
        is_text = any(isinstance(value, str | bytes) for value in objects.flat[:1000])
        if objects.dtype.kind in "US" or (objects.dtype.kind == "O" and is_text):
            columns.append((name, texts_of(values, name), ""))
        elif objects.dtype.kind in "biufO":
            try:
                numbers = column_of(values, name, unit)
            except (TypeError, ValueError):
                # Identifiers of other kinds, arrays in cells.
                continue
            columns.append((name, numbers, "" if unit is None else unit.to_string()))
    rows = max((np.size(values) for _, values, _ in columns if np.ndim(values)), default=1)
    return [
        (
            name,
            np.broadcast_to(values, rows).tolist()
            if isinstance(values, np.ndarray) and values.dtype.kind == "U"
            else np.ascontiguousarray(np.broadcast_to(values, rows)),
            unit,
        )
        for name, values, unit in columns
    ]


def _plain(value: Any) -> Any:
    """Return what JSON can hold for a path, a number of NumPy, an array, or a time."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if hasattr(value, "isot"):
        return str(value.utc.isot)
    if hasattr(value, "isoformat"):
        return value.isoformat()
    raise TypeError(f"a survey cannot hold {value!r}")

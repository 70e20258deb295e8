"""Injection of sources into real frames."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass
from typing import Any

from psfield import _native
from psfield._catalog import Reads, sources_of
from psfield._choices import integer
from psfield._defaults import DEFAULTS
from psfield._errors import PsfieldWarning
from psfield._model import PsfModel
from psfield._sky import FrameSky


@dataclass(frozen=True)
class InjectReport:
    """The result of an injection.

    Attributes
    ----------
    gain : float
        Electrons per unit of the frame.
    saturation : float or None
        Value at which pixels saturate, if it is known.
    seed : int
        Seed of the photon noise.
    electrons : float
        Electrons that were added, before pixels saturate.
    pixels, saturated_pixels : int
        Pixels that hold injected light, and those of them that are saturated now.

    Examples
    --------
    >>> from psfield import InjectReport
    >>> InjectReport(2.0, None, 1, 1e4, 30, 0).electrons
    10000.0
    """

    gain: float
    saturation: float | None
    seed: int
    electrons: float
    pixels: int
    saturated_pixels: int


def inject(
    frame: str | os.PathLike[str],
    catalog: Any,
    output: str | os.PathLike[str],
    model: PsfModel | None = None,
    *,
    extension: str | int | None = None,
    gain: float | None = None,
    saturation: float | None = None,
    seed: int = 0,
    tolerance: float = DEFAULTS.tolerance,
    truth_table: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> InjectReport:
    """Inject stars and galaxies into a real frame, as the command ``psfield inject`` does.

    The photon noise of the injected light alone is added: the frame has its own noise already. All
    pixels without injected light, all header cards, the storage type and other extensions stay as
    they are. A line of HISTORY is added, checksums are renewed, and an image that is compressed in
    tiles becomes an uncompressed one. The numbers of a frame of integers are rounded up or down at
    random, so that the mean stays.

    Parameters
    ----------
    frame : path
        FITS image.
    catalog : table or path
        Stars and galaxies, as for `Plan.simulate`. Fluxes are in the unit of the frame. The world
        coordinates and the date of its header give ``ra`` and ``dec`` their pixels. For magnitudes
        and other names of columns: ``read_catalog(path, wcs=frame, ...)``.
    output : path
        The frame with the sources.
    model : PsfModel, optional
        PSF. By default, that of the stars of the frame.
    extension : str or int, optional
        The image in the file: its number or its name.
    gain : float, optional
        Electrons per unit of the frame. Default: the card EGAIN or GAIN.
    saturation : float, optional
        Value at which pixels saturate. Default: the card SATURATE, if there is one above the sky.
    seed : int
        Seed of the photon noise.
    tolerance : float
        Largest relative L2 error of the PSF of any source.
    truth_table : path, optional
        FITS table of the sources as they are in the frame (`Plan.truth_table`).
    overwrite : bool
        Replace files that exist.

    Returns
    -------
    InjectReport

    Raises
    ------
    ValueError
        The gain is not known, an argument or a source is invalid.
    OSError
        A file cannot be read or written.

    Warns
    -----
    PsfieldWarning
        As for `Plan.simulate`.

    Examples
    --------
    >>> import numpy as np
    >>> import psfield
    >>> from astropy.io import fits
    >>> sky = np.random.default_rng(1).normal(100, 3, (40, 50)).astype("float32")
    >>> fits.writeto("real.fits", sky, fits.Header({"GAIN": 2.0}), overwrite=True)
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> star = {"x": [20.0], "y": [10.0], "flux": [5000.0]}
    >>> report = psfield.inject("real.fits", star, "star.fits", model, seed=1, overwrite=True)
    >>> changed = fits.getdata("star.fits") != sky
    >>> int(changed.sum()), bool(changed[10, 20])
    (5, True)
    """
    if not (model is None or isinstance(model, PsfModel)):
        raise TypeError(f"model must be a PsfModel, got {type(model).__name__}")
    handle = _native.RealFrame(os.fspath(frame), None if extension is None else str(extension))
    sources = sources_of(catalog, handle.unit(), FrameSky(handle.cards()), Reads(), 3)
    if sources is None:
        raise ValueError("catalog: give a catalogue of stars and galaxies")
    settings = {
        "gain": gain,
        "saturation": saturation,
        "seed": integer(seed, "seed", 0, 2**64 - 1),
        "tolerance": tolerance,
        "truth_table": None if truth_table is None else os.fspath(truth_table),
        "overwrite": overwrite,
    }
    report, texts = handle.inject(
        None if model is None else model._handle, sources, os.fspath(output), settings
    )
    for text in texts:
        warnings.warn(text, PsfieldWarning, stacklevel=2)
    return InjectReport(**json.loads(report))

"""What a batch makes."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypedDict, TypeGuard

import numpy as np

from psfield._arrays import plain
from psfield._catalog import read_catalog

#: Extensions of files that are read by astropy.
_FITS = (".fits", ".fit", ".fts", ".fits.gz", ".fit.gz", ".fits.fz")


class Job(TypedDict, total=False):
    """One frame of a batch; it needs a scene, a catalogue, or both.

    Attributes
    ----------
    scene : array_like, path or callable
        Flux in each pixel, ``[y, x]``; a FITS file (its first image) or an ``.npy`` file; or a function that draws it on the worker, called
        with the job's seed, or with nothing where it has none.
    catalog : table, path or callable
        Stars and galaxies, as for `Plan.simulate`; a file that `read_catalog` knows; or a function as for the scene.
    seed : int
        For functions and for the detector's noise.
    detector : psfield.detector.Detector
        In place of the batch's.
    output : path
        The FITS file, in place of the batch's template.
    header : mapping
        Cards for the FITS file: keyword to value, or to value and comment.
    """

    scene: Any
    catalog: Any
    seed: int
    detector: Any
    output: str | os.PathLike[str]
    header: Mapping[str, Any]


KEYS = frozenset(Job.__annotations__)


@dataclass(frozen=True)
class JobResult:
    """What became of a job.

    Attributes
    ----------
    index : int
        Its place among the jobs, from 0.
    status : {'written', 'kept', 'failed'}
        Whether its output was made now, was there before, or could not be made.
    output : str
        The FITS file, or the Zarr group with the frame's index, as in ``frames.zarr[17]``.
    seconds : float
        What it took on its worker.
    error : str or None
        Why it failed.
    """

    index: int
    status: Literal["written", "kept", "failed"]
    output: str
    seconds: float = 0.0
    error: str | None = None


@dataclass(frozen=True)
class Task:
    """A job on its way."""

    index: int
    job: Mapping[str, Any]
    #: The file or frame that it makes.
    output: str
    #: How often it has failed by its files.
    failures: int = 0


def checked(job: Any, has_detector: bool) -> None:
    """Refuse a job that cannot be made."""
    if not isinstance(job, Mapping):
        raise TypeError(f"a job must be a dict, got {type(job).__name__}")
    if unknown := sorted(set(job) - KEYS):
        raise ValueError(f"a job has no {unknown[0]!r}; it may have {', '.join(sorted(KEYS))}")
    if job.get("scene") is None and job.get("catalog") is None:
        raise ValueError("there is nothing to convolve: give the job a scene, a catalog, or both")
    seed = job.get("seed")
    if seed is not None and (not isinstance(seed, (int, np.integer)) or seed < 0):
        raise ValueError(f"seed must be a whole number from 0, got {seed!r}")
    if seed is None and (has_detector or job.get("detector") is not None):
        raise ValueError("a detector's noise needs a seed: give each job one of its own")


def is_path(value: Any) -> TypeGuard[str | os.PathLike[str]]:
    return isinstance(value, (str, os.PathLike))


def scene_of(job: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the pixels of a job's scene, if it has one, and the header of its file, if that has one."""
    scene = job.get("scene")
    if scene is None:
        return None, None
    header = None
    if is_path(scene):
        scene, header = _read(os.fspath(scene))
    elif callable(scene):
        scene = _call(scene, job)
    pixels = plain(scene, "scene")
    if pixels.ndim != 2:
        raise ValueError(f"scene must be an array [y, x], got one of shape {pixels.shape}")
    return pixels, header


def catalog_of(job: Mapping[str, Any]) -> Any:
    """Return the table of a job's sources, if it has one."""
    catalog: Any = job.get("catalog")
    if is_path(catalog):
        return read_catalog(catalog)
    return _call(catalog, job) if callable(catalog) else catalog


def shape_without_reading(job: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return the shape of a job's scene if it can be told without its pixels."""
    scene = job.get("scene")
    if scene is None or (callable(scene) and not hasattr(scene, "shape")):
        return None
    if is_path(scene):
        path = os.fspath(scene)
        if not path.endswith(_FITS):
            return tuple(np.load(path, mmap_mode="r").shape)
        from astropy.io import fits

        with fits.open(path) as hdus:
            return tuple(_first_image(hdus, path).shape)
    shape = np.shape(scene)
    return shape if len(shape) == 2 else None


def _call(function: Callable[..., Any], job: Mapping[str, Any]) -> Any:
    seed = job.get("seed")
    return function() if seed is None else function(seed)


def _read(path: str) -> tuple[Any, Any]:
    if path.endswith(".npy"):
        return np.load(path), None
    if not path.endswith(_FITS):
        raise ValueError(f"scene: {path}: is neither FITS ({', '.join(_FITS)}) nor .npy")
    from astropy.io import fits

    with fits.open(path, memmap=False) as hdus:
        hdu = _first_image(hdus, path)
        return hdu.data, hdu.header


def _first_image(hdus: Any, path: str) -> Any:
    for hdu in hdus:
        if hdu.is_image and len(hdu.shape) == 2:
            return hdu
    raise OSError(f"{path}: there is no image in it")

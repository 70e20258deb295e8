"""The jobs of a batch and their results."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypedDict

import numpy as np

from psfield._arrays import plain
from psfield._catalog import is_path
from psfield._colour import first_image, is_images
from psfield._model import PsfModel

#: Extensions of files that astropy reads.
_FITS = (".fits", ".fit", ".fts", ".fits.gz", ".fit.gz", ".fits.fz")


class Job(TypedDict, total=False):
    """One frame of a batch: a dict with a scene, a catalogue, or both.

    Attributes
    ----------
    scene : array_like, path or callable
        Flux in each pixel, ``[y, x]``, or (in colour) a dict of such images by the names of their
        spectra, or a FITS file or an ``.npy`` file, or a function that draws the scene on the
        worker. The function receives the seed of the job, or no argument if the
        job has none.
    extension : str or int
        Image of the scene's FITS file: its number or its name. Default: the primary if it has
        pixels, else the only image. If there are several, the job fails.
    catalog : table, path or callable
        Stars and galaxies, as for `Plan.simulate`, or a function as for the scene.
    psf : PsfModel, path or callable
        PSF that replaces the model of the batch: a model, a file that `PsfModel.read` reads, or a
        function that makes a model, as for the scene. Frames with a PSF of their own each, such as
        other coefficients of one basis, use the tiles of the plan for the model of the batch.
    seed : int
        Seed of the functions and of the noise of the detector.
    detector : psfield.detector.Detector
        Detector that replaces that of the batch.
    output : path
        FITS file that replaces the template of the batch.
    header : mapping
        Cards for the FITS file: keyword to value, or to value and comment.

    Examples
    --------
    >>> import dask
    >>> from psfield.dask import Job
    >>> def draw(seed):
    ...     return {"x": [1.0], "y": [2.0], "flux": [100.0 * seed]}
    >>> job = Job(catalog=draw, seed=3, header={"OBJECT": "test star"})
    >>> job["seed"]
    3
    """

    scene: Any
    extension: str | int
    catalog: Any
    psf: Any
    seed: int
    detector: Any
    output: str | os.PathLike[str]
    header: Mapping[str, Any]


KEYS = frozenset(Job.__annotations__)


@dataclass(frozen=True)
class JobResult:
    """The result of a job.

    Attributes
    ----------
    index : int
        Index of the job, from 0.
    status : {'written', 'kept', 'failed'}
        The output was made now (written), existed before (kept), or could not be made (failed).
    output : str
        The FITS file, or the Zarr group with the frame's index, as in ``frames.zarr[17]``.
    seconds : float
        Time that the job took on its worker.
    error : str or None
        Reason of the failure.

    Examples
    --------
    >>> import dask
    >>> from psfield.dask import JobResult
    >>> JobResult(index=2, status="kept", output="frame2.fits").error is None
    True
    """

    index: int
    status: Literal["written", "kept", "failed"]
    output: str
    seconds: float = 0.0
    error: str | None = None


@dataclass(frozen=True)
class Task:
    """A job that is waiting or running."""

    index: int
    job: Mapping[str, Any]
    #: The file or frame to write.
    output: str
    #: Number of failures to read or write its files.
    failures: int = 0


def checked(job: Any, has_detector: bool) -> None:
    """Refuse an invalid job."""
    if not isinstance(job, Mapping):
        raise TypeError(f"a job must be a dict, got {type(job).__name__}")
    if unknown := sorted(set(job) - KEYS):
        raise ValueError(f"a job has no key {unknown[0]!r}: its keys are {', '.join(sorted(KEYS))}")
    if job.get("scene") is None and job.get("catalog") is None:
        raise ValueError("there is nothing to simulate: give the job a scene, a catalog, or both")
    psf = job.get("psf")
    if not (psf is None or isinstance(psf, PsfModel) or is_path(psf) or callable(psf)):
        raise TypeError(f"psf must be a PsfModel, a path or a function, got {type(psf).__name__}")
    seed = job.get("seed")
    if seed is not None and (not isinstance(seed, (int, np.integer)) or seed < 0):
        raise ValueError(f"seed must be an integer of at least 0, got {seed!r}")
    if seed is None and (has_detector or job.get("detector") is not None):
        raise ValueError("the noise of the detector needs a seed: give each job a different one")


def scene_of(job: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the pixels of the scene and the header of its file. Either may be None."""
    scene = job.get("scene")
    if scene is None:
        return None, None
    header = None
    if is_path(scene):
        scene, header = _read(os.fspath(scene), job.get("extension"))
    elif callable(scene):
        scene = _call(scene, job)
    if is_images(scene):
        return {name: plain(image, f"scene[{name!r}]") for name, image in scene.items()}, None
    pixels = plain(scene, "scene")
    if pixels.ndim != 2:
        raise ValueError(f"scene must be an array [y, x], got one of shape {pixels.shape}")
    return pixels, header


def catalog_of(job: Mapping[str, Any]) -> Any:
    """Return the catalogue of a job as a table or a path, or None."""
    catalog: Any = job.get("catalog")
    return _call(catalog, job) if callable(catalog) else catalog


def psf_of(job: Mapping[str, Any]) -> PsfModel | None:
    """Return the PSF of a job, or None if it uses the model of the batch."""
    psf: Any = job.get("psf")
    if callable(psf):
        psf = _call(psf, job)
        if not isinstance(psf, PsfModel):
            raise TypeError(f"psf: the function must return a PsfModel, got {type(psf).__name__}")
    return PsfModel.read(psf) if is_path(psf) else psf


def shape_without_reading(job: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return the shape of the scene of a job if it is known without reading the pixels."""
    scene = job.get("scene")
    if scene is None or (callable(scene) and not hasattr(scene, "shape")):
        return None
    if is_path(scene):
        path = os.fspath(scene)
        if not path.endswith(_FITS):
            return tuple(np.load(path, mmap_mode="r").shape)
        from astropy.io import fits

        with fits.open(path) as hdus:
            return tuple(_image(hdus, path, job.get("extension")).shape)
    shape = np.shape(first_image(scene))
    return shape if len(shape) == 2 else None


def _call(function: Callable[..., Any], job: Mapping[str, Any]) -> Any:
    seed = job.get("seed")
    return function() if seed is None else function(seed)


def _read(path: str, extension: str | int | None) -> tuple[Any, Any]:
    if path.endswith(".npy"):
        return np.load(path), None
    if not path.endswith(_FITS):
        raise ValueError(f"scene: {path} must be a FITS file ({', '.join(_FITS)}) or an .npy file")
    from astropy.io import fits

    with fits.open(path, memmap=False) as hdus:
        hdu = _image(hdus, path, extension)
        return hdu.data, hdu.header


def _image(hdus: Any, path: str, extension: str | int | None) -> Any:
    """Return the HDU of the image, by the rule of the command line's ``--extension``."""
    if extension is not None:
        try:
            hdu = hdus[extension]
        except (KeyError, IndexError):
            raise OSError(f"{path}: there is no extension {extension!r}") from None
    elif hdus[0].shape:
        hdu = hdus[0]
    else:
        images = [(i, hdu) for i, hdu in enumerate(hdus) if hdu.is_image and hdu.shape]
        if len(images) != 1:
            names = ", ".join(f"{i} {hdu.name}".rstrip() for i, hdu in images)
            raise OSError(
                f"{path}: the file has {len(images) or 'no'} images"
                + (f" ({names}): give the job an extension" if images else "")
            )
        hdu = images[0][1]
    if not hdu.is_image or len(hdu.shape) != 2:
        raise OSError(f"{path}: {hdu.name or 'the image'} is not an image [y, x]")
    return hdu

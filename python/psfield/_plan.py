"""Simulations of scenes of one shape."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._arrays import DTYPES, numbers, shape_of
from psfield._astropy import like, unit_of
from psfield._catalog import columns_of
from psfield._choices import real, whole, whole_or_none, word, word_or_none
from psfield._errors import PsfieldWarning
from psfield._progress import Progress, as_callback

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

    from psfield._model import PsfModel


@dataclass(frozen=True)
class SpotCheck:
    """An image checked against the direct sum in double precision at random pixels.

    Attributes
    ----------
    pixels : int
        How many pixels were looked at.
    seed : int
        The seed that chose them.
    max_abs, rms : float
        The largest absolute difference, and the root mean square.
    max_over_peak : float or None
        The largest over the image's largest absolute value.
    relative_rms : float or None
        ``rms`` over the root mean square of the direct sum at the same pixels.
    limit : float or None
        What ``relative_rms`` may be.
    passed : bool or None
        Whether it is.
    """

    pixels: int
    seed: int
    max_abs: float
    rms: float
    max_over_peak: float | None
    relative_rms: float | None
    limit: float | None
    passed: bool | None


class Plan:
    """Everything about the simulation of scenes of one shape that does not depend on the light. Made by `PsfModel.plan`.

    A plan is a linear operator from scenes to images; it may be used from many threads at once, and can be pickled (it is then made
    anew). Plans for stars and for galaxies are made when the first of them comes, and kept.
    """

    __slots__ = ("_handle", "_model", "_words")

    def __init__(self, model: PsfModel, shape: tuple[int, int], **words: Any) -> None:
        if "tolerance" not in words:
            raise TypeError("use PsfModel.plan")
        self._model = model
        self._words = {**checked(words), "shape": shape_of(shape, "shape")}
        self._handle = _native.Plan(model._handle, self._words)

    def for_region(self, region: tuple[int, int, int, int]) -> Plan:
        """Return the plan for another region of the same frame, with the tiles that were chosen for this one.

        Much sooner made than a plan that has to choose.

        Parameters
        ----------
        region : (int, int, int, int)
            First column, first row, columns, rows, in pixels of the image counted from the frame's first.

        Returns
        -------
        Plan
        """
        if region is None:
            raise TypeError("region must be (x0, y0, nx, ny), four whole numbers, got None")
        other = Plan.__new__(Plan)
        other._model = self._model
        other._words = {**self._words, "region": region_of(region, "region")}
        other._handle = self._handle.for_region(other._words["region"])
        return other

    @property
    def model(self) -> PsfModel:
        """The PSF."""
        return self._model

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the scenes."""
        shape: tuple[int, int] = self._words["shape"]
        return shape

    @property
    def image_shape(self) -> tuple[int, int]:
        """Rows and columns of the images."""
        return self._handle.frame_shape()

    @property
    def region(self) -> tuple[int, int, int, int] | None:
        """The part of the frame that images show: first column, first row, columns, rows; None for all of it."""
        region: tuple[int, int, int, int] | None = self._words["region"]
        return region

    @property
    def light_region(self) -> tuple[int, int, int, int]:
        """The part of the scene whose light reaches images: first column, first row, columns, rows, in pixels of the scene."""
        return self._handle.light_region()

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the images' pixels."""
        return DTYPES[self._words["precision"]]

    @property
    def tolerance(self) -> float:
        """The largest relative L2 error that the engine may add to the PSF of any pixel."""
        return float(self._words["tolerance"])

    @property
    def summary(self) -> dict[str, Any]:
        """The plan in figures: tiles, modes, memory, predicted seconds (on one thread, every pixel lit), device."""
        figures = self._handle.summary()
        del figures["text"]
        return figures

    def describe(self) -> str:
        """Return the plan as a few lines of text.

        Returns
        -------
        str
            Tiles, modes, memory, the device and why it was chosen.
        """
        figures = self._handle.summary()
        return f"{figures['text']}\n{figures['device']}"

    def simulate(
        self,
        scene: Any = None,
        catalog: Any = None,
        out: NDArray[Any] | None = None,
        *,
        progress: Progress | None = None,
    ) -> Any:
        """Return the image of a scene: an image, sources, or both.

        Pixels that are in the machine's byte order and of the plan's type are not copied, whatever the order of rows in memory, as long
        as the pixels of a row are neighbours. The interpreter is free meanwhile, and Ctrl-C stops the work.

        Parameters
        ----------
        scene : array_like, astropy CCDData or Quantity, optional
            Flux in each pixel, ``[y, x]`` of the plan's `shape`; finite. Where the plan is for a region, its `light_region` will do.
        catalog : table, optional
            Stars and galaxies: anything with columns ``x``, ``y`` (0-based pixels of the image, also off it) and ``flux`` (an astropy
            Table, a dict of arrays, a structured array, a data frame); with ``re`` (half-light radius along the major axis in pixels; 0,
            NaN or masked: a star), ``n``, ``q`` and ``angle`` (degrees from +x towards +y) galaxies with Sersic profiles.
        out : numpy.ndarray, optional
            Where the image goes: of `image_shape` and `dtype`. After an interruption its content is undefined.
        progress : callable or tqdm bar, optional
            ``progress(done, total)``, called a few times a second.

        Returns
        -------
        numpy.ndarray, Quantity or CCDData
            The image ``[y, x]``, ``out`` where it was given; with the unit of the scene, and for CCDData its header and world
            coordinates.

        Raises
        ------
        ValueError
            A scene of another shape, values that are not finite or beyond the precision, a source that cannot be (with its row), light
            where there is no PSF.

        Warns
        -----
        PsfieldWarning
            Stars between pixels drawn from stamps that are not oversampled; galaxies on pixels that blur them (``oversample`` below 4).
        """
        if scene is None and catalog is None:
            raise ValueError("there is nothing to convolve: give a scene, a catalog, or both")
        light, unit = None if scene is None else self._scene(scene), unit_of(scene)
        columns = columns_of(catalog, unit)
        target, copied = self._target(out, light, unit)
        image, texts = self._handle.simulate(light, columns, target, as_callback(progress))
        for text in texts:
            warnings.warn(text, PsfieldWarning, stacklevel=2)
        if copied:
            np.copyto(out, target)  # type: ignore[arg-type]
        if out is not None:
            return out
        return like(scene, image, self._shown(light), self._words["oversample"])

    def adjoint(self, image: Any, *, progress: Progress | None = None) -> NDArray[Any]:
        """Apply the transpose: what each pixel of the scene gives to the scalar product of its image with this one.

        ``(A f) . g == f . (A^T g)`` for every scene ``f`` without a catalogue: for gradients and deconvolution.

        Parameters
        ----------
        image : array_like
            ``[y, x]`` of `image_shape`.
        progress : callable or tqdm bar, optional
            ``progress(done, total)``.

        Returns
        -------
        numpy.ndarray
            ``[y, x]`` of `shape`, or of `light_region` where the plan is for a region.
        """
        return self._handle.adjoint(self._image(image), as_callback(progress))

    def linear_operator(self) -> LinearOperator:
        """Return the plan as SciPy's `~scipy.sparse.linalg.LinearOperator`, for its solvers.

        Returns
        -------
        scipy.sparse.linalg.LinearOperator
            From flattened scenes to flattened images, with its adjoint.
        """
        from scipy.sparse.linalg import LinearOperator

        scene_shape = self.shape if self.region is None else self._light_shape()
        (rows, columns), (image_rows, image_columns) = scene_shape, self.image_shape
        return LinearOperator(
            shape=(image_rows * image_columns, rows * columns),
            dtype=self.dtype,
            matvec=lambda scene: self.simulate(np.reshape(scene, scene_shape)).ravel(),
            rmatvec=lambda image: self.adjoint(np.reshape(image, self.image_shape)).ravel(),
        )

    def spot_check(self, scene: Any = None, catalog: Any = None, *, image: Any = None, pixels: int = 500, seed: int = 0) -> SpotCheck:
        """Check an image against the direct sum in double precision at random pixels, half of them where it is bright.

        Parameters
        ----------
        scene, catalog
            As for `simulate`.
        image : array_like, optional
            What `simulate` gave for them; it is simulated where it is not given.
        pixels : int
            How many pixels, at most as many as the image has (or 500).
        seed : int
            Chooses them.

        Returns
        -------
        SpotCheck
            Its ``passed`` is the verdict.
        """
        if scene is None and catalog is None:
            raise ValueError("there is nothing to check: give a scene, a catalog, or both")
        if self.region is not None:
            raise ValueError("plans for a region check nothing: check with a plan of the whole frame")
        # Each costs a direct sum; small images may be looked at more than once.
        pixels = whole(pixels, "pixels", 1, max(500, self.image_shape[0] * self.image_shape[1]))
        seed = whole(seed, "seed", 0, 2**64 - 1)
        light = None if scene is None else self._scene(scene)
        columns = columns_of(catalog, unit_of(scene))
        if image is None:
            image, _ = self._handle.simulate(light, columns, None, None)
        checked = self._handle.spot_check(self._image(image), light, columns, pixels, seed)
        return SpotCheck(**json.loads(checked))

    def _scene(self, scene: Any) -> NDArray[Any]:
        light = numbers(scene, "scene", self.dtype, "[y, x]")
        if light.shape == self.shape or (self.region is not None and light.shape == self._light_shape()):
            return light
        part = "" if self.region is None else f", or their part {self.light_region} of shape {self._light_shape()}"
        raise ValueError(f"scene: the plan is for scenes of shape {self.shape}{part}, got {light.shape}")

    def _shown(self, light: NDArray[Any] | None) -> tuple[int, int]:
        """Return the column and the row of the image's first pixel, in pixels of the image counted from the first of the scene given."""
        x0, y0 = 0, 0
        for part in (self._words["frame"], self.region):
            x0, y0 = (x0 + part[0], y0 + part[1]) if part is not None else (x0, y0)
        if light is None or light.shape == self.shape:
            return x0, y0
        left, top, _, _ = self.light_region
        oversample = self._words["oversample"]
        return x0 - left // oversample, y0 - top // oversample

    def _light_shape(self) -> tuple[int, int]:
        _, _, columns, rows = self.light_region
        return rows, columns

    def _image(self, image: Any) -> NDArray[Any]:
        pixels = numbers(image, "image", self.dtype, "[y, x]")
        if pixels.shape != self.image_shape:
            raise ValueError(f"image: the plan is for images of shape {self.image_shape}, got {pixels.shape}")
        return pixels

    def _target(self, out: Any, light: NDArray[Any] | None, unit: Any) -> tuple[NDArray[Any] | None, bool]:
        """Return where the native module writes to, and whether that is copied to ``out`` afterwards."""
        if out is None:
            return None, False
        if not isinstance(out, np.ndarray):
            raise TypeError(f"out must be a NumPy array, got {type(out).__name__}")
        if out.shape != self.image_shape or out.dtype != self.dtype:
            wanted = f"shape {self.image_shape} and type {self.dtype}"
            raise ValueError(f"out must have {wanted}, got {out.shape} and {out.dtype}")
        if not out.flags.writeable:
            raise ValueError("out is read-only")
        if hasattr(out, "unit") and out.unit != unit:
            raise ValueError(f"out has the unit {out.unit}, the scene {unit or 'none'}")
        overlaps = light is not None and np.may_share_memory(out, light)
        # Rows that share memory must not be written by several threads.
        rows_apart = abs(out.strides[0]) >= out.shape[1] * out.itemsize or out.shape[0] == 1
        direct = out.flags.aligned and out.dtype.isnative and out.strides[1] == out.itemsize and rows_apart and not overlaps
        return (np.asarray(out), False) if direct else (np.empty(self.image_shape, self.dtype), True)

    def __repr__(self) -> str:
        (ny, nx), words = self.shape, self._words
        part = "" if self.region is None else f", region {self.region}"
        device = self.summary["gpu"] or "the CPU"
        return f"<Plan: scenes {ny} x {nx}{part}, tolerance {words['tolerance']:g}, {words['precision']}, on {device}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (self._model, self._words)


def region_of(region: Any, name: str) -> tuple[int, int, int, int] | None:
    """Return first column, first row, columns and rows as plain numbers."""
    if region is None:
        return None
    try:
        x0, y0, nx, ny = (int(np.asarray(n).__index__()) for n in region)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be (x0, y0, nx, ny), four whole numbers, got {region!r}") from None
    if nx < 1 or ny < 1:
        raise ValueError(f"{name} must have columns and rows, got {nx} x {ny}")
    return x0, y0, nx, ny


#: What each argument of a plan but its shape must be.
_CHECKS: dict[str, Callable[[Any, str], Any]] = {
    "tolerance": real,
    "precision": partial(word, known=DTYPES),
    "device": partial(word, known=("auto", "cpu", "gpu")),
    "frame": region_of,
    "region": region_of,
    "anchor": partial(word, known=("source", "output")),
    "method": partial(word, known=("auto", "lowrank")),
    "memory": whole,
    "oversample": partial(whole, least=1),
    "stamp_size": partial(whole_or_none, least=1),
    "gpu_adapter": word_or_none,
    "gpu_memory": whole_or_none,
}


def checked(words: dict[str, Any]) -> dict[str, Any]:
    """Return arguments of a plan in the native module's types."""
    return {name: _CHECKS[name](value, name) for name, value in words.items()}


def _again(model: PsfModel, words: dict[str, Any]) -> Plan:
    """Make a pickled plan again."""
    return Plan(model, **words)

"""Simulations of scenes of one shape."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from psfield import _native
from psfield._arrays import DTYPES, doubles, numbers, precision_of, shape_of
from psfield._astropy import like, unit_of
from psfield._catalog import SOURCE_COLUMNS, Reads, is_path, source_columns, sources_of
from psfield._choices import integer
from psfield._colour import checked_colour, first_image, is_images, native_colour
from psfield._defaults import arguments
from psfield._errors import PsfieldWarning
from psfield._html import FieldsAsTable, size, table
from psfield._progress import Progress, as_callback
from psfield._reports import PlanSummary
from psfield._sky import Sky, sky_of
from psfield._tables import column_names
from psfield.detector import Detector, Exposure, exposure_of

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator


class _Model(Protocol):
    """A `PsfModel`, which makes plans."""

    _handle: _native.PsfModel


class _WithAttributes(Protocol):
    """An array with attributes that its image shares: CCDData, Quantity or DataArray."""

    @property
    def wcs(self) -> Any: ...


class _WithLabels(Protocol):
    @property
    def coords(self) -> Any: ...


class _WithUnit(Protocol):
    @property
    def unit(self) -> Any: ...


Out = TypeVar("Out", bound=NDArray[Any])
#: Types of scenes whose images have the same type.
Labelled = TypeVar("Labelled", bound=_WithAttributes | _WithLabels | _WithUnit)


@dataclass(frozen=True)
class DroppedLight(FieldsAsTable):
    """Upper limits of the light of sources that a plan drops because it is below the floor.

    `Plan.dropped_light` returns it.

    Attributes
    ----------
    largest : float
        The largest sum of dropped light in any pixel is at most this, in flux per pixel.
    fraction : float
        The fraction of the sources' flux that is dropped is at most about this.

    Examples
    --------
    >>> import psfield
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> model.plan((20, 30)).dropped_light({"x": [14.0], "y": [12.0], "flux": [10.0]})
    DroppedLight(largest=0.0, fraction=0.0)
    """

    largest: float
    fraction: float


@dataclass(frozen=True)
class SpotCheck(FieldsAsTable):
    """A comparison of an image with the direct sum in double precision at random pixels.

    `Plan.spot_check` returns it.

    Attributes
    ----------
    pixels : int
        Number of pixels compared.
    seed : int
        Seed that chose the pixels.
    max_abs, rms : float
        Largest absolute difference, and root mean square difference.
    max_over_peak : float or None
        Largest difference, divided by the largest absolute value of the image.
    relative_rms : float or None
        ``rms``, divided by the root mean square of the direct sum at the same pixels.
    limit : float or None
        Largest ``relative_rms`` that passes the check. It is larger than the tolerance where the
        light of several sources overlaps.
    worst_pixel : float or None
        Largest difference in a pixel, divided by the largest that the tolerance allows there.
    sources : int
        Number of stars, galaxies and pixels of the scene around which 7 x 7 pixels were compared.
    worst_source : float or None
        Largest difference around a source (the root of the sum of its squares), divided by the
        largest that the tolerance allows there.
    passed : bool or None
        True if ``relative_rms`` is within the limit, and ``worst_pixel`` and ``worst_source`` are
        at most 1. None if the method promises nothing.

    Examples
    --------
    >>> import psfield
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> check = model.plan((20, 30), 1e-3).spot_check([[1.0] * 30] * 20)
    >>> check.passed, check.pixels, check.max_over_peak < 1e-3
    (True, 500, True)
    """

    pixels: int
    seed: int
    max_abs: float
    rms: float
    max_over_peak: float | None
    relative_rms: float | None
    limit: float | None
    worst_pixel: float | None
    sources: int
    worst_source: float | None
    passed: bool | None


class Plan:
    """The part of a simulation that does not depend on the light, for scenes of one shape.

    `PsfModel.plan` makes it.

    A plan is a linear operator from scenes to images. It may be used from many threads at once. It
    can be pickled. A plan that is loaded from a pickle is computed again. The part for stars and
    galaxies is computed when it is first needed, and kept.

    Examples
    --------
    >>> import psfield
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> plan = model.plan((3, 4), tolerance=1e-4)
    >>> image = plan.simulate(catalog={"x": [1], "y": [1], "flux": [8]})
    >>> (image.round(2) + 0.0).tolist()  # + 0.0 turns -0.0 into 0.0
    [[0.0, 1.0, 0.0, 0.0], [1.0, 4.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0]]
    """

    __slots__ = ("_handle", "_model", "_settings")

    def __init__(self, model: _Model, shape: tuple[int, int], **settings: Any) -> None:
        if "tolerance" not in settings:
            raise TypeError("make a Plan with PsfModel.plan")
        self._model = model
        self._settings = {**checked(settings), "shape": shape_of(shape, "shape")}
        self._handle = _native.Plan(
            model._handle,
            self._settings["shape"],
            self._settings["precision"],
            arguments("plan", self._settings),
            native_colour(self._settings),
        )

    def for_region(self, region: tuple[int, int, int, int]) -> Plan:
        """Return a plan for another region of the same frame, with the tiles of this plan.

        This takes much less time than `PsfModel.plan`, which has to choose the tiles.

        Parameters
        ----------
        region : (int, int, int, int)
            First column, first row, columns, rows, in pixels of the image counted from the first
            pixel of the frame.

        Returns
        -------
        Plan

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> left = model.plan((20, 30), region=(0, 0, 15, 20))
        >>> right = left.for_region((15, 0, 15, 20))
        >>> right.region, right.image_shape
        ((15, 0, 15, 20), (20, 15))
        """
        if region is None:
            raise TypeError("region must be (x0, y0, nx, ny), four integers, got None")
        at = tuple(_native.plan_settings({"region": region})["region"])
        return self._derived(
            self._handle.for_region(at), self._model, {**self._settings, "region": at}
        )

    def with_psf(self, model: _Model) -> Plan:
        """Return a plan for another PSF, with the settings and the tiles of this plan.

        This takes much less time than `PsfModel.plan`, which has to choose the tiles. Use it for
        frames that have a PSF of their own each, such as other coefficients of one basis. The
        tolerance holds for every model. If the stamps have another shape, the plan is made anew.

        Parameters
        ----------
        model : PsfModel
            The other PSF.

        Returns
        -------
        Plan

        Examples
        --------
        >>> import psfield
        >>> stamps = [[[0, 1, 0], [1, 4, 1], [0, 1, 0]], [[1, 1, 1], [1, 1, 1], [1, 1, 1]]]
        >>> sharp, wide = (psfield.PsfModel.from_samples(stamp, (0, 0)) for stamp in stamps)
        >>> plan = sharp.plan((3, 5), tolerance=1e-4)
        >>> scene = [[0, 0, 0, 0, 0], [0, 0, 9, 0, 0], [0, 0, 0, 0, 0]]
        >>> plan.with_psf(wide).simulate(scene).round(2)[1].tolist()
        [0.0, 1.0, 1.0, 1.0, 0.0]
        """
        return self._derived(self._handle.with_psf(model._handle), model, self._settings)

    @staticmethod
    def _derived(handle: _native.Plan, model: _Model, settings: dict[str, Any]) -> Plan:
        """Return a plan that the native module made from another one."""
        other = Plan.__new__(Plan)
        other._handle, other._model, other._settings = handle, model, settings
        return other

    @property
    def model(self) -> Any:
        """The `PsfModel` of the PSF.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> model.plan((4, 6)).model is model
        True
        """
        return self._model

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the scenes.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).plan((4, 6)).shape
        (4, 6)
        """
        shape: tuple[int, int] = self._settings["shape"]
        return shape

    @property
    def image_shape(self) -> tuple[int, int]:
        """Rows and columns of the images.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0))
        >>> model.plan((4, 6), frame=(0, 0, 3, 4)).image_shape
        (4, 3)
        """
        return self._handle.frame_shape()

    @property
    def region(self) -> tuple[int, int, int, int] | None:
        """Part of the frame that images show: first column, first row, columns, rows.

        None for the whole frame.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0))
        >>> model.plan((40, 60), region=(0, 0, 30, 40)).region
        (0, 0, 30, 40)
        """
        region: tuple[int, int, int, int] | None = self._settings["region"]
        return region

    @property
    def light_region(self) -> tuple[int, int, int, int]:
        """Part of the scene whose light reaches the images.

        First column, first row, columns, rows, in pixels of the scene.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> model.plan((40, 60), region=(0, 0, 30, 40)).light_region
        (0, 0, 31, 40)
        """
        return self._handle.light_region()

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the pixels of the images.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).plan((4, 6), precision="f64").dtype
        dtype('float64')
        """
        return DTYPES[self._settings["precision"]]

    @property
    def tolerance(self) -> float:
        """Largest relative L2 error that the engine may add to the PSF of any pixel.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).plan((4, 6), 1e-3).tolerance
        0.001
        """
        return float(self._settings["tolerance"])

    @property
    def summary(self) -> PlanSummary:
        """Properties of the plan: tiles, modes, memory, device and predicted seconds.

        Examples
        --------
        >>> import psfield
        >>> plan = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).plan((4, 6), device="cpu")
        >>> plan.summary.shape, plan.summary.tiles
        ((4, 6), 1)
        """
        properties = self._handle.summary()
        del properties["text"]
        return PlanSummary(**properties)

    @property
    def blocks(self) -> NDArray[Any]:
        """Blocks of the plan, row by row: a structured array of x0, y0, nx, ny and modes.

        Each block has its own modes: the stamps that represent all its PSFs. ``modes`` is their
        number. First column and row, columns and rows are in pixels of the scene. The blocks cover
        the `light_region` or, with ``anchor="output"``, the part of the scene that the image shows.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> plan = model.plan((40, 60), tolerance=1e-3)
        >>> plan.blocks["modes"].tolist(), int((plan.blocks["nx"] * plan.blocks["ny"]).sum())
        ([1], 2400)
        """
        names = ("x0", "y0", "nx", "ny", "modes")
        return np.array(self._handle.blocks(), dtype=[(name, np.int64) for name in names])

    def describe(self) -> str:
        """Return a description of the plan in a few lines of text.

        Returns
        -------
        str
            Tiles, modes, memory, the device and the reason for its choice.

        Examples
        --------
        >>> import psfield
        >>> plan = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).plan((4, 6), device="cpu")
        >>> len(plan.describe().splitlines()) > 1
        True
        """
        properties = self._handle.summary()
        return f"{properties['text']}\n{properties['device']}"

    @overload
    def simulate(
        self,
        scene: Any,
        catalog: Any,
        out: Out,
        *,
        wcs: Any = None,
        progress: Progress | None = None,
    ) -> Out: ...
    @overload
    def simulate(
        self,
        scene: Any = None,
        catalog: Any = None,
        *,
        out: Out,
        wcs: Any = None,
        progress: Progress | None = None,
    ) -> Out: ...
    @overload
    def simulate(
        self,
        scene: Labelled,
        catalog: Any = None,
        out: None = None,
        *,
        wcs: Any = None,
        progress: Progress | None = None,
    ) -> Labelled: ...
    @overload
    def simulate(
        self,
        scene: ArrayLike | None = None,
        catalog: Any = None,
        out: None = None,
        *,
        wcs: Any = None,
        progress: Progress | None = None,
    ) -> NDArray[Any]: ...
    def simulate(
        self,
        scene: Any = None,
        catalog: Any = None,
        out: NDArray[Any] | None = None,
        *,
        wcs: Any = None,
        progress: Progress | None = None,
    ) -> Any:
        """Return the image of a scene, of a catalogue of sources, or of both.

        A scene is not copied if it has the type of the plan and the byte order of the machine, and
        the pixels of a row are adjacent in memory, unless the plan is in colour. The order of the
        rows does not matter. The call releases the interpreter while it works, and Ctrl-C cancels
        it.

        Parameters
        ----------
        scene : array_like, Quantity, CCDData or xarray.DataArray, optional
            Flux in each pixel, ``[y, x]`` with the `shape` of the plan, finite. A plan for a region
            also accepts only its `light_region`. An array ``[n, y, x]`` (or a list of arrays, or
            an array with more axes before y, such as ``[n, 1, y, x]``) is a stack of scenes,
            without a catalogue. For many small scenes this is faster than a loop. A plan in colour
            (``bandpass``) also takes a dict of images by the names of their spectra:
            ``{"blackbody:4000": image, ...}``.
        catalog : table or path, optional
            Stars and galaxies, as a table (astropy Table, dict of arrays, structured array, data
            frame) or as a CSV or FITS file that `read_catalog` can read. The columns are ``x``,
            ``y`` (or ``x_0``, ``y_0``) and ``flux``. Positions are in pixels of the image, counted
            from the first pixel of the scene (0-based). They may lie outside the scene. In place of
            ``x`` and ``y``, a table may have ``ra`` and ``dec`` (degrees) or a ``SkyCoord``.
            Galaxies have a Sersic profile with the columns ``re`` (half-light radius along the
            major axis in pixels, 0 for a star), ``n``, ``q`` and ``angle`` (degrees from +x towards
            +y), and the reduced shear ``g1`` and ``g2`` that is applied to this profile (as
            GalSim's ``shear(g1=, g2=)``, without it ``q`` and ``angle`` are those of the image). A
            number in place of a column holds for all rows. Fluxes may be negative, but not 0. Stars
            and galaxies do not depend on the scene's pixels (``oversample``). A plan in colour
            reads the spectrum of each source: the column ``sed`` (a name) or ``teff`` (a black
            body, kelvin).
        out : numpy.ndarray, optional
            Array to which the image is written, with `image_shape` and `dtype`, or a stack of such
            images for a stack of scenes. Its content is undefined after an interruption.
        wcs : astropy.wcs.WCS or gwcs.WCS, optional
            World coordinates of the pixels in which ``x`` and ``y`` count, for positions on the
            sky. Default: those of the scene.
        progress : callable or tqdm bar, optional
            ``progress(done, total)``, called a few times per second.

        Returns
        -------
        numpy.ndarray, Quantity, CCDData or xarray.DataArray
            The image ``[y, x]``, or a stack for a stack of scenes, or ``out`` if that is given. It
            has the unit of the scene. For a single CCDData it also has the header and the world
            coordinates of the scene.

        Raises
        ------
        ValueError
            The scene has another shape, a value is not finite or too large for the precision, a
            source is invalid (the text names its row), or there is light where the PSF is unknown.

        Warns
        -----
        PsfieldWarning
            There are galaxies, or stars between pixels, and the stamps are too coarse to be
            interpolated for them. Or the model does not keep the tolerance for the flux in circles
            about a source. Or the catalogue has no sources, or none whose light reaches the frame.
            Or the plan exceeds its memory, so that each call makes parts of it again.

        Examples
        --------
        >>> import numpy as np
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> plan = model.plan((3, 4), tolerance=1e-4)
        >>> scene = np.zeros((3, 4))
        >>> scene[1, 2] = 8
        >>> plan.simulate(scene).round(2).tolist()
        [[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 4.0, 1.0], [0.0, 0.0, 1.0, 0.0]]
        >>> image = plan.simulate(catalog={"x": [0, 3], "y": [1, 1], "flux": 8})
        >>> (image.round(2) + 0.0).tolist()  # + 0.0 turns -0.0 into 0.0
        [[1.0, 0.0, 0.0, 1.0], [4.0, 1.0, 1.0, 4.0], [1.0, 0.0, 0.0, 1.0]]
        >>> plan.simulate(np.stack([scene, 2 * scene, 3 * scene])).shape
        (3, 3, 4)
        """
        return self._image_of(scene, catalog, out, wcs, progress)

    def _image_of(self, scene: Any, catalog: Any, out: Any, wcs: Any, progress: Any) -> Any:
        """Return what `simulate` returns. Warnings name the line that calls the caller."""
        if scene is None and catalog is None:
            raise ValueError("there is nothing to simulate: give a scene, a catalog, or both")
        if is_stack(scene):
            return self._simulate_stack(scene, catalog, out, progress)
        images, scene = self._images(scene), first_image(scene)
        light, unit = images[0][1] if images else None, unit_of(scene)
        sources = self._sources(catalog, scene, light, wcs, 4)
        if sources is not None and not len(sources):
            warnings.warn("catalog: there are no sources", PsfieldWarning, stacklevel=3)
        overlap = [pixels for _, pixels in images]
        target, copied = self._target(out, overlap, unit)
        image, texts = self._handle.simulate(images, sources, target, as_callback(progress))
        for text in texts:
            warnings.warn(text, PsfieldWarning, stacklevel=3)
        if copied:
            np.copyto(out, target)  # type: ignore[arg-type]
        if out is not None:
            return out
        return like(scene, image, self._shown(light), self._settings["oversample"])

    def _simulate_stack(self, scenes: Any, catalog: Any, out: Any, progress: Any) -> Any:
        """Return the images of scenes ``[n, y, x]``."""
        if catalog is not None:
            raise ValueError(
                "catalog: a stack of scenes has no catalogue: simulate the scenes one by one"
            )
        lights, unit = _stack(scenes, "scene", self.dtype)
        check_spectrum(self._settings)
        self._check_scene_shape(lights.shape[-2:])
        outer = lights.shape[:-2]
        target, copied = self._target(out, [lights], unit, outer)
        lights = lights.reshape(-1, *lights.shape[-2:])
        flat = None if target is None else target.reshape(-1, *self.image_shape)
        images, texts = self._handle.simulate_many(lights, flat, as_callback(progress))
        for text in texts:
            warnings.warn(text, PsfieldWarning, stacklevel=4)
        if copied:
            np.copyto(out, target)  # type: ignore[arg-type]
        if out is not None:
            return out
        images = images.reshape(*outer, *self.image_shape)  # type: ignore[union-attr]
        return images if unit is None else images << unit

    def adjoint(
        self,
        image: Any,
        *,
        spectra: Sequence[str] | None = None,
        progress: Progress | None = None,
    ) -> Any:
        """Apply the transpose of `simulate` to an image, for gradients and deconvolution.

        ``(A f) . g == f . (A^T g)`` for every scene ``f`` without a catalogue, and every image
        ``g``.

        Parameters
        ----------
        image : array_like
            ``[y, x]`` with `image_shape`, or a stack of such images, as for `simulate`.
        spectra : sequence of str, optional
            In colour: the names of the spectra of the scene's images. Default: that of the plan.
        progress : callable or tqdm bar, optional
            ``progress(done, total)``. With several ``spectra``, for each image of a stack anew.

        Returns
        -------
        numpy.ndarray or dict
            ``[y, x]`` with `shape`, or with the shape of `light_region` if the plan is for a
            region. For a stack, a stack. With ``spectra``, a dict of such arrays by their names.

        Examples
        --------
        >>> import numpy as np
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 2], [0, 0, 0]], (0, 0))
        >>> plan = model.plan((3, 4), tolerance=1e-6, precision="f64")
        >>> f, g = np.arange(12.0).reshape(3, 4), np.ones((3, 4))
        >>> bool(np.isclose(np.vdot(plan.simulate(f), g), np.vdot(f, plan.adjoint(g))))
        True
        """
        if spectra is None:
            check_spectrum(self._settings)
            names = [] if self._settings["sed"] is None else [self._settings["sed"]]
        else:
            if self._settings["bandpass"] is None:
                raise ValueError("spectra needs a plan in colour: PsfModel.plan(..., bandpass=)")
            if isinstance(spectra, str) or not spectra:
                raise TypeError(f"spectra must be a list of names, got {spectra!r}")
            names = sorted({os.fspath(name) for name in spectra})
        if is_stack(image):
            images, _ = _stack(image, "image", self.dtype)
            self._check_image_shape(images.shape[-2:])
        else:
            images = self._image(image)
        outer = images.shape[:-2]
        if outer and len(names) <= 1:
            flat = images.reshape(-1, *images.shape[-2:])
            made = self._handle.adjoint_many(flat, (*names, None)[0], as_callback(progress))
            light = made.reshape(*outer, *made.shape[-2:])
            return light if spectra is None else {names[0]: light}
        found = [
            self._handle.adjoint(images[index], names, as_callback(progress))
            for index in np.ndindex(outer)
        ]
        layers = [
            np.reshape(layer, (*outer, *layer[0].shape)) if outer else layer[0]
            for layer in zip(*found, strict=True)
        ]
        return layers[0] if spectra is None else dict(zip(names, layers, strict=True))

    def source_gradients(self, catalog: Mapping[str, Any], image: Any) -> dict[str, Any]:
        """Return derivatives with respect to sources, for fits of fluxes, positions and shapes.

        They are those of ``(simulate(catalog=catalog) * image).sum()`` with respect to each number
        of the catalogue. So if ``image`` is the derivative of a number, such as chi-square, with
        respect to the image of the sources, these are the derivatives of this number. They include
        the change of the PSF with the position, and keep the tolerance. They leave out the
        ``floor``: sources without flux have a derivative with respect to it, too. The warnings of
        `simulate` are not repeated.

        Parameters
        ----------
        catalog : dict of str to array_like
            Columns ``x``, ``y`` and ``flux`` and, for galaxies, ``re`` (0 for a star), ``n``, ``q``
            and ``angle``, as for `simulate`. Each is ``[source]``, or a number for all sources.
        image : array_like
            ``[y, x]`` with `image_shape`.

        Returns
        -------
        dict of str to numpy.ndarray
            For each column of the catalogue, ``[source]``.

        Raises
        ------
        TypeError
            The catalogue is not a dict.
        ValueError
            A column is missing or unknown, a source is not valid, or the PSF has wings.

        Examples
        --------
        >>> import numpy as np
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> plan = model.plan((20, 30), tolerance=1e-6, precision="f64")
        >>> stars = {"x": [12.0, 13.0], "y": [9.0, 9.0], "flux": [80.0, 40.0]}
        >>> pixel = np.zeros((20, 30))
        >>> pixel[9, 12] = 1.0
        >>> gradient = plan.source_gradients(stars, pixel)
        >>> gradient["flux"].round(6).tolist()  # the part of each flux in this pixel
        [0.5, 0.125]
        """
        check_spectrum(self._settings)
        columns = np.broadcast_arrays(*map(np.atleast_1d, source_columns(catalog).values()))
        if columns[0].ndim > 1:
            raise ValueError(f"catalog: columns must be [source], got {list(columns[0].shape)}")
        found = self._handle.source_gradients(np.stack(columns), self._image(image))
        return {name: found[SOURCE_COLUMNS.index(name)] for name in catalog}

    def linear_operator(self) -> LinearOperator:
        """Return the plan as SciPy's `~scipy.sparse.linalg.LinearOperator`, for its solvers.

        Returns
        -------
        scipy.sparse.linalg.LinearOperator
            Operator from flattened scenes to flattened images, with its adjoint.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> import scipy.sparse.linalg
        >>> model.plan((3, 4)).linear_operator().shape
        (12, 12)
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

    def expose(
        self,
        scene: Any = None,
        catalog: Any = None,
        *,
        detector: Detector,
        seed: int,
        shoot_below: float | Literal["auto"] = 0,
        bad_pixels: Any = None,
        wcs: Any = None,
    ) -> Exposure:
        """Simulate a scene, a catalogue of stars and galaxies, or both, and expose the image.

        Parameters
        ----------
        scene, catalog, wcs
            As for `simulate`, without stacks of scenes.
        detector : psfield.detector.Detector
            The detector.
        seed : int
            Seed of the noise.
        shoot_below : float or 'auto'
            Stars and galaxies of fewer expected photons are drawn photon by photon, which is faster
            for faint ones. Their photons are Poisson distributed, as those of light in the image.
            ``auto``: the sources for which it is predicted to be faster. It needs photon noise.
        bad_pixels : array_like, optional
            As for `psfield.detector.Detector.expose`.

        Returns
        -------
        psfield.detector.Exposure

        Examples
        --------
        >>> import psfield
        >>> from psfield.detector import Detector
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> stars = {"x": [4.0, 9.0], "y": [5.0, 2.0], "flux": [30.0, 2e4]}
        >>> camera = Detector(photon_noise=True)
        >>> plan = model.plan((12, 16))
        >>> exposure = plan.expose(None, stars, detector=camera, seed=1, shoot_below=100)
        >>> exposure.counts.shape
        (12, 16)
        """
        if not isinstance(detector, Detector):
            raise TypeError(f"detector must be a Detector, got {type(detector).__name__}")
        if scene is None and catalog is None:
            raise ValueError("there is nothing to expose: give a scene, a catalog, or both")
        if is_stack(scene):
            raise ValueError("scene: a stack of scenes cannot be exposed: expose them one by one")
        seed = integer(seed, "seed", 0, 2**64 - 1)
        is_auto = isinstance(shoot_below, str) and shoot_below == "auto"
        if not is_auto and not (isinstance(shoot_below, Real) and 0 <= shoot_below < np.inf):
            raise ValueError(f"shoot_below must be 'auto' or at least 0, got {shoot_below!r}")
        below = -1.0 if is_auto else float(shoot_below)
        mask = None if bad_pixels is None else doubles(bad_pixels, "bad_pixels", "[y, x]")
        images, scene = self._images(scene), first_image(scene)
        light = images[0][1] if images else None
        sources = self._sources(catalog, scene, light, wcs, 3)
        found, texts = self._handle.expose(images, sources, detector._handle, seed, below, mask)
        for text in texts:
            warnings.warn(text, PsfieldWarning, stacklevel=2)
        return exposure_of(*found)

    def truth_table(
        self, catalog: Any, scene: Any = None, *, flags: Any = None, wcs: Any = None
    ) -> dict[str, NDArray[Any]]:
        """Return a table of the sources as they are in the image.

        Parameters
        ----------
        catalog, scene, wcs
            As for `simulate`.
        flags : numpy.ndarray, optional
            The ``flags`` of an exposure of this catalogue.

        Returns
        -------
        dict of str to numpy.ndarray
            In the order of the catalogue's rows: ``row`` (from 0), ``x`` and ``y`` (0-based pixels
            of the image), ``ra`` and ``dec`` (degrees at the date of the image, if psfield knows
            its world coordinates), ``flux``, ``in_frame``, and with ``flags`` also
            ``saturated_pixels``: how many pixels the saturated area at the source has (0: none).

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> plan = model.plan((12, 16))
        >>> table = plan.truth_table({"x": [4.0, 99.0], "y": [5.0, 2.0], "flux": [30.0, 2e4]})
        >>> table["in_frame"].tolist()
        [True, False]
        """
        images, scene = self._images(scene), first_image(scene)
        light = images[0][1] if images else None
        sources = self._sources(catalog, scene, light, wcs, 3)
        if sources is None:
            raise ValueError("catalog: give a catalogue of stars and galaxies")
        sky = self._sky(scene, light, wcs)
        if flags is not None:
            flags = np.asarray(flags, dtype=np.uint8)
            if flags.shape != self.image_shape:
                raise ValueError(
                    f"flags must have the shape of the image, {self.image_shape}, not {flags.shape}"
                )
        cards = None if sky is None else sky.known_cards()
        return self._handle.truth_table(sources, cards, flags)

    def dropped_light(self, catalog: Any, *, wcs: Any = None) -> DroppedLight:
        """Return upper limits of the light that is dropped because it is below the floor.

        Parameters
        ----------
        catalog, wcs
            As for `simulate`.

        Returns
        -------
        DroppedLight
            Zeros for a plan without a floor, whose ``floor`` is 0.

        Examples
        --------
        >>> import psfield
        >>> stamp = [[1, 1, 1, 1, 1], [1, 9, 9, 9, 1], [1, 9, 99, 9, 1], [1, 9, 9, 9, 1], [1] * 5]
        >>> model = psfield.PsfModel.from_samples(stamp, (0, 0))
        >>> plan = model.plan((30, 30), floor=0.5)
        >>> plan.dropped_light({"x": [14.0], "y": [12.0], "flux": [10.0]}).largest <= 0.5
        True
        """
        sources = self._sources(catalog, None, None, wcs, 3)
        if sources is None:
            raise ValueError("catalog: give a catalogue of stars and galaxies")
        return DroppedLight(*self._handle.dropped_light(sources))

    def spot_check(
        self,
        scene: Any = None,
        catalog: Any = None,
        *,
        wcs: Any = None,
        image: Any = None,
        pixels: int = 500,
        seed: int = 0,
    ) -> SpotCheck:
        """Compare an image with the direct sum in double precision at random pixels.

        Half of the pixels are chosen where the image is bright. The pixels around up to 32 stars,
        32 galaxies and 32 pixels of the scene are compared too.

        Parameters
        ----------
        scene, catalog, wcs
            As for `simulate`.
        image : array_like, optional
            The result of `simulate` for this scene and catalogue. By default it is computed here.
        pixels : int
            Number of pixels, at most the number of pixels of the image, or 500 if that is more.
        seed : int
            Seed that chooses the pixels.

        Returns
        -------
        SpotCheck
            Its ``passed`` is the result of the check.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> model.plan((20, 30), tolerance=1e-3).spot_check([[1.0] * 30] * 20, pixels=100).passed
        True
        """
        if scene is None and catalog is None:
            raise ValueError("there is nothing to check: give a scene, a catalog, or both")
        if self.region is not None:
            raise ValueError(
                "a plan for a region cannot be checked: check with a plan of the whole frame"
            )
        # Each pixel costs a direct sum. Pixels of small images may be chosen more than once.
        most = max(500, self.image_shape[0] * self.image_shape[1])
        pixels = integer(pixels, "pixels", 1, most)
        seed = integer(seed, "seed", 0, 2**64 - 1)
        images, scene = self._images(scene), first_image(scene)
        light = images[0][1] if images else None
        sources = self._sources(catalog, scene, light, wcs, 3)
        if image is None:
            image, _ = self._handle.simulate(images, sources, None, None)
        found = self._handle.spot_check(self._image(image), images, sources, pixels, seed)
        return SpotCheck(**json.loads(found))

    def _images(self, scene: Any) -> list[tuple[str | None, NDArray[Any]]]:
        images = images_of(scene, self._settings)
        for _, image in images:
            self._check_scene_shape(image.shape)
        return images

    def _sources(
        self, catalog: Any, scene: Any, light: NDArray[Any] | None, wcs: Any, stacklevel: int
    ) -> _native.Sources | None:
        """Return the sources of a catalogue, in pixels of the image from the scene's first one.

        ``stacklevel`` is that of the user's line, for warnings.
        """
        sky = self._sky(scene, light, wcs)
        reads = Reads(spectra=self._settings["bandpass"] is not None)
        return sources_of(catalog, unit_of(scene), sky, reads, stacklevel + 1)

    def _sky(self, scene: Any, light: NDArray[Any] | None, wcs: Any) -> Sky | None:
        """Return the world coordinates of the image from the scene's first pixel, if any."""
        is_part = light is not None and light.shape != self.shape
        first = self.light_region[:2] if is_part else (0, 0)
        return sky_of(scene, wcs, self._settings["oversample"], first)

    def _check_scene_shape(self, shape: tuple[int, ...]) -> None:
        """Refuse a scene that is neither the whole scene nor the part that reaches the region."""
        for_region = self.region is not None and shape == self._light_shape()
        if shape == self.shape or for_region:
            return
        expected = f"{self.shape}"
        if self.region is not None:
            expected += f", or {self._light_shape()} for the light_region {self.light_region}"
        raise ValueError(f"scene: the plan is for scenes of shape {expected}, got {shape}")

    def _shown(self, light: NDArray[Any] | None) -> tuple[int, int]:
        """Return the column and the row of the first pixel of the image.

        They are in pixels of the image, counted from the first pixel of the given scene.
        """
        x0, y0 = 0, 0
        for part in (self._settings["frame"], self.region):
            x0, y0 = (x0 + part[0], y0 + part[1]) if part is not None else (x0, y0)
        if light is None or light.shape == self.shape:
            return x0, y0
        left, top, _, _ = self.light_region
        oversample = self._settings["oversample"]
        return x0 - left // oversample, y0 - top // oversample

    def _light_shape(self) -> tuple[int, int]:
        """Return rows and columns of the part of the scene whose light reaches the image."""
        _, _, columns, rows = self.light_region
        return rows, columns

    def _image(self, image: Any) -> NDArray[Any]:
        """Return the pixels of an image in the type of the plan."""
        pixels = numbers(image, "image", self.dtype, "[y, x]")
        self._check_image_shape(pixels.shape)
        return pixels

    def _check_image_shape(self, shape: tuple[int, ...]) -> None:
        """Refuse an image of another shape than those of the plan."""
        if shape != self.image_shape:
            raise ValueError(
                f"image: the plan is for images of shape {self.image_shape}, got {shape}"
            )

    def _target(
        self, out: Any, lights: list[NDArray[Any]], unit: Any, outer: tuple[int, ...] = ()
    ) -> tuple[NDArray[Any] | None, bool]:
        """Return the array that the native module writes to.

        The second value says whether that array must be copied to ``out`` afterwards. ``outer`` is
        the shape of a stack of images.
        """
        shape = (*outer, *self.image_shape)
        if out is None:
            return None, False
        if not isinstance(out, np.ndarray):
            raise TypeError(f"out must be a NumPy array, got {type(out).__name__}")
        if out.shape != shape or out.dtype != self.dtype:
            wanted = f"shape {shape} and type {self.dtype}"
            raise ValueError(f"out must have {wanted}, got {out.shape} and {out.dtype}")
        if not out.flags.writeable:
            raise ValueError("out is read-only")
        if hasattr(out, "unit") and out.unit != unit:
            raise ValueError(f"out has the unit {out.unit}, but the scene has {unit or 'none'}")
        overlaps = any(np.may_share_memory(out, light) for light in lights)
        # Several threads must not write to rows or images that share memory.
        apart = all(
            abs(stride) >= abs(inner) * length or count == 1
            for stride, inner, length, count in zip(
                out.strides[:-1], out.strides[1:], out.shape[1:], out.shape[:-1], strict=True
            )
        )
        pixels_adjacent = out.strides[-1] == out.itemsize and out.flags.aligned
        # The native module knows stacks with one axis of images.
        one_axis = len(outer) <= 1 or out.flags.c_contiguous
        if pixels_adjacent and out.dtype.isnative and apart and one_axis and not overlaps:
            return np.asarray(out), False
        return np.empty(shape, self.dtype), True

    def __repr__(self) -> str:
        (ny, nx), settings = self.shape, self._settings
        colour = "" if settings["bandpass"] is None else " in colour"
        finer = "" if settings["oversample"] == 1 else f", oversample {settings['oversample']}"
        frame = "" if settings["frame"] is None else f", frame {settings['frame']}"
        part = "" if self.region is None else f", region {self.region}"
        # Without a spectrum of its own, the plan would be made only to tell its device.
        lazy = settings["bandpass"] is not None and settings["sed"] is None
        device = "any device" if lazy else self.summary.gpu or "the CPU"
        return (
            f"<Plan: scenes {ny} x {nx}{colour}{finer}{frame}{part},"
            f" tolerance {settings['tolerance']:g}, {settings['precision']}, on {device}>"
        )

    def _repr_html_(self) -> str:
        found, settings = self.summary, self._settings
        tile_rows, tile_columns = found.tile_shape
        rows = {
            "Scenes": size(self.shape),
            "Oversampling": None if settings["oversample"] == 1 else settings["oversample"],
            "Frame (x0, y0, nx, ny)": settings["frame"],
            "Region (x0, y0, nx, ny)": self.region,
            "Images": size(self.image_shape),
            "Tolerance": f"{self.tolerance:g} ({found.tolerance_on})",
            "Precision": found.precision,
            "Anchor": found.anchor,
            "Device": found.device,
            "Tiles": f"{found.tiles}, of at most {tile_rows} x {tile_columns}",
            "Blocks": found.blocks,
            "Modes per block": f"mean {found.mean_modes:.2f}, most {found.most_modes}",
            "Memory kept": f"{found.kept_bytes / 2**20:.1f} MiB",
            "Predicted time": f"{found.predicted_seconds:.2g} s (one thread, every pixel lit)",
        }
        return table("Plan", rows)

    def __copy__(self) -> Plan:
        return self  # A plan does not change.

    def __deepcopy__(self, memo: dict[int, Any]) -> Plan:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (self._model, self._settings)


def images_of(scene: Any, settings: Mapping[str, Any]) -> list[tuple[str | None, NDArray[Any]]]:
    """Return the images of a scene in the type of a plan, and the names of their spectra.

    ``settings`` are checked arguments of a plan.
    """
    if scene is None:
        return []
    dtype = DTYPES[settings["precision"]]
    if is_images(scene):
        if settings["bandpass"] is None:
            raise ValueError(
                "scene: images by the names of their spectra need a plan in colour:"
                " PsfModel.plan(..., bandpass=)"
            )
        units = {str(unit_of(image)) for image in scene.values()}
        if len(units) > 1:
            raise ValueError(f"scene: its images have different units: {', '.join(sorted(units))}")
        for name in scene:
            if not isinstance(name, (str, os.PathLike)):
                raise TypeError(f"scene: the name of a spectrum must be a string, got {name!r}")
        return [
            (os.fspath(name), numbers(image, f"scene[{name!r}]", dtype, "[y, x]"))
            for name, image in scene.items()
        ]
    if column_names(scene) is not None or is_path(scene):
        kind = f"the path {scene!r}" if is_path(scene) else "a table"
        raise TypeError(f"scene must be an array [y, x], got {kind}: did you mean catalog=?")
    check_spectrum(settings)
    return [(None, numbers(scene, "scene", dtype, "[y, x]"))]


def check_spectrum(settings: Mapping[str, Any]) -> None:
    """Refuse an image without a spectrum if a plan is in colour and has none either."""
    if settings["bandpass"] is not None and settings["sed"] is None:
        raise ValueError(
            "the image has no spectrum: give PsfModel.plan(..., sed=), or images by the names of"
            " their spectra, {name: image}"
        )


def is_stack(scene: Any) -> bool:
    """Return whether a scene is an array ``[..., y, x]`` of scenes, or a list of arrays."""
    if isinstance(scene, (list, tuple)):
        return len(scene) > 0 and np.ndim(scene[0]) >= 2
    return getattr(scene, "ndim", 0) >= 3


def _stack(planes: Any, name: str, dtype: Any) -> tuple[NDArray[Any], Any]:
    """Return the pixels ``[..., y, x]`` of a stack of scenes or images, and their unit."""

    def axes(array: Any) -> str:
        return f"[{', '.join(['n'] * (np.ndim(array) - 2) + ['y', 'x'])}]"

    if not isinstance(planes, (list, tuple)):
        return numbers(planes, name, dtype, axes(planes)), unit_of(planes)
    units = [unit_of(plane) for plane in planes]
    for i, unit in enumerate(units):
        if unit != units[0]:
            raise ValueError(f"{name}[{i}] has the unit {unit}, but {name}[0] has {units[0]}")
    pixels = [numbers(plane, f"{name}[{i}]", dtype, axes(plane)) for i, plane in enumerate(planes)]
    for i, plane in enumerate(pixels):
        if plane.shape != pixels[0].shape:
            raise ValueError(
                f"{name}[{i}] has the shape {plane.shape}, but {name}[0] has {pixels[0].shape}"
            )
    return np.stack(pixels), units[0]


def checked(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a plan, which may be among others, in plain types."""
    given = arguments("plan", settings)
    found = _native.plan_settings(given)
    plain = {name: found[name] for name in given}
    for name in {"frame", "region"} & given.keys():
        plain[name] = None if found[name] is None else tuple(found[name])
    return {
        **plain,
        **checked_colour(settings),
        "precision": precision_of(settings["precision"], "precision"),
    }


def _again(model: _Model, settings: dict[str, Any]) -> Plan:
    """Make a pickled plan again."""
    return Plan(model, **settings)

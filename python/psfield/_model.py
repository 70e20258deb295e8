"""PSFs that change over the field."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from psfield import _native
from psfield._arrays import DTYPES, column, doubles, plain, points, shape_of, shape_or_none
from psfield._astropy import in_unit
from psfield._choices import pair_or_none, real, real_or_none, whole, whole_or_none, word, word_or_none, yes_or_no
from psfield._defaults import DEFAULTS
from psfield._plan import Plan
from psfield._progress import Progress, as_callback

if TYPE_CHECKING:
    from photutils.psf import GriddedPSFModel

Centre = tuple[float, float]
PathLike = str | os.PathLike[str]


class PsfModel:
    """A PSF that changes over the field.

    Models are made by `from_samples`, `from_basis`, `from_gridded_psf_model`, `from_function` and `read`. They do not change, can be
    pickled, and may be used from many threads. What follows from samples (the fit, the interpolator) is made when it is first needed,
    and kept.

    Notes
    -----
    The PSF at a field position x is ``h(u; x) = [B_0(u) + sum_k a_k(x) B_k(u)] / s(x)``: the mean stamp, orthonormal components (from an
    SVD of the samples), their coefficients, interpolated between the samples, and the flux ``s`` where PSFs are scaled to unit flux.

    A value of a stamp is the fraction of a source's flux that falls into a *frame* pixel centred there, so that a stamp oversampled ``s``
    times holds unit flux where its values sum to ``s**2``, as in photutils.
    """

    __slots__ = ("_handle", "_sampling")

    _handle: _native.PsfModel
    _sampling: dict[str, Any] | None

    def __init__(self) -> None:
        raise TypeError("use PsfModel.from_samples, .read, .from_function, .from_gridded_psf_model or .from_basis")

    @classmethod
    def _of(cls, native: _native.PsfModel, sampling: dict[str, Any] | None = None) -> PsfModel:
        model = cls.__new__(cls)
        model._handle = native
        model._sampling = sampling
        return model

    @classmethod
    def from_samples(
        cls,
        stamps: ArrayLike,
        positions: Any,
        *,
        field_shape: tuple[int, int] | None = None,
        oversampling: float = DEFAULTS.oversampling,
        centre: Centre | None = None,
        pixel_response_included: bool = DEFAULTS.pixel_response_included,
        stamp_interpolation: Literal["cubic-spline", "lanczos3"] = DEFAULTS.stamp_interpolation,
        rank: str | int | None = None,
        centring: Literal["mean", "none"] | None = None,
        noise: float | None = None,
        interpolation: str | None = None,
        outside: Literal["nearest", "extend", "error"] | None = None,
        normalise: Literal["unit", "keep"] | None = None,
    ) -> PsfModel:
        """Make a model from PSF stamps at positions of the field.

        Parameters
        ----------
        stamps : array_like
            Stamps ``[sample, y, x]``, each with positive flux.
        positions : array_like or table
            Where they belong: ``[sample, 2]``, x and y in 0-based pixels of the frame; or a table with columns x and y.
        field_shape : (int, int), optional
            Rows and columns of the frame over which the PSF is known; larger frames are then refused.
        oversampling : float
            Stamp pixels per frame pixel, along each axis.
        centre : (float, float), optional
            The stamps' reference point ``(x, y)``, a 0-based index that may be fractional. Default: ``(nx // 2, ny // 2)``.
        pixel_response_included : bool
            Whether the response of a frame pixel is in the stamps; where it is not, it is applied once when the PSF is used.
        stamp_interpolation : {'cubic-spline', 'lanczos3'}
            How stamps continue between their pixels.
        rank : str or int, optional
            Components to keep: ``'auto'`` (default), ``'elbow'``, ``'full'``, a number, ``'energy=0.999'`` or ``'error=1e-3'``.
        centring : {'mean', 'none'}, optional
            Take out the mean stamp (default) or not.
        noise : float, optional
            Standard deviation of the noise in the samples' pixels, after normalisation; 0 for none. Default: estimated.
        interpolation : str, optional
            ``'auto'`` (default: bicubic on a regular grid, else natural neighbour), ``'delaunay'``, ``'natural-neighbour'``, ``'idw'``,
            ``'idw=POWER'``, ``'bilinear'``, ``'bicubic'``, ``'polynomial=DEGREE'`` or ``'nearest'``.
        outside : {'nearest', 'extend', 'error'}, optional
            What holds outside the area that the samples cover. Default: nearest.
        normalise : {'unit', 'keep'}, optional
            Scale every PSF to unit flux (default), or keep the values as they are.

        Returns
        -------
        PsfModel

        Raises
        ------
        ValueError
            Stamps or positions that cannot be: of the wrong shape, not finite, without flux, two at one position.
        """
        cube = doubles(_stack(stamps), "stamps", "[sample, y, x]")
        x, y = points(positions)
        grid = _grid(oversampling, centre, pixel_response_included, stamp_interpolation)
        fit = _fit(rank, centring, noise, interpolation, outside, normalise)
        field = shape_or_none(field_shape, "field_shape")
        return cls._of(_native.PsfModel.from_samples(cube, x, y, field, grid, fit, False))

    @classmethod
    def from_basis(
        cls,
        mean: ArrayLike | None,
        components: ArrayLike,
        coefficients: ArrayLike,
        positions: Any,
        *,
        field_shape: tuple[int, int] | None = None,
        oversampling: float = DEFAULTS.oversampling,
        centre: Centre | None = None,
        pixel_response_included: bool = DEFAULTS.pixel_response_included,
        stamp_interpolation: Literal["cubic-spline", "lanczos3"] = DEFAULTS.stamp_interpolation,
        interpolation: str = DEFAULTS.interpolation,
        outside: Literal["nearest", "extend", "error"] = DEFAULTS.outside,
        normalise: Literal["unit", "keep"] = DEFAULTS.normalise,
    ) -> PsfModel:
        """Make a model from a basis of your own and its coefficients at positions.

        Parameters
        ----------
        mean : array_like or None
            The mean stamp ``[y, x]``, if the basis is centred.
        components : array_like
            Orthonormal stamps ``[component, y, x]``.
        coefficients : array_like
            ``[position, component]``.
        positions : array_like or table
            As for `from_samples`.
        field_shape, oversampling, centre, pixel_response_included, stamp_interpolation
            As for `from_samples`.
        interpolation, outside, normalise
            As for `from_samples`.

        Returns
        -------
        PsfModel
        """
        x, y = points(positions)
        grid = _grid(oversampling, centre, pixel_response_included, stamp_interpolation)
        native = _native.PsfModel.from_basis(
            None if mean is None else doubles(mean, "mean", "[y, x]"),
            doubles(components, "components", "[component, y, x]"),
            doubles(coefficients, "coefficients", "[position, component]"),
            x,
            y,
            shape_or_none(field_shape, "field_shape"),
            grid,
            (word(interpolation, "interpolation"), word(outside, "outside"), word(normalise, "normalise")),
        )
        return cls._of(native)

    @classmethod
    def from_gridded_psf_model(
        cls, model: GriddedPSFModel, *, field_shape: tuple[int, int] | None = None, interpolation: str | None = None
    ) -> PsfModel:
        """Take over a gridded PSF model of photutils.

        Its planes are kept as they are (every component, no scaling), and interpolated bilinearly between the grid's positions and by a
        cubic spline between the stamps' pixels, as photutils does.

        Parameters
        ----------
        model : photutils.psf.GriddedPSFModel
            The model; anything with ``data``, ``grid_xypos`` and ``oversampling`` will do. Its ``flux``, ``x_0`` and ``y_0`` play no part.
        field_shape : (int, int), optional
            Rows and columns of the frame.
        interpolation : str, optional
            Another interpolation over the field than photutils' bilinear one.

        Returns
        -------
        PsfModel
        """
        oversampling = np.unique(np.atleast_1d(plain(model.oversampling, "oversampling")))
        if len(oversampling) != 1:
            raise ValueError(f"oversampling: x and y must be oversampled alike, got {model.oversampling}")
        cube = doubles(model.data, "data", "[position, y, x]")
        x, y = points(np.asarray(model.grid_xypos, dtype=float), "grid_xypos")
        _, ny, nx = cube.shape
        grid = _grid(float(oversampling[0]), ((nx - 1) / 2, (ny - 1) / 2), True, "cubic-spline")
        fit = _fit(None, None, None, interpolation, None, None)
        field = shape_or_none(field_shape, "field_shape")
        return cls._of(_native.PsfModel.from_samples(cube, x, y, field, grid, fit, True))

    @classmethod
    def from_function(
        cls,
        function: Callable[[float, float], Any],
        shape: tuple[int, int],
        *,
        threshold: float = DEFAULTS.threshold,
        criterion: Literal["interpolation", "neighbours"] = "interpolation",
        measure: Literal["l2", "l1"] = "l2",
        start: tuple[int, int] = DEFAULTS.start,
        max_samples: int = DEFAULTS.max_samples,
        uniform: tuple[int, int] | None = None,
        oversampling: float = DEFAULTS.oversampling,
        centre: Centre | None = None,
        pixel_response_included: bool = DEFAULTS.pixel_response_included,
        stamp_interpolation: Literal["cubic-spline", "lanczos3"] = DEFAULTS.stamp_interpolation,
        rank: str | int | None = None,
        centring: Literal["mean", "none"] | None = None,
        noise: float | None = None,
        interpolation: str | None = None,
        outside: Literal["nearest", "extend", "error"] | None = None,
        normalise: Literal["unit", "keep"] | None = None,
        progress: Progress | None = None,
    ) -> PsfModel:
        """Sample a function that draws the PSF at any position, densely where the PSF varies and sparsely where it does not.

        Parameters
        ----------
        function : callable
            ``function(x, y)`` draws the PSF of a source at a position (0-based pixels of the frame), centred on its stamp, as an array
            ``[y, x]`` or a GalSim image; always of one shape. It is never called twice at a time.
        shape : (int, int)
            Rows and columns of the frame.
        threshold : float
            Where sampling may stop: the relative error of interpolating between neighbouring samples, or their relative difference.
        criterion : {'interpolation', 'neighbours'}
            Which of the two.
        measure : {'l2', 'l1'}
            The norm in which PSFs are compared.
        start : (int, int)
            Rows and columns of the coarse grid that refinement starts from.
        max_samples : int
            An error where more are needed.
        uniform : (int, int), optional
            Rows and columns of a regular grid of samples, in place of refinement.
        oversampling, centre, pixel_response_included, stamp_interpolation
            What the stamps are, as for `from_samples`.
        rank, centring, noise, interpolation, outside, normalise
            How samples become a model, as for `from_samples`.
        progress : callable or tqdm bar, optional
            Called with the PSFs drawn and their number as far as it is known.

        Returns
        -------
        PsfModel
            `sampling` says how the sampling ended.
        """
        rows, columns = shape_of(shape, "shape")

        def draw(x: float, y: float) -> NDArray[np.float64]:
            return doubles(function(x, y), f"the PSF at ({x:g}, {y:g})", "[y, x]")

        stamp_shape = draw((columns - 1) / 2, (rows - 1) / 2).shape
        native, sampling = _native.sample_function(
            draw,
            stamp_shape,
            (rows, columns),
            _grid(oversampling, centre, pixel_response_included, stamp_interpolation),
            {
                "criterion": word(criterion, "criterion", ("neighbours", "interpolation")),
                "measure": word(measure, "measure", ("l1", "l2")),
                "threshold": real(threshold, "threshold"),
                "start": shape_of(start, "start"),
                "max_samples": whole(max_samples, "max_samples", 1),
                "uniform": shape_or_none(uniform, "uniform"),
            },
            _fit(rank, centring, noise, interpolation, outside, normalise),
            as_callback(progress),
        )
        return cls._of(native, sampling)

    @classmethod
    def read(
        cls,
        path: PathLike,
        *,
        extension: str | int | None = None,
        detector: int | None = None,
        plane_order: str | None = None,
        wavelength_um: float | None = None,
        pixel_scale_arcsec: float | None = None,
        field_centre: Centre | None = None,
        positions: Any = None,
        oversampling: float | None = None,
        centre: Centre | None = None,
        pixel_response_included: bool | None = None,
        rank: str | int | None = None,
        centring: Literal["mean", "none"] | None = None,
        noise: float | None = None,
        interpolation: str | None = None,
        outside: Literal["nearest", "extend", "error"] | None = None,
        normalise: Literal["unit", "keep"] | None = None,
    ) -> PsfModel:
        """Read any PSF file that psfield knows, told by its content.

        PSFEx models, STPSF and WebbPSF gridded libraries, STDPSF, ScopeSim's field-varying PSFs, psfield's own samples and models, and
        plain cubes and stamps. Options that a format has no use for are refused.

        Parameters
        ----------
        path : path
            The file; ``.gz`` and ``.fz`` are read as they are.
        extension : str or int, optional
            Which of several models (PSFEx) or images.
        detector : int, optional
            Which of several detectors (STDPSF).
        plane_order : str, optional
            How positions belong to planes (STPSF), where its writer's version does not say.
        wavelength_um, pixel_scale_arcsec, field_centre : optional
            What ScopeSim's files do not say.
        positions : array_like or table, optional
            Where the planes of a plain cube belong.
        oversampling, centre, pixel_response_included : optional
            What plain stamps do not say of themselves, as for `from_samples`.
        rank, centring, noise, interpolation, outside, normalise
            How samples become a model, as for `from_samples`. Models take ``outside`` and ``normalise`` alone. STPSF and STDPSF libraries
            are by default interpolated bilinearly and not scaled.

        Returns
        -------
        PsfModel
            `notes` says how the file was read.

        Raises
        ------
        OSError
            The file cannot be read or is damaged; the text names the keyword or row.
        ValueError
            Something that the file does not say and that must be chosen, or an option that does not suit the file.
        """
        at = None if positions is None else tuple(axis.tolist() for axis in points(positions))
        file = {
            "extension": None if extension is None else str(extension),
            "detector": whole_or_none(detector, "detector"),
            "plane_order": word_or_none(plane_order, "plane_order"),
            "wavelength_um": real_or_none(wavelength_um, "wavelength_um"),
            "pixel_scale_arcsec": real_or_none(pixel_scale_arcsec, "pixel_scale_arcsec"),
            "field_centre": pair_or_none(field_centre, "field_centre"),
            "positions": at,
            "oversampling": real_or_none(oversampling, "oversampling"),
            "centre": pair_or_none(centre, "centre"),
            "pixel_response_included": (
                None if pixel_response_included is None else yes_or_no(pixel_response_included, "pixel_response_included")
            ),
        }
        fit = _fit(rank, centring, noise, interpolation, outside, normalise)
        return cls._of(_native.PsfModel.read(os.fspath(path), file, fit))

    @property
    def notes(self) -> tuple[str, ...]:
        """How its file was read, in plain sentences."""
        return tuple(self._handle.notes())

    @property
    def sampling(self) -> dict[str, Any] | None:
        """How `from_function` ended: samples, draws, cells, unmet_cells, worst, threshold, outcome ('met' or 'cell-size-reached')."""
        return None if self._sampling is None else dict(self._sampling)

    @property
    def field_shape(self) -> tuple[int, int] | None:
        """Rows and columns of the frame over which the PSF is known, if that is known."""
        return self._handle.field()

    @property
    def stamp_shape(self) -> tuple[int, int]:
        """Rows and columns of the stamps."""
        return self._handle.stamp_shape()

    @property
    def oversampling(self) -> float:
        """Stamp pixels per frame pixel."""
        value: float = self._handle.grid()["oversampling"]
        return value

    @property
    def centre(self) -> Centre:
        """The stamps' reference point (x, y)."""
        value: Centre = self._handle.grid()["centre"]
        return value

    @property
    def pixel_response_included(self) -> bool:
        """Whether the response of a frame pixel is in the stamps."""
        value: bool = self._handle.grid()["pixel_response_included"]
        return value

    @property
    def positions(self) -> NDArray[np.float64]:
        """Where its samples or nodes lie: ``[sample, 2]``, x and y."""
        return np.column_stack(self._handle.positions())

    @property
    def rank(self) -> int:
        """Components, the mean stamp not counted."""
        return len(self.components)

    @property
    def mean(self) -> NDArray[np.float64] | None:
        """The mean stamp ``[y, x]``, if there is one."""
        return self._handle.basis()[0]

    @property
    def components(self) -> NDArray[np.float64]:
        """Orthonormal stamps ``[component, y, x]``."""
        return self._handle.basis()[1]

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """Their coefficients at `positions`: ``[sample, component]``."""
        return self._handle.basis()[2]

    @property
    def interpolation(self) -> str:
        """How coefficients are carried over the field."""
        return self._handle.choices()[0]

    @property
    def outside(self) -> str:
        """What holds outside the area that the samples cover."""
        return self._handle.choices()[1]

    @property
    def normalise(self) -> str:
        """Whether PSFs are scaled to unit flux ('unit') or not ('keep')."""
        return self._handle.choices()[2]

    def fit_report(self) -> dict[str, Any] | None:
        """Return the figures of the fit of its samples; None where there are no samples.

        Returns
        -------
        dict or None
            ``rank``, ``elbow``, ``noise_sigma``, ``max_error``, ``rms_error`` and ``errors`` (relative L2 errors of the samples),
            ``leave_one_out`` (errors of predicting each sample from the others: ``median``, ``max``, ``errors``), ``singular_values``,
            ``cumulative_weights``.
        """
        report = self._handle.fit_report()
        return None if report is None else json.loads(report)

    def evaluate(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        pixels: Literal["stamp", "frame"] = "stamp",
        size: int | None = None,
        sub_pixel: bool = False,
    ) -> NDArray[np.float64]:
        """Return the PSF at positions.

        Parameters
        ----------
        x, y : float or array_like
            Positions in 0-based pixels of the frame; they are broadcast.
        pixels : {'stamp', 'frame'}
            Sampled as the stamps are, or at the frame's own pixels, with their response also where the stamps lack it.
        size : int, optional
            Rows and columns, cut or padded about the centre.
        sub_pixel : bool
            Draw each PSF at the sub-pixel phase of its position, as a star there looks, in place of centred; needs ``pixels='frame'``.

        Returns
        -------
        numpy.ndarray
            ``[y, x]`` for one position, else ``[..., y, x]`` in the shape of the positions.
        """
        at_frame = word(pixels, "pixels", ("stamp", "frame")) == "frame"
        size, sub_pixel = whole_or_none(size, "size", 1), yes_or_no(sub_pixel, "sub_pixel")
        at_x, at_y = (plain(in_unit(axis, "pix", name), name) for axis, name in ((x, "x"), (y, "y")))
        try:
            xs, ys = np.broadcast_arrays(at_x, at_y)
        except ValueError:
            raise ValueError(f"x and y of the shapes {np.shape(x)} and {np.shape(y)} cannot be broadcast") from None
        shape = xs.shape
        flat_x, flat_y = (np.ascontiguousarray(column(axis.ravel(), name)) for axis, name in ((xs, "x"), (ys, "y")))
        stamps = self._handle.evaluate(flat_x, flat_y, at_frame, size, sub_pixel)
        return stamps.reshape(*shape, *stamps.shape[1:])

    def to_gridded_psf_model(self, grid_shape: tuple[int, int] | None = None) -> GriddedPSFModel:
        """Return the PSF as photutils' `~photutils.psf.GriddedPSFModel`.

        Parameters
        ----------
        grid_shape : (int, int), optional
            Rows and columns of the grid of positions. Default: the model's own positions where they are a grid, else a grid of at least
            11 x 11 over the field.

        Returns
        -------
        photutils.psf.GriddedPSFModel
            Its ``meta['psfield_max_error']`` is the largest relative L2 error of its bilinear interpolation in the middle between its
            positions, against this model; None where this model is bilinear between the same positions itself.
        """
        from astropy.nddata import NDData
        from photutils.psf import GriddedPSFModel

        at = shape_or_none(grid_shape, "grid_shape")
        stamps, (x, y), oversampling, max_error = self._handle.gridded(at)
        meta = {
            "grid_xypos": list(zip(x.tolist(), y.tolist(), strict=True)),
            "oversampling": round(oversampling),
            "psfield_max_error": max_error,
        }
        return GriddedPSFModel(NDData(stamps, meta=meta))

    def write(
        self,
        path: PathLike,
        *,
        format: Literal["psf-model", "psf-samples", "psfex", "gridded"] = "psf-model",
        degree: int | None = None,
        grid_shape: tuple[int, int] | None = None,
        precision: Literal["f32", "f64"] = "f32",
        overwrite: bool = False,
    ) -> tuple[str, ...]:
        """Write the PSF to a file, which appears whole or not at all.

        Parameters
        ----------
        path : path
            The file.
        format : {'psf-model', 'psf-samples', 'psfex', 'gridded'}
            A model of psfield; stamps at positions; PSFEx; a library that photutils reads.
        degree : int, optional
            PSFEx: the degree of its polynomial.
        grid_shape : (int, int), optional
            Samples and libraries: rows and columns of a grid of positions. Default: the model's own.
        precision : {'f32', 'f64'}
            Of samples.
        overwrite : bool
            Replace a file that exists.

        Returns
        -------
        tuple of str
            What the file does not hold, in plain sentences.
        """
        words = {
            "format": word(format, "format", ("psf-model", "psf-samples", "psfex", "gridded")),
            "degree": whole_or_none(degree, "degree"),
            "at": shape_or_none(grid_shape, "grid_shape"),
            "double": word(precision, "precision", DTYPES) == "f64",
            "overwrite": yes_or_no(overwrite, "overwrite"),
        }
        return tuple(self._handle.write(os.fspath(path), words))

    def plan(
        self,
        shape: tuple[int, int],
        tolerance: float = DEFAULTS.tolerance,
        precision: Literal["f32", "f64"] = DEFAULTS.precision,
        device: Literal["auto", "cpu", "gpu"] = DEFAULTS.device,
        *,
        frame: tuple[int, int, int, int] | None = None,
        region: tuple[int, int, int, int] | None = None,
        anchor: Literal["source", "output"] = DEFAULTS.anchor,
        method: Literal["auto", "lowrank"] = DEFAULTS.method,
        memory: int = DEFAULTS.memory,
        oversample: int = DEFAULTS.oversample,
        stamp_size: int | None = None,
        gpu_adapter: str | None = None,
        gpu_memory: int | None = None,
    ) -> Plan:
        """Prepare the simulation of scenes of one shape.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the scenes.
        tolerance : float
            The largest relative L2 error that the engine may add to the PSF of any single pixel or star, from 0 (rounding alone) to
            below 1.
        precision : {'f32', 'f64'}
            Working precision and that of images.
        device : {'auto', 'cpu', 'gpu'}
            Where images are convolved. ``auto``: on a GPU where the plan is predicted to be faster there.
        frame : (int, int, int, int), optional
            The part of the scene that the image shows: first column, first row, columns, rows, in pixels of the image. Field positions
            count from its first pixel; light from around it comes in.
        region : (int, int, int, int), optional
            The part of the frame that is made, for frames that are made in pieces, on many machines: first column, first row, columns,
            rows, in pixels of the image counted from the frame's first. Put together, the pieces are the image of the whole frame but for
            rounding, at any tolerance. Scenes need no light but that of `Plan.light_region`; `Plan.for_region` makes the plans for others.
        anchor : {'source', 'output'}
            Whose PSF applies: each source spreads with that of its own position, or each pixel gathers with its own.
        method : {'auto', 'lowrank'}
            Each tile in the cheapest way, or by transforms alone.
        memory : int
            Bytes that the plan keeps, at most.
        oversample : int
            Scenes are finer than the image: so many of their pixels along each side of one of the image.
        stamp_size : int, optional
            Cut or pad stamps to so many pixels of the image.
        gpu_adapter : str, optional
            Which GPU, by a part of its name.
        gpu_memory : int, optional
            Bytes that the plan keeps on a GPU, at most.

        Returns
        -------
        Plan
        """
        return Plan(
            self,
            shape,
            tolerance=tolerance,
            precision=precision,
            device=device,
            frame=frame,
            region=region,
            anchor=anchor,
            method=method,
            memory=memory,
            oversample=oversample,
            stamp_size=stamp_size,
            gpu_adapter=gpu_adapter,
            gpu_memory=gpu_memory,
        )

    def __repr__(self) -> str:
        kind = "samples" if self._handle.has_samples() else "nodes"
        (ny, nx), count = self.stamp_shape, len(self._handle.positions()[0])
        field = "" if self.field_shape is None else f", field {self.field_shape[0]} x {self.field_shape[1]}"
        return f"<PsfModel: {count} {kind}, stamps {ny} x {nx}, oversampling {self.oversampling:g}{field}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (*self._handle.state(), self._sampling)


def _again(constructor: str, arguments: tuple[Any, ...], sampling: dict[str, Any] | None) -> PsfModel:
    """Make a pickled model again."""
    return PsfModel._of(getattr(_native.PsfModel, constructor)(*arguments), sampling)


def _stack(stamps: Any) -> Any:
    """Return a list of stamps as one array."""
    if isinstance(stamps, (list, tuple)):
        arrays = [plain(stamp, f"stamp {i}") for i, stamp in enumerate(stamps)]
        if not arrays:
            raise ValueError("stamps is empty: there must be at least one")
        if shapes := {array.shape for array in arrays} - {arrays[0].shape}:
            raise ValueError(f"stamps must have one shape, got {arrays[0].shape} and {min(shapes)}")
        return np.stack(arrays)
    return stamps


def _grid(oversampling: float, centre: Centre | None, included: bool, interpolation: str) -> dict[str, Any]:
    return {
        "oversampling": real(oversampling, "oversampling"),
        "centre": pair_or_none(centre, "centre"),
        "pixel_response_included": yes_or_no(included, "pixel_response_included"),
        "stamp_interpolation": word(interpolation, "stamp_interpolation", ("cubic-spline", "lanczos3")),
    }


def _fit(
    rank: str | int | None,
    centring: str | None,
    noise: float | None,
    interpolation: str | None,
    outside: str | None,
    normalise: str | None,
) -> dict[str, Any]:
    return {
        "rank": None if rank is None else str(rank),
        "centring": word_or_none(centring, "centring"),
        "noise": real_or_none(noise, "noise"),
        "interpolation": word_or_none(interpolation, "interpolation"),
        "outside": word_or_none(outside, "outside"),
        "normalise": word_or_none(normalise, "normalise"),
    }

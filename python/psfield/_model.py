"""PSFs that vary over the field."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from psfield import _native
from psfield._arrays import (
    Precision,
    column,
    doubles,
    plain,
    points,
    precision_of,
    reals,
    shape_of,
    shape_or_none,
    stack,
)
from psfield._astropy import in_unit
from psfield._choices import (
    boolean,
    choice,
    choice_or_none,
    integer_or_none,
    real,
    real_or_none,
    text,
)
from psfield._colour import COLOUR, PathLike, curve
from psfield._defaults import DEFAULTS, arguments
from psfield._errors import PsfieldWarning
from psfield._html import size, table
from psfield._own import Decomposition, Interpolation, basis_stamps, interpolated, split
from psfield._plan import Plan
from psfield._progress import Progress, as_callback
from psfield._reports import (
    FitReport,
    LeaveOneOutReport,
    SamplingReport,
    VerificationReport,
    WingsReport,
)
from psfield._spelling import american, british

if TYPE_CHECKING:
    from photutils.psf import GriddedPSFModel
    from typing_extensions import Unpack

    from psfield._spelling import American

Centre = tuple[float, float]


class PsfModel:
    """A PSF that varies over the field.

    Make a model with `read`, `from_samples`, `from_function`, `from_telescope`,
    `from_gridded_psf_model` or `from_basis`. Models are immutable, can be pickled, and may be used
    from many threads. The fit of the samples and the interpolator are computed when they are first
    needed, and kept.

    Notes
    -----
    The PSF at a field position ``x`` and an offset ``u`` from it is
    ``h(u; x) = [B_0(u) + sum_k a_k(x) B_k(u)] / s(x)``. ``B_0`` is the mean stamp and ``B_k`` are
    orthonormal components, from an SVD of the samples. The coefficients ``a_k`` are interpolated
    between the samples. If PSFs are scaled to unit flux, ``s`` is the flux of the sum in brackets,
    else 1.

    If the pixel response is included, a value of a stamp is the fraction of the flux of a source
    that falls in a *frame* pixel centred at that point of the stamp. Otherwise it is the density
    at that point: the fraction of the flux per frame pixel. In both cases a stamp that is
    oversampled ``s`` times has unit flux if its values sum to ``s**2``, as in photutils.

    The arguments ``centre``, ``centring``, ``field_centre`` and ``normalise`` may also be spelt
    ``center``, ``centering``, ``field_center`` and ``normalize``.

    Examples
    --------
    >>> import psfield
    >>> narrow, wide = [[0, 1, 0], [1, 4, 1], [0, 1, 0]], [[1, 2, 1], [2, 4, 2], [1, 2, 1]]
    >>> model = psfield.PsfModel.from_samples([narrow, wide], [(0, 0), (10, 0)])
    >>> model.evaluate(0, 0).round(3).tolist()
    [[0.0, 0.125, 0.0], [0.125, 0.5, 0.125], [0.0, 0.125, 0.0]]
    >>> model.plan((20, 30), tolerance=1e-3).simulate([[1.0] * 30] * 20).shape
    (20, 30)
    """

    __slots__ = ("_given", "_handle", "_report", "_sampling")

    _handle: _native.PsfModel
    _sampling: SamplingReport | None
    _given: NDArray[np.float64] | None
    _report: str | None

    def __init__(self) -> None:
        raise TypeError(
            "make a PsfModel with from_samples, read, from_function, from_telescope,"
            " from_gridded_psf_model or from_basis"
        )

    @classmethod
    def _of(
        cls,
        native: _native.PsfModel,
        sampling: SamplingReport | None = None,
        given: NDArray[np.float64] | None = None,
        report: str | None = None,
    ) -> PsfModel:
        model = cls.__new__(cls)
        model._handle = native
        model._sampling = sampling
        model._given = given
        model._report = report
        return model

    @classmethod
    @american
    def from_samples(
        cls,
        stamps: ArrayLike,
        positions: Any,
        *,
        wavelengths_um: ArrayLike | None = None,
        times_s: ArrayLike | None = None,
        frame_numbers: ArrayLike | None = None,
        field_shape: tuple[int, int] | None = None,
        oversampling: float = DEFAULTS.oversampling,
        centre: Centre | None = None,
        pixel_response_included: bool = DEFAULTS.pixel_response_included,
        stamp_interpolation: Literal["cubic-spline", "lanczos3"] = DEFAULTS.stamp_interpolation,
        rank: str | int | None = None,
        centring: Literal["mean", "none"] | None = None,
        noise: float | None = None,
        interpolation: Interpolation | None = None,
        table_error: float = DEFAULTS.table_error,
        outside: Literal["nearest", "extend", "error"] | None = None,
        normalise: Literal["unit", "keep"] | None = None,
        shift_copies: int | None = None,
        basis: PsfModel | Decomposition | ArrayLike | None = None,
        weights: ArrayLike | None = None,
        **american: Unpack[American],
    ) -> PsfModel:
        """Make a model from PSF stamps at positions of the field.

        Parameters
        ----------
        stamps : array_like
            Stamps ``[sample, y, x]``, or a single stamp ``[y, x]``. Each must have positive flux.
        positions : array_like or table
            Positions of the stamps in 0-based pixels of the frame: ``[sample, 2]``, x and y, or a
            table with columns x and y. For a single stamp also a pair ``(x, y)``.
        wavelengths_um, times_s, frame_numbers : array_like, optional
            One of them, if the PSF also depends on the wavelength (micrometres), the time (seconds)
            or the frame: one value per stamp. All stamps get one basis. `at` chooses one
            wavelength, time or frame.
        field_shape : (int, int), optional
            Rows and columns of the frame over which the PSF is known. Larger frames are refused.
        oversampling : float
            Stamp pixels per frame pixel, along each axis: above 0, and below 1 for stamps coarser
            than the frame.
        centre : (float, float), optional
            Point ``(x, y)`` of the stamps that lies at the position of the source, as a 0-based
            index that may be fractional. Default: ``(nx // 2, ny // 2)``.
        pixel_response_included : bool
            The stamps include the response of a frame pixel. If not, the response is applied when
            the PSF is used.
        stamp_interpolation : {'cubic-spline', 'lanczos3'}
            Interpolation between the pixels of a stamp.
        rank : str or int, optional
            Number of components to keep: ``'auto'`` (default), ``'elbow'``, ``'full'``, a number,
            ``'energy=0.999'`` or ``'error=1e-3'``.
        centring : {'mean', 'none'}, optional
            Whether the mean stamp is subtracted before the fit. Default: ``mean``.
        noise : float, optional
            Standard deviation of the noise in the pixels of the samples, after normalisation. 0
            means no noise. Default: estimated.
        interpolation : str, object or callable, optional
            Interpolation over the field: ``'auto'`` (default: kriging or a local method, whichever
            predicts the samples better from each other), ``'kriging'`` (Gaussian process
            regression), ``'kriging=KERNEL,LENGTH_X,LENGTH_Y,TREND,NUGGET'``, ``'delaunay'``,
            ``'natural-neighbour'``, ``'idw'``, ``'idw=POWER'``, ``'bilinear'``, ``'bicubic'``,
            ``'polynomial=DEGREE'`` or ``'nearest'``. Or an interpolation of your own: an object
            with ``fit(positions, values)`` and ``predict(positions)``, such as a regressor of
            scikit-learn, or a function ``f(positions, values)`` that returns a function
            ``g(positions)``, such as `scipy.interpolate.RBFInterpolator`. Positions are
            ``[sample, (x, y)]`` in pixels, values ``[sample, component]``. Copies of the object are
            fitted, on this thread. The result is stored as a table, so it must be smooth.
        table_error : float
            Largest error of the table of an interpolation of your own: relative L2 error of the
            PSF, checked at points.
        outside : {'nearest', 'extend', 'error'}, optional
            Policy for positions outside the area of the samples. Default: ``nearest``.
        normalise : {'unit', 'keep'}, optional
            ``unit`` (default) scales every PSF to unit flux, ``keep`` keeps the values.
        shift_copies : int, optional
            Number of copies of each stamp, shifted by up to half a pixel, from which the basis is
            computed in addition to the stamps. Default: 0.
        basis : PsfModel, object or array_like, optional
            Keep the basis of this model, and find only the coefficients of the stamps. Or a basis
            of your own: stamps ``[component, y, x]``, or an object with ``fit_transform`` and
            ``components_``, such as a decomposition of scikit-learn, which is fitted to the pixels
            of the stamps (scaled to unit flux, unless ``normalise='keep'``). They are made
            orthonormal. `given_components` returns them as they were. ``rank``, ``centring`` and
            ``shift_copies`` do not apply then.
        weights : array_like, optional
            Inverse variances of the pixels of the stamps, up to a factor: ``[sample, y, x]``, or
            ``[sample]``. 0 for bad pixels, which may be NaN. The basis is then that of weighted
            principal components, and kriging weighs samples by their noise.

        Returns
        -------
        PsfModel

        Raises
        ------
        ValueError
            Stamps or positions are invalid: they have the wrong shape, are not finite, have no
            flux, or share a position.

        Examples
        --------
        >>> import psfield
        >>> narrow, wide = [[0, 1, 0], [1, 4, 1], [0, 1, 0]], [[1, 2, 1], [2, 4, 2], [1, 2, 1]]
        >>> psfield.PsfModel.from_samples([narrow, wide], [(0, 0), (10, 0)], field_shape=(5, 11))
        <PsfModel: 2 samples, stamps 3 x 3, oversampling 1, field 5 x 11>

        A PSF that is constant over the field:

        >>> psfield.PsfModel.from_samples(narrow, (0, 0), center=(1, 1), normalize="unit")
        <PsfModel: 1 sample, stamps 3 x 3, oversampling 1>

        A PSF that widens with the wavelength:

        >>> colours = psfield.PsfModel.from_samples(
        ...     [narrow, wide], [(0, 0), (0, 0)], wavelengths_um=[0.5, 0.7]
        ... )
        >>> colours.at(wavelength_um=0.6).evaluate(0, 0)[1].round(3).tolist()
        [0.125, 0.375, 0.125]
        """
        cube = stack(stamps, "stamps", "[sample, y, x]")
        of_pixels = None
        if weights is not None:
            _refuse_with("weights", basis=basis, shift_copies=shift_copies)
            cube, of_pixels = _weighted(cube, weights)
        x, y = points(positions)
        grid = arguments("grid", locals())
        interpolation, own = split(interpolation)
        fit = _fit(locals())
        field = shape_or_none(field_shape, "field_shape")
        states = _states(wavelengths_um, times_s, frame_numbers)
        of_basis: _native.PsfModel | tuple[Any, NDArray[np.float64]] | None = None
        given = None
        if basis is not None:
            _refuse_with("basis", rank=rank, centring=centring, shift_copies=shift_copies)
        if isinstance(basis, PsfModel):
            of_basis = basis._handle
        elif basis is not None:
            mean, given = basis_stamps(basis, cube, grid["oversampling"], normalise)
            of_basis = mean, given
        native = _native.PsfModel.from_samples(
            cube, x, y, states, field, grid, fit, False, of_basis, of_pixels
        )
        return cls._of(interpolated(native, own, table_error), given=given)

    @classmethod
    @american
    def from_basis(
        cls,
        mean: ArrayLike | None,
        components: ArrayLike,
        coefficients: ArrayLike,
        positions: Any,
        *,
        wavelengths_um: ArrayLike | None = None,
        times_s: ArrayLike | None = None,
        frame_numbers: ArrayLike | None = None,
        field_shape: tuple[int, int] | None = None,
        oversampling: float = DEFAULTS.oversampling,
        centre: Centre | None = None,
        pixel_response_included: bool = DEFAULTS.pixel_response_included,
        stamp_interpolation: Literal["cubic-spline", "lanczos3"] = DEFAULTS.stamp_interpolation,
        interpolation: Interpolation = DEFAULTS.interpolation,
        table_error: float = DEFAULTS.table_error,
        outside: Literal["nearest", "extend", "error"] = DEFAULTS.outside,
        normalise: Literal["unit", "keep"] = DEFAULTS.normalise,
        **american: Unpack[American],
    ) -> PsfModel:
        """Make a model from a given basis and its coefficients at positions.

        Parameters
        ----------
        mean : array_like or None
            Mean stamp ``[y, x]``, if the basis is centred.
        components : array_like
            Orthonormal stamps ``[component, y, x]``, or a single stamp ``[y, x]``.
        coefficients : array_like
            Coefficients ``[position, component]``.
        positions : array_like or table
            As for `from_samples`.
        wavelengths_um, times_s, frame_numbers : array_like, optional
            As for `from_samples`.
        field_shape, oversampling, centre, pixel_response_included, stamp_interpolation
            As for `from_samples`.
        interpolation, table_error, outside, normalise
            As for `from_samples`.

        Returns
        -------
        PsfModel

        Examples
        --------
        The PSF is one pixel, whose flux is 1 at x = 0 and 3 at x = 10:

        >>> import psfield
        >>> pixel = [[0, 0, 0], [0, 1, 0], [0, 0, 0]]
        >>> model = psfield.PsfModel.from_basis(
        ...     None, pixel, [[1], [3]], [(0, 0), (10, 0)], normalise="keep"
        ... )
        >>> round(float(model.evaluate(10, 0).sum()), 9)
        3.0
        """
        x, y = points(positions)
        named, own = split(interpolation)
        grid = arguments("grid", locals())
        native = _native.PsfModel.from_basis(
            None if mean is None else doubles(mean, "mean", "[y, x]"),
            stack(components, "components", "[component, y, x]"),
            doubles(coefficients, "coefficients", "[position, component]"),
            x,
            y,
            _states(wavelengths_um, times_s, frame_numbers),
            shape_or_none(field_shape, "field_shape"),
            grid,
            (
                DEFAULTS.interpolation if named is None else british(named),
                text(outside, "outside"),
                text(normalise, "normalise"),
                None,
            ),
        )
        return cls._of(interpolated(native, own, table_error))

    @classmethod
    def from_gridded_psf_model(
        cls,
        model: GriddedPSFModel,
        *,
        field_shape: tuple[int, int] | None = None,
        interpolation: Interpolation | None = None,
        table_error: float = DEFAULTS.table_error,
    ) -> PsfModel:
        """Make a model from a gridded PSF model of photutils.

        The model keeps every component and does not scale the stamps. It interpolates bilinearly
        between the positions of the grid and by a cubic spline between the pixels of the stamps, as
        photutils does.

        Parameters
        ----------
        model : photutils.psf.GriddedPSFModel
            The gridded model, or any object with ``data``, ``grid_xypos`` and ``oversampling``. Its
            ``flux``, ``x_0`` and ``y_0`` are ignored.
        field_shape : (int, int), optional
            Rows and columns of the frame.
        interpolation : str, object or callable, optional
            Interpolation over the field. Default: bilinear. As for `from_samples`.
        table_error : float
            As for `from_samples`.

        Returns
        -------
        PsfModel

        Examples
        --------
        >>> import types
        >>> import numpy as np
        >>> import psfield
        >>> gridded = types.SimpleNamespace(  # photutils.psf.GriddedPSFModel
        ...     data=np.ones((4, 3, 3)), grid_xypos=[(0, 0), (9, 0), (0, 9), (9, 9)], oversampling=1
        ... )
        >>> psfield.PsfModel.from_gridded_psf_model(gridded).interpolation
        'bilinear'
        """
        oversampling = np.unique(np.atleast_1d(plain(model.oversampling, "oversampling")))
        if len(oversampling) != 1:
            raise ValueError(f"oversampling must be the same in x and y, got {model.oversampling}")
        cube = doubles(model.data, "data", "[position, y, x]")
        x, y = points(np.asarray(model.grid_xypos, dtype=float), "grid_xypos")
        _, ny, nx = cube.shape
        grid = {
            "oversampling": oversampling[0],
            "centre": ((nx - 1) / 2, (ny - 1) / 2),
            "pixel_response_included": True,
            "stamp_interpolation": "cubic-spline",
        }
        interpolation, own = split(interpolation)
        fit = {"interpolation": british(interpolation)}
        field = shape_or_none(field_shape, "field_shape")
        native = _native.PsfModel.from_samples(cube, x, y, None, field, grid, fit, True, None, None)
        return cls._of(interpolated(native, own, table_error))

    @classmethod
    @american
    def from_function(
        cls,
        function: Callable[[float, float], Any],
        shape: tuple[int, int],
        *,
        threshold: float = DEFAULTS.threshold,
        method: Literal["kriging", "mesh"] | None = None,
        measure: Literal["l2", "l1"] = DEFAULTS.measure,
        verify: int | None = None,
        seed: int = DEFAULTS.seed,
        criterion: Literal["interpolation", "neighbours", "neighbors"] | None = None,
        start: tuple[int, int] | None = None,
        max_draws: int = DEFAULTS.max_draws,
        accept_cap: bool = False,
        uniform: tuple[int, int] | None = None,
        oversampling: float = DEFAULTS.oversampling,
        centre: Centre | None = None,
        pixel_response_included: bool = DEFAULTS.pixel_response_included,
        stamp_interpolation: Literal["cubic-spline", "lanczos3"] = DEFAULTS.stamp_interpolation,
        rank: str | int | None = None,
        centring: Literal["mean", "none"] | None = None,
        noise: float | None = None,
        interpolation: Interpolation | None = None,
        table_error: float = DEFAULTS.table_error,
        outside: Literal["nearest", "extend", "error"] | None = None,
        normalise: Literal["unit", "keep"] | None = None,
        shift_copies: int | None = None,
        progress: Progress | None = None,
        **american: Unpack[American],
    ) -> PsfModel:
        """Make a model from a function that draws the PSF at any position.

        The function is called where kriging (Gaussian process regression) expects the largest
        error. Each PSF is predicted before it is drawn, until errors are at most `threshold`. Then
        random PSFs verify the result. Where the PSF is not smooth, a mesh takes over: a grid,
        refined until interpolation errors are at most `threshold`.

        Parameters
        ----------
        function : callable
            ``function(x, y)`` draws the PSF of a source at a position, in 0-based pixels of the
            frame. It returns an array ``[y, x]`` or a GalSim image, always of one shape, with the
            PSF at its centre. It is never called by two threads at once.
        shape : (int, int)
            Rows and columns of the frame.
        threshold : float
            Largest error of a predicted PSF, relative to its norm.
        method : {'kriging', 'mesh'}, optional
            Way to choose positions. By default kriging, or the mesh if `criterion` or `start` is
            given.
        measure : {'l2', 'l1'}
            Norm in which PSFs are compared.
        verify : int, optional
            Only for kriging: number of PSFs drawn at random at the end, by default 16. If one of
            them has a larger error than `threshold`, sampling goes on.
        seed : int
            Seed of the random positions.
        criterion : {'interpolation', 'neighbours'}, optional
            Only for the mesh: the error that is compared with `threshold`. By default the error of
            interpolating between neighbouring samples, or the difference of neighbouring samples.
        start : (int, int), optional
            Only for the mesh: rows and columns of the coarse grid at which the refinement starts,
            by default 5 x 5.
        max_draws : int
            Largest number of PSFs drawn. If more are needed, an error is raised.
        accept_cap : bool
            If `threshold` is not met, return a model of the samples so far in place of an error.
            The report's ``outcome`` tells.
        uniform : (int, int), optional
            Rows and columns of a regular grid of samples that replaces the refinement.
        oversampling, centre, pixel_response_included, stamp_interpolation
            Geometry of the stamps, as for `from_samples`.
        rank, centring, noise, interpolation, table_error, outside, normalise, shift_copies
            Fit of the samples, as for `from_samples`.
        progress : callable or tqdm bar, optional
            ``progress(done, total)`` with the number of PSFs drawn so far, and the number of PSFs
            known to be needed.

        Returns
        -------
        PsfModel
            Its `sampling` reports on the sampling.

        Examples
        --------
        >>> import numpy as np
        >>> import psfield
        >>> y, x = np.mgrid[-4:5, -4:5]
        >>> def draw(px, py):
        ...     return np.exp(-(x**2 + y**2) / (2 * (1 + px / 100) ** 2))
        >>> model = psfield.PsfModel.from_function(draw, (40, 60), threshold=0.05, noise=0)
        >>> model.sampling.outcome, model.field_shape
        ('met', (40, 60))
        """
        rows, columns = shape_of(shape, "shape")
        interpolation, own = split(interpolation)

        def draw(x: float, y: float) -> NDArray[np.float64]:
            return doubles(function(x, y), f"the PSF at ({x:g}, {y:g})", "[y, x]")

        stamp_shape = draw((columns - 1) / 2, (rows - 1) / 2).shape
        native, sampling = _native.sample_function(
            draw,
            stamp_shape,
            (rows, columns),
            arguments("grid", locals()),
            {
                "method": choice_or_none(method, "method", ("kriging", "mesh")),
                "criterion": choice_or_none(
                    None if criterion is None else british(criterion),
                    "criterion",
                    ("neighbours", "interpolation"),
                ),
                "measure": choice(measure, "measure", ("l1", "l2")),
                "threshold": threshold,
                "start": shape_or_none(start, "start"),
                "max_draws": max_draws,
                "accept_cap": accept_cap,
                "verify": verify,
                "seed": seed,
                "uniform": shape_or_none(uniform, "uniform"),
            },
            _fit(locals()),
            as_callback(progress),
        )
        random = sampling.pop("verification")
        verification = None if random is None else VerificationReport(**random)
        return cls._of(
            interpolated(native, own, table_error),
            SamplingReport(**sampling, verification=verification),
        )

    @classmethod
    @american
    def from_telescope(
        cls,
        telescope: PathLike = "survey-2m",
        *,
        field_shape: tuple[int, int] | None = None,
        samples: tuple[int, int] = (15, 15),
        stamp_size: int | None = None,
        oversampling: int = 2,
        wavelengths_um: ArrayLike | None = None,
        rank: str | int | None = None,
        centring: Literal["mean", "none"] | None = None,
        interpolation: Interpolation | None = None,
        table_error: float = DEFAULTS.table_error,
        outside: Literal["nearest", "extend", "error"] | None = None,
        normalise: Literal["unit", "keep"] | None = None,
        **american: Unpack[American],
    ) -> PsfModel:
        """Make a model from the optics of a telescope.

        The PSF is computed from the pupil, the wavefront over the field, the seeing, the pixel and
        the blur of the detector, on a regular grid of positions.

        Parameters
        ----------
        telescope : str or path
            A built-in telescope, or a file (TOML) that describes one. ``'survey-2m'``: an off-axis
            telescope of 2 m in space, at 633 nm, with 0.074 arcsec per pixel.
            ``'wide-field-lens'``: a lens of 180 mm on the ground, undersampled, with 11.7 arcsec
            per pixel. The aberrations of both are invented. ``psfield demo`` writes an example of a
            file.
        field_shape : (int, int), optional
            Rows and columns of the frame. The PSF at the edge of this frame is that at the edge of
            the telescope's field. Default: as the telescope.
        samples : (int, int)
            Rows and columns of the grid of positions. Between them, the PSF of ``'survey-2m'`` is
            interpolated to 0.02 % (15 x 15, at most 0.2 %) or 0.4 % (7 x 7, at most 3 %).
        stamp_size : int, optional
            Rows and columns of the stamps in frame pixels. Default: as the telescope.
        oversampling : int
            Stamp pixels per frame pixel, along each axis. Stars between pixels need 2 or more.
        wavelengths_um : array_like, optional
            Wavelengths in micrometres at which the PSF is computed. Diffraction, the phase of the
            wavefront and the seeing depend on them. Default: the telescope's own wavelength, and
            the PSF does not depend on the wavelength.
        rank, centring, interpolation, table_error, outside, normalise
            Fit of the samples, as for `from_samples`. The samples have no noise.

        Returns
        -------
        PsfModel

        Raises
        ------
        ValueError
            There is no such telescope, the file cannot be read, or a value is impossible.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_telescope(
        ...     "survey-2m", field_shape=(300, 400), samples=(3, 3), stamp_size=24, oversampling=2
        ... )
        >>> model
        <PsfModel: 9 samples, stamps 48 x 48, oversampling 2, field 300 x 400>
        """
        at = None
        if wavelengths_um is not None:
            at = column(wavelengths_um, "wavelengths_um").tolist()
            if not at:
                raise ValueError("wavelengths_um is empty: give at least one wavelength")
        settings = {
            "telescope": os.fspath(telescope),
            "field": shape_or_none(field_shape, "field_shape"),
            "samples": shape_of(samples, "samples"),
            "stamp_size": stamp_size,
            "oversampling": oversampling,
            "wavelengths_um": at,
        }
        interpolation, own = split(interpolation)
        fit = {**_fit(locals()), "noise": 0.0}
        return cls._of(interpolated(_native.sample_telescope(settings, fit), own, table_error))

    @classmethod
    @american
    def read(
        cls,
        path: PathLike,
        *,
        extension: str | int | None = None,
        contexts: Mapping[str, float] | None = None,
        detector: int | None = None,
        plane_order: str | None = None,
        skip_invalid: bool = False,
        wavelength_um: float | None = None,
        time_s: float | None = None,
        frame_number: int | None = None,
        pixel_scale_arcsec: float | None = None,
        field_centre: Centre | None = None,
        positions: Any = None,
        oversampling: float | None = None,
        centre: Centre | None = None,
        pixel_response_included: bool | None = None,
        wings: PathLike | None = None,
        rank: str | int | None = None,
        centring: Literal["mean", "none"] | None = None,
        noise: float | None = None,
        interpolation: Interpolation | None = None,
        table_error: float = DEFAULTS.table_error,
        outside: Literal["nearest", "extend", "error"] | None = None,
        normalise: Literal["unit", "keep"] | None = None,
        shift_copies: int | None = None,
        **american: Unpack[American],
    ) -> PsfModel:
        """Read a PSF file. The format is recognised by the content of the file.

        The formats are PSFEx models, gridded libraries of STPSF and WebbPSF, STDPSF, field-varying
        PSFs of ScopeSim, samples and models of psfield, and plain cubes and stamps. Arguments that
        do not apply to the format are refused.

        Parameters
        ----------
        path : path
            The file. It may be compressed (``.gz``, ``.fz``).
        extension : str or int, optional
            Extension to read, if the file holds several models (PSFEx) or images. Of a table with
            a model in each row (legacypipe), the ``CCDNAME`` or the number of the row from 0.
        contexts : dict, optional
            Values of the quantities on which the PSF depends besides the position, by their names
            in the file, such as ``{"MAG_AUTO": 18.0}`` (PSFEx).
        detector : int, optional
            Detector to read, if the file holds several (STDPSF).
        plane_order : str, optional
            Order of the planes (STPSF): ``'cards'`` or ``'sorted'`` (by y, then x). Needed only if
            the header does not show which version of STPSF wrote the file.
        skip_invalid : bool
            Leave out planes without positive flux (STPSF, STDPSF) instead of raising an error. If
            the other planes do not form a regular grid, the default interpolation is natural
            neighbour.
        wavelength_um, time_s, frame_number : optional
            Wavelength, time or frame to choose, if the PSF depends on it. As for `at`. In a file of
            ScopeSim, the nearest wavelength is taken.
        pixel_scale_arcsec, field_centre : optional
            Values that a file of ScopeSim does not state.
        positions : array_like or table, optional
            Positions of the stamps of a plain cube.
        oversampling, centre, pixel_response_included : optional
            Geometry of the stamps, for files that do not state it. As for `from_samples`.
        wings : path or str, optional
            Wings that are joined to the PSF: a PSF file with larger stamps, a radial profile (a
            file ``.csv``, ``.txt`` or ``.dat`` of radius in pixels and light), or
            ``'power=EXPONENT,RADIUS'``. They are scaled to the light of the PSF where both meet.
        rank, centring, noise, interpolation, table_error, outside, normalise, shift_copies
            Fit of the samples, as for `from_samples`. Only ``outside`` and ``normalise`` apply to
            models. By default STPSF and STDPSF libraries are interpolated bilinearly and not
            scaled.

        Returns
        -------
        PsfModel
            Its `notes` say how the file was read.

        Raises
        ------
        OSError
            The file cannot be read or is damaged. The text names the keyword or row.
        ValueError
            The file needs an argument that is missing, or an argument does not apply to the file.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> _ = model.write("psf.fits", overwrite=True)
        >>> psfield.PsfModel.read("psf.fits")
        <PsfModel: 1 position, stamps 3 x 3, oversampling 1>
        """
        file = {
            **arguments("file", locals()),
            "extension": None if extension is None else str(extension),
            "wings": None if wings is None else os.fspath(wings),
            "contexts": [
                (name, real(value, f"contexts[{name!r}]"))
                for name, value in (contexts or {}).items()
            ],
            "positions": None if positions is None else np.column_stack(points(positions)),
        }
        interpolation, own = split(interpolation)
        fit = _fit(locals())
        native = _native.PsfModel.read(os.fspath(path), file, fit)
        return cls._of(interpolated(native, own, table_error))

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on how the file of the model was read.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> model.notes  # it was not read from a file
        ()
        """
        return tuple(self._handle.notes())

    @property
    def sampling(self) -> SamplingReport | None:
        """Report of the sampling by `from_function`. None for other models.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_function(lambda x, y: [[0, 1, 0], [1, 4, 1]], (5, 8))
        >>> model.sampling.outcome, model.sampling.samples == len(model.positions)
        ('met', True)
        """
        return self._sampling

    @property
    def field_shape(self) -> tuple[int, int] | None:
        """Rows and columns of the frame over which the PSF is known, or None if not stated.

        A PSFEx model states only the positions of its stars. Its frame begins at pixel (0, 0), and
        ends as far beyond the last star as the first star is from the first pixel.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0), field_shape=(20, 30)).field_shape
        (20, 30)
        """
        return self._handle.field_shape()

    @property
    def stamp_shape(self) -> tuple[int, int]:
        """Rows and columns of the stamps.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).stamp_shape
        (1, 3)
        """
        return self._handle.stamp_shape()

    @property
    def oversampling(self) -> float:
        """Stamp pixels per frame pixel, along each axis.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0), oversampling=2).oversampling
        2.0
        """
        value: float = self._handle.grid()["oversampling"]
        return value

    @property
    def centre(self) -> Centre:
        """Point (x, y) of the stamps that lies at the position of the source.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).centre
        (1.0, 0.0)
        """
        x, y = self._handle.grid()["centre"]
        return x, y

    @property
    def pixel_response_included(self) -> bool:
        """True if the stamps include the response of a frame pixel.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).pixel_response_included
        True
        """
        value: bool = self._handle.grid()["pixel_response_included"]
        return value

    @property
    def positions(self) -> NDArray[np.float64]:
        """Positions of the samples or, without samples, of the coefficients: ``[position, 2]``.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (7, 5)).positions.tolist()
        [[7.0, 5.0]]
        """
        return np.column_stack(self._handle.positions())

    @property
    def wavelengths_um(self) -> NDArray[np.float64] | None:
        """Wavelength of each sample (micrometres), or None if the PSF does not depend on it.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (7, 5)).wavelengths_um is None
        True
        """
        return self._states_of("wavelength")

    @property
    def times_s(self) -> NDArray[np.float64] | None:
        """Time of each sample (seconds), or None if the PSF does not depend on it.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (7, 5), times_s=[60]).times_s.tolist()
        [60.0]
        """
        return self._states_of("time")

    @property
    def frame_numbers(self) -> NDArray[np.float64] | None:
        """Frame of each sample, or None if the PSF does not depend on it.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (7, 5)).frame_numbers is None
        True
        """
        return self._states_of("frame")

    def _states_of(self, kind: str) -> NDArray[np.float64] | None:
        states = self._handle.states()
        return np.asarray(states[1]) if states is not None and states[0] == kind else None

    def at(
        self,
        *,
        wavelength_um: float | None = None,
        time_s: float | None = None,
        frame_number: int | None = None,
    ) -> PsfModel:
        """Return the PSF at a wavelength, a time or a frame. The basis stays the same.

        Parameters
        ----------
        wavelength_um : float, optional
            Wavelength in micrometres. Between the wavelengths of the samples, coefficients are
            interpolated by cubics.
        time_s : float, optional
            Time in seconds. Interpolated like wavelengths.
        frame_number : int, optional
            Number of a frame. Frames are not interpolated.

        Returns
        -------
        PsfModel

        Raises
        ------
        ValueError
            The PSF does not depend on this quantity, or is not known at this value.

        Examples
        --------
        >>> import psfield
        >>> stamps, at = [[[1, 2, 1]], [[2, 3, 2]]], [(0, 0), (0, 0)]
        >>> model = psfield.PsfModel.from_samples(stamps, at, frame_numbers=[1, 2], noise=0)
        >>> model.at(frame_number=1).evaluate(0, 0).round(3).tolist()
        [[0.25, 0.5, 0.25]]
        """
        given = {
            "wavelength": real_or_none(wavelength_um, "wavelength_um"),
            "time": real_or_none(time_s, "time_s"),
            "frame": real_or_none(frame_number, "frame_number"),
        }
        chosen = [(kind, value) for kind, value in given.items() if value is not None]
        if len(chosen) != 1:
            raise ValueError("give one of wavelength_um, time_s and frame_number")
        kind, value = chosen[0]
        if self._states_of(kind) is None:
            raise ValueError(f"this PSF does not depend on the {kind}")
        return PsfModel._of(self._handle.at_state(value), self._sampling, self._given)

    def for_spectrum(
        self,
        bandpass: PathLike | tuple[ArrayLike, ArrayLike],
        spectrum: PathLike | tuple[ArrayLike, ArrayLike],
    ) -> PsfModel:
        """Return the PSF of sources with a spectrum: the mean over their detected photons.

        The model must depend on the wavelength. The basis stays the same.

        Parameters
        ----------
        bandpass : path or (array_like, array_like)
            Throughput of the instrument: wavelengths in micrometres and fractions of photons, or a
            file with these two columns. If the file does not state the unit of its wavelengths,
            give it behind the name, as in ``"filter.txt:nm"``.
        spectrum : str, path or (array_like, array_like)
            ``"blackbody:KELVIN"``, ``"powerlaw:INDEX"`` (the flux density per wavelength is
            proportional to ``wavelength**INDEX``), wavelengths in micrometres and flux densities
            per wavelength, or a file with these two columns (``"FILE[:UNIT][:VALUES]"``, where
            ``VALUES`` is ``flambda``, ``fnu`` or ``photons``). ``@z=REDSHIFT`` behind a name sets
            the redshift.

        Returns
        -------
        PsfModel

        Raises
        ------
        ValueError
            The PSF does not depend on the wavelength, the spectrum has no light in the bandpass, or
            the bandpass reaches beyond the wavelengths of the samples.

        Notes
        -----
        ``h(u; x) = int h(u; x, w) f(w) w T(w) dw / int f(w) w T(w) dw`` over the wavelengths ``w``,
        with the flux density per wavelength ``f`` and the throughput ``T``.

        Examples
        --------
        >>> import psfield
        >>> narrow, wide = [[0, 1, 0], [1, 4, 1], [0, 1, 0]], [[1, 2, 1], [2, 4, 2], [1, 2, 1]]
        >>> model = psfield.PsfModel.from_samples(
        ...     [narrow, wide], [(0, 0), (0, 0)], wavelengths_um=[0.5, 0.7]
        ... )
        >>> bandpass = ([0.5, 0.6, 0.7], [0, 1, 0])
        >>> red = model.for_spectrum(bandpass, "blackbody:3000").evaluate(0, 0)
        >>> blue = model.for_spectrum(bandpass, "blackbody:20000").evaluate(0, 0)
        >>> bool(red.max() < blue.max())
        True
        """
        native = self._handle.for_spectrum(curve(bandpass, "bandpass"), curve(spectrum, "spectrum"))
        return PsfModel._of(native, self._sampling, self._given)

    def with_parameters(
        self,
        *,
        mean: ArrayLike | None = None,
        components: ArrayLike | None = None,
        coefficients: ArrayLike | None = None,
    ) -> PsfModel:
        """Return a model with other stamps, or other coefficients at the `positions`.

        The interpolation stays the same, with its parameters, so interpolated values are linear in
        the coefficients. `psfield.torch` and `psfield.jax` differentiate with respect to all three.

        Parameters
        ----------
        mean : array_like, optional
            Mean stamp ``[y, x]``, for a model that has one.
        components : array_like, optional
            Stamps ``[component, y, x]`` of any number. They need not be orthonormal.
        coefficients : array_like, optional
            Coefficients ``[position, component]``.

        Returns
        -------
        PsfModel

        Raises
        ------
        ValueError
            An array has another shape or a value that is not finite, or the PSF has wings.

        Examples
        --------
        >>> import psfield
        >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
        >>> model = psfield.PsfModel.from_samples(stamps, [(0, 0), (9, 0)], noise=0)
        >>> other = model.with_parameters(coefficients=[[0.1], [0.3]])
        >>> other.coefficients.tolist(), other.interpolation == model.interpolation
        ([[0.1], [0.3]], True)
        """
        given = (
            None if mean is None else doubles(mean, "mean", "[y, x]"),
            None if components is None else stack(components, "components", "[component, y, x]"),
            None
            if coefficients is None
            else doubles(coefficients, "coefficients", "[position, component]"),
        )
        return PsfModel._of(self._handle.with_parameters(*given), self._sampling)

    @property
    def rank(self) -> int:
        """Number of components. The mean stamp does not count.

        Examples
        --------
        >>> import psfield
        >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
        >>> psfield.PsfModel.from_samples(stamps, [(0, 0), (9, 0)], noise=0).rank
        1
        """
        return len(self.components)

    @property
    def mean(self) -> NDArray[np.float64] | None:
        """Mean stamp ``[y, x]``, or None if the basis is not centred.

        Examples
        --------
        >>> import psfield
        >>> stamps = [[[1, 2, 1]], [[1, 4, 3]]]
        >>> psfield.PsfModel.from_samples(stamps, [(0, 0), (9, 0)], normalise="keep").mean.tolist()
        [[1.0, 3.0, 2.0]]
        """
        return self._handle.parameters()[0]

    @property
    def components(self) -> NDArray[np.float64]:
        """Orthonormal stamps ``[component, y, x]``, or those given to `with_parameters`.

        Examples
        --------
        >>> import psfield
        >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
        >>> psfield.PsfModel.from_samples(stamps, [(0, 0), (9, 0)], noise=0).components.shape
        (1, 1, 3)
        """
        return self._handle.parameters()[1]

    @property
    def given_components(self) -> NDArray[np.float64] | None:
        """Components of a basis of your own, as given: ``[component, y, x]``. Not stored in files.

        Examples
        --------
        >>> import psfield
        >>> own = [[[1, 0, 1]], [[0, 2, 0]]]
        >>> model = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0), basis=own)
        >>> model.given_components.tolist(), model.components.shape
        ([[[1.0, 0.0, 1.0]], [[0.0, 2.0, 0.0]]], (2, 1, 3))
        """
        return self._given

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """Coefficients of the components at `positions`: ``[position, component]``.

        Examples
        --------
        >>> import psfield
        >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
        >>> psfield.PsfModel.from_samples(stamps, [(0, 0), (9, 0)], noise=0).coefficients.shape
        (2, 1)
        """
        return self._handle.parameters()[2]

    @property
    def interpolation(self) -> str:
        """Interpolation of the coefficients over the field.

        An interpolation of your own is a table, as in ``'RBFInterpolator (table=8,8)'``.

        Examples
        --------
        >>> import psfield
        >>> stamps, corners = [[[1, 2, 1]]] * 4, [(0, 0), (9, 0), (0, 9), (9, 9)]
        >>> psfield.PsfModel.from_samples(stamps, corners, interpolation="bilinear").interpolation
        'bilinear'
        """
        name, *_, table_of = self._handle.choices()
        return name if table_of is None else f"{table_of} ({name})"

    @property
    def outside(self) -> str:
        """Policy for positions outside the area of the samples.

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).outside
        'nearest'
        """
        return self._handle.choices()[1]

    @property
    def normalise(self) -> str:
        """Scaling of the PSFs: to unit flux ('unit'), or none ('keep').

        Examples
        --------
        >>> import psfield
        >>> psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).normalise
        'unit'
        """
        return self._handle.choices()[2]

    def fit_report(self) -> FitReport | None:
        """Return the errors and choices of the fit, or None for a model without samples.

        Returns
        -------
        FitReport or None

        Warns
        -----
        PsfieldWarning
            The samples do not determine the model (`FitReport.warnings`).

        Examples
        --------
        >>> import psfield
        >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
        >>> model = psfield.PsfModel.from_samples(stamps, [(0, 0), (9, 0)], noise=0)
        >>> report = model.fit_report()
        >>> report.rank, report.max_error < 1e-12
        (1, True)
        """
        report = self._report or self._handle.fit_report()
        if report is None:
            return None
        found = json.loads(report)
        found["leave_one_out"] = LeaveOneOutReport(**found["leave_one_out"])
        found["wings"] = found["wings"] and WingsReport(**found["wings"])
        for warning in found["warnings"]:
            warnings.warn(warning, PsfieldWarning, stacklevel=2)
        return FitReport(**found)

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
            Positions in 0-based pixels of the frame. ``x`` and ``y`` are broadcast together.
        pixels : {'stamp', 'frame'}
            Sample the PSF at the pixels of the stamps or at the pixels of the frame. Pixels of the
            frame include the pixel response, even if the stamps do not.
        size : int, optional
            Rows and columns of the result, which is cut or padded about the centre.
        sub_pixel : bool
            Draw each PSF at the sub-pixel phase of its position, as a star there appears, instead
            of centred. The centre of the result is the pixel on which the star lies, ``floor(x +
            0.5)`` and ``floor(y + 0.5)``. It needs ``pixels='frame'``.

        Returns
        -------
        numpy.ndarray
            ``[y, x]`` for one position, else ``[..., y, x]`` with the shape of the positions.

        Warns
        -----
        PsfieldWarning
            If the PSF is a polynomial that was fitted to a much smaller range than the positions.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0))
        >>> model.evaluate(7.0, 5.0).tolist()
        [[0.25, 0.5, 0.25]]
        >>> model.evaluate([1, 2, 3, 4], 5.0).shape
        (4, 1, 3)
        """
        at_frame = choice(pixels, "pixels", ("stamp", "frame")) == "frame"
        size, sub_pixel = integer_or_none(size, "size", 1), boolean(sub_pixel, "sub_pixel")
        at_x, at_y = (
            plain(in_unit(axis, "pix", name), name) for axis, name in ((x, "x"), (y, "y"))
        )
        try:
            xs, ys = np.broadcast_arrays(at_x, at_y)
        except ValueError:
            shapes = f"{np.shape(x)} and {np.shape(y)}"
            raise ValueError(f"x and y of the shapes {shapes} cannot be broadcast") from None
        shape = xs.shape
        flat_x, flat_y = (
            np.ascontiguousarray(column(axis.ravel(), name))
            for axis, name in ((xs, "x"), (ys, "y"))
        )
        stamps, warning = self._handle.evaluate(flat_x, flat_y, at_frame, size, sub_pixel)
        if warning is not None:
            warnings.warn(warning, PsfieldWarning, stacklevel=2)
        return stamps.reshape(*shape, *stamps.shape[1:])

    def to_gridded_psf_model(self, grid_shape: tuple[int, int] | None = None) -> GriddedPSFModel:
        """Return the PSF as photutils' `~photutils.psf.GriddedPSFModel`.

        Parameters
        ----------
        grid_shape : (int, int), optional
            Rows and columns of the grid of positions. By default the positions of the model, if
            they are a grid, else a grid of at least 11 x 11 over the field.

        Returns
        -------
        photutils.psf.GriddedPSFModel
            Its ``meta['psfield_max_error']`` is the largest relative L2 difference from this model
            halfway between the positions, where the gridded model interpolates. The value is None
            if this model is itself bilinear between these positions.

        Examples
        --------
        >>> import psfield
        >>> stamps, corners = [[[1, 2, 4, 2, 1]] * 5] * 4, [(0, 0), (9, 0), (0, 9), (9, 9)]
        >>> model = psfield.PsfModel.from_samples(stamps, corners)
        >>> import photutils.psf
        >>> model.to_gridded_psf_model().data.shape
        (4, 5, 5)
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
        precision: Precision = DEFAULTS.precision,
        overwrite: bool = False,
    ) -> tuple[str, ...]:
        """Write the PSF to a file. If the writing fails, no partial file is left.

        Parameters
        ----------
        path : path
            The file.
        format : {'psf-model', 'psf-samples', 'psfex', 'gridded'}
            A model of psfield, stamps at positions, a model of PSFEx, or a library for photutils.
        degree : int, optional
            Degree of the polynomial of PSFEx.
        grid_shape : (int, int), optional
            Rows and columns of a grid of positions, for samples and libraries. By default the
            positions of the model.
        precision : {'f32', 'f64'} or dtype
            Precision of samples.
        overwrite : bool
            Replace an existing file.

        Returns
        -------
        tuple of str
            Notes on properties of the model that the file cannot hold, in sentences.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> model.write("samples.fits", format="psf-samples", precision="f64", overwrite=True)
        ()
        """
        settings = {
            "format": format,
            "degree": degree,
            "at": shape_or_none(grid_shape, "grid_shape"),
            "double": precision_of(precision, "precision") == "f64",
            "overwrite": overwrite,
        }
        return tuple(self._handle.write(os.fspath(path), settings))

    def plan(
        self,
        shape: tuple[int, int],
        tolerance: float = DEFAULTS.tolerance,
        precision: Precision = DEFAULTS.precision,
        device: Literal["auto", "cpu", "gpu"] = DEFAULTS.device,
        *,
        frame: tuple[int, int, int, int] | None = None,
        region: tuple[int, int, int, int] | None = None,
        tolerance_on: Literal["l2", "aperture"] = DEFAULTS.tolerance_on,
        floor: float = DEFAULTS.floor,
        anchor: Literal["source", "output"] = DEFAULTS.anchor,
        method: Literal["auto", "lowrank"] = DEFAULTS.method,
        memory: int | None = DEFAULTS.memory,
        oversample: int = DEFAULTS.oversample,
        scene_pixels: Literal["point", "integrated"] = DEFAULTS.scene_pixels,
        stamp_size: int | None = None,
        gpu_adapter: str | None = None,
        gpu_memory: int | None = None,
        bandpass: PathLike | tuple[ArrayLike, ArrayLike] | None = None,
        sed: PathLike | None = None,
        dispersion: Mapping[str, float] | str | None = None,
    ) -> Plan:
        """Prepare the simulation of scenes of one shape.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the scenes.
        tolerance : float
            Largest relative L2 error that the engine may add to the PSF of any single pixel, star
            or galaxy, from 0 (limited only by rounding) to below 1.
        precision : {'f32', 'f64'} or dtype
            Precision of the computation and of the images. Also ``'float64'``, ``numpy.float64``
            or any other spelling of these types.
        device : {'auto', 'cpu', 'gpu'}
            Device that convolves scenes. ``auto`` uses a GPU if that is predicted to be faster.
            Stars and galaxies are drawn on the CPU.
        frame : (int, int, int, int), optional
            Part of the scene that the image shows: first column, first row, columns, rows, in
            pixels of the image. Field positions count from the first pixel of the frame. Light from
            around the frame enters the image.
        region : (int, int, int, int), optional
            Part of the frame to simulate: first column, first row, columns, rows, in pixels of the
            image counted from the first pixel of the frame. Use it to simulate a frame in pieces,
            on one or many machines. The pieces together equal the image of the whole frame except
            for rounding, at any tolerance. A scene needs light only within `Plan.light_region`.
            `Plan.for_region` makes the plans for the other regions.
        tolerance_on : {'l2', 'aperture'}
            Errors that the tolerance bounds. ``l2``: the relative L2 error of a PSF. ``aperture``:
            also the error of the flux in every circle about the source, relative to the total flux
            of the PSF.
        floor : float
            Flux per pixel below which light of stars and galaxies may be dropped, such as a tenth
            of the noise (`psfield.detector.Detector.noise`). A source is drawn as far as its light
            exceeds the floor, and at least to the radius of 90 % of its light, so faint sources
            are drawn faster. `Plan.dropped_light` says how much is dropped, and `Plan.spot_check`
            allows it. With 0, nothing is dropped. Scenes that are images do not depend on it, nor
            does `Plan.adjoint`.
        anchor : {'source', 'output'}
            Position at which the PSF is evaluated. ``source``: each source spreads with the PSF at
            its own position. ``output``: each pixel gathers light with the PSF at its own position.
        method : {'auto', 'lowrank'}
            ``auto`` convolves each tile in the cheapest way, ``lowrank`` only by transforms.
        memory : int, optional
            Largest number of bytes that the plan keeps. Default: 256 MiB, and room for two images
            of the frame and for the stamps of the PSF model. Galaxies need memory beside it, which
            grows with the number of components and with the sizes of the galaxies.
        oversample : int
            Scene pixels along each side of a pixel of the image. Stars and galaxies of a catalogue
            do not depend on it.
        scene_pixels : {'point', 'integrated'}
            Meaning of the values of the scene's image. ``point``: light at the centres of the
            scene's pixels. ``integrated``: light that is already integrated over the scene's
            pixels. The response of these pixels is then taken out, for detail that the pixels can
            hold. This amplifies noise in the scene by at most 2.47 before the PSF. Stars and
            galaxies of a catalogue do not depend on it.
        stamp_size : int, optional
            Cut or pad stamps to this number of pixels of the image along each side.
        gpu_adapter : str, optional
            Part of the name of the GPU to use.
        gpu_memory : int, optional
            Largest number of bytes that the plan keeps on a GPU.
        bandpass : path or (array_like, array_like), optional
            Throughput of the instrument, as for `for_spectrum`. It makes a plan in colour: light
            has spectra, and each source has the PSF of its own spectrum. The model must depend on
            the wavelength. Fluxes are those that the detector sees in the bandpass. Each new set of
            spectra is planned when a scene first has it, and the plans of four sets are kept. What
            the plan says of its tiles is that of the spectrum ``sed``, or of a flat one. Images of
            several spectra are convolved on the CPU.
        sed : str, optional
            In colour: the spectrum of images and sources that name none, by its name or its file,
            as for `for_spectrum`.
        dispersion : dict, optional
            In colour: the dispersion of the atmosphere, such as ``{"zenith": 50, "scale": 0.2}``.
            The keys are those of the command line's ``--dispersion``.

        Returns
        -------
        Plan

        Raises
        ------
        ValueError
            An argument is invalid, or does not fit to others or to the model.
        OSError
            A file cannot be read, or the GPU cannot be used.

        Examples
        --------
        >>> import psfield
        >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
        >>> model.plan((4, 6), tolerance=1e-4, precision="float64", device="cpu")
        <Plan: scenes 4 x 6, tolerance 0.0001, f64, on the CPU>
        """
        given = locals()
        colour = {name: given[name] for name in COLOUR}
        return Plan(self, shape, precision=precision, **arguments("plan", given), **colour)

    def __repr__(self) -> str:
        kind = "sample" if self._handle.has_samples() else "position"
        (ny, nx), count = self.stamp_shape, len(self._handle.positions()[0])
        plural = "" if count == 1 else "s"
        states = self._states_in_words()
        at = "" if states is None else f", at {states}"
        field = "" if self.field_shape is None else ", field {} x {}".format(*self.field_shape)
        return (
            f"<PsfModel: {count} {kind}{plural}{at}, stamps {ny} x {nx},"
            f" oversampling {self.oversampling:g}{field}>"
        )

    def _states_in_words(self) -> str | None:
        """Return the number and the range of the wavelengths, times or frames, if there are any."""
        states = self._handle.states()
        if states is None:
            return None
        kind, values = states
        least, most, count = min(values), max(values), len(set(values))
        unit = {"wavelength": " um", "time": " s"}.get(kind, "")
        to = "" if count == 1 else f" to {most:g}"
        return f"{count} {kind}{'' if count == 1 else 's'} ({least:g}{to}{unit})"

    def _repr_html_(self) -> str:
        rank = self._handle.rank_if_fitted()
        rows = {
            "Samples" if self._handle.has_samples() else "Positions": len(self.positions),
            "Depends on": self._states_in_words(),
            "Field": "not stated" if self.field_shape is None else size(self.field_shape),
            "Stamps": size(self.stamp_shape),
            "Oversampling": self.oversampling,
            "Centre (x, y)": "({:g}, {:g})".format(*self.centre),
            "Pixel response included": self.pixel_response_included,
            "Components": "not fitted yet" if rank is None else rank,
        }
        if rank is not None:
            rows |= {
                "Interpolation": self.interpolation,
                "Outside the samples": self.outside,
                "Scaling of PSFs": self.normalise,
            }
        return table("PsfModel", rows)

    def __reduce__(self) -> tuple[Any, ...]:
        has_samples = self._handle.has_samples()
        report = None if has_samples else self._report or self._handle.fit_report()
        parameters = self._handle.given_parameters()
        return _again, (*self._handle.state(), self._sampling, self._given, report, parameters)


def _again(
    constructor: str,
    arguments: tuple[Any, ...],
    sampling: SamplingReport | None,
    given: NDArray[np.float64] | None = None,
    report: str | None = None,
    parameters: tuple[Any, ...] | None = None,
) -> PsfModel:
    """Make a pickled model again."""
    native = getattr(_native.PsfModel, constructor)(*arguments)
    if parameters is not None:
        native = native.with_parameters(*parameters)
    return PsfModel._of(native, sampling, given, report)


def _fit(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of the fit among arguments, as the native module accepts them."""
    fit = arguments("fit", given)
    if fit["rank"] is not None:
        fit["rank"] = str(fit["rank"])
    return {**fit, "interpolation": british(fit["interpolation"])}


def _refuse_with(given: str, **settings: Any) -> None:
    """Refuse settings that do not apply together with an argument."""
    for name, value in settings.items():
        if value is not None:
            raise ValueError(f"{name} does not apply together with {given}: leave it out")


def _weighted(
    stamps: NDArray[np.float64], weights: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return stamps with 0 in place of bad pixels, and a weight for each pixel."""
    given = reals(weights, "weights")
    if given.ndim == 1 and len(given) == len(stamps):
        given = given[:, np.newaxis, np.newaxis]
    if given.ndim != 3:
        raise ValueError(
            f"weights must be an array [sample, y, x] or [sample], got one of shape {given.shape}"
        )
    try:
        each = np.broadcast_to(given, stamps.shape).copy()
    except ValueError:
        raise ValueError(
            f"weights must have the shape of the stamps, {stamps.shape}, got {given.shape}"
        ) from None
    return np.where(each == 0, 0.0, stamps), each


def _states(
    wavelengths_um: ArrayLike | None, times_s: ArrayLike | None, frame_numbers: ArrayLike | None
) -> tuple[str, list[float]] | None:
    """Return the states of samples, as the native module accepts them."""
    given = [
        (kind, name, values)
        for kind, name, values in (
            ("wavelength", "wavelengths_um", wavelengths_um),
            ("time", "times_s", times_s),
            ("frame", "frame_numbers", frame_numbers),
        )
        if values is not None
    ]
    if not given:
        return None
    if len(given) > 1:
        raise ValueError(f"give only one of {given[0][1]} and {given[1][1]}")
    kind, name, values = given[0]
    return kind, column(np.atleast_1d(plain(values, name)), name).tolist()

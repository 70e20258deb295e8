"""Reports on models, plans and exposures."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, fields
from typing import Any


class Report:
    """A report whose values are attributes. They can still be read by their names in brackets."""

    def __getitem__(self, name: str) -> Any:
        if name not in (known.name for known in fields(self)):  # type: ignore[arg-type]
            raise KeyError(name)
        text = f"reports have attributes now: .{name} in place of [{name!r}]"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return getattr(self, name)


@dataclass(frozen=True)
class LeaveOneOutReport(Report):
    """The errors of predicting each sample from all others, relative to the norm of the sample.

    `FitReport.leave_one_out` is one. The errors include those of the truncated basis.

    Attributes
    ----------
    folds : int or None
        Number of parts into which the samples were divided, if each part was predicted from the
        others: for an interpolation of your own. None if each sample was predicted from all others.
    predicted : int
        Number of samples inside the area that the other samples cover. They are interpolated.
    median, max : float or None
        Median and largest error of these samples. None if there are none.
    extrapolated : int
        Number of samples at the border, which the other samples can only extrapolate.
    unpredictable : int
        Number of samples that the others cannot predict.
    errors : list of float or None
        Error of every sample. None where there is no prediction.

    Examples
    --------
    >>> import psfield
    >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
    >>> model = psfield.PsfModel.from_samples(stamps, [(0, 0), (9, 0)], noise=0)
    >>> model.fit_report().leave_one_out.extrapolated
    2
    """

    folds: int | None
    predicted: int
    median: float | None
    max: float | None
    extrapolated: int
    unpredictable: int
    errors: list[float | None] = field(repr=False)


@dataclass(frozen=True)
class WingsReport(Report):
    """The wings that a fit has split from large stamps. `FitReport.wings` is one.

    Attributes
    ----------
    core_size : int
        Columns and rows of the stamps of the core.
    modes : int
        Number of stamps of the wings.
    error : float
        Root mean square difference from the wings of the samples, relative to the light at the same
        distance from the source.
    flux : list of float
        Least and largest part of the flux that the wings hold.

    Examples
    --------
    >>> import numpy as np
    >>> import psfield
    >>> y, x = np.mgrid[-200:201, -200:201]
    >>> model = psfield.PsfModel.from_samples((1 + x**2 + y**2) ** -1.5, (0, 0))
    >>> model.fit_report().wings.modes
    1
    """

    core_size: int
    modes: int
    error: float
    flux: list[float]


@dataclass(frozen=True)
class FitReport(Report):
    """The errors and choices of the fit of a model. `PsfModel.fit_report` returns it.

    Attributes
    ----------
    samples : int
        Number of samples.
    depends_on : str or None
        Quantity on which the PSF depends besides the position, such as 'wavelength'.
    states : list of float
        Values of this quantity that the samples have, ascending.
    rank : int
        Number of components kept, without the mean.
    elbow : int or None
        Number of components at the elbow of the cumulative weights.
    noise_sigma : float or None
        Standard deviation of the noise in the pixels of the samples, estimated or given. None if
        there is none.
    interpolation, outside, normalise : str
        Choices that the model uses.
    interpolation_reason : str
        Why the model uses this interpolation. Empty if it was named.
    max_error, rms_error : float
        Largest and root mean square error of the truncated basis, relative to each sample.
    errors : list of float
        This error for every sample.
    circle_error : float or None
        Largest error of the flux in circles about the source, over the samples, relative to the
        total flux. Of noisy samples, only what the noise does not explain.
    leave_one_out : LeaveOneOutReport
        Errors of predicting each sample from the others.
    expected_error : float or None
        Error that kriging expects between the samples: relative L2, root mean square over the
        field, without the error of the truncated basis. None for other interpolations.
    wings : WingsReport or None
        Wings that were split from large stamps. The other errors are then those of the core.
    singular_values, cumulative_weights : list of float
        Singular values that were computed, from the largest on, and their cumulative weights.
    warnings : list of str
        Sentences on samples that do not determine the model.

    Examples
    --------
    >>> import psfield
    >>> stamps = [[[1, 2, 1]], [[2, 3, 2]]]
    >>> model = psfield.PsfModel.from_samples(stamps, [(0, 0), (9, 0)], noise=0)
    >>> report = model.fit_report()
    >>> report.samples, report.rank, report.max_error < 1e-12
    (2, 1, True)
    """

    samples: int
    depends_on: str | None
    states: list[float]
    rank: int
    elbow: int | None
    noise_sigma: float | None
    interpolation: str
    interpolation_reason: str
    outside: str
    normalise: str
    max_error: float
    rms_error: float
    errors: list[float] = field(repr=False)
    circle_error: float | None
    leave_one_out: LeaveOneOutReport
    expected_error: float | None
    wings: WingsReport | None
    singular_values: list[float] = field(repr=False)
    cumulative_weights: list[float] = field(repr=False)
    warnings: list[str]


@dataclass(frozen=True)
class VerificationReport(Report):
    """The random tests of a sampling. `SamplingReport.verification` is one.

    Attributes
    ----------
    tests, above : int
        Number of PSFs drawn at random, and of those whose error exceeds the threshold.
    fraction_limit : float
        With 95 % confidence, errors exceed the threshold in at most this fraction of the field.
    worst : float
        Largest error of these PSFs.
    worst_at : (float, float)
        Its position x, y.
    draws : int
        Number of PSFs drawn at random in all, those of earlier verifications included.

    Examples
    --------
    >>> import psfield
    >>> model = psfield.PsfModel.from_function(lambda x, y: [[0, 1, 0], [1, 4, 1]], (50, 80))
    >>> found = model.sampling.verification
    >>> found.above, found.tests, round(found.fraction_limit, 2)
    (0, 16, 0.17)
    """

    tests: int
    above: int
    fraction_limit: float
    worst: float
    worst_at: tuple[float, float]
    draws: int


@dataclass(frozen=True)
class SamplingReport(Report):
    """The sampling of a PSF that a function draws. `PsfModel.sampling` is one.

    Attributes
    ----------
    method : {'kriging', 'mesh'} or None
        Method that chose the last positions. None for a regular grid.
    samples, draws : int
        Number of samples kept, and of PSFs drawn.
    cells, unmet_cells : int
        Number of cells of the mesh, and of those whose error exceeds the threshold.
    worst : float
        Largest error measured last: by the last tests of kriging, or in a cell of the mesh.
    worst_at : (float, float) or None
        Its position x, y.
    expected : float or None
        Largest error that kriging expects anywhere in the field.
    threshold : float or None
        Largest error allowed.
    outcome : {'met', 'cell-size-reached', 'cap-reached'}
        Whether the threshold is met, some cells are as small as cells may be, or ``max_draws`` is
        reached.
    verification : VerificationReport or None
        Random tests at the end. None if there were none.

    Examples
    --------
    >>> import psfield
    >>> model = psfield.PsfModel.from_function(lambda x, y: [[0, 1, 0], [1, 4, 1]], (5, 8))
    >>> model.sampling.outcome, model.sampling.samples == len(model.positions)
    ('met', True)
    """

    method: str | None
    samples: int
    draws: int
    cells: int
    unmet_cells: int
    worst: float
    worst_at: tuple[float, float] | None
    expected: float | None
    threshold: float | None
    outcome: str
    verification: VerificationReport | None


@dataclass(frozen=True)
class PlanSummary(Report):
    """The properties of a plan. `Plan.summary` is one.

    Attributes
    ----------
    shape, frame_shape : (int, int)
        Rows and columns of the scenes, and of the images.
    precision, tolerance, tolerance_on, anchor, method, scene_pixels
        Arguments of `PsfModel.plan`.
    device : str
        The device, and why it was chosen.
    gpu : str or None
        Name of the GPU.
    tile_shape, transform_shape : (int, int)
        Rows and columns of the largest tile, and of the transforms.
    tiles, blocks : int
        Number of tiles, and of blocks: the tiles of a block share their modes.
    mean_modes : float
        Mean number of modes of a block, the mean PSF included.
    most_modes : int
        Largest number of modes of a block.
    predicted_seconds : float
        Predicted time of an image with light in every pixel, on one thread.
    kept_bytes : int
        Memory of the plan.

    Examples
    --------
    >>> import psfield
    >>> plan = psfield.PsfModel.from_samples([[1, 2, 1]], (0, 0)).plan((4, 6), device="cpu")
    >>> plan.summary.shape, plan.summary.precision, plan.summary.gpu
    ((4, 6), 'f32', None)
    """

    shape: tuple[int, int]
    frame_shape: tuple[int, int]
    precision: str
    tolerance: float
    tolerance_on: str
    anchor: str
    method: str
    scene_pixels: str
    device: str
    gpu: str | None
    tile_shape: tuple[int, int]
    transform_shape: tuple[int, int]
    tiles: int
    blocks: int
    mean_modes: float
    most_modes: int
    predicted_seconds: float
    kept_bytes: int


@dataclass(frozen=True)
class ExposureReport(Report):
    """Statistics of an exposure. `Exposure.report` is one.

    Attributes
    ----------
    seed : int
        Seed of the noise.
    pixels : int
        Number of pixels.
    saturated_pixels : int
        Pixels at their full well or at the upper end of the converter.
    below_zero_pixels : int
        Pixels that the converter set to 0 because their count was negative.
    negative_pixels : int
        Pixels whose expected charge was negative. It keeps its sign in the exposure.
    lowest_expected_e : float
        Lowest charge expected in a pixel, in electrons.
    bad_pixels, dead_pixels, hot_pixels, bad_column_pixels : int
        Pixels with any fault, and with each fault.
    mean_sky_e : float
        Mean sky in electrons per pixel.
    dark_e : float
        Dark charge of a good pixel in electrons.

    Examples
    --------
    >>> from psfield.detector import Detector
    >>> Detector(full_well_e=50.0).expose([[1.0, 60.0]], seed=1).report.saturated_pixels
    1
    """

    seed: int
    pixels: int
    saturated_pixels: int
    below_zero_pixels: int
    negative_pixels: int
    lowest_expected_e: float
    bad_pixels: int
    dead_pixels: int
    hot_pixels: int
    bad_column_pixels: int
    mean_sky_e: float
    dark_e: float

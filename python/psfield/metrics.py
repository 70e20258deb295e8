"""Measurements of PSFs and images: Gaussian fits, adaptive moments, error norms.

Stamps are ``[y, x]``; centroids 0-based stamp indices; lengths in pixels of the stamp; angles in radians from +x towards +y.

The ellipticities of an ellipse with axes ``a >= b`` and position angle ``phi``:

==============  =============================================
eccentricity    ``sqrt(1 - b**2 / a**2)``: ``ellipticity``
distortion      ``(a**2 - b**2) / (a**2 + b**2)``: ``e1``, ``e2``
reduced shear   ``(a - b) / (a + b)``: ``g1``, ``g2``
==============  =============================================

>>> import numpy as np
>>> from psfield import metrics
>>> y, x = np.mgrid[-12:13, -12:13]
>>> fit = metrics.fit_gaussian(np.exp(-0.5 * (x**2 / 4 + y**2 / 9)))
>>> round(fit.fwhm_minor / fit.fwhm_major, 6), round(fit.angle / np.pi, 3)
(0.666667, 0.5)
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._arrays import doubles, points, reals
from psfield._choices import real, whole, whole_or_none, yes_or_no

__all__ = [
    "AdaptiveMoments",
    "Comparison",
    "GaussianFit",
    "QuadrupoleMoments",
    "adaptive_moments",
    "compare",
    "fit_gaussian",
    "measure",
    "quadrupole_moments",
]


@dataclass(frozen=True)
class GaussianFit:
    """A Gaussian fitted by least squares.

    Attributes
    ----------
    flux, amplitude : float
        Its integral and its peak.
    x, y : float
        The centroid.
    fwhm, fwhm_major, fwhm_minor : float
        Full widths at half maximum: the geometric mean, and of the axes.
    angle : float
        Of the major axis.
    ellipticity : float
        ``sqrt(1 - b**2 / a**2)``.
    background : float or None
        The constant background, where it was fitted.
    residual_rms : float
        Root mean square of what the fit leaves.
    """

    flux: float
    amplitude: float
    x: float
    y: float
    fwhm: float
    fwhm_major: float
    fwhm_minor: float
    angle: float
    ellipticity: float
    background: float | None
    residual_rms: float


@dataclass(frozen=True)
class AdaptiveMoments:
    """Second moments under a Gaussian weight of the light's own size and shape (Hirata and Seljak 2003).

    Attributes
    ----------
    amplitude : float
        Of the matched Gaussian.
    x, y : float
        The centroid.
    sigma : float
        ``det(moments)**(1/4)``, as GalSim's ``moments_sigma``.
    e1, e2 : float
        Distortion.
    g1, g2 : float
        Reduced shear.
    """

    amplitude: float
    x: float
    y: float
    sigma: float
    e1: float
    e2: float
    g1: float
    g2: float


@dataclass(frozen=True)
class QuadrupoleMoments:
    """Plain second moments, without a weight.

    Attributes
    ----------
    flux : float
        The sum of the pixels.
    x, y : float
        The centroid.
    sigma : float
        ``det(moments)**(1/4)``.
    e1, e2 : float
        Distortion.
    g1, g2 : float
        Reduced shear.
    """

    flux: float
    x: float
    y: float
    sigma: float
    e1: float
    e2: float
    g1: float
    g2: float


@dataclass(frozen=True)
class Comparison:
    """How far a result is from a reference; what has no meaning (a dark reference, no error at all) is None.

    Attributes
    ----------
    mae, mse, max_abs : float
        Mean absolute, mean squared and largest absolute error.
    max_abs_index : tuple of int
        Where the largest is.
    relative_l2 : float or None
        ``norm(result - reference) / norm(reference)``.
    max_over_peak : float or None
        The largest over the reference's peak.
    mae_over_mean : float or None
        The mean absolute error over the reference's mean.
    snr_db : float or None
        ``-20 log10(relative_l2)``.
    """

    mae: float
    mse: float
    max_abs: float
    max_abs_index: tuple[int, ...]
    relative_l2: float | None
    max_over_peak: float | None
    mae_over_mean: float | None
    snr_db: float | None


def fit_gaussian(
    stamp: Any,
    *,
    size: int | None = None,
    about: tuple[int, int] | None = None,
    background: bool = False,
    round: bool = False,
) -> GaussianFit:
    """Fit a Gaussian to a stamp.

    Parameters
    ----------
    stamp : array_like
        ``[y, x]``.
    size : int, optional
        Use so many pixels each way alone, about index ``n // 2`` or about ``about``.
    about : (int, int), optional
        Column and row of the middle of these pixels; needs ``size``.
    background : bool
        Fit a constant background too.
    round : bool
        Fit a round Gaussian, in place of an elliptical one.

    Returns
    -------
    GaussianFit

    Raises
    ------
    ValueError
        What could not be measured, and why.
    """
    values = doubles(stamp, "stamp", "[y, x]")
    return GaussianFit(
        **_native.fit_gaussian(values, *_window(size, about), yes_or_no(background, "background"), yes_or_no(round, "round"))
    )


def adaptive_moments(
    stamp: Any,
    *,
    size: int | None = None,
    about: tuple[int, int] | None = None,
    start: tuple[float, float, float] | None = None,
) -> AdaptiveMoments:
    """Measure the adaptive moments of a stamp, as HSM does in GalSim (``FindAdaptiveMom``).

    Parameters
    ----------
    stamp : array_like
        ``[y, x]``.
    size, about
        As for `fit_gaussian`.
    start : (float, float, float), optional
        Centroid x, y and sigma to start from.

    Returns
    -------
    AdaptiveMoments

    Raises
    ------
    ValueError
        What could not be measured, and why.
    """
    values = doubles(stamp, "stamp", "[y, x]")
    return AdaptiveMoments(**_native.adaptive_moments(values, *_window(size, about), _start(start)))


def quadrupole_moments(stamp: Any, *, size: int | None = None, about: tuple[int, int] | None = None) -> QuadrupoleMoments:
    """Measure the plain second moments of a stamp.

    Parameters
    ----------
    stamp : array_like
        ``[y, x]``.
    size, about
        As for `fit_gaussian`.

    Returns
    -------
    QuadrupoleMoments

    Raises
    ------
    ValueError
        What could not be measured, and why.
    """
    values = doubles(stamp, "stamp", "[y, x]")
    return QuadrupoleMoments(**_native.quadrupole_moments(values, *_window(size, about)))


def compare(result: Any, reference: Any) -> Comparison:
    """Compare a result with a reference.

    Parameters
    ----------
    result, reference : array_like
        Of one shape, finite.

    Returns
    -------
    Comparison
    """
    figures = _native.compare(reals(result, "result"), reals(reference, "reference"))
    return Comparison(**{**figures, "max_abs_index": tuple(figures["max_abs_index"])})


def measure(images: Any, positions: Any = None, *, size: int | None = None, background: bool = False) -> dict[str, NDArray[Any]]:
    """Measure sizes and shapes of many PSFs: every stamp of a stack, or the stars of an image.

    Parameters
    ----------
    images : array_like
        Stamps ``[stamp, y, x]``, or with ``positions`` an image ``[y, x]``.
    positions : array_like or table, optional
        Where the stars lie: ``[star, 2]``, x and y, or a table with columns x and y.
    size : int, optional
        Pixels each way that are used, about the middle of a stamp or about a star. Default: a whole stamp for the moments and for the
        fit, 15 pixels about a star.
    background : bool
        Fit a constant background too.

    Returns
    -------
    dict of str to numpy.ndarray
        A column for each figure, as ``psfield measure`` writes them: ``flux``, ``x_centroid``, ``y_centroid``, ``fwhm_px``,
        ``fwhm_major_px``, ``fwhm_minor_px``, ``angle_rad``, ``ellipticity`` (Gaussian fit), ``e1``, ``e2``, ``g1``, ``g2``, ``sigma_px``
        (adaptive moments), and ``note``, which says what could not be measured and is then NaN. `astropy.table.Table` takes it as it is.
    """
    size, background = whole_or_none(size, "size", 1), yes_or_no(background, "background")
    if positions is None:
        text = _native.measure_stamps(doubles(images, "images", "[stamp, y, x]"), size, background)
    else:
        text = _native.measure_image(doubles(images, "images", "[y, x]"), *points(positions), size, background)
    rows = json.loads(text)
    names = [name for name in rows[0] if name not in ("x", "y", "note")] if rows else []
    columns: dict[str, NDArray[Any]] = {
        name: np.array([np.nan if row[name] is None else row[name] for row in rows], dtype=np.float64) for name in names
    }
    columns["note"] = np.array([row["note"] for row in rows], dtype=np.str_)
    return columns


def _window(size: int | None, about: tuple[int, int] | None) -> tuple[int | None, tuple[int, int] | None]:
    """Return the window that is measured."""
    if about is None:
        return whole_or_none(size, "size"), None
    if size is None:
        raise ValueError("about is the middle of a window: give its size too")
    try:
        column, row = about
    except (TypeError, ValueError):
        raise TypeError(f"about must be (column, row), two whole numbers, got {about!r}") from None
    return whole(size, "size"), (whole(column, "about: column"), whole(row, "about: row"))


def _start(start: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
    """Return where adaptive moments start from."""
    if start is None:
        return None
    try:
        x, y, sigma = start
    except (TypeError, ValueError):
        raise TypeError(f"start must be three numbers (x, y, sigma), got {start!r}") from None
    if not real(sigma, "start: sigma") > 0:
        raise ValueError(f"start: sigma must be above 0, got {sigma}")
    return real(x, "start: x"), real(y, "start: y"), float(sigma)

"""Measurements of PSFs and images: Gaussian fits, moments and error norms.

Stamps are ``[y, x]``. Centroids are 0-based indices of the stamp and lengths are in its pixels.
Angles are in radians from +x towards +y.

Measures of the elongation of an ellipse with axes ``a >= b`` and position angle ``phi``, and the
attributes that hold them:

==============  ======================================================================
eccentricity    ``eccentricity``: ``sqrt(1 - b**2 / a**2)``
ellipticity     ``ellipticity``: ``(a**2 - b**2) / (a**2 + b**2)``
distortion      ``e1``, ``e2``: the ellipticity times ``cos(2 phi)``, ``sin(2 phi)``
reduced shear   ``g1``, ``g2``: ``(a - b) / (a + b)`` times ``cos(2 phi)``, ``sin(2 phi)``
==============  ======================================================================

>>> import numpy as np
>>> from psfield import metrics
>>> y, x = np.mgrid[-12:13, -12:13]
>>> fit = metrics.fit_gaussian(np.exp(-0.5 * (x**2 / 4 + y**2 / 9)))
>>> round(fit.fwhm_minor / fit.fwhm_major, 6), round(fit.angle / np.pi, 3)
(0.666667, 0.5)
"""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._arrays import doubles, points, reals, stack
from psfield._choices import boolean, integer, integer_or_none, real
from psfield._html import FieldsAsTable

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
class GaussianFit(FieldsAsTable):
    """A Gaussian fitted by least squares. `fit_gaussian` returns it.

    Attributes
    ----------
    flux, amplitude : float
        Integral and peak of the Gaussian.
    x, y : float
        Centroid.
    fwhm, fwhm_major, fwhm_minor : float
        Full widths at half maximum: the geometric mean of both axes, and the width along each axis.
    angle : float
        Angle of the major axis.
    eccentricity : float
        ``sqrt(1 - b**2 / a**2)``. `ellipticity` is its former name.
    background : float or None
        Constant background, if it was fitted.
    residual_rms : float
        Root mean square of the residuals.

    Examples
    --------
    >>> import numpy as np
    >>> from psfield import metrics
    >>> y, x = np.mgrid[-8:9, -8:9]
    >>> fit = metrics.fit_gaussian(5 * np.exp(-(x**2 + y**2) / 8))
    >>> round(fit.amplitude, 6), round(fit.fwhm, 4), round(fit.x, 6)
    (5.0, 4.7096, 8.0)
    """

    flux: float
    amplitude: float
    x: float
    y: float
    fwhm: float
    fwhm_major: float
    fwhm_minor: float
    angle: float
    eccentricity: float
    background: float | None
    residual_rms: float

    @property
    def ellipticity(self) -> float:
        """The former name of `eccentricity`.

        Examples
        --------
        >>> import warnings
        >>> from psfield import metrics
        >>> fit = metrics.fit_gaussian([[0, 1, 0], [1, 4, 1], [0, 1, 0]])
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     fit.ellipticity == fit.eccentricity
        True
        """
        warnings.warn(
            "GaussianFit.ellipticity is now called eccentricity", DeprecationWarning, stacklevel=2
        )
        return self.eccentricity


class _Distortion:
    """Moments that have a distortion."""

    e1: float
    e2: float

    @property
    def ellipticity(self) -> float:
        """Size of the distortion, ``|e1 + i e2|``.

        Examples
        --------
        >>> import numpy as np
        >>> from psfield import metrics
        >>> y, x = np.mgrid[-12:13, -12:13]
        >>> stamp = np.exp(-(x**2 / 18 + y**2 / 8))
        >>> round(metrics.adaptive_moments(stamp).ellipticity, 3)
        0.385
        >>> round(metrics.quadrupole_moments(stamp).ellipticity, 3)
        0.384
        """
        return math.hypot(self.e1, self.e2)


@dataclass(frozen=True)
class AdaptiveMoments(_Distortion, FieldsAsTable):
    """Second moments with a Gaussian weight that is fitted to the light.

    The weight has the size and shape of the light (Hirata and Seljak 2003). `adaptive_moments`
    returns them.

    Attributes
    ----------
    amplitude : float
        Amplitude of the fitted Gaussian.
    x, y : float
        Centroid.
    sigma : float
        ``det(moments)**(1/4)``, as GalSim's ``moments_sigma``.
    e1, e2 : float
        Distortion.
    ellipticity : float
        Size of the distortion, ``|e1 + i e2|``.
    g1, g2 : float
        Reduced shear.

    Examples
    --------
    >>> import numpy as np
    >>> from psfield import metrics
    >>> y, x = np.mgrid[-12:13, -12:13]
    >>> moments = metrics.adaptive_moments(np.exp(-(x**2 / 18 + y**2 / 8)))
    >>> round(moments.sigma**2, 3), round(moments.e1, 3), round(moments.g1, 3)
    (6.0, 0.385, 0.2)
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
class QuadrupoleMoments(_Distortion, FieldsAsTable):
    """Second moments without a weight. `quadrupole_moments` returns them.

    Attributes
    ----------
    flux : float
        Sum of the pixels.
    x, y : float
        Centroid.
    sigma : float
        ``det(moments)**(1/4)``.
    e1, e2 : float
        Distortion.
    ellipticity : float
        Size of the distortion, ``|e1 + i e2|``.
    g1, g2 : float
        Reduced shear.

    Examples
    --------
    >>> from psfield import metrics
    >>> moments = metrics.quadrupole_moments([[0, 1, 0], [2, 4, 2], [0, 1, 0]])
    >>> moments.flux, moments.x, moments.y, round(moments.e1, 3)
    (10.0, 1.0, 1.0, 0.333)
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
class Comparison(FieldsAsTable):
    """The errors of a result against a reference. `compare` returns them.

    Undefined values, such as ``snr_db`` without any error, are None.

    Attributes
    ----------
    mae, mse, max_abs : float
        Mean absolute, mean squared and largest absolute error.
    max_abs_index : tuple of int
        Index of the largest error.
    relative_l2 : float or None
        ``norm(result - reference) / norm(reference)``.
    max_over_peak : float or None
        Largest error, divided by the peak of the reference.
    mae_over_mean : float or None
        Mean absolute error, divided by the mean of the reference.
    snr_db : float or None
        ``-20 log10(relative_l2)``.

    Examples
    --------
    >>> from psfield import metrics
    >>> errors = metrics.compare([3.0, 4.5], [3.0, 4.0])
    >>> errors.max_abs, errors.max_abs_index, errors.relative_l2, errors.max_over_peak
    (0.5, (1,), 0.1, 0.125)
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
        Use only a window of ``size`` by ``size`` pixels, about index ``n // 2`` or ``about``.
    about : (int, int), optional
        Column and row of the middle of the window. It needs ``size``.
    background : bool
        Also fit a constant background.
    round : bool
        Fit a circular Gaussian instead of an elliptical one.

    Returns
    -------
    GaussianFit

    Raises
    ------
    ValueError
        The stamp cannot be measured. The text says why.

    Examples
    --------
    >>> import numpy as np
    >>> from psfield import metrics
    >>> y, x = np.mgrid[-8:9, -8:9]
    >>> fit = metrics.fit_gaussian(np.exp(-(x**2 + y**2) / 8) + 0.5, background=True)
    >>> round(fit.background, 6), round(fit.fwhm, 4)
    (0.5, 4.7096)
    """
    values = doubles(stamp, "stamp", "[y, x]")
    window = _window(size, about)
    background, circular = boolean(background, "background"), boolean(round, "round")
    return GaussianFit(**_native.fit_gaussian(values, *window, background, circular))


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
        Initial centroid x, y and sigma.

    Returns
    -------
    AdaptiveMoments

    Raises
    ------
    ValueError
        The stamp cannot be measured. The text says why.

    Examples
    --------
    >>> import numpy as np
    >>> from psfield import metrics
    >>> y, x = np.mgrid[-8:9, -8:9]
    >>> round(metrics.adaptive_moments(np.exp(-(x**2 + y**2) / 8)).sigma, 3)
    2.0
    """
    values = doubles(stamp, "stamp", "[y, x]")
    found = _native.adaptive_moments(values, *_window(size, about), _start(start))
    return AdaptiveMoments(**found)


def quadrupole_moments(
    stamp: Any, *, size: int | None = None, about: tuple[int, int] | None = None
) -> QuadrupoleMoments:
    """Measure the second moments of a stamp without a weight.

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
        The stamp cannot be measured. The text says why.

    Examples
    --------
    >>> from psfield import metrics
    >>> moments = metrics.quadrupole_moments([[0, 1, 0], [1, 4, 1], [0, 1, 0]])
    >>> moments.flux, moments.sigma
    (8.0, 0.5)
    """
    values = doubles(stamp, "stamp", "[y, x]")
    return QuadrupoleMoments(**_native.quadrupole_moments(values, *_window(size, about)))


def compare(result: Any, reference: Any) -> Comparison:
    """Compare a result with a reference.

    Parameters
    ----------
    result, reference : array_like
        Finite arrays of the same shape.

    Returns
    -------
    Comparison

    Examples
    --------
    >>> from psfield import metrics
    >>> metrics.compare([[1.0, 2.0]], [[1.0, 4.0]]).mae
    1.0
    """
    found = _native.compare(reals(result, "result"), reals(reference, "reference"))
    return Comparison(**{**found, "max_abs_index": tuple(found["max_abs_index"])})


def measure(
    images: Any, positions: Any = None, *, size: int | None = None, background: bool = False
) -> dict[str, NDArray[Any]]:
    """Measure sizes and shapes of many PSFs: the stamps of a stack, or the stars of an image.

    Parameters
    ----------
    images : array_like
        Stamps ``[stamp, y, x]`` or a single stamp ``[y, x]``. With ``positions``: an image
        ``[y, x]``.
    positions : array_like or table, optional
        Positions of the stars: ``[star, 2]``, x and y, or a table with columns x and y.
    size : int, optional
        Rows and columns of the window about the middle of a stamp or about a star. By default the
        whole stamp, or 15 pixels about a star.
    background : bool
        Also fit a constant background.

    Returns
    -------
    dict of str to numpy.ndarray
        A column for each value. From the Gaussian fit: ``flux``, ``x_centroid``, ``y_centroid``,
        ``fwhm_px``, ``fwhm_major_px``, ``fwhm_minor_px``, ``angle_rad``, ``eccentricity``. From the
        adaptive moments: ``e1``, ``e2``, ``g1``, ``g2``, ``sigma_px``, ``ellipticity``. Lengths are
        in pixels of the arrays: divide lengths of oversampled stamps by the oversampling. Values
        that could not be measured are NaN, and ``note`` says why. The dict can be given to
        `astropy.table.Table`.

    Examples
    --------
    >>> import numpy as np
    >>> from psfield import metrics
    >>> y, x = np.mgrid[-8:9, -8:9]
    >>> stamps = [np.exp(-(x**2 + y**2) / (2 * sigma**2)) for sigma in (1.5, 2.0)]
    >>> metrics.measure(stamps)["fwhm_px"].round(3).tolist()
    [3.532, 4.71]
    """
    size, background = integer_or_none(size, "size", 1), boolean(background, "background")
    if positions is None:
        stamps = stack(images, "images", "[stamp, y, x]")
        encoded = _native.measure_stamps(stamps, size, background)
    else:
        image = doubles(images, "images", "[y, x]")
        encoded = _native.measure_image(image, *points(positions), size, background)
    rows = json.loads(encoded)
    names = [name for name in rows[0] if name not in ("x", "y", "note")] if rows else []
    columns: dict[str, NDArray[Any]] = {
        # A value that could not be measured is None, and becomes NaN.
        name: np.array([row[name] for row in rows], dtype=np.float64)
        for name in names
    }
    columns["note"] = np.array([row["note"] for row in rows], dtype=np.str_)
    return columns


def _window(
    size: int | None, about: tuple[int, int] | None
) -> tuple[int | None, tuple[int, int] | None]:
    """Return the window to measure: its size, and column and row of its middle."""
    if about is None:
        return integer_or_none(size, "size"), None
    if size is None:
        raise ValueError("about is the middle of a window: give its size too")
    try:
        column, row = about
    except (TypeError, ValueError):
        raise TypeError(f"about must be (column, row), two integers, got {about!r}") from None
    return integer(size, "size"), (integer(column, "about: column"), integer(row, "about: row"))


def _start(start: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
    """Return the initial values of adaptive moments."""
    if start is None:
        return None
    try:
        x, y, sigma = start
    except (TypeError, ValueError):
        raise TypeError(f"start must be three numbers (x, y, sigma), got {start!r}") from None
    if not real(sigma, "start: sigma") > 0:
        raise ValueError(f"start: sigma must be above 0, got {sigma}")
    return real(x, "start: x"), real(y, "start: y"), float(sigma)

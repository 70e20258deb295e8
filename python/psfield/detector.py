"""What a detector makes of an image: sky, photon noise, response, dark current, bad pixels, full well, read noise, gain, digits.

>>> import numpy as np
>>> from psfield.detector import Detector
>>> ccd = Detector(photon_noise=True, sky_e=100.0, read_noise_e=5.0, gain_e_per_adu=2.0, bits=16)
>>> exposure = ccd.expose(np.zeros((100, 200), np.float32), seed=42)
>>> abs(float(exposure.counts.mean()) - 50.0) < 0.5  # 100 electrons at 2 electrons per ADU
True
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._arrays import DTYPES, doubles, numbers, plain
from psfield._choices import whole

__all__ = ["BAD_COLUMN", "DEAD", "HOT", "SATURATED", "Detector", "Exposure"]

#: Flags of a pixel: it never holds charge.
DEAD = 1
#: It has a dark current of its own.
HOT = 2
#: Its column holds no charge.
BAD_COLUMN = 4
#: It is at its full well or at the upper end of the converter.
SATURATED = 8


@dataclass(frozen=True)
class Exposure:
    """An image as a detector counted it.

    Attributes
    ----------
    counts : numpy.ndarray
        ``[y, x]``, in ADU where the detector has a gain, a bias or bits, else in electrons.
    flags : numpy.ndarray
        ``[y, x]``, sums of `DEAD`, `HOT`, `BAD_COLUMN` and `SATURATED`.
    report : dict
        Counts of pixels: ``saturated_pixels``, ``below_zero_pixels``, ``negative_pixels``, ``bad_pixels`` and others.
    """

    counts: NDArray[Any]
    flags: NDArray[np.uint8]
    report: dict[str, Any]


class Detector:
    """The whole chain from light to counts. Every step is off unless it is asked for.

    Parameters
    ----------
    **params
        The keys of the command line's TOML file: ``name``, ``electrons_per_flux`` (1), ``exposure_s``, ``photon_noise`` (False), ``sky_e``
        (electrons a pixel), ``sky_gradient_e_per_px`` (a dict of ``x`` and ``y``), ``dark_e_per_s``, ``response_rms``, ``full_well_e``,
        ``read_noise_e``, ``gain_e_per_adu``, ``bias_adu``, ``bits``, ``pattern_seed``, ``bad_pixels`` (a dict of ``dead_fraction``,
        ``hot_fraction``, ``hot_dark_e_per_s``, ``bad_column_fraction``).

    Raises
    ------
    ValueError
        A key that is not known, or a value out of range.

    Notes
    -----
    Noise comes from ChaCha8 streams, one for each row and step: it depends on the image and the seed alone. ``pattern_seed`` belongs to the
    sensor: exposures with different seeds share its response and bad pixels.
    """

    __slots__ = ("_handle",)

    def __init__(self, **params: Any) -> None:
        given = {key: value for key, value in params.items() if value is not None}
        for key, value in given.items():
            if isinstance(value, (float, np.floating)) and not np.isfinite(value):
                raise ValueError(f"the detector: {key} must be finite, got {value}")
        try:
            text = json.dumps(given, default=_number)
        except TypeError as error:
            raise TypeError(f"the detector: {error}") from None
        self._handle = _native.Detector(text)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Detector:
        """Read a detector from a TOML file, as ``psfield simulate --detector`` does.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Detector
        """
        detector = cls.__new__(cls)
        detector._handle = _native.Detector.from_toml(os.fspath(path))
        return detector

    @property
    def params(self) -> dict[str, Any]:
        """All parameters by key."""
        params: dict[str, Any] = json.loads(self._handle.params())
        return params

    @property
    def unit(self) -> str:
        """The unit of counts: 'electron' or 'adu'."""
        return self._handle.unit()

    @property
    def saturation(self) -> float | None:
        """The level of saturated pixels, if there is one."""
        return self._handle.saturation()

    def expose(self, image: Any, seed: int, *, bad_pixels: Any = None) -> Exposure:
        """Expose an image.

        Parameters
        ----------
        image : array_like
            Light ``[y, x]``, finite; single precision stays single precision.
        seed : int
            Of the noise.
        bad_pixels : array_like, optional
            Flags of bad pixels beside those that the detector draws, ``[y, x]``.

        Returns
        -------
        Exposure
        """
        dtype = DTYPES["f32" if plain(image, "image").dtype == np.float32 else "f64"]
        mask = None if bad_pixels is None else doubles(bad_pixels, "bad_pixels", "[y, x]")
        seed = whole(seed, "seed", 0, 2**64 - 1)
        counts, flags, report = self._handle.expose(numbers(image, "image", dtype, "[y, x]"), seed, mask)
        return Exposure(counts, flags, json.loads(report))

    def __repr__(self) -> str:
        perfect = _native.Detector("{}")
        usual = json.loads(perfect.params())
        given = ", ".join(f"{key}={value!r}" for key, value in self.params.items() if usual.get(key) != value)
        return f"Detector({given})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (self.params,)


def _again(params: dict[str, Any]) -> Detector:
    """Make a pickled detector again."""
    return Detector(**params)


def _number(value: Any) -> Any:
    """Return a NumPy number as a plain one."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} is neither a number nor a text")

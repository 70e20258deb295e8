"""A detector, which converts the light of an image to counts in several steps.

The steps, in this order, are sky, response, dark current, bad pixels, photon noise, full well, read
noise, gain with bias, and digitisation.

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
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._arrays import DTYPES, doubles, numbers, plain
from psfield._choices import integer
from psfield._defaults import DETECTOR
from psfield._reports import ExposureReport

__all__ = ["BAD_COLUMN", "DEAD", "HOT", "SATURATED", "Detector", "Exposure", "ExposureReport"]

#: Flag of a pixel that never holds charge.
DEAD = 1
#: Flag of a pixel with an additional dark current.
HOT = 2
#: Flag of a pixel in a column that holds no charge.
BAD_COLUMN = 4
#: Flag of a pixel at its full well or at the largest value of the converter.
SATURATED = 8


@dataclass(frozen=True)
class Exposure:
    """The counts of a detector. `Detector.expose` returns them.

    Attributes
    ----------
    counts : numpy.ndarray
        ``[y, x]``, in ADU if the detector has a gain, a bias or bits, else in electrons.
    flags : numpy.ndarray
        ``[y, x]``, sums of `DEAD`, `HOT`, `BAD_COLUMN` and `SATURATED`.
    report : ExposureReport
        Numbers of pixels: saturated, below zero, bad and others.

    Examples
    --------
    >>> from psfield.detector import SATURATED, Detector
    >>> exposure = Detector(full_well_e=50.0).expose([[1.0, 60.0]], seed=1)
    >>> exposure.counts.tolist(), (exposure.flags == SATURATED).tolist()
    ([[1.0, 50.0]], [[False, True]])
    >>> exposure.report.saturated_pixels
    1
    """

    counts: NDArray[Any]
    flags: NDArray[np.uint8]
    report: ExposureReport


class Detector:
    """A detector, which converts light to counts in several steps. By default every step is off.

    Parameters
    ----------
    name : str
        Name of the detector, for human readers.
    electrons_per_flux : float
        Electrons that one unit of the image's flux gives in the exposure.
    exposure_s : float, optional
        Exposure time in seconds. It scales the dark current, not the light.
    photon_noise : bool
        If true, the charge is Poisson distributed about its expected value.
    sky_e : float
        Sky in electrons per pixel, in the exposure, at the middle of the frame.
    sky_gradient_e_per_px : mapping, optional
        Change of the sky in electrons from pixel to pixel, with the keys ``x`` and ``y``.
    dark_e_per_s : float
        Dark current in electrons per pixel and second. A value above 0 needs ``exposure_s``.
    response_rms : float
        Standard deviation of the pixels' response to light. The mean response is 1.
    full_well_e : float, optional
        Largest charge of a pixel in electrons.
    read_noise_e : float
        Standard deviation of the read noise in electrons.
    gain_e_per_adu : float, optional
        Electrons per ADU.
    bias_adu : float, optional
        Count of a pixel without charge, in ADU.
    bits : int, optional
        Bits of the converter. Counts are then integers from 0 to ``2**bits - 1``.
    pattern_seed : int
        Seed of the response and the bad pixels.
    bad_pixels : mapping
        Bad pixels, with the keys ``dead_fraction``, ``hot_fraction``, ``hot_dark_e_per_s`` and
        ``bad_column_fraction``.

    Raises
    ------
    ValueError
        A value is out of range.

    Notes
    -----
    The noise comes from ChaCha8 streams, one for each row and step. It depends only on the image,
    the parameters and the seed. ``pattern_seed`` determines the response and the bad pixels of the
    sensor, which exposures with different seeds share.

    Examples
    --------
    >>> from psfield.detector import Detector
    >>> ccd = Detector(sky_e=20.0, gain_e_per_adu=2.0, bits=8)
    >>> ccd
    Detector(sky_e=20.0, gain_e_per_adu=2.0, bits=8)
    >>> ccd.expose([[0.0, 80.0, 1000.0]], seed=1).counts.tolist()
    [[10.0, 50.0, 255.0]]
    """

    __slots__ = ("_handle",)

    def __init__(
        self,
        *,
        name: str = DETECTOR.name,
        electrons_per_flux: float = DETECTOR.electrons_per_flux,
        exposure_s: float | None = DETECTOR.exposure_s,
        photon_noise: bool = DETECTOR.photon_noise,
        sky_e: float = DETECTOR.sky_e,
        sky_gradient_e_per_px: Mapping[str, float] | None = DETECTOR.sky_gradient_e_per_px,
        dark_e_per_s: float = DETECTOR.dark_e_per_s,
        response_rms: float = DETECTOR.response_rms,
        full_well_e: float | None = DETECTOR.full_well_e,
        read_noise_e: float = DETECTOR.read_noise_e,
        gain_e_per_adu: float | None = DETECTOR.gain_e_per_adu,
        bias_adu: float | None = DETECTOR.bias_adu,
        bits: int | None = DETECTOR.bits,
        pattern_seed: int = DETECTOR.pattern_seed,
        bad_pixels: Mapping[str, float] = DETECTOR.bad_pixels,
    ) -> None:
        given = {name: value for name, value in locals().items() if name in DETECTOR._fields}
        self._handle = _native.Detector(given)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Detector:
        r"""Read a detector from a TOML file, the format that the command line reads.

        Parameters
        ----------
        path : path
            The file. Its keys are the parameters of `Detector`.

        Returns
        -------
        Detector

        Examples
        --------
        >>> import pathlib
        >>> from psfield.detector import Detector
        >>> _ = pathlib.Path("ccd.toml").write_text("read_noise_e = 3.0\nbits = 16\n")
        >>> Detector.from_toml("ccd.toml")
        Detector(read_noise_e=3.0, bits=16)
        """
        detector = cls.__new__(cls)
        detector._handle = _native.Detector.from_toml(os.fspath(path))
        return detector

    @property
    def params(self) -> dict[str, Any]:
        """All parameters by name.

        Examples
        --------
        >>> from psfield.detector import Detector
        >>> params = Detector(read_noise_e=3.0).params
        >>> params["read_noise_e"], params["sky_e"]
        (3.0, 0.0)
        """
        params: dict[str, Any] = json.loads(self._handle.params())
        return params

    @property
    def unit(self) -> str:
        """Unit of the counts: 'electron' or 'adu'.

        Examples
        --------
        >>> from psfield.detector import Detector
        >>> Detector().unit, Detector(gain_e_per_adu=2.0).unit
        ('electron', 'adu')
        """
        return self._handle.unit()

    @property
    def noise(self) -> float:
        """Noise of a dark pixel, in the unit of the image's flux.

        The standard deviation of sky (at the middle of the frame), dark charge and read noise. Sky
        and dark charge count only with photon noise. A tenth of it is a good ``floor`` for
        `PsfModel.plan`.

        Examples
        --------
        >>> from psfield.detector import Detector
        >>> Detector(photon_noise=True, sky_e=91.0, read_noise_e=3.0, electrons_per_flux=2.0).noise
        5.0
        """
        return self._handle.noise()

    @property
    def saturation(self) -> float | None:
        """Count at which pixels saturate, or None if they do not.

        Examples
        --------
        >>> from psfield.detector import Detector
        >>> Detector(full_well_e=9e4).saturation
        90000.0
        """
        return self._handle.saturation()

    def expose(self, image: Any, seed: int, *, bad_pixels: Any = None) -> Exposure:
        """Expose an image.

        Parameters
        ----------
        image : array_like
            Light ``[y, x]``, finite. Counts have single precision if the image has it, else double.
        seed : int
            Seed of the noise.
        bad_pixels : array_like, optional
            Flags ``[y, x]``: sums of `DEAD`, `HOT` and `BAD_COLUMN`, or 0 for a good pixel. The bad
            pixels that the detector draws at random are added.

        Returns
        -------
        Exposure

        Examples
        --------
        >>> from psfield.detector import DEAD, Detector
        >>> exposure = Detector().expose([[1.0, 2.0]], seed=1, bad_pixels=[[0, DEAD]])
        >>> exposure.counts.tolist(), exposure.flags.tolist()
        ([[1.0, 0.0]], [[0, 1]])
        """
        dtype = DTYPES["f32" if plain(image, "image").dtype == np.float32 else "f64"]
        mask = None if bad_pixels is None else doubles(bad_pixels, "bad_pixels", "[y, x]")
        seed = integer(seed, "seed", 0, 2**64 - 1)
        return exposure_of(
            *self._handle.expose(numbers(image, "image", dtype, "[y, x]"), seed, mask)
        )

    def __repr__(self) -> str:
        defaults = DETECTOR._asdict()
        given = (f"{key}={value!r}" for key, value in self.params.items() if value != defaults[key])
        return f"Detector({', '.join(given)})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (self.params,)


def exposure_of(counts: Any, flags: Any, report: str) -> Exposure:
    """Return an exposure with its report, which is JSON."""
    return Exposure(counts, flags, ExposureReport(**json.loads(report)))


def _again(params: dict[str, Any]) -> Detector:
    """Make a pickled detector again."""
    return Detector(**params)

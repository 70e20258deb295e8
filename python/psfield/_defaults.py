"""Names and defaults of arguments.

They are defined in the Rust library and shared with the command line.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

from psfield import _native


class DetectorDefaults(NamedTuple):
    """The parameters of a perfect detector, by name. None means that a parameter is not set."""

    name: str
    electrons_per_flux: float
    exposure_s: float | None
    photon_noise: bool
    sky_e: float
    sky_gradient_e_per_px: dict[str, float] | None
    dark_e_per_s: float
    response_rms: float
    full_well_e: float | None
    read_noise_e: float
    gain_e_per_adu: float | None
    bias_adu: float | None
    bits: int | None
    pattern_seed: int
    bad_pixels: dict[str, float]


def _perfect_detector() -> DetectorDefaults:
    # The library omits parameters without a value.
    params: dict[str, Any] = dict.fromkeys(DetectorDefaults._fields)
    params |= json.loads(_native.Detector({}).params())
    return DetectorDefaults(**params)


def arguments(
    kind: Literal["plan", "fit", "file", "grid"], given: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the settings of one kind among the arguments of a function, which are its locals."""
    return {name: given[name] for name in _native.DEFAULTS[kind] if name in given}


_KINDS = ("fit", "grid", "others", "plan")
#: The default of each argument.
DEFAULTS = SimpleNamespace(
    **{name: value for kind in _KINDS for name, value in _native.DEFAULTS[kind].items()}
)
DETECTOR = _perfect_detector()

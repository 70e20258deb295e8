"""Defaults of arguments. They are defined in the Rust library and shared with the command line."""

from __future__ import annotations

import json
from typing import Any, Literal, NamedTuple

from psfield import _native


class Defaults(NamedTuple):
    """The default of each argument, by its name."""

    tolerance: float
    tolerance_on: Literal["l2", "aperture"]
    precision: Literal["f32", "f64"]
    device: Literal["auto", "cpu", "gpu"]
    anchor: Literal["source", "output"]
    method: Literal["auto", "lowrank"]
    memory: int | None
    oversample: int
    scene_pixels: Literal["point", "integrated"]
    interpolation: str
    table_error: float
    outside: Literal["nearest", "extend", "error"]
    normalise: Literal["unit", "keep"]
    oversampling: float
    pixel_response_included: bool
    stamp_interpolation: Literal["cubic-spline", "lanczos3"]
    measure: Literal["l2", "l1"]
    threshold: float
    max_draws: int
    seed: int


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
    params |= json.loads(_native.Detector("{}").params())
    return DetectorDefaults(**params)


DEFAULTS = Defaults(**_native.DEFAULTS)
DETECTOR = _perfect_detector()

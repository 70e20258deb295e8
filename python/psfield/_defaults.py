"""The defaults of options: the library's own, which the command line has as well."""

from __future__ import annotations

from typing import Literal, NamedTuple

from psfield import _native


class Defaults(NamedTuple):
    """A default for each option, by its name."""

    tolerance: float
    precision: Literal["f32", "f64"]
    device: Literal["auto", "cpu", "gpu"]
    anchor: Literal["source", "output"]
    method: Literal["auto", "lowrank"]
    memory: int
    oversample: int
    interpolation: str
    outside: Literal["nearest", "extend", "error"]
    normalise: Literal["unit", "keep"]
    oversampling: float
    pixel_response_included: bool
    stamp_interpolation: Literal["cubic-spline", "lanczos3"]
    threshold: float
    start: tuple[int, int]
    max_samples: int


DEFAULTS = Defaults(**_native.DEFAULTS)

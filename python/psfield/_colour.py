"""Light with spectra: bandpasses, spectra, and images by the names of their spectra."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from psfield._arrays import column
from psfield._astropy import in_unit

PathLike: TypeAlias = str | os.PathLike[str]
#: A bandpass or a spectrum as the native module takes it.
Curve: TypeAlias = str | tuple[list[float], list[float]]

#: The arguments of a plan in colour.
COLOUR = frozenset({"bandpass", "sed", "dispersion"})


def curve(given: PathLike | tuple[ArrayLike, ArrayLike], name: str) -> Curve:
    """Return the name of a curve, or its wavelengths and values."""
    if isinstance(given, (str, os.PathLike)):
        return os.fspath(given)
    try:
        wavelengths, values = given
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a name or a pair (wavelengths, values)") from None
    return column(in_unit(wavelengths, "um", name), name).tolist(), column(values, name).tolist()


def checked_colour(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a plan in colour, which may be among others, in plain types."""
    given = {name: settings.get(name) for name in sorted(COLOUR)}
    if given["bandpass"] is None:
        for name in ("sed", "dispersion"):
            if given[name] is not None:
                raise ValueError(f"{name} needs bandpass=, the throughput of the instrument")
        return given
    sed, dispersion = given["sed"], given["dispersion"]
    if sed is not None and not isinstance(sed, (str, os.PathLike)):
        raise TypeError(f"sed must be the name of a spectrum, got {type(sed).__name__}")
    if isinstance(dispersion, Mapping):
        dispersion = ",".join(f"{key}={value}" for key, value in dispersion.items())
    if dispersion is not None and not isinstance(dispersion, str):
        raise TypeError(f"dispersion must be a dict, got {type(dispersion).__name__}")
    return {
        "bandpass": curve(given["bandpass"], "bandpass"),
        "sed": None if sed is None else os.fspath(sed),
        "dispersion": dispersion,
    }


def native_colour(settings: Mapping[str, Any]) -> tuple[Curve, str | None, str | None] | None:
    """Return what the native module takes of checked arguments."""
    bandpass = settings["bandpass"]
    return None if bandpass is None else (bandpass, settings["dispersion"], settings["sed"])


def is_images(scene: Any) -> bool:
    """Return whether a scene is a mapping of images by the names of their spectra.

    A catalogue is a mapping of columns.
    """
    if not isinstance(scene, Mapping):
        return False
    # CCDData has a shape, but no other properties of an array.
    shapes = (getattr(image, "shape", None) for image in scene.values())
    return any(
        len(np.shape(image) if shape is None else shape) >= 2
        for image, shape in zip(scene.values(), shapes, strict=True)
    )


def first_image(scene: Any) -> Any:
    """Return the first image of such a mapping, or any other scene itself."""
    return next(iter(scene.values())) if is_images(scene) else scene

"""Units and headers of astropy, which is never imported for them."""

from __future__ import annotations

from typing import Any

import numpy as np


def unit_of(scene: Any) -> Any:
    """Return the unit of a Quantity or of CCDData, if there is one."""
    unit = getattr(scene, "unit", None)
    check_linear(unit, "scene")
    return unit


def check_linear(unit: Any, name: str) -> None:
    """Refuse magnitudes, decibels and the like: light adds up, they do not."""
    if unit is not None and (hasattr(unit, "physical_unit") or str(unit) in ("mag", "dex", "dB")):
        raise ValueError(f"{name}: its unit is {unit}, which does not add up: give fluxes")


def in_unit(values: Any, unit: Any, name: str) -> Any:
    """Return the numbers of a Quantity in a unit (None: its own); what has no unit, and pure numbers for pixels, as they are."""
    own = getattr(values, "unit", None)
    if own is None or not hasattr(values, "to_value"):
        return values
    if unit is None or (unit == "pix" and str(own) == ""):
        return values.to_value()
    try:
        return values.to_value(unit)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None


def like(scene: Any, image: Any, first: tuple[int, int], oversample: int) -> Any:
    """Return an image with the unit, the header and the world coordinates of its scene.

    ``first`` is the column and the row of the image's first pixel, in its own pixels counted from the first of the scene.
    """
    unit = unit_of(scene)
    if isinstance(scene, np.ndarray) or scene is None or not hasattr(scene, "meta"):
        return image if unit is None else image << unit
    wcs = getattr(scene, "wcs", None)
    ny, nx = image.shape
    if wcs is not None and (scene.shape != (ny, nx) or first != (0, 0)):
        shown = (slice(start * oversample, (start + n) * oversample, oversample) for start, n in ((first[1], ny), (first[0], nx)))
        wcs = wcs.slice(tuple(shown))
    return type(scene)(image, unit=unit, meta=scene.meta.copy(), wcs=wcs)

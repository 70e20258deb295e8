"""Units and headers of astropy, which is never imported for them."""

from __future__ import annotations

from typing import Any

import numpy as np


def unit_of(scene: Any) -> Any:
    """Return the unit of a Quantity or of CCDData, if there is one."""
    return getattr(scene, "unit", None) if hasattr(scene, "unit") else None


def like(scene: Any, image: Any, frame: tuple[int, int, int, int] | None, oversample: int) -> Any:
    """Return an image with the unit, the header and the world coordinates of its scene."""
    unit = unit_of(scene)
    if isinstance(scene, np.ndarray) or scene is None or not hasattr(scene, "meta"):
        return image if unit is None else image << unit
    wcs = getattr(scene, "wcs", None)
    if wcs is not None and (frame is not None or oversample > 1):
        x0, y0, nx, ny = frame or (0, 0, image.shape[1], image.shape[0])
        s = oversample
        wcs = wcs.slice((slice(y0 * s, (y0 + ny) * s, s), slice(x0 * s, (x0 + nx) * s, s)))
    return type(scene)(image, unit=unit, meta=scene.meta.copy(), wcs=wcs)

"""Units and headers of astropy, which is never imported for them."""

from __future__ import annotations

from typing import Any

import numpy as np


def unit_of(scene: Any) -> Any:
    """Return the unit of a Quantity or of CCDData, if there is one."""
    return getattr(scene, "unit", None) if hasattr(scene, "unit") else None


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

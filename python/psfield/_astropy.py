"""Handles units and headers of astropy, and labels of xarray, without an import of either."""

from __future__ import annotations

from typing import Any

import numpy as np

from psfield import _native


def unit_of(scene: Any) -> Any:
    """Return the unit of a Quantity or of CCDData, or None."""
    unit = getattr(scene, "unit", None)
    check_linear(unit, "scene")
    return unit


def check_linear(unit: Any, name: str) -> None:
    """Refuse logarithmic units such as magnitudes, whose values cannot be added."""
    if unit is not None and (hasattr(unit, "physical_unit") or str(unit) in ("mag", "dex", "dB")):
        raise ValueError(f"{name}: its unit is {unit}, which is logarithmic: convert it to flux")


def in_unit(values: Any, unit: Any, name: str) -> Any:
    """Return the numbers of values in ``unit``, or in their own unit if ``unit`` is None.

    Values without a unit, and dimensionless ones, count as values in ``unit``. A mask is kept.
    """
    own = getattr(values, "unit", None)
    if own is None or not hasattr(own, "to"):
        return values
    wanted = own if unit is None or str(own) == "" else unit
    try:
        if hasattr(values, "to_value"):
            return values.to_value(wanted)
        # A column of a Table, whose numbers may be masked.
        factor = own.to(wanted)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None
    plain = np.ma.asarray(values) if np.ma.isMaskedArray(values) else np.asarray(values)
    return plain if factor == 1 else plain * factor


def like(scene: Any, image: Any, first: tuple[int, int], oversample: int) -> Any:
    """Return an image with the unit, header, world coordinates or labels of its scene.

    ``first`` is the column and the row of the first pixel of the image, in pixels of the image
    counted from the first pixel of the scene.
    """
    if hasattr(scene, "dims") and hasattr(scene, "coords"):
        return _labelled(scene, image, first, oversample)
    unit = unit_of(scene)
    if isinstance(scene, np.ndarray) or scene is None or not hasattr(scene, "meta"):
        return image if unit is None else image << unit
    wcs = getattr(scene, "wcs", None)
    if wcs is not None and (scene.shape != image.shape or first != (0, 0)):
        wcs = _wcs_of_image(wcs, image.shape, first, oversample)
    return type(scene)(image, unit=unit, meta=scene.meta.copy(), wcs=wcs)


def _wcs_of_image(wcs: Any, shape: tuple[int, int], first: tuple[int, int], oversample: int) -> Any:
    """Return the world coordinates of an image from those of its scene."""
    if oversample > 1 and getattr(wcs, "sip", None) is not None:
        # The polynomials of SIP count in pixels. A slice of astropy's leaves them as they are.
        from astropy.io import fits

        moved = _native.image_cards(cards_of(wcs), first, oversample)
        return type(wcs)(fits.Header.fromstring(moved, sep=""))
    column, row = first
    shown = (
        slice(start * oversample, (start + n) * oversample, oversample)
        for start, n in zip((row, column), shape, strict=True)
    )
    return wcs.slice(tuple(shown))


def cards_of(wcs: Any) -> str:
    """Return the cards of a header with these world coordinates, 80 characters each."""
    text: str = wcs.to_header(relax=True).tostring(sep="", endcard=False, padding=False)
    return text


def _labelled(scene: Any, image: Any, first: tuple[int, int], oversample: int) -> Any:
    """Return an image as a DataArray of xarray, with the labels of its pixels.

    The coordinate of a pixel is the mean of those of the scene's pixels inside it. Coordinates that
    are not numbers or not along one axis are left out, unless they belong to the whole scene.
    """
    coords: dict[Any, Any] = {}
    for name, labels in scene.coords.items():
        if labels.ndim == 0:
            coords[name] = labels
        elif labels.ndim == 1 and labels.dtype.kind in "fiu":
            axis = scene.dims.index(labels.dims[0])
            start, n = first[1 - axis] * oversample, image.shape[axis] * oversample
            inside = np.asarray(labels)[start : start + n]
            if len(inside) == n:
                of_pixels = inside.reshape(-1, oversample)
                means = inside if oversample == 1 else of_pixels.mean(axis=1)
                coords[name] = (labels.dims, means, labels.attrs)
    return type(scene)(image, coords=coords, dims=scene.dims, name=scene.name, attrs=scene.attrs)

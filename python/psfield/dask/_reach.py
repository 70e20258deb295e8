"""The distance over which a PSF spreads light."""

from __future__ import annotations

import math

from psfield._model import PsfModel

#: Pixels of the scene on the lower and on the upper side of a pixel of the image.
Depth = tuple[int, int]

#: Pixels beyond the edges of a stamp up to which the interpolated PSF may hold light.
BEYOND = 12

#: Pixels of the scene that the filter for integrated light may add to each side of a stamp.
FILTER = 64


def reach(
    model: PsfModel,
    oversample: int,
    stamp_size: int | None,
    *,
    of_stars: bool = False,
    integrated: bool = False,
) -> tuple[Depth, Depth]:
    """Return the distances from which light reaches a pixel, along rows and along columns.

    They are in pixels of the scene, below and above the pixel. A stamp with offsets
    ``-left..right`` brings light to a pixel from ``right`` pixels below it to ``left`` pixels
    above. Even stamps, centred at ``n // 2``, therefore reach less far on one side. One pixel is
    added because the centres of finer scenes are shifted by half a pixel. Stamps that are
    interpolated, as all stamps are for stars, reach farther. So do those for scenes whose light is
    integrated over their pixels.
    """
    (ny, nx), (cx, cy) = model.stamp_shape, model.centre
    finer = model.oversampling / oversample
    interpolated = (
        of_stars
        or not model.pixel_response_included
        or any(value % 1 != 0 for value in (finer, cx, cy))
        or oversample % 2 == 0
    )
    # A shift by half a pixel of the scene is added.
    beyond = BEYOND + math.ceil(finer) if interpolated else 0
    (below, above) = _along(model, ny, cy, oversample, stamp_size, beyond)
    (left, right) = _along(model, nx, cx, oversample, stamp_size, beyond)
    more = FILTER if integrated else 0
    return (below + more, above + more), (left + more, right + more)


def _along(
    model: PsfModel, n: int, centre: float, oversample: int, stamp_size: int | None, beyond: int
) -> Depth:
    """Return the distances along one axis of a stamp of ``n`` pixels."""
    if stamp_size is not None:
        pixels = stamp_size * oversample
        left, right = pixels // 2, pixels - 1 - pixels // 2
    else:
        # The response of a pixel widens a stamp by half a pixel on each side.
        margin = 0 if model.pixel_response_included else math.ceil(model.oversampling / 2)
        margin += beyond
        finer = oversample / model.oversampling
        rooms = (centre, n - 1 - centre)
        left, right = (math.floor(max(room + margin, 0.0) * finer) for room in rooms)
    return right + 1, left + 1

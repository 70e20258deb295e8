"""How far light is spread."""

from __future__ import annotations

import math

from psfield._model import PsfModel

#: Pixels of the scene on the lower and on the upper side of a pixel of the image.
Depth = tuple[int, int]


def reach(model: PsfModel, oversample: int, stamp_size: int | None) -> tuple[Depth, Depth]:
    """Return from how far below and above light reaches a pixel, in pixels of the scene: of rows, and of columns.

    A stamp with offsets ``-left..right`` brings light to a pixel from ``right`` pixels below it to ``left`` pixels above: even stamps,
    centred at ``n // 2``, reach less far to one side. One pixel is added for the half by which the centres of finer scenes are shifted.
    """
    (ny, nx), (cx, cy) = model.stamp_shape, model.centre
    return _along(model, ny, cy, oversample, stamp_size), _along(model, nx, cx, oversample, stamp_size)


def _along(model: PsfModel, n: int, centre: float, oversample: int, stamp_size: int | None) -> Depth:
    if stamp_size is not None:
        pixels = stamp_size * oversample
        left, right = pixels // 2, pixels - 1 - pixels // 2
    else:
        # The response of a pixel widens a stamp by half a pixel on each side.
        margin = 0 if model.pixel_response_included else math.ceil(model.oversampling / 2)
        finer = oversample / model.oversampling
        left, right = (math.floor(max(room + margin, 0.0) * finer) for room in (centre, n - 1 - centre))
    return right + 1, left + 1

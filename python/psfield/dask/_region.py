"""The image of a part of a frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from psfield._arrays import DTYPES, plain
from psfield._model import PsfModel
from psfield._plan import Plan
from psfield.dask._kept import Kept
from psfield.dask._reach import reach

#: x0, y0, nx, ny.
Region = tuple[int, int, int, int]
Columns = dict[str, NDArray[np.float64]]

#: A plan keeps up to its ``memory`` between tasks, so that few are kept: for the next scene with the same chunks.
_PLANS: Kept[Plan] = Kept(4)
#: Plans for the first pixel of a frame. They have the tiles of the whole: their choice is most of what a plan for a region takes.
_TILES: Kept[Plan] = Kept(4)


def region_image(
    model: PsfModel,
    token: str,
    words: dict[str, Any],
    region: Region,
    part: Any,
    origin: tuple[int, int],
    catalog: Columns | None,
) -> NDArray[Any]:
    """Return the image of a region of the frame, as the plan of the whole frame gives it.

    Parameters
    ----------
    model, token
        The PSF, and what tells it from others.
    words
        The arguments of `PsfModel.plan` for the whole scene.
    region
        In pixels of the image, from the frame's first pixel.
    part, origin
        The light that reaches the region, and the column and the row of the scene at which it begins.
    catalog
        Columns of the whole catalogue.
    """
    _, _, nx, ny = region
    light = plain(part, "scene")
    sources = None if catalog is None else _near(catalog, region, model, words)
    if sources is None and not np.any(light):
        return np.zeros((ny, nx), DTYPES[words["precision"]])
    plan = _plan(model, token, words, region)
    image: NDArray[Any] = plan.simulate(_reaching(light, origin, plan.light_region), sources)
    return image


def _plan(model: PsfModel, token: str, words: dict[str, Any], region: Region) -> Plan:
    """Return the plan for a region of the frame."""
    whole = (token, tuple(sorted(words.items())))

    def tiles() -> Plan:
        return model.plan(**words, region=(0, 0, 1, 1))

    return _PLANS.get((whole, region), lambda: _TILES.get(whole, tiles).for_region(region))


def _reaching(light: NDArray[Any], origin: tuple[int, int], region: Region) -> NDArray[Any]:
    """Return the part of the light that a plan asks for, in pixels of the scene."""
    (x, y), (x0, y0, nx, ny) = origin, region
    first_row, first_column = y0 - y, x0 - x
    part = light[max(first_row, 0) : first_row + ny, max(first_column, 0) : first_column + nx]
    if part.shape != (ny, nx):
        # It would be dark where there is light.
        raise RuntimeError(f"light from {region} reaches the image, and there is that from {(x, y, *light.shape[::-1])} alone")
    return part


def _near(catalog: Columns, region: Region, model: PsfModel, words: dict[str, Any]) -> Columns | None:
    """Return the stars that can reach a region, and every galaxy, whose wings end nowhere in particular; None where there are none."""
    x0, y0, nx, ny = region
    (below, above), (left, right) = reach(model, 1, words["stamp_size"])
    # A star between pixels lies up to one further off than the pixel that it is drawn around.
    x, y = catalog["x"], catalog["y"]
    near = (x > x0 - left - 2) & (x < x0 + nx + right + 1) & (y > y0 - below - 2) & (y < y0 + ny + above + 1)
    # What is no position at all is refused by the plan.
    near |= ~(np.isfinite(x) & np.isfinite(y))
    if "re" in catalog:
        near |= catalog["re"] > 0
    return {name: column[near] for name, column in catalog.items()} if near.any() else None

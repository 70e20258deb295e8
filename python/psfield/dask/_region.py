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
    x0, y0, nx, ny = region
    light = plain(part, "scene")
    sources = None if catalog is None else _near(catalog, region, model, words)
    if sources is None and not np.any(light):
        return np.zeros((ny, nx), DTYPES[words["precision"]])
    whole = tuple(sorted(words.items()))
    plan = _PLANS.get((token, whole), lambda: model.plan(**words))
    scene = np.zeros(plan.shape, plan.dtype)
    x, y = origin
    with np.errstate(over="ignore"):
        scene[y : y + light.shape[0], x : x + light.shape[1]] = light
    image: NDArray[Any] = plan.simulate(scene, sources)
    return np.ascontiguousarray(image[y0 : y0 + ny, x0 : x0 + nx])


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

"""The image of a region of a frame."""

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

#: Plans for the next scene with these chunks. They are few: each may keep ``memory`` bytes.
_PLANS: Kept[Plan] = Kept(4)
#: Plans for the first pixel of a frame. Their tiles are those of the whole frame. Choosing tiles is
#: most of the work of making a plan for a region.
_TILES: Kept[Plan] = Kept(4)


def region_image(
    model: PsfModel,
    token: str,
    settings: dict[str, Any],
    region: Region,
    part: Any,
    origin: tuple[int, int],
    catalog: Columns | None,
) -> NDArray[Any]:
    """Return the image of a region, which equals that part of the image of the whole frame.

    Parameters
    ----------
    model, token
        The PSF, and a token that identifies it.
    settings
        The arguments of `PsfModel.plan` for the whole scene.
    region
        In pixels of the image, from the first pixel of the frame.
    part, origin
        The light that reaches the region, and the column and row of the scene where it starts.
    catalog
        Columns of the whole catalogue.
    """
    _, _, nx, ny = region
    light = plain(part, "scene")
    sources = None if catalog is None else _near(catalog, region, model, settings)
    if sources is None and not np.any(light):
        return np.zeros((ny, nx), DTYPES[settings["precision"]])
    plan = _plan(model, token, settings, region)
    image: NDArray[Any] = plan.simulate(_reaching(light, origin, plan.light_region), sources)
    return image


def _plan(model: PsfModel, token: str, settings: dict[str, Any], region: Region) -> Plan:
    """Return the plan for a region of the frame."""
    whole = (token, tuple(sorted(settings.items())))

    def tiles() -> Plan:
        return model.plan(**settings, region=(0, 0, 1, 1))

    return _PLANS.get((whole, region), lambda: _TILES.get(whole, tiles).for_region(region))


def _reaching(light: NDArray[Any], origin: tuple[int, int], region: Region) -> NDArray[Any]:
    """Return the part of the light within a region of the scene."""
    (x, y), (x0, y0, nx, ny) = origin, region
    first_row, first_column = y0 - y, x0 - x
    part = light[max(first_row, 0) : first_row + ny, max(first_column, 0) : first_column + nx]
    if part.shape != (ny, nx):
        # Without the missing light, the image would be too faint.
        given = (x, y, *light.shape[::-1])
        raise RuntimeError(f"the image needs the light of {region}, but only {given} is given")
    return part


def _near(
    catalog: Columns, region: Region, model: PsfModel, settings: dict[str, Any]
) -> Columns | None:
    """Return the stars that can reach a region, and all galaxies.

    The plan leaves out galaxies whose light does not reach the region. None if there are no such
    sources.
    """
    x0, y0, nx, ny = region
    (below, above), (left, right) = reach(model, 1, settings["stamp_size"], of_stars=True)
    # A star between pixels is up to one pixel away from the pixel about which it is drawn.
    x, y = catalog["x"], catalog["y"]
    near = (x > x0 - left - 2) & (x < x0 + nx + right + 1)
    near &= (y > y0 - below - 2) & (y < y0 + ny + above + 1)
    # Invalid sources are kept, so that the plan refuses them.
    near |= ~(np.isfinite(x) & np.isfinite(y) & np.isfinite(catalog["flux"]))
    near |= catalog["flux"] == 0
    if "re" in catalog:
        near |= catalog["re"] != 0
    return {name: column[near] for name, column in catalog.items()} if near.any() else None

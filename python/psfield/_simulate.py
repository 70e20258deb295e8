"""Simulations in one call, and an example to begin with."""

from __future__ import annotations

from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from psfield._arrays import plain, shape_of
from psfield._catalog import is_path
from psfield._colour import COLOUR, first_image, is_images
from psfield._defaults import arguments
from psfield._model import PsfModel
from psfield._plan import Labelled, is_stack
from psfield._tables import column_names


@overload
def simulate(
    scene: Labelled,
    model: PsfModel,
    catalog: Any = None,
    *,
    wcs: Any = None,
    shape: tuple[int, int] | None = None,
    **settings: Any,
) -> Labelled: ...
@overload
def simulate(
    scene: Any,
    model: PsfModel,
    catalog: Any = None,
    *,
    wcs: Any = None,
    shape: tuple[int, int] | None = None,
    **settings: Any,
) -> NDArray[Any]: ...
def simulate(
    scene: Any,
    model: PsfModel,
    catalog: Any = None,
    *,
    wcs: Any = None,
    shape: tuple[int, int] | None = None,
    **settings: Any,
) -> Any:
    """Return the image of a scene through a PSF, in one call.

    This is ``model.plan(...).simulate(scene, catalog)``. For many scenes of one shape, make the
    plan once.

    Parameters
    ----------
    scene : array_like, table, path or None
        An image ``[y, x]``, images by the names of their spectra, or a catalogue of stars and
        galaxies. All as for `Plan.simulate`.
    model : PsfModel
        The PSF.
    catalog : table or path, optional
        Stars and galaxies, if ``scene`` is an image.
    wcs : astropy.wcs.WCS, optional
        World coordinates of the image, for positions on the sky, as for `Plan.simulate`.
    shape : (int, int), optional
        Rows and columns of the image, if ``scene`` is a catalogue. Default: ``model.field_shape``.
    **settings
        Arguments of `PsfModel.plan`, such as ``tolerance``, ``precision``, ``oversample``.

    Returns
    -------
    numpy.ndarray, Quantity, CCDData or DataArray
        The image, as from `Plan.simulate`.

    Examples
    --------
    >>> import psfield
    >>> catalog, model = psfield.example((120, 160))
    >>> psfield.simulate(catalog, model, tolerance=1e-3).shape
    (120, 160)
    """
    if not isinstance(model, PsfModel):
        raise TypeError(
            f"model must be a PsfModel, got {type(model).__name__}: psfield.simulate(scene, model)"
        )
    if unknown := sorted(set(settings) - {*arguments("plan", settings), *COLOUR, "precision"}):
        raise TypeError(
            f"simulate() has no argument {unknown[0]!r}: it takes the arguments of PsfModel.plan."
            " For columns and magnitudes of a file of sources, see psfield.read_catalog"
        )
    is_table = column_names(scene) is not None and not is_images(scene)
    if scene is not None and (is_path(scene) or is_table):
        if catalog is not None:
            raise TypeError("scene and catalog are both catalogues: join them")
        scene, catalog = None, scene
    if scene is not None:
        if shape is not None:
            raise TypeError("shape is that of the scene's image: leave it out")
        first = scene[0] if is_stack(scene) else first_image(scene)
        scene_shape = plain(first, "scene").shape[-2:]
    else:
        shape = model.field_shape if shape is None else shape
        if shape is None:
            raise ValueError("shape: give rows and columns, because the model has no field_shape")
        finer = settings.get("oversample", 1)
        scene_shape = tuple(n * finer for n in shape_of(shape, "shape"))
    plan = model.plan(scene_shape, **settings)
    return plan._image_of(scene, catalog, None, wcs, None)


def example(shape: tuple[int, int] = (512, 768)) -> tuple[dict[str, Any], PsfModel]:
    """Return a catalogue of stars and galaxies, and the PSF of a telescope, to try psfield.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the frame.

    Returns
    -------
    catalog : dict of numpy.ndarray
        Invented stars and galaxies, in the columns of `Plan.simulate`. Always the same ones for one
        shape.
    model : PsfModel
        The PSF of the built-in telescope ``'survey-2m'`` over the frame.

    Examples
    --------
    >>> import psfield
    >>> catalog, model = psfield.example((120, 160))
    >>> sorted(catalog), model.field_shape
    (['angle', 'flux', 'n', 'q', 're', 'x', 'y'], (120, 160))
    """
    ny, nx = shape_of(shape, "shape")
    rng = np.random.default_rng(1)
    area = nx * ny
    stars, galaxies = max(1, area // 1500), max(1, area // 4000)
    count = stars + galaxies
    # The number of sources above a flux falls as flux**-1.2.
    flux = np.minimum(300 * rng.pareto(1.2, count) + 300, 3e5)
    re = np.concatenate([np.zeros(stars), 1.5 + rng.gamma(2.0, 1.5, galaxies)])
    catalog = {
        "x": rng.uniform(0, nx - 1, count),
        "y": rng.uniform(0, ny - 1, count),
        "flux": np.where(re > 0, flux * re, flux),
        "re": re,
        "n": rng.choice([1.0, 1.0, 1.5, 2.5, 4.0], count),
        "q": rng.uniform(0.3, 1.0, count),
        "angle": rng.uniform(0, 180, count),
    }
    model = PsfModel.from_telescope(
        "survey-2m", field_shape=(ny, nx), samples=(7, 7), stamp_size=48, oversampling=4
    )
    return catalog, model

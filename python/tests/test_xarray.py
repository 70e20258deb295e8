"""Scenes and images with the labels of xarray."""

from __future__ import annotations

import numpy as np
import pytest

xarray = pytest.importorskip("xarray")


def labelled(pixels):
    """Return a scene with coordinates along both axes, a number, and names of rows."""
    ny, nx = pixels.shape
    coords = {
        "y": ("y", np.arange(ny) * 0.5, {"units": "arcsec"}),
        "x": ("x", np.arange(nx) * 0.25 - 3.0),
        "band": "r",
        "row": ("y", [f"row {i}" for i in range(ny)]),
    }
    return xarray.DataArray(pixels, coords, ("y", "x"), name="sky", attrs={"units": "electron"})


def test_an_image_has_the_labels_of_its_scene(model, scene):
    plan = model.plan(scene.shape, 1e-3)
    image = plan.simulate(labelled(scene))
    assert isinstance(image, xarray.DataArray)
    np.testing.assert_array_equal(image.values, plan.simulate(scene))
    assert (image.name, image.dims, image.attrs) == ("sky", ("y", "x"), {"units": "electron"})
    assert image.y.attrs == {"units": "arcsec"} and image.band == "r" and "row" not in image.coords
    np.testing.assert_array_equal(image.x, np.arange(scene.shape[1]) * 0.25 - 3.0)


def test_parts_and_coarser_images_have_their_own_labels(model, scene):
    part = model.plan(scene.shape, 1e-3, frame=(10, 5, 100, 80), region=(7, 3, 20, 30))
    image = part.simulate(labelled(scene))
    assert (image.x[0], image.y[0]) == (17 * 0.25 - 3.0, 8 * 0.5)
    coarse = model.plan(scene.shape, 1e-3, oversample=2).simulate(labelled(scene))
    assert (coarse.x[0], coarse.y[1]) == (0.125 - 3.0, 1.25)
    assert coarse.shape == (scene.shape[0] // 2, scene.shape[1] // 2)

"""`Plan.source_gradients`: differences of images, single numbers, units, errors."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import pytest
from conftest import widening_model

SHAPE = (60, 80)
GALAXIES = {
    "x": np.array([20.3, 50.8, 33.0]),
    "y": np.array([15.1, 40.6, 22.5]),
    "flux": np.array([300.0, 500.0, 200.0]),
    "re": np.array([2.0, 3.0, 0.0]),
    "n": np.array([1.0, 1.4, 1.0]),
    "q": np.array([0.5, 0.8, 1.0]),
    "angle": np.array([20.0, 70.0, 0.0]),
}
STEPS = {"x": 1e-3, "y": 1e-3, "flux": 1.0, "re": 3e-3, "n": 3e-3, "q": 1e-3, "angle": 0.1}
#: The stamps are coarse, which does not matter for derivatives.
pytestmark = pytest.mark.filterwarnings("ignore:the PSF stamps are too coarse")


@pytest.fixture(scope="module")
def plan():
    return widening_model(SHAPE).plan(SHAPE, 1e-8, "f64", tolerance_on="l2")


@pytest.fixture(scope="module")
def image():
    y, x = np.indices(SHAPE)
    return np.sin(0.2 * x) * np.cos(0.15 * y + 0.4)


@pytest.mark.parametrize("name", list(GALAXIES))
def test_derivatives_are_differences(plan, image, name):
    found = plan.source_gradients(GALAXIES, image)[name]
    assert found.shape == (3,)
    # The last one is a star.
    for source in range(2 if name in ("re", "n", "q", "angle") else 3):
        values = []
        for step in (STEPS[name], -STEPS[name]):
            moved = {column: numbers.copy() for column, numbers in GALAXIES.items()}
            moved[name][source] += step
            values.append(np.vdot(plan.simulate(catalog=moved), image))
        difference = (values[0] - values[1]) / (2 * STEPS[name])
        assert found[source] == pytest.approx(difference, rel=1e-4, abs=1e-4)


def test_single_numbers_and_units(plan, image):
    stars = {"x": [20.0, 50.0], "y": 30.0, "flux": 100.0}
    found = plan.source_gradients(stars, image)
    whole = {"x": [20.0, 50.0] * u.pix, "y": [30.0, 30.0], "flux": [100.0, 100.0]}
    expected = plan.source_gradients(whole, image)
    assert list(found) == ["x", "y", "flux"]
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)
    turned = {**GALAXIES, "angle": np.deg2rad(GALAXIES["angle"]) * u.rad}
    expected = plan.source_gradients(GALAXIES, image)["angle"]
    np.testing.assert_allclose(plan.source_gradients(turned, image)["angle"], expected, rtol=1e-9)


def test_sources_without_flux(plan, image):
    dark = plan.source_gradients({"x": [20.0], "y": [30.0], "flux": [0.0]}, image)
    bright = plan.source_gradients({"x": [20.0], "y": [30.0], "flux": [5.0]}, image)
    assert dark["flux"] == bright["flux"] != 0.0
    assert dark["x"] == 0.0
    none = plan.source_gradients({"x": [], "y": [], "flux": []}, image)
    assert none["x"].shape == (0,)


def test_errors(plan, image):
    good = {"x": [1.0], "y": [1.0], "flux": [1.0]}
    masked = np.ma.array([1.0], mask=[True])
    for catalog, error, words in [
        ([1.0, 2.0], TypeError, "catalog must be a dict"),
        ({"x": [1.0], "y": [1.0]}, ValueError, "needs a column 'flux'"),
        ({**good, "re": [1.0]}, ValueError, "needs a column 'n'"),
        ({**good, "mag": [20.0]}, ValueError, "a column 'mag'"),
        ({**good, "x": [float("nan")]}, ValueError, "source 0"),
        ({**good, "x": masked}, ValueError, "source 0"),
        ({**good, "x": [[1.0]]}, ValueError, r"columns must be \[source\]"),
        ({**good, "x": [1.0] * u.s}, ValueError, "catalog: x"),
        ({**good, "re": 1.0, "n": 1.0, "q": 1.5, "angle": 0.0}, ValueError, "axis ratio"),
    ]:
        with pytest.raises(error, match=words):
            plan.source_gradients(catalog, image)
    with pytest.raises(ValueError, match="image"):
        plan.source_gradients(good, image[:-1])

"""The floor of sources, and sources that are drawn photon by photon."""

from __future__ import annotations

import numpy as np
import pytest

import psfield
from psfield.detector import Detector

SHAPE = (60, 70)
#: The stamps are small and coarse, for speed.
pytestmark = pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")


@pytest.fixture(scope="module")
def model():
    """Return a PSF with wide wings that changes over the field."""
    y, x = np.mgrid[-20:21, -20:21] / 2.0
    corners = ((0, 0), (69, 0), (0, 59), (69, 59))
    stamps = [(1 + (x**2 + y**2) / (3 + 0.02 * at[0])) ** -2.5 for at in corners]
    return psfield.PsfModel.from_samples(stamps, corners, oversampling=2, interpolation="bilinear")


@pytest.fixture(scope="module")
def catalog():
    """Return stars and galaxies of many brightnesses."""
    rng = np.random.default_rng(2)
    count = 80
    return {
        "x": rng.uniform(0, 69, count),
        "y": rng.uniform(0, 59, count),
        "flux": 10 ** rng.uniform(0, 4, count),
        "re": np.where(rng.random(count) > 0.5, rng.uniform(0.5, 2, count), 0.0),
        "n": 1.0,
    }


def test_what_is_dropped_is_within_its_limit(model, catalog):
    whole = model.plan(SHAPE, precision="f64")
    plan = model.plan(SHAPE, precision="f64", floor=0.05)
    dropped = plan.dropped_light(catalog)
    difference = np.abs(plan.simulate(None, catalog) - whole.simulate(None, catalog))
    assert 0.005 < difference.max() <= dropped.largest + 1e-4 * 1e3
    assert 0 < dropped.fraction < 0.1
    assert plan.spot_check(None, catalog, pixels=400).passed
    assert whole.dropped_light(catalog) == psfield.DroppedLight(0.0, 0.0)
    assert "largest" in dropped._repr_html_()


def test_the_floor_keeps_images_and_the_adjoint(model):
    scene = np.random.default_rng(1).random(SHAPE)
    whole, plan = model.plan(SHAPE), model.plan(SHAPE, floor=10.0)
    assert np.array_equal(whole.simulate(scene), plan.simulate(scene))
    assert np.array_equal(whole.adjoint(scene), plan.adjoint(scene))


def test_regions_reach_as_far(model, catalog):
    plan = model.plan(SHAPE, floor=0.05)
    part = plan.for_region((20, 10, 33, 25)).simulate(None, catalog)
    assert np.array_equal(part, plan.simulate(None, catalog)[10:35, 20:53])


@pytest.mark.parametrize("floor", [-1, np.nan, np.inf])
def test_floors_are_checked(model, floor):
    with pytest.raises(ValueError, match="floor"):
        model.plan(SHAPE, floor=floor)


def test_photons_have_the_statistics_of_light(model, catalog):
    plan = model.plan(SHAPE, precision="f64")
    camera = Detector(photon_noise=True, sky_e=3.0, response_rms=0.01)
    truth = plan.simulate(None, catalog) + 3.0
    runs = [
        plan.expose(None, catalog, detector=camera, seed=seed, shoot_below=2000.0).counts
        for seed in range(60)
    ]
    mean, variance = np.mean(runs, axis=0), np.var(runs, axis=0, ddof=1)
    chi_square = np.mean((mean - truth) ** 2 * 60 / (truth + (0.01 * truth) ** 2 * 60))
    assert abs(chi_square - 1) < 0.08
    assert abs(variance.sum() / truth.sum() - 1) < 0.03


def test_an_exposure_without_photons_is_that_of_the_image(model, catalog):
    plan, camera = model.plan(SHAPE), Detector(photon_noise=True)
    exposure = plan.expose(None, catalog, detector=camera, seed=4)
    image = plan.simulate(None, catalog)
    assert np.array_equal(exposure.counts, camera.expose(image, 4).counts)
    mask = np.zeros(SHAPE)
    mask[3, 5] = 1
    dark = plan.expose(None, catalog, detector=camera, seed=4, shoot_below="auto", bad_pixels=mask)
    assert dark.counts[3, 5] == 0


def test_the_order_of_rows_does_not_matter(model, catalog):
    plan, camera = model.plan(SHAPE), Detector(photon_noise=True)
    order = np.random.default_rng(3).permutation(80)
    shuffled = {k: v[order] if np.ndim(v) else v for k, v in catalog.items()}
    first, second = (
        plan.expose(None, sources, detector=camera, seed=1, shoot_below=1e6).counts
        for sources in (catalog, shuffled)
    )
    assert np.array_equal(first, second)


def test_exposures_are_checked(model, catalog):
    plan = model.plan(SHAPE)
    noisy = Detector(photon_noise=True)
    with pytest.raises(TypeError, match="detector"):
        plan.expose(None, catalog, detector={}, seed=1)
    with pytest.raises(ValueError, match="nothing to expose"):
        plan.expose(detector=noisy, seed=1)
    with pytest.raises(ValueError, match="stack"):
        plan.expose(np.zeros((2, *SHAPE)), detector=noisy, seed=1)
    for below in (-1, np.nan, "some"):
        with pytest.raises(ValueError, match="shoot_below"):
            plan.expose(None, catalog, detector=noisy, seed=1, shoot_below=below)
    with pytest.raises(ValueError, match="photon_noise"):
        plan.expose(None, catalog, detector=Detector(), seed=1, shoot_below=10)

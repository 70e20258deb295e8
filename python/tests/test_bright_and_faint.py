"""The floor of sources, and sources that are drawn photon by photon."""

from __future__ import annotations

import pickle

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


@pytest.fixture(scope="module")
def spiky():
    """Return a PSF whose stamps are large enough for wings, which change over the field."""
    y, x = np.mgrid[-200:201, -200:201].astype(float)
    spikes = np.exp(-(x**2) / 4) / (1 + y**2 / 100) + np.exp(-(y**2) / 4) / (1 + x**2 / 100)
    corners = ((0, 0), (69, 0), (0, 59), (69, 59))
    stamps = [(1 + (x**2 + y**2) / (3 + 0.02 * at[0])) ** -1.5 + 2e-3 * spikes for at in corners]
    return psfield.PsfModel.from_samples(stamps, corners)


def test_large_stamps_get_wings(spiky, tmp_path):
    wings = spiky.fit_report().wings
    assert wings.core_size == 191
    assert 0.005 < wings.flux[0] < wings.flux[1] < 0.2
    stamp = spiky.evaluate(34.0, 31.0)
    assert stamp.shape == (401, 401)
    assert abs(stamp.sum() - 1) < 1e-6
    path = tmp_path / "model.fits"
    spiky.write(path)
    back = psfield.PsfModel.read(path)
    assert np.array_equal(back.evaluate(34.0, 31.0), stamp)
    assert np.array_equal(pickle.loads(pickle.dumps(back)).evaluate(34.0, 31.0), stamp)
    with pytest.raises(ValueError, match=r"normalise=.*|has wings"):
        psfield.PsfModel.read(path, normalise="unit")


def test_wings_are_drawn_on_every_path(spiky, catalog):
    scene = np.zeros(SHAPE)
    scene[20, 30] = 1e4
    plan = spiky.plan(SHAPE, precision="f64")
    image = plan.simulate(scene, catalog)
    assert plan.spot_check(scene, catalog, pixels=100).passed
    part = plan.for_region((20, 10, 33, 25)).simulate(scene, catalog)
    np.testing.assert_allclose(part, image[10:35, 20:53], rtol=1e-9)
    rng = np.random.default_rng(3)
    other = rng.random(SHAPE)
    pairs = np.vdot(plan.simulate(scene), other), np.vdot(scene, plan.adjoint(other))
    assert abs(pairs[0] - pairs[1]) < 1e-9 * abs(pairs[0])
    # Beside the core, which ends 95 pixels from a star.
    alone = plan.simulate(None, {"x": [-100.0], "y": [30.0], "flux": [1e6]})
    assert alone.min() > 0


def test_wings_are_joined(tmp_path):
    y, x = np.mgrid[-30:31, -30:31]
    small = tmp_path / "small.fits"
    psfield.PsfModel.from_samples((1 + x**2 + y**2) ** -1.5, (0, 0)).write(small)
    joined = psfield.PsfModel.read(small, wings="power=3,300")
    stamp = joined.evaluate(0, 0)
    assert stamp.shape == (601, 601)
    assert abs(stamp.sum() - 1) < 1e-6
    # The profile goes on as it began.
    assert stamp[300, 300 + 200] / stamp[300, 300 + 20] == pytest.approx(1e-3, rel=0.05)
    profile = tmp_path / "profile.csv"
    profile.write_text("radius_px,light\n1,1\n300,0\n200,3\n")
    with pytest.raises(ValueError, match=r"profile.csv, line 4: radii must increase"):
        psfield.PsfModel.read(small, wings=profile)

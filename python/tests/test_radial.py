"""Galaxies whose profile is a table."""

import re

import numpy as np
import pytest

import psfield


@pytest.fixture(scope="module")
def plan():
    y, x = np.mgrid[-16:17, -16:17]
    stamps = [np.exp(-(x**2 + y**2) / (2 * sigma**2)) for sigma in (2.2, 2.6, 2.3, 2.8)]
    model = psfield.PsfModel.from_samples(stamps, [(0, 0), (99, 0), (0, 79), (99, 79)])
    return model.plan((80, 100), 1e-5, "f64")


@pytest.mark.parametrize("n", [1.0, 2.0])
def test_a_table_of_a_sersic_profile_gives_its_galaxy(plan, n):
    # The constant b of the profile, to 1e-6.
    b = {1.0: 1.678347, 2.0: 3.672061}[n]
    radius = np.concatenate([[0.0], np.geomspace(0.02, 60, 150)])
    profile = psfield.RadialProfile(radius, np.exp(-b * (radius / 3) ** (1 / n)))
    shape = {"q": 0.6, "angle": [30.0, -20.0], "g1": 0.05, "g2": [0.0, 0.1]}
    at = {"x": [40.3, 61.0], "y": [30.1, 55.5], "flux": [1000.0, -200.0]}
    image = plan.simulate(catalog=profile.catalog(**at, **shape, scale=[1.0, 0.5]))
    shape = {key: np.broadcast_to(value, 2) for key, value in shape.items()}
    galaxies = {**at, **shape, "re": [3.0, 1.5], "n": [n, n]}
    expected = plan.simulate(catalog=galaxies)
    # The sum over all pixels, as a fraction of the flux. The light beyond the table is negligible.
    assert np.abs(image - expected).sum() < profile.deviation * 1200


def test_the_sum_of_gaussians_is_close_to_the_table():
    radius = np.linspace(0, 12, 61)
    brightness = (1 + radius**2) ** -2.0
    profile = psfield.RadialProfile(radius, brightness, tolerance=1e-5)
    peaks = profile.fraction / (2 * np.pi * profile.sigma**2)
    total = np.exp(-0.5 * (radius[:, np.newaxis] / profile.sigma) ** 2) @ peaks
    scale = total[10] / brightness[10]
    assert np.allclose(total, scale * brightness, rtol=1e-2)
    assert profile.deviation <= 1e-5
    assert profile.fraction.sum() == pytest.approx(1)
    assert (profile.fraction > 0).all()
    assert repr(profile).startswith(f"<RadialProfile: {len(profile.sigma)} Gaussians")


def test_further_columns_are_repeated():
    profile = psfield.RadialProfile([0, 1, 2, 3, 4], np.exp(-np.arange(5.0)), tolerance=0.1)
    rows = profile.catalog([1, 2], [3, 4], 10, sed=["a", "b"], vx=0.5)
    count = len(profile.sigma)
    assert list(rows["sed"]) == ["a"] * count + ["b"] * count
    assert list(rows["vx"]) == [0.5] * 2 * count
    assert rows["flux"].sum() == pytest.approx(20)
    assert len(profile.catalog([], [], [])["x"]) == 0


@pytest.mark.parametrize(
    ("radius", "brightness", "options", "text"),
    [
        ([0, 1], [1, 0.5], {}, "three or more points, got shapes (2,) and (2,)"),
        ([0, 1, 2], [1, 0.5], {}, "got shapes (3,) and (2,)"),
        ([0, 2, 1], [3, 2, 1], {}, "radius must increase"),
        ([-1, 0, 1], [3, 2, 1], {}, "radius must increase from 0 or larger"),
        ([0, 1, np.nan], [3, 2, 1], {}, "radius must increase"),
        ([0, 1, 2], [3, -2, 1], {}, "brightness must be finite, 0 or larger"),
        ([0, 1, 2], [0, 0, 0], {}, "not 0 everywhere"),
        ([0, 1, 2], [3, 2, 1], {"tolerance": 0}, "tolerance must be from 1e-6 to 1, got 0"),
        (np.arange(20), np.arange(20) < 9, {}, "a profile with a sharp edge"),
    ],
)
def test_tables_that_are_refused(radius, brightness, options, text):
    with pytest.raises(ValueError, match=re.escape(text)):
        psfield.RadialProfile(radius, brightness, **options)


def test_columns_of_different_lengths_are_refused():
    profile = psfield.RadialProfile([0, 1, 2, 3, 4], np.exp(-np.arange(5.0)), tolerance=0.1)
    with pytest.raises(ValueError, match=re.escape("q must be one value or one for each of 2")):
        profile.catalog([1, 2], [3, 4], 10, q=[0.5, 0.5, 0.5])

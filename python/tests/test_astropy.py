"""Units, headers and world coordinates of astropy."""

from __future__ import annotations

import numpy as np
import pytest

units, nddata, wcs = (pytest.importorskip(f"astropy.{name}") for name in ("units", "nddata", "wcs"))


@pytest.fixture
def sky():
    """World coordinates of 96 x 128 pixels."""
    made = wcs.WCS(naxis=2)
    made.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    made.wcs.crval, made.wcs.crpix, made.wcs.cdelt = [150.0, 2.0], [64.5, 48.5], [-1e-4, 1e-4]
    return made


def test_quantities_keep_their_unit(model, scene):
    plan = model.plan(scene.shape, 1e-3)
    image = plan.simulate(scene * units.electron)
    assert image.unit == units.electron
    assert np.array_equal(image.value, plan.simulate(scene))


def test_fluxes_are_in_the_scene_s_unit(model, scene):
    plan = model.plan(scene.shape, 1e-3)
    stars = {
        "x": np.array([10.0]) * units.pix,
        "y": np.array([20.0]) * units.pix,
        "flux": np.array([2.0]) * units.kilojansky,
    }
    both = plan.simulate(scene * units.jansky, stars)
    plain = plan.simulate(scene, {"x": [10.0], "y": [20.0], "flux": [2000.0]})
    assert np.allclose(both.value, plain, rtol=1e-6)
    with pytest.raises(ValueError, match=r"catalog: flux.*not convertible"):
        plan.simulate(scene * units.electron, stars)


def test_ccddata_keep_their_header_and_place_on_the_sky(model, scene, sky):
    ccd = nddata.CCDData(scene.astype(np.float32), unit="adu", meta={"OBJECT": "field"}, wcs=sky)
    image = model.plan(scene.shape, 1e-3).simulate(ccd)
    assert isinstance(image, nddata.CCDData)
    assert image.unit == units.adu and image.meta["OBJECT"] == "field"
    assert np.array_equal(
        image.data, model.plan(scene.shape, 1e-3).simulate(scene.astype(np.float32))
    )
    assert np.allclose(image.wcs.all_pix2world([[3.0, 4.0]], 0), sky.all_pix2world([[3.0, 4.0]], 0))


@pytest.mark.parametrize(
    ("words", "first"),
    [
        ({"frame": (10, 5, 100, 80)}, (10, 5)),
        ({"region": (30, 20, 50, 41)}, (30, 20)),
        ({"frame": (10, 5, 100, 80), "region": (7, 3, 20, 20)}, (17, 8)),
    ],
)
def test_parts_of_a_frame_have_their_own_place(model, scene, sky, words, first):
    plan = model.plan(scene.shape, 1e-3, **words)
    expected = sky.all_pix2world([[first[0] + 2.0, first[1] + 1.0]], 0)
    ccd = nddata.CCDData(scene, unit="adu", wcs=sky)
    assert np.allclose(plan.simulate(ccd).wcs.all_pix2world([[2.0, 1.0]], 0), expected)
    if "region" in words:
        x0, y0, nx, ny = plan.light_region
        part = ccd[y0 : y0 + ny, x0 : x0 + nx]
        assert np.allclose(plan.simulate(part).wcs.all_pix2world([[2.0, 1.0]], 0), expected)


@pytest.mark.parametrize("distorted", [False, True], ids=["TAN", "TAN-SIP"])
def test_finer_scenes_have_coarser_images(model, sky, distorted):
    if distorted:
        sky.wcs.ctype = ["RA---TAN-SIP", "DEC--TAN-SIP"]
        a, b = np.zeros((3, 3)), np.zeros((3, 3))
        a[2, 0], b[0, 2] = 1e-3, -2e-3
        sky.sip = wcs.Sip(a, b, None, None, sky.wcs.crpix)
    ccd = nddata.CCDData(np.ones((96, 128)), unit="adu", wcs=sky)
    image = model.plan((96, 128), 1e-3, oversample=2).simulate(ccd)
    # Pixel (0, 0) of the image is centred between four pixels of the scene.
    assert np.allclose(image.wcs.all_pix2world([[0.0, 0.0]], 0), sky.all_pix2world([[0.5, 0.5]], 0))
    part = model.plan((96, 128), 1e-3, oversample=2, frame=(5, 3, 20, 30)).simulate(ccd)
    found = part.wcs.all_pix2world([[7.0, 9.0]], 0)
    expected = sky.all_pix2world([[24.5, 24.5]], 0)
    assert np.allclose(found, expected, rtol=0, atol=1e-9)


def test_masked_pixels_are_refused(model, scene):
    mask = np.zeros(scene.shape, bool)
    mask[3, 4] = True
    plan = model.plan(scene.shape)
    for masked in (nddata.CCDData(scene, unit="adu", mask=mask), np.ma.masked_array(scene, mask)):
        with pytest.raises(ValueError, match="scene: 1 values are masked"):
            plan.simulate(masked)

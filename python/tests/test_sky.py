"""Sources with positions on the sky, against astropy's world coordinates."""

from __future__ import annotations

import numpy as np
import pytest

import psfield
from psfield._catalog import columns_of
from psfield._sky import Sky

fits = pytest.importorskip("astropy.io.fits")
nddata, wcs = (pytest.importorskip(f"astropy.{name}") for name in ("nddata", "wcs"))
SkyCoord = pytest.importorskip("astropy.coordinates").SkyCoord
Table = pytest.importorskip("astropy.table").Table

#: The largest difference from astropy, in pixels, of positions that psfield computes itself.
CLOSE_PX = 1e-3
SHAPE = (2048, 2000)

SIP = {
    "CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "A_ORDER": 3, "B_ORDER": 3,
    "A_2_0": 2.1e-6, "A_0_2": -8.0e-7, "A_1_1": 3.0e-6, "A_3_0": 4.0e-11, "B_0_2": 1.7e-6,
    "B_2_0": 6.0e-7, "B_1_1": -2.0e-6, "B_0_3": -3.0e-11,
}  # fmt: skip
TPV = {
    "CTYPE1": "RA---TPV", "CTYPE2": "DEC--TPV", "PV1_0": 1e-5, "PV1_1": 1.001, "PV1_2": 2e-4,
    "PV1_4": 3e-3, "PV1_5": -1e-3, "PV1_7": 4e-2, "PV2_1": 0.999, "PV2_2": -1e-4, "PV2_4": -2e-3,
    "PV2_6": 2e-3, "PV2_10": 3e-2,
}  # fmt: skip


def detector(cards):
    """Return the world coordinates of a detector with distortion."""
    header = fits.Header({"CRPIX1": 1000.5, "CRPIX2": 980.0, "CRVAL1": 150.1, "CRVAL2": 2.2})
    header.update({"CD1_1": -5.4e-5, "CD1_2": 3e-6, "CD2_1": 3.1e-6, "CD2_2": 5.5e-5})
    header.update({"CUNIT1": "deg", "CUNIT2": "deg", "RADESYS": "ICRS", **cards})
    return wcs.WCS(header)


@pytest.fixture(params=[SIP, TPV], ids=["TAN-SIP", "TPV"])
def sky(request):
    return detector(request.param)


@pytest.fixture(scope="module")
def model():
    """Return an oversampled PSF, for stars between pixels."""
    return psfield.PsfModel.from_telescope(
        field_shape=(96, 128), samples=(7, 7), stamp_size=16, oversampling=4
    )


@pytest.fixture(scope="module")
def stars():
    """Pixels (x, y) all over the detector and a little beyond."""
    return np.random.default_rng(3).uniform(-20, 2060, (2, 300))


def test_tables_with_sky_coord(sky, stars):
    place = sky.pixel_to_world(*stars)
    flux = np.ones(300)
    expected = np.array(sky.world_to_pixel(place))
    for catalog in (
        Table({"place": place, "flux": flux}),
        Table({"place": place.galactic, "flux": flux}),
        Table({"RA": place.ra, "Dec": place.dec, "flux": flux}),
        {"ra": place.ra.deg, "dec": place.dec.deg, "flux": 1.0},
    ):
        columns = columns_of(catalog, sky=Sky(sky))
        found = np.array([columns["x"], columns["y"]])
        assert np.abs(found - expected).max() < 1e-6
        assert np.abs(found - stars).max() < CLOSE_PX


def test_files_with_world_coordinates_of_an_object(sky, stars, tmp_path):
    place = sky.pixel_to_world(*stars)
    path = tmp_path / "stars.ecsv"
    Table({"ra": place.ra.deg, "dec": place.dec.deg, "flux": np.ones(300)}).write(path)
    read = psfield.read_catalog(path, wcs=sky)
    expected = np.array(sky.world_to_pixel(place))
    assert np.abs(np.array([read["x"], read["y"]]) - expected).max() < CLOSE_PX
    # A scene that is three times finer, and its part from pixel (30, 12) on.
    finer = columns_of(path, sky=Sky(sky, 3, (30, 12)))
    assert np.abs(finer["x"] - ((expected[0] + 30.5) / 3 - 0.5)).max() < CLOSE_PX
    assert np.abs(finer["y"] - ((expected[1] + 12.5) / 3 - 0.5)).max() < CLOSE_PX


def test_the_world_coordinates_of_a_scene_place_its_stars(model, scene):
    sky = wcs.WCS(naxis=2)
    sky.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    sky.wcs.crval, sky.wcs.crpix, sky.wcs.cdelt = [150.0, 2.0], [64.5, 48.5], [-1e-4, 1e-4]
    ccd = nddata.CCDData(scene, unit="adu", wcs=sky)
    for settings, to_pixels in [
        ({}, lambda p: p),
        ({"oversample": 2}, lambda p: (p + 0.5) / 2 - 0.5),
    ]:
        plan = model.plan(scene.shape, 1e-3, **settings)
        at = np.array([[30.0, 70.3], [40.0, 20.6]])
        place = sky.pixel_to_world(*at)
        x, y = to_pixels(at)
        expected = plan.simulate(ccd, {"x": x, "y": y, "flux": [100.0, 50.0]})
        image = plan.simulate(ccd, {"place": place, "flux": [100.0, 50.0]})
        assert np.allclose(image.data, expected.data, rtol=1e-6, atol=1e-6)
        assert plan.spot_check(ccd, {"place": place, "flux": [100.0, 50.0]}).passed
    # A scene that is only the part of the light that a region needs.
    plan = model.plan(scene.shape, 1e-3, region=(40, 30, 50, 40))
    x0, y0, nx, ny = plan.light_region
    part = ccd[y0 : y0 + ny, x0 : x0 + nx]
    catalog = {"place": sky.pixel_to_world(60.0, 50.0), "flux": 100.0}
    expected = plan.simulate(part, {"x": 60.0, "y": 50.0, "flux": 100.0})
    assert np.allclose(plan.simulate(part, catalog).data, expected.data, rtol=1e-6, atol=1e-6)


def test_world_coordinates_of_the_image_may_be_given(model, scene):
    sky = detector(SIP)
    place = sky.pixel_to_world([30.0, 50.2], [40.0, 60.7])
    plan = model.plan(scene.shape, 1e-3)
    expected = plan.simulate(catalog={"x": [30.0, 50.2], "y": [40.0, 60.7], "flux": 9.0})
    image = plan.simulate(catalog={"place": place, "flux": 9.0}, wcs=sky)
    assert np.abs(image - expected).max() < 1e-4 * expected.max()
    again = psfield.simulate({"place": place, "flux": 9.0}, model, wcs=sky, tolerance=1e-3)
    np.testing.assert_array_equal(again, image)


def test_sources_off_the_projection_are_left_out(model, scene):
    sky = detector({"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN"})
    place = SkyCoord([150.1, 330.1, 150.11], [2.2, -2.2, 2.2], unit="deg")
    with pytest.warns(psfield.PsfieldWarning, match="1 row skipped: outside the projection"):
        columns = columns_of({"place": place, "flux": [1.0, 2.0, 3.0]}, sky=Sky(sky))
    assert columns["flux"].tolist() == [1.0, 3.0]


def test_what_is_missing_is_named(model, scene):
    plan = model.plan(scene.shape)
    place = SkyCoord([150.1], [2.2], unit="deg")
    with pytest.raises(ValueError, match="on the sky: give the world coordinates"):
        plan.simulate(catalog={"ra": [150.1], "dec": [2.2], "flux": [1.0]})
    with pytest.raises(ValueError, match="a and b are both positions on the sky"):
        columns_of({"a": place, "b": place, "flux": [1.0]}, sky=Sky(detector(SIP)))
    with pytest.raises(ValueError, match=r"no such column.*or ra and dec"):
        plan.simulate(catalog={"flux": [1.0]})

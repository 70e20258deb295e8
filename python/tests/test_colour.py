"""Scenes in colour, and series of exposures."""

import warnings

import numpy as np
import pytest

import psfield

BAND = ([0.45, 0.5, 0.7, 0.75], [0.0, 1.0, 1.0, 0.0])
RED, BLUE = "blackbody:3000", "blackbody:12000"


def chromatic():
    """A PSF that widens with the wavelength and over the field."""
    y, x = np.mgrid[-20:21, -20:21] / 2.0
    stamps, positions, wavelengths = [], [], []
    for wavelength in (0.45, 0.6, 0.75):
        for at in ((0, 0), (59, 0), (0, 49), (59, 49)):
            sigma = 1.2 * (wavelength / 0.6) * (1 + 0.002 * at[0])
            stamps.append(np.exp(-(x**2 + y**2) / (2 * sigma**2)))
            positions.append(at)
            wavelengths.append(wavelength)
    return psfield.PsfModel.from_samples(
        stamps,
        positions,
        wavelengths_um=wavelengths,
        oversampling=2,
        noise=0,
        interpolation="bilinear",
    )


def light(seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 1, (50, 60)) * (rng.uniform(0, 1, (50, 60)) > 0.9)


@pytest.fixture(scope="module")
def model():
    return chromatic()


def test_a_plan_in_colour_adds_the_images_of_the_spectra(model):
    plan = model.plan((50, 60), 1e-8, "f64", bandpass=BAND)
    scene = {RED: light(1), BLUE: light(2)}
    catalog = {"x": [20.3, 40.7], "y": [10.0, 30.5], "flux": [5.0, 7.0], "sed": [BLUE, RED]}
    image = plan.simulate(scene, catalog)
    alone = {
        name: model.for_spectrum(BAND, name).plan((50, 60), 1e-8, "f64") for name in (RED, BLUE)
    }
    expected = sum(alone[name].simulate(scene[name]) for name in scene)
    for row, name in enumerate(catalog["sed"]):
        source = {key: catalog[key][row] for key in ("x", "y", "flux")}
        expected = expected + alone[name].simulate(catalog=source)
    assert np.abs(image - expected).max() < 1e-7 * expected.max()
    assert "in colour" in repr(plan)
    assert plan.spot_check(scene, catalog).passed
    # Temperatures are black bodies.
    warm = {key: catalog[key] for key in ("x", "y", "flux")} | {"teff": [12000.0, 3000.0]}
    assert np.array_equal(plan.simulate(scene, warm), image)


def test_the_spectrum_of_a_plan_is_that_of_light_without_one(model):
    plan = model.plan((50, 60), 1e-6, "f64", bandpass=BAND, sed=RED)
    alone = model.for_spectrum(BAND, RED).plan((50, 60), 1e-6, "f64")
    catalog = {"x": [20.3], "y": [10.0], "flux": [5.0]}
    both = plan.simulate(light(), catalog)
    assert np.allclose(both, alone.simulate(light(), catalog), rtol=0, atol=1e-6 * both.max())
    stack = np.stack([light(1), light(2)])
    assert np.allclose(plan.simulate(stack), alone.simulate(stack), rtol=0, atol=1e-6)
    part = plan.for_region((10, 5, 30, 20))
    assert np.allclose(part.simulate(light(), catalog), both[5:25, 10:40], rtol=0, atol=1e-6)
    again = alone.with_psf(model.for_spectrum(BAND, BLUE)).simulate(light())
    of_blue = model.plan((50, 60), 1e-6, "f64", bandpass=BAND, sed=BLUE).simulate(light())
    assert np.allclose(again, of_blue, rtol=0, atol=2e-6 * again.max())


def test_the_adjoint_in_colour_is_the_transpose(model):
    plan = model.plan((50, 60), 1e-4, "f64", bandpass=BAND)
    scene, image = {RED: light(1), BLUE: light(2)}, light(3)
    of_spectra = plan.adjoint(image, spectra=[RED, BLUE])
    transposed = sum(np.vdot(scene[name], of_spectra[name]) for name in scene)
    assert np.isclose(np.vdot(plan.simulate(scene), image), transposed, rtol=1e-10)
    stack = plan.adjoint(np.stack([image, 2 * image]), spectra=[RED, BLUE])
    assert np.allclose(stack[BLUE][1], 2 * of_spectra[BLUE])


def test_dispersion_moves_blue_light_to_the_zenith(model):
    plan = model.plan(
        (50, 60), 1e-4, bandpass=BAND, dispersion={"zenith": 60, "scale": 0.2, "reference": 0.6}
    )

    def row(name):
        star = {"x": [30.0], "y": [25.0], "flux": [100.0], "sed": [name]}
        image = plan.simulate(catalog=star)
        return (image.sum(axis=1) @ np.arange(50)) / image.sum()

    assert row(BLUE) > row(RED) + 0.05


@pytest.mark.parametrize(
    ("settings", "scene", "text"),
    [
        ({"sed": RED}, None, "sed needs bandpass="),
        ({"dispersion": {"zenith": 50}}, None, "dispersion needs bandpass="),
        ({"bandpass": BAND}, light(), "the image has no spectrum"),
        ({"bandpass": BAND}, {"no such": light()}, "no such"),
        ({"bandpass": "none.csv"}, None, "none.csv"),
    ],
)
def test_what_does_not_fit_is_named(model, settings, scene, text):
    with pytest.raises((ValueError, OSError), match=text):
        model.plan((50, 60), **settings).simulate(scene, {"x": 1, "y": 1, "flux": 1, "sed": RED})


def test_images_by_spectrum_need_a_bandpass(model):
    with pytest.raises(ValueError, match="need a plan in colour"):
        model.at(wavelength_um=0.6).plan((50, 60)).simulate({RED: light()})


def test_without_a_bandpass_spectra_are_not_read(model):
    catalog = {"x": [20.3], "y": [10.0], "flux": [5.0], "sed": [BLUE]}
    plan = model.at(wavelength_um=0.6).plan((50, 60))
    with pytest.warns(psfield.PsfieldWarning, match="sed"):
        plan.simulate(catalog=catalog)


def test_a_simulation_in_one_call_may_be_in_colour(model):
    image = psfield.simulate({RED: light()}, model, tolerance=1e-4, bandpass=BAND)
    assert image.shape == (50, 60)


def test_a_catalogue_file_has_spectra(tmp_path, model):
    path = tmp_path / "stars.csv"
    path.write_text(f"x,y,flux,sed,vx,vy\n20.3,10,5,{BLUE},0,0\n40,30,7,{RED},0.1,0\n")
    read = psfield.read_catalog(path, spectra=True, velocities=True)
    assert read["sed"] == [BLUE, RED]
    assert read["vx"].tolist() == [0, 0.1]
    plan = model.plan((50, 60), 1e-4, "f64", bandpass=BAND)
    with pytest.warns(psfield.PsfieldWarning, match="vx, vy"):
        from_file = plan.simulate(catalog=path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        assert np.array_equal(plan.simulate(catalog=read), from_file)


def test_a_series_in_colour_moves_its_light(model):
    catalog = {"x": [20.0, 40.0], "y": [10.0, 30.0], "flux": [5.0, 7.0], "teff": [3000, 12000]}
    night = psfield.series(
        model,
        catalog=catalog,
        shape=(50, 60),
        exposure_s=10,
        count=3,
        cadence_s=20,
        drift_px_per_s=(0.05, 0.0),
        light_curves={"row": [0, 0], "time": [0, 100], "factor": [1, 2]},
        bandpass=BAND,
        tolerance=1e-6,
        precision="f64",
    )
    assert len(night) == 3
    last = night[-1]
    assert (last.start_s, last.end_s) == (40.0, 50.0)
    assert last.sources["x"].round(6).tolist() == [22.25, 42.25]
    assert last.sources["flux"].round(6).tolist() == [7.25, 7.0]
    assert np.isclose(last.image.sum(), 14.25, rtol=1e-5)
    plan = model.plan((50, 60), 1e-6, "f64", bandpass=BAND)
    at_rest = plan.simulate(catalog=catalog | {"x": last.sources["x"], "flux": [7.25, 7.0]})
    assert np.abs(last.image - at_rest).max() < 0.02 * at_rest.max()


def test_a_series_of_frames_takes_the_psf_of_each():
    y, x = np.mgrid[-8:9, -8:9]
    stamps = [np.exp(-(x**2 + y**2) / (2 * sigma**2)) for sigma in (1.0, 2.0)]
    model = psfield.PsfModel.from_samples(stamps, [(0, 0)] * 2, frame_numbers=[0, 1], noise=0)
    scene = np.zeros((30, 40))
    scene[15, 20] = 1.0
    sharp, wide = psfield.series(model, scene, exposure_s=5, starts_s=[0, 100], precision="f64")
    assert sharp.image.max() > 3 * wide.image.max()
    expected = model.at(frame_number=1).plan((30, 40), precision="f64").simulate(scene)
    assert np.allclose(wide.image, expected, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match="exposure 2"):
        psfield.series(model, scene, exposure_s=5, count=3)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "count"),
        ({"count": 2, "starts_s": [0, 50]}, "either"),
        ({"count": 2, "path": {"time": [0]}}, "path must be a table with columns time, dx, dy"),
        ({"count": 2, "jitter_px": -1}, "jitter"),
        ({"starts_s": [0, 1]}, "before exposure 0 ends"),
        ({"count": 2, "light_curves": {"row": [5], "time": [0], "factor": [1]}}, "source 5"),
    ],
)
def test_a_series_that_does_not_fit_is_named(changes, text):
    model = psfield.PsfModel.from_samples(np.ones((3, 3)), (0, 0))
    star = {"x": 3, "y": 2, "flux": 1}
    with pytest.raises(ValueError, match=text):
        psfield.series(model, catalog=star, shape=(5, 7), exposure_s=10, **changes)


def test_the_order_of_spectra_does_not_matter(model):
    plan = model.plan((50, 60), 1e-4, "f64", bandpass=BAND)
    one, other = light(1), light(2)
    assert np.array_equal(
        plan.simulate({RED: one, BLUE: other}), plan.simulate({BLUE: other, RED: one})
    )
    out = np.zeros((50, 60))
    assert plan.simulate({RED: one, BLUE: out}, out=out) is out
    # An image of zeros may share a transform with another one, which rounds differently.
    assert np.allclose(out, plan.simulate({RED: one}), rtol=0, atol=1e-14 * out.max())


def test_a_spectrum_is_beside_its_catalogue(tmp_path, monkeypatch, model):
    folder = tmp_path / "sub"
    folder.mkdir()
    (folder / "red.csv").write_text("wavelength_um,flux\n0.4,0\n0.8,1\n")
    (folder / "stars.csv").write_text("x,y,flux,sed\n20.3,10,5,red.csv\n")
    monkeypatch.chdir(tmp_path)
    plan = model.plan((50, 60), 1e-4, "f64", bandpass=BAND)
    image = plan.simulate(catalog="sub/stars.csv")
    read = psfield.read_catalog("sub/stars.csv", spectra=True)
    assert np.array_equal(plan.simulate(catalog=read), image)


@pytest.mark.parametrize("sed", [np.ma.array([RED, BLUE], mask=[False, True]), [RED, None]])
def test_a_missing_spectrum_is_named_with_its_row(model, sed):
    plan = model.plan((50, 60), bandpass=BAND)
    catalog = {"x": [1, 2], "y": [1, 2], "flux": [1, 2], "sed": sed}
    with pytest.raises((ValueError, OSError), match=r"row 1.*the name of the spectrum is missing"):
        plan.simulate(catalog=catalog)


def test_adjoints_and_images_need_names(model):
    plan = model.plan((50, 60), bandpass=BAND)
    with pytest.raises(TypeError, match="spectra must be a list of names"):
        plan.adjoint(light(), spectra=RED)
    with pytest.raises(TypeError, match="the name of a spectrum must be a string"):
        plan.simulate({1: light()})
    with pytest.raises(ValueError, match=r"scene\['powerlaw:1'\] must be an array \[y, x\]"):
        plan.simulate({"powerlaw:1": np.zeros((2, 50, 60))})
    with pytest.raises(ValueError, match=r"scene\[.powerlaw:1.\].*NaN"):
        plan.simulate({"powerlaw:1": np.full((50, 60), np.nan)})


def test_the_shape_of_a_series_is_that_of_its_images():
    y, x = np.mgrid[-20:21, -20:21] / 2.0
    model = psfield.PsfModel.from_samples(
        np.exp(-(x**2 + y**2) / 2), (0, 0), oversampling=2, field_shape=(50, 60)
    )
    star = {"x": [20.0], "y": [10.0], "flux": [5.0]}
    night = psfield.series(model, catalog=star, exposure_s=1, count=1, oversample=2)
    assert night[0].image.shape == (50, 60)
    with pytest.raises(IndexError):
        night[-2]
    with pytest.raises(TypeError, match="drift_px_per_s must be two numbers"):
        psfield.series(model, catalog=star, exposure_s=1, count=1, drift_px_per_s=0.1)
    with pytest.raises(TypeError, match="leave it out"):
        psfield.series(model, np.ones((50, 60)), exposure_s=1, count=1, shape=(3, 3))


def test_light_curves_keep_the_rows_of_a_table():
    u = pytest.importorskip("astropy.units")
    coordinates = pytest.importorskip("astropy.coordinates")
    wcs = pytest.importorskip("astropy.wcs").WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN", "DEC--TAN"], [10, 20]
    wcs.wcs.crpix, wcs.wcs.cdelt = [30, 25], [-1e-4, 1e-4]
    y, x = np.mgrid[-20:21, -20:21] / 2.0
    model = psfield.PsfModel.from_samples(np.exp(-(x**2 + y**2) / 2), (0, 0), oversampling=2)
    # The first source is on the other side of the sky.
    places = coordinates.SkyCoord([190, 10] * u.deg, [-20, 20] * u.deg)
    with pytest.warns(psfield.PsfieldWarning, match="1 row skipped"):
        night = psfield.series(
            model,
            catalog={"pos": places, "flux": [5, 7]},
            shape=(50, 60),
            wcs=wcs,
            exposure_s=1,
            starts_s=[0] * u.min,
            light_curves={"row": [1, 1], "time": [0, 1] * u.hour, "factor": [2, 2]},
        )
    assert night[0].sources["row"].tolist() == [1]
    assert night[0].sources["flux"].tolist() == [14.0]

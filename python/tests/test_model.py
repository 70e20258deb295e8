"""Models: constructors, properties and files."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from conftest import direct_sum, gaussian_stamp, relative_l2, widening_model

import psfield

#: Error of a stamp that is rebuilt from the components kept by the automatic rank.
RANK = 1e-4
ROUNDING = 1e-12


def test_samples_come_back_where_they_lie(model):
    stamps = model.evaluate(model.positions[:, 0], model.positions[:, 1])
    for (x, y), stamp in zip(model.positions, stamps):
        assert relative_l2(stamp, gaussian_stamp(1.3 + 0.9 * x / 128, q=1.0 + 0.3 * y / 96)) < RANK
    assert np.allclose(stamps.sum((1, 2)), 1.0, atol=ROUNDING)


def test_evaluate_broadcasts_and_repeats(model):
    one = model.evaluate(30, 40)
    assert one.shape == (17, 17) and one.dtype == np.float64
    many = model.evaluate([[30, 31, 30]], [[40], [41]])
    assert many.shape == (2, 3, 17, 17)
    assert np.array_equal(many[0, 0], one) and np.array_equal(many[0, 2], one)
    assert model.evaluate(30, 40, size=9).shape == (9, 9)
    assert np.allclose(model.evaluate(30, 40, size=9), one[4:13, 4:13], rtol=0, atol=ROUNDING)


def test_evaluate_draws_stars_at_their_phase():
    stamp = gaussian_stamp(6.0, 65)
    model = psfield.PsfModel.from_samples(stamp[None] * 16, [(0, 0)], oversampling=4)
    drawn = model.evaluate(10.25, 20.0, pixels="frame", sub_pixel=True, size=13)
    assert (
        relative_l2(drawn, gaussian_stamp(1.5, 13, shift=(0.25, 0.0))) < 1e-3
    )  # The error of the cubic spline.
    with pytest.raises(ValueError, match="sub-pixel"):
        model.evaluate(10.25, 20.0, sub_pixel=True)
    with pytest.raises(ValueError, match="pixels must be stamp or frame"):
        model.evaluate(0, 0, pixels="native")
    with pytest.raises(ValueError, match="size must be at least 1"):
        model.evaluate(0, 0, size=0)


def test_planes_of_a_library_without_flux_can_be_left_out(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    planes = np.array([gaussian_stamp(1.5 + 0.1 * i, 11) for i in range(9)])
    planes[4] = 0
    header = fits.Header({"NXPSFS": 3, "NYPSFS": 3})
    for i in range(3):
        header[f"IPSFX{i + 1:02}"] = header[f"JPSFY{i + 1:02}"] = 1.0 + 50 * i
    path = tmp_path / "library.fits"
    fits.PrimaryHDU(planes, header).writeto(path)
    with pytest.raises(OSError, match=r"plane 4 .*at \(50, 50\) has flux 0.*\(skip_invalid=\)"):
        psfield.PsfModel.read(path)
    model = psfield.PsfModel.read(path, skip_invalid=True)
    assert "1 of 9 left out" in " ".join(model.notes)
    assert model.interpolation == "natural-neighbour"
    # The PSFs around the missing plane, of sigma 1.6 to 1.8, replace it.
    middle = model.evaluate(50, 50)
    assert middle.max() == pytest.approx(planes[[1, 3, 5, 7]].mean(axis=0).max(), rel=0.05)


def test_positions_off_the_field_are_refused(model):
    with pytest.raises(ValueError, match="outside the field of 128 x 96 pixels"):
        model.evaluate(200, 0)
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="finite"):
            model.evaluate(bad, 0)


def test_a_model_tells_of_itself(model):
    assert (model.field_shape, model.stamp_shape, model.oversampling, model.centre) == (
        (96, 128),
        (17, 17),
        1.0,
        (8.0, 8.0),
    )
    assert model.pixel_response_included is True
    assert model.positions.shape == (16, 2)
    assert model.interpolation.startswith("kriging=gaussian,")
    assert (model.outside, model.normalise) == ("nearest", "unit")
    assert model.mean.shape == (17, 17)
    assert model.components.shape == (model.rank, 17, 17) and model.coefficients.shape == (
        16,
        model.rank,
    )
    flat = model.components.reshape(model.rank, -1)
    assert np.allclose(flat @ flat.T, np.eye(model.rank), atol=1e-10)
    report = model.fit_report()
    assert report.rank == model.rank and report.max_error <= RANK and len(report.errors) == 16
    assert repr(model) == "<PsfModel: 16 samples, stamps 17 x 17, oversampling 1, field 96 x 128>"
    assert model.notes == () and model.sampling is None


def test_a_basis_of_one_s_own(model):
    again = psfield.PsfModel.from_basis(
        model.mean,
        model.components,
        model.coefficients,
        model.positions,
        field_shape=(96, 128),
        interpolation=model.interpolation,
    )
    assert np.array_equal(again.evaluate(17.5, 80.25), model.evaluate(17.5, 80.25))
    assert again.fit_report() is None
    with pytest.raises(ValueError, match="inner product"):
        psfield.PsfModel.from_basis(None, 2 * model.components, model.coefficients, model.positions)
    with pytest.raises(ValueError, match="coefficient"):
        psfield.PsfModel.from_basis(
            None, model.components, model.coefficients[:, :1], model.positions
        )


def test_polynomials_are_evaluated_far_away_with_a_warning():
    def of(outside):
        return psfield.PsfModel.from_samples(
            [gaussian_stamp(sigma) for sigma in (1.3, 1.6, 1.4, 1.7)],
            [(0, 0), (60, 0), (0, 60), (60, 60)],
            field_shape=(200, 200),
            interpolation="polynomial=1",
            outside=outside,
        )

    of("extend").evaluate([0, 60], 64)
    with pytest.warns(psfield.PsfieldWarning, match="extrapolated by 67 % of the range in x"):
        of("extend").evaluate(100, 20)
    of("nearest").evaluate(100, 20)


@pytest.mark.parametrize(
    "make",
    [
        lambda: widening_model(
            rank=5, interpolation="delaunay", outside="extend", noise=1e-6, centring="none"
        ),
        lambda: widening_model(
            rank="error=0.01", oversampling=2.5, centre=(8.25, 7.5), pixel_response_included=False
        ),
        lambda: psfield.PsfModel.from_samples(
            [gaussian_stamp(1.0)], [(3, 4)], stamp_interpolation="lanczos3", normalise="keep"
        ),
        lambda: psfield.PsfModel.from_basis(
            None, gaussian_stamp(1.0)[None] / np.linalg.norm(gaussian_stamp(1.0)), [[2.0]], [(3, 4)]
        ),
    ],
)
def test_pickled_models_are_the_same(make):
    model = make()
    again = pickle.loads(pickle.dumps(model))
    assert np.array_equal(again.evaluate(3, 4), model.evaluate(3, 4))
    assert again.centre == model.centre and again.interpolation == model.interpolation
    plan = model.plan((10, 12), 1e-2, "f64")
    scene = np.ones((10, 12))
    assert np.array_equal(pickle.loads(pickle.dumps(plan)).simulate(scene), plan.simulate(scene))


class TestBadSamples:
    """Invalid samples."""

    good = np.stack([gaussian_stamp(1.0)] * 3)
    places = [(0, 0), (10, 0), (0, 10)]

    @pytest.mark.parametrize(
        ("stamps", "positions", "error", "text"),
        [
            (good, places[:2], ValueError, "one for each position"),
            (good, [(0, 0), (10, 0), (0, 0)], ValueError, "0, 0"),
            (good, [0, 1, 2], ValueError, "positions must be"),
            (good, np.zeros((3, 3)), ValueError, "of x and y"),
            (good, [(0, 0), (10, 0), (0, np.nan)], ValueError, "finite"),
            (good[0, 0], places, ValueError, r"\[sample, y, x\]"),
            (good[0], places, ValueError, "one for each position"),
            (np.zeros((0, 17, 17)), np.zeros((0, 2)), ValueError, "stamps is empty"),
            (np.zeros((3, 17, 17)), places, ValueError, "flux"),
            (np.where(good > 0.01, np.nan, good), places, ValueError, "NaN|finite"),
            (good.astype(complex), places, TypeError, "real numbers"),
            ([good[0], good[0][:5, :5], good[0]], places, ValueError, "one shape"),
        ],
    )
    def test_refused(self, stamps, positions, error, text):
        with pytest.raises(error, match=text):
            psfield.PsfModel.from_samples(stamps, positions)

    @pytest.mark.parametrize(
        ("options", "text"),
        [
            ({"rank": 50}, "50"),
            ({"rank": "most"}, "rank"),
            ({"interpolation": "spline"}, "interpolation"),
            ({"outside": "zero"}, "nearest, extend or error"),
            ({"normalise": "peak"}, "unit or keep"),
            ({"centring": "median"}, "mean"),
            ({"noise": -1.0}, "noise"),
            ({"oversampling": 0}, "oversampling"),
            ({"centre": (50, 0)}, "centre"),
            ({"stamp_interpolation": "linear"}, "cubic-spline or lanczos3"),
            ({"field_shape": (5, 5)}, "field"),
        ],
    )
    def test_options(self, options, text):
        with pytest.raises(ValueError, match=text):
            psfield.PsfModel.from_samples(self.good, self.places, **options).evaluate(0, 0)

    def test_other_types_of_numbers_are_taken(self):
        expected = psfield.PsfModel.from_samples(
            self.good.astype(np.float32), self.places
        ).evaluate(3, 3)
        for stamps in (
            self.good.astype(">f4"),
            np.asfortranarray(self.good.astype(np.float32)),
            self.good.astype(np.float32)[:, ::-1][:, ::-1],
        ):
            for positions in (
                np.array(self.places, np.int16),
                np.array(self.places, ">f8"),
                {"x": [0, 10, 0], "y": [0, 0, 10]},
            ):
                assert np.array_equal(
                    psfield.PsfModel.from_samples(stamps, positions).evaluate(3, 3), expected
                )


class TestFunctions:
    """Functions that draw the PSF."""

    def test_samples_lie_where_the_psf_varies(self):
        def draw(x, y):
            # It widens only at the right.
            return gaussian_stamp(1.5 + np.exp((x - 399) / 40))

        steps = []
        model = psfield.PsfModel.from_function(
            draw, (300, 400), threshold=0.005, progress=lambda *step: steps.append(step)
        )
        report = model.sampling
        assert (report.method, report.outcome) == ("kriging", "met") and report.worst <= 0.005
        assert report.samples == report.draws == len(model.positions) < 200
        assert report.verification.above == 0 and report.verification.tests == 16
        assert report.expected <= 0.005
        for x, y in [(10.3, 20.4), (350.1, 33.0), (398.0, 299.0), (200.0, 150.0)]:
            assert relative_l2(model.evaluate(x, y), draw(x, y)) < 0.01
        assert steps and steps[-1][0] > 0
        assert model.field_shape == (300, 400)

    def test_a_mesh_lies_where_the_psf_varies(self):
        def draw(x, y):
            return gaussian_stamp(1.5 + np.exp((x - 399) / 40))

        model = psfield.PsfModel.from_function(draw, (300, 400), threshold=0.005, method="mesh")
        assert (model.sampling.method, model.sampling.outcome) == ("mesh", "met")
        assert model.sampling.verification is None
        assert np.mean(model.positions[:, 0] > 300) > 0.5

    def test_a_jump_is_told_and_its_samples_may_be_used(self):
        def draw(x, y):
            return gaussian_stamp(1.0 if x < 20 else 2.0)

        with pytest.raises(ValueError, match=r"is not met: cells .* accept_cap"):
            psfield.PsfModel.from_function(draw, (40, 60), threshold=0.01)
        model = psfield.PsfModel.from_function(draw, (40, 60), threshold=0.01, accept_cap=True)
        assert (model.sampling.method, model.sampling.outcome) == ("mesh", "cell-size-reached")
        assert abs(model.sampling.worst_at[0] - 20) <= 1

    def test_a_regular_grid(self):
        model = psfield.PsfModel.from_function(
            lambda x, y: gaussian_stamp(1.0 + x / 99), (80, 100), uniform=(3, 4)
        )
        assert len(model.positions) == 12

    def test_images_of_galsim_are_taken(self):
        class Image:
            array = gaussian_stamp(1.0)

        assert psfield.PsfModel.from_function(lambda x, y: Image(), (10, 10)).evaluate(
            5, 5
        ).shape == (17, 17)

    def test_an_error_of_the_function_is_told(self):
        def draw(x, y):
            if x > 50:
                raise ZeroDivisionError("no such place")
            return gaussian_stamp(1.0)

        with pytest.raises(ValueError, match=r"could not be drawn: .*no such place") as caught:
            psfield.PsfModel.from_function(draw, (100, 100))
        assert isinstance(caught.value.__cause__, ZeroDivisionError)

    @pytest.mark.parametrize(
        ("draw", "text"),
        [
            (lambda x, y: np.full((5, 5), np.nan), "."),
            (lambda x, y: np.zeros((5, 5)), "flux"),
            (lambda x, y: np.ones((5, 5 if x < 50 else 7)), "shape"),
            (lambda x, y: np.ones(5), r"\[y, x\]"),
        ],
    )
    def test_what_is_no_psf(self, draw, text):
        with pytest.raises(ValueError, match=text):
            psfield.PsfModel.from_function(draw, (100, 100))

    @pytest.mark.parametrize(
        ("options", "text"),
        [
            ({"criterion": "best"}, "neighbours or interpolation"),
            ({"measure": "l3"}, "l1 or l2"),
            ({"threshold": -1.0}, "threshold|must be"),
            ({"start": (1, 5)}, "from 2 to 4096"),
            ({"max_draws": 30, "threshold": 1e-6}, "max_draws"),
            ({"method": "kriging", "start": (3, 3)}, "left out with the method kriging"),
            ({"method": "mesh", "verify": 3}, "left out with the method mesh"),
            ({"method": "grid"}, "kriging or mesh"),
        ],
    )
    def test_settings(self, options, text):
        with pytest.raises(ValueError, match=text):
            psfield.PsfModel.from_function(
                lambda x, y: gaussian_stamp(1.0 + x / 50 + (y / 70) ** 2), (100, 100), **options
            )


class TestFiles:
    """Files that psfield reads and writes."""

    def test_models_and_samples_come_back(self, model, tmp_path):
        for name in ("psf-model", "psf-samples"):
            path = tmp_path / f"{name}.fits"
            model.write(path, format=name, precision="f64")
            again = psfield.PsfModel.read(path)
            # Samples are fitted again, and kriging's equations amplify the rounding.
            assert relative_l2(again.evaluate(50, 50), model.evaluate(50, 50)) < 1e-9
        with pytest.raises(FileExistsError, match="the file exists"):
            model.write(path)
        model.write(path, overwrite=True)

    def test_psfex_and_libraries_come_back(self, model, tmp_path):
        model.write(tmp_path / "model.psf", format="psfex", degree=3)
        assert (
            relative_l2(
                psfield.PsfModel.read(tmp_path / "model.psf").evaluate(50, 50),
                model.evaluate(50, 50),
            )
            < 1e-2
        )
        model.write(tmp_path / "library.fits", format="gridded", grid_shape=(15, 15))
        assert (
            relative_l2(
                psfield.PsfModel.read(tmp_path / "library.fits").evaluate(50, 50),
                model.evaluate(50, 50),
            )
            < 1e-2
        )
        with pytest.raises(ValueError, match="format must be"):
            model.write(tmp_path / "x", format="fits")
        with pytest.raises(ValueError, match="degree"):
            model.write(tmp_path / "x", format="psfex")
        assert not (tmp_path / "x").exists()

    def test_trouble_is_an_oserror_that_names_the_file(self, model, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"none\.fits: cannot read the file"):
            psfield.PsfModel.read(tmp_path / "none.fits")
        (tmp_path / "text.fits").write_text("hello")
        with pytest.raises(OSError, match=r"text\.fits: this is not a FITS file"):
            psfield.PsfModel.read(tmp_path / "text.fits")
        with pytest.raises(FileNotFoundError, match="there is no directory"):
            model.write(tmp_path / "nowhere" / "model.fits")
        model.write(tmp_path / "model.fits")
        with pytest.raises(ValueError, match=r"detector applies to STDPSF .* \(detector=\)"):
            psfield.PsfModel.read(tmp_path / "model.fits", detector=1)
        with pytest.raises(ValueError, match="not fitted"):
            psfield.PsfModel.read(tmp_path / "model.fits", rank=3)


def test_models_are_made_by_name():
    with pytest.raises(TypeError, match="from_samples"):
        psfield.PsfModel()


def coloured():
    """Stamps at two positions and three wavelengths, their positions and wavelengths."""
    y, x = np.mgrid[-7:8, -7:8]
    positions, wavelengths, stamps = [], [], []
    for wavelength in (0.5, 0.6, 0.8):
        for px in (0.0, 40.0):
            width = 1 + wavelength + px / 100
            stamps.append(np.exp(-(x**2 + y**2) / (2 * width**2)))
            positions.append((px, 0.0))
            wavelengths.append(wavelength)
    return np.array(stamps), positions, wavelengths


def assert_near(found, expected, atol):
    assert np.abs(found - expected).max() < atol


def test_a_psf_of_several_wavelengths():
    stamps, positions, wavelengths = coloured()
    model = psfield.PsfModel.from_samples(
        stamps, positions, wavelengths_um=wavelengths, rank="full", noise=0
    )
    assert model.wavelengths_um.tolist() == wavelengths
    assert model.frame_numbers is None
    blue = model.at(wavelength_um=0.5)
    expected = stamps[1] / stamps[1].sum()
    assert_near(blue.evaluate(40.0, 0.0), expected, atol=1e-12)
    assert blue.wavelengths_um is None
    # Between wavelengths: a parabola through three.
    middle = model.at(wavelength_um=0.7).evaluate(0.0, 0.0)
    units = stamps[::2] / stamps[::2].sum(axis=(1, 2), keepdims=True)
    weights = np.array([-1 / 3, 1.0, 1 / 3])
    assert_near(middle, np.tensordot(weights, units, 1), atol=1e-12)
    for again in (pickle.loads(pickle.dumps(model)), pickle.loads(pickle.dumps(blue))):
        assert again.wavelengths_um is None or again.wavelengths_um.tolist() == wavelengths
    with pytest.raises(ValueError, match=r"0\.5 to 0\.8 um"):
        model.at(wavelength_um=1.0)
    with pytest.raises(ValueError, match="does not depend on the time"):
        model.at(time_s=1.0)
    with pytest.raises(ValueError, match="depends on the wavelength"):
        model.evaluate(0.0, 0.0)
    with pytest.raises(ValueError, match="give only one of"):
        psfield.PsfModel.from_samples(stamps, positions, wavelengths_um=wavelengths, times_s=[1])


def test_files_keep_the_wavelengths(tmp_path):
    stamps, positions, wavelengths = coloured()
    model = psfield.PsfModel.from_samples(stamps, positions, wavelengths_um=wavelengths, noise=0)
    model.write(tmp_path / "model.fits")
    again = psfield.PsfModel.read(tmp_path / "model.fits")
    assert again.wavelengths_um.tolist() == wavelengths
    chosen = psfield.PsfModel.read(tmp_path / "model.fits", wavelength_um=0.65)
    expected = model.at(wavelength_um=0.65).evaluate(5.0, 0.0)
    assert_near(chosen.evaluate(5.0, 0.0), expected, atol=1e-14)


def test_a_given_basis_is_kept():
    stamps, positions, _ = coloured()
    model = psfield.PsfModel.from_samples(stamps[:4], [(0, 0), (1, 0), (2, 0), (3, 0)], noise=0)
    other = psfield.PsfModel.from_samples(stamps[4:], positions[4:], basis=model)
    assert np.array_equal(other.components, model.components)
    unit = stamps[4:] / stamps[4:].sum(axis=(1, 2), keepdims=True)
    products = np.tensordot(unit - model.mean, model.components, ([1, 2], [1, 2]))
    assert_near(other.coefficients, products, atol=1e-12)
    with pytest.raises(ValueError, match="the basis has stamps of 15 x 15 pixels"):
        psfield.PsfModel.from_samples(
            stamps[:, 1:, 1:], positions[:1] * 6, times_s=range(6), basis=model
        )


def test_the_psf_of_a_spectrum(tmp_path):
    stamps, positions, wavelengths = coloured()
    model = psfield.PsfModel.from_samples(
        stamps, positions, wavelengths_um=wavelengths, rank="full", noise=0
    )
    # A narrow bandpass is a single wavelength.
    narrow = ([0.5999, 0.6, 0.6001], [0.0, 1.0, 0.0])
    alone = model.for_spectrum(narrow, "powerlaw:0").evaluate(10.0, 0.0)
    assert_near(alone, model.at(wavelength_um=0.6).evaluate(10.0, 0.0), atol=1e-7)
    wide = ([0.5, 0.55, 0.75, 0.8], [0.0, 1.0, 1.0, 0.0])
    (tmp_path / "band.csv").write_text("wavelength_nm,t\n500,0\n550,1\n750,1\n800,0\n")
    flat = ([0.4, 0.9], [1.0, 1.0])
    by_name = model.for_spectrum(tmp_path / "band.csv", "powerlaw:0").evaluate(0.0, 0.0)
    assert_near(model.for_spectrum(wide, flat).evaluate(0.0, 0.0), by_name, atol=1e-14)
    with pytest.raises(ValueError, match="no light in the bandpass"):
        model.for_spectrum(wide, ([2.0, 3.0], [1.0, 1.0]))
    with pytest.raises(ValueError, match="must ascend"):
        model.for_spectrum(([0.6, 0.5], [1.0, 1.0]), "powerlaw:0")
    with pytest.raises(TypeError, match="a name or a pair"):
        model.for_spectrum(3, "powerlaw:0")
    with pytest.raises(ValueError, match="does not depend on the wavelength"):
        model.at(wavelength_um=0.6).for_spectrum(wide, flat)


def parameters_of(model):
    return {
        "mean": model.mean,
        "components": model.components,
        "coefficients": model.coefficients,
    }


@pytest.fixture(scope="module")
def fitted():
    return widening_model((24, 24), across=3, size=9, rank=2)


@pytest.fixture(scope="module")
def given():
    """Three components that are not orthonormal."""
    rng = np.random.default_rng(7)
    return {
        "mean": gaussian_stamp(1.6, 9) + 1e-3 * rng.random((9, 9)),
        "components": 0.01 * rng.random((3, 9, 9)),
        "coefficients": rng.random((9, 3)),
    }


class TestParameters:
    """Models with other parameters."""

    def test_they_come_back(self, fitted, given):
        model = fitted.with_parameters(**given)
        for name, values in given.items():
            assert np.array_equal(getattr(model, name), values)
        assert model.rank == 3
        assert model.interpolation == fitted.interpolation
        assert np.array_equal(model.positions, fitted.positions)
        assert (model.field_shape, model.outside) == (fitted.field_shape, fitted.outside)
        coefficients = model.with_parameters(coefficients=2 * given["coefficients"])
        assert np.array_equal(coefficients.components, given["components"])
        assert np.array_equal(coefficients.coefficients, 2 * given["coefficients"])

    def test_own_parameters_change_nothing(self, fitted):
        for given in ({}, parameters_of(fitted), {"mean": fitted.mean.astype(">f8").tolist()}):
            again = fitted.with_parameters(**given)
            assert np.array_equal(again.evaluate(7.5, 3.25), fitted.evaluate(7.5, 3.25))
            for name, values in parameters_of(fitted).items():
                assert np.array_equal(getattr(again, name), values)

    @pytest.mark.parametrize("normalise", ["unit", "keep"])
    def test_psfs_are_sums_of_the_stamps(self, given, normalise):
        fitted = widening_model((24, 24), across=3, size=9, rank=2, normalise=normalise)
        model = fitted.with_parameters(**given)
        sums = given["mean"] + np.tensordot(given["coefficients"], given["components"], 1)
        if normalise == "unit":
            sums /= sums.sum((1, 2), keepdims=True)
        assert_near(model.evaluate(*model.positions.T), sums, atol=ROUNDING)
        other = fitted.with_parameters(**{**given, "coefficients": 2 * given["coefficients"]})
        assert np.abs(other.evaluate(*model.positions.T) - sums).max() > 1e-3

    def test_interpolated_psfs_are_linear_in_the_coefficients(self, given):
        fitted = widening_model((24, 24), across=3, size=9, rank=2, normalise="keep")

        def psf(scale):
            changed = {**given, "coefficients": scale * given["coefficients"]}
            return fitted.with_parameters(**changed).evaluate(7.5, 3.25)

        assert_near(psf(3) - psf(2), psf(2) - psf(1), atol=ROUNDING)

    def test_pickled(self, fitted, given):
        model = fitted.with_parameters(**given)
        again = pickle.loads(pickle.dumps(model))
        assert np.array_equal(again.evaluate(7.5, 3.25), model.evaluate(7.5, 3.25))
        assert again.interpolation == model.interpolation
        for name in ("mean", "components", "coefficients"):
            assert np.array_equal(getattr(again, name), getattr(model, name))

    def test_plans_of_other_parameters(self, fitted, given):
        model = fitted.with_parameters(**given)
        scene = np.random.default_rng(1).random((24, 24))
        found = fitted.plan((24, 24), 0.0, "f64").with_psf(model).simulate(scene)
        assert_near(found, direct_sum(model, scene), atol=ROUNDING)

    @pytest.mark.parametrize(
        ("bad", "error", "text"),
        [
            ({"mean": np.ones(9)}, ValueError, r"mean must be an array \[y, x\]"),
            ({"components": np.ones(9)}, ValueError, r"components must be an array \[component"),
            ({"coefficients": np.ones(9)}, ValueError, r"coefficients must be .* \[position"),
            ({"mean": np.ones((3, 3))}, ValueError, r"3 x 3 pixels .* have 9 x 9 \(mean=\)"),
            ({"components": np.ones((2, 8, 9))}, ValueError, r"8 x 9 pixels .* \(components=\)"),
            ({"components": np.ones((1, 9, 9))}, ValueError, "coefficients, .* expected 1, got 2"),
            ({"coefficients": np.ones((9, 1))}, ValueError, "coefficients, .* expected 2, got 1"),
            ({"coefficients": np.ones((8, 2))}, ValueError, "coefficients, .* expected 9, got 8"),
            ({"mean": np.full((9, 9), np.nan)}, ValueError, r"not finite \(mean=\)"),
            ({"coefficients": np.full((9, 2), np.inf)}, ValueError, "coefficient .*finite"),
            ({"components": np.full((2, 9, 9), np.nan)}, ValueError, r"finite \(components=\)"),
            ({"coefficients": np.ones((9, 2)) * 1j}, TypeError, "coefficients must be real"),
        ],
    )
    def test_refused(self, fitted, bad, error, text):
        with pytest.raises(error, match=text):
            fitted.with_parameters(**bad)

    def test_wings_and_missing_means_are_refused(self, tmp_path):
        widening_model((24, 24), across=3, size=41).write(tmp_path / "core.fits")
        with_wings = psfield.PsfModel.read(tmp_path / "core.fits", wings="power=3,40")
        with pytest.raises(ValueError, match="PSF with wings"):
            with_wings.with_parameters()
        uncentred = widening_model((24, 24), across=3, size=9, centring="none")
        with pytest.raises(ValueError, match="has no mean stamp"):
            uncentred.with_parameters(mean=np.ones((9, 9)))


@pytest.mark.parametrize("words", [{}, {"oversample": 2}, {"region": (3, 2, 11, 13)}])
def test_the_adjoint_of_a_stack_is_that_of_each_image(words):
    plan = widening_model((24, 24), across=3, size=9).plan((24, 24), 1e-5, **words)
    images = np.random.default_rng(3).random((2, 3, *plan.image_shape), np.float32)
    steps = []
    back = plan.adjoint(images, progress=lambda *step: steps.append(step))
    assert steps[-1][0] == steps[-1][1]
    for index in np.ndindex(2, 3):
        assert np.array_equal(back[index], plan.adjoint(images[index]))
    assert not np.array_equal(back[0, 0], back[1, 0])


def test_the_adjoint_of_a_stack_in_colour():
    stamps, positions, wavelengths = coloured()
    model = psfield.PsfModel.from_samples(stamps, positions, wavelengths_um=wavelengths, noise=0)
    band = ([0.5, 0.55, 0.75, 0.8], [0.0, 1.0, 1.0, 0.0])
    plan = model.plan((20, 30), 1e-5, bandpass=band, sed="powerlaw:0")
    images = np.random.default_rng(3).random((3, 20, 30), np.float32)
    names = "blackbody:3000", "powerlaw:0"
    of_each = {name: plan.adjoint(images, spectra=[name])[name] for name in names}
    for name, back in of_each.items():
        assert back.shape == images.shape
        loop = [plan.adjoint(image, spectra=[name])[name] for image in images]
        assert np.array_equal(back, loop)
    assert np.array_equal(plan.adjoint(images), of_each["powerlaw:0"])
    assert not np.array_equal(*of_each.values())

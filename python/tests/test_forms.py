"""The forms in which arguments are accepted: spellings, types, files, single values."""

from __future__ import annotations

import inspect
import json
import re

import numpy as np
import pytest
from conftest import gaussian_stamp

import psfield
from psfield import _native, detector, metrics

CORNERS = [(0, 0), (79, 0), (0, 59), (79, 59)]
STAMPS = np.stack([gaussian_stamp(s) for s in (1.2, 1.5, 1.3, 1.8)])
STARS = {"x": [10.0, 70.0, 33.0], "y": [20.0, 3.0, 41.0], "flux": [100.0, 50.0, 10.0]}


@pytest.fixture(scope="module")
def plan():
    """A plan for images of 60 x 80 pixels."""
    return psfield.PsfModel.from_samples(STAMPS, CORNERS).plan((60, 80), 1e-3)


class TestPrecision:
    """Precisions by name and as types of NumPy."""

    @pytest.mark.parametrize(
        ("precision", "dtype"),
        [
            ("f32", np.float32),
            ("float32", np.float32),
            ("single", np.float32),
            (np.float32, np.float32),
            (np.dtype("f4"), np.float32),
            ("f64", np.float64),
            ("float64", np.float64),
            ("f8", np.float64),
            (float, np.float64),
            (np.float64, np.float64),
            (np.dtype("f8"), np.float64),
            (np.dtype(">f8"), np.float64),
        ],
    )
    def test_plans(self, plan, precision, dtype):
        made = plan.model.plan((6, 8), precision=precision)
        assert made.dtype == dtype
        assert made.summary.precision == ("f32" if dtype == np.float32 else "f64")
        assert repr(made) == repr(plan.model.plan((6, 8), precision=made.dtype))

    def test_samples(self, plan, tmp_path):
        fits = pytest.importorskip("astropy.io.fits")
        for precision, bits in ((np.float64, -64), ("float32", -32)):
            path = tmp_path / f"{bits}.fits"
            plan.model.write(path, format="psf-samples", precision=precision)
            with fits.open(path) as hdus:
                images = [hdu.header["BITPIX"] for hdu in hdus if hdu.is_image and hdu.shape]
            assert images == [bits]

    def test_dask(self, plan):
        da = pytest.importorskip("dask.array")
        import psfield.dask

        scene = da.zeros((60, 80), chunks=30)
        assert psfield.dask.simulate(scene, plan.model, precision=np.float64).dtype == np.float64

    @pytest.mark.parametrize("precision", ["f16", np.float16, "int32", "", np.dtype("f4,f8")])
    def test_other_types_are_refused(self, plan, precision):
        with pytest.raises(ValueError, match="precision must be f32 or f64"):
            plan.model.plan((6, 8), precision=precision)


class TestCatalogues:
    """Catalogues as tables, files and single numbers."""

    def test_a_single_flux(self, plan):
        same = {**STARS, "flux": [7.0, 7.0, 7.0]}
        expected = plan.simulate(catalog=same)
        for flux in (7.0, 7, np.float32(7.0)):
            assert np.array_equal(plan.simulate(catalog={**STARS, "flux": flux}), expected)
        assert plan.spot_check(catalog={**STARS, "flux": 7.0}, image=expected).passed

    def test_a_single_star(self, plan):
        expected = plan.simulate(catalog={"x": [10.0], "y": [20.0], "flux": [5.0]})
        one = {"x": 10.0, "y": 20.0, "flux": 5.0}
        assert np.array_equal(plan.simulate(catalog=one), expected)
        with pytest.warns(psfield.PsfieldWarning, match="there are no sources"):
            assert not plan.simulate(catalog={"x": [], "y": [], "flux": 5.0}).any()

    def test_a_single_flux_with_a_unit(self, plan):
        units = pytest.importorskip("astropy.units")
        scene = np.zeros((60, 80)) * units.Jy
        image = plan.simulate(scene, {**STARS, "flux": 7000 * units.mJy})
        expected = plan.simulate(catalog={**STARS, "flux": 7.0})
        assert np.allclose(image.value, expected, atol=1e-6)

    @pytest.mark.parametrize("names", [("x_0", "y_0"), ("X_0", "Y_0"), ("x", "y_0")])
    def test_the_columns_of_photutils(self, plan, names):
        table = {names[0]: STARS["x"], names[1]: STARS["y"], "flux": STARS["flux"]}
        expected = plan.simulate(catalog=STARS)
        assert np.array_equal(plan.simulate(catalog=table), expected)
        # Columns x and y come first.
        table |= {"x": STARS["x"], "y": STARS["y"], "x_0": [0.0] * 3, "y_0": [0.0] * 3}
        assert np.array_equal(plan.simulate(catalog=table), expected)

    @pytest.mark.parametrize("kind", [str, lambda path: path])
    @pytest.mark.parametrize("header", ["x,y,flux", "x_0,y_0,flux", "flux,Y_0,X_0"])
    def test_csv_files(self, plan, tmp_path, header, kind):
        columns = {name.lower()[0]: values for name, values in STARS.items()}
        rows = zip(*(columns[name.lower()[0]] for name in header.split(",")))
        path = tmp_path / "stars.csv"
        path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
        expected = plan.simulate(catalog=STARS)
        assert np.array_equal(plan.simulate(catalog=kind(path)), expected)
        assert plan.spot_check(catalog=kind(path), image=expected).passed

    def test_fits_files(self, plan, tmp_path):
        table = pytest.importorskip("astropy.table")
        path = tmp_path / "stars.fits"
        table.Table({"x_0": STARS["x"], "y_0": STARS["y"], "flux": STARS["flux"]}).write(path)
        assert np.array_equal(plan.simulate(catalog=path), plan.simulate(catalog=STARS))

    def test_files_on_dask(self, plan, tmp_path):
        da = pytest.importorskip("dask.array")
        import psfield.dask

        path = tmp_path / "stars.csv"
        path.write_text("x,y,flux\n10,20,100\n70,3,50\n33,41,10\n")
        scene = da.zeros((60, 80), chunks=60)
        image = psfield.dask.simulate(scene, plan.model, 1e-3, catalog=path).compute()
        assert np.allclose(image, plan.simulate(catalog=STARS), atol=1e-4)

    def test_errors_of_files(self, plan, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"none\.csv"):
            plan.simulate(catalog=tmp_path / "none.csv")
        path = tmp_path / "bad.csv"
        path.write_text("x,y,brightness\n1,2,3\n")
        with pytest.raises(OSError, match=r"bad\.csv.*flux"):
            plan.simulate(catalog=path)
        # The error is that of the columns x and y, not that of x_0 and y_0.
        path.write_text("ra_2000,dec_2000,flux\n1,2,3\n")
        with pytest.raises(OSError, match='"x"'):
            psfield.read_catalog(path)
        path.write_text("x_0,y_0,brightness\n1,2,3\n")
        stars = psfield.read_catalog(path, columns="flux=brightness")
        assert (stars["x"].tolist(), stars["flux"].tolist()) == ([1.0], [3.0])

    @pytest.mark.parametrize("call", ["simulate", "spot_check"])
    def test_a_table_as_the_scene(self, plan, call):
        rows = np.zeros(2, dtype=[("x", float), ("y", float), ("flux", float)])
        tables = [STARS, rows]
        try:
            from astropy.table import Table
        except ImportError:
            pass
        else:
            tables.append(Table(STARS))
        for table in tables:
            with pytest.raises(TypeError, match="got a table: did you mean catalog=\\?"):
                getattr(plan, call)(table)
        with pytest.raises(TypeError, match=r"path 'stars\.csv': did you mean catalog=\?"):
            getattr(plan, call)("stars.csv")


class TestPositions:
    """Positions of stamps and stars."""

    def test_the_columns_of_photutils(self):
        x, y = (np.array(axis) for axis in zip(*CORNERS))
        model = psfield.PsfModel.from_samples(STAMPS, {"x_0": x, "y_0": y})
        assert model.positions.tolist() == [list(map(float, corner)) for corner in CORNERS]
        with pytest.raises(ValueError, match="a table with columns x and y"):
            psfield.PsfModel.from_samples(STAMPS, {"x_0": x})

    def test_a_single_pair(self):
        model = psfield.PsfModel.from_samples(STAMPS[:1], (3, 4))
        assert model.positions.tolist() == [[3.0, 4.0]]


class TestSingleStamps:
    """A stamp ``[y, x]`` where a stack of stamps is accepted."""

    def test_samples(self):
        stack = psfield.PsfModel.from_samples(STAMPS[:1], [(3, 4)])
        for stamp in (STAMPS[0], STAMPS[0].tolist()):
            single = psfield.PsfModel.from_samples(stamp, [(3, 4)])
            assert np.array_equal(single.evaluate(3, 4), stack.evaluate(3, 4))

    def test_components(self):
        component = STAMPS[0] / np.linalg.norm(STAMPS[0])
        model = psfield.PsfModel.from_basis(None, component, [[2.0]], (3, 4))
        assert model.components.shape == (1, 17, 17)

    def test_measurements(self):
        one, many = metrics.measure(STAMPS[0]), metrics.measure(STAMPS)
        assert one["fwhm_px"].shape == (1,) and one["fwhm_px"][0] == many["fwhm_px"][0]


class TestSpellings:
    """American spellings of arguments and values."""

    def test_samples(self):
        british = psfield.PsfModel.from_samples(
            STAMPS, CORNERS, centre=(7.5, 8.0), centring="none", normalise="keep"
        )
        american = psfield.PsfModel.from_samples(
            STAMPS, CORNERS, center=(7.5, 8.0), centering="none", normalize="keep"
        )
        assert american.centre == british.centre == (7.5, 8.0)
        assert american.normalise == british.normalise == "keep"
        assert american.mean is None and british.mean is None

    def test_the_other_constructors(self, plan, tmp_path):
        model = plan.model
        basis = (model.mean, model.components, model.coefficients, model.positions)
        made = psfield.PsfModel.from_basis(*basis, center=(7.0, 8.0), normalize="keep")
        assert (made.centre, made.normalise) == ((7.0, 8.0), "keep")
        made = psfield.PsfModel.from_function(
            lambda x, y: STAMPS[0], (10, 10), center=(7.0, 8.0), criterion="neighbors", noise=0
        )
        assert made.centre == (7.0, 8.0)
        model.write(tmp_path / "model.fits")
        read = psfield.PsfModel.read(tmp_path / "model.fits", normalize="keep")
        assert read.normalise == "keep"
        with pytest.raises(ValueError, match="ScopeSim"):
            psfield.PsfModel.read(tmp_path / "model.fits", field_center=(3, 4))

    def test_values(self):
        options = {"field_shape": (60, 80), "noise": 0}
        american, british = (
            psfield.PsfModel.from_samples(STAMPS, CORNERS, interpolation=name, **options)
            for name in ("natural-neighbor", "natural-neighbour")
        )
        assert american.interpolation == british.interpolation == "natural-neighbour"

    def test_one_spelling_at_a_time(self):
        with pytest.raises(TypeError, match="centre is given in two spellings"):
            psfield.PsfModel.from_samples(STAMPS, CORNERS, centre=(8, 8), center=(8, 8))
        for wrong in ({"centr": (8, 8)}, {"field_center": (3, 4)}, {"american": 1}):
            with pytest.raises(TypeError, match=f"from_samples.* has no argument '{min(wrong)}'"):
                psfield.PsfModel.from_samples(STAMPS, CORNERS, **wrong)

    def test_signatures_are_those_of_the_documentation(self):
        names = inspect.signature(psfield.PsfModel.from_samples).parameters
        assert {"stamps", "centre", "normalise"} <= set(names)
        assert not {"american", "center", "kwargs"} & set(names)


class TestDetector:
    """The parameters of a detector."""

    def test_the_signature_has_names_and_defaults(self):
        parameters = inspect.signature(detector.Detector).parameters
        own = {name: parameter.default for name, parameter in parameters.items()}
        # The library omits parameters without a value.
        library = json.loads(_native.Detector({}).params())
        assert {name: value for name, value in own.items() if value is not None} == library
        assert all(p.kind is inspect.Parameter.KEYWORD_ONLY for p in parameters.values())
        # Every optional parameter is one of the library's.
        given = {"sky_gradient_e_per_px": {"x": 0.1, "y": 0.0}}
        given |= {name: 1 for name, value in own.items() if value is None and name not in given}
        assert set(detector.Detector(**given).params) == set(own)

    def test_defaults_are_those_of_the_library(self):
        explicit = inspect.signature(detector.Detector).bind()
        explicit.apply_defaults()
        made = detector.Detector(**explicit.arguments)
        assert made.params == detector.Detector().params and repr(made) == "Detector()"

    def test_other_names_are_refused(self):
        with pytest.raises(TypeError, match="reed_noise"):
            detector.Detector(reed_noise=1.0)


def test_no_message_names_an_option_of_the_command_line(plan, tmp_path):
    """Errors and warnings name the arguments of Python, such as ``frame=``."""
    model = plan.model
    model.write(tmp_path / "model.fits")
    (tmp_path / "mag.csv").write_text("x,y,mag\n1,2,20\n")
    (tmp_path / "flux.csv").write_text("x,y,flux\n1,2,20\n")
    (tmp_path / "sky.csv").write_text("ra,dec,flux\n1,2,20\n")
    file, field = tmp_path / "model.fits", psfield.PsfModel.from_samples
    galaxy = {"x": 5.0, "y": 7.0, "flux": 1.0, "re": 5.0, "n": 1.0}
    calls = [
        lambda: model.write(file),
        lambda: psfield.PsfModel.read(file, detector=1),
        lambda: psfield.PsfModel.read(file, extension=1),
        lambda: psfield.PsfModel.read(file, plane_order="x"),
        lambda: psfield.PsfModel.read(file, wavelength_um=1.0),
        lambda: psfield.PsfModel.read(file, pixel_scale_arcsec=1.0),
        lambda: psfield.PsfModel.read(file, field_centre=(1, 1)),
        lambda: psfield.PsfModel.read(file, positions=[(1, 1)]),
        lambda: psfield.PsfModel.read(file, centre=(1, 1)),
        lambda: psfield.PsfModel.read(file, oversampling=2.0),
        lambda: psfield.PsfModel.read(file, rank=3),
        lambda: model.write(tmp_path / "x.psf", format="psfex"),
        lambda: field(STAMPS, CORNERS, field_shape=(60, 80)).plan((90, 90)),
        lambda: model.plan((61, 80), oversample=2),
        lambda: model.plan((60, 80), oversample=1000),
        lambda: plan.simulate(catalog={"x": 1.0, "y": 1.0, "flux": 1e300}),
        lambda: psfield.read_catalog(tmp_path / "mag.csv"),
        lambda: psfield.read_catalog(tmp_path / "flux.csv", zero_point=25.0),
        lambda: psfield.read_catalog(
            tmp_path / "sky.csv", one_based=True, wcs=tmp_path / "model.fits"
        ),
        lambda: psfield.read_catalog(tmp_path / "sky.csv", one_based=True),
        lambda: psfield.read_catalog(tmp_path / "sky.csv"),
        lambda: model.plan((60, 80), region=(0, 0, 200, 10)),
    ]
    texts = []
    for call in calls:
        with pytest.raises((OSError, ValueError)) as caught:
            call()
        texts.append(str(caught.value))
    with pytest.warns(psfield.PsfieldWarning) as warned:
        plan.simulate(catalog=galaxy)
    texts += [str(warning.message) for warning in warned]
    assert [text for text in texts if re.search(r"(?<![\w-])--\w", text)] == []

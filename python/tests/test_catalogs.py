"""Stars and galaxies."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import gaussian_stamp

import psfield


@pytest.fixture(scope="module")
def plan():
    """A plan with stamps of four pixels per frame pixel."""
    stamps = [16 * gaussian_stamp(s, 65) for s in (5.0, 6.0, 5.5, 6.5)]
    model = psfield.PsfModel.from_samples(
        stamps, [(0, 0), (79, 0), (0, 59), (79, 59)], oversampling=4
    )
    return model.plan((60, 80), 1e-3, "f64")


STARS = {"x": [10.25, 70.0, -1.5], "y": [20.5, 3.0, 30.0], "flux": [100.0, 50.0, 1000.0]}
GALAXIES = {
    "x": [40.0, 10.0],
    "y": [30.0, 50.0],
    "flux": [1e3, 10.0],
    "re": [4.0, 0.0],
    "n": [1.0, np.nan],
    "q": [0.5, 1.0],
    "angle": [30.0, 0.0],
}


def test_stars_are_drawn_at_their_positions(plan):
    image = plan.simulate(catalog={"x": [33.3], "y": [22.2], "flux": [100.0]})
    y, x = np.mgrid[:60, :80]
    assert image.sum() == pytest.approx(100.0, rel=1e-3)
    assert (image * x).sum() / image.sum() == pytest.approx(33.3, abs=1e-3)
    assert (image * y).sum() / image.sum() == pytest.approx(22.2, abs=1e-3)


def test_stars_add_to_the_scene(plan):
    scene = np.random.default_rng(1).random((60, 80))
    both = plan.simulate(scene, STARS)
    assert np.allclose(
        both, plan.simulate(scene) + plan.simulate(catalog=STARS), rtol=1e-12, atol=1e-12
    )


def test_light_from_off_the_frame_shines_in(plan):
    image = plan.simulate(catalog={"x": [-1.5], "y": [30.0], "flux": [1000.0]})
    assert 50 < image.sum() < 500 and image[:, 20:].max() < 1e-6


def test_galaxies_have_their_flux_and_shape(plan):
    image = plan.simulate(catalog=GALAXIES)
    y, x = np.mgrid[:60, :80]
    disc = image.copy()
    disc[40:, :20] = 0.0
    assert image.sum() == pytest.approx(
        1010.0, rel=0.02
    )  # The wings of the disc extend beyond the frame.
    dx, dy = x - 40.0, y - 30.0
    # The major axis is 30 degrees from +x towards +y.
    angle = 0.5 * np.arctan2(2 * (disc * dx * dy).sum(), (disc * (dx**2 - dy**2)).sum())
    assert np.degrees(angle) == pytest.approx(30.0, abs=1.0)


def as_astropy(columns):
    table = pytest.importorskip("astropy.table")
    return table.Table(columns)


def as_quantities(columns):
    table, u = pytest.importorskip("astropy.table"), pytest.importorskip("astropy.units")
    units = {"x": u.pix, "y": u.pix, "re": u.pix, "angle": u.deg}
    quantities = {
        name: values * units[name] if name in units else values for name, values in columns.items()
    }
    quantities = {
        name: np.array(v) if not hasattr(v, "unit") else v for name, v in quantities.items()
    }
    if "angle" in quantities:
        quantities["angle"] = quantities["angle"].to(u.rad)
    return table.QTable(quantities)


def as_structured(columns):
    names = list(columns)
    rows = np.zeros(
        len(columns["x"]), dtype=[(name.upper(), ">f4" if name == "q" else ">f8") for name in names]
    )
    for name in names:
        rows[name.upper()] = columns[name]
    return rows


def as_masked(columns):
    table = pytest.importorskip("astropy.table")
    masked = table.Table(columns, masked=True)
    masked["n"].mask = np.asarray(columns["re"]) == 0
    return masked


@pytest.mark.parametrize(
    "form",
    [
        as_astropy,
        as_quantities,
        as_structured,
        as_masked,
        lambda c: {k: tuple(v) for k, v in c.items()},
    ],
)
def test_tables_of_any_kind(plan, form):
    assert np.allclose(
        plan.simulate(catalog=form(GALAXIES)),
        plan.simulate(catalog=GALAXIES),
        rtol=1e-12,
        atol=1e-15,
    )


def test_an_empty_catalogue_makes_a_dark_image(plan):
    empty = {"x": [], "y": [], "flux": []}
    with pytest.warns(psfield.PsfieldWarning, match="there are no sources"):
        assert not plan.simulate(catalog=empty).any()


def test_a_negative_flux_is_drawn(plan):
    image = plan.simulate(catalog={"x": [33.0], "y": [22.0], "flux": [-100.0]})
    assert image.min() < 0 and not (image > 1e-12).any()


def test_shear_is_applied_to_the_ellipse(plan):
    place = {"x": 40.0, "y": 30.0, "flux": 1e3, "n": 1.0}
    q = 0.8 / 1.2
    angle = np.degrees(np.arctan2(0.12, -0.16)) / 2
    sheared = plan.simulate(catalog={**place, "re": 4.0, "g1": -0.16, "g2": 0.12})
    ellipse = {"re": 4.0 / np.sqrt(q), "q": q, "angle": angle}
    same = plan.simulate(catalog={**place, **ellipse})
    assert np.allclose(sheared, same, rtol=1e-12, atol=1e-12)
    # The opposite shear makes the ellipse round again.
    opposite = plan.simulate(catalog={**place, **ellipse, "g1": 0.16, "g2": -0.12})
    assert np.allclose(opposite, plan.simulate(catalog={**place, "re": 4.0}), rtol=1e-6, atol=1e-6)
    # Stars have no shear: in a table of stars, g1 may mean anything.
    star = {"x": [40.0], "y": [30.0], "flux": [1.0]}
    with_g1 = plan.simulate(catalog={**star, "g1": [np.nan]})
    assert np.array_equal(with_g1, plan.simulate(catalog=star))


@pytest.mark.parametrize(
    ("catalog", "error", "text"),
    [
        ({"x": [1.0], "y": [1.0]}, ValueError, '"flux": there is no such column'),
        (
            {"x": [1.0], "y": [1.0, 2.0], "flux": [1.0]},
            ValueError,
            'column "y": the column has 2 rows',
        ),
        (
            {"x": [1.0, np.nan], "y": [1.0, 1.0], "flux": [1.0, 1.0]},
            ValueError,
            r"row 1 \(0-based\)",
        ),
        ({"x": [1.0], "y": [1.0], "flux": [np.inf]}, ValueError, r"row 0"),
        ({"x": [1.0], "y": [1.0], "flux": [np.nan]}, ValueError, r"row 0"),
        (
            {"x": [1.0], "y": [1.0], "flux": [0.0]},
            ValueError,
            r'row 0.*"flux": the flux.* is 0',
        ),
        ({**GALAXIES, "re": [4.0, np.nan]}, ValueError, r"row 1.*write 0 for a star"),
        ({**GALAXIES, "g1": 0.6, "g2": -0.8}, ValueError, "row 0.*reduced shear"),
        ({**GALAXIES, "g1": 0.6}, ValueError, "a shear needs both columns g1 and g2"),
        ({"x": ["a"], "y": [1.0], "flux": [1.0]}, TypeError, "x must be real numbers"),
        ({"x": [[1.0]], "y": [1.0], "flux": [1.0]}, ValueError, "x must be a column"),
        ({**GALAXIES, "n": [9.0, 1.0]}, ValueError, "row 0.*Sersic index"),
        ({**GALAXIES, "q": [0.0, 1.0]}, ValueError, "row 0.*axis ratio"),
        ({**GALAXIES, "re": [-1.0, 1.0]}, ValueError, "half-light radius"),
        (
            {k: v for k, v in GALAXIES.items() if k != "n"},
            ValueError,
            "need their Sersic index",
        ),
        ([1.0, 2.0], TypeError, "catalog must be the path of a file or a table"),
        (np.zeros(3), TypeError, "catalog must be the path of a file or a table"),
    ],
)
def test_bad_catalogues(plan, catalog, error, text):
    with pytest.raises(error, match=text):
        plan.simulate(catalog=catalog)


def test_a_flux_beyond_single_precision(plan):
    single = plan.model.plan((60, 80))
    with pytest.raises(ValueError, match="beyond single precision"):
        single.simulate(catalog={"x": [1.0], "y": [1.0], "flux": [1e300]})


def test_coarse_stamps_are_warned_of():
    model = psfield.PsfModel.from_samples([gaussian_stamp(1.5)], [(0, 0)])
    plan = model.plan((40, 40))
    plan.simulate(catalog={"x": [5.0], "y": [7.0], "flux": [1.0]})
    with pytest.warns(psfield.PsfieldWarning, match="too coarse to be interpolated"):
        plan.simulate(catalog={"x": [5.5], "y": [7.0], "flux": [1.0]})


def test_galaxies_from_coarse_stamps_are_warned_of(plan):
    galaxy = {"x": [5.0], "y": [7.0], "flux": [1.0], "re": [5.0], "n": [1.0]}
    plan.simulate(catalog=galaxy)
    coarse = psfield.PsfModel.from_samples([gaussian_stamp(1.5)], [(0, 0)]).plan((40, 40))
    # Every galaxy is interpolated, also on the centre of a pixel.
    with pytest.warns(psfield.PsfieldWarning, match="too coarse to be interpolated"):
        coarse.simulate(catalog=galaxy)


def test_galaxies_do_not_depend_on_the_pixels_of_the_scene(plan):
    finer = plan.model.plan((240, 320), 1e-3, "f64", oversample=4)
    assert np.allclose(
        finer.simulate(catalog=GALAXIES),
        plan.simulate(catalog=GALAXIES),
        rtol=1e-12,
        atol=1e-15,
    )


class TestFiles:
    """Catalogues from files."""

    def test_csv(self, tmp_path):
        path = tmp_path / "stars.csv"
        path.write_text("X_IMAGE,Y_IMAGE,MAG_AUTO\n11.5,3,20\n1,1,22.5\n")
        stars = psfield.read_catalog(
            path, columns="x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO", one_based=True, zero_point=25.0
        )
        assert {name: values.tolist() for name, values in stars.items()} == {
            "x": [10.5, 0.0],
            "y": [2.0, 0.0],
            "flux": pytest.approx([100.0, 10.0]),
        }

    def test_galaxies_come_after_stars(self, tmp_path, plan):
        path = tmp_path / "sources.csv"
        path.write_text("x,y,flux,re,n,q,angle\n40,30,1000,4,1,0.5,30\n10,50,10,0,,,\n")
        catalog = psfield.read_catalog(path)
        assert catalog["re"].tolist() == [0.0, 4.0]
        assert np.allclose(
            plan.simulate(catalog=catalog), plan.simulate(catalog=GALAXIES), rtol=1e-12, atol=1e-15
        )

    def test_bad_rows(self, tmp_path):
        path = tmp_path / "bad.csv"
        path.write_text("x,y,flux\n1,2,3\n1,oops,3\n")
        with pytest.raises(OSError, match=r"bad\.csv.*line 3"):
            psfield.read_catalog(path)
        with pytest.raises(FileNotFoundError):
            psfield.read_catalog(tmp_path / "none.csv")
        path.write_text("x,y,flux\n1,2,3\n1,2,0\n")
        with pytest.raises(OSError, match=r"line 3.*flux of the source is 0.*\(skip_invalid=\)"):
            psfield.read_catalog(path)
        path.write_text("x,y,flux\n1,2,3\n1,nan,3\n")
        with pytest.warns(psfield.PsfieldWarning, match="1 row skipped: invalid"):
            assert len(psfield.read_catalog(path, skip_invalid=True)["x"]) == 1
        with pytest.raises(ValueError, match="columns"):
            psfield.read_catalog(path, columns="z=Z")

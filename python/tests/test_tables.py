"""Units and masks mean the same in every kind of table, and so do columns that are not read."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import gaussian_stamp

import psfield

table = pytest.importorskip("astropy.table")
u = pytest.importorskip("astropy.units")
Masked = pytest.importorskip("astropy.utils.masked").Masked

#: One galaxy and one star.
PLAIN = {
    "x": [40.0, 10.0],
    "y": [30.0, 50.0],
    "flux": [1e3, 10.0],
    "re": [4.0, 0.0],
    "n": [1.0, 1.0],
    "q": [0.5, 1.0],
    "angle": [30.0, 0.0],
}


@pytest.fixture(scope="module")
def plan():
    """A plan with stamps of four pixels per frame pixel."""
    stamp = 16 * gaussian_stamp(5.0, 65)
    model = psfield.PsfModel.from_samples([stamp], (0, 0), oversampling=4)
    return model.plan((60, 80), 1e-3, "f64")


def as_table(columns, units, masked, folder):
    made = table.Table({name: np.array(values) for name, values in columns.items()})
    return with_units(made, units, masked)


def as_qtable(columns, units, masked, folder):
    return table.QTable(as_table(columns, units, masked, folder))


def as_fits(columns, units, masked, folder):
    path = folder / "table.fits"
    as_table(columns, units, masked, folder).write(path, overwrite=True)
    return path


def as_ecsv(columns, units, masked, folder):
    path = folder / "table.ecsv"
    as_table(columns, units, masked, folder).write(path, overwrite=True)
    return path


def as_ecsv_with_commas(columns, units, masked, folder):
    path = folder / "commas.ecsv"
    as_table(columns, units, masked, folder).write(path, delimiter=",", overwrite=True)
    return path


def as_masked_quantities(columns, units, masked, folder):
    made = {}
    for name, values in columns.items():
        hidden = np.array([name == masked and row == 0 for row in range(len(values))])
        made[name] = Masked(np.array(values), mask=hidden)
        if name in units:
            made[name] = made[name] << units[name]
    return made


def as_csv(columns, units, masked, folder):
    path = folder / "table.csv"
    as_table(columns, {}, masked, folder).write(path, overwrite=True)
    return path


def as_data_frame(columns, units, masked, folder):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(columns)
    if masked:
        frame[masked] = frame[masked].astype("Float64")
        frame.loc[0, masked] = pandas.NA
    return frame


def as_structured(columns, units, masked, folder):
    return np.ma.MaskedArray(as_table(columns, {}, masked, folder).as_array())


def with_units(made, units, masked):
    for name, unit in units.items():
        made[name].unit = unit
    if masked:
        made[masked] = table.MaskedColumn(made[masked])
        made[masked].mask[0] = True
    return made


WITH_UNITS = [as_table, as_qtable, as_fits, as_ecsv, as_ecsv_with_commas, as_masked_quantities]
WITHOUT_UNITS = [as_csv, as_data_frame, as_structured]


@pytest.mark.parametrize("form", WITH_UNITS)
@pytest.mark.parametrize(
    ("name", "unit", "values"),
    [
        ("angle", u.rad, np.radians([30.0, 0.0])),
        ("angle", u.arcmin, [1800.0, 0.0]),
        ("flux", u.mJy, [1e6, 1e4]),
        ("flux", u.Jy, [1e3, 10.0]),
        ("x", u.pix, [40.0, 10.0]),
        ("re", u.pix, [4.0, 0.0]),
    ],
)
def test_units_are_converted(plan, tmp_path, form, name, unit, values):
    dark = np.zeros((60, 80)) << u.Jy
    expected = plan.simulate(dark, PLAIN | {"flux": np.array(PLAIN["flux"]) << u.Jy})
    given = form(PLAIN | {name: values}, {"flux": u.Jy} | {name: unit}, None, tmp_path)
    assert np.allclose(plan.simulate(dark, given), expected, rtol=1e-9, atol=1e-12 * u.Jy)


@pytest.mark.parametrize("form", WITH_UNITS)
@pytest.mark.parametrize(
    ("name", "unit"),
    [("re", u.arcsec), ("x", u.deg), ("angle", u.m), ("flux", u.ct), ("flux", u.mag)],
)
def test_other_units_are_refused(plan, tmp_path, form, name, unit):
    dark = np.zeros((60, 80)) << u.Jy
    with pytest.raises((ValueError, OSError), match=name):
        plan.simulate(dark, form(PLAIN, {"flux": u.Jy} | {name: unit}, None, tmp_path))


@pytest.mark.parametrize("form", WITH_UNITS + WITHOUT_UNITS)
@pytest.mark.parametrize("name", ["x", "flux", "re"])
def test_masked_values_are_not_drawn(plan, tmp_path, form, name):
    """No number that a mask hides, and no fill value, becomes a source."""
    catalog = form(PLAIN, {}, name, tmp_path)
    with pytest.raises((ValueError, OSError), match=rf"{name}|half-light") as raised:
        plan.simulate(catalog=catalog)
    assert "missing" in str(raised.value) or "NaN" in str(raised.value)


@pytest.mark.parametrize("form", WITH_UNITS + WITHOUT_UNITS)
def test_a_star_needs_no_shape(plan, tmp_path, form):
    swapped = {name: values[::-1] for name, values in PLAIN.items()}
    catalog = form(swapped, {}, "n", tmp_path)
    assert np.allclose(plan.simulate(catalog=catalog), plan.simulate(catalog=PLAIN), rtol=1e-9)


@pytest.mark.parametrize("form", WITH_UNITS + WITHOUT_UNITS)
def test_columns_that_are_not_read_are_named(plan, tmp_path, form):
    columns = PLAIN | {"pmRA": [1.0, 2.0], "parallax": [3.0, 4.0], "id": [5, 6]}
    with pytest.warns(psfield.PsfieldWarning, match=r"the columns pmRA, parallax$") as caught:
        plan.simulate(catalog=form(columns, {}, None, tmp_path))
    assert len(caught) == 1 and caught[0].filename == __file__


@pytest.mark.parametrize("masked", [True, False])
def test_masked_arrays_are_refused_everywhere(plan, masked):
    """Arrays with hidden values are refused. Those whose masks hide nothing are used."""

    def hidden(array):
        mask = np.zeros(array.shape, bool)
        mask.flat[0] = masked
        return Masked(array, mask=mask)

    image, stamps = np.ones((60, 80)), np.ones((1, 5, 5))
    model = psfield.PsfModel.from_samples
    calls = [
        lambda form: plan.simulate(form(image)),
        lambda form: plan.simulate(form(np.ones((2, 60, 80)))),
        lambda form: plan.adjoint(form(image)),
        lambda form: plan.spot_check(image, image=form(plan.simulate(image))).passed,
        lambda form: model(form(stamps), (0, 0)).evaluate(0, 0),
        lambda form: model(stamps, form(np.zeros((1, 2)))).evaluate(0, 0),
        lambda form: psfield.detector.Detector(photon_noise=True).expose(form(image), 1).counts,
        lambda form: psfield.metrics.compare(form(image), 2 * image).mae,
    ]
    for call in calls:
        if masked:
            with pytest.raises(ValueError, match="masked"):
                call(hidden)
        else:
            assert np.array_equal(call(hidden), call(np.asarray))


def test_masked_positions_on_the_sky_are_refused(plan):
    coordinates = pytest.importorskip("astropy.coordinates")
    wcs = pytest.importorskip("astropy.wcs").WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.cdelt = ["RA---TAN", "DEC--TAN"], [-1e-4, 1e-4]
    wcs.wcs.crval, wcs.wcs.crpix = [150.0, 2.0], [40.5, 30.5]
    ra, dec = Masked([150.0, 150.001] * u.deg, mask=[False, True]), [2.0, 2.001] * u.deg
    for catalog in (
        {"sky": coordinates.SkyCoord(ra, dec), "flux": [1.0, 2.0]},
        {"ra": ra, "dec": dec, "flux": [1.0, 2.0]},
    ):
        with pytest.raises(ValueError, match=r"1 positions? on the sky.*row 1"):
            plan.simulate(catalog=catalog, wcs=wcs)
    hours = {"ra": (ra.unmasked / 15).value * u.hourangle, "dec": dec, "flux": [1.0, 2.0]}
    degrees = {"ra": ra.unmasked, "dec": dec, "flux": [1.0, 2.0]}
    images = [plan.simulate(catalog=catalog, wcs=wcs) for catalog in (hours, degrees)]
    assert np.allclose(*images, atol=1e-9)

"""Surveys: frames of a camera, against astropy, GalSim and single simulations."""

from __future__ import annotations

import json
import pathlib
import re
import subprocess
import warnings

import numpy as np
import pytest
from conftest import ROOT

import psfield
from psfield import plot

fits = pytest.importorskip("astropy.io.fits")
wcs = pytest.importorskip("astropy.wcs")
Table = pytest.importorskip("astropy.table").Table
units = pytest.importorskip("astropy.units")
coordinates = pytest.importorskip("astropy.coordinates")
Time = pytest.importorskip("astropy.time").Time

#: The largest difference from astropy, in pixels.
CLOSE_PX = 1e-3
NX, NY = 120, 100
DATE = "2026-05-17T04:00:00"
SIP = {
    "CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "A_ORDER": 2, "B_ORDER": 2,
    "A_2_0": 2.1e-5, "A_0_2": -8.0e-6, "A_1_1": 3.0e-5, "B_0_2": 1.7e-5, "B_1_1": -2.0e-5,
}  # fmt: skip
TPV = {
    "CTYPE1": "RA---TPV", "CTYPE2": "DEC--TPV", "PV1_1": 1.001, "PV1_2": 2e-4, "PV1_4": 3e-1,
    "PV1_7": 4.0, "PV2_1": 0.999, "PV2_4": -2e-1, "PV2_10": 3.0,
}  # fmt: skip


def camera_header(number):
    """Return the cards of a detector, relative to the boresight: turned, flipped, distorted."""
    scale = 0.3 / 3600
    header = fits.Header({"CRVAL1": 0.0, "CRVAL2": 0.0, "RADESYS": "ICRS"})
    header["CRPIX1"], header["CRPIX2"] = NX + 10.5, NY + 5.5
    flip = -1 if number == 0 else 1
    header["CD1_1"], header["CD1_2"] = flip * scale, 0.1 * scale
    header["CD2_1"], header["CD2_2"] = -0.12 * scale, 1.01 * scale
    header.update(SIP if number == 0 else TPV)
    return header


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with the files of a survey."""
    monkeypatch.chdir(tmp_path)
    model = psfield.PsfModel.from_telescope(
        field_shape=(NY, NX), samples=(5, 5), stamp_size=24, oversampling=4
    )
    model.write("psf.fits")
    for number in range(2):
        cards = camera_header(number).cards
        pathlib.Path(f"N{number}.head").write_text("\n".join(str(card) for card in cards))
    rng = np.random.default_rng(2)
    count = 600
    is_star = np.arange(count) < 400
    table = Table({
        "ra": 150.0 + rng.uniform(-0.03, 0.03, count),
        "dec": 2.0 + rng.uniform(-0.02, 0.02, count),
        "r": rng.uniform(16, 20, count),
        "pmra": np.where(is_star, rng.normal(0, 100, count), 0.0),
        "pmdec": np.where(is_star, rng.normal(0, 100, count), 0.0),
        "parallax": np.where(is_star, rng.exponential(10, count), 0.0),
        "ref_epoch": np.full(count, 2016.0),
        "re_arcsec": np.where(is_star, 0.0, rng.uniform(0.3, 1.0, count)),
        "n": rng.choice([1.0, 2.5], count),
        "q": rng.uniform(0.4, 1.0, count),
        "pa_deg": rng.uniform(0, 180, count),
    })  # fmt: skip
    for name, unit in [("pmra", "mas/yr"), ("pmdec", "mas/yr"), ("re_arcsec", "arcsec")]:
        table[name].unit = unit
    table.write("sky.fits")
    pathlib.Path("ccd.toml").write_text(
        "photon_noise = true\nread_noise_e = 4.0\ndark_e_per_s = 0.1\n"
        "full_well_e = 3e4\nbits = 16\n"
    )
    detectors = "".join(
        f'[[detector]]\nname = "N{number}"\nshape = [{NX}, {NY}]\nwcs = "N{number}.head"\n'
        'psf = "psf.fits"\nsettings = "ccd.toml"\n'
        for number in range(2)
    )
    pathlib.Path("survey.toml").write_text(f"""
catalog = "sky.fits"
output = "raw/{{exposure}}.fits"
truth_table = "raw/{{exposure}}_{{detector}}_sources.fits"
frames = "raw/frames.csv"
seed = 5
simulate = {{ tolerance = 1e-3 }}
band.r = {{ zero_point = 25.0, mag = "r", sky_e_per_s = 2.0 }}
{detectors}
[[pointing]]
name = "a"
ra = 150.0
dec = 2.0
rotation_deg = 25
date = {DATE}
band = "r"
exposure_s = 50
dithers_arcsec = [[0, 0], [6, -3]]
""")
    return tmp_path


def files():
    """Return the contents of all files of the survey by their names."""
    return {path.name: path.read_bytes() for path in pathlib.Path("raw").iterdir()}


def quiet(survey, **words):
    """Make the frames of a survey without warnings about small stamps."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        return survey.observe(**words)


def warned(survey):
    """Make the frames of a survey, and return the reports and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        reports = survey.observe()
    return reports, [str(warning.message) for warning in caught]


def on_date(table):
    """Return the positions of a catalogue as seen from the Earth, by astropy."""
    date = Time(DATE)
    column = {name: np.asarray(table[name]) for name in table.colnames}
    place = coordinates.SkyCoord(
        column["ra"] * units.deg,
        column["dec"] * units.deg,
        distance=1 / np.maximum(column["parallax"], 1e-4) * units.kpc,
        pm_ra_cosdec=column["pmra"] * units.mas / units.yr,
        pm_dec=column["pmdec"] * units.mas / units.yr,
        obstime=Time(2016.0, format="jyear"),
    ).apply_space_motion(date)
    earth = coordinates.get_body_barycentric("earth", date)
    seen = place.cartesian.without_differentials() - earth
    return coordinates.SkyCoord(
        seen.represent_as(coordinates.UnitSphericalRepresentation), frame="icrs"
    )


def test_positions_and_fluxes_are_those_of_astropy(folder):
    survey = psfield.Survey.read("survey.toml")
    reports = quiet(survey)
    assert [report.status for report in reports] == ["done"] * 4
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = Table.read("sky.fits")
        place = on_date(table)
    for frame in survey.frames:
        with fits.open(frame.output) as hdus:
            header = hdus[frame.extension].header
        truth = Table.read(f"raw/{frame.exposure}_{frame.detector}_sources.fits")
        shown = truth[truth["in_frame"]]
        assert 5 < len(shown) < len(truth)
        x, y = wcs.WCS(header).world_to_pixel(place[shown["row"]])
        assert np.hypot(x - shown["x"], y - shown["y"]).max() < CLOSE_PX
        flux = 50 * 10 ** (-0.4 * (table["r"][shown["row"]] - 25))
        assert np.allclose(shown["flux"], flux, rtol=1e-9)
        # Every source that astropy finds on the frame is in the table.
        x, y = wcs.WCS(header).all_world2pix(place.ra.deg, place.dec.deg, 0, quiet=True)
        inside = (x >= -0.5) & (x < NX - 0.5) & (y >= -0.5) & (y < NY - 0.5)
        assert sorted(shown["row"]) == np.flatnonzero(inside).tolist()
        saturated = shown["saturated_pixels"] > 0
        assert saturated.any() and shown["flux"][saturated].min() > 2e4
        corners = wcs.WCS(header).pixel_to_world_values(
            [-0.5, NX - 0.5, NX - 0.5, -0.5], [-0.5, -0.5, NY - 0.5, NY - 0.5]
        )
        assert np.allclose(np.transpose(frame.corners_deg), corners, atol=1e-7)
    listed = Table.read("raw/frames.csv")
    assert list(listed["exposure"]) == ["a-1", "a-1", "a-2", "a-2"]
    assert listed["file"][0] == "a-1.fits" and listed["extension"][1] == "N1"


def test_a_frame_equals_a_single_simulation(folder):
    survey = psfield.Survey.read("survey.toml")
    quiet(survey)
    frame = survey.frames[0]
    header = fits.Header.fromstring(frame.header)
    table = psfield.read_catalog(
        "sky.fits", columns="mag=r", zero_point=25 + 2.5 * np.log10(50), wcs=wcs.WCS(header)
    )
    model = psfield.PsfModel.read("psf.fits")
    ccd = psfield.detector.Detector(
        photon_noise=True, read_noise_e=4.0, dark_e_per_s=0.1, full_well_e=3e4, bits=16,
        exposure_s=50.0, sky_e=100.0,
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        plan = model.plan((NY, NX), tolerance=1e-3)
        expected = plan.expose(None, table, detector=ccd, seed=frame.seed).counts
    with fits.open(frame.output) as hdus:
        counts = hdus[frame.extension].data
    # Sources beyond the reach of the frame are left out, which changes roundings.
    assert np.mean(counts != expected) < 1e-3


def test_a_survey_continues_and_gives_the_same_bytes(folder, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    survey = psfield.Survey.read("survey.toml")
    quiet(survey)
    first = files()
    assert len(first) == 7
    assert {report.status for report in quiet(survey)} == {"skipped"}
    pathlib.Path("raw/a-1.fits").unlink()
    pathlib.Path("raw/a-2_N0_sources.fits").unlink()
    statuses = [report.status for report in quiet(survey)]
    assert sorted(statuses) == ["done", "done", "done", "skipped"]
    assert files() == first
    # A table is made again for a frame that the file of its exposure holds already.
    pathlib.Path("raw/a-1_N1_sources.fits").unlink()
    assert sorted(report.status for report in quiet(survey)) == ["done", *["skipped"] * 3]
    assert files() == first
    # Other settings are not mistaken for these, unless files may be replaced.
    text = pathlib.Path("survey.toml").read_text().replace("seed = 5", "seed = 6")
    pathlib.Path("survey.toml").write_text(text)
    other = psfield.Survey.read("survey.toml")
    _, texts = warned(other)
    assert "4 of 4 frames failed" in texts[0] and "other options" in texts[0]
    assert {report.status for report in quiet(other, overwrite=True)} == {"done"}
    assert pathlib.Path("raw/a-1.fits").read_bytes() != first["a-1.fits"]


def test_tables_and_dicts_make_a_survey_too(folder, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    quiet(psfield.Survey.read("survey.toml"))
    expected = {name: content for name, content in files().items() if name.endswith(".fits")}
    camera = [
        {"name": f"N{number}", "shape": (NX, NY), "wcs": wcs.WCS(camera_header(number)),
         "psf": "psf.fits", "settings": "ccd.toml"}
        for number in range(2)
    ]  # fmt: skip
    pointing = {
        "name": "a", "ra": 150.0, "dec": 2.0, "rotation_deg": 25, "date": Time(DATE), "band": "r",
        "exposure_s": 50, "dithers_arcsec": [[0, 0], [6, -3]],
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        reports = psfield.observe(
            Table.read("sky.fits"), camera, [pointing], "mine/{exposure}.fits",
            truth_table="mine/{exposure}_{detector}_sources.fits", seed=5,
            simulate={"tolerance": 1e-3},
            bands={"r": {"zero_point": 25.0, "mag": "r", "sky_e_per_s": 2.0}},
        )  # fmt: skip
    assert [report.error for report in reports] == [None] * 4
    for name, content in expected.items():
        with (
            fits.open(f"mine/{name}") as mine,
            fits.HDUList.fromstring(content) as theirs,
        ):
            for one, other in zip(mine, theirs, strict=True):
                # A header of astropy has rounded numbers.
                if one.name == "TRUTH":
                    assert np.allclose(one.data["x"], other.data["x"], atol=1e-6)
                elif one.data is not None:
                    assert np.mean(one.data != other.data) < 1e-3


def test_dask_makes_the_same_bytes(folder, monkeypatch):
    pytest.importorskip("distributed")
    from distributed import Client, LocalCluster

    import psfield.dask

    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    survey = psfield.Survey.read("survey.toml")
    quiet(survey)
    first = files()
    for name in first:
        pathlib.Path("raw", name).unlink()
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        reports = psfield.dask.observe(survey, client=client)
    assert [report.status for report in reports] == ["done"] * 4
    assert files() == first


def test_galaxies_equal_galsim_on_a_distorted_detector(folder):
    galsim = pytest.importorskip("galsim")
    sigma = 1.6
    offsets = np.mgrid[-60:61, -60:61] / 4
    stamp = np.exp(-(offsets**2).sum(axis=0) / (2 * sigma**2))
    model = psfield.PsfModel.from_samples(stamp, (0, 0), oversampling=4)
    survey = psfield.Survey.read("survey.toml")
    for frame in survey.frames[:1] + survey.frames[2:3]:
        sky = wcs.WCS(fits.Header.fromstring(frame.header))
        place = sky.pixel_to_world(60.3, 50.8)
        for q, angle, shear in [(0.4, 35.0, (0.0, 0.0)), (0.8, 110.0, (0.1, -0.07))]:
            row = {
                "ra": [place.ra.deg], "dec": [place.dec.deg], "flux": [1000.0], "re_arcsec": [1.1],
                "n": [1.5], "q": [q], "pa_deg": [angle], "g1": [shear[0]], "g2": [shear[1]],
            }  # fmt: skip
            plan = model.plan((NY, NX), tolerance=1e-5)
            image = plan.simulate(catalog=row, wcs=sky)
            world = galsim.AstropyWCS(header=fits.Header.fromstring(frame.header))
            centre = galsim.PositionD(61.3, 51.8)
            local = world.local(centre)
            light = galsim.Sersic(1.5, half_light_radius=1.1 * np.sqrt(q), flux=1000.0)
            light = light.shear(q=q, beta=(90 + angle) * galsim.degrees)
            light = light.shear(g1=shear[0], g2=shear[1])
            psf = local.toWorld(galsim.Gaussian(sigma=sigma))
            drawn = galsim.Convolve(light, psf, gsparams=galsim.GSParams(folding_threshold=1e-4))
            canvas = galsim.ImageD(NX, NY, wcs=world)
            drawn.drawImage(canvas, method="no_pixel", center=centre)
            peak = canvas.array.max()
            assert np.abs(image - canvas.array).max() < 1e-3 * peak


def test_pixel_catalogues_and_columns_for_the_sky_agree(folder):
    """Positions, sizes and motions of tables go the same way as those of files."""
    frame = psfield.Survey.read("survey.toml").frames[0]
    sky = wcs.WCS(fits.Header.fromstring(frame.header))
    model = psfield.PsfModel.read("psf.fits")
    table = Table.read("sky.fits")
    table["flux"] = 10 ** (-0.4 * (table["r"] - 25))
    table.write("flux.fits")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        plan = model.plan((NY, NX), tolerance=1e-3)
        of_table = plan.simulate(catalog=table, wcs=sky)
        of_file = plan.simulate(catalog="flux.fits", wcs=sky)
        truth = plan.truth_table(table, wcs=sky)
    np.testing.assert_array_equal(of_table, of_file)
    assert truth["row"].tolist() == list(range(len(table)))
    pixels = psfield.read_catalog("flux.fits", wcs=sky)
    assert np.array_equal(np.sort(truth["x"]), np.sort(pixels["x"]))
    # Without the epoch, nothing moves, with a warning.
    still = Table(table)
    still.remove_column("ref_epoch")
    with pytest.warns(psfield.PsfieldWarning, match="not read.*pmra, pmdec, parallax"):
        truth = plan.truth_table(still, wcs=sky)
    where = sky.world_to_pixel(coordinates.SkyCoord(table["ra"], table["dec"], unit="deg"))
    assert np.abs(truth["x"] - where[0]).max() < CLOSE_PX
    read = psfield.read_catalog("flux.fits", wcs=sky, date=2016.0)
    assert read["x"].size == len(table)


def test_regions_and_flags_of_truth_tables():
    model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    stars = {"x": [4.0, 30.0], "y": [5.0, 20.0], "flux": [30.0, 1e6]}
    part = model.plan((40, 50), region=(20, 10, 30, 20)).truth_table(stars)
    assert part["x"].tolist() == [-16.0, 10.0] and part["y"].tolist() == [-5.0, 10.0]
    assert part["in_frame"].tolist() == [False, True] and "ra" not in part
    plan = model.plan((40, 50))
    ccd = psfield.detector.Detector(photon_noise=True, full_well_e=1e4)
    exposure = plan.expose(None, stars, detector=ccd, seed=1)
    full = plan.truth_table(stars, flags=exposure.flags)
    assert full["saturated_pixels"].tolist() == [0, 5]
    with pytest.raises(ValueError, match="flags must have the shape"):
        plan.truth_table(stars, flags=np.zeros((3, 3)))


def test_columns_of_tables_are_not_lost(folder):
    """Single values, masked and missing values, SkyCoords and texts."""
    detector = {"name": "N", "shape": [NX, NY], "psf": "psf.fits"}
    detector["geometry"] = {"pixel_scale_arcsec": 0.3}
    pointing = {"ra": 150.0, "dec": 2.0, "date": 2026.0}
    place = coordinates.SkyCoord([150.0, 150.001], [2.0, 2.001], unit="deg")
    words = {"truth_table": "{exposure}_t.fits", "output": "{exposure}_{detector}.fits"}

    def truth(catalog, **more):
        survey = psfield.Survey(catalog, [detector], [pointing], **words, **more)
        report = quiet(survey, overwrite=True)[0]
        assert report.error is None
        return Table.read("001_t.fits"), report, fits.getdata("001_N.fits")

    numbers = {"ra": [150.0, 150.001], "dec": [2.0, 2.001], "flux": [100.0, 50.0]}
    table, _, image = truth(numbers)
    assert len(table) == 2
    moved, _, _ = truth({**numbers, "pmra": 1000.0, "pmdec": 0.0, "epoch": 2016.0})
    assert np.allclose(table["x"] - moved["x"], 10 / 0.3, atol=0.1)
    _, _, galaxies = truth({**numbers, "re_arcsec": 1.0, "n": 1.0})
    assert galaxies.max() < 0.5 * image.max()
    same, _, _ = truth(Table({"place": place, "flux": [100.0, 50.0], "name": ["a", "b"]}))
    assert np.allclose(same["x"], table["x"], atol=1e-9)
    masked = Table({**numbers, "flux": np.ma.masked_array([100.0, 50.0], [False, True])})
    few, report, _ = truth(masked, skip_invalid=True)
    assert len(few) == 1 and report.invalid_rows == 1
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({**numbers, "flux": pandas.array([100, None], dtype="Int64")})
    few, report, _ = truth(frame, skip_invalid=True)
    assert len(few) == 1 and report.invalid_rows == 1
    # Another table is another survey.
    other = psfield.Survey({**numbers, "flux": [9.0, 9.0]}, [detector], [pointing], **words)
    assert "made with other options" in warned(other)[1][0]


def test_a_telescope_is_sampled_for_its_detector(folder):
    telescope = (ROOT / "tests/compatibility/v0.2.0/telescope.toml").read_text()
    pathlib.Path("scope.toml").write_text(telescope)
    detector = {"name": "N", "shape": [64, 48], "psf": "scope.toml"}
    detector["geometry"] = {"pixel_scale_arcsec": 0.1}
    sky = {"ra": [10.0], "dec": [20.0], "flux": [100.0]}
    report = quiet(psfield.Survey(sky, [detector], [{"ra": 10, "dec": 20}], "{exposure}.fits"))[0]
    assert report.error is None and report.in_frame == 1
    detector["shape"] = [64, 64]
    other = psfield.Survey(sky, [detector], [{"ra": 10, "dec": 20}], "o{exposure}.fits")
    assert "for frames of" in quiet(other)[0].error


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('name = "N1"', 'name = "N0"', "the detector N0 appears twice"),
        ("raw/{exposure}.fits", "raw/{band}.fits", r"raw/r\.fits would be.*put {exposure}"),
        ("{exposure}_{detector}_s", "{exposure}_s", r"a-1_sources\.fits would be"),
        ("raw/{exposure}.fits", "sky.fits", "an input of the survey"),
        ("raw/{exposure}.fits", "raw/{filter}.fits", "and nothing else"),
        ('band = "r"', 'band = "g"', r"pointing 1 \(a\): the band \"g\" is not among the bands r"),
        ("dec = 2.0\nrot", "dec = 92.0\nrot", r"pointing 1 \(a\): dec must be -90 to 90"),
        ("exposure_s = 50", "exposure_s = 0", "exposure_s must be above 0"),
        (f"date = {DATE}", 'date = "in May"', "date: a date is needed"),
        ("seed = 5", "sead = 5", r"survey\.toml.*line.*unknown field `sead`"),
        ('wcs = "N1.head"', "", "detector N1: its world coordinates are needed"),
    ],
)
def test_bad_surveys_are_refused(folder, before, after, message):
    text = pathlib.Path("survey.toml").read_text()
    assert before in text
    pathlib.Path("survey.toml").write_text(text.replace(before, after))
    with pytest.raises((ValueError, OSError), match=message):
        psfield.Survey.read("survey.toml")


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (
            "zero_point = 25.0, ",
            "",
            "band r: the catalogue holds magnitudes: give the band a zero_p",
        ),
        (f"shape = [{NX}, {NY}]", "shape = [64, 64]", r"psf\.fits: this PSF is for frames of"),
        ('mag = "r"', 'mag = "i"', "no such column"),
        ("exposure_s = 50", "", "exposure time"),
    ],
)
def test_frames_that_fail_say_why(folder, before, after, message):
    text = pathlib.Path("survey.toml").read_text()
    pathlib.Path("survey.toml").write_text(text.replace(before, after))
    reports, texts = warned(psfield.Survey.read("survey.toml"))
    assert re.search(message, texts[0])
    assert {report.status for report in reports} == {"failed"}
    assert not list(pathlib.Path("raw").glob("*.fits"))


def test_a_source_without_a_magnitude_fails_only_its_frames(folder):
    table = Table.read("sky.fits")
    survey = psfield.Survey.read("survey.toml")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        place = on_date(table)
    # The star on the first detector that is farthest from the second one.
    skies = [wcs.WCS(fits.Header.fromstring(survey.frames[number].header)) for number in (0, 2)]
    x, y = skies[0].world_to_pixel(place)
    on_first = (x > 0) & (x < NX) & (y > 0) & (y < NY) & (table["re_arcsec"] == 0)
    x, y = skies[1].world_to_pixel(place)
    row = int(np.argmax(np.where(on_first, np.hypot(x - NX / 2, y - NY / 2), 0)))
    table["r"][row] = np.nan
    table.write("sky.fits", overwrite=True)
    reports, texts = warned(survey)
    assert f'row {row} (0-based), column "r"' in texts[0]
    statuses = {(report.detector, report.status) for report in reports}
    assert ("N0", "failed") in statuses and ("N1", "done") in statuses
    text = pathlib.Path("survey.toml").read_text()
    pathlib.Path("survey.toml").write_text("skip_invalid = true\n" + text)
    again = quiet(psfield.Survey.read("survey.toml"), overwrite=True)
    assert {report.status for report in again} == {"done"}
    assert max(report.invalid_rows for report in again) == 1


def test_poles_and_the_first_meridian(folder):
    model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    model.write("small.fits")
    camera = [{"name": "N", "shape": [200, 200], "psf": "small.fits"}]
    camera[0]["geometry"] = {"pixel_scale_arcsec": 1.0, "centre_arcsec": [40.0, -20.0]}
    rng = np.random.default_rng(1)
    for ra, dec in [(0.0, 0.0), (359.999, -40.0), (10.0, 90.0), (0.0, -89.99)]:
        sky = wcs.WCS(naxis=2)
        sky.wcs.ctype, sky.wcs.crval = ["RA---TAN", "DEC--TAN"], [ra, dec]
        sky.wcs.crpix, sky.wcs.cdelt = [100.5, 100.5], [-1 / 3600, 1 / 3600]
        place = sky.pixel_to_world(*rng.uniform(0, 199, (2, 200)))
        stars = {"ra": place.ra.deg, "dec": place.dec.deg, "flux": np.full(200, 100.0)}
        survey = psfield.Survey(
            stars, camera, [{"ra": ra, "dec": dec, "rotation_deg": 30.0}],
            "pole/{exposure}_{detector}.fits", truth_table="pole/{exposure}_{detector}_t.fits",
        )  # fmt: skip
        report = quiet(survey, overwrite=True)[0]
        own = wcs.WCS(fits.getheader(survey.frames[0].output))
        x, y = own.world_to_pixel(place)
        inside = (x >= -0.5) & (x < 199.5) & (y >= -0.5) & (y < 199.5)
        assert report.in_frame == inside.sum() > 100
        truth = Table.read("pole/001_N_t.fits")
        row = truth["row"]
        assert np.hypot(x[row] - truth["x"], y[row] - truth["y"]).max() < CLOSE_PX


def test_empty_frames_hold_the_sky(folder):
    text = pathlib.Path("survey.toml").read_text()
    pathlib.Path("survey.toml").write_text(text.replace("dec = 2.0\nrot", "dec = 40.0\nrot"))
    survey = psfield.Survey.read("survey.toml")
    reports, texts = warned(survey)
    assert texts == ["no source of the catalogue reaches this frame"]
    assert {(report.status, report.sources) for report in reports} == {("done", 0)}
    with fits.open("raw/a-1.fits") as hdus:
        assert 100 < hdus["N1"].data.mean() < 110


def test_bands_have_their_own_spectra(folder):
    """Sources with spectra see the PSF of their spectrum in the band."""
    model = psfield.PsfModel.from_telescope(
        field_shape=(NY, NX), samples=(3, 3), stamp_size=24, oversampling=4,
        wavelengths_um=[0.5, 0.6, 0.7],
    )  # fmt: skip
    model.write("colour.fits")
    pathlib.Path("r.csv").write_text("wavelength_um,throughput\n0.52,1\n0.68,1\n")
    sky = {
        "ra": [10.0, 10.001],
        "dec": [20.0, 20.001],
        "flux": [1e4, 1e4],
        "teff": [3000.0, 9000.0],
    }
    camera = [{"name": "N", "shape": [NX, NY], "psf": "colour.fits"}]
    camera[0]["geometry"] = {"pixel_scale_arcsec": 0.3}
    bands = {"r": {"bandpass": "r.csv:um"}}
    survey = psfield.Survey(
        sky, camera, [{"ra": 10, "dec": 20, "band": "r"}], "c.fits", bands=bands
    )
    assert quiet(survey)[0].error is None
    plan = model.plan((NY, NX), bandpass="r.csv:um")
    header = fits.Header.fromstring(survey.frames[0].header)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        expected = plan.simulate(catalog=sky, wcs=wcs.WCS(header))
    with fits.open("c.fits") as hdus:
        assert np.abs(hdus["N"].data - expected).max() < 1e-5 * expected.max()


def test_the_command_makes_the_same_files(command, folder, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    survey = psfield.Survey.read("survey.toml")
    quiet(survey)
    first = files()
    for name in first:
        pathlib.Path("raw", name).unlink()
    run = subprocess.run([command, "observe", "survey.toml"], capture_output=True, check=True)
    assert [json.loads(line)["status"] for line in run.stdout.splitlines()] == ["done"] * 4
    assert files() == first


def test_the_focal_plane_is_drawn(folder):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    survey = psfield.Survey.read("survey.toml")
    ax = plot.plot_focal_plane(survey, catalog=Table.read("sky.fits"))
    assert [text.get_text() for text in ax.texts] == ["N0", "N1"]
    assert ax.get_xlim()[0] > ax.get_xlim()[1]  # east is left
    plt.close(ax.figure)
    with pytest.raises(ValueError, match="the survey has none of"):
        plot.plot_focal_plane(survey, exposures=["b"])

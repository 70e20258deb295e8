"""Injection of sources into real frames."""

from __future__ import annotations

import json
import pathlib
import subprocess
import warnings

import numpy as np
import pytest

import psfield

fits = pytest.importorskip("astropy.io.fits")
units = pytest.importorskip("astropy.units")
wcs = pytest.importorskip("astropy.wcs")
Table = pytest.importorskip("astropy.table").Table

NX, NY = 150, 120
GAIN = 1.7
#: Cards that an injection may change.
CHANGED = {"CHECKSUM", "DATASUM", "HISTORY"}


def frame_of(kind, path):
    """Write a frame with stars, sky, noise and cards. Return the number of its image."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:NY, :NX]
    electrons = np.full((NY, NX), 400.0)
    for sx, sy, flux in rng.uniform([8, 8, 3], [NX - 8, NY - 8, 5.5], (60, 3)):
        r2 = (x - sx) ** 2 + (y - sy) ** 2
        electrons += 10**flux / (2 * np.pi * 1.6**2) * np.exp(-r2 / (2 * 1.6**2))
    data = rng.poisson(electrons) / GAIN + rng.normal(300, 4, (NY, NX))
    header = fits.Header({"GAIN": GAIN, "OBJECT": "a field", "MJD-OBS": 60000.5})
    header["COMMENT"] = "kept"
    sky = wcs.WCS(naxis=2)
    sky.wcs.ctype, sky.wcs.crval, sky.wcs.crpix = ["RA---TAN", "DEC--TAN"], [10, 20], [75, 60]
    sky.wcs.cdelt = [-1e-4, 1e-4]
    header.update(sky.to_header())
    header["MJD-OBS"] = 60000.5
    table = fits.BinTableHDU(Table({"a": [1, 2, 3]}))
    if kind == "float":
        data = data.astype(np.float32)
        data[3, 4] = np.nan
        hdus = [fits.PrimaryHDU(data, header), table]
    elif kind == "unsigned":
        hdus = [fits.PrimaryHDU(np.rint(data).clip(0, 65535).astype(np.uint16), header), table]
    elif kind == "scaled":
        image = fits.PrimaryHDU(np.rint((data - 1000) / 0.25).astype(np.int32))
        image.header.update(header)
        image.header["BSCALE"], image.header["BZERO"] = 0.25, 1000.0
        image.header["BLANK"] = int(image.data[3, 4])
        hdus = [image, table]
    elif kind == "extension":
        hdus = [
            fits.PrimaryHDU(),
            table,
            fits.ImageHDU(np.rint(data).astype(np.int16), header, name="SCI"),
        ]
    else:
        tiles = fits.CompImageHDU(np.rint(data).astype(np.int32), header, compression_type="RICE_1")
        hdus = [fits.PrimaryHDU(), tiles]
    fits.HDUList(hdus).writeto(path, checksum=kind == "unsigned")
    return {"extension": 2, "tiles": 1}.get(kind, 0)


@pytest.fixture
def model():
    """Return a PSF that widens over the frame."""
    offsets = np.mgrid[-40:41, -40:41] / 4
    stamps = [np.exp(-(offsets**2).sum(axis=0) / (2 * s**2)) for s in (1.4, 1.7, 1.5, 1.6)]
    corners = [(0, 0), (NX - 1, 0), (0, NY - 1), (NX - 1, NY - 1)]
    return psfield.PsfModel.from_samples(stamps, corners, oversampling=4)


STARS = {"x": [40.3, 100.7, 70.2], "y": [30.6, 50.1, 90.9], "flux": [30000.0, 10000.0, 3000.0]}


@pytest.mark.parametrize("kind", ["float", "unsigned", "scaled", "extension", "tiles"])
def test_all_but_the_light_stays(kind, model, tmp_path):
    number = frame_of(kind, tmp_path / "real.fits")
    report = psfield.inject(tmp_path / "real.fits", STARS, tmp_path / "new.fits", model, seed=3)
    assert report.gain == GAIN and report.saturation is None
    assert abs(report.electrons / (43000 * GAIN) - 1) < 0.02
    raw = {"do_not_scale_image_data": kind != "tiles"}
    with (
        fits.open(tmp_path / "real.fits", **raw) as before,
        fits.open(tmp_path / "new.fits", checksum=True, **raw) as after,
    ):
        assert len(before) == len(after)
        for place, (old, new) in enumerate(zip(before, after, strict=True)):
            if place == number == 1:
                kept = {
                    card.keyword: card.value
                    for card in new.header.cards
                    if card.keyword not in CHANGED
                }
                for keyword in ("GAIN", "OBJECT", "CTYPE1", "CRVAL2", "MJD-OBS"):
                    assert kept[keyword] == old.header[keyword]
                assert new.data.dtype.kind == "i" and new.header["BITPIX"] == 32
            else:
                cards = [
                    [card for card in hdu.header.cards if card.keyword not in CHANGED]
                    for hdu in (old, new)
                ]
                assert [str(card) for card in cards[0]] == [str(card) for card in cards[1]]
            if place == number:
                changed = (old.data != new.data) & ~np.isnan(np.asarray(new.data, float))
                y, x = np.nonzero(changed)
                near = [np.hypot(x - sx, y - sy) for sx, sy in zip(STARS["x"], STARS["y"])]
                assert np.min(near, axis=0).max() < 12 and changed.sum() > 100
                assert "psfield" in str(new.header["HISTORY"])
                if kind == "float":
                    assert np.isnan(new.data[3, 4])
                assert new.data.dtype.kind == old.data.dtype.kind
            elif old.data is not None:
                assert old.data.tobytes() == new.data.tobytes()


@pytest.mark.parametrize("kind", ["float", "unsigned"])
def test_photometry_is_unbiased_and_has_photon_noise(kind, model, tmp_path):
    """The mean of many seeds is the flux, and the scatter that of its photons."""
    runs, number = 60, frame_of(kind, tmp_path / "real.fits")
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(15.0, NX - 10, 20), np.arange(15.0, NY - 10, 20))
    stars = {"x": x.ravel() + rng.uniform(0, 1, x.size), "y": y.ravel() + rng.uniform(0, 1, x.size)}
    stars["flux"] = np.full(x.size, 20000.0)
    with fits.open(tmp_path / "real.fits") as hdus:
        before = hdus[number].data.astype(float)
    apertures = []
    for seed in range(runs):
        psfield.inject(
            tmp_path / "real.fits", stars, tmp_path / "new.fits", model,
            seed=seed, tolerance=1e-5, overwrite=True,
        )  # fmt: skip
        with fits.open(tmp_path / "new.fits") as hdus:
            added = np.nan_to_num(hdus[number].data.astype(float) - before)
        # Stars do not overlap: squares of 20 pixels hold one each.
        rows = added[5:105, 5:145].reshape(5, 20, 7, 20)
        apertures.append(rows.sum(axis=(1, 3)))
    apertures = np.array(apertures)
    noise = np.sqrt(20000.0 / GAIN)
    mean_error = noise / np.sqrt(apertures.size)
    assert abs(apertures.mean() - 20000.0) < 4 * mean_error < 1e-3 * 20000
    scatter = np.sqrt(apertures.var(axis=0, ddof=1).mean()) / noise
    assert abs(scatter - 1) < 4 / np.sqrt(2 * apertures.size)


def test_positions_on_the_sky_and_truth_tables(model, tmp_path):
    frame_of("float", tmp_path / "real.fits")
    sky = wcs.WCS(fits.getheader(tmp_path / "real.fits"))
    place = sky.pixel_to_world([40.0, 400.0], [50.0, 50.0])
    stars = Table({"place": place, "flux": [20000.0, 20000.0]})
    report = psfield.inject(
        tmp_path / "real.fits", stars, tmp_path / "new.fits", model,
        saturation=2000.0, truth_table=tmp_path / "truth.fits",
    )  # fmt: skip
    truth = Table.read(tmp_path / "truth.fits")
    assert np.allclose(truth["x"], [40, 400], atol=1e-6)
    assert truth["in_frame"].tolist() == [True, False]
    assert truth["saturated_pixels"].tolist() == [report.saturated_pixels, 0]
    data = fits.getdata(tmp_path / "new.fits")
    assert report.saturated_pixels > 0
    assert data[50, 40] == 2000.0
    # A file of magnitudes, whose stars move to the date of the frame.
    (tmp_path / "moving.csv").write_text(
        "ra,dec,mag,pmra,pmdec,ref_epoch\n10.0,20.0,15,1000,0,2016.0\n"
    )
    table = psfield.read_catalog(
        tmp_path / "moving.csv", wcs=tmp_path / "real.fits", zero_point=25.0
    )
    moved = (2023.15 - 2016) * 1000 / 3.6e6 / 1e-4
    assert abs(table["x"][0] - (74 - moved)) < 0.02


def test_the_psf_is_that_of_the_frame(tmp_path):
    frame_of("unsigned", tmp_path / "real.fits")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        psfield.inject(tmp_path / "real.fits", STARS, tmp_path / "new.fits", seed=1)
    before, after = (
        fits.getdata(tmp_path / name).astype(float) for name in ("real.fits", "new.fits")
    )
    stamp = (after - before)[30 - 8 : 30 + 9, 40 - 8 : 40 + 9]
    fit = psfield.metrics.fit_gaussian(stamp)
    assert abs(fit.fwhm / (2.3548 * 1.6) - 1) < 0.1


def test_cards_of_the_frame_are_weighed(model, tmp_path):
    """EGAIN comes before the number of a setting, a saturation below the sky is none."""
    data = np.full((60, 70), 100, np.int16)
    header = fits.Header({"GAIN": 120, "EGAIN": 0.8, "SATURATE": 0, "BUNIT": "Jy", "BLANK": 32767})
    data[0, 0] = 32767
    fits.writeto(tmp_path / "real.fits", data, header)
    star = Table({"x": [30.0], "y": [20.0], "flux": [5000.0] * units.Jy})
    report = psfield.inject(tmp_path / "real.fits", star, tmp_path / "a.fits", model)
    assert (report.gain, report.saturation) == (0.8, None)
    star["flux"] = star["flux"].to(units.mJy)
    again = psfield.inject(tmp_path / "real.fits", star, tmp_path / "b.fits", model)
    assert again == report
    bright = {"x": [30.0], "y": [20.0], "flux": [1e8]}
    psfield.inject(tmp_path / "real.fits", bright, tmp_path / "c.fits", model)
    with fits.open(tmp_path / "c.fits", do_not_scale_image_data=True) as hdus:
        # The largest number is that of undefined pixels.
        assert hdus[0].data[20, 30] == 32766 and hdus[0].data[0, 0] == 32767
    (tmp_path / "real.fits").chmod(0o444)
    psfield.inject(tmp_path / "real.fits", star, tmp_path / "d.fits", model)


def test_compressed_primary_images_stay_at_their_place(model, tmp_path):
    """Files as of fpack: the compressed image was a primary one."""
    frame_of("float", tmp_path / "plain.fits")
    counts = np.rint(np.nan_to_num(fits.getdata(tmp_path / "plain.fits"))).astype(np.int16)
    tiles = fits.CompImageHDU(counts, fits.Header({"GAIN": GAIN}), compression_type="RICE_1")
    mask = fits.ImageHDU(np.zeros((NY, NX), np.uint8), name="MASK")
    fits.HDUList([fits.PrimaryHDU(), tiles, mask]).writeto(tmp_path / "packed.fits")
    # astropy writes no ZSIMPLE: the card makes a decompressed image the primary one.
    with fits.open(tmp_path / "packed.fits", disable_image_compression=True) as hdus:
        for keyword in ("ZTENSION", "ZPCOUNT", "ZGCOUNT"):
            hdus[1].header.remove(keyword, ignore_missing=True)
        hdus[1].header.insert("ZBITPIX", ("ZSIMPLE", True))
        hdus.writeto(tmp_path / "fpacked.fits")
    for name, extension in [("packed.fits", "1"), ("fpacked.fits", "1")]:
        out = tmp_path / f"new_{name}"
        psfield.inject(tmp_path / name, STARS, out, model, extension=extension, seed=3)
        with fits.open(out) as hdus:
            images = [hdu for hdu in hdus if hdu.data is not None and hdu.name != "MASK"]
            assert len(images) == 1
            changed = images[0].data != counts
            assert 100 < changed.sum() < 2000
            assert hdus["MASK"].data.sum() == 0 and "HISTORY" not in hdus["MASK"].header
            assert "HISTORY" in images[0].header


def test_bad_injections_are_refused(model, tmp_path):
    frame_of("float", tmp_path / "real.fits")
    fits.writeto(tmp_path / "long.fits", np.ones((20, 30), np.int64), fits.Header({"GAIN": 1.0}))
    with pytest.raises(OSError, match="64-bit whole numbers cannot be changed"):
        psfield.inject(tmp_path / "long.fits", STARS, tmp_path / "new.fits", model)
    (tmp_path / "long.fits").unlink()
    real = tmp_path / "real.fits"
    with pytest.raises(ValueError, match="would replace another file"):
        psfield.inject(real, STARS, real, model, overwrite=True)
    with pytest.raises(ValueError, match="would replace another file"):
        psfield.inject(real, STARS, tmp_path / "n.fits", model, truth_table=tmp_path / "n.fits")
    stars = {**STARS, "flux": [1.0, -1.0, 1.0]}
    with pytest.raises(ValueError, match=r"row 1 \(0-based\) has a negative flux"):
        psfield.inject(real, stars, tmp_path / "new.fits", model)
    with pytest.raises(ValueError, match="saturation must be a finite number"):
        psfield.inject(real, STARS, tmp_path / "new.fits", model, saturation=np.nan)
    fits.writeto(tmp_path / "plain.fits", np.ones((20, 30)))
    with pytest.raises(ValueError, match=r"plain\.fits: the header states no gain"):
        psfield.inject(tmp_path / "plain.fits", STARS, tmp_path / "new.fits", model)
    with pytest.raises(ValueError, match="gain must be above 0"):
        psfield.inject(tmp_path / "real.fits", STARS, tmp_path / "new.fits", model, gain=-1.0)
    on_sky = {"ra": [10.0], "dec": [20.0], "flux": [1.0]}
    with pytest.raises(ValueError, match="does not know the world coordinates"):
        psfield.inject(tmp_path / "plain.fits", on_sky, tmp_path / "new.fits", model, gain=1.0)
    with pytest.raises(TypeError, match="model must be a PsfModel"):
        psfield.inject(tmp_path / "real.fits", STARS, tmp_path / "new.fits", "psf.fits")
    (tmp_path / "new.fits").write_text("mine")
    with pytest.raises(OSError, match="exists"):
        psfield.inject(tmp_path / "real.fits", STARS, tmp_path / "new.fits", model)
    assert (tmp_path / "new.fits").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "new.fits",
        "plain.fits",
        "real.fits",
    ]


def test_the_command_injects_with_many_seeds(command, model, tmp_path):
    frame_of("unsigned", tmp_path / "real.fits")
    model.write(tmp_path / "psf.fits")
    Table(STARS).write(tmp_path / "stars.csv")
    run = subprocess.run(
        [command, "inject", "real.fits", "--catalog", "stars.csv", "--psf", "psf.fits",
         "--runs", "2", "--seed", "7", "-o", "new_{seed}.fits", "--truth-table", "t_{seed}.fits"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    lines = [json.loads(line) for line in run.stdout.splitlines()]
    assert [line["seed"] for line in lines] == [7, 8]
    psfield.inject(tmp_path / "real.fits", STARS, tmp_path / "mine.fits", model, seed=8)
    mine, theirs = (fits.getdata(tmp_path / name) for name in ("mine.fits", "new_8.fits"))
    np.testing.assert_array_equal(mine, theirs)
    assert Table.read(tmp_path / "t_7.fits")["row"].tolist() == [0, 1, 2]
    assert (
        pathlib.Path(tmp_path / "new_7.fits").read_bytes()
        != pathlib.Path(tmp_path / "new_8.fits").read_bytes()
    )

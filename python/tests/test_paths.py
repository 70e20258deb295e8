"""The table of docs/paths.md: each cell runs, or the error is the one that its letter names."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import psfield

fits = pytest.importorskip("astropy.io.fits")
wcs = pytest.importorskip("astropy.wcs")

PAGE = Path(__file__).parents[2] / "docs" / "paths.md"
BAND = "wavelength_nm,throughput\n450,0\n500,1\n700,1\n750,0\n"
RED, BLUE = "blackbody:3000", "blackbody:12000"
STARS = "x,y,flux,re,n\n20.3,10,50,0,\n41,30.5,70,2,1\n"
SHAPE = (50, 60)
COLOUR = {"bandpass": "band.csv"}
DISPERSION = "zenith=50,scale=0.2"


def table():
    """Return the cells of the table by feature and path."""
    rows = [
        [cell.strip() for cell in line.strip().strip("|").split("|")]
        for line in PAGE.read_text(encoding="utf-8").splitlines()
        if line.startswith("|")
    ]
    paths = [re.sub("`", "", name) for name in rows[0][1:]]
    return {row[0]: dict(zip(paths, row[1:], strict=True)) for row in rows[2:]}


TABLE = table()
CELLS = [(feature, path) for feature, row in TABLE.items() for path in row]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write a PSF that widens with the wavelength and over the field, a scene and a catalogue."""
    folder = tmp_path_factory.mktemp("paths")
    y, x = np.mgrid[-12:13, -12:13] / 2.0
    corners = ((0, 0), (59, 0), (0, 49), (59, 49))
    states = [(w, at) for w in (0.45, 0.6, 0.75) for at in corners]
    stamps = [np.exp(-(x**2 + y**2) / (2 * (1.6 * w + 0.002 * at[0]) ** 2)) for w, at in states]
    model = psfield.PsfModel.from_samples(
        stamps,
        [at for _, at in states],
        wavelengths_um=[w for w, _ in states],
        oversampling=2,
        noise=0,
        interpolation="bilinear",
        field_shape=SHAPE,
    )
    model.write(folder / "colours.fits")
    model.at(wavelength_um=0.6).write(folder / "psf.fits")
    model.at(wavelength_um=0.5).write(folder / "other.fits")
    stamps = [(1 + (x**2 + y**2) / (0.6 + 0.003 * at[0])) ** -2.5 for at in corners]
    wide = psfield.PsfModel.from_samples(
        stamps, corners, oversampling=2, interpolation="bilinear", field_shape=SHAPE
    )
    wide.write(folder / "core.fits")
    psfield.PsfModel.read(folder / "core.fits", wings="power=3,40").write(folder / "wings.fits")
    rng = np.random.default_rng(5)
    for name in ("scene", "red"):
        lit = rng.random(SHAPE) > 0.95
        fits.writeto(folder / f"{name}.fits", (lit * rng.random(SHAPE)).astype(np.float32))
    fine = np.zeros((100, 120), np.float32)
    fine[40:60, 50:70] = 1
    fits.writeto(folder / "fine.fits", fine)
    (folder / "band.csv").write_text(BAND)
    (folder / "stars.csv").write_text(STARS)
    sky = wcs.WCS(naxis=2)
    sky.wcs.ctype, sky.wcs.crval = ["RA---TAN", "DEC--TAN"], [10.0, 60.0]
    sky.wcs.crpix, sky.wcs.cdelt, sky.wcs.mjdobs = [30.5, 25.5], [-1e-4, 1e-4], 60000.0
    fits.writeto(folder / "frame.fits", np.zeros(SHAPE, np.float32), sky.to_header())
    (folder / "sky.csv").write_text(
        "ra,dec,flux,pmra,pmdec,ref_epoch,re_arcsec,n,pa_deg,q\n"
        "10.001,60.0005,50,200,-90,2016.0,0,,,\n9.9995,59.9992,70,0,0,2016.0,0.8,1,30,0.5\n"
    )
    (folder / "seds.csv").write_text(f"x,y,flux,sed\n20.3,10,50,{BLUE}\n41,30.5,70,{RED}\n")
    (folder / "noisy.toml").write_text("electrons_per_flux = 100\nphoton_noise = true\n")
    (folder / "camera.toml").write_text("electrons_per_flux = 100\nread_noise_e = 2\n")
    return folder


#: For each feature: options of the command line, and the scene, the catalogue and words of Python.
FEATURES = {
    "image": ({"scene": "scene.fits"}, {}),
    "stars and galaxies": ({"catalog": "stars.csv"}, {}),
    "positions on the sky, with motions": ({"catalog": "sky.csv", "wcs": "frame.fits"}, {}),
    "table of the sources": ({"catalog": "stars.csv"}, {}),
    "wings of the PSF": (
        {"scene": "scene.fits", "catalog": "stars.csv", "psf": "wings.fits"},
        {},
    ),
    "floor of sources": ({"catalog": "stars.csv", "floor": 0.05}, {"floor": 0.05}),
    "spectra of images": (
        {"scene": "scene.fits", "sed": BLUE, "layer": f"red.fits:sed={RED}", **COLOUR},
        {"scene": {BLUE: "scene.fits", RED: "red.fits"}, "bandpass": "band.csv"},
    ),
    "spectra of sources": ({"catalog": "seds.csv", **COLOUR}, {"bandpass": "band.csv"}),
    "dispersion": (
        {"catalog": "seds.csv", "dispersion": DISPERSION, **COLOUR},
        {"bandpass": "band.csv", "dispersion": DISPERSION},
    ),
    "finer scene": ({"scene": "fine.fits", "oversampling": 2}, {"oversample": 2}),
    "a part of the scene": (
        {"scene": "scene.fits", "frame": "5,4,40,30"},
        {"frame": (5, 4, 40, 30)},
    ),
    "a PSF for each frame": ({"scene": "scene.fits", "psf": "other.fits"}, {}),
    "moving light": ({"catalog": "stars.csv"}, {}),
    "many frames at once": ({"scene": "scene.fits"}, {}),
    "rows in turn, for scenes beyond memory": ({"scene": "scene.fits", "stream": True}, {}),
    "photons one by one": (
        {"catalog": "stars.csv", "detector": "noisy.toml", "seed": 3, "shoot-below": 1e6},
        {},
    ),
    "noise of a detector": ({"scene": "scene.fits", "detector": "camera.toml", "seed": 3}, {}),
    "spot check": ({"catalog": "stars.csv", "spot-check": 100}, {}),
    "adjoint": ({"scene": "scene.fits"}, {}),
    "own interpolation or basis": ({"scene": "scene.fits"}, {}),
}
DRIFT = (0.05, 0.0)


class Case:
    """One feature, on any path."""

    def __init__(self, feature, folder, tmp_path, command):
        self.feature, self.folder, self.tmp, self.command = feature, folder, tmp_path, command
        options, words = FEATURES[feature]
        psf = "colours.fits" if "bandpass" in words else options.get("psf", "psf.fits")
        self.options = {"psf": psf, "tolerance": 1e-5, "precision": "f64", **options}
        if "scene" not in options:
            self.options["shape"] = f"{SHAPE[1]},{SHAPE[0]}"
        self.words = {"tolerance": 1e-5, "precision": "f64", **words}
        if "bandpass" in self.words:
            self.words["bandpass"] = str(folder / "band.csv")
        named = self.words.pop("scene", options.get("scene"))
        if isinstance(named, dict):
            self.scene = {sed: self.pixels(name) for sed, name in named.items()}
        else:
            self.scene = None if named is None else self.pixels(named)
        catalog = options.get("catalog")
        self.catalog = None if catalog is None else str(folder / catalog)
        named = options.get("wcs")
        self.sky = None if named is None else wcs.WCS(fits.getheader(folder / named))
        self.model = psfield.PsfModel.read(folder / psf)
        if feature == "own interpolation or basis":
            model = psfield.PsfModel.read(folder / "psf.fits")
            stamps = model.evaluate(*model.positions.T, pixels="stamp")
            self.model = psfield.PsfModel.from_samples(
                stamps, model.positions, oversampling=2, interpolation=mean_of_all
            )

    def pixels(self, name):
        return fits.getdata(self.folder / name).astype(float)

    def run(self, *arguments):
        """Run the command, and return its first image."""
        done = subprocess.run(
            [self.command, "--quiet", *arguments],
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise ValueError(done.stderr)

    # The paths: each returns the image.

    def simulate(self):
        out = self.tmp / "image.fits"
        options = dict(self.options)
        scene = [options.pop("scene")] if "scene" in options else []
        named = [
            part
            for name, value in options.items()
            for part in ([f"--{name}"] if value is True else [f"--{name}", str(value)])
        ]
        if self.has_table:
            named += ["--truth-table", str(self.tmp / "table.fits")]
        self.run("simulate", *scene, *named, "-o", str(out))
        if self.has_table:
            assert fits.getdata(self.tmp / "table.fits")["row"].tolist() == [0, 1]
        return fits.getdata(out)

    def batch(self):
        out = self.tmp / "image.fits"
        jobs = self.folder / "jobs.toml"
        job = toml(self.options)
        jobs.write_text(f"[[job]]\n{job}output = '{out}'\n\n[[job]]\n{job}output = '{out}2.fits'\n")
        if self.has_table:
            job += f"truth-table = '{self.tmp}/table.fits'\n"
            jobs.write_text(f"[[job]]\n{job}output = '{out}'\n")
        self.run("batch", "--overwrite", str(jobs))
        if self.has_table:
            assert fits.getdata(self.tmp / "table.fits")["row"].tolist() == [0, 1]
        return fits.getdata(out)

    def series(self):
        night = self.folder / "night.toml"
        drift = f"[pointing]\ndrift_px_per_s = {list(DRIFT)}\n" if self.moves else ""
        times = 'start = "2026-11-27T21:00:00"\nexposure_s = 10.0\ncount = 2\n'
        night.write_text(f"{times}{drift}[simulate]\n{toml(self.options)}")
        self.run("series", str(night), "--out", str(self.tmp / "night"))
        if self.has_table:
            lines = (self.tmp / "night" / "frame_0000_sources.csv").read_text().splitlines()
            assert lines[0] == "row,x,y,flux" and len(lines) == 3
        return fits.getdata(self.tmp / "night" / "frame_0000.fits")

    def python_plan(self):
        plan = self.model.plan(self.shape, **self.words)
        if self.feature == "a PSF for each frame":
            other = psfield.PsfModel.read(self.folder / "psf.fits").plan(self.shape, **self.words)
            return other.with_psf(self.model).simulate(self.scene)
        if self.feature == "many frames at once":
            return plan.simulate(np.stack([self.scene, self.scene]))[1]
        if self.feature == "photons one by one":
            camera = psfield.detector.Detector.from_toml(self.folder / "noisy.toml")
            words = {"detector": camera, "seed": 3, "shoot_below": 1e6}
            return plan.expose(self.scene, self.catalog, **words).counts
        if self.feature == "spot check":
            assert plan.spot_check(self.scene, self.catalog, pixels=100).passed
        if self.feature == "adjoint":
            image = plan.simulate(self.scene)
            assert np.isclose(np.vdot(image, image), np.vdot(self.scene, plan.adjoint(image)))
        if self.has_table:
            assert plan.truth_table(self.catalog)["row"].tolist() == [0, 1]
        return plan.simulate(self.scene, self.catalog, wcs=self.sky)

    def python_series(self):
        words = {**self.words, "drift_px_per_s": DRIFT} if self.moves else dict(self.words)
        shape = SHAPE if self.scene is None else None
        if self.sky is not None:
            words["wcs"] = self.sky
        night = psfield.series(
            self.model, self.scene, self.catalog, shape=shape, exposure_s=10, count=2, **words
        )
        if self.has_table:
            assert night[0].sources["row"].tolist() == [0, 1]
        return night[0].image

    def dask_batch(self):
        dask = pytest.importorskip("psfield.dask")
        distributed = pytest.importorskip("distributed")
        job = {"scene": self.scene, "catalog": self.catalog}
        job = {key: value for key, value in job.items() if value is not None}
        words, model = dict(self.words), self.model
        if self.feature == "a PSF for each frame":
            job["psf"], model = self.model, psfield.PsfModel.read(self.folder / "psf.fits")
        if self.feature == "noise of a detector":
            words["detector"] = psfield.detector.Detector.from_toml(self.folder / "camera.toml")
            job["seed"] = 3
        out = str(self.tmp / "frame{index}.fits")
        shape = SHAPE if self.scene is None else None
        with distributed.Client(processes=False, dashboard_address=None) as client:
            results = dask.batch([job, job], model, out, shape=shape, client=client, **words)
        assert [result.error for result in results] == [None, None]
        with fits.open(self.tmp / "frame1.fits") as hdus:
            return next(hdu.data for hdu in hdus if hdu.data is not None)

    def dask_simulate(self):
        dask = pytest.importorskip("psfield.dask")
        array = pytest.importorskip("dask.array")
        scene = np.zeros(self.shape) if self.scene is None else self.scene
        if isinstance(scene, dict):
            scene = scene[BLUE]
        lazy = array.from_array(scene, chunks=(30, 30))
        return dask.simulate(lazy, self.model, catalog=self.catalog, **self.words).compute()

    @property
    def has_table(self):
        return self.feature == "table of the sources"

    @property
    def moves(self):
        return self.feature == "moving light"

    @property
    def shape(self):
        if isinstance(self.scene, dict) or self.scene is None:
            return SHAPE
        return self.scene.shape


def mean_of_all(positions, values):
    """Return an interpolation: the mean of all samples, everywhere."""
    mean = np.mean(values, axis=0, keepdims=True)
    return lambda at: np.repeat(mean, len(at), axis=0)


def toml(options):
    """Return options as lines of TOML."""
    text = {True: "true"}
    return "".join(
        f"{name} = {text[value] if value is True else repr(value)}\n"
        for name, value in options.items()
    )


#: Errors behind letters: for a cell, a part of the message.
ERRORS = {
    ("spectra of images", "Dask simulate"): "bandpass",
    ("spectra of sources", "Dask simulate"): "bandpass",
    ("dispersion", "Dask simulate"): "bandpass",
    ("rows in turn, for scenes beyond memory", "series"): "stream cannot be used in a series",
}


def test_the_table_has_every_feature():
    assert set(TABLE) == set(FEATURES)
    letters = set(re.findall(r"^- \*\*(\w)\*\*:", PAGE.read_text(encoding="utf-8"), re.M))
    assert {cell for row in TABLE.values() for cell in row.values()} == letters | {"yes"}


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
@pytest.mark.parametrize(("feature", "path"), CELLS)
def test_each_cell(feature, path, files, tmp_path, command):
    case = Case(feature, files, tmp_path, command)
    run = getattr(case, path.replace(" ", "_").replace("Plan", "plan").lower())
    if TABLE[feature][path] != "yes":
        if (feature, path) in ERRORS:
            with pytest.raises((TypeError, ValueError), match=ERRORS[feature, path]):
                run()
        return
    image = run()
    expected = case.python_plan()
    if feature == "noise of a detector":
        assert image.shape == expected.shape
        assert abs(np.median(image - 100 * expected)) < 2
    elif feature == "moving light":
        # Half a pixel per exposure: 0.25 pixels on average.
        x = np.arange(SHAPE[1])
        moved = image.sum(axis=0) @ x / image.sum() - expected.sum(axis=0) @ x / expected.sum()
        assert abs(moved - 0.25) < 1e-3
    else:
        assert np.abs(image - expected).max() < 1e-4 * expected.max()

"""The example programs."""

from __future__ import annotations

import csv
import itertools
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT

import psfield

EXAMPLES = ROOT / "python" / "examples"


def run(name: str, folder: Path) -> str:
    """Run an example as a program and return its output. It must not print errors."""
    sources = os.pathsep.join(
        [str(Path(psfield.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    )
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), str(folder)],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": sources},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return done.stdout


def number(pattern: str, text: str) -> float:
    """Return the number in the output at the place of ``#`` in the pattern."""
    found = re.search(pattern.replace("#", r"([-+.0-9e]+)"), text)
    assert found, f"{pattern!r} is not in\n{text}"
    return float(found[1])


def test_every_example_is_tested():
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert names <= tested, names - tested


def test_quick_start(tmp_path):
    text = run("quick_start", tmp_path)
    image = np.load(tmp_path / "image.npy")
    assert image.shape == (512, 768) and image.dtype == np.float32
    # The tolerance of the plan is 1e-4.
    assert number("relative error at 500 pixels: #", text) < 1e-4 and "as promised" in text
    light, seen = number("flux of the scene #", text), number("of the image #", text)
    # A little light leaves the frame through its edges.
    assert 0.995 < seen / light < 1.0 and seen == pytest.approx(image.sum(dtype=float), abs=0.1)
    assert psfield.PsfModel.read(tmp_path / "psf.fits").field_shape == (512, 768)


def test_roman_from_galsim(tmp_path):
    pytest.importorskip("galsim")
    fits = pytest.importorskip("astropy.io.fits")
    text = run("roman_from_galsim", tmp_path)
    assert "threshold met" in text and number("# samples", text) < 200
    # The error of interpolation between 4 x 4 oversampled pixels and between positions.
    assert number("# at most", text) < 3e-3
    image = fits.getdata(tmp_path / "image.fits")
    assert image.shape == (4088, 4088) and np.isfinite(image).all() and image.max() > 1e5
    model = psfield.PsfModel.read(tmp_path / "roman_psf.fits")
    # Part of the light of a star of Roman falls beyond 32 x 32 pixels.
    assert 0.9 < model.evaluate(2000.0, 2000.0, pixels="frame").sum() < 0.99


def test_psfex_and_catalog(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    text = run("psfex_and_catalog", tmp_path)
    assert number("# stars,", text) == 400
    with fits.open(tmp_path / "stars.cat") as catalogue:
        objects = catalogue["LDAC_OBJECTS"].data
        flux = 10 ** (-0.4 * (objects["MAG_AUTO"].astype(float) - 25))
        brightest = int(np.argmax(flux))
        x, y = objects["X_IMAGE"][brightest] - 1, objects["Y_IMAGE"][brightest] - 1
    truth, counts = fits.getdata(tmp_path / "truth.fits"), fits.getdata(tmp_path / "image.fits")
    assert truth.shape == counts.shape == (1000, 800)
    # A little light leaves the frame through its edges.
    assert truth.sum(dtype=float) == pytest.approx(flux.sum(), rel=1e-3)
    # The brightest star is at its position in the catalogue, which counts from 1.
    row, column = round(y), round(x)
    around = truth[row - 3 : row + 4, column - 3 : column + 4]
    dy, dx = np.mgrid[-3:4, -3:4]
    assert np.sum(dx * around) / np.sum(around) == pytest.approx(x - column, abs=0.3)
    assert np.sum(dy * around) / np.sum(around) == pytest.approx(y - row, abs=0.3)
    # Bias and sky, 300 + 200 / 1.5, under most pixels.
    assert np.median(counts) == pytest.approx(433, abs=2)
    # An aperture of 10 pixels misses a little light of a Moffat profile.
    assert 0 < number(r"they are # mag fainter", text) < 0.1
    assert len({*re.findall(r"star at .*: (\S+) %", text)}) == 3


def test_training_set(tmp_path):
    text = run("training_set", tmp_path)
    assert number("blurred in .*: # per second", text) > 20
    sharp, blurred = (
        np.load(tmp_path / f"{name}.npy", mmap_mode="r") for name in ("sharp", "blurred")
    )
    assert (
        sharp.shape == blurred.shape == (1000, 64, 64)
        and sharp.dtype == blurred.dtype == np.float32
    )
    for pair in (0, 499, 999):
        assert sharp[pair].max() > 1.5 * blurred[pair].max() > 0
        assert 0.7 < blurred[pair].sum() / sharp[pair].sum() < 1
    assert not np.array_equal(sharp[0], sharp[1])


def test_richardson_lucy(tmp_path):
    fits = pytest.importorskip("astropy.io.fits")
    text = run("richardson_lucy", tmp_path)
    assert number("adjoint is exact to #", text) < 1e-12
    errors = [float(error) for error in re.findall(r"^ +\d+  (\d\.\d+)$", text, re.MULTILINE)]
    assert len(errors) == 20 and all(a > b for a, b in itertools.pairwise(errors))
    assert number("error ends at #", text) > 1.1 * errors[-1]
    with fits.open(tmp_path / "deconvolved.fits") as hdus:
        image, result, truth = (hdu.data for hdu in hdus)
    norm = np.linalg.norm(truth)
    assert np.linalg.norm(result - truth) / norm == pytest.approx(errors[-1], abs=1e-4)
    assert np.linalg.norm(result - truth) < 0.8 * np.linalg.norm(image - truth)


def test_interpolators(tmp_path):
    text = run("interpolators", tmp_path)
    with open(tmp_path / "errors.csv", newline="") as file:
        rows = {(row["samples"], row["interpolation"]): row for row in csv.DictReader(file)}
    assert len(rows) == 16 and text.count("\n") == 18
    median = {key: float(row["median"]) for key, row in rows.items()}
    assert all(0 < float(row["median"]) <= float(row["largest"]) < 0.5 for row in rows.values())
    for samples in ("scattered", "grid"):
        assert median[samples, "natural-neighbour"] < median[samples, "nearest"] / 2
        assert median[samples, "delaunay"] < median[samples, "nearest"] / 2
    assert median["grid", "bicubic"] < median["grid", "bilinear"] / 2
    # A sample that is left out is farther from the others than the test positions are from them.
    # The prediction is therefore an upper estimate.
    assert all(float(row["leave_one_out"]) > 0.5 * median[key] for key, row in rows.items())

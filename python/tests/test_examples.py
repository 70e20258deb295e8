"""The example programs, and the snippets of the documents."""

from __future__ import annotations

import csv
import importlib.util
import itertools
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

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


#: A block that imports one of these, and the blocks after it, are skipped if it is not installed.
OPTIONAL = ("astropy", "galsim", "matplotlib", "photutils", "regularizepsf", "scipy", "tqdm")


def sections(document: str) -> list[tuple[str, list[tuple[int, str]]]]:
    """Return the sections of a document: the title and the blocks of Python.

    Each block has the number of its first line.
    """
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    made: list[tuple[str, list[tuple[int, str]]]] = [("", [])]
    for found in re.finditer(
        r"^## ([^\n]*)$|^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL
    ):
        if found[1] is not None:
            made.append((found[1], []))
        else:
            made[-1][1].append((text.count("\n", 0, found.start(2)), found[2]))
    return made


def available(module: str) -> bool:
    """Return whether a module can be imported."""
    return importlib.util.find_spec(module) is not None


def execute(blocks: list[tuple[int, str]], document: str, names: dict[str, Any]) -> None:
    """Run blocks one after the other. Lines are numbered as in the document."""
    for line, block in blocks:
        for module in OPTIONAL:
            if re.search(rf"^(from|import) {module}\b", block, re.MULTILINE) and not available(
                module
            ):
                pytest.skip(f"{module} is not installed")
        exec(compile("\n" * line + block, document, "exec"), names)


def test_the_page_of_the_package(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    if not available("photutils"):
        pytest.skip("photutils is not installed")
    for _, blocks in sections("python.md"):
        execute(blocks, "python.md", names)
    image = np.load("frames.npy")[9]
    assert np.array_equal(image, names["plan"].simulate(names["scene"]))
    assert names["check"].passed and 0 < names["difference"].relative_l2 < 1e-3


def test_the_page_on_colour(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for _, blocks in sections("colour.md"):
        execute(blocks, "colour.md", names)
    peaks = [names[name].evaluate(0, 0).max() for name in ("green", "star")]
    assert all(0 < peak < 1 for peak in peaks)


def coming_from(section: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Run the blocks of a section and return their variables."""
    monkeypatch.chdir(folder)
    blocks = dict(sections("coming_from.md"))
    names: dict[str, Any] = {}
    execute([*blocks[""], *blocks[section]], "coming_from.md", names)
    return names


def over_peak(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Return the largest difference over the peak."""
    return float(np.abs(ours - theirs).max() / theirs.max())


def test_coming_from_galsim(tmp_path, monkeypatch):
    names = coming_from("GalSim", tmp_path, monkeypatch)
    # The error of interpolation between a dozen positions and between thirds of a pixel. The stars
    # of GalSim have 64 pixels, those of psfield 63.
    assert over_peak(names["ours"], names["theirs"].array) < 1e-3
    # The interpolation of the PSF as for stars, and the truncation of GalSim's transforms.
    assert over_peak(names["our_galaxy"], names["their_galaxy"]) < 2e-3
    # The first pixel is 1 in GalSim and 0 in psfield. A shift by one pixel must be detected.
    assert over_peak(names["ours"], np.roll(names["theirs"].array, 1, axis=1)) > 0.1


def test_coming_from_photutils(tmp_path, monkeypatch):
    names = coming_from("photutils", tmp_path, monkeypatch)
    # Both draw splines through the same pixels.
    assert over_peak(names["ours"], names["theirs"]) < 1e-6


def test_coming_from_regularizepsf(tmp_path, monkeypatch):
    names = coming_from("regularizepsf", tmp_path, monkeypatch)
    ours, theirs, exact = (names[name] for name in ("ours", "theirs", "exact"))
    # The error of interpolation between 5 x 5 positions, and that of patches stated on the page.
    assert np.linalg.norm(ours - exact) < 1e-3 * np.linalg.norm(exact)
    assert 2e-3 < np.linalg.norm(theirs - exact) / np.linalg.norm(exact) < 2e-2


@pytest.mark.parametrize("document", ["python.md", "coming_from.md", "colour.md"])
def test_links_lead_somewhere(document):
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        assert target.startswith("https://") or (ROOT / "docs" / target).exists(), (
            f"{document}: {target} is not there"
        )

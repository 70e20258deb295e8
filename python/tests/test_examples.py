"""The example programs."""

from __future__ import annotations

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

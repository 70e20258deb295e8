"""Helpers and fixtures that the tests share."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import psfield

# Plots are drawn without a window.
os.environ["MPLBACKEND"] = "Agg"

ROOT = Path(__file__).resolve().parents[2]


def gaussian_stamp(
    sigma: float, size: int = 17, shift: tuple[float, float] = (0.0, 0.0), q: float = 1.0
) -> np.ndarray:
    """Return a Gaussian of unit sum, centred at index ``size // 2``."""
    y, x = np.mgrid[:size, :size] - float(size // 2)
    stamp = np.exp(-0.5 * (((x - shift[0]) / sigma) ** 2 + ((y - shift[1]) / (q * sigma)) ** 2))
    return stamp / stamp.sum()


def widening_model(
    field: tuple[int, int] = (96, 128), across: int = 4, size: int = 17, **options: object
) -> psfield.PsfModel:
    """Return a model of Gaussians that widen to the right and lengthen upwards."""
    ny, nx = field
    grid = [(x, y) for y in np.linspace(0, ny - 1, across) for x in np.linspace(0, nx - 1, across)]
    stamps = [gaussian_stamp(1.3 + 0.9 * x / nx, size, q=1.0 + 0.3 * y / ny) for x, y in grid]
    return psfield.PsfModel.from_samples(stamps, grid, field_shape=field, **options)


def direct_sum(model: psfield.PsfModel, scene: np.ndarray) -> np.ndarray:
    """Return the image of a scene by definition: each pixel spreads with its own PSF."""
    ny, nx = scene.shape
    size_y, size_x = model.stamp_shape
    cx, cy = (int(c) for c in model.centre)
    image = np.zeros((ny + 2 * size_y, nx + 2 * size_x))
    rows, columns = np.nonzero(scene)
    stamps = model.evaluate(columns, rows)
    for row, column, stamp in zip(rows, columns, stamps):
        y, x = row - cy + size_y, column - cx + size_x
        image[y : y + size_y, x : x + size_x] += scene[row, column] * stamp
    return image[size_y : size_y + ny, size_x : size_x + nx]


def relative_l2(result: np.ndarray, reference: np.ndarray) -> float:
    """Return ``norm(result - reference) / norm(reference)``."""
    reference = np.asarray(reference, float)
    return float(np.linalg.norm(np.asarray(result, float) - reference) / np.linalg.norm(reference))


@pytest.fixture(scope="session")
def model() -> psfield.PsfModel:
    """A model over 96 x 128 pixels."""
    return widening_model()


@pytest.fixture(scope="session")
def scene() -> np.ndarray:
    """A scene of 96 x 128 pixels with faint light everywhere and some bright pixels."""
    rng = np.random.default_rng(7)
    light = rng.random((96, 128))
    light[rng.integers(0, 96, 20), rng.integers(0, 128, 20)] += 100.0
    return light


@pytest.fixture(scope="session")
def outside_data() -> Path:
    """The folder with data of other software. Skip the test if it is missing."""
    folder = Path(os.environ.get("PSFIELD_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"the data of other software are missing ({folder})")
    return folder


@pytest.fixture(scope="session")
def command() -> str:
    """The command ``psfield``, built from the same sources."""
    named = os.environ.get("PSFIELD_COMMAND")
    for candidate in (named, ROOT / "target" / "release" / "psfield", shutil.which("psfield")):
        if candidate and Path(candidate).is_file():
            return str(candidate)
    pytest.skip(
        "the command psfield is not built: run cargo build --release -p psfield-cli, or set"
        " PSFIELD_COMMAND to its path"
    )

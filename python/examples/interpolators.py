"""Swapping the interpolator: the same samples, carried over the field in different ways, against the truth between them.

    python interpolators.py [FOLDER]

Needs NumPy alone. Writes ``errors.csv`` to FOLDER (default: ``output/interpolators`` beside this file).

The PSF is that of a telescope with known optics, so that the truth is known everywhere. It is sampled once at random positions, as by
the stars of a frame, and once on a grid, as by a program; two thirds of a wave of aberrations at the corners make it vary a lot.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import psfield

SHAPE = (1024, 1024)
SAMPLES, TESTS, SEED = 100, 200, 11
#: Those that take samples anywhere, and those that need a grid.
ANYWHERE = [
    "delaunay",
    "natural-neighbour",
    "idw",
    "idw=4",
    "polynomial=2",
    "polynomial=4",
    "nearest",
]
ON_A_GRID = [*ANYWHERE, "bilinear", "bicubic"]


def stamp(x: float, y: float) -> NDArray[np.float64]:
    """Draw the PSF at a position: coma grows with the distance from the middle of the frame, astigmatism with its square."""
    v, u = np.mgrid[-32:32, -32:32] / 10.0
    aperture = (np.hypot(u, v) <= 1) & (np.hypot(u, v) > 0.3)
    fx, fy = (x - 511.5) / 511.5, (y - 511.5) / 511.5
    coma = 0.15 * (3 * (u**2 + v**2) - 2) * (fx * u + fy * v)
    astigmatism = 0.1 * ((fx**2 - fy**2) * (u**2 - v**2) + 4 * fx * fy * u * v)
    pupil = np.fft.fft2(aperture * np.exp(2j * np.pi * (coma + astigmatism)))
    psf = np.fft.fftshift(np.abs(pupil) ** 2)
    return psf / psf.sum()


def errors(
    positions: NDArray[np.float64], method: str, tests: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return relative errors at new positions, and the error that the model predicts without knowing the truth (median)."""
    model = psfield.PsfModel.from_samples(
        [stamp(x, y) for x, y in positions], positions, field_shape=SHAPE, interpolation=method
    )
    report = model.fit_report()
    drawn = model.evaluate(tests[:, 0], tests[:, 1])
    truth = np.array([stamp(x, y) for x, y in tests])
    wrong = np.linalg.norm(drawn - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
    return wrong, report["leave_one_out"]["median"]


def main(folder: Path) -> None:
    """Run the example; files go to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(SEED)
    ny, nx = SHAPE
    # The corners are sampled too: what lies outside the area of the samples could not be interpolated.
    corners = [(0, 0), (nx - 1, 0), (0, ny - 1), (nx - 1, ny - 1)]
    scattered = np.concatenate([corners, rng.uniform(0, nx - 1, (SAMPLES - 4, 2))])
    side = round(SAMPLES**0.5)
    grid = np.array(
        [(x, y) for y in np.linspace(0, ny - 1, side) for x in np.linspace(0, nx - 1, side)]
    )
    tests = rng.uniform(50, nx - 51, (TESTS, 2))

    rows = []
    for name, positions, methods in [("scattered", scattered, ANYWHERE), ("grid", grid, ON_A_GRID)]:
        for method in methods:
            wrong, predicted = errors(positions, method, tests)
            rows.append((name, method, float(np.median(wrong)), float(wrong.max()), predicted))

    print(f"relative L2 errors of the PSF at {TESTS} positions between {SAMPLES} samples")
    print(f"{'samples':10} {'interpolation':18} {'median':>9} {'largest':>9} {'leave one out':>14}")
    for name, method, median, largest, predicted in rows:
        print(f"{name:10} {method:18} {median:9.2e} {largest:9.2e} {predicted:14.2e}")
    with open(folder / "errors.csv", "w", newline="") as file:
        csv.writer(file).writerows(
            [("samples", "interpolation", "median", "largest", "leave_one_out"), *rows]
        )


if __name__ == "__main__":
    main(
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parent / "output" / Path(__file__).stem
    )

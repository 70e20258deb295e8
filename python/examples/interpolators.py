"""Compare interpolators: errors of the PSF between the same samples, for each interpolator.

    python interpolators.py [FOLDER]

Needs only NumPy. Writes ``errors.csv`` to FOLDER (default: ``output/interpolators`` next to this
file).

The PSF is that of a telescope with known optics, so that the truth is known everywhere. It is
sampled at random positions, like those of stars, and on a grid. Aberrations of two thirds of a wave
at the corners make it vary strongly.
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
#: Interpolators for samples at any positions, and all of them, including those that need a grid.
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
    """Draw the PSF at a position.

    Coma grows with the distance from the middle of the frame, astigmatism with its square.
    """
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
    """Return the errors at the test positions, and the median error that the fit predicts."""
    model = psfield.PsfModel.from_samples(
        [stamp(x, y) for x, y in positions], positions, field_shape=SHAPE, interpolation=method
    )
    report = model.fit_report()
    drawn = model.evaluate(tests[:, 0], tests[:, 1])
    truth = np.array([stamp(x, y) for x, y in tests])
    wrong = np.linalg.norm(drawn - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
    return wrong, report.leave_one_out.median


def main(folder: Path) -> None:
    """Run the example and write its files to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(SEED)
    ny, nx = SHAPE
    # The corners are sampled too, because positions outside the samples cannot be interpolated.
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

"""Time the drawing of galaxies through PSFs on a regular grid.

Usage: python benches/python/galaxies.py [COUNT] [SIZE] [TOLERANCE] [ROUNDS] [FWHM] [OVERSAMPLING]

First install the package. The program prints the time per galaxy of the first image, which also
makes the local PSFs of all blocks of the field, the median of the next images, and the peak memory
of this process. The half-light radii are log-normal about 1.5 pixels, from 0.3 to 8 pixels. The
PSFs are Moffat profiles of about this FWHM (pixels), averaged over a pixel.
"""

from __future__ import annotations

import resource
import statistics
import sys
import time

import numpy as np

import psfield

ACROSS, PIXELS = 7, 41


def stamp(u: float, v: float, fwhm: float, oversampling: int) -> np.ndarray:
    """Return a PSF. Its width and shear vary over the field (u, v = -0.5 ... 0.5)."""
    size = PIXELS * oversampling
    y, x = (np.mgrid[:size, :size] - size // 2) / oversampling
    radius = fwhm * (0.87 + 0.17 * (u * u + v * v) + 0.07 * u)
    g1, g2 = 0.06 * (u + 0.3 * u * v), 0.06 * (v - 0.3 * u)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    total = np.zeros((size, size))
    for dx, wx in zip(nodes / 2, weights / 2, strict=True):
        for dy, wy in zip(nodes / 2, weights / 2, strict=True):
            along = (1 - g1) * (x + dx) - g2 * (y + dy)
            across = (1 + g1) * (y + dy) - g2 * (x + dx)
            total += wx * wy * (1 + (along**2 + across**2) / radius**2) ** -2.5
    return total


def main() -> None:
    """Draw a catalogue several times."""
    given = [*sys.argv[1:], *["30000", "4096", "1e-4", "3", "2", "4"][len(sys.argv) - 1 :]]
    count, size, tolerance, rounds = int(given[0]), int(given[1]), float(given[2]), int(given[3])
    fwhm, oversampling = float(given[4]), int(given[5])
    rng = np.random.default_rng(1)
    catalog = {
        "x": rng.uniform(0, size - 1, count),
        "y": rng.uniform(0, size - 1, count),
        "flux": 10 ** rng.uniform(2, 5, count),
        "re": np.clip(1.5 * np.exp(0.5 * rng.normal(size=count)), 0.3, 8),
        "n": rng.uniform(0.5, 4, count),
        "q": rng.uniform(0.2, 1, count),
        "angle": rng.uniform(0, 180, count),
    }
    places = np.linspace(0, 1, ACROSS)
    positions = [(x * (size - 1), y * (size - 1)) for y in places for x in places]
    stamps = [stamp(x - 0.5, y - 0.5, fwhm, oversampling) for y in places for x in places]
    model = psfield.PsfModel.from_samples(
        stamps, positions, oversampling=oversampling, field_shape=(size, size)
    )
    plan = model.plan((size, size), tolerance=tolerance)
    image, seconds = None, []
    for _ in range(rounds + 1):
        began = time.perf_counter()
        image = plan.simulate(catalog=catalog, out=image)
        seconds.append(time.perf_counter() - began)
    first, others = seconds[0] / count * 1e6, statistics.median(seconds[1:]) / count * 1e6
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{count} galaxies on {size} x {size} pixels, tolerance {tolerance:g}")
    print(f"PSFs of FWHM {fwhm:g} pixels, {oversampling} samples per pixel")
    print(f"first image {first:.0f} us per galaxy, next images {others:.0f}; {memory:.2f} GiB")


if __name__ == "__main__":
    main()

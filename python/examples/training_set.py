"""Make a training set for a network: 1000 pairs of a sharp frame and its blurred image.

    python training_set.py [FOLDER]

Needs only NumPy. Writes ``sharp.npy`` and ``blurred.npy``, arrays ``[pair, y, x]`` in single
precision, to FOLDER (default: ``output/training_set`` next to this file). Read them with
``numpy.load(path, mmap_mode="r")``.
"""

from __future__ import annotations

import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

import psfield

PAIRS = 1000
SHAPE = (64, 64)
STARS, GALAXIES = 12, 6
SEED = 2024
#: Stamp pixels per frame pixel, for the PSF that is only the response of a pixel.
FINE = 4


def telescope() -> psfield.PsfModel:
    """Return a PSF that is sharp in one corner of the frame and aberrated in the opposite one."""
    v, u = np.mgrid[-32:32, -32:32] / 12.0
    aperture = (np.hypot(u, v) <= 1) & (np.hypot(u, v) > 0.3)

    def stamp(x: float, y: float) -> NDArray[np.float64]:
        field = np.hypot(x, y) / np.hypot(*SHAPE)
        coma, astigmatism = (
            0.25 * field * (3 * (u**2 + v**2) - 2) * u,
            0.15 * field**2 * (u**2 - v**2),
        )
        pupil = np.fft.fft2(aperture * np.exp(2j * np.pi * (coma + astigmatism)))
        # The middle of a transform of 64 pixels is pixel 32, the default centre of a stamp.
        return np.fft.fftshift(np.abs(pupil) ** 2)

    positions = [
        (x, y) for y in np.linspace(0, SHAPE[0] - 1, 5) for x in np.linspace(0, SHAPE[1] - 1, 5)
    ]
    # The stamps do not include the pixel response of the camera. Psfield applies it.
    return psfield.PsfModel.from_samples(
        [stamp(x, y) for x, y in positions],
        positions,
        field_shape=SHAPE,
        pixel_response_included=False,
    )


def main(folder: Path) -> None:
    """Run the example and write its files to a folder."""
    folder.mkdir(parents=True, exist_ok=True)

    # Plans are made once. A point without pixel response is given the response of a pixel. This
    # PSF draws the flux of a galaxy in each pixel.
    began = time.perf_counter()
    plan = telescope().plan(SHAPE, tolerance=1e-3)
    point = np.zeros((2 * FINE + 1, 2 * FINE + 1))
    point[FINE, FINE] = FINE**2
    pixel = psfield.PsfModel.from_samples(
        [point], [(0, 0)], oversampling=FINE, pixel_response_included=False
    )
    drawing = pixel.plan(SHAPE)
    print(f"plans made in {time.perf_counter() - began:.2f} s")

    sharp = open_memmap(folder / "sharp.npy", "w+", np.float32, (PAIRS, *SHAPE))
    blurred = open_memmap(folder / "blurred.npy", "w+", np.float32, (PAIRS, *SHAPE))

    def draw(pair: int) -> None:
        # One generator per pair, so that the set does not depend on the order of the threads.
        rng = np.random.default_rng([SEED, pair])
        galaxies = {
            "x": rng.uniform(-0.5, SHAPE[1] - 0.5, GALAXIES),
            "y": rng.uniform(-0.5, SHAPE[0] - 0.5, GALAXIES),
            "flux": 10 ** rng.uniform(3, 4.5, GALAXIES),
            "re": rng.uniform(2, 6, GALAXIES),
            "n": rng.uniform(0.8, 4, GALAXIES),
            "q": rng.uniform(0.3, 1, GALAXIES),
            "angle": rng.uniform(0, 180, GALAXIES),
        }
        drawing.simulate(catalog=galaxies, out=sharp[pair])
        at = rng.integers(0, SHAPE[0], STARS), rng.integers(0, SHAPE[1], STARS)
        np.add.at(sharp[pair], at, 10 ** rng.uniform(2, 4.5, STARS))

    def blur(pair: int) -> None:
        # Reads from one file and writes to the other, without a copy.
        plan.simulate(sharp[pair], out=blurred[pair])

    # Frames this small are too small for several threads. Each thread makes its own frames. Psfield
    # releases the lock of the interpreter, so that the threads run at the same time.
    psfield.set_threads(1)
    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        for stage, make in [("drawn", draw), ("blurred", blur)]:
            began = time.perf_counter()
            for _ in pool.map(make, range(PAIRS)):
                pass
            seconds = time.perf_counter() - began
            size, speed = f"{SHAPE[1]} x {SHAPE[0]} pixels", PAIRS / seconds
            print(
                f"{PAIRS} frames of {size} {stage} in {seconds:.2f} s: {speed:.0f} per second on"
                f" {workers} threads"
            )
    sharp.flush()
    blurred.flush()
    kept = blurred.sum(dtype=float) / sharp.sum(dtype=float)
    print(f"light that stays in the frames: {100 * kept:.1f} %")


if __name__ == "__main__":
    main(
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parent / "output" / Path(__file__).stem
    )

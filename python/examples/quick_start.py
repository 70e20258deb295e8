"""Quick start: a PSF that varies over the field, stars and galaxies, and an image that is checked against the exact sum.

    python quick_start.py [FOLDER]

Needs NumPy alone. Writes ``psf.fits`` (the model) and ``image.npy`` to FOLDER (default: ``output/quick_start`` beside this file).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import psfield

#: Rows and columns of the frame.
SHAPE = (512, 768)
#: Stamp pixels per frame pixel: stars that lie between pixels need a PSF that is sampled more finely than the frame.
OVERSAMPLING = 2
#: Pixels of the scene along each side of one of the frame: galaxies need pixels this fine, or these blur them.
FINER = 4
SEED = 1


def stamp(x: float, y: float) -> NDArray[np.float64]:
    """Draw the PSF at a position: an elliptical Gaussian, sharp and round in the middle, wide and drawn out at the corners."""
    ny, nx = SHAPE
    u, v = (x - nx / 2) / (nx / 2), (y - ny / 2) / (nx / 2)
    r = np.hypot(u, v)
    sigma, stretch, along = 1.3 + 0.5 * r**2, 1 + 0.25 * r**2, np.arctan2(v, u)
    dy, dx = np.mgrid[-24:25, -24:25] / OVERSAMPLING
    major, minor = dx * np.cos(along) + dy * np.sin(along), dy * np.cos(along) - dx * np.sin(along)
    return np.exp(-0.5 * ((major / (sigma * stretch)) ** 2 + (minor * stretch / sigma) ** 2))


def main(folder: Path) -> None:
    """Run the example; files go to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    ny, nx = SHAPE

    # 1. The model: stamps at positions, from which the PSF everywhere else is interpolated. Arrays are [y, x], positions (x, y), and an
    #    integer is the centre of a pixel, counted from 0. Every PSF is scaled to unit flux unless you say normalise="keep".
    positions = [(x, y) for y in np.linspace(0, ny - 1, 7) for x in np.linspace(0, nx - 1, 9)]
    model = psfield.PsfModel.from_samples(
        [stamp(x, y) for x, y in positions], positions, field_shape=SHAPE, oversampling=OVERSAMPLING
    )
    report = model.fit_report()
    print(model)
    predicted = report["leave_one_out"]["median"]
    print(
        f"{model.rank} components; samples reproduced to {report['max_error']:.1e}, predicted by the others to {predicted:.1e}"
    )
    model.write(folder / "psf.fits", overwrite=True)

    # 2. The plan: everything that does not depend on the light. The tolerance bounds the error that the engine adds to any single PSF.
    plan = model.plan((FINER * ny, FINER * nx), tolerance=1e-4, oversample=FINER)
    print(plan.describe())

    # 3. Light: an image (here a faint nebula), a catalogue, or both. With half-light radii "re" sources are galaxies; re = 0 is a star.
    #    The image has the scene's fine pixels, a catalogue counts in pixels of the frame.
    rng = np.random.default_rng(SEED)
    y, x = (np.mgrid[: FINER * ny, : FINER * nx] - (FINER - 1) / 2) / FINER
    nebula = 5 / FINER**2 * np.exp(-0.5 * (((x - 300) / 60) ** 2 + ((y - 200) / 40) ** 2))
    stars, galaxies = 300, 40
    count = stars + galaxies
    is_star = np.arange(count) < stars
    catalog = {
        "x": rng.uniform(40, nx - 41, count),
        "y": rng.uniform(40, ny - 41, count),
        "flux": 10 ** rng.uniform(2, 5, count),
        "re": np.where(is_star, 0, rng.uniform(2, 5, count)),
        "n": np.where(is_star, 1, rng.uniform(1, 4, count)),
        "q": np.where(is_star, 1, rng.uniform(0.3, 1, count)),
        "angle": rng.uniform(0, 180, count),
    }

    # 4. The image, as often as you like with the same plan.
    image = plan.simulate(nebula, catalog)
    np.save(folder / "image.npy", image)
    print(
        f"flux of the scene {nebula.sum() + catalog['flux'].sum():.1f}, of the image {image.sum(dtype=float):.1f}"
    )

    # 5. The image against the direct sum in double precision, at 500 random pixels.
    check = plan.spot_check(nebula, catalog, image=image, pixels=500)
    print(
        f"relative error at {check.pixels} pixels: {check.relative_rms:.1e} ({'as promised' if check.passed else 'more than promised'})"
    )


if __name__ == "__main__":
    main(
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parent / "output" / Path(__file__).stem
    )

"""Quick start: a PSF that varies over the field, stars and galaxies, an image and its check.

    python quick_start.py [FOLDER]

Needs only NumPy. Writes ``psf.fits`` (the model) and ``image.npy`` to FOLDER (default:
``output/quick_start`` next to this file).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import psfield

#: Rows and columns of the frame.
SHAPE = (512, 768)
#: Stamp pixels per frame pixel. Stars between pixels and galaxies need a PSF that is sampled more
#: finely than the frame.
OVERSAMPLING = 2
SEED = 1


def stamp(x: float, y: float) -> NDArray[np.float64]:
    """Draw the PSF at a position.

    It is a Gaussian, narrow and round in the middle of the frame, wide and long at the corners.
    """
    ny, nx = SHAPE
    u, v = (x - nx / 2) / (nx / 2), (y - ny / 2) / (nx / 2)
    r = np.hypot(u, v)
    sigma, stretch, along = 1.3 + 0.5 * r**2, 1 + 0.25 * r**2, np.arctan2(v, u)
    dy, dx = np.mgrid[-24:25, -24:25] / OVERSAMPLING
    major, minor = dx * np.cos(along) + dy * np.sin(along), dy * np.cos(along) - dx * np.sin(along)
    return np.exp(-0.5 * ((major / (sigma * stretch)) ** 2 + (minor * stretch / sigma) ** 2))


def main(folder: Path) -> None:
    """Run the example and write its files to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    ny, nx = SHAPE

    # 1. The model: stamps at positions, between which the PSF is interpolated. Arrays are [y, x].
    #    Positions are (x, y), counted from 0, and an integer is the centre of a pixel. Every PSF is
    #    scaled to unit flux, unless you give normalise="keep".
    positions = [(x, y) for y in np.linspace(0, ny - 1, 7) for x in np.linspace(0, nx - 1, 9)]
    model = psfield.PsfModel.from_samples(
        [stamp(x, y) for x, y in positions], positions, field_shape=SHAPE, oversampling=OVERSAMPLING
    )
    report = model.fit_report()
    print(model)
    predicted = report.leave_one_out.median
    print(
        f"{model.rank} components, error of the samples {report.max_error:.1e}, error of their"
        f" prediction from the others {predicted:.1e}"
    )
    model.write(folder / "psf.fits", overwrite=True)

    # 2. The plan: everything that does not depend on the light. The tolerance bounds the error that
    #    the engine adds to any single PSF.
    plan = model.plan(SHAPE, tolerance=1e-4)
    print(plan.describe())

    # 3. Light: an image (here a faint nebula), a catalogue, or both. Sources with a half-light
    #    radius "re" are galaxies, and re = 0 means a star.
    rng = np.random.default_rng(SEED)
    y, x = np.mgrid[:ny, :nx]
    nebula = 5 * np.exp(-0.5 * (((x - 300) / 60) ** 2 + ((y - 200) / 40) ** 2))
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

    # 4. The image. A plan can simulate any number of scenes.
    image = plan.simulate(nebula, catalog)
    np.save(folder / "image.npy", image)
    light = nebula.sum() + catalog["flux"].sum()
    print(f"flux of the scene {light:.1f}, of the image {image.sum(dtype=float):.1f}")

    # 5. Compare the image with the direct sum in double precision at 500 random pixels.
    check = plan.spot_check(nebula, catalog, image=image, pixels=500)
    verdict = "as promised" if check.passed else "more than promised"
    print(f"relative error at {check.pixels} pixels: {check.relative_rms:.1e} ({verdict})")


if __name__ == "__main__":
    main(
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parent / "output" / Path(__file__).stem
    )

"""Richardson-Lucy deconvolution with a PSF that varies over the field, by a plan and its adjoint.

    python richardson_lucy.py [FOLDER]

Needs astropy. Writes ``deconvolved.fits`` (the image, with the result and the truth in extensions)
to FOLDER (default: ``output/richardson_lucy`` next to this file). If matplotlib is installed, it
also writes ``deconvolved.png``.

For an image ``d`` and the operator ``A`` that blurs scenes, each iteration is
``f <- f * A^T(d / A f) / A^T 1`` (Richardson 1972, Lucy 1974). ``A`` is ``plan.simulate`` and
``A^T`` is ``plan.adjoint``.
"""

from __future__ import annotations

import importlib.util
import itertools
import sys
from pathlib import Path

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

import psfield

SHAPE = (256, 256)
ITERATIONS = 20
SEED = 5
#: Stamp pixels per frame pixel, for the PSF that is only the response of a pixel.
FINE = 4

Image = NDArray[np.float64]


def telescope() -> psfield.PsfModel:
    """Return a PSF with coma and astigmatism that grow from the middle of the frame."""
    v, u = np.mgrid[-32:32, -32:32] / 12.0
    aperture = (np.hypot(u, v) <= 1) & (np.hypot(u, v) > 0.3)

    def stamp(x: float, y: float) -> Image:
        fx, fy = (x - 127.5) / 127.5, (y - 127.5) / 127.5
        coma = 0.2 * (3 * (u**2 + v**2) - 2) * (fx * u + fy * v)
        astigmatism = 0.25 * ((fx**2 - fy**2) * (u**2 - v**2) + 4 * fx * fy * u * v)
        pupil = np.fft.fft2(aperture * np.exp(2j * np.pi * (coma + astigmatism)))
        return np.fft.fftshift(np.abs(pupil) ** 2)

    positions = [(x, y) for y in np.linspace(0, 255, 9) for x in np.linspace(0, 255, 9)]
    return psfield.PsfModel.from_samples(
        [stamp(x, y) for x, y in positions],
        positions,
        field_shape=SHAPE,
        pixel_response_included=False,
    )


def scene() -> Image:
    """Return the truth: stars, a faint sky, and the flux of galaxies in each pixel."""
    rng = np.random.default_rng(SEED)
    count = 25
    galaxies = {
        "x": rng.uniform(10, 245, count),
        "y": rng.uniform(10, 245, count),
        "flux": rng.uniform(1e4, 1e5, count),
        "re": rng.uniform(3, 8, count),
        "n": np.ones(count),
        "q": rng.uniform(0.3, 1, count),
        "angle": rng.uniform(0, 180, count),
    }
    # A point without pixel response is given the response of a pixel. This PSF draws the flux of a
    # galaxy in each pixel.
    point = np.zeros((2 * FINE + 1, 2 * FINE + 1))
    point[FINE, FINE] = FINE**2
    pixel = psfield.PsfModel.from_samples(
        [point], [(0, 0)], oversampling=FINE, pixel_response_included=False
    )
    truth = 20.0 + pixel.plan(SHAPE, precision="f64").simulate(catalog=galaxies)
    np.add.at(
        truth, (rng.integers(10, 246, 40), rng.integers(10, 246, 40)), rng.uniform(1e3, 1e4, 40)
    )
    return truth


def richardson_lucy(plan: psfield.Plan, image: Image, truth: Image) -> tuple[Image, list[float]]:
    """Return the deconvolved image, and after each iteration its relative error."""
    errors = []
    norm = plan.adjoint(np.ones(plan.image_shape))
    estimate = np.full(plan.shape, image.mean())
    for _ in range(ITERATIONS):
        estimate *= plan.adjoint(image / plan.simulate(estimate)) / norm
        errors.append(float(np.linalg.norm(estimate - truth) / np.linalg.norm(truth)))
    return estimate, errors


def plot(path: Path, panels: dict[str, Image]) -> None:
    """Draw images side by side."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(panels), figsize=(4 * len(panels), 4), layout="constrained")
    for axis, (title, image) in zip(axes, panels.items()):
        axis.imshow(np.arcsinh(image / 50), origin="lower", cmap="gray")
        axis.set(title=title, xticks=[], yticks=[])
    figure.savefig(path)


def main(folder: Path) -> None:
    """Run the example and write its files to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    model, truth = telescope(), scene()
    plan = model.plan(SHAPE, tolerance=1e-6, precision="f64")

    # (A f) . g = f . (A^T g) must hold for all f and g. Otherwise the iteration may diverge.
    rng = np.random.default_rng(SEED)
    f, g = rng.normal(size=SHAPE), rng.normal(size=SHAPE)
    forth, back = np.vdot(plan.simulate(f), g), np.vdot(f, plan.adjoint(g))
    print(f"the adjoint is exact to {abs(forth - back) / abs(forth):.0e}")

    # Photon noise.
    image = rng.poisson(plan.simulate(truth)).astype(float)
    result, errors = richardson_lucy(plan, image, truth)
    print("iteration  relative error")
    print(*(f"{i + 1:9}  {error:.4f}" for i, error in enumerate(errors)), sep="\n")
    falls = all(a > b for a, b in itertools.pairwise(errors))
    print(f"the error fell in each of {ITERATIONS} iterations: {falls}")

    # For comparison: deconvolution with a single PSF, that of the middle of the frame.
    single = psfield.PsfModel.from_samples(
        [model.evaluate(127.5, 127.5)], [(0, 0)], pixel_response_included=False
    )
    _, with_one = richardson_lucy(single.plan(SHAPE, tolerance=1e-6, precision="f64"), image, truth)
    print(f"with the PSF of the middle for the whole frame the error ends at {with_one[-1]:.4f}")

    hdus = [
        fits.PrimaryHDU(image),
        fits.ImageHDU(result, name="RESULT"),
        fits.ImageHDU(truth, name="TRUTH"),
    ]
    fits.HDUList(hdus).writeto(folder / "deconvolved.fits", overwrite=True)
    if importlib.util.find_spec("matplotlib"):
        plot(
            folder / "deconvolved.png",
            {"image": image, f"{ITERATIONS} iterations": result, "truth": truth},
        )


if __name__ == "__main__":
    main(
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parent / "output" / Path(__file__).stem
    )

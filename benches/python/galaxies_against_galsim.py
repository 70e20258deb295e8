"""Compare galaxies with GalSim: random galaxies, each through several PSFs.

Usage: python benches/python/galaxies_against_galsim.py [COUNT] [FILE]

First install the package, galsim and scipy. For each PSF the program prints the largest differences
over COUNT galaxies (12 if not given): of a pixel relative to the galaxy's peak, of the reduced
shear, and of the size. Shear and size are adaptive moments of both images. The galaxies have
half-light radii of 0.1 to 8 pixels, indices of 0.5 to 6 and axis ratios of 0.2 to 1. One more PSF
is taken from FILE, if given, at the first pixel of its field.

GalSim convolves the same function: the cubic spline of the stamps, at so many points per pixel that
its own interpolation between them does not matter.
"""

from __future__ import annotations

import sys
import warnings

import galsim
import numpy as np
from scipy import ndimage

import psfield

SIZE, MARGIN = 256, 12
#: Points per frame pixel at which GalSim gets the spline, for stamps that are not finer than half.
FINE = 8
#: Fractions of the flux that GalSim may fold back, the first one that its memory allows.
FOLDING = 1e-5, 1e-4, 1e-3, 5e-3


def moffat(fwhm: float, oversampling: int) -> np.ndarray:
    """Return a Moffat profile that reaches 20 pixels far."""
    half = 20 * oversampling
    y, x = np.mgrid[-half : half + 1, -half : half + 1] / oversampling
    radius = fwhm / (2 * np.sqrt(2**0.4 - 1))
    return (1 + (x**2 + y**2) / radius**2) ** -2.5


def interpolated(stamp: np.ndarray, oversampling: int) -> tuple[np.ndarray, int]:
    """Return the cubic spline of a stamp on finer points, and their number per frame pixel."""
    fine = max(2, FINE // oversampling)
    # Pixels outside the stamp count as 0.
    padded = np.pad(stamp, MARGIN)
    coefficients = ndimage.spline_filter(padded, order=3, mode="grid-constant")
    half = fine * (stamp.shape[0] // 2 + MARGIN - 2)
    at = np.arange(-half, half + 1) / fine + padded.shape[0] // 2
    places = np.meshgrid(at, at, indexing="ij")
    return ndimage.map_coordinates(coefficients, places, prefilter=False), fine * oversampling


def of_galsim(
    stamp: np.ndarray, oversampling: int, galaxy: dict[str, float]
) -> tuple[np.ndarray, float]:
    """Return GalSim's image, and the flux that may be folded back."""
    for folding in FOLDING:
        accurate = galsim.GSParams(
            folding_threshold=folding,
            maxk_threshold=1e-5,
            kvalue_accuracy=1e-8,
            stepk_minimum_hlr=5,
            maximum_fft_size=12288,
        )
        psf = galsim.InterpolatedImage(
            galsim.ImageD(stamp),
            scale=1 / oversampling,
            x_interpolant="lanczos15",
            normalization="sb",
            use_true_center=False,
            gsparams=accurate,
            calculate_stepk=False,
            calculate_maxk=False,
            # The transform of the points is repeated farther out, too faint to matter.
            _force_maxk=2 * np.pi * oversampling,
        )
        # The half-light radius of GalSim is that of the round profile of equal area.
        radius = galaxy["re"] * np.sqrt(galaxy["q"])
        light = galsim.Sersic(n=galaxy["n"], half_light_radius=radius, gsparams=accurate)
        light = light.shear(q=galaxy["q"], beta=galaxy["angle"] * galsim.degrees)
        offset = [galaxy[axis] - (SIZE - 1) / 2 for axis in "xy"]
        try:
            drawn = galsim.Convolve(light, psf, gsparams=accurate).drawImage(
                nx=SIZE, ny=SIZE, scale=1, method="no_pixel", dtype=float, offset=offset
            )
        except galsim.GalSimFFTSizeWarning:
            continue
        return drawn.array, folding
    msg = f"GalSim needs too large a transform for {galaxy}"
    raise MemoryError(msg)


def shape(image: np.ndarray, galaxy: dict[str, float]) -> np.ndarray:
    """Return the reduced shear and the size by adaptive moments."""
    for guess in 3, 1.5, 1:
        found = galsim.hsm.FindAdaptiveMom(
            galsim.ImageD(image),
            guess_sig=guess,
            guess_centroid=galsim.PositionD(galaxy["x"] + 1, galaxy["y"] + 1),
            hsmparams=galsim.hsm.HSMParams(convergence_threshold=1e-9, max_mom2_iter=2000),
            strict=False,
        )
        if not found.error_message:
            break
    return np.array([found.observed_shape.g1, found.observed_shape.g2, found.moments_sigma])


def main() -> None:
    """Compare all galaxies through all PSFs."""
    # GalSim warns before it makes a transform that is larger than the maximum.
    warnings.simplefilter("error", galsim.GalSimFFTSizeWarning)
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    psfs = [
        (f"Moffat, FWHM {fwhm} pixels, {s} x sampled", moffat(fwhm, s), s)
        for fwhm, s in [(2, 4), (3, 4), (4, 4), (4, 1), (6, 1)]
    ]
    if len(sys.argv) > 2:
        read = psfield.PsfModel.read(sys.argv[2])
        psfs.append((sys.argv[2], read.evaluate(0, 0), round(read.oversampling)))
    rng = np.random.default_rng(1)
    for name, stamp, s in psfs:
        stamp = stamp / stamp.sum() * s * s
        model = psfield.PsfModel.from_samples([stamp], [(0, 0)], oversampling=s)
        plan = model.plan((SIZE, SIZE), tolerance=1e-5, precision="f64")
        worst, foldings = np.zeros(3), []
        for _ in range(count):
            galaxy = {
                "x": rng.uniform(0.4, 0.6) * SIZE,
                "y": rng.uniform(0.4, 0.6) * SIZE,
                "re": 10 ** rng.uniform(-1, np.log10(8)),
                "n": rng.uniform(0.5, 6),
                "q": rng.uniform(0.2, 1),
                "angle": rng.uniform(0, 180),
            }
            ours = plan.simulate(catalog={**galaxy, "flux": 1})
            theirs, folding = of_galsim(*interpolated(stamp, s), galaxy)
            own, other = shape(ours, galaxy), shape(theirs, galaxy)
            errors = np.abs(own - other)
            errors = [
                np.abs(ours - theirs).max() / theirs.max(),
                errors[:2].max(),
                errors[2] / other[2],
            ]
            worst = np.maximum(worst, errors)
            foldings.append(folding)
        error, shear, size = worst
        print(f"{name}: pixel {error:.1e}, shear {shear:.1e}, size {size:.1e}")
        print(f"  GalSim folded back up to {max(foldings):g} of the flux")


if __name__ == "__main__":
    main()

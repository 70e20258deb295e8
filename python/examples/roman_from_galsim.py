"""Sample Roman's PSF over a detector with GalSim, and simulate a frame of stars and galaxies.

    python roman_from_galsim.py [FOLDER]

Needs GalSim and astropy. Writes ``roman_psf.fits`` (the model) and ``image.fits`` (4088 x 4088
pixels) to FOLDER (default: ``output/roman_from_galsim`` next to this file).

GalSim takes 30 ms for each PSF. Psfield requests PSFs until the interpolation between them is as
accurate as you ask. Then it draws any number of stars, each with the PSF at its own position.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import galsim
import galsim.roman
import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

import psfield

SCA, BAND = 7, "H158"
#: Rows and columns of the detector.
SHAPE = (galsim.roman.n_pix, galsim.roman.n_pix)
#: Roman's pixels are too coarse for its PSF. Draw the PSF on pixels of a quarter of their width.
OVERSAMPLING = 4
#: GalSim centres a PSF in the middle of the stamp. An odd size puts it on a pixel, which is the
#: centre of the stamp for psfield.
STAMP_SIZE = 32 * OVERSAMPLING + 1
#: The relative error of interpolation between neighbours at which the sampling stops.
THRESHOLD = 0.005
STARS, GALAXIES, SEED = 20_000, 200, 7
#: The mean wavelength of the band in nm. GalSim uses every eighth pixel of the pupil (with 4 it is
#: more accurate and 4 times slower).
WAVELENGTH = galsim.roman.getBandpasses()[BAND].effective_wavelength
PUPIL_BIN = 8


def optics(x: float, y: float) -> galsim.GSObject:
    """Return the PSF of the telescope at a position. GalSim counts pixels from 1."""
    position = galsim.PositionD(x + 1, y + 1)
    return galsim.roman.getPSF(
        SCA, BAND, SCA_pos=position, wavelength=WAVELENGTH, pupil_bin=PUPIL_BIN
    )


def stamp(x: float, y: float) -> NDArray[np.float64]:
    """Draw the PSF at a position with the response of a detector pixel, on fine pixels."""
    psf = galsim.Convolve(optics(x, y), galsim.Pixel(galsim.roman.pixel_scale))
    # The PSF already includes the pixel response, so "no_pixel" is right.
    fine = psf.drawImage(
        nx=STAMP_SIZE,
        ny=STAMP_SIZE,
        scale=galsim.roman.pixel_scale / OVERSAMPLING,
        method="no_pixel",
    )
    # GalSim returns the flux in a fine pixel. Stamps of psfield hold the flux in a detector pixel
    # centred there.
    return fine.array.astype(float) * OVERSAMPLING**2


def against_galsim(model: psfield.PsfModel, count: int) -> NDArray[np.float64]:
    """Return the differences between stars of the model and of GalSim, over the peak."""
    rng = np.random.default_rng(SEED)
    errors = []
    for x, y in rng.uniform(0, SHAPE[0] - 1, (count, 2)):
        ours = model.evaluate(x, y, pixels="frame", size=25, sub_pixel=True)
        # The pixel that contains the star is the middle of the stamp.
        shift = galsim.PositionD(x - np.floor(x + 0.5), y - np.floor(y + 0.5))
        theirs = (
            optics(x, y).drawImage(nx=25, ny=25, scale=galsim.roman.pixel_scale, offset=shift).array
        )
        errors.append(np.abs(ours - theirs).max() / theirs.max())
    return np.array(errors)


def main(folder: Path) -> None:
    """Run the example and write its files to a folder."""
    folder.mkdir(parents=True, exist_ok=True)

    # The sampling calls GalSim where the PSF varies. "keep" keeps the values of GalSim: light
    # outside the stamp is lost, as in GalSim. The default "unit" would scale every PSF to unit
    # flux. These PSFs are computed, not measured, and have no noise.
    began = time.perf_counter()
    model = psfield.PsfModel.from_function(
        stamp,
        SHAPE,
        threshold=THRESHOLD,
        start=(3, 3),
        oversampling=OVERSAMPLING,
        normalise="keep",
        noise=0,
    )
    seconds, how = time.perf_counter() - began, model.sampling
    print(
        f"{how.samples} samples, {how.draws} PSFs drawn by GalSim in {seconds:.1f} s:"
        f" threshold {how.outcome}"
    )
    model.write(folder / "roman_psf.fits", overwrite=True)

    errors = against_galsim(model, 10)
    print(
        f"10 stars at new positions against GalSim: {np.median(errors):.1e} of the peak (median),"
        f" {errors.max():.1e} at most"
    )

    rng = np.random.default_rng(SEED)
    count = STARS + GALAXIES
    is_star = np.arange(count) < STARS
    catalog = {
        "x": rng.uniform(0, SHAPE[1] - 1, count),
        "y": rng.uniform(0, SHAPE[0] - 1, count),
        # The number of sources above a flux is inversely proportional to the flux.
        "flux": 1e3 / rng.uniform(1e-3, 1, count),
        "re": np.where(is_star, 0, rng.uniform(2, 12, count)),
        "n": np.where(is_star, 1, rng.choice([1.0, 4.0], count)),
        "q": np.where(is_star, 1, rng.uniform(0.3, 1, count)),
        "angle": rng.uniform(0, 180, count),
    }
    plan = model.plan(SHAPE, tolerance=1e-3)
    began = time.perf_counter()
    image = plan.simulate(catalog=catalog)
    seconds = time.perf_counter() - began
    size = f"{SHAPE[1]} x {SHAPE[0]} pixels"
    print(f"{STARS} stars and {GALAXIES} galaxies on {size} in {seconds:.1f} s")

    header = fits.Header(
        [
            ("TELESCOP", "Roman"),
            ("DETECTOR", f"SCA{SCA:02}"),
            ("FILTER", BAND),
            ("PSFTOL", plan.tolerance),
        ]
    )
    fits.writeto(folder / "image.fits", image, header, overwrite=True)


if __name__ == "__main__":
    main(
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parent / "output" / Path(__file__).stem
    )

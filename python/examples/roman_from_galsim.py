"""Roman's PSF over a whole detector, taken from GalSim at the few positions that it needs, and a frame of stars and galaxies.

    python roman_from_galsim.py [FOLDER]

Needs GalSim and astropy. Writes ``roman_psf.fits`` (the model) and ``image.fits`` (4088 x 4088 pixels) to FOLDER (default:
``output/roman_from_galsim`` beside this file).

GalSim takes 30 ms for each PSF. psfield asks for as many as are needed until interpolation between them is as good as you want,
and then draws any number of stars, each with the PSF of its own position.
"""

from __future__ import annotations

import sys
import time
import warnings
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
#: Roman's pixels are too coarse for its PSF: draw it on pixels a quarter as wide.
OVERSAMPLING = 4
#: Odd, so that GalSim, which centres a PSF on the middle of the stamp, puts it on a pixel: the one that psfield takes as the centre.
STAMP_SIZE = 32 * OVERSAMPLING + 1
#: Where sampling may stop: the relative error of interpolating between neighbours.
THRESHOLD = 0.005
STARS, GALAXIES, SEED = 20_000, 200, 7
#: GalSim takes the mean wavelength of the band, in nm, and every eighth pixel of the pupil (4 is finer, and 4 times slower).
WAVELENGTH = galsim.roman.getBandpasses()[BAND].effective_wavelength
PUPIL_BIN = 8


def optics(x: float, y: float) -> galsim.GSObject:
    """Return the PSF of the telescope at a position, of which GalSim counts pixels from 1."""
    position = galsim.PositionD(x + 1, y + 1)
    return galsim.roman.getPSF(
        SCA, BAND, SCA_pos=position, wavelength=WAVELENGTH, pupil_bin=PUPIL_BIN
    )


def stamp(x: float, y: float) -> NDArray[np.float64]:
    """Draw the PSF at a position with the response of a detector pixel, on fine pixels."""
    psf = galsim.Convolve(optics(x, y), galsim.Pixel(galsim.roman.pixel_scale))
    # The pixel is in it already: "no_pixel" only looks up values.
    fine = psf.drawImage(
        nx=STAMP_SIZE,
        ny=STAMP_SIZE,
        scale=galsim.roman.pixel_scale / OVERSAMPLING,
        method="no_pixel",
    )
    # GalSim gives the flux in a fine pixel; psfield's stamps hold the flux in a detector pixel centred there.
    return fine.array.astype(float) * OVERSAMPLING**2


def against_galsim(model: psfield.PsfModel, count: int) -> NDArray[np.float64]:
    """Return errors over the peak of stars at random places, drawn by the model and by GalSim."""
    rng = np.random.default_rng(SEED)
    errors = []
    for x, y in rng.uniform(0, SHAPE[0] - 1, (count, 2)):
        ours = model.evaluate(x, y, pixels="frame", size=25, sub_pixel=True)
        # The pixel that the star falls on is the middle of the stamp.
        shift = galsim.PositionD(x - np.floor(x + 0.5), y - np.floor(y + 0.5))
        theirs = (
            optics(x, y).drawImage(nx=25, ny=25, scale=galsim.roman.pixel_scale, offset=shift).array
        )
        errors.append(np.abs(ours - theirs).max() / theirs.max())
    return np.array(errors)


def main(folder: Path) -> None:
    """Run the example; files go to a folder."""
    folder.mkdir(parents=True, exist_ok=True)

    # Sampling asks GalSim where the PSF varies. "keep" leaves the values as GalSim gives them: what falls off the stamp stays lost, as it
    # would be in GalSim; with the default, "unit", every PSF would be scaled to unit flux. These PSFs are computed, not measured: noise=0.
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
        f"{how['samples']} samples, {how['draws']} PSFs drawn by GalSim in {seconds:.1f} s: threshold {how['outcome']}"
    )
    model.write(folder / "roman_psf.fits", overwrite=True)

    errors = against_galsim(model, 10)
    print(
        f"10 stars at new positions against GalSim: {np.median(errors):.1e} of the peak (median), {errors.max():.1e} at most"
    )

    rng = np.random.default_rng(SEED)
    count = STARS + GALAXIES
    is_star = np.arange(count) < STARS
    catalog = {
        "x": rng.uniform(0, SHAPE[1] - 1, count),
        "y": rng.uniform(0, SHAPE[0] - 1, count),
        # Twice as many at half the flux, as the sky has it.
        "flux": 1e3 / rng.uniform(1e-3, 1, count),
        "re": np.where(is_star, 0, rng.uniform(2, 12, count)),
        "n": np.where(is_star, 1, rng.choice([1.0, 4.0], count)),
        "q": np.where(is_star, 1, rng.uniform(0.3, 1, count)),
        "angle": rng.uniform(0, 180, count),
    }
    # On the frame's own pixels, which blur galaxies by percents of their peaks; oversample=4 takes sixteen times as many pixels.
    warnings.filterwarnings("ignore", r"\d+ galaxies are blurred", psfield.PsfieldWarning)
    plan = model.plan(SHAPE, tolerance=1e-3)
    began = time.perf_counter()
    image = plan.simulate(catalog=catalog)
    print(
        f"{STARS} stars and {GALAXIES} galaxies on {SHAPE[1]} x {SHAPE[0]} pixels in {time.perf_counter() - began:.1f} s"
    )

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

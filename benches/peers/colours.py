"""Compares stars in colour with GalSim: Roman's PSF in a band, six black bodies.

    pip install -r benches/peers/requirements.txt
    python benches/peers/colours.py --psfield target/release/psfield --work FOLDER

The PSF is sampled by GalSim at 5 x 5 positions of a tile of 512 x 512 pixels and at 9 wavelengths.
psfield interpolates between them. The reference is GalSim's monochromatic PSF at the position of
each star, at 96 wavelengths, added up with the weights of the detected photons. Errors are the
largest in a stamp, relative to its peak. GalSim's own chromatic drawing is compared with the same
reference.

The PSF itself is for the benchmark of images in colour:

    python benches/peers/colours.py --band Y106 --stars 0 --work FOLDER
    psfield bench --real=colours --psf FOLDER/psf.fits --sizes 9216
"""

import argparse
import json
import subprocess
import time
import warnings
from functools import partial
from itertools import pairwise
from multiprocessing.pool import Pool
from pathlib import Path

import galsim
import galsim.roman
import numpy as np
from astropy.io import fits

DETECTOR, PUPIL_BIN = 7, 8
SIDE, FIRST = 512, 1800  # the tile, and its first pixel on the detector
STAMP, OVERSAMPLING = 64, 4
KELVIN = [2500, 3500, 5000, 7000, 10000, 20000]
FINE = 96  # wavelengths of the reference
OWN_DRAWINGS = 6  # stars that GalSim's chromatic drawing draws, too
HC_OVER_K_NM_K = 14387768.775
PARAMS = galsim.GSParams(
    folding_threshold=2e-4, maxk_threshold=1e-4, kvalue_accuracy=1e-6, maximum_fft_size=32768
)
SCALE = galsim.roman.pixel_scale


def psf(band: str, x: float, y: float, wavelength: float | None = None):
    """Return GalSim's PSF at a position of the tile, of one wavelength (nm) or chromatic."""
    position = galsim.PositionD(FIRST + x + 1, FIRST + y + 1)
    options = {} if wavelength is None else {"wavelength": wavelength}
    return galsim.roman.getPSF(
        DETECTOR, band, SCA_pos=position, pupil_bin=PUPIL_BIN, gsparams=PARAMS, **options
    )


def photons(wavelength, kelvin: float):
    """Return the photons per wavelength of a black body, up to a factor."""
    return wavelength**-4.0 / np.expm1(HC_OVER_K_NM_K / (wavelength * kelvin))


def sampled(band: str, x: float, y: float, wavelength: float) -> np.ndarray:
    """Return an oversampled stamp, put together from native draws at sub-pixel shifts.

    GalSim's draws with finer pixels differ from its native ones by up to 0.2 % of the peak.
    """
    size, drawn = STAMP * OVERSAMPLING + 1, psf(band, x, y, wavelength)
    stamp = np.zeros((size, size))
    for row in range(OVERSAMPLING):
        for column in range(OVERSAMPLING):
            part = stamp[row::OVERSAMPLING, column::OVERSAMPLING]
            image = galsim.ImageD(part.shape[1], part.shape[0], scale=SCALE)
            centre = [(size // 2 - first) / OVERSAMPLING + 1 for first in (column, row)]
            drawn.drawImage(image=image, center=galsim.PositionD(*centre))
            part[:] = image.array
    return stamp


def write_samples(path: Path, band: str, wavelengths: np.ndarray, pool: Pool) -> None:
    """Write PSF samples in psfield's layout."""
    at = np.linspace(0, SIDE - 1, 5)
    rows = [(band, x, y, w) for y in at for x in at for w in wavelengths]
    cube = fits.PrimaryHDU(np.array(pool.starmap(sampled, rows)))
    cube.header["OVERSAMP"] = OVERSAMPLING
    cube.header["FIELDNX"] = cube.header["FIELDNY"] = SIDE
    x, y, w = np.array([row[1:] for row in rows]).T
    columns = [fits.Column("X", "D", array=x), fits.Column("Y", "D", array=y)]
    columns.append(fits.Column("WAVELENGTH", "D", unit="nm", array=w))
    table = fits.BinTableHDU.from_columns(columns, name="POSITIONS")
    fits.HDUList([cube, table]).writeto(path, overwrite=True)


def stamp_about(x: float, y: float) -> galsim.ImageD:
    """Return an empty image around a star."""
    column, row = round(x), round(y)
    return galsim.ImageD(galsim.BoundsI(column - 32, column + 31, row - 32, row + 31), scale=SCALE)


def reference(band: str, star: tuple[float, float, float]) -> np.ndarray:
    """Return the sum of monochromatic PSFs, weighted by detected photons.

    A star is x, y and the temperature in kelvin.
    """
    warnings.simplefilter("ignore")
    x, y, kelvin = star
    bandpass = galsim.roman.getBandpasses(AB_zeropoint=True)[band]
    edges = np.linspace(bandpass.blue_limit, bandpass.red_limit, FINE + 1)
    total, weights = 0.0, 0.0
    for low, high in pairwise(edges):
        points = low + (high - low) * (np.arange(20) + 0.5) / 20
        weight = float(np.sum(photons(points, kelvin) * [bandpass(w) for w in points]))
        mono = psf(band, x, y, (low + high) / 2)
        total = (
            total
            + weight * mono.drawImage(image=stamp_about(x, y), center=galsim.PositionD(x, y)).array
        )
        weights += weight
    return total / weights


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--psfield", default="target/release/psfield")
    parser.add_argument("--work", type=Path, default=Path("colours"))
    parser.add_argument(
        "--stars",
        type=int,
        default=6,
        help="stars that are compared (20 s each); 0: make the PSF only",
    )
    parser.add_argument("--processes", type=int, default=2, help="processes of GalSim")
    parser.add_argument("--timed", type=int, default=2000, help="stars of the timing")
    parser.add_argument("--band", default="W146", help="a band of galsim.roman")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    given.work.mkdir(exist_ok=True)
    path = {
        name: str(given.work / name)
        for name in ("samples.fits", "psf.fits", "band.csv", "stars.csv", "image.fits")
    }
    bandpass = galsim.roman.getBandpasses(AB_zeropoint=True)[given.band]
    wavelengths = np.linspace(bandpass.blue_limit, bandpass.red_limit, 9)
    pool = Pool(given.processes)
    write_samples(path["samples.fits"], given.band, wavelengths, pool)
    fit = ["fit", path["samples.fits"], "-o", path["psf.fits"], "--overwrite", "-q"]
    subprocess.run([given.psfield, *fit, "--rank", "error=1e-6", "--normalise", "keep"], check=True)
    band = [(w, bandpass(w)) for w in bandpass.wave_list]
    np.savetxt(
        path["band.csv"], band, delimiter=",", header="wavelength_nm,throughput", comments=""
    )

    def simulated(x, y, kelvin, *options: str) -> dict:
        rows = "".join(f"{a},{b},1,blackbody:{t}\n" for a, b, t in zip(x, y, kelvin, strict=True))
        Path(path["stars.csv"]).write_text("x,y,flux,sed\n" + rows)
        command = [
            given.psfield,
            "simulate",
            "--json",
            "--catalog",
            path["stars.csv"],
            "--shape",
            f"{SIDE},{SIDE}",
        ]
        command += [
            "--psf",
            path["psf.fits"],
            "--bandpass",
            path["band.csv"],
            "-o",
            path["image.fits"],
            "--overwrite",
        ]
        return json.loads(
            subprocess.run([*command, *options], check=True, capture_output=True).stdout
        )

    if given.stars == 0:
        return
    rng = np.random.default_rng(5)
    seds = {
        t: galsim.SED(lambda w, t=t: photons(w, t) / w, "nm", "flambda").withFlux(1.0, bandpass)
        for t in KELVIN
    }
    stars = [
        (*rng.uniform(40, SIDE - 40, 2), KELVIN[star % len(KELVIN)]) for star in range(given.stars)
    ]
    errors, of_galsim = [], []
    with pool:
        for (x, y, kelvin), exact in zip(
            stars, pool.imap(partial(reference, given.band), stars), strict=True
        ):
            tight = ["--tolerance", "1e-6", "--tolerance-on", "l2", "--precision", "f64"]
            simulated([x], [y], [kelvin], *tight)
            image, bounds = fits.getdata(path["image.fits"]), stamp_about(x, y).bounds
            ours = image[bounds.ymin : bounds.ymax + 1, bounds.xmin : bounds.xmax + 1]
            errors.append(np.abs(ours - exact).max() / exact.max())
            print(f"star {len(errors)}: {errors[-1]:.1e}", flush=True)
            if len(of_galsim) < OWN_DRAWINGS:
                star_of_galsim = galsim.Convolve(
                    galsim.DeltaFunction() * seds[kelvin], psf(given.band, x, y)
                )
                drawn = star_of_galsim.drawImage(
                    bandpass, image=stamp_about(x, y), center=galsim.PositionD(x, y)
                )
                of_galsim.append(np.abs(drawn.array - exact).max() / exact.max())
    for name, found in ("psfield", errors), ("GalSim, chromatic", of_galsim):
        print(f"{name}: error median {np.median(found):.1e}, largest {max(found):.1e} of the peak")

    x, y = rng.uniform(40, SIDE - 40, (2, given.timed))
    kelvin = [KELVIN[star % len(KELVIN)] for star in range(given.timed)]
    seconds = min(sum(simulated(x, y, kelvin)["seconds"].values()) for _ in range(3))
    interpolated = psf(given.band, 256, 256).interpolate(wavelengths)
    clock, drawn = time.perf_counter(), 12
    for star in range(drawn):
        convolved = galsim.Convolve(galsim.DeltaFunction() * seds[kelvin[star]], interpolated)
        centre = galsim.PositionD(x[star], y[star])
        convolved.drawImage(bandpass, image=stamp_about(x[star], y[star]), center=centre)
    of_galsim = (time.perf_counter() - clock) / drawn * given.timed
    print(f"{given.timed} stars: psfield {seconds:.2f} s")
    print(f"GalSim (interpolated, one PSF for all stars): {of_galsim:.0f} s")


if __name__ == "__main__":
    main()

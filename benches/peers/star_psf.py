"""Compares the PSF that psfield finds in a frame of stars with the truth, PSFEx and photutils.

    pip install -r benches/peers/requirements.txt     # and Debian's source-extractor and psfex
    python benches/peers/star_psf.py --psfield target/release/psfield --work FOLDER

Three frames, all with psfield's default settings:

- `optics`: 2048 x 2048 pixels, 3000 stars of all brightnesses, FWHM of 3 pixels. GalSim's optics and
  atmosphere, with aberrations that vary over the field.
- `equal`: the same stars with one Gaussian PSF and less noise.
- `undersampled`: 500 isolated stars of equal flux, FWHM of 1.2 and 1.5 pixels.

For the first two it prints errors at 200 positions: relative L2 (median and largest; centres aligned,
both PSFs scaled to unit sum on the same pixels), size and shear (adaptive moments, r.m.s.). For the
third it prints the sums over the pixels around a star at 64 sub-pixel positions, and the r.m.s. error
of these pixels.
"""

import argparse
import shutil
import subprocess
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import galsim
import galsim.des
import numpy as np
from astropy.io import fits
from astropy.nddata import NDData
from astropy.table import Table
from photutils.psf import EPSFBuilder, extract_stars
from scipy.optimize import minimize
from scipy.special import erf

SIDE, STARS, HALF, SCALE = 2048, 3000, 25, 0.25  # pixels, stars, half a stamp, arcsec per pixel
SKY, READ_NOISE = 350.0, {"optics": 5.0, "equal": 9.0}
PHASES = (np.arange(8) + 0.5) / 8 - 0.5


def galsim_psf(kind, seed, x, y):
    """The PSF at a position of the frame."""
    if kind == "equal":
        return galsim.Gaussian(sigma=1.4 * SCALE)
    u, v = 2 * x / SIDE - 1, 2 * y / SIDE - 1
    field = np.array([1, u, v, u * u - 0.3, u * v, v * v - 0.3])
    size = 0.5 * np.array([0.10, 0.06, 0.06, 0.05, 0.05, 0.03, 0.03, 0.02])
    zernikes = size * (np.random.default_rng(seed + 1000).normal(0, 1, (8, 6)) @ field)
    optics = galsim.OpticalPSF(
        lam=800, diam=1.6, obscuration=0.3, aberrations=[0, 0, 0, 0, *zernikes], pad_factor=1.0
    )
    shear = {"g1": 0.02 * u + 0.01 * v * v, "g2": 0.02 * u * v}
    return galsim.Convolve(galsim.Kolmogorov(fwhm=0.62).shear(**shear), optics)


def drawn(kind, seed, at):
    """The first pixel of a stamp along x and y, and a star of unit flux on it."""
    x, y = at
    column, row = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
    bounds = galsim.BoundsI(column - HALF, column + HALF, row - HALF, row + HALF)
    image = galsim.Image(bounds, scale=SCALE, dtype=float)
    method = "no_pixel" if kind == "equal" else "auto"
    psf = galsim_psf(kind, seed, x, y)
    psf.drawImage(image=image, center=galsim.PositionD(x, y), method=method)
    return column - HALF, row - HALF, image.array


def frame_of_stars(kind, seed, pool):
    """A frame, and positions with the PSFs there."""
    rng = np.random.default_rng(seed)
    flux = 250 * (1 - rng.random(STARS)) ** (-1 / 0.75)
    flux = np.minimum(flux, 1e6) if kind == "optics" else flux
    places = rng.uniform(0, SIDE - 1, (STARS, 2))
    light = np.zeros((SIDE, SIDE))
    draw = partial(drawn, kind, seed)
    for (x0, y0, stamp), f in zip(pool.map(draw, places, chunksize=50), flux, strict=True):
        rows, columns = (np.arange(v, v + 2 * HALF + 1) for v in (y0, x0))
        on_rows, on_columns = ((v >= 0) & (v < SIDE) for v in (rows, columns))
        part = stamp[np.ix_(on_rows, on_columns)]
        light[np.ix_(rows[on_rows], columns[on_columns])] += f * part
    noisy = rng.poisson(light + SKY) if kind == "optics" else light + SKY
    noisy = noisy + rng.normal(0, READ_NOISE[kind], light.shape)
    at = np.round(rng.uniform(40, SIDE - 41, (200, 2)))
    return noisy, at, np.array([stamp for *_, stamp in pool.map(draw, at, chunksize=20)])


def central(stamps, side):
    first = stamps.shape[-1] // 2 - side // 2
    return stamps[:, first : first + side, first : first + side]


def l2_error(stamp, truth):
    """The relative L2 error of a stamp that is shifted to fit best."""
    waves = [np.fft.fftfreq(n) for n in truth.shape]
    transform, shift, moved = np.fft.fft2(stamp), np.zeros(2), stamp
    for _ in range(4):
        slopes = np.stack([s.ravel() for s in np.gradient(moved)], axis=1)
        shift += np.linalg.lstsq(slopes, (moved - truth).ravel(), rcond=None)[0]
        phase = waves[0][:, None] * shift[0] + waves[1] * shift[1]
        moved = np.fft.ifft2(transform * np.exp(-2j * np.pi * phase)).real
    return np.linalg.norm(moved - truth) / np.linalg.norm(truth)


def shapes(stamps):
    found = [galsim.hsm.FindAdaptiveMom(galsim.Image(np.ascontiguousarray(s))) for s in stamps]
    return np.array([(m.moments_sigma, m.observed_shape.g1, m.observed_shape.g2) for m in found])


def report(label, stamps, truth):
    side = min(stamps.shape[-1], truth.shape[-1])
    stamps, truth = central(stamps, side).astype(float), central(truth, side)
    stamps, truth = (s / s.sum(axis=(1, 2), keepdims=True) for s in (stamps, truth))
    errors = [l2_error(*pair) for pair in zip(stamps, truth, strict=True)]
    a, b = shapes(stamps), shapes(truth)
    size = np.sqrt(np.mean((a[:, 0] / b[:, 0] - 1) ** 2))
    shear = np.sqrt(np.mean(np.sum((a[:, 1:] - b[:, 1:]) ** 2, axis=1)))
    print(
        f"{label:18s} L2 {np.median(errors):.4f} / {max(errors):.4f}  "
        f"size {100 * size:.2f} %  shear {shear:.4f}",
        flush=True,
    )


def run(*command, cwd=None):
    subprocess.run([str(c) for c in command], check=True, cwd=cwd, stdout=subprocess.DEVNULL)


def psfield_stamps(arguments, frame, at, grid="native"):
    """The PSFs that psfield finds, at positions: the HDU of the stamps."""
    work = arguments.work
    fits.writeto(work / "frame.fits", frame.astype(np.float32), overwrite=True)
    np.savetxt(work / "at.csv", at, delimiter=",", header="x,y", comments="")
    model, stamps = work / "model.fits", work / "stamps.fits"
    run(
        arguments.psfield, "sample", work / "frame.fits", "-o", work / "samples.fits", "--overwrite"
    )
    run(arguments.psfield, "fit", work / "samples.fits", "-o", model, "--overwrite")
    places = ("--at", work / "at.csv", "--pixels", grid, "--sub-pixel")
    run(
        arguments.psfield,
        "evaluate",
        model,
        *places[: None if grid == "native" else 4],
        "-o",
        stamps,
        "--overwrite",
    )
    return fits.getdata(stamps)


def psfex_stamps(work, at):
    (work / "columns").write_text(
        "VIGNET(35,35)\nX_IMAGE\nY_IMAGE\nFLUX_RADIUS\nSNR_WIN\n"
        "FLUX_APER(1)\nFLUXERR_APER(1)\nELONGATION\nFLAGS\n"
    )
    (work / "kernel").write_text("CONV NORM\n1 2 1\n2 4 2\n1 2 1\n")
    detect = "-CATALOG_NAME frame.ldac -CATALOG_TYPE FITS_LDAC -PARAMETERS_NAME columns -FILTER_NAME kernel "
    detect += "-DETECT_THRESH 2 -PHOT_APERTURES 12 -SATUR_LEVEL 1e9 -GAIN 1 -VERBOSE_TYPE QUIET "
    detect += "-STARNNW_NAME /usr/share/source-extractor/default.nnw"
    run("source-extractor", "frame.fits", *detect.split(), cwd=work)
    model = "-PSF_SIZE 31,31 -PSF_SAMPLING 1.0 -PSFVAR_DEGREES 3 -CHECKPLOT_DEV NULL -CHECKPLOT_TYPE NONE "
    model += "-CHECKIMAGE_TYPE NONE -VERBOSE_TYPE QUIET -WRITE_XML N"
    run("psfex", "frame.ldac", *model.split(), cwd=work)
    psf = galsim.des.DES_PSFEx(str(work / "frame.psf"))
    return np.array([psf.getPSFArray(galsim.PositionD(x + 1, y + 1)) for x, y in at])


def in_pixel(offset, sigma):
    edge = sigma * 2**0.5
    return 0.5 * (erf((offset + 0.5) / edge) - erf((offset - 0.5) / edge))


def undersampled_frame(sigma, flux):
    rng = np.random.default_rng(5)
    spacing, count = 32, 500
    across = int(np.ceil(count**0.5))
    light = np.zeros((spacing * across + 16,) * 2)
    near = np.arange(-9, 10)
    place = [
        24 + spacing * (np.arange(count) // d % across) + rng.uniform(-0.5, 0.5, count)
        for d in (1, across)
    ]
    for x, y in zip(*place, strict=True):
        i, j = round(x), round(y)
        star = np.outer(in_pixel(j + near - y, sigma), in_pixel(i + near - x, sigma))
        light[j - 9 : j + 10, i - 9 : i + 10] += flux * star
    return rng.poisson(light + 100) + rng.normal(0, 5, light.shape), *place


def report_phases(label, value, sigma):
    """`value(dx, dy)` is the PSF at offsets from the star. Its centre is fitted first."""
    near = np.arange(-4, 5)

    def compared(x, y, centre):
        truth = np.outer(in_pixel(near - y, sigma), in_pixel(near - x, sigma))
        return value(*np.meshgrid(near - x - centre[0], near - y - centre[1])), truth

    def squares(centre, phases):
        pairs = [compared(x, y, centre) for x in phases for y in phases]
        return np.mean([(a - b) ** 2 for a, b in pairs]), [a.sum() for a, _ in pairs]

    centre = minimize(lambda c: 1e6 * squares(c, (-0.25, 0.25))[0], [0, 0], method="Nelder-Mead").x
    mean, sums = squares(centre, PHASES)
    print(
        f"{label:30s} sums {min(sums):.4f} to {max(sums):.4f}  pixels {mean**0.5:.2e}", flush=True
    )


def undersampled(arguments):
    from scipy.interpolate import RectBivariateSpline

    for sigma in (0.42, 0.55):
        for flux in (1e4, 1e5, 1e6, 1e7):
            frame, x, y = undersampled_frame(sigma, flux)
            stamp = psfield_stamps(arguments, frame, [[200, 200]], "model")[0].astype(float)
            scale = fits.getheader(arguments.work / "stamps.fits")["OVERSAMP"]
            axis = (np.arange(len(stamp)) - len(stamp) // 2) / scale
            spline = RectBivariateSpline(axis, axis, stamp)
            report_phases(
                f"psfield {sigma} {flux:.0e}", lambda dx, dy, s=spline: s.ev(dy, dx), sigma
            )
            stars = extract_stars(NDData(frame - 100.0), Table({"x": x, "y": y}), size=15)
            found = EPSFBuilder(oversampling=4, maxiters=10, progress_bar=False)(stars)[0]
            evaluate = found.evaluate
            report_phases(
                f"photutils {sigma} {flux:.0e}",
                lambda dx, dy, f=evaluate: f(dx, dy, 1.0, 0.0, 0.0),
                sigma,
            )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--psfield", default="psfield", help="the program")
    parser.add_argument("--work", type=Path, required=True, help="folder for files")
    parser.add_argument("--seed", type=int, default=22)
    parser.add_argument("--frames", default="optics,equal,undersampled")
    arguments = parser.parse_args()
    arguments.psfield = Path(shutil.which(arguments.psfield)).resolve()
    arguments.work.mkdir(parents=True, exist_ok=True)
    for kind in arguments.frames.split(","):
        if kind == "undersampled":
            undersampled(arguments)
            continue
        with ProcessPoolExecutor() as pool:
            frame, at, truth = frame_of_stars(kind, arguments.seed, pool)
        report(f"{kind}: psfield", psfield_stamps(arguments, frame, at), truth)
        report(f"{kind}: PSFEx", psfex_stamps(arguments.work, at), truth)


if __name__ == "__main__":
    main()

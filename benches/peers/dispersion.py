"""Compares the dispersion of the atmosphere with GalSim: shifts of stars at several zenith distances.

    pip install -r benches/peers/requirements.txt
    python benches/peers/dispersion.py --psfield target/release/psfield --work FOLDER

A Gaussian PSF, equal at all wavelengths, and a band from 0.4 to 0.95 um. Stars of three black bodies
are drawn by psfield (`simulate --dispersion`) and by GalSim (`ChromaticAtmosphere` with the same air
and the same wavelength without a shift). The centroids of their images are compared. GalSim sums
over the band in steps of 1 nm.
"""

import argparse
import subprocess
from pathlib import Path

import galsim
import numpy as np
from astropy.io import fits

ZENITH_DISTANCES = 0, 15, 30, 45, 60  # degrees
KELVIN = 3000, 6000, 20000
BAND_UM = 0.4, 0.95
REFERENCE_UM = 0.6
SCALE = 0.1  # arcsec per pixel
SIGMA, OVERSAMPLING = 3.0, 2  # pixels; stamp pixels per pixel
SIDE = 161  # pixels of an image
# The air: 800 hPa, 7 C and 8 mm of mercury of water vapour, as in Filippenko (1982).
AIR = {"pressure": 80.0, "temperature": 280.15, "H2O_pressure": 1.0666}
HC_OVER_K_NM_K = 14387768.775


def write_samples(path: Path) -> None:
    """Write the Gaussian in psfield's layout, at the wavelengths of the band's ends."""
    side = 16 * int(SIGMA) * OVERSAMPLING + 1
    u = (np.arange(side) - side // 2) / OVERSAMPLING
    line = np.exp(-(u**2) / (2 * SIGMA**2))
    cube = fits.PrimaryHDU(np.array([np.outer(line, line)] * 2))
    cube.header["OVERSAMP"] = OVERSAMPLING
    cube.header["FIELDNX"] = cube.header["FIELDNY"] = SIDE
    columns = [fits.Column(name, "D", array=[SIDE // 2] * 2) for name in "XY"]
    columns.append(fits.Column("WAVELENGTH", "D", unit="um", array=BAND_UM))
    table = fits.BinTableHDU.from_columns(columns, name="POSITIONS")
    fits.HDUList([cube, table]).writeto(path, overwrite=True)


def centroid(image: np.ndarray) -> np.ndarray:
    """Return the mean position (x, y) of the light."""
    y, x = np.indices(image.shape)
    return np.array([(image * x).sum(), (image * y).sum()]) / image.sum()


def galsim_image(zenith: float, kelvin: float) -> np.ndarray:
    """Return GalSim's image of a star in the middle. The zenith is at the top.

    It is the sum of the images at all wavelengths. The shifts of GalSim's own drawing through a
    bandpass are off by 0.04 pixels at 60 degrees.
    """
    psf = galsim.ChromaticAtmosphere(
        galsim.Gaussian(sigma=SIGMA * SCALE),
        REFERENCE_UM * 1e3,
        alpha=0.0,
        zenith_angle=zenith * galsim.degrees,
        parallactic_angle=0 * galsim.degrees,
        scale_unit="arcsec",
        **AIR,
    )
    total = np.zeros((SIDE, SIDE))
    low, high = (round(um * 1e3) for um in BAND_UM)
    for nm in np.arange(low, high) + 0.5:
        photons = nm**-4.0 / np.expm1(HC_OVER_K_NM_K / (nm * kelvin))
        image = galsim.ImageD(SIDE, SIDE, scale=SCALE)
        total += (
            photons * psf.evaluateAtWavelength(nm).drawImage(image=image, method="no_pixel").array
        )
    return total


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--psfield", default="target/release/psfield")
    parser.add_argument("--work", type=Path, default=Path("dispersion"))
    given = parser.parse_args()
    given.work.mkdir(parents=True, exist_ok=True)
    names = "samples.fits", "band.csv", "star.csv", "image.fits"
    samples, band, star, image = (given.work / name for name in names)
    write_samples(samples)
    band.write_text("wavelength_um,throughput\n" + "".join(f"{um},1\n" for um in BAND_UM))
    largest = 0.0
    for zenith in ZENITH_DISTANCES:
        for kelvin in KELVIN:
            star.write_text(f"x,y,flux,sed\n{SIDE // 2},{SIDE // 2},1,blackbody:{kelvin}\n")
            dispersion = (
                f"zenith={zenith},scale={SCALE},reference={REFERENCE_UM},pressure=800,temperature=7"
            )
            command = [
                given.psfield,
                "simulate",
                "--psf",
                samples,
                "--catalog",
                star,
                "--shape",
                f"{SIDE},{SIDE}",
            ]
            command += [
                "--bandpass",
                band,
                "--dispersion",
                dispersion,
                "--precision",
                "f64",
                "--tolerance",
                "1e-6",
            ]
            subprocess.run([*command, "-o", image, "--overwrite", "-q"], check=True)
            ours, theirs = centroid(fits.getdata(image)), centroid(galsim_image(zenith, kelvin))
            difference = float(np.hypot(*(ours - theirs)))
            largest = max(largest, difference)
            print(
                f"{zenith:2} degrees, {kelvin:5} K: shift {ours[1] - SIDE // 2:+.4f} pixels, difference {difference:.1e}"
            )
    print(f"largest difference: {largest:.1e} pixels")


if __name__ == "__main__":
    main()

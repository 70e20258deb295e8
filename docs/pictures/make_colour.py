"""Make the pictures of docs/colour.md: stars of different colours, dispersion, and motion.

    cargo build --release -p psfield-cli
    python docs/pictures/make_colour.py target/release/psfield

Needs numpy, matplotlib, astropy and Pillow.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.visualization import make_lupton_rgb
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from PIL import Image

FOLDER = Path(__file__).resolve().parent

#: A telescope in space: its PSF shows diffraction by the aperture and by the vanes of the spider.
SPACE = """
wavelength_nm = 600
pixel_scale_arcsec = 0.05
frame = { nx = 360, ny = 240 }
stamp = { nx = 128, ny = 128 }
aperture = { diameter_m = 1.0, obscuration = 0.35, spider = { vanes = 4, width_m = 0.03 } }
[wavefront]
modes = [
    { noll = 4, terms = [{ x = 2, value = 25.0 }, { y = 2, value = 25.0 }] },
    { noll = 8, terms = [{ x = 1, value = 40.0 }] },
]
"""
#: A telescope on the ground, with pixels much smaller than the seeing.
GROUND = """
wavelength_nm = 600
pixel_scale_arcsec = 0.1
frame = { nx = 64, ny = 64 }
stamp = { nx = 128, ny = 128, oversampling = 2 }
aperture = { diameter_m = 2.0, obscuration = 0.3 }
[seeing]
fwhm_arcsec = 0.6
"""
#: Ends of three bands in micrometres, blue, green and red, and of all of them together.
BANDS, WIDE = [(0.40, 0.55), (0.55, 0.70), (0.70, 0.95)], (0.40, 0.95)
#: Temperatures in kelvin of red and of blue stars, and of stars that look white.
RED, BLUE, WHITE = 3000, 15000, 5500


class Work:
    """A folder in which psfield runs."""

    def __init__(self, program, folder):
        self.program, self.folder = Path(program).resolve(), Path(folder)

    def psfield(self, *arguments):
        """Run a command of psfield in the folder."""
        command = [self.program, *map(str, arguments), "--quiet", "--overwrite"]
        subprocess.run(command, check=True, cwd=self.folder)

    def write(self, name, text):
        """Write a text file."""
        (self.folder / name).write_text(text)

    def telescope(self, text, uniform, step_um):
        """Draw the PSF of a telescope from the first to the last wavelength of the wide band."""
        self.write("telescope.toml", 'name = "telescope"' + text)
        count = round((WIDE[1] - WIDE[0]) / step_um) + 1
        wavelengths = ",".join(f"{um:.4f}" for um in np.linspace(*WIDE, count))
        grid = ["--uniform", uniform, "--wavelengths", wavelengths]
        self.psfield("sample", "telescope.toml", *grid, "-o", "samples.fits")
        self.psfield("fit", "samples.fits", "-o", "psf.fits")

    def image(self, stars, band, shape, *options):
        """Simulate stars `(x, y, flux, teff)` in a band without slopes, and return the pixels."""
        rows = "".join("{},{},{},{}\n".format(*star) for star in stars)
        self.write("stars.csv", "x,y,flux,teff\n" + rows)
        low, high = band
        ends = f"{low},0\n{low + 1e-4},1\n{high - 1e-4},1\n{high},0\n"
        self.write("band.csv", "wavelength_um,throughput\n" + ends)
        scene = ["--catalog", "stars.csv", "--shape", shape, "--bandpass", "band.csv"]
        self.psfield("simulate", *scene, "--psf", "psf.fits", *options, "-o", "image.fits")
        return fits.getdata(self.folder / "image.fits").astype(float)


def photons(kelvin, band):
    """Return the photons of a black body in a band, up to a factor."""
    um = np.linspace(*band, 500)
    return np.sum(um**-4 / np.expm1(14387.77 / (um * kelvin))) * (band[1] - band[0])


def show_star(axes, image, half_side, brightest):
    """Show a star of unit flux in the middle of an image. The sides are in arcsec."""
    sides = (-half_side, half_side) * 2
    return axes.imshow(
        image, origin="lower", extent=sides, cmap="inferno", norm=LogNorm(1e-5, brightest)
    )


def draw_field(work):
    """Draw red and blue stars in three bands as one colour picture, and two of them in one band."""
    work.telescope(SPACE, "3,3", 0.0125)
    random = np.random.default_rng(5)
    places = random.uniform((12, 12), (348, 228), (60, 2))
    fluxes = 10 ** random.uniform(2.6, 4.2, 60)
    kelvins = [RED, BLUE] * 30
    stars = [
        (x, y, flux, kelvin) for (x, y), flux, kelvin in zip(places, fluxes, kelvins, strict=True)
    ]
    pair = [(100, 130, 1.2e5, RED), (262, 108, 1.2e5, BLUE)]
    stars += pair

    def seen(band):
        """Return the stars with their photons in a band. White stars keep their fluxes."""
        part = {
            kelvin: photons(kelvin, band) / photons(kelvin, WIDE) for kelvin in (RED, WHITE, BLUE)
        }
        return [(x, y, flux * part[kelvin] / part[WHITE], kelvin) for x, y, flux, kelvin in stars]

    blue, green, red = (work.image(seen(band), band, "360,240") for band in BANDS)
    wide = work.image(pair, WIDE, "360,240")

    figure = Figure(figsize=(9.5, 3.1), layout="constrained")
    left, *zooms = figure.subplots(1, 3, width_ratios=[1.5, 1, 1])
    extent = (0, 360 * 0.05, 0, 240 * 0.05)
    left.imshow(make_lupton_rgb(red, green, blue, stretch=40, Q=10), origin="lower", extent=extent)
    title = f"{RED} K and {BLUE} K, three bands"
    left.set(title=title, xlabel="x (arcsec)", ylabel="y (arcsec)")
    for axes, (x, y, flux, kelvin) in zip(zooms, pair, strict=True):
        half = 28
        cut = wide[y - half : y + half + 1, x - half : x + half + 1] / flux
        shown = show_star(axes, cut, (half + 0.5) * 0.05, 5e-2)
        axes.set(title=f"{kelvin} K", xlabel="x (arcsec)")
    figure.colorbar(shown, ax=zooms, label="fraction of the flux per pixel")
    return figure


def draw_dispersion(work):
    """Draw a star at four zenith distances."""
    work.telescope(GROUND, "2,2", 0.05)
    figure = Figure(figsize=(9, 2.9), layout="constrained")
    for axes, zenith in zip(figure.subplots(1, 4, sharey=True), (0, 30, 50, 60), strict=True):
        star = [(31.5, 31.5, 1.0, 6000)]
        image = work.image(star, WIDE, "64,64", "--dispersion", f"zenith={zenith},scale=0.1")
        shown = show_star(axes, image, 32 * 0.1, 2e-2)
        axes.set(title=f"zenith distance {zenith}\N{DEGREE SIGN}", xlabel="x (arcsec)")
        if zenith == 0:
            axes.set_ylabel("towards the zenith (arcsec)")
    figure.colorbar(shown, ax=figure.axes, label="fraction of the flux per pixel")
    return figure


def draw_drift(work):
    """Draw a star in exposures with different motion of the telescope."""
    work.telescope(GROUND, "2,2", 0.55)
    work.write("star.csv", "x,y,flux\n31.5,31.5,1\n")
    random = np.random.default_rng(4)
    steps = np.cumsum(random.normal(0, 0.35, (200, 2)), axis=0)
    steps -= steps.mean(axis=0)
    rows = "".join(f"{i / 199},{dx},{dy}\n" for i, (dx, dy) in enumerate(steps))
    work.write("path.csv", "time,dx,dy\n" + rows)
    motions = {
        "at rest": "",
        "jitter of 4 pixels": "jitter_px = 4.0",
        "drift of 30 pixels": "drift_px_per_s = [26.8, 13.4]",
        "path of 200 points": 'path = "path.csv"',
    }
    figure = Figure(figsize=(9, 2.9), layout="constrained")
    for axes, (title, motion) in zip(
        figure.subplots(1, 4, sharey=True), motions.items(), strict=True
    ):
        # A path begins at time 0. The middle of the other exposures is at time 0.
        first = 0.0 if "path" in motion else -0.5
        times = f'start = "2026-11-27T21:00:00"\nexposure_s = 1\nstarts_s = [{first}]'
        scene = 'psf = "psf.fits"\ncatalog = "star.csv"\nshape = [64, 64]\npsf-wavelength = 0.5'
        table = f"{times}\n[pointing]\n{motion}\n[simulate]\n{scene}\n"
        work.write("series.toml", table)
        work.psfield("series", "series.toml", "--out", "frames")
        image = fits.getdata(work.folder / "frames" / "frame_0000.fits").astype(float)
        shown = show_star(axes, image, 32 * 0.1, 2e-2)
        axes.set(title=title, xlabel="x (arcsec)")
    figure.axes[0].set_ylabel("y (arcsec)")
    figure.colorbar(shown, ax=figure.axes, label="fraction of the flux per pixel")
    return figure


def save(figure, name):
    """Write a figure as a PNG with a palette, which keeps it small."""
    path = FOLDER / name
    figure.savefig(path, dpi=100)
    with Image.open(path) as picture:
        # Colours that cover the whole range, moved to where most pixels are.
        picture.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, 2).save(
            path, optimize=True
        )


PICTURES = {
    "colour_field.png": draw_field,
    "dispersion.png": draw_dispersion,
    "drift.png": draw_drift,
}

if __name__ == "__main__":
    for name, draw in PICTURES.items():
        with tempfile.TemporaryDirectory() as scratch:
            save(draw(Work(sys.argv[1], scratch)), name)

"""
A Roman field in colour
=======================

The PSF of the Roman Space Telescope widens with the wavelength, by a factor of two from the bluest
light of its Y106 filter to the reddest of H158. This tutorial draws Roman's PSF with GalSim at a
few positions and wavelengths, and simulates stars and galaxies in three filters. Each source has
the PSF of its own spectrum.

It needs GalSim, astropy and matplotlib.

**Sources.** Optics, filters and detector of Roman come from ``galsim.roman``, which holds data of
the Roman project at NASA (Wide Field Instrument, cycle 9). The spectra of galaxies are those of
Coleman, Wu and Weedman (1980, ApJS 43, 393), extended to the infrared by Bolzonella
et al. (2000, A&A 363, 476), in the files that come with GalSim. GalSim is distributed with its data
files under a BSD licence. The stars are black bodies. Positions and fluxes are invented.
"""

import warnings
from pathlib import Path

import galsim
import galsim.roman
import matplotlib.pyplot as plt
import numpy as np
from astropy.visualization import make_lupton_rgb
from matplotlib.colors import LogNorm

import psfield

# %%
# 1. The PSF at some positions and wavelengths
# --------------------------------------------
#
# Roman's pixels are too coarse for its PSF, so the stamps have three pixels per detector pixel.
# GalSim returns the flux in a stamp pixel, and psfield takes the flux in a detector pixel centred
# there, hence the factor. The pupil is sampled coarsely (``pupil_bin=8``) to save time.

detector, oversampling, size = 7, 4, 60 * 4 + 1
shape = (galsim.roman.n_pix, galsim.roman.n_pix)
scale = galsim.roman.pixel_scale
warnings.simplefilter("ignore", galsim.GalSimWarning)


def optics(x, y, wavelength_um):
    """Return GalSim's PSF at a 0-based position. GalSim counts from 1."""
    return galsim.roman.getPSF(
        detector,
        "J129",  # the three filters have one pupil
        SCA_pos=galsim.PositionD(x + 1, y + 1),
        wavelength=1000 * wavelength_um,
        pupil_bin=8,
    )


def stamp(x, y, wavelength_um):
    """Draw the PSF, with the response of a detector pixel."""
    psf = galsim.Convolve(optics(x, y, wavelength_um), galsim.Pixel(scale))
    fine = psf.drawImage(nx=size, ny=size, scale=scale / oversampling, method="no_pixel")
    return fine.array * oversampling**2


bands = {}
for name in ["Y106", "J129", "H158"]:
    bandpass = galsim.roman.getBandpasses(AB_zeropoint=True)[name]
    waves = np.linspace(bandpass.blue_limit, bandpass.red_limit, 100)
    bands[name] = (waves / 1000, np.array([bandpass(wave) for wave in waves]))

shortest, longest = bands["Y106"][0][0], bands["H158"][0][-1]
side = [0, shape[0] // 2, shape[0] - 1]
samples = [(x, y, wave) for y in side for x in side for wave in np.linspace(shortest, longest, 8)]
x, y, wave = np.transpose(samples)
model = psfield.PsfModel.from_samples(
    [stamp(*sample) for sample in samples],
    np.column_stack([x, y]),
    wavelengths_um=wave,
    field_shape=shape,
    oversampling=oversampling,
    normalise="keep",
    noise=0,
)
print(model)

# %%
# 2. One PSF per spectrum and filter
# ----------------------------------
#
# ``for_spectrum`` returns the mean PSF over the photons that the filter lets through. Here it is
# that of a red star (3500 K) in the three filters. The rings and spikes grow with the wavelength.

figure, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
for ax, (name, band) in zip(axes, bands.items(), strict=True):
    psf = model.for_spectrum(band, "blackbody:3500").evaluate(2000, 2000)
    shown = ax.imshow(
        psf, origin="lower", norm=LogNorm(1e-6, 0.2), extent=(-30.17, 30.17, -30.17, 30.17)
    )
    ax.set(title=name, xlabel="x from the star (pixels)")
axes[0].set_ylabel("y from the star (pixels)")
figure.colorbar(shown, ax=axes, label="fraction of the flux per pixel")
plt.show()

# %%
# Is that right? Compare with GalSim at a new position: the sum of the PSFs at 20 wavelengths, with
# the photons of the star as weights. The error is below one per cent of the PSF.

x, y, kelvin = 900.0, 3100.0, 5800.0
waves = np.linspace(*bands["J129"][0][[0, -1]], 20)
photons = np.interp(waves, *bands["J129"]) * waves**-4 / np.expm1(14387.77 / (waves * kelvin))
exact = np.zeros((25, 25))
for wave, weight in zip(waves, photons / photons.sum(), strict=True):
    exact += weight * optics(x, y, wave).drawImage(nx=25, ny=25, scale=scale).array
star = model.for_spectrum(bands["J129"], f"blackbody:{kelvin}")
difference = star.evaluate(x, y, pixels="frame", size=25) - exact
error = np.linalg.norm(difference) / np.linalg.norm(exact)
print(f"relative L2 difference from GalSim: {error:.1e}")
assert error < 0.01

# %%
# 3. Stars and galaxies
# ---------------------
#
# Stars of four temperatures, and galaxies with the spectrum of an elliptical or an irregular one
# at redshift 0.3. A spectrum is a table of wavelengths and flux densities per wavelength. The
# picture shows 500 x 700 pixels in a corner of the detector.

spectra = {}
waves = np.linspace(0.8, 2.0, 500)
for kelvin in (3000, 4500, 6000, 12000):
    spectra[f"{kelvin} K"] = (waves, waves**-5 / np.expm1(14387.77 / (waves * kelvin)))
for name in ("CWW_E_ext", "CWW_Im_ext"):
    path = Path(galsim.meta_data.share_dir) / "SEDs" / f"{name}.sed"
    angstrom, flux_density = np.loadtxt(path).T
    spectra[name] = (1.3 * angstrom / 1e4, flux_density)

rng = np.random.default_rng(6)
catalogs = {}
for name in spectra:
    count = 60 if name.endswith("K") else 25
    catalogs[name] = {
        "x": rng.uniform(0, 700, count),
        "y": rng.uniform(0, 500, count),
        "flux": np.minimum(500 * (1 - rng.uniform(0, 1, count)) ** -1.2, 5e4),  # in J129
        "re": np.zeros(count) if name.endswith("K") else rng.uniform(2, 9, count),
        "n": np.full(count, 4.0 if name == "CWW_E_ext" else 1.0),
        "q": rng.uniform(0.3, 1, count),
        "angle": rng.uniform(0, 180, count),
    }

# %%
# The flux of a source in another filter follows from its spectrum. There is one plan for each
# filter and spectrum, and their images add up.


def detected(band, spectrum):
    """Return the photons of a spectrum in a filter, up to a factor."""
    waves, throughput = band
    return np.sum(np.interp(waves, *spectrum) * waves * throughput) * (waves[1] - waves[0])


images = {}
for name, band in bands.items():
    images[name] = np.zeros((500, 700), np.float32)
    for key, spectrum in spectra.items():
        ratio = detected(band, spectrum) / detected(bands["J129"], spectrum)
        catalog = {**catalogs[key], "flux": ratio * catalogs[key]["flux"]}
        plan = model.for_spectrum(band, spectrum).plan(shape, region=(0, 0, 700, 500))
        images[name] += plan.simulate(catalog=catalog)

# %%
# 4. The picture
# --------------
#
# H158, J129 and Y106 become red, green and blue, with the factors that make a star of 6000 K
# white. Red stars are cool, blue ones hot. The reddest galaxies are the ellipticals.

white = [detected(bands[name], spectra["6000 K"]) for name in bands]
blue, green, red = (image * white[1] / w for image, w in zip(images.values(), white, strict=True))
picture = make_lupton_rgb(red, green, blue, stretch=15, Q=8)

# sphinx_gallery_thumbnail_number = 2
figure, ax = plt.subplots(figsize=(9, 6.6), layout="constrained")
ax.imshow(picture, origin="lower", interpolation="nearest")
ax.set(xlabel="x (pixels)", ylabel="y (pixels)", title="Red: H158, green: J129, blue: Y106")
plt.show()

for name, image in images.items():
    print(f"{name}: {image.sum(dtype=float):.3g} photons")

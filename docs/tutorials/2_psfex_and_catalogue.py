"""
A PSFEx file and a catalogue on the sky
=======================================

Surveys describe their PSF by PSFEx files and their sources by right ascension, declination and
magnitude. This tutorial reads both, makes a raw CCD frame with world coordinates, and checks its
noise by aperture photometry.

It needs astropy and matplotlib. The files are made in the first step. If you have your own, begin
at the second.
"""

import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.table import Table
from astropy.wcs import WCS

import psfield
from psfield.detector import Detector
from psfield.plot import plot_shapes

# %%
# 1. Two files
# ------------
#
# The PSF: polynomials of degree 4 over a frame of 500 x 700 pixels. ``write`` returns notes on the
# properties that a PSFEx file cannot hold.

folder = Path(tempfile.mkdtemp())
shape = (500, 700)
telescope = psfield.PsfModel.from_telescope(
    "survey-2m", field_shape=shape, stamp_size=32, oversampling=4
)
for note in telescope.write(folder / "survey.psf", format="psfex", degree=4):
    print(note)

# %%
# The world coordinates of the frame: 0.074 arcsec per pixel, north at the top. Those of a real
# frame come from its header, by ``WCS(header)``.

wcs = WCS(naxis=2)
wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
wcs.wcs.crpix = [350.5, 250.5]
wcs.wcs.crval = [150.1, 2.2]  # degrees
wcs.wcs.cdelt = [-0.074 / 3600, 0.074 / 3600]

# %%
# The catalogue: 250 stars, and 60 galaxies with a half-light radius. The number of stars grows
# towards the faint end.

rng = np.random.default_rng(5)
count = 310
is_star = np.arange(count) < 250
right_ascension, declination = wcs.pixel_to_world_values(
    rng.uniform(0, shape[1] - 1, count), rng.uniform(0, shape[0] - 1, count)
)
table = Table(
    {
        "RA": right_ascension,
        "DEC": declination,
        "MAG": 17 + 6 * np.sqrt(rng.uniform(0, 1, count)),
        "RE": np.where(is_star, 0, rng.uniform(2, 8, count)),
        "N": np.where(is_star, 1, rng.uniform(0.8, 3, count)),
        "Q": np.where(is_star, 1, rng.uniform(0.4, 1, count)),
        "ANGLE": rng.uniform(0, 180, count),
    }
)
table.write(folder / "sources.fits")

# %%
# 2. Read them
# ------------
#
# psfield recognises a PSF file by its content, and says how it read it.

model = psfield.PsfModel.read(folder / "survey.psf")
for note in model.notes:
    print(note)
plot_shapes(model)
plt.show()

# %%
# ``columns`` gives the role of each column. Positions become 0-based pixels by the world
# coordinates of the frame, and magnitudes become fluxes by the zero point, the magnitude of one
# electron.

sources = psfield.read_catalog(
    folder / "sources.fits",
    columns="ra=RA,dec=DEC,mag=MAG,re=RE,n=N,q=Q,angle=ANGLE",
    zero_point=30.0,
    wcs=wcs,
)
print(f"{len(sources['x'])} sources, fluxes from {sources['flux'].min():.0f} electrons")
assert len(sources["x"]) == count
brightest = 10 ** (-0.4 * (table["MAG"].min() - 30))
assert np.isclose(sources["flux"].max(), brightest)

# %%
# 3. The frame
# ------------
#
# The light first, without noise. A ``CCDData`` gives the image its unit and its world coordinates.
# psfield warns of the error that the interpolation of PSFEx files (Lanczos-4) adds between pixels.

blank = CCDData(np.zeros(shape), unit="electron", wcs=wcs)
light = psfield.simulate(blank, model, catalog=sources)
assert light.wcs is not None

# %%
# Then the detector: sky, photon noise, read noise, full well, gain and bias. One seed always gives
# the same frame.

ccd = Detector(
    photon_noise=True,
    sky_e=150.0,
    read_noise_e=5.0,
    full_well_e=90_000,
    gain_e_per_adu=1.5,
    bias_adu=300,
    bits=16,
)
exposure = ccd.expose(light.data, seed=1)
fits.writeto(folder / "raw.fits", exposure.counts.astype(np.uint16), wcs.to_header())

# sphinx_gallery_thumbnail_number = 2
figure = plt.figure(figsize=(9, 6), layout="constrained")
ax = figure.add_subplot(projection=light.wcs)
shown = ax.imshow(exposure.counts, origin="lower", cmap="gray", vmin=380, vmax=600)
figure.colorbar(shown, ax=ax, label="counts (ADU)", shrink=0.8)
ax.set(xlabel="right ascension", ylabel="declination")
plt.show()

# %%
# 4. Photometry
# -------------
#
# Add up the counts within 5 pixels of each source, without bias and sky, and compare with the image
# without noise. The difference should be the photon noise of source and sky, and the read noise.
# Saturated sources are left out.

electrons = 1.5 * (exposure.counts - 300.0) - 150.0
rows, columns = np.indices(shape)
deviations = []
for x, y in zip(sources["x"], sources["y"], strict=True):
    inside = np.hypot(columns - x, rows - y) < 5
    if (exposure.flags[inside] == 0).all():
        expected = light.data[inside].sum()
        noise = np.sqrt(expected + inside.sum() * (150 + 5**2))
        deviations.append((electrons[inside].sum() - expected) / noise)

figure, ax = plt.subplots(figsize=(6, 4), layout="constrained")
ax.hist(deviations, bins=np.linspace(-4, 4, 25), density=True, label="sources")
sigma = np.linspace(-4, 4, 100)
ax.plot(sigma, np.exp(-(sigma**2) / 2) / np.sqrt(2 * np.pi), color="black", label="expected")
ax.set(xlabel="(measured - noiseless flux) / expected noise", ylabel="probability density")
ax.legend()
plt.show()

print(f"{len(deviations)} sources: mean {np.mean(deviations):.2f}, rms {np.std(deviations):.2f}")
assert abs(np.mean(deviations)) < 0.25 and abs(np.std(deviations) - 1) < 0.15
shutil.rmtree(folder)

"""
A frame on the sky
==================

Give psfield a scene with world coordinates (an astropy ``CCDData``), and the image keeps them. Here
the scene is a faint nebula, and the stars come from a list of right ascensions and declinations.
The circles mark the brighter stars of the list.
"""

import matplotlib.pyplot as plt
import numpy as np
from astropy.nddata import CCDData
from astropy.wcs import WCS
from matplotlib.colors import AsinhNorm

import psfield

shape = (300, 450)
wcs = WCS(naxis=2)
wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
wcs.wcs.crpix = [225.5, 150.5]
wcs.wcs.crval = [83.82, -5.39]  # degrees
angle, scale = np.radians(20), 0.074 / 3600
wcs.wcs.cd = scale * np.array([[-np.cos(angle), np.sin(angle)], [np.sin(angle), np.cos(angle)]])

rng = np.random.default_rng(8)
ra, dec = 83.82 + rng.uniform(-0.006, 0.006, 400), -5.39 + rng.uniform(-0.005, 0.005, 400)
stars = {"ra": ra, "dec": dec, "flux": 100 * (1 - rng.uniform(0, 1, 400)) ** -1.2}

v, u = np.indices(shape)
nebula = 3 * np.exp(-((u - 260) ** 2 + 2 * (v - 170) ** 2) / 20000)
model = psfield.PsfModel.from_telescope("survey-2m", field_shape=shape, oversampling=4)
frame = psfield.simulate(CCDData(nebula, unit="electron", wcs=wcs), model, catalog=stars)

ax = plt.figure(figsize=(8, 5.4), layout="constrained").add_subplot(projection=frame.wcs)
shown = ax.imshow(frame.data, cmap="gray", origin="lower", norm=AsinhNorm(2, vmin=0, vmax=500))
bright = stars["flux"] > 1000
ax.scatter(
    ra[bright], dec[bright], transform=ax.get_transform("world"), s=120, fc="none", ec="tab:orange"
)
ax.set(xlim=(-0.5, 449.5), ylim=(-0.5, 299.5), xlabel="right ascension", ylabel="declination")
ax.coords.grid(color="white", alpha=0.3)
ax.coords["ra"].set_ticks_position("b")
ax.coords["dec"].set_ticks_position("l")
plt.colorbar(shown, ax=ax, label="electrons per pixel", shrink=0.9)
plt.show()

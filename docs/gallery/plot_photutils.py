"""
PSF photometry with photutils
=============================

``to_gridded_psf_model`` gives the PSF of a model to photutils. PSF photometry then uses the PSF of
each star's own position. With the PSF of the middle for every star, fluxes are wrong by tens of per
cent, and the error follows the position in the field. With the PSF of each position, a fraction of
one per cent remains (note the other scale): the gridded model interpolates linearly. The image has
no noise.
"""

import matplotlib.pyplot as plt
import numpy as np
from astropy.table import QTable
from photutils.psf import PSFPhotometry

import psfield

shape = (512, 768)
model = psfield.PsfModel.from_telescope(
    "survey-2m", field_shape=shape, stamp_size=32, oversampling=4, rank="full"
)
y, x = (axis.ravel() + 0.3 for axis in np.mgrid[31:512:50, 34:768:50])
image = psfield.simulate({"x": x, "y": y, "flux": 1000.0}, model, tolerance=1e-5)

everywhere = model.to_gridded_psf_model((17, 25))
middle = psfield.PsfModel.from_samples(
    model.evaluate(384, 256), (384, 256), field_shape=shape, oversampling=4
).to_gridded_psf_model((2, 2))

figure, axes = plt.subplots(1, 2, figsize=(11, 3.4), layout="constrained")
titles = ["PSF of the middle for every star", "PSF of each position"]
guesses = QTable({"x": x, "y": y, "flux": np.full(x.size, 900.0)})
for ax, title, psf in zip(axes, titles, [middle, everywhere], strict=True):
    found = PSFPhotometry(psf, fit_shape=(11, 11))(image, init_params=guesses)
    error = 100 * (found["flux_fit"] / 1000 - 1)
    print(f"{title}: largest error of a flux {np.abs(error).max():.2f} %")
    most = np.abs(error).max()
    dots = ax.scatter(x, y, c=error, cmap="RdBu_r", vmin=-most, vmax=most, edgecolor="grey")
    figure.colorbar(dots, ax=ax, label="error of the flux (%)", shrink=0.9)
    ax.set(title=title, xlabel="x (pixels)", ylabel="y (pixels)", aspect="equal")
plt.show()

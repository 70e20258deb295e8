"""
A first image
=============

This tutorial makes an image of stars and galaxies through a telescope whose PSF changes over the
field. It shows the three things you need (light, PSF, plan), checks the result, and measures the
cost of using one PSF for the whole frame.

It needs NumPy and matplotlib.
"""

import matplotlib.pyplot as plt
import numpy as np

import psfield
from psfield.plot import plot_image, plot_psf_field, plot_residuals

# %%
# Light and PSF
# -------------
#
# ``psfield.example`` returns a catalogue of stars and galaxies, and the PSF of a survey telescope
# over 512 x 768 pixels. A catalogue is any table with columns ``x``, ``y`` and ``flux``. Positions
# are 0-based pixels, and an integer is the centre of a pixel. Galaxies also have a half-light
# radius ``re``, a Sersic index ``n``, an axis ratio ``q`` and an ``angle``.

scene, model = psfield.example()
print(f"{len(scene['x'])} sources with the columns {', '.join(scene)}")
print(model)

# %%
# Look at the PSF first. Each stamp is drawn at its own position.

plot_psf_field(model)
plt.show()

# %%
# A model holds samples of the PSF and interpolates between them. It reports its own error: each
# sample is predicted from the others. The median error is two per cent of the PSF. Between the
# samples the error is smaller, because there the next sample is nearer.

report = model.fit_report()
print(f"{len(model.positions)} samples, {model.rank} components")
print(f"error of predicting a sample from the others: {report.leave_one_out.median:.1e}")
assert report.leave_one_out.median < 0.03

# %%
# The image
# ---------
#
# One call makes the image. Every source has the PSF of its own position.

image = psfield.simulate(scene, model)
# sphinx_gallery_thumbnail_number = 2
ax = plot_image(image)
ax.set_title("Stars and galaxies through the survey telescope")
plt.show()

# %%
# A PSF has unit flux, so the image keeps the light of the scene, except for the light that falls
# beyond the edges of the frame.

kept = image.sum(dtype=float) / scene["flux"].sum()
print(f"{100 * kept:.1f} % of the light is in the frame")
assert 0.9 < kept <= 1.001

# %%
# Many images
# -----------
#
# If you need more than one image, make a plan once. It holds all that does not depend on the light.
# The tolerance is the largest error that psfield may add to the PSF of any source. Here it has its
# default value.

plan = model.plan((512, 768))
print(plan.describe())
again = plan.simulate(catalog=scene)
assert np.array_equal(again, image)

# %%
# Is it right?
# ------------
#
# A spot check computes some hundred pixels by the exact sum over all sources, in double precision,
# and compares. Half of the pixels are bright ones.

check = plan.spot_check(catalog=scene, image=image)
print(f"relative error at {check.pixels} pixels: {check.relative_rms:.1e}")
assert check.passed

# %%
# One PSF for the whole frame
# ---------------------------
#
# With the PSF of the middle everywhere, the image is wrong. The panels show a corner of the frame.
# The title of the third gives the relative error there.

middle = psfield.PsfModel.from_samples(
    model.evaluate(383.5, 255.5), (383.5, 255.5), oversampling=model.oversampling
)
simple = psfield.simulate(scene, middle, shape=model.field_shape)
plot_residuals(simple[452:, :110], image[452:, :110])
plt.show()

error = psfield.metrics.compare(simple, image).relative_l2
print(f"relative L2 error with one PSF: {error:.2f}")
assert error > 100 * plan.tolerance

# %%
# The next tutorial reads the PSF and the sources from files.

"""
Whiskers: shapes over the field
===============================

Weak lensing needs the shape of the PSF at every position. Each whisker points along the major axis
of the PSF, and its length is the ellipticity. The colour is the width. The PSF is almost round in
the middle of the field and elongated in the corners.
"""

import matplotlib.pyplot as plt

import psfield
from psfield.plot import plot_shapes

model = psfield.PsfModel.from_telescope(
    "survey-2m", field_shape=(512, 768), stamp_size=32, oversampling=2
)
figure, ax = plt.subplots(figsize=(8, 4.6), layout="constrained")
plot_shapes(model, ax=ax)
plt.show()

# %%
# The numbers of one whisker: adaptive moments and a Gaussian fit of the PSF at a position.

shape = psfield.metrics.measure(model.evaluate(700, 450))
fwhm = shape["fwhm_px"][0] / model.oversampling
print(f"e1 = {shape['e1'][0]:.3f}, e2 = {shape['e2'][0]:.3f}, FWHM {fwhm:.2f} pixels")

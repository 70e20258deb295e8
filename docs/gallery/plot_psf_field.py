"""
PSFs over the field
===================

The PSFs of the two built-in telescopes, each drawn at its own position. Both telescopes are sharp
near the middle of the field. The survey telescope is off-axis, and its worst corner is at the top
left. The aberrations of the lens grow towards all corners.
"""

import matplotlib.pyplot as plt

import psfield
from psfield.plot import plot_psf_field

figure, axes = plt.subplots(2, 1, figsize=(7, 9), layout="constrained")
for ax, name, size in [(axes[0], "survey-2m", 20), (axes[1], "wide-field-lens", 12)]:
    model = psfield.PsfModel.from_telescope(
        name, field_shape=(512, 768), stamp_size=size, oversampling=4
    )
    plot_psf_field(model, ax=ax)
    ax.set_title(f"{name}: {ax.get_title()}")
plt.show()

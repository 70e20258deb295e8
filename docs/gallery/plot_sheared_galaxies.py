"""
Galaxies with shear
===================

Each galaxy of a catalogue may have a shear of its own, by the columns ``g1`` and ``g2``. These
galaxies are equal round exponential discs with a half-light radius of 6 pixels. ``g1`` stretches
along x or y, and ``g2`` along the diagonals. The PSF makes all of them rounder.
"""

import matplotlib.pyplot as plt
import numpy as np

import psfield
from psfield.metrics import measure

shears, step = np.linspace(-0.4, 0.4, 5), 64
model = psfield.PsfModel.from_telescope("survey-2m", field_shape=(320, 320), oversampling=4)
columns, rows = np.meshgrid(np.arange(5), np.arange(5))
galaxies = {
    "x": step * columns.ravel() + step / 2,
    "y": step * rows.ravel() + step / 2,
    "flux": 1000.0,
    "re": 6.0,
    "n": 1.0,
    "g1": shears[columns.ravel()],
    "g2": shears[rows.ravel()],
}
image = psfield.simulate(galaxies, model)

figure, ax = plt.subplots(figsize=(6, 5.2), layout="constrained")
shown = ax.imshow(image, origin="lower", cmap="magma")
ticks = step * np.arange(5) + step / 2
ax.set_xticks(ticks, [f"{g:+.1f}" for g in shears])
ax.set_yticks(ticks, [f"{g:+.1f}" for g in shears])
ax.set(xlabel="shear g1", ylabel="shear g2")
figure.colorbar(shown, ax=ax, label="flux per pixel")
plt.show()

# %%
# The measured shape of the galaxy on the right of the middle row:

found = measure(image, [(288, 160)], size=61)
print(f"sheared by g1 = 0.400, observed {found['g1'][0]:.3f}")

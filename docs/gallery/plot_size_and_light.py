"""
Width and aperture flux over the field
======================================

An aperture of fixed size loses more light where the PSF is wider. The left map shows the width of
the PSF, and the right one the part of a star's light within 3 pixels. One aperture correction for
the whole frame would be wrong by up to 25 per cent.
"""

import matplotlib.pyplot as plt
import numpy as np

import psfield
from psfield.metrics import measure

model = psfield.PsfModel.from_telescope("survey-2m", field_shape=(512, 768), oversampling=2)
x, y = np.meshgrid(np.linspace(0, 767, 25), np.linspace(0, 511, 17))
stamps = model.evaluate(x, y, pixels="frame", size=63)

width = measure(stamps.reshape(-1, 63, 63))["fwhm_px"].reshape(x.shape)
v, u = np.mgrid[-31:32, -31:32]
inside = stamps[..., np.hypot(u, v) <= 3].sum(axis=-1)

figure, axes = plt.subplots(1, 2, figsize=(10.5, 3.2), layout="constrained")
for ax, values, label in [
    (axes[0], width, "FWHM of the PSF (pixels)"),
    (axes[1], 100 * inside, "flux within 3 pixels (%)"),
]:
    shown = ax.contourf(x, y, values, levels=12)
    figure.colorbar(shown, ax=ax, label=label, shrink=0.8)
    ax.set(xlabel="x (pixels)", ylabel="y (pixels)", aspect="equal")
plt.show()

print(f"flux within 3 pixels: {100 * inside.min():.1f} to {100 * inside.max():.1f} %")

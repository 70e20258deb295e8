"""
A raw frame
===========

From light to the counts of a CCD. The detector adds sky, photon noise, read noise and bias, fills
its pixels up to the full well, and converts to integers. The first panel is the image without
noise, the second the raw frame. The third marks pixels that are saturated, dead or in a bad column.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap

import psfield
from psfield.detector import BAD_COLUMN, DEAD, SATURATED, Detector
from psfield.plot import plot_image

scene, model = psfield.example()
image = psfield.simulate(scene, model)[200:400, 300:600]
ccd = Detector(
    electrons_per_flux=20.0,
    photon_noise=True,
    sky_e=300.0,
    read_noise_e=5.0,
    full_well_e=60_000,
    gain_e_per_adu=1.5,
    bias_adu=500,
    bits=16,
    bad_pixels={"dead_fraction": 5e-4, "bad_column_fraction": 0.005},
)
exposure = ccd.expose(image, seed=1)

states = np.select([exposure.flags & flag > 0 for flag in (BAD_COLUMN, DEAD, SATURATED)], [3, 2, 1])

figure, axes = plt.subplots(3, 1, figsize=(6.5, 10.5), layout="constrained")
plot_image(image, ax=axes[0]).set_title("light (flux per pixel)")
plot_image(exposure.counts, ax=axes[1]).set_title("raw frame (ADU)")
colours = ListedColormap(["white", "tab:red", "black", "tab:blue"])
shown = axes[2].imshow(states, origin="lower", cmap=colours, vmin=-0.5, vmax=3.5)
bar = figure.colorbar(shown, ax=axes[2], ticks=range(4))
bar.set_ticklabels(["good", "saturated", "dead", "bad column"])
axes[2].set(title="flags", xlabel="x (pixels)", ylabel="y (pixels)")
plt.show()

print(f"{exposure.report.saturated_pixels} saturated pixels")

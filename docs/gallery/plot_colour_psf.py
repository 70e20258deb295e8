"""
A PSF that widens with the wavelength
=====================================

Diffraction grows with the wavelength, so a red star is wider than a blue star in the image of one
filter. Left: the width of the PSF at each wavelength, and of the mean PSF over the detected photons
of two black bodies. Right: the PSF of the red star minus that of the blue one. The telescope and
the filter are made up.
"""

import matplotlib.pyplot as plt
import numpy as np

import psfield
from psfield.metrics import measure

model = psfield.PsfModel.from_telescope(
    "survey-2m",
    field_shape=(512, 768),
    samples=(3, 3),
    stamp_size=32,
    oversampling=4,
    wavelengths_um=np.linspace(0.4, 1.0, 9),
)
x, y = 384, 256
bandpass = ([0.4, 0.45, 0.95, 1.0], [0.0, 0.8, 0.8, 0.0])  # micrometres, throughput
waves = np.linspace(0.4, 1.0, 31)
stamps = np.array([model.at(wavelength_um=wave).evaluate(x, y) for wave in waves])
widths = measure(stamps)["fwhm_px"] / model.oversampling

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", width_ratios=(4, 3))
axes[0].plot(waves, widths, color="black", label="one wavelength")
psfs = {}
for name, kelvin in [("blue", 12000), ("red", 3000)]:
    star = model.for_spectrum(bandpass, f"blackbody:{kelvin}")
    psfs[name] = star.evaluate(x, y)
    width = measure(psfs[name])["fwhm_px"][0] / model.oversampling
    axes[0].axhline(width, color=f"tab:{name}", ls="--", label=f"{name} star, {kelvin} K")
axes[0].set(xlabel="wavelength (micrometres)", ylabel="FWHM of the PSF (pixels)")
axes[0].legend()

difference = 100 * (psfs["red"] - psfs["blue"]) / psfs["blue"].max()
most = np.abs(difference).max()
side = (-16.125, 15.875)  # the PSF is centred on stamp pixel 64 of 128
shown = axes[1].imshow(
    difference, origin="lower", extent=(*side, *side), cmap="RdBu_r", vmin=-most, vmax=most
)
axes[1].set(xlim=(-6, 6), ylim=(-6, 6), xlabel="x from the star (pixels)")
axes[1].set(ylabel="y from the star (pixels)", title="red minus blue")
figure.colorbar(shown, ax=axes[1], label="% of the blue peak")
plt.show()

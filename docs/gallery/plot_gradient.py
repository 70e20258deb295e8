"""
The gradient of a misfit
========================

To fit a scene to a frame, an optimiser needs the derivative of the misfit with respect to every
pixel of the scene. ``Plan.adjoint`` gives all of them in the time of one simulation. Left: the
residual of a scene that lacks one star and has another too bright. Middle: the gradient, which is
the residual correlated with the PSF of each position. Right: it equals numerical derivatives.
"""

import matplotlib.pyplot as plt
import numpy as np

import psfield

shape = (32, 48)
model = psfield.PsfModel.from_telescope("survey-2m", field_shape=shape, stamp_size=32)
plan = model.plan(shape, tolerance=1e-6, precision="f64")

truth, guess = np.ones(shape), np.ones(shape)
truth[[24, 8], [10, 36]] = 400, 400
guess[[24, 8], [10, 36]] = 1, 700
residual = plan.simulate(guess) - plan.simulate(truth)
gradient = 2 * plan.adjoint(residual)  # of the sum of the squares of the residual

# Numerical derivatives for the pixels of a row through each star
pixels = [(row, x) for row in (24, 8) for x in range(48)]
numerical = []
for pixel in pixels:
    step = np.zeros(shape)
    step[pixel] = 0.5
    change = plan.simulate(step)
    numerical.append(np.sum((residual + change) ** 2) - np.sum((residual - change) ** 2))
values = [gradient[pixel] for pixel in pixels]
assert np.allclose(values, numerical, atol=1e-4 * np.abs(gradient).max())

figure, axes = plt.subplots(1, 3, figsize=(13, 3.1), layout="constrained", width_ratios=(3, 3, 2))
for ax, title, picture in [(axes[0], "residual", residual), (axes[1], "gradient", gradient)]:
    most = np.abs(picture).max()
    shown = ax.imshow(picture, origin="lower", cmap="RdBu_r", vmin=-most, vmax=most)
    figure.colorbar(shown, ax=ax, shrink=0.9)
    ax.set(title=title, xlabel="x (pixels)", ylabel="y (pixels)")
axes[2].axline((0, 0), slope=1, color="grey", label="equal")
axes[2].plot(numerical, values, "o", markersize=4, label="two rows")
axes[2].set(xlabel="numerical derivative", ylabel="gradient by the adjoint")
axes[2].legend()
plt.show()

"""
Which interpolation over the field?
===================================

Real PSF samples lie where the stars are. Each interpolator predicts the PSF between them. A fit
reports the error of predicting each sample from the others, so the choice needs no truth. Here the
truth is known, and both errors choose the same interpolator.
"""

import matplotlib.pyplot as plt
import numpy as np

import psfield

shape = (512, 768)
truth = psfield.PsfModel.from_telescope("survey-2m", field_shape=shape, samples=(13, 17))
rng = np.random.default_rng(4)
corners = [(0, 0), (767, 0), (0, 511), (767, 511)]
positions = np.concatenate([corners, rng.uniform(0, 1, (96, 2)) * (767, 511)])
samples = truth.evaluate(*positions.T)
x, y = rng.uniform(0, 1, (2, 200)) * [[767], [511]]
exact = truth.evaluate(x, y)

names = [
    "nearest",
    "idw",
    "delaunay",
    "polynomial=4",
    "natural-neighbour",
    "polynomial=8",
    "kriging",
]
predicted, real = [], []
for name in names:
    model = psfield.PsfModel.from_samples(
        samples,
        positions,
        field_shape=shape,
        oversampling=truth.oversampling,
        interpolation=name,
        noise=0,
    )
    predicted.append(model.fit_report().leave_one_out.median)
    error = np.linalg.norm(model.evaluate(x, y) - exact, axis=(1, 2))
    real.append(np.median(error / np.linalg.norm(exact, axis=(1, 2))))

figure, ax = plt.subplots(figsize=(7, 3.8), layout="constrained")
ax.plot(100 * np.array(predicted), names, "o", label="predicted: leave one out")
ax.plot(100 * np.array(real), names, "s", label="true, at 200 other positions")
ax.set(xscale="log", xlabel="relative L2 error of the PSF, median (%)")
ax.grid(alpha=0.4)
ax.legend()
plt.show()

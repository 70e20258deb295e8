"""
One PSF per patch
=================

A common shortcut gives each patch of a frame the PSF of its middle. The left panel shows the error
of this shortcut in the image of a scene with light in every pixel. It jumps at the edges of the
patches. The right panel shows that patches of half the side have half the error. psfield gives
every pixel the PSF of its own position.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import psfield
from psfield.metrics import compare

shape, sides = (512, 768), [256, 128, 64, 32]
model = psfield.PsfModel.from_telescope("survey-2m", field_shape=shape)
rng = np.random.default_rng(3)
scene = rng.uniform(0, 1, shape) ** 8  # fine structure everywhere
exact = psfield.simulate(scene, model, tolerance=1e-6, precision="f64")

# psfield warns that so few samples do not determine the PSF between them.
warnings.filterwarnings("ignore", "the samples do not determine the PSF")
images = []
for side in sides:
    x, y = np.meshgrid(np.arange(side / 2, 768, side), np.arange(side / 2, 512, side))
    patches = psfield.PsfModel.from_samples(
        model.evaluate(x.ravel(), y.ravel()),
        np.column_stack([x.ravel(), y.ravel()]),
        field_shape=shape,
        interpolation="nearest",
        noise=0,
    )
    images.append(psfield.simulate(scene, patches, tolerance=1e-4))
errors = [compare(image, exact).relative_l2 for image in images]
ours = compare(psfield.simulate(scene, model, tolerance=1e-3), exact).relative_l2

figure, axes = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained", width_ratios=(3, 2))
residual = 100 * (images[1] - exact) / exact.mean()
shown = axes[0].imshow(residual, origin="lower", cmap="RdBu_r", vmin=-10, vmax=10)
figure.colorbar(shown, ax=axes[0], label="error (% of the mean)", shrink=0.85)
axes[0].set(title="patches of 128 pixels", xlabel="x (pixels)", ylabel="y (pixels)")
axes[1].loglog(sides, errors, "o-", label="one PSF per patch")
axes[1].axhline(ours, color="C1", label="psfield, tolerance 1e-3")
axes[1].set_xticks(sides, [str(side) for side in sides])
axes[1].set_xticks([], minor=True)
axes[1].set(xlabel="side of a patch (pixels)", ylabel="relative L2 error of the image")
axes[1].legend()
plt.show()

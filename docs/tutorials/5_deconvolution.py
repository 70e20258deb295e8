"""
Deconvolution
=============

A plan is a linear operator, and its adjoint is the transpose. That is all that an iterative
deconvolution needs, so the PSF may change over the frame. This tutorial sharpens a noisy frame by
the method of Richardson (1972) and Lucy (1974), and compares it with a deconvolution that has only
the PSF of the middle.

It needs NumPy and matplotlib.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import AsinhNorm

import psfield

# %%
# 1. A frame
# ----------
#
# The truth: a sky of 20 electrons per pixel, galaxies and stars. A PSF that is a point draws the
# flux of a galaxy in each pixel. Deconvolution amplifies errors, so the plan is exact to 1e-6, in
# double precision.

shape = (192, 192)
model = psfield.PsfModel.from_telescope(
    "survey-2m", field_shape=shape, stamp_size=32, oversampling=2
)
plan = model.plan(shape, tolerance=1e-6, precision="f64")

rng = np.random.default_rng(5)
count = 25
galaxies = {
    "x": rng.uniform(10, 181, count),
    "y": rng.uniform(10, 181, count),
    "flux": rng.uniform(1e4, 6e4, count),
    "re": rng.uniform(3, 7, count),
    "n": np.ones(count),
    "q": rng.uniform(0.3, 1, count),
    "angle": rng.uniform(0, 180, count),
}
point = np.zeros((9, 9))
point[4, 4] = 4**2
pixel = psfield.PsfModel.from_samples(point, (0, 0), oversampling=4, pixel_response_included=False)
truth = 20 + pixel.plan(shape, precision="f64").simulate(catalog=galaxies)
np.add.at(truth, tuple(rng.integers(8, 184, (2, 40))), rng.uniform(2e3, 2e4, 40))

frame = rng.poisson(plan.simulate(truth)).astype(float)

# %%
# 2. The adjoint
# --------------
#
# For the operator ``A`` of the plan, ``(A f) . g`` equals ``f . (A^T g)`` for all images ``f`` and
# ``g``. An adjoint that is only nearly right may make the iteration diverge.

f, g = rng.normal(size=(2, *shape))
left, right = np.vdot(plan.simulate(f), g), np.vdot(f, plan.adjoint(g))
print(f"relative difference: {abs(left - right) / abs(left):.0e}")
assert np.isclose(left, right, rtol=1e-10)

# %%
# 3. Richardson and Lucy
# ----------------------
#
# Each iteration is ``f <- f * A^T(frame / A f) / A^T 1``: two calls of the plan. The error of the
# result is measured against the truth.


def richardson_lucy(plan, frame, iterations):
    """Return the deconvolved frame, and its relative error after each iteration."""
    norm = plan.adjoint(np.ones(shape))
    estimate = np.full(shape, frame.mean())
    errors = []
    for _ in range(iterations):
        estimate *= plan.adjoint(frame / plan.simulate(estimate)) / norm
        errors.append(np.linalg.norm(estimate - truth) / np.linalg.norm(truth))
    return estimate, errors


sharp, errors = richardson_lucy(plan, frame, 40)

# %%
# 4. With one PSF
# ---------------
#
# The PSF of the middle of the frame, used everywhere.

middle = psfield.PsfModel.from_samples(model.evaluate(95.5, 95.5), (95.5, 95.5), oversampling=2)
one_plan = middle.plan(shape, tolerance=1e-6, precision="f64")
with_one, errors_with_one = richardson_lucy(one_plan, frame, 40)

norm = AsinhNorm(linear_width=30, vmin=0, vmax=5000)
figure, axes = plt.subplots(1, 4, figsize=(13, 3.8), layout="constrained")
panels = {"frame": frame, "one PSF": with_one, "varying PSF": sharp, "truth": truth}
for ax, (title, image) in zip(axes, panels.items(), strict=True):
    shown = ax.imshow(image, origin="lower", cmap="gray", norm=norm)
    # The worst corner
    ax.set(title=title, xlim=(-0.5, 95.5), ylim=(95.5, 191.5), xlabel="x (pixels)")
axes[0].set_ylabel("y (pixels)")
figure.colorbar(shown, ax=axes, label="electrons per pixel", shrink=0.75)
plt.show()

# %%
# The pictures show the quarter of the frame where the PSF is widest. With one PSF, stars keep the
# shape of the aberrations. With the varying PSF, they become points, and the error falls in every
# iteration.

figure, ax = plt.subplots(figsize=(6, 4), layout="constrained")
iterations = np.arange(1, 41)
ax.plot(iterations, errors_with_one, label="one PSF")
ax.plot(iterations, errors, label="varying PSF")
ax.set(xlabel="iteration", ylabel="relative error", ylim=(0, None))
ax.legend()
plt.show()

print(f"error: {errors[-1]:.2f} with the varying PSF, {errors_with_one[-1]:.2f} with one PSF")
assert errors[-1] < 0.5 * min(errors_with_one)
assert (np.diff(errors) < 0).all()

# %%
# ``plan.linear_operator()`` gives the operator to the solvers of SciPy, such as ``lsqr``.

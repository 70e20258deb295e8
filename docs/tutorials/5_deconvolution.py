"""
Deconvolution
=============

Deconvolution by the method of Richardson (1972) and Lucy (1974) needs a plan and its adjoint, the
transpose. So the PSF may change over the frame. This tutorial finds the number of iterations
without the truth, and compares the result with one that has only the PSF of the middle of the
frame. It needs NumPy and matplotlib.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import AsinhNorm

import psfield

# %%
# 1. A frame
# ----------
#
# The truth: galaxies and stars. A PSF that is a point draws the flux of a galaxy in each pixel. The
# sky adds 100 electrons to each pixel of the frame. It is not part of the scene, where it would end
# at the edge. Deconvolution amplifies errors, so the model keeps all components, and the plan is
# exact to 1e-6, in double precision. psfield warns that a point cannot be shifted by parts of a
# pixel. Here it only adds up the light of each pixel.

shape, sky = (192, 192), 100.0
model = psfield.PsfModel.from_telescope(
    "survey-2m", field_shape=shape, stamp_size=32, oversampling=2, rank="full"
)
plan = model.plan(shape, tolerance=1e-6, precision="f64")

rng = np.random.default_rng(5)
x, y = rng.uniform(10, 181, (2, 25))
flux, re = rng.uniform(1e4, 6e4, 25), rng.uniform(3, 7, 25)
q, angle = rng.uniform(0.3, 1, 25), rng.uniform(0, 180, 25)
galaxies = {"x": x, "y": y, "flux": flux, "re": re, "n": np.ones(25), "q": q, "angle": angle}
warnings.filterwarnings("ignore", "the PSF stamps are too coarse")
point = np.zeros((9, 9))
point[4, 4] = 4**2
pixel = psfield.PsfModel.from_samples(point, (0, 0), oversampling=4, pixel_response_included=False)
truth = pixel.plan(shape, precision="f64").simulate(catalog=galaxies)
np.add.at(truth, tuple(rng.integers(8, 184, (2, 40))), rng.uniform(2e3, 2e4, 40))

frame = rng.poisson(plan.simulate(truth) + sky)

# %%
# 2. Richardson and Lucy
# ----------------------
#
# For the operator ``A`` of the plan, ``(A f) . g`` equals ``f . (A^T g)`` for all images ``f`` and
# ``g``. Each iteration is ``f <- f * A^T(frame / (A f + sky)) / A^T 1``: two calls of the plan.
# Start far below the sky: dark pixels fall slowly, so a high start leaves too much flux in them.
# In a frame that is mostly empty, even this start may add some per cent to the total. Fluxes in
# apertures are safer.

f, g = rng.normal(size=(2, *shape))
assert np.isclose(np.vdot(plan.simulate(f), g), np.vdot(f, plan.adjoint(g)), rtol=1e-10)


def richardson_lucy(plan, counts, sky, iterations):
    """Yield the estimate and the counts that it predicts, after each iteration."""
    norm = plan.adjoint(np.ones(plan.image_shape))
    estimate = np.full(plan.shape, 0.01 * sky)
    predicted = plan.simulate(estimate) + sky
    for _ in range(iterations):
        estimate = estimate * plan.adjoint(counts / predicted) / norm
        predicted = plan.simulate(estimate) + sky
        yield estimate, predicted


# %%
# 3. When to stop
# ---------------
#
# Too many iterations fit the noise. To find the right number, divide the electrons at random: about
# 80 % of each pixel to fit, 20 % to test. The noise of the two parts is independent. Stop where the
# test counts are most likely. This needs whole electrons, with the sky. For counts of a detector,
# subtract the bias, multiply by the gain and round.

fit = rng.binomial(frame, 0.8)
test = frame - fit


def error(estimate):
    """Return the sum of the absolute errors, as a share of the flux."""
    return np.abs(estimate - truth).sum() / truth.sum()


middle = psfield.PsfModel.from_samples(model.evaluate(95.5, 95.5), (95.5, 95.5), oversampling=2)
plans = {"one PSF": middle.plan(shape, tolerance=1e-6, precision="f64"), "varying PSF": plan}
curves, best = {}, {}
for name, each in plans.items():
    steps = richardson_lucy(each, fit / 0.8, sky, 60)
    curve = [((test * np.log(0.2 * m) - 0.2 * m).sum(), error(estimate)) for estimate, m in steps]
    curves[name] = np.transpose(curve)
    best[name] = curves[name][0].argmax() + 1

top = curves["varying PSF"][0].max()
assert top > curves["one PSF"][0].max()
figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for name, (likelihoods, errors) in curves.items():
    for ax, values in zip(axes, (likelihoods - top, errors), strict=True):
        ax.plot(range(1, 61), values, "o-", markevery=[best[name] - 1], label=name)
    assert errors[best[name] - 1] < 1.05 * errors.min()
axes[0].set(xlabel="iteration", ylabel="log-likelihood - largest value", ylim=(-2000, 100))
axes[1].set(xlabel="iteration", ylabel="error (share of the flux)", ylim=(0, 1))
axes[1].legend()
plt.show()

# %%
# Dots mark the stops. The error needs the truth, so a real frame has no such curve. Here it checks
# the rule: the error at the stop is within 5 % of its smallest value. The likelihood is higher with
# the varying PSF, which a real frame would show as well.
#
# 4. The result
# -------------
#
# The result uses all counts. The pictures show the quarter of the frame where the PSF is widest.
# With one PSF, stars keep the shape of the aberrations. With the varying PSF, they become nearly
# points. More iterations would sharpen stars further, and make galaxies noisier.

sharp = {name: list(richardson_lucy(plans[name], frame, sky, best[name]))[-1][0] for name in plans}

# sphinx_gallery_thumbnail_number = 2
figure, axes = plt.subplots(1, 4, figsize=(13, 3.8), layout="constrained")
norm = AsinhNorm(linear_width=30, vmin=0, vmax=5000)
panels = {"frame - sky": frame - sky, **sharp, "truth": truth}
for ax, (title, image) in zip(axes, panels.items(), strict=True):
    shown = ax.imshow(image, origin="lower", cmap="gray", norm=norm)
    ax.set(title=title, xlim=(-0.5, 95.5), ylim=(95.5, 191.5), xlabel="x (pixels)")
axes[0].set_ylabel("y (pixels)")
figure.colorbar(shown, ax=axes, label="electrons per pixel", shrink=0.75)
plt.show()

ratio = sharp["varying PSF"].sum() / (frame - sky).sum()
print(f"flux of the result / (counts - sky): {ratio:.3f}")
print({name: f"{best[name]} iterations, error {error(sharp[name]):.2f}" for name in plans})
assert abs(ratio - 1) < 0.03 and error(sharp["varying PSF"]) < 0.7 * error(sharp["one PSF"])

# %%
# No pixel becomes negative, so noise in dark pixels adds a little flux. Least squares allows
# negative pixels: ``plan.linear_operator()`` gives the operator to SciPy, for example to ``lsqr``.
# Sources outside a frame also light its edge. A plan for a larger scene, with ``frame=``, has room
# for their light. Its margin must be smaller than half a stamp, or ``A^T 1`` is zero there.

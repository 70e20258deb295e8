"""
Deconvolution
=============

Deconvolution by the method of Richardson (1972) and Lucy (1974) needs a plan and its adjoint, the
transpose. So the PSF may change over the frame. This tutorial finds the number of iterations
without the truth, and compares the result with one that has only the PSF of the middle of the
frame. Its last section adds a regulariser, and finds the light by gradient.

It needs NumPy, SciPy, JAX and matplotlib.
"""

import warnings

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import AsinhNorm
from scipy.optimize import minimize

import psfield
from psfield.jax import SpatiallyVaryingBlur

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
#
# 5. By gradient, with a regulariser
# ----------------------------------
#
# A stop is a weak constraint: galaxies are noisy before stars are sharp. A regulariser prefers
# light without noise. This one is the total variation of the square root of the light, whose photon
# noise is equal in bright and faint pixels. Steps below 1 are smoothed. ``psfield.jax`` makes the
# plan a function of JAX, which differentiates the sum of misfit and regulariser. The pixels are
# squares of the parameters, so none is negative. L-BFGS begins with the result of Richardson and
# Lucy.

jax.config.update("jax_enable_x64", True)


def deconvolve(plan, counts, share, strength, begin):
    """Return the light whose image, times ``share``, fits the counts."""
    blur = SpatiallyVaryingBlur(plan)

    def objective(root):
        root = root.reshape(shape)
        predicted = share * jnp.maximum(blur(root**2) + sky, 1e-3)
        misfit = (predicted - counts * jnp.log(predicted)).sum()
        steps_x, steps_y = jnp.diff(root, axis=1)[:-1], jnp.diff(root, axis=0)[:, :-1]
        return (misfit + strength * jnp.sqrt(1 + steps_x**2 + steps_y**2).sum()) / root.size

    value_and_gradient = jax.jit(jax.value_and_grad(objective))
    options = {"maxiter": 30, "ftol": 0}
    root = np.sqrt(begin).ravel()
    found = minimize(value_and_gradient, root, jac=True, method="L-BFGS-B", options=options)
    return found.x.reshape(shape) ** 2


# %%
# The test counts tell the strength, as they told the number of iterations.

*_, (begin, _) = richardson_lucy(plan, fit / 0.8, sky, best["varying PSF"])
likelihoods = {}
for strength in (0.2, 0.6, 1.8):
    predicted = 0.2 * (plan.simulate(deconvolve(plan, fit, 0.8, strength, begin)) + sky)
    likelihoods[strength] = (test * np.log(predicted) - predicted).sum()
    print(f"strength {strength}: log-likelihood of the test {likelihoods[strength] - top:+.0f}")
strength = max(likelihoods, key=likelihoods.get)

classic = sharp["varying PSF"]
regularised = deconvolve(plan, frame, 1.0, strength, classic)
print(f"error with strength {strength}: {error(regularised):.2f}", end=" ")
print(f"(Richardson and Lucy: {error(classic):.2f})")
assert likelihoods[strength] > top and error(regularised) < 0.6 * error(classic)

figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.8), layout="constrained")
panels = {"Richardson and Lucy": classic, "regularised": regularised, "truth": truth}
for ax, (title, image) in zip(axes, panels.items(), strict=True):
    shown = ax.imshow(image, origin="lower", cmap="gray", norm=norm)
    ax.set(title=title, xlim=(-0.5, 95.5), ylim=(95.5, 191.5), xlabel="x (pixels)")
axes[0].set_ylabel("y (pixels)")
figure.colorbar(shown, ax=axes, label="electrons per pixel", shrink=0.75)
plt.show()

# %%
# Log-likelihoods are relative to the best one of Richardson and Lucy. All stars of this scene lie
# in the middle of a pixel, which is easy to restore sharply. Other scenes may need other
# regularisers, or a network, which a later tutorial trains with the plan in the loop.

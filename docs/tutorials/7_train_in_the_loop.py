"""
A network with psfield in the loop
==================================

A deconvolution repeats a step: blur the estimate, compare it with the frame, correct the estimate.
A network can learn the corrections. Here psfield blurs in each step, so the gradient of the loss
passes through the varying PSF on its way to the weights. This tutorial trains a small network with
the varying PSF, and another with the PSF of the middle of the frame. New frames compare both with
the method of Richardson (1972) and Lucy (1974).

It needs JAX, optax and matplotlib.
"""

import time
import warnings
from functools import partial

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax
from matplotlib.colors import AsinhNorm

import psfield
from psfield.jax import SpatiallyVaryingBlur

# Single precision is the default of JAX, unless another program has changed it.
jax.config.update("jax_enable_x64", False)
shape, sky = (64, 64), 50.0

# %%
# 1. Frames
# ---------
#
# The PSF is that of the whole field of the survey telescope, squeezed into a small frame. The truth
# is the light in each pixel: stars in single pixels, and galaxies, which a PSF that is a point
# draws. The tutorial on training sets explains this. The frames have the photon noise of stars,
# galaxies and sky. The last 20 frames are not used for the training.

model = psfield.PsfModel.from_telescope(
    "survey-2m",
    field_shape=shape,
    samples=(7, 7),
    stamp_size=24,
    oversampling=2,
    interpolation="natural-neighbour",
)

# psfield warns of the sharp edges of a point. Here it only adds up the light of each pixel.
warnings.filterwarnings("ignore", "the PSF stamps are too coarse")
point = np.zeros((17, 17))
point[8, 8] = 8**2
pixel = psfield.PsfModel.from_samples(point, (0, 0), oversampling=8, pixel_response_included=False)
drawing = pixel.plan(shape)


def sharp_frame(rng):
    """Draw 4 galaxies and 10 stars."""
    galaxies = {
        "x": rng.uniform(0, shape[1] - 1, 4),
        "y": rng.uniform(0, shape[0] - 1, 4),
        "flux": 10 ** rng.uniform(3.5, 4.5, 4),
        "re": rng.uniform(2, 5, 4),
        "n": np.ones(4),
        "q": rng.uniform(0.3, 1, 4),
        "angle": rng.uniform(0, 180, 4),
    }
    frame = np.maximum(drawing.simulate(catalog=galaxies), 0)
    np.add.at(frame, tuple(rng.integers(0, 64, (2, 10))), 10 ** rng.uniform(3, 4.3, 10))
    return frame


def expose(model, sharp):
    """Return frames in electrons. Their plan is finer than that of the network."""
    light = model.plan(shape, tolerance=1e-4).simulate(sharp)
    return rng.poisson(light + sky).astype(np.float32)


rng = np.random.default_rng(7)
sharp = np.array([sharp_frame(rng) for _ in range(420)])
frames = expose(model, sharp)
new, new_sharp = frames[400:], sharp[400:]

# %%
# 2. The network
# --------------
#
# For the operator ``A`` of a plan, a step of Richardson and Lucy multiplies the estimate ``f`` by
# the factor ``A^T(frame / (A f + sky)) / A^T 1``. A step of the network raises this factor to a
# power, and multiplies by a correction. Two small convolutions compute the logarithm of the
# correction from those of the estimate and of the factor. So no pixel becomes negative. Each step
# has weights of its own. Before the training, the corrections are 1 and the powers are 1: the
# network is Richardson and Lucy.

steps, channels = 6, 8
weights = {
    "power": jnp.ones(steps),
    "first": 0.24 * jax.random.normal(jax.random.key(7), (steps, 3, 3, 2, channels)),
    "bias": jnp.zeros((steps, channels)),
    "last": jnp.zeros((steps, 3, 3, channels, 1)),
}
print(f"{sum(values.size for values in weights.values())} weights")


def convolve(images, kernels):
    """Convolve images ``[frame, y, x, channel]``."""
    axes = ("NHWC", "HWIO", "NHWC")
    return jax.lax.conv_general_dilated(images, kernels, (1, 1), "SAME", dimension_numbers=axes)


def richardson_lucy_factor(blur, norm, light, frames):
    """Return the factor of a step."""
    return blur.adjoint(frames / (blur(light) + sky)) / norm


def restore(weights, blur, frames):
    """Return the light of frames ``[frame, y, x]``."""
    norm = blur.adjoint(jnp.ones(shape))
    light = jnp.full_like(frames, 0.1 * sky)
    for k in range(steps):
        factor = richardson_lucy_factor(blur, norm, light, frames)
        # Factors are near 1. The bound keeps the logarithm finite during the training.
        logs = jnp.stack([jnp.log(light / sky), jnp.log(jnp.maximum(factor, 0.01))], axis=-1)
        hidden = jax.nn.relu(convolve(logs, weights["first"][k]) + weights["bias"][k])
        correction = convolve(hidden, weights["last"][k])[..., 0]
        light = light * jnp.exp(weights["power"][k] * logs[..., 1] + correction)
    return light


# %%
# 3. The training
# ---------------
#
# The loss is the error of the estimate as a share of the flux. Both networks see the frames of the
# varying PSF in the same order. ``jit`` compiles a whole step of the training, with the calls of
# psfield in it.


def errors(light, truth):
    """Return the sum of the absolute errors of each frame, as a share of its flux."""
    return jnp.abs(light - truth).sum((1, 2)) / truth.sum((1, 2))


middle = psfield.PsfModel.from_samples(model.evaluate(31.5, 31.5), (31.5, 31.5), oversampling=2)
blurs = {
    "one PSF": SpatiallyVaryingBlur(middle.plan(shape, tolerance=0.01)),
    "varying PSF": SpatiallyVaryingBlur(model.plan(shape, tolerance=0.01)),
}
rounds, batch = 100, 4
optimiser = optax.adam(optax.cosine_decay_schedule(0.01, rounds))


@partial(jax.jit, static_argnums=0)
def update(blur, weights, state, frames, truth):
    """Return the weights and the state of the optimiser after a step, and the loss before it."""
    loss, gradient = jax.value_and_grad(
        lambda weights: errors(restore(weights, blur, frames), truth).mean()
    )(weights)
    changes, state = optimiser.update(gradient, state)
    return optax.apply_updates(weights, changes), state, loss


def train(blur, weights):
    """Return the trained weights, and the loss of each round."""
    state, order, losses = optimiser.init(weights), np.random.default_rng(1), []
    for _ in range(rounds):
        chosen = order.integers(0, 400, batch)
        weights, state, loss = update(blur, weights, state, frames[chosen], sharp[chosen])
        losses.append(loss.item())
    return weights, losses


trained, losses = {}, {}
for name, blur in blurs.items():
    began = time.perf_counter()
    trained[name], losses[name] = train(blur, weights)
    print(f"{name}: {rounds} rounds in {time.perf_counter() - began:.0f} s")

# %%
# 4. New frames
# -------------
#
# Richardson and Lucy start from the same light. Their error after each step shows how many steps
# suit them best. It needs the truth, so a real frame does not tell.


def richardson_lucy(blur, frames, count):
    """Yield the light after each step."""
    norm = blur.adjoint(jnp.ones(shape))
    step = jax.jit(lambda light: light * richardson_lucy_factor(blur, norm, light, frames))
    light = jnp.full_like(frames, 0.1 * sky)
    for _ in range(count):
        light = step(light)
        yield light


def error(light):
    """Return the mean error of the new frames."""
    return errors(light, new_sharp).mean().item()


figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
results = {}
for (name, blur), colour in zip(blurs.items(), ("C1", "C0"), strict=True):
    curve = [error(light) for light in richardson_lucy(blur, new, 150)]
    assert np.isclose(error(restore(weights, blur, new)), curve[steps - 1], rtol=1e-4)
    results[name] = error(restore(trained[name], blur, new))
    axes[0].plot(losses[name], color=colour, label=name)
    axes[1].plot(range(1, 151), curve, color=colour, label=f"Richardson-Lucy, {name}")
    axes[1].plot(steps, results[name], "o", color=colour, label=f"network, {name}")
    print(f"{name}: Richardson and Lucy {curve[steps - 1]:.2f} after {steps} steps,", end=" ")
    print(f"{min(curve):.2f} after {np.argmin(curve) + 1}, network {results[name]:.2f}")
axes[0].set(xlabel="round", ylabel="error (share of the flux)", ylim=(0, 1.2), title="training")
axes[1].set(xlabel="steps", xscale="log", ylim=(0, 1.2), title="new frames")
axes[0].legend()
axes[1].legend(loc="upper right")
plt.show()

assert results["varying PSF"] < 0.8 * results["one PSF"] < 0.8 * min(curve)

# %%
# The networks have learned what stars and galaxies look like, and Richardson and Lucy have not. So
# frames with other sources need another training. The pictures show a new frame. The PSF is widest
# in the upper left corner. The network with one PSF does not know this, so a star there stays wide.
# Richardson and Lucy make this star the sharpest, but the galaxies noisy.

truth, frame = new_sharp[0], new[:1]
*_, classic = richardson_lucy(blurs["varying PSF"], frame, 100)
panels = {"frame - sky": frame[0] - sky, "Richardson-Lucy,\n100 steps": classic[0]}
for name, blur in blurs.items():
    panels[f"network,\n{name}"] = restore(trained[name], blur, frame)[0]
panels["truth"] = truth

# sphinx_gallery_thumbnail_number = 2
figure, axes = plt.subplots(1, 5, figsize=(14, 3.6), layout="constrained")
norm = AsinhNorm(linear_width=30, vmin=0, vmax=5000)
for ax, (title, image) in zip(axes, panels.items(), strict=True):
    shown = ax.imshow(image, origin="lower", cmap="gray", norm=norm)
    ax.set(title=title, xlabel="x (pixels)")
axes[0].set_ylabel("y (pixels)")
figure.colorbar(shown, ax=axes, label="electrons per pixel", shrink=0.75, pad=0.01)
plt.show()

# %%
# 5. Another PSF
# --------------
#
# The weights know the PSF only through the operator. So the network takes frames of another PSF
# without a new training, if it gets their plan. Here the PSFs of opposite positions are exchanged.

turned = model.with_parameters(coefficients=model.coefficients[::-1])
turned_frames = expose(turned, new_sharp)
right = SpatiallyVaryingBlur(turned.plan(shape, tolerance=0.01))
of_right = error(restore(trained["varying PSF"], right, turned_frames))
of_wrong = error(restore(trained["varying PSF"], blurs["varying PSF"], turned_frames))
print(f"error with the plan of the new PSF {of_right:.2f}, with that of the old {of_wrong:.2f}")
assert of_right < 1.3 * results["varying PSF"] and of_right < 0.5 * of_wrong

"""
Fit the PSF to a frame
======================

The focus of a telescope drifts. Earlier nights tell which shapes its PSF takes, and the stars of a
frame tell which of them it has tonight. This tutorial fits the PSF and the fluxes of the stars to a
frame with photon noise, by the gradient of the likelihood. Then it measures the fitted PSF over the
field, and predicts another frame.

It needs JAX, SciPy and matplotlib.
"""

import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

import psfield
from psfield.jax import SpatiallyVaryingBlur
from psfield.metrics import measure

# A fit needs double precision.
jax.config.update("jax_enable_x64", True)

# %%
# 1. Earlier nights
# -----------------
#
# A telescope of 1.2 m. Its aberrations grow towards the corners, and the focus adds to them. Five
# nights had a focus from -50 to 50 nm. The PSF of each night is known at 5 x 5 positions. A model
# with ten components holds them all, with a frame number for each night. The fit begins with the
# night at 0 nm.

DESCRIPTION = """
wavelength_nm = 633.0
pixel_scale_arcsec = 0.05
frame = { nx = 192, ny = 192 }
stamp = { nx = 64, ny = 64, oversampling = 2 }
aperture = { diameter_m = 1.2, obscuration = 0.3 }
detector = { pixel_integration = true, blur_sigma_px = 0.4 }
[wavefront]
unit = "nm"
modes = [
    { noll = 4, terms = [{ value = FOCUS }, { x = 2, value = 25.0 }, { y = 2, value = 25.0 }] },
    { noll = 5, terms = [{ x = 1, y = 1, value = 25.0 }, { value = 20.0 }] },
    { noll = 6, terms = [{ x = 2, value = 20.0 }, { y = 2, value = -20.0 }] },
    { noll = 7, terms = [{ y = 1, value = 25.0 }] },
    { noll = 8, terms = [{ x = 1, value = 25.0 }] },
]
"""
shape, sky = (192, 192), 100.0


def telescope(focus_nm, samples):
    """Return the PSF of the telescope, with all its components."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "telescope.toml"
        path.write_text(DESCRIPTION.replace("FOCUS", str(focus_nm)))
        return psfield.PsfModel.from_telescope(
            path, field_shape=shape, samples=samples, oversampling=2, rank="full"
        )


nights = [telescope(focus_nm, (5, 5)) for focus_nm in (-50.0, -25.0, 0.0, 25.0, 50.0)]
history = psfield.PsfModel.from_samples(
    [night.evaluate(x, y) for night in nights for x, y in night.positions],
    np.concatenate([night.positions for night in nights]),
    frame_numbers=np.repeat(np.arange(5), 25),
    field_shape=shape,
    oversampling=2,
    rank=10,
    noise=0,
)
start = history.at(frame_number=2)

# %%
# 2. Tonight's frame
# ------------------
#
# The focus is 35 nm, which no earlier night had. The frame has 100 stars, and the photon noise of
# stars and sky. It is made from the telescope itself, with more samples and all components.

truth = telescope(35.0, (9, 9))
rng = np.random.default_rng(8)


def new_stars():
    """Return a catalogue of stars."""
    x, y = rng.uniform(6, 185, (2, 100))
    return {"x": x, "y": y, "flux": 10 ** rng.uniform(3.5, 4.8, 100)}


def plan_for(model):
    """Return a plan that bounds the L2 error. Ten components do not keep the flux in apertures."""
    return model.plan(shape, tolerance=1e-4, tolerance_on="l2", precision="f64")


def image(model, stars):
    """Return the image of stars, without noise."""
    return plan_for(model).simulate(catalog=stars)


stars = new_stars()
frame = rng.poisson(image(truth, stars) + sky).astype(float)

# %%
# 3. The stars as light
# ---------------------
#
# The gradient with respect to the PSF needs light on pixels. The pixels of this frame sample the
# PSF well, so the image of a star between pixels is a sum of images of stars on pixels. Their
# weights are those of Lanczos, over 12 x 12 pixels. The positions are known, the fluxes are not.


def lanczos(positions, reach=6):
    """Return the pixels about positions along an axis, and their weights."""
    pixels = np.floor(positions).astype(int)[:, None] + np.arange(1 - reach, reach + 1)
    distances = pixels - positions[:, None]
    weights = np.sinc(distances) * np.sinc(distances / reach)
    return pixels, weights / weights.sum(1, keepdims=True)


(columns, along_x), (rows, along_y) = lanczos(stars["x"]), lanczos(stars["y"])
cells = rows[:, :, None], columns[:, None, :]
weights = along_y[:, :, None] * along_x[:, None, :]


def light(flux):
    """Return the light on pixels."""
    return jnp.zeros(shape).at[cells].add(flux[:, None, None] * weights)


exact = image(truth, stars)
difference = plan_for(truth).simulate(np.asarray(light(stars["flux"]))) - exact
in_sigma = np.abs(difference) / np.sqrt(exact + sky)
print(f"error of the light on pixels: {in_sigma.max():.1f} sigma at most")
assert in_sigma.max() < 1

# %%
# 4. The fit
# ----------
#
# The focus changes the coefficients smoothly over the field: to those of the earlier night, the fit
# adds a polynomial of degree 2 in the position for each component. JAX takes the gradient from the
# coefficients to the polynomials. Fluxes are in units of a guess, which is wrong by up to 20 %, and
# coefficients in units of their scatter. So all parameters are of the order of 1.

u, v = (start.positions / 95.5 - 1).T
terms = np.stack([u**0, u, v, u**2, u * v, v**2], axis=1)
scatter = start.coefficients.std(axis=0)
guess = stars["flux"] * rng.uniform(0.8, 1.2, 100)
blur = SpatiallyVaryingBlur(plan_for(start))


def coefficients(parameters):
    """Return the coefficients at the samples."""
    return start.coefficients + terms @ parameters[100:].reshape(6, -1) * scatter


def predicted(parameters):
    """Return the frame without noise. The first 100 parameters are the fluxes."""
    psf = {} if parameters.size == 100 else {"coefficients": coefficients(parameters)}
    return blur(light(guess * parameters[:100]), **psf) + sky


def misfit(parameters):
    """Return the deviance per pixel: -2 log-likelihood, which is about 1 for the truth."""
    counts = jnp.maximum(predicted(parameters), 1.0)
    return 2 * (counts - frame + jax.scipy.special.xlogy(frame, frame / counts)).mean()


def fit(begin):
    """Return the best parameters."""
    began = time.perf_counter()
    value_and_gradient = jax.jit(jax.value_and_grad(misfit))
    options = {"maxiter": 100, "ftol": 1e-7}
    found = minimize(value_and_gradient, begin, jac=True, method="L-BFGS-B", options=options)
    seconds = time.perf_counter() - began
    print(f"{found.x.size} parameters, {found.nfev} gradients in {seconds:.1f} s")
    return found.x


# %%
# First only the fluxes, with the PSF of the earlier night. Then both.

fluxes = fit(np.ones(100))
best = fit(np.concatenate([fluxes, np.zeros(6 * start.rank)]))
fitted = start.with_parameters(coefficients=coefficients(best))


def chi_square(frame, counts):
    """Return chi square per pixel."""
    return np.mean((frame - counts) ** 2 / counts)


figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
shown = axes[0].imshow(frame, origin="lower", cmap="gray", vmin=50, vmax=1000)
axes[0].set(title="frame", ylabel="y (pixels)")
figure.colorbar(shown, ax=axes[0], label="electrons per pixel", shrink=0.8, extend="max")
for ax, (name, parameters) in zip(
    axes[1:], {"PSF of the earlier night": fluxes, "fitted PSF": best}.items(), strict=True
):
    counts = np.asarray(predicted(parameters))
    residuals = (frame - counts) / np.sqrt(counts)
    shown = ax.imshow(residuals, origin="lower", cmap="RdBu_r", vmin=-6, vmax=6)
    ax.set(title=name)
    wrong = np.median(np.abs(guess * parameters[:100] / stars["flux"] - 1))
    print(f"{name}: chi square per pixel {chi_square(frame, counts):.3f},", end=" ")
    print(f"error of a flux {100 * wrong:.1f} % (median)")
figure.colorbar(shown, ax=axes[1:], label="residual (sigma)", shrink=0.8, extend="both")
for ax in axes:
    ax.set(xlabel="x (pixels)")
plt.show()

assert chi_square(frame, counts) < 1.1

# %%
# 5. The PSF over the field
# -------------------------
#
# Compare with the truth at 8 x 8 positions: the PSFs themselves, their widths and their shapes.

grid = [(x, y) for y in np.linspace(8, 183, 8) for x in np.linspace(8, 183, 8)]
models = {"earlier night": start, "fitted": fitted, "truth": truth}
stamps = {name: np.array([model.evaluate(*at) for at in grid]) for name, model in models.items()}
measured = {name: measure(each) for name, each in stamps.items()}
widths = {name: each["fwhm_px"] / start.oversampling for name, each in measured.items()}
shapes = {name: np.hypot(each["e1"], each["e2"]) for name, each in measured.items()}

# sphinx_gallery_thumbnail_number = 2
figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
errors = {}
for name, colour in (("earlier night", "C1"), ("fitted", "C0")):
    difference = np.linalg.norm(stamps[name] - stamps["truth"], axis=(1, 2))
    errors[name] = np.median(difference / np.linalg.norm(stamps["truth"], axis=(1, 2)))
    wide = np.sqrt(np.mean((widths[name] / widths["truth"] - 1) ** 2))
    e1, e2 = (measured[name][e] - measured["truth"][e] for e in ("e1", "e2"))
    shape_error = np.sqrt(np.mean(e1**2 + e2**2))
    print(f"{name}: error of the PSF {errors[name]:.3f} (median, relative L2),", end=" ")
    print(f"of the FWHM {100 * wide:.1f} %, of the ellipticity {shape_error:.3f} (r.m.s.)")
    for ax, values in zip(axes, (widths, shapes), strict=True):
        ax.plot(values["truth"], values[name], "o", markersize=4, color=colour, label=name)
for ax, name in zip(axes, ("FWHM (pixels)", "ellipticity"), strict=True):
    ax.axline((1, 1), slope=1, color="grey", zorder=0)
    ax.set(xlabel=f"{name}, truth", ylabel=f"{name}, model")
axes[0].set(xlim=(2.3, 3.3), ylim=(2.3, 3.3))
axes[1].set(xlim=(0, 0.55), ylim=(0, 0.55))
axes[0].legend()
plt.show()

assert errors["fitted"] < 0.15 * errors["earlier night"]

# %%
# 6. Another frame
# ----------------
#
# The fitted PSF is a model like any other. It predicts a new frame of the night, with other stars
# of known flux. Nothing is fitted to this frame.

others = new_stars()
second = rng.poisson(image(truth, others) + sky)
for name, model in models.items():
    result = chi_square(second, image(model, others) + sky)
    print(f"{name}: chi square per pixel of the new frame {result:.3f}")

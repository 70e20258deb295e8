"""
Fluxes and positions of 10 000 stars
====================================

In a crowded frame the light of stars overlaps, so all of them are fitted together. ``simulate``
draws the stars with the PSF of each position, and ``source_gradients`` returns the derivatives
with respect to their fluxes and positions. This is all that an optimiser needs. The errors of the
result are compared with the smallest that are possible, the bound of Cramer and Rao.

It needs NumPy, SciPy and matplotlib.
"""

import time

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import AsinhNorm
from scipy.optimize import minimize

import psfield

# %%
# 1. A crowded frame
# ------------------
#
# 10 000 stars on 1024 x 1024 pixels: one in 105 pixels. Their fluxes follow a power law, and the
# sky adds 50 electrons to each pixel. The frame has photon noise.

shape, count, sky = (1024, 1024), 10_000, 50.0
model = psfield.PsfModel.from_telescope(
    "survey-2m", field_shape=shape, stamp_size=32, oversampling=4, interpolation="natural-neighbour"
)
plan = model.plan(shape, tolerance=1e-4)

rng = np.random.default_rng(11)
truth = {
    "x": rng.uniform(0, 1023, count),
    "y": rng.uniform(0, 1023, count),
    "flux": 2000 * rng.uniform(0.002, 1, count) ** -0.7,
}
frame = rng.poisson(plan.simulate(catalog=truth) + sky)

# %%
# 2. The fit
# ----------
#
# A detection would give positions right to some tenths of a pixel, and fluxes to some tens of per
# cent. These are the start. The likelihood of the frame is that of Poisson's distribution: with the
# expected electrons ``m`` and those of the frame ``d``, ``-ln L`` is the sum of ``m - d ln m``. Its
# derivative with respect to ``m`` is ``1 - d / m``. This is the image that ``source_gradients``
# takes.
#
# L-BFGS is fast if a step of 1 changes each parameter by about its error. An isolated star of flux
# ``f`` has an error of about ``sqrt(f + 20 sky)``, because its light covers 20 pixels. That of its
# position is the part of the PSF's width that corresponds to it.

start = {
    "x": truth["x"] + rng.normal(0, 0.2, count),
    "y": truth["y"] + rng.normal(0, 0.2, count),
    "flux": truth["flux"] * rng.uniform(0.7, 1.3, count),
}
flux_step = np.sqrt(start["flux"] + 20 * sky)
position_step = 1.3 * flux_step / start["flux"]
steps = {"x": position_step, "y": position_step, "flux": flux_step}


def catalog_of(z):
    """Return the catalogue whose parameters are so many steps from the start."""
    parts = zip(start, np.split(z, len(start)), strict=True)
    return {name: start[name] + steps[name] * part for name, part in parts}


def loss(z):
    """Return -ln L of the frame, and its derivatives."""
    catalog = catalog_of(z)
    expected = plan.simulate(catalog=catalog).astype(float) + sky
    if expected.min() <= 0:
        return np.inf, np.zeros_like(z)
    slopes = plan.source_gradients(catalog, 1 - frame / expected)
    value = np.sum(expected - frame * np.log(expected))
    return value, np.concatenate([slopes[name] * steps[name] for name in start])


begin = time.perf_counter()
options = {"maxiter": 50, "maxcor": 20}
found = minimize(loss, np.zeros(3 * count), jac=True, method="L-BFGS-B", options=options)
fitted = catalog_of(found.x)
print(f"{found.nfev} evaluations in {time.perf_counter() - begin:.0f} s: {found.message}")

# %%
# The residual of the start and of the result, in units of the noise. For a good fit, the sum of its
# squares is the number of pixels less the number of parameters.


def residual_of(catalog):
    expected = plan.simulate(catalog=catalog) + sky
    return (frame - expected) / np.sqrt(expected)


residuals = {"start": residual_of(start), "fit": residual_of(fitted)}
freedom = frame.size - 3 * count
for name, residual in residuals.items():
    chi_square = np.sum(residual**2) / freedom
    print(f"{name}: chi-square per degree of freedom {chi_square:.4f}")
assert abs(chi_square - 1) < 0.01

fig, axes = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
part = np.s_[400:500, 400:500]
look = {"origin": "lower", "extent": (399.5, 499.5, 399.5, 499.5)}
shown = axes[0].imshow(frame[part], norm=AsinhNorm(100, sky, 3000), cmap="gray_r", **look)
axes[0].set_title("frame [electrons]")
fig.colorbar(shown, shrink=0.8)
for ax, (name, residual) in zip(axes[1:], residuals.items(), strict=True):
    shown = ax.imshow(residual[part], vmin=-5, vmax=5, cmap="RdBu", **look)
    ax.set_title(f"{name}: residual [sigma]")
fig.colorbar(shown, shrink=0.8)
for ax in axes:
    ax.set(xlabel="x [pixel]", ylabel="y [pixel]")
plt.show()

# %%
# 3. The bound
# ------------
#
# No unbiased fit has smaller errors than the bound of Cramer and Rao. It is the inverse of Fisher's
# matrix: with the derivatives ``J`` of the pixels with respect to all parameters, and the expected
# electrons ``m``, ``J^T (J / m)``. Far stars do not matter, so the matrix is computed for parts of
# the frame. The bound is taken from the stars in the middle of each part.

half, margin = 12, 30
expected = plan.simulate(catalog=truth) + sky


def stamps(x, y):
    return model.evaluate(x, y, pixels="frame", size=2 * half + 1, sub_pixel=True)


def bounds(x0, y0, side=120):
    """Return the numbers of the stars in the middle of a part, and their bounds (x, y, flux)."""
    inside = [(truth[axis] > at) & (truth[axis] < at + side) for axis, at in (("x", x0), ("y", y0))]
    stars = np.flatnonzero(inside[0] & inside[1])
    x, y, flux = (truth[name][stars] for name in ("x", "y", "flux"))
    column, row = np.floor(x + 0.5).astype(int), np.floor(y + 0.5).astype(int)
    # Differences that stay in the pixel of the star.
    step_x, step_y = np.where(x > column, -1e-3, 1e-3), np.where(y > row, -1e-3, 1e-3)
    psf = stamps(x, y)
    slopes = [
        (stamps(x + step_x, y) - psf) * (flux / step_x)[:, None, None],
        (stamps(x, y + step_y) - psf) * (flux / step_y)[:, None, None],
        psf,
    ]
    width = side + 2 * half + 1
    jacobian = np.zeros((3, len(stars), width, width))
    for star, (i, j) in enumerate(zip(column - x0, row - y0, strict=True)):
        window = np.s_[j : j + 2 * half + 1, i : i + 2 * half + 1]
        for parameter, slope in enumerate(slopes):
            jacobian[parameter, star][window] = slope[star]
    variance = expected[y0 - half : y0 - half + width, x0 - half : x0 - half + width]
    jacobian = jacobian.reshape(3 * len(stars), -1)
    covariance = np.linalg.inv((jacobian / variance.ravel()) @ jacobian.T)
    is_middle = [
        (truth[axis][stars] > at + margin) & (truth[axis][stars] < at + side - margin)
        for axis, at in (("x", x0), ("y", y0))
    ]
    middle = is_middle[0] & is_middle[1]
    errors = np.sqrt(np.diag(covariance)).reshape(3, -1)
    return stars[middle], errors[:, middle]


parts = [bounds(x0, y0) for y0 in range(60, 900, 200) for x0 in range(60, 900, 200)]
stars = np.concatenate([numbers for numbers, _ in parts])
bound = dict(zip(("x", "y", "flux"), np.concatenate([b for _, b in parts], axis=1), strict=True))
pulls = {name: (fitted[name] - truth[name])[stars] / bound[name] for name in bound}
for name, pull in pulls.items():
    ratio = np.sqrt(np.mean(pull**2))
    print(f"{name}: r.m.s. error / bound {ratio:.3f} of {pull.size} stars")
    assert ratio < 1.1

fig, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
normal = np.linspace(-4, 4, 200)
axes[0].hist(list(pulls.values()), np.linspace(-4, 4, 33), density=True, label=list(pulls))
axes[0].plot(normal, np.exp(-(normal**2) / 2) / np.sqrt(2 * np.pi), "k", label="Gaussian")
axes[0].set(xlabel="error / bound", ylabel="density of stars")
axes[0].legend()
axes[1].loglog(truth["flux"][stars], bound["x"], ".", ms=3, label="bound")
axes[1].loglog(
    truth["flux"][stars], np.abs(fitted["x"] - truth["x"])[stars], ".", ms=3, label="error"
)
axes[1].set(xlabel="flux [electrons]", ylabel="position along x [pixel]", ylim=(1e-4, 3))
axes[1].legend()
plt.show()

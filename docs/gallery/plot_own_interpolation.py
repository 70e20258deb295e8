"""
An interpolation or a basis of your own
=======================================

Any smooth interpolation serves: an object with ``fit`` and ``predict``, as in scikit-learn, or a
function of positions and coefficients, such as SciPy's ``RBFInterpolator``. psfield stores it as a
table, so a model can be saved, and images take no longer than with kriging, the built-in method. A
basis may be any stamps, or a decomposition of scikit-learn.
"""

import timeit
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from scipy.interpolate import RBFInterpolator
from sklearn.decomposition import NMF, FastICA
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF

import psfield

shape = (512, 768)
truth = psfield.PsfModel.from_telescope("survey-2m", field_shape=shape, samples=(13, 17))
rng = np.random.default_rng(4)
corners = [(0, 0), (767, 0), (0, 511), (767, 511)]
positions = np.concatenate([corners, rng.uniform(0, 1, (96, 2)) * (767, 511)])
samples = truth.evaluate(*positions.T)
x, y = rng.uniform(0, 1, (2, 200)) * [[767], [511]]
exact = truth.evaluate(x, y)
sky = rng.exponential(1.0, shape)


def quintic(positions, values):
    """Fit a polynomial of degree 5 in x and y by least squares."""

    def terms(at):
        x, y = (at / 400 - 1).T
        return np.stack([x**i * y**j for i in range(6) for j in range(6 - i)], axis=1)

    solution = np.linalg.lstsq(terms(positions), values, rcond=None)[0]
    return lambda at: terms(at) @ solution


choices = {
    "quintic (a function)": {"interpolation": quintic},
    "RBFInterpolator": {"interpolation": RBFInterpolator},
    "GaussianProcessRegressor": {
        "interpolation": GaussianProcessRegressor(RBF(250.0), alpha=1e-10, optimizer=None)
    },
    "kriging (built in)": {"interpolation": "kriging"},
    "kriging, basis FastICA(20)": {
        "interpolation": "kriging",
        "basis": FastICA(20, random_state=0),
    },
    "kriging, basis NMF(12)": {
        "interpolation": "kriging",
        "basis": NMF(12, init="nndsvda", max_iter=2000, tol=1e-3),
    },
}

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
for name, own in choices.items():
    model = psfield.PsfModel.from_samples(
        samples, positions, field_shape=shape, oversampling=truth.oversampling, noise=0, **own
    )
    left_out = model.fit_report().leave_one_out
    error = np.linalg.norm(model.evaluate(x, y) - exact, axis=(1, 2))
    error = np.median(error / np.linalg.norm(exact, axis=(1, 2)))
    plan = model.plan(shape, tolerance=1e-4, tolerance_on="l2")
    seconds = min(timeit.repeat(partial(plan.simulate, sky), number=1, repeat=5))
    label = (name, f"{left_out.folds or len(samples)} folds")
    left.plot(left_out.median, "\n".join(label), "o", color="C0")
    left.plot(error, "\n".join(label), "s", color="C1")
    right.plot(1e3 * seconds, "\n".join(label), "D", color="C2")

left.plot([], [], "o", color="C0", label="predicted: parts of the samples from the others")
left.plot([], [], "s", color="C1", label="true, at 200 other positions")
left.set(xscale="log", xlabel="relative L2 error of the PSF, median")
right.set(xlim=(0, None), xlabel="time of an image (ms)")
for ax in (left, right):
    ax.grid(alpha=0.4)
figure.legend(loc="outside upper center", ncols=2)
plt.show()

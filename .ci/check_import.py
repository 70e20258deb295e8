"""Checks that the package does its work where only NumPy is installed."""

import importlib.metadata
import sys

import numpy as np

import psfield

installed = {package.metadata["Name"].lower() for package in importlib.metadata.distributions()} - {"pip", "setuptools"}
assert installed == {"numpy", "psfield"}, installed
model = psfield.PsfModel.from_samples(np.ones((1, 3, 3)) / 9, [(0, 0)])
scene = np.zeros((20, 30))
scene[10, 15] = 9.0
image = model.plan(scene.shape, 0.0).simulate(scene, {"x": [5.0], "y": [5.0], "flux": [18.0]})
assert np.allclose(image[9:12, 14:17], 1.0) and np.allclose(image[4:7, 4:7], 2.0) and np.isclose(image.sum(), 27.0)
y, x = np.mgrid[-7:8, -7:8]
assert np.isclose(psfield.metrics.fit_gaussian(np.exp(-(x**2 + y**2) / 8)).fwhm, 2 * 2.3548, rtol=1e-4)
assert psfield.detector.Detector(sky_e=3.0).expose(image, 1).counts.min() >= 2.9
assert not {"astropy", "scipy", "dask", "matplotlib"} & set(sys.modules)
print(f"psfield {psfield.__version__} with NumPy {np.__version__} alone")

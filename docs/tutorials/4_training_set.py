"""
A training set
==============

A network that removes the blur of a telescope needs many pairs of a sharp frame and its image. This
tutorial makes 400 pairs of 64 x 64 pixels with stars and galaxies. The PSF changes over each frame
and from frame to frame, and the images have the noise of a detector.

It needs NumPy and matplotlib.
"""

import os
import shutil
import tempfile
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import AsinhNorm
from numpy.lib.format import open_memmap

import psfield
from psfield.detector import Detector
from psfield.metrics import measure

pairs, shape, seed = 400, (64, 64), 2024

# %%
# 1. The blur
# -----------
#
# The whole field of the survey telescope, squeezed into a small frame. Two stamp pixels per frame
# pixel are needed for galaxies.

model = psfield.PsfModel.from_telescope(
    "survey-2m", field_shape=shape, samples=(5, 5), stamp_size=32, oversampling=4
)
plan = model.plan(shape, tolerance=1e-3, device="cpu")

# %%
# The PSF of real frames changes with focus and seeing. Here the coefficients of the model are
# multiplied by a random factor for each frame: 0 would be the mean PSF everywhere, and 1 is the
# telescope as designed. ``with_psf`` makes the plan for another PSF without choosing the tiles
# again.


def plan_of(factor):
    """Return the plan for a PSF whose variation over the field is scaled."""
    scaled = psfield.PsfModel.from_basis(
        model.mean,
        model.components,
        factor * model.coefficients,
        model.positions,
        field_shape=shape,
        oversampling=4,
    )
    return plan.with_psf(scaled)


factors = np.linspace(0.6, 1.2, 13)
plans = [plan_of(factor) for factor in factors]

# %%
# 2. The sharp frame
# ------------------
#
# The truth is the flux in each pixel: stars in single pixels, and galaxies with the response of a
# pixel but no other blur. A PSF that is a point gives nearly this. Its stamp cannot hold the sharp
# edges of a pixel, so they are softened a little. In the bright centre of a small galaxy, a pixel
# is wrong by up to 2 % of the peak. If that matters, draw the galaxies on a frame that is 8 times
# finer (``8 * x + 3.5``, ``8 * y + 3.5`` and ``8 * re``), and sum 8 x 8 pixels.

# psfield warns of these edges.
warnings.filterwarnings("ignore", "the PSF stamps are too coarse")
point = np.zeros((17, 17))
point[8, 8] = 8**2
pixel = psfield.PsfModel.from_samples(point, (0, 0), oversampling=8, pixel_response_included=False)
drawing = pixel.plan(shape, device="cpu")


def sharp_frame(rng):
    """Draw 5 galaxies and 10 stars."""
    galaxies = {
        "x": rng.uniform(0, shape[1] - 1, 5),
        "y": rng.uniform(0, shape[0] - 1, 5),
        "flux": 10 ** rng.uniform(3, 4.5, 5),
        "re": rng.uniform(2, 6, 5),
        "n": rng.uniform(0.8, 4, 5),
        "q": rng.uniform(0.3, 1, 5),
        "angle": rng.uniform(0, 180, 5),
    }
    frame = drawing.simulate(catalog=galaxies)
    np.add.at(frame, tuple(rng.integers(0, 64, (2, 10))), 10 ** rng.uniform(2, 4, 10))
    return frame


# %%
# 3. All pairs
# ------------
#
# Each pair has a random generator of its own, so pair 17 is the same in every run, on any number of
# threads. Frames this small are too little work for all cores, so threads of Python make several at
# the same time. psfield releases the interpreter while it works. The arrays are files, which may be
# larger than the memory.

ccd = Detector(photon_noise=True, sky_e=50.0, read_noise_e=4.0)
folder = Path(tempfile.mkdtemp())
sharp = open_memmap(folder / "sharp.npy", "w+", np.float32, (pairs, *shape))
blurred = open_memmap(folder / "blurred.npy", "w+", np.float32, (pairs, *shape))


def make(index):
    """Make one pair."""
    rng = np.random.default_rng([seed, index])
    frame = sharp_frame(rng)
    image = plans[rng.integers(len(plans))].simulate(frame)
    return frame, ccd.expose(image, seed=index).counts - 50.0


def write(index):
    """Make one pair and write it."""
    sharp[index], blurred[index] = make(index)


began = time.perf_counter()
with ThreadPoolExecutor(os.cpu_count()) as pool:
    list(pool.map(write, range(pairs)))
seconds = time.perf_counter() - began
print(f"{pairs} pairs in {seconds:.2f} s: {pairs / seconds:.0f} per second")

# %%
# Four pairs. The stars in the corners are wider than those in the middle.

norm = AsinhNorm(linear_width=30, vmin=-20, vmax=1000)
figure, axes = plt.subplots(2, 4, figsize=(10, 5.2), layout="constrained")
for column in range(4):
    for row, (name, frames) in enumerate([("sharp", sharp), ("blurred", blurred)]):
        ax = axes[row, column]
        shown = ax.imshow(frames[column], origin="lower", cmap="gray", norm=norm)
        ax.set(xticks=[], yticks=[], title=f"pair {column}, {name}")
figure.colorbar(shown, ax=axes, label="electrons per pixel")
plt.show()

# %%
# 4. Checks
# ---------
#
# A pair can be made again alone. The light of the frames is kept, except beyond the edges.

again = make(17)
assert np.array_equal(again[0], sharp[17])
assert np.array_equal(again[1].astype(np.float32), blurred[17])
kept = blurred.sum(dtype=float) / sharp.sum(dtype=float)
print(f"light that stays in the frames: {100 * kept:.1f} %")
assert 0.9 < kept < 1

# %%
# The width of the PSF in the worst corner changes from frame to frame:

widths = [
    measure(some.model.evaluate(0, 63))["fwhm_px"][0] / some.model.oversampling for some in plans
]
print(f"FWHM from {min(widths):.1f} to {max(widths):.1f} pixels")
assert max(widths) > 1.2 * min(widths)
shutil.rmtree(folder)

# %%
# For ``torch.utils.data.DataLoader``, put ``make`` into the ``__getitem__`` of a data set: pairs
# are then made on request and need no files. The page on Python has such a class. Dask makes sets
# that are larger than one machine.

"""The peers for images. The constructor of each class is its plan.

Each has `name`, `run() -> image`, `describe()` and `own(reference)`. The latter returns the values
of a double-precision sum over the method's own model at the reference's pixels. An image must agree
with them to rounding. Its difference from the true field is the model error of the method.
"""

import time

import numpy as np
import scipy.fft
from scipy.signal import fftconvolve

from basis import Modes, TiledBasis, WholeBasis
from overlap_add import MEMORY, OverlapAdd
from tiling import Tiling
from transforms import lengths


class Single:
    """One PSF for the whole frame, `scipy.signal.fftconvolve`: the unit of the ratios."""

    name = "single"

    def __init__(self, inputs, pool):
        self.inputs, self.threads = inputs, pool.threads
        middle = (inputs.size - 1) / 2
        self.psf = inputs.psf_at([middle], [middle])[0]
        # `mode="same"` centres the stamp at index (n - 1) / 2. Zeros at the end make it n / 2.
        self.kernel = np.pad(self.psf, [(0, 1 - n % 2) for n in self.psf.shape])

    def run(self):
        with scipy.fft.set_workers(self.threads):
            return fftconvolve(self.inputs.scene, self.kernel, mode="same")

    def describe(self):
        return "scipy.signal.fftconvolve"

    def own(self, reference):
        return reference.direct(np.broadcast_to(self.psf, self.inputs.samples.shape))


class Cells:
    """Exact: tiles of whole cells of the grid, or of parts of one.

    Each tile needs one weighted forward transform for each sample around, and one inverse. The plan
    ranks sizes of tiles by the number of operations and times the best on a part of the frame.
    """

    name = "cells"
    TIMED = 5
    CACHES = (1e6, 2e6)
    """Most bytes for a batch of tiles."""

    def __init__(self, inputs, pool):
        stamp = inputs.samples.shape[2]
        candidates = {}
        for together, split in [(t, 1) for t in range(1, 9)] + [(1, s) for s in range(2, 17)]:
            ty, tx = (Tiling.cells(axis, together, split) for axis in (inputs.y, inputs.x))
            if min(ty.side, tx.side) < 8 or max(ty.side, tx.side) > 600:
                continue
            for length in lengths(max(ty.side, tx.side) + stamp - 1):
                if len(inputs.stamps) * length * (length // 2 + 1) * 8 <= MEMORY:
                    candidates[ty.side, length] = (_operations(ty, tx, length), ty, tx, length)
        if not candidates:
            raise MemoryError("the spectra of the samples exceed the memory for every size of tile")
        ranked = sorted(candidates.values(), key=lambda c: c[0])[: self.TIMED]
        choices = [(*sizes, cache) for _, *sizes in ranked for cache in self.CACHES]
        seconds = [
            _seconds_per_row(OverlapAdd(inputs, inputs.samples, ty, tx, length, pool, cache))
            for ty, tx, length, cache in choices
        ]
        ty, tx, length, cache = choices[int(np.argmin(seconds))]
        self.plan = OverlapAdd(
            inputs, inputs.samples, ty, tx, length, pool, cache, effort="FFTW_PATIENT"
        )
        self.run, self.describe = self.plan.run, self.plan.describe

    def own(self, reference):
        return reference.truth


def _operations(ty, tx, length):
    """Operations per frame, up to a factor: transforms of rows and columns, and products."""
    columns = length / 2 + 1
    components = ty.nodes * tx.nodes
    one = length * np.log2(length)
    rows = (tx.nodes * ty.side + length) / 2
    tile = one * (rows + columns * (components + 1)) + 2 * components * length * columns
    return len(ty) * len(tx) * tile


def _seconds_per_row(plan, target=0.15):
    """Processor time per row of pixels: the best of three turns of tiles spread over the frame.

    Other programs disturb it less than wall-clock time.
    """
    count = len(plan.tile_y)
    rows = min(count, plan.pool.threads)
    best = np.inf
    for turn in range(4):
        chosen = set(np.linspace(0, count - 1, rows).round().astype(int).tolist())
        start = time.process_time()
        plan.run(chosen)
        seconds = time.process_time() - start
        if turn == 0:
            # The first turn warms up and shows how many rows take `target` seconds.
            rows = min(count, max(rows, int(rows * target / seconds)))
            continue
        best = min(best, seconds / sum(plan.tile_y.length[row] for row in chosen))
    return best


class Hat:
    """Exact: each sample convolves the light under its own hat function."""

    name = "hat"

    def __init__(self, inputs, pool):
        ty, tx = (Tiling.hats(axis) for axis in (inputs.y, inputs.x))
        length = lengths(max(ty.side, tx.side) + inputs.samples.shape[2] - 1)[0]
        self.plan = OverlapAdd(inputs, inputs.samples, ty, tx, length, pool)
        self.run, self.describe = self.plan.run, self.plan.describe

    def own(self, reference):
        return reference.truth


class Patch:
    """One PSF for each square patch: the PSF of its middle."""

    def __init__(self, inputs, pool, side):
        self.name, self.side, self.size = f"patch-{side}", side, inputs.size
        tiling = Tiling.patches(inputs.size, side)
        middle = tiling.start + (tiling.length - 1) / 2
        y, x = (a.ravel() for a in np.meshgrid(middle, middle, indexing="ij"))
        kernels = inputs.psf_at(y, x).reshape(len(tiling), len(tiling), *inputs.samples.shape[2:])
        length = lengths(side + inputs.samples.shape[2] - 1)[0]
        self.plan = OverlapAdd(inputs, kernels, tiling, tiling, length, pool)
        self.run, self.describe = self.plan.run, self.plan.describe

    def own(self, reference):
        def snap(positions):
            first = positions // self.side * self.side
            return (first + np.minimum(first + self.side, self.size) - 1) / 2

        return reference.direct(snap=snap)


class Basis:
    """The paper's method: `F = sum_k (a_k f) * B_k` with 100 modes of the mean-centred samples.

    It transforms the whole frame, or tiles of it.
    """

    def __init__(self, inputs, pool, tiled):
        self.name = "basis-tiled" if tiled else "basis"
        self.modes = Modes.of(inputs)
        self.plan = (TiledBasis if tiled else WholeBasis)(inputs, self.modes, pool)
        self.run, self.describe = self.plan.run, self.plan.describe

    def own(self, reference):
        return reference.direct(self.modes.samples())


METHODS = {
    "single": Single,
    "cells": Cells,
    "hat": Hat,
    "patch-64": lambda inputs, pool: Patch(inputs, pool, 64),
    "patch-256": lambda inputs, pool: Patch(inputs, pool, 256),
    "basis-tiled": lambda inputs, pool: Basis(inputs, pool, True),
    "basis": lambda inputs, pool: Basis(inputs, pool, False),
}

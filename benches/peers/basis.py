"""The method of the paper: a global basis, with one convolution per mode."""

from functools import cache

import numpy as np
import pyfftw
import scipy.fft

import loops
from overlap_add import MEMORY
from pool import RowLocks
from transforms import Forward, Inverse, as_reals, kernel_spectra


class Modes:
    """Mean and principal components of the samples, and the coefficients of each sample."""

    def __init__(self, inputs, count):
        flat = inputs.stamps.reshape(len(inputs.stamps), -1).astype(np.float64)
        self.shape = inputs.samples.shape
        mean = flat.mean(axis=0)
        centred = flat - mean
        count = min(count, len(flat) - 1, flat.shape[1])
        components = _leading(centred, count)
        coefficients = centred @ components.T
        # The mean goes first, as a mode whose coefficient is 1 everywhere.
        stamps = np.vstack([mean, components]).reshape(-1, *self.shape[2:])
        grid = np.vstack([np.ones(len(flat)), coefficients.T]).reshape(-1, *self.shape[:2])
        self.stamps = stamps.astype(np.float32)
        """`[1 + K, v, u]`, f32."""
        self.grid = grid.astype(np.float32)
        """Coefficients at the samples, `[1 + K, sample y, sample x]`, f32."""

    @classmethod
    @cache
    def of(cls, inputs, count=100):
        """The modes, computed once for all methods with these inputs."""
        return cls(inputs, count)

    def samples(self):
        """The samples as reconstructed from the modes, f64."""
        grid = self.grid.astype(np.float64).reshape(len(self.grid), -1)
        stamps = self.stamps.astype(np.float64).reshape(len(self.grid), -1)
        return (grid.T @ stamps).reshape(self.shape)


def _leading(rows, count, extra=28, turns=4):
    """The first right singular vectors of a matrix, `[count, column]`.

    By subspace iteration (Halko et al. 2011, algorithm 4.4).
    """
    size = min(count + extra, *rows.shape)
    basis = np.random.default_rng(0).standard_normal((rows.shape[1], size))
    for _ in range(turns):
        basis = np.linalg.qr(rows.T @ np.linalg.qr(rows @ basis)[0])[0]
    within = np.linalg.svd(rows @ basis, full_matrices=False)[2]
    return (within @ basis.T)[:count]


class WholeBasis:
    """Transforms each mode's light over the whole frame, sums the spectra, transforms back once."""

    def __init__(self, inputs, modes, pool):
        self.inputs, self.modes, self.pool = inputs, modes, pool
        stamp = modes.stamps.shape[1:]
        self.shape = tuple(scipy.fft.next_fast_len(inputs.size + n - 1, real=True) for n in stamp)
        self.half = self.shape[1] // 2 + 1
        self.scale = np.float32(1)
        self.light = np.zeros(self.shape, dtype=np.float32)
        self.total = np.empty((self.shape[0], self.half), dtype=np.complex64)
        bytes_all = len(modes.stamps) * self.total.nbytes
        self.spectra = None
        if bytes_all <= MEMORY:
            self.spectra = np.stack([self._spectrum(k) for k in range(len(modes.stamps))])
        self.bands = np.array_split(np.arange(self.shape[0]), 4 * pool.threads)

    def _spectrum(self, k):
        lines = scipy.fft.rfft(self.modes.stamps[k], self.shape[1], axis=1)
        return scipy.fft.fft(lines, self.shape[0], axis=0, workers=self.pool.threads)

    def run(self):
        y, x = self.inputs.y, self.inputs.x
        size = self.inputs.size
        for k in range(len(self.modes.stamps)):
            grid = self.modes.grid[k : k + 1]

            def weigh(_, band, grid=grid):
                first, last = band[0], min(band[-1] + 1, size)
                if first < last:
                    out = self.light[None, first:last]
                    loops.weigh_bilinear(
                        self.inputs.scene,
                        first,
                        last - first,
                        0,
                        size,
                        grid,
                        y.cell,
                        _f32(y.part),
                        x.cell,
                        _f32(x.part),
                        out,
                    )

            self.pool.each(self.bands, weigh)
            light = scipy.fft.rfft2(self.light, workers=self.pool.threads)
            spectrum = self._spectrum(k) if self.spectra is None else self.spectra[k]

            def multiply(_, band, light=light, spectrum=spectrum, keep=k > 0):
                rows = slice(band[0], band[-1] + 1)
                index = np.zeros((1, 1), dtype=np.int64)
                one, two, out = (as_reals(a[rows][None]) for a in (light, spectrum, self.total))
                loops.multiply_sum(one[None], two, index, out, keep)

            self.pool.each(self.bands, multiply)
        image = scipy.fft.irfft2(
            self.total, s=self.shape, overwrite_x=True, workers=self.pool.threads
        )
        cy, cx = (n // 2 for n in self.modes.stamps.shape[1:])
        return image[cy : cy + size, cx : cx + size]

    def describe(self):
        where = "made in the run" if self.spectra is None else "planned"
        return f"{len(self.modes.stamps) - 1} modes, transform {self.shape[0]}, spectra {where}"


class TiledBasis:
    """The method in tiles. Each tile uses a few modes at a time, so that they stay in the cache."""

    SIDE = 256
    TOGETHER = 4

    def __init__(self, inputs, modes, pool):
        self.inputs, self.modes, self.pool = inputs, modes, pool
        self.stamp = modes.stamps.shape[1:]
        side = min(self.SIDE, inputs.size)
        self.length = scipy.fft.next_fast_len(side + max(self.stamp) - 1, real=True)
        self.spectra = as_reals(kernel_spectra(modes.stamps, self.length))
        self.image = np.zeros_like(inputs.scene)
        self.locks = RowLocks(inputs.size)
        self.parts = _f32(inputs.y.part), _f32(inputs.x.part)
        starts = range(0, inputs.size, side)
        self.side = side
        self.jobs = [(y, x) for y in starts for x in starts]
        self.workers = [self._buffers() for _ in range(pool.threads)]

    def _buffers(self):
        forward = Forward(self.TOGETHER, self.side, self.length)
        inverse = Inverse(1, self.side + self.stamp[0] - 1, self.length)
        total = pyfftw.zeros_aligned(inverse.spectrum.shape, "complex64")
        return forward, inverse, total

    def run(self):
        self.image.fill(0)
        self.pool.each(self.jobs, self._tile)
        return self.image

    def _tile(self, thread, job):
        forward, inverse, total = self.workers[thread]
        y0, x0 = job
        size = self.inputs.size
        rows, columns = min(self.side, size - y0), min(self.side, size - x0)
        y, x = self.inputs.y, self.inputs.x
        forward.real[:] = 0
        count = len(self.modes.stamps)
        for first in range(0, count, self.TOGETHER):
            last = min(first + self.TOGETHER, count)
            grid = self.modes.grid[first:last]
            loops.weigh_bilinear(
                self.inputs.scene,
                y0,
                rows,
                x0,
                columns,
                grid,
                y.cell,
                self.parts[0],
                x.cell,
                self.parts[1],
                forward.real,
            )
            forward.transform()
            light = as_reals(forward.spectrum)[None, : last - first]
            index = np.arange(first, last)[None]
            loops.multiply_sum(light, self.spectra, index, as_reals(total), first > 0)
        inverse.spectrum[:] = total
        inverse.transform()
        top, left = y0 - self.stamp[0] // 2, np.array([x0 - self.stamp[1] // 2])
        with self.locks.hold(top, top + rows + self.stamp[0] - 1):
            loops.add(
                inverse.real,
                top,
                rows + self.stamp[0] - 1,
                left,
                np.array([columns + self.stamp[1] - 1]),
                self.image,
            )

    def describe(self):
        return f"{len(self.modes.stamps) - 1} modes, tile {self.side}, transform {self.length}"


def _f32(values):
    return values.astype(np.float32)

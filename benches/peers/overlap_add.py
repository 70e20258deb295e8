"""Overlap-add in tiles, `F = sum_tiles sum_c h_c * (w_c f)`.

The weighted light of a tile is transformed and multiplied by the spectra of the tile's kernels.
The sum is transformed back once and added to the image. Cells of the grid (`c` runs over the
samples around), hat functions and patches (one `c`) differ only in the tiling.
"""

from dataclasses import dataclass

import numpy as np

import loops
from pool import RowLocks
from transforms import EFFORT, Forward, Inverse, Rows, as_reals, kernel_spectra

MEMORY = 1.5e9
"""Most bytes for the spectra of the kernels. Above it, each tile makes its spectra again."""
CACHE = 1.0e6
"""Most bytes of working memory for a batch of tiles, the size of the second-level cache."""


class OverlapAdd:
    """A plan: the tiling, the kernels' spectra, and each thread's buffers and transforms."""

    def __init__(self, inputs, kernels, tile_y, tile_x, length, pool, cache=CACHE, effort=EFFORT):
        """Plans for kernels `[index y, index x, v, u]`.

        `length` of the transform is at least the tile's side + the stamp's - 1. `cache` is the most
        bytes for a batch of tiles, `effort` that of FFTW in planning.
        """
        self.scene = inputs.scene
        self.stamp = kernels.shape[2:]
        self.tile_y, self.tile_x, self.length, self.pool = tile_y, tile_x, length, pool
        self.kernels_x = kernels.shape[1]
        self.stamps = kernels.reshape(-1, *self.stamp)
        self.half = length // 2 + 1
        self.components = tile_y.nodes * tile_x.nodes
        fits = len(self.stamps) * length * self.half * 8 <= MEMORY
        self.spectra = as_reals(kernel_spectra(self.stamps, length)) if fits else None
        if not fits and self.components > 1:
            raise MemoryError(
                f"spectra of {len(self.stamps)} kernels of length {length} take more than {MEMORY:.1e} bytes"
            )
        one = (2 * self.components + 1) * length * self.half * 8
        self.batch = int(np.clip(cache // one, 1, len(tile_x))) if fits else 1
        self.out_rows = tile_y.side + self.stamp[0] - 1
        self.workers = [_Buffers(self, effort) for _ in range(pool.threads)]
        self.image = np.zeros_like(self.scene)
        self.locks = RowLocks(len(self.scene))
        self.jobs = [
            self._job(row, first)
            for row in range(len(tile_y))
            for first in range(0, len(tile_x), self.batch)
        ]

    def _job(self, row, first):
        ty, tx, (height, width) = self.tile_y, self.tile_x, self.stamp
        last = min(first + self.batch, len(tx))
        # A short last batch of a row is filled up with the tiles before it. These are not added.
        begin = max(0, last - self.batch)
        tiles = slice(begin, last)
        index = (ty.kernel[row][:, None] * self.kernels_x + tx.kernel[tiles][:, None, :]).reshape(
            last - begin, -1
        )
        light = (
            ty.start[row],
            ty.length[row],
            tx.start[tiles],
            tx.length[tiles],
            ty.weight[row],
            tx.weight[tiles],
            index,
            first - begin,
        )
        top, left = ty.start[row] - height // 2, tx.start[first:last] - width // 2
        return _Job(
            row, light, (top, ty.length[row] + height - 1, left, tx.length[first:last] + width - 1)
        )

    def run(self, rows=None):
        """The image, in a buffer that the next run overwrites. `rows` selects rows of tiles."""
        self.image.fill(0)
        jobs = self.jobs if rows is None else [job for job in self.jobs if job.row in rows]
        self.pool.each(jobs, self._tiles)
        return self.image

    def _tiles(self, thread, job):
        """Convolves a batch of neighbouring tiles of a row."""
        work = self.workers[thread]
        y0, height, x0, width, wy, wx, index, skip = job.light
        if work.rows is None:
            loops.weigh(self.scene, y0, height, x0, width, wy[0], wx, work.real)
            work.forward.transform()
        else:
            loops.weigh(self.scene, y0, height, x0, width, work.ones, wx, work.real)
            work.rows.transform()
            loops.spread(work.lines, wy, work.spread)
            work.forward.transform_columns()
        spectra = self.spectra
        if spectra is None:
            work.kernel.real[0, :, : self.stamp[1]] = self.stamps[index[0, 0]] * np.float32(
                1 / self.length**2
            )
            work.kernel.transform()
            spectra, index = as_reals(work.kernel.spectrum), np.zeros_like(index)
        loops.multiply_sum(work.light, spectra, index, work.product, False)
        work.inverse.transform()
        top, rows, left, columns = job.result
        with self.locks.hold(top, top + rows):
            loops.add(work.inverse.real[skip:], top, rows, left, columns, self.image)

    def describe(self):
        return f"tile {self.tile_y.side}, transform {self.length}, batch {self.batch}"


@dataclass(frozen=True)
class _Job:
    """Arguments of the loops for a batch of neighbouring tiles of a row.

    They are computed in the plan, since threads would wait for the interpreter.
    """

    row: int
    light: tuple
    """First row, rows, first columns, columns, weights along y and x, kernels, tiles to skip.

    Kernels are `[tile, component]`.
    """
    result: tuple
    """First row, rows, first columns and columns of the tiles to add."""


class _Buffers:
    """The buffers and transforms of one thread."""

    def __init__(self, plan, effort):
        batch, length, half = plan.batch, plan.length, plan.half
        side, ny, nx = plan.tile_y.side, plan.tile_y.nodes, plan.tile_x.nodes
        self.forward = Forward(batch * plan.components, side, length, effort)
        if ny == 1:
            self.rows = None
            self.real = self.forward.real.reshape(batch, nx, side, length)
        else:
            self.rows = Rows(batch * nx * side, length, effort)
            self.real = self.rows.real.reshape(batch, nx, side, length)
            self.lines = self.rows.lines.reshape(batch, nx, side, half)
            self.spread = self.forward.lines.reshape(batch, ny, nx, length, half)[:, :, :, :side]
        self.ones = np.ones(side, dtype=np.float32)
        self.light = as_reals(self.forward.spectrum).reshape(batch, plan.components, -1)
        self.inverse = Inverse(batch, plan.out_rows, length, effort)
        self.product = as_reals(self.inverse.spectrum)
        self.kernel = Forward(1, plan.stamp[0], length) if plan.spectra is None else None

"""Pieces of an axis of the frame and their weights: cells of the grid, hat functions, patches."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tiling:
    """Pieces of one axis. Each pair of a piece along y and a piece along x is a tile."""

    start: np.ndarray
    """First pixel of each piece, `[piece]`."""
    length: np.ndarray
    """Number of pixels of each piece."""
    kernel: np.ndarray
    """Indices of the kernels along this axis that a piece uses, `[piece, node]`."""
    weight: np.ndarray
    """Weight of each kernel at each pixel, `[piece, node, pixel]`, f32, zero beyond the piece."""

    @property
    def side(self):
        return self.weight.shape[2]

    @property
    def nodes(self):
        return self.weight.shape[1]

    def __len__(self):
        return len(self.start)

    @classmethod
    def _of(cls, pieces):
        """Makes a tiling from a list of (first, last, kernels, weights)."""
        side = max(last - first for first, last, _, _ in pieces)
        nodes = max(len(kernels) for _, _, kernels, _ in pieces)
        kernel = np.zeros((len(pieces), nodes), dtype=np.int64)
        weight = np.zeros((len(pieces), nodes, side), dtype=np.float32)
        for p, (first, last, kernels, weights) in enumerate(pieces):
            kernel[p, : len(kernels)] = kernels
            weight[p, : len(kernels), : last - first] = weights
        start = np.array([p[0] for p in pieces], dtype=np.int64)
        length = np.array([p[1] - p[0] for p in pieces], dtype=np.int64)
        return cls(start, length, kernel, weight)

    @classmethod
    def cells(cls, axis, together=1, split=1):
        """Exact: pieces of `together` neighbouring cells, or `split` parts of a cell."""
        pixels = len(axis.cell)
        bounds = np.searchsorted(axis.cell, np.arange(len(axis.nodes)))
        bounds[0], bounds[-1] = 0, pixels
        pieces = []
        for first_cell in range(0, len(bounds) - 1, together):
            last_cell = min(first_cell + together, len(bounds) - 1)
            cuts = np.linspace(bounds[first_cell], bounds[last_cell], split + 1).round().astype(int)
            count = last_cell - first_cell + 1
            kernels = np.arange(first_cell, last_cell + 1)
            for first, last in zip(cuts[:-1], cuts[1:]):
                if last > first:
                    pieces.append(
                        (first, last, kernels, axis.weights(first, last, first_cell, count))
                    )
        return cls._of(pieces)

    @classmethod
    def hats(cls, axis):
        """Exact: one piece per sample, the support of its hat function."""
        pixels = len(axis.cell)
        pieces = []
        for k in range(len(axis.nodes)):
            weights = axis.weights(0, pixels, k, 1)
            lit = np.flatnonzero(weights[0])
            if len(lit):
                first, last = lit[0], lit[-1] + 1
                pieces.append((first, last, [k], weights[:, first:last]))
        return cls._of(pieces)

    @classmethod
    def patches(cls, pixels, side):
        """Pieces of `side` pixels with one kernel each."""
        pieces = []
        for k, first in enumerate(range(0, pixels, side)):
            last = min(first + side, pixels)
            pieces.append((first, last, [k], np.ones((1, last - first), dtype=np.float32)))
        return cls._of(pieces)

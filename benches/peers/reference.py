"""The truth for every method: the plain sum `F(y) = sum_x f(x) h(y - x; x)` in double precision."""

import numpy as np


class Reference:
    """The pixels at which images are compared: random pixels of the frame, and its corners."""

    def __init__(self, inputs, pixels, seed):
        rng = np.random.default_rng(seed)
        last = inputs.size - 1
        corners = np.array([(0, 0), (0, last), (last, 0), (last, last)])
        self.pixels = np.vstack([rng.integers(0, inputs.size, size=(pixels, 2)), corners])
        self.inputs = inputs
        self.truth = self.direct()

    def direct(self, samples=None, snap=None):
        """The sum at each pixel, f64.

        `samples` replaces the PSFs. `snap` maps source positions (an integer array) to the
        positions whose PSF they get.
        """
        inputs = self.inputs
        samples = (inputs.samples if samples is None else samples).astype(np.float64)
        height, width = samples.shape[2:]
        v, u = (a.ravel() for a in np.indices((height, width)))
        values = np.zeros(len(self.pixels))
        for p, (py, px) in enumerate(self.pixels):
            y, x = py - (v - height // 2), px - (u - width // 2)
            lit = (y >= 0) & (y < inputs.size) & (x >= 0) & (x < inputs.size)
            y, x, vl, ul = y[lit], x[lit], v[lit], u[lit]
            sy, sx = (y, x) if snap is None else (snap(y), snap(x))
            cell_y, part_y = _fraction(inputs.y.nodes, sy)
            cell_x, part_x = _fraction(inputs.x.nodes, sx)
            psf = (
                (1 - part_y) * (1 - part_x) * samples[cell_y, cell_x, vl, ul]
                + (1 - part_y) * part_x * samples[cell_y, cell_x + 1, vl, ul]
                + part_y * (1 - part_x) * samples[cell_y + 1, cell_x, vl, ul]
                + part_y * part_x * samples[cell_y + 1, cell_x + 1, vl, ul]
            )
            values[p] = np.sum(inputs.scene[y, x].astype(np.float64) * psf)
        return values

    def error(self, image, values=None):
        """Relative L2 error of an image at the pixels, against the truth or `values`."""
        values = self.truth if values is None else values
        found = image[self.pixels[:, 0], self.pixels[:, 1]].astype(np.float64)
        return float(np.linalg.norm(found - values) / np.linalg.norm(values))


def exact_psf(inputs, samples, y, x):
    """The PSF at one position, `[v, u]`, in the precision of the samples."""
    (cell_y,), (part_y,) = _fraction(inputs.y.nodes, np.array([y]))
    (cell_x,), (part_x,) = _fraction(inputs.x.nodes, np.array([x]))
    upper = (1 - part_x) * samples[cell_y, cell_x] + part_x * samples[cell_y, cell_x + 1]
    lower = (1 - part_x) * samples[cell_y + 1, cell_x] + part_x * samples[cell_y + 1, cell_x + 1]
    return (1 - part_y) * upper + part_y * lower


def _fraction(nodes, positions):
    """Cell and fraction, implemented independently of the code that this module checks."""
    cell = np.zeros(len(positions), dtype=int)
    for k in range(1, len(nodes) - 1):
        cell[positions >= nodes[k]] = k
    return cell, (positions - nodes[cell]) / (nodes[cell + 1] - nodes[cell])

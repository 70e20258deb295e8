"""Compiled loops without the interpreter's lock. numpy would need several passes over memory.

Every function works in single precision on the given arrays and allocates nothing. Indices are
`[y, x]`.
"""

from numba import njit

_OPTIONS = {"nogil": True, "fastmath": True, "cache": True}


@njit(**_OPTIONS)
def weigh(scene, y0, rows, x0, columns, wy, wx, out):
    """`out[b, j, i, l] = scene[y0 + i, x0[b] + l] wy[i] wx[b, j, l]`, and 0 beyond the tile.

    Shapes: `x0`, `columns` `[b]`, `wy` `[side]`, `wx` `[b, nodes, side]`,
    `out` `[b, nodes, side, transform]`.
    """
    batch, nodes, side, width = out.shape
    for b in range(batch):
        start = x0[b]
        filled = columns[b]
        for j in range(nodes):
            for i in range(side):
                line = out[b, j, i]
                if i < rows:
                    factor = wy[i]
                    light = scene[y0 + i, start : start + filled]
                    weight = wx[b, j]
                    for l in range(filled):
                        line[l] = light[l] * weight[l] * factor
                    for l in range(filled, width):
                        line[l] = 0.0
                else:
                    for l in range(width):
                        line[l] = 0.0


@njit(**_OPTIONS)
def spread(lines, wy, out):
    """`out[b, k, j, i, :] = wy[k, i] lines[b, j, i, :]`.

    A weight along y commutes with the transform along x.
    """
    batch, nodes, side, width = lines.shape
    for b in range(batch):
        for k in range(wy.shape[0]):
            for j in range(nodes):
                for i in range(side):
                    factor = wy[k, i]
                    source = lines[b, j, i]
                    target = out[b, k, j, i]
                    for l in range(width):
                        target[l] = source[l] * factor


@njit(**_OPTIONS)
def multiply_sum(light, spectra, index, out, keep):
    """`out[b, k] = sum_c light[b, c, k] spectra[index[b, c], k]`, added to `out` if `keep`.

    Shapes: `light` `[b, components, 2 m]`, `spectra` `[kernels, 2 m]`, `out` `[b, 2 m]`, with
    alternating real and imaginary parts.
    """
    batch, components, length = light.shape
    block = 2048
    for b in range(batch):
        for first in range(0, length, block):
            last = min(first + block, length)
            half = (last - first) // 2
            total = out[b, first:last]
            if not keep:
                for k in range(last - first):
                    total[k] = 0.0
            for c in range(components):
                one = light[b, c, first:last]
                two = spectra[index[b, c], first:last]
                for k in range(half):
                    real, imaginary = one[2 * k], one[2 * k + 1]
                    total[2 * k] += real * two[2 * k] - imaginary * two[2 * k + 1]
                    total[2 * k + 1] += real * two[2 * k + 1] + imaginary * two[2 * k]


@njit(**_OPTIONS)
def add(patches, y0, rows, x0, columns, image):
    """Adds `patches[b, :rows, :columns[b]]` to the image, cut at the frame.

    The first pixel of a patch lies at `(y0, x0[b])`.
    """
    height, width = image.shape
    for b in range(patches.shape[0]):
        left = max(0, -x0[b])
        right = min(columns[b], width - x0[b])
        for i in range(max(0, -y0), min(rows, height - y0)):
            source = patches[b, i, left:right]
            target = image[y0 + i, x0[b] + left : x0[b] + right]
            for l in range(right - left):
                target[l] += source[l]


@njit(**_OPTIONS)
def weigh_bilinear(scene, y0, rows, x0, columns, grid, cell_y, part_y, cell_x, part_x, out):
    """`out[k, i, l] = scene[y0 + i, x0 + l] a_k(x0 + l, y0 + i)`, bilinear coefficients.

    Shapes: `grid` `[k, sample y, sample x]` holds the coefficients of the samples. `cell_y`,
    `part_y` `[frame y]` hold the sample before each row and the fraction of the way to the next,
    and likewise for x. Only the tile of `out` `[k, >= rows, >= columns]` is written.
    """
    for k in range(grid.shape[0]):
        for i in range(rows):
            y = y0 + i
            upper = grid[k, cell_y[y]]
            lower = grid[k, cell_y[y] + 1]
            down = part_y[y]
            light = scene[y, x0 : x0 + columns]
            line = out[k, i]
            l = 0
            while l < columns:
                # Within a cell the coefficient is linear, so one look-up per cell is enough.
                cell = cell_x[x0 + l]
                end = l + 1
                while end < columns and cell_x[x0 + end] == cell:
                    end += 1
                left = upper[cell] + down * (lower[cell] - upper[cell])
                right = upper[cell + 1] + down * (lower[cell + 1] - upper[cell + 1])
                slope = right - left
                for p in range(l, end):
                    line[p] = light[p] * (left + part_x[x0 + p] * slope)
                l = end

"""Transforms of padded real tiles with FFTW, and back.

The light of a tile fills only its first rows and columns. Rows without light and rows beyond the
result are not transformed.
"""

import numpy as np
import pyfftw

EFFORT = "FFTW_MEASURE"
"""FFTW's effort in planning. `FFTW_PATIENT` is up to a tenth faster but plans for seconds."""


def lengths(at_least):
    """Two transform lengths: products of 2, 3 and 5, divisible by 4 and by 16.

    Each is the smallest that is not below `at_least`.
    """
    return sorted({_smooth(at_least, 4), _smooth(at_least, 16)})


def _smooth(at_least, step):
    length = -(-at_least // step) * step
    while True:
        rest = length
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return length
        length += step


class Forward:
    """Real `[count, rows, length]` to `[count, length, length / 2 + 1]`, zeros below `rows`.

    `real` holds the input, `spectrum` the result. `lines` holds the transforms of the rows,
    `[count, length, ...]`, of which the first `rows` are used.
    """

    def __init__(self, count, rows, length, effort=EFFORT):
        half = length // 2 + 1
        self.real = pyfftw.zeros_aligned((count, rows, length), "float32")
        self.lines = pyfftw.zeros_aligned((count, length, half), "complex64")
        self.spectrum = pyfftw.empty_aligned((count, length, half), "complex64")
        top = self.lines[:, :rows]
        # Planning overwrites the arrays. They are cleared, since rows below the light must be 0.
        self._rows = pyfftw.FFTW(self.real, top, axes=(2,), flags=(effort,))
        self._columns = pyfftw.FFTW(self.lines, self.spectrum, axes=(1,), flags=(effort,))
        self.real[:] = 0
        self.lines[:] = 0

    def transform_rows(self):
        self._rows.execute()

    def transform_columns(self):
        self._columns.execute()

    def transform(self):
        self._rows.execute()
        self._columns.execute()


class Rows:
    """Transforms only rows: real `[count, length]` to `[count, length / 2 + 1]`."""

    def __init__(self, count, length, effort=EFFORT):
        self.real = pyfftw.zeros_aligned((count, length), "float32")
        self.lines = pyfftw.empty_aligned((count, length // 2 + 1), "complex64")
        self._plan = pyfftw.FFTW(self.real, self.lines, axes=(1,), flags=(effort,))
        self.real[:] = 0

    def transform(self):
        self._plan.execute()


class Inverse:
    """`[count, length, length / 2 + 1]` back to the first `rows` rows, without scaling.

    The result is `[count, rows, length]`.
    """

    def __init__(self, count, rows, length, effort=EFFORT):
        half = length // 2 + 1
        self.spectrum = pyfftw.empty_aligned((count, length, half), "complex64")
        self.real = pyfftw.empty_aligned((count, rows, length), "float32")
        backward = {"direction": "FFTW_BACKWARD"}
        self._columns = pyfftw.FFTW(
            self.spectrum, self.spectrum, axes=(1,), flags=(effort,), **backward
        )
        top = self.spectrum[:, :rows]
        self._rows = pyfftw.FFTW(
            top, self.real, axes=(2,), flags=(effort, "FFTW_DESTROY_INPUT"), **backward
        )

    def transform(self):
        self._columns.execute()
        self._rows.execute()


def kernel_spectra(stamps, length):
    """Spectra of `[kernel, v, u]`, `[kernel, length, length / 2 + 1]`.

    They are scaled so that a forward and an inverse transform need no other factor.
    """
    count, rows, columns = stamps.shape
    batch = max(1, min(count, 4 * 10**6 // length**2))
    forward = Forward(batch, rows, length)
    out = np.empty((count, length, length // 2 + 1), dtype=np.complex64)
    scale = np.float32(1 / length**2)
    for first in range(0, count, batch):
        part = stamps[first : first + batch]
        forward.real[: len(part), :, :columns] = part
        forward.transform()
        np.multiply(forward.spectrum[: len(part)], scale, out=out[first : first + batch])
    return out


def as_reals(spectra):
    """Complex `[..., y, x]` as alternating real and imaginary parts, `[..., 2 y x]`, not copied."""
    return spectra.view(np.float32).reshape(*spectra.shape[:-2], -1)

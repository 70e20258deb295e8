"""Transforms of padded tiles with FFTW: of real tiles whose light fills only the first rows and columns, and back.

Rows without light are not transformed, nor rows that the result does not have.
"""

import numpy as np
import pyfftw

EFFORT = "FFTW_MEASURE"
"""What FFTW may spend on planning; `FFTW_PATIENT` gains up to a tenth and takes seconds."""


def lengths(at_least):
    """Two transform lengths from `at_least` up: the next product of 2, 3 and 5 divisible by 4, and by 16."""
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
    """`[count, rows, length]` real to `[count, length, length / 2 + 1]`, zeros below `rows`.

    `real` holds the input, `lines` the rows' transforms (`[count, length, ...]`, of which the first `rows` are used), `spectrum` the result.
    """

    def __init__(self, count, rows, length, effort=EFFORT):
        half = length // 2 + 1
        self.real = pyfftw.zeros_aligned((count, rows, length), "float32")
        self.lines = pyfftw.zeros_aligned((count, length, half), "complex64")
        self.spectrum = pyfftw.empty_aligned((count, length, half), "complex64")
        top = self.lines[:, :rows]
        # Planning overwrites the arrays; the rows below the light must stay zero, so they are cleared after it.
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
    """The transform of rows alone: `[count, length]` real to `[count, length / 2 + 1]`."""

    def __init__(self, count, length, effort=EFFORT):
        self.real = pyfftw.zeros_aligned((count, length), "float32")
        self.lines = pyfftw.empty_aligned((count, length // 2 + 1), "complex64")
        self._plan = pyfftw.FFTW(self.real, self.lines, axes=(1,), flags=(effort,))
        self.real[:] = 0

    def transform(self):
        self._plan.execute()


class Inverse:
    """`[count, length, length / 2 + 1]` back to the first `rows` rows, `[count, rows, length]`; not scaled."""

    def __init__(self, count, rows, length, effort=EFFORT):
        half = length // 2 + 1
        self.spectrum = pyfftw.empty_aligned((count, length, half), "complex64")
        self.real = pyfftw.empty_aligned((count, rows, length), "float32")
        backward = {"direction": "FFTW_BACKWARD"}
        self._columns = pyfftw.FFTW(self.spectrum, self.spectrum, axes=(1,), flags=(effort,), **backward)
        top = self.spectrum[:, :rows]
        self._rows = pyfftw.FFTW(top, self.real, axes=(2,), flags=(effort, "FFTW_DESTROY_INPUT"), **backward)

    def transform(self):
        self._columns.execute()
        self._rows.execute()


def kernel_spectra(stamps, length):
    """Spectra of `[kernel, v, u]`, scaled so that the way there and back needs no other factor, `[kernel, length, length / 2 + 1]`."""
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
    """Complex `[..., y, x]` as real and imaginary parts in turn, `[..., 2 y x]`, without a copy."""
    return spectra.view(np.float32).reshape(*spectra.shape[:-2], -1)

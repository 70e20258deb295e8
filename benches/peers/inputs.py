"""The scene and the PSF samples for every method, read from files or made here.

Arrays are `[y, x]`. Positions are 0-based pixels, with an integer at the centre of a pixel. A
stamp's centre is at index `n / 2`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy.io import fits

STAMP = 64


@dataclass(frozen=True)
class Axis:
    """One axis of the grid of samples, and the place of each pixel of the frame in it."""

    nodes: np.ndarray
    """Positions of the samples, increasing, pixels."""
    cell: np.ndarray
    """For each pixel, the index of the sample before it. The last cell includes its end."""
    part: np.ndarray
    """For each pixel, the fraction of the way to the next sample. 0 or 1 beyond the grid."""

    @classmethod
    def new(cls, nodes, pixels):
        nodes = np.asarray(nodes, dtype=np.float64)
        if len(nodes) < 2 or np.any(np.diff(nodes) <= 0):
            raise ValueError("an axis of the grid needs at least two increasing positions")
        cell, part = locate(nodes, np.arange(pixels))
        return cls(nodes, cell, part)

    def weights(self, first, last, start, count):
        """Hat functions, `[sample, pixel]`, f32.

        Of the samples `start .. start + count` at the pixels `first .. last`.
        """
        out = np.zeros((count, last - first), dtype=np.float32)
        columns = np.arange(last - first)
        before = self.cell[first:last] - start
        for offset, value in ((0, 1 - self.part[first:last]), (1, self.part[first:last])):
            inside = (before + offset >= 0) & (before + offset < count)
            out[before[inside] + offset, columns[inside]] = value[inside]
        return out


def locate(nodes, positions):
    """The cell and the fraction within it of each position, both arrays like `positions`."""
    cell = np.clip(np.searchsorted(nodes, positions, side="right") - 1, 0, len(nodes) - 2)
    part = (positions - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
    return cell, np.clip(part, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Inputs:
    """The input of every method: a scene and PSFs on a regular grid, bilinear between them."""

    scene: np.ndarray
    """`[y, x]`, f32."""
    samples: np.ndarray
    """`[sample y, sample x, v, u]`, f32, each of unit sum."""
    y: Axis
    x: Axis

    @property
    def size(self):
        return self.scene.shape[0]

    @property
    def stamps(self):
        """The samples as one list, `[sample, v, u]`."""
        return self.samples.reshape(-1, *self.samples.shape[2:])

    def psf_at(self, y, x, samples=None):
        """The PSFs at positions, `[position, v, u]`, in the precision of the samples.

        `y` and `x` are arrays of one length.
        """
        samples = self.samples if samples is None else samples
        cell_y, part_y = locate(self.y.nodes, np.asarray(y, dtype=np.float64))
        cell_x, part_x = locate(self.x.nodes, np.asarray(x, dtype=np.float64))
        out = np.zeros((len(cell_y), *samples.shape[2:]), dtype=samples.dtype)
        for dy, wy in ((0, 1 - part_y), (1, part_y)):
            for dx, wx in ((0, 1 - part_x), (1, part_x)):
                weight = (wy * wx).astype(samples.dtype)[:, None, None]
                out += weight * samples[cell_y + dy, cell_x + dx]
        return out


def random_scene(size, seed):
    """Exponential noise on a smooth background, `[y, x]`, f32: light on every pixel."""
    rng = np.random.default_rng(seed)
    wave = np.sin(np.linspace(0, 7, size, dtype=np.float32))
    scene = rng.standard_exponential((size, size), dtype=np.float32)
    scene += 2 + wave[:, None] * wave[None, :]
    return scene


def optical_samples(grid):
    """PSFs of an aperture, `[sample, v, u]`, f32, unit sum.

    Astigmatism, coma and defocus change over the field. The field is the Fourier transform of a
    pupil with Zernike phase. The intensity is summed over 2 x 2 samples to one frame pixel.
    """
    n = 2 * STAMP
    v, u = np.indices((n, n)) - n // 2
    y, x = v / (n / 6), u / (n / 6)
    r2 = x * x + y * y
    pupil = (r2 <= 1) & (r2 >= 0.09)
    modes = [2 * r2 - 1, x * x - y * y, 2 * x * y, (3 * r2 - 2) * x, (3 * r2 - 2) * y]
    out = np.empty((grid * grid, STAMP, STAMP), dtype=np.float32)
    for s in range(grid * grid):
        fy, fx = (2 * np.array(divmod(s, grid)) / (grid - 1)) - 1
        terms = [
            0.5 + 0.6 * (fx * fx + fy * fy),
            0.8 * (fx * fx - fy * fy),
            1.6 * fx * fy,
            0.5 * fx,
            0.5 * fy,
        ]
        phase = sum(a * z for a, z in zip(terms, modes))
        field = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(pupil * np.exp(1j * phase))))
        # Samples 2 i - 1 and 2 i make pixel i, so that the peak at n / 2 is in pixel n / 4.
        intensity = np.roll(np.abs(field) ** 2, 1, axis=(0, 1))
        stamp = intensity.reshape(STAMP, 2, STAMP, 2).sum(axis=(1, 3))
        out[s] = stamp / stamp.sum()
    return out


def read_samples(path):
    """The stamps of a psf-samples file on a regular grid, and its axes y, x.

    Stamps are `[sample y, sample x, v, u]`, f64.
    """
    with fits.open(path) as file:
        cube = np.asarray(file[0].data, dtype=np.float64)
        header = file[0].header
        table = file["POSITIONS"].data
        px, py = np.asarray(table["X"], dtype=np.float64), np.asarray(table["Y"], dtype=np.float64)
    if header.get("OVERSAMP", 1.0) != 1.0:
        raise ValueError(
            f"{path}: OVERSAMP = {header['OVERSAMP']}, the peers need stamps at frame pixels"
        )
    for key, size in (("CENX", cube.shape[2]), ("CENY", cube.shape[1])):
        if header.get(key, size // 2) != size // 2:
            raise ValueError(f"{path}: {key} = {header[key]}, expected {size // 2}")
    xs, ys = np.unique(px), np.unique(py)
    if len(xs) * len(ys) != len(px):
        raise ValueError(f"{path}: {len(px)} positions do not form a grid of {len(xs)} x {len(ys)}")
    order = np.lexsort((px, py))
    cube = cube[order].reshape(len(ys), len(xs), *cube.shape[1:])
    return cube, ys, xs


def write_samples(path, inputs):
    """Writes the samples as a psf-samples file."""
    ny, nx = inputs.samples.shape[:2]
    py, px = np.repeat(inputs.y.nodes, nx), np.tile(inputs.x.nodes, ny)
    primary = fits.PrimaryHDU(inputs.stamps)
    primary.header["FIELDNX"], primary.header["FIELDNY"] = inputs.size, inputs.size
    columns = [fits.Column("X", "D", array=px), fits.Column("Y", "D", array=py)]
    table = fits.BinTableHDU.from_columns(columns, name="POSITIONS")
    fits.HDUList([primary, table]).writeto(path, overwrite=True)


def write_scene(work, scene):
    """Writes the scene for other programs, as `scene.fits` in the folder `work`."""
    fits.writeto(Path(work) / "scene.fits", scene, overwrite=True)


def prepare(work, size, grid, seed, scene=None, samples=None):
    """Makes the inputs and writes them as `scene.fits` and `samples.fits` in the folder `work`.

    Samples of another frame are stretched to this one (first sample at pixel 0, last at
    `size - 1`), so that a field is equally difficult at every size of frame. They are scaled to
    unit sum.
    """
    work = Path(work)
    work.mkdir(parents=True, exist_ok=True)
    if scene is None:
        image = random_scene(size, seed)
    else:
        image = np.ascontiguousarray(fits.getdata(scene), dtype=np.float32)
        if image.shape != (size, size):
            raise ValueError(f"{scene}: shape {image.shape}, expected {(size, size)}")
    if samples is None:
        cube = optical_samples(grid).reshape(grid, grid, STAMP, STAMP)
        ys = xs = np.linspace(0, size - 1, grid)
    else:
        cube, ys, xs = read_samples(samples)
        if cube.shape[:2] != (grid, grid):
            raise ValueError(f"{samples}: a grid of {cube.shape[:2]}, expected {(grid, grid)}")
        ys, xs = ((a - a[0]) / (a[-1] - a[0]) * (size - 1) for a in (ys, xs))
    cube = (cube / cube.sum(axis=(2, 3), keepdims=True)).astype(np.float32)
    inputs = Inputs(image, cube, Axis.new(ys, size), Axis.new(xs, size))
    write_scene(work, image)
    write_samples(work / "samples.fits", inputs)
    return inputs

"""The benchmark of point sources: 2916 stars, each one pixel, drawn one by one."""

import warnings

import galsim
import numpy as np
from astropy.nddata import NDData
from astropy.table import Table
from photutils.datasets import make_model_image
from photutils.psf import GriddedPSFModel

import images
import loops
import psfield
import table
import timing
from basis import Modes
from inputs import Inputs, locate, write_scene
from reference import exact_psf
from timing import RIGHT

COUNT = 2916


class Matrix:
    """Multiplies coefficients `[star, mode]` by the basis `[mode, pixel]` and adds each stamp."""

    name = "matrix"

    def __init__(self, inputs, catalogue):
        self.inputs, self.catalogue = inputs, catalogue
        self.modes = Modes.of(inputs)
        count = len(self.modes.stamps)
        self.basis = self.modes.stamps.reshape(count, -1)
        self.grid = np.ascontiguousarray(self.modes.grid.reshape(count, -1).T)
        self.image = np.zeros_like(inputs.scene)

    def run(self):
        self.image.fill(0)
        y, x, flux = self.catalogue
        cell_y, part_y = locate(self.inputs.y.nodes, y)
        cell_x, part_x = locate(self.inputs.x.nodes, x)
        columns = len(self.inputs.x.nodes)
        coefficients = np.zeros((len(y), len(self.basis)), dtype=np.float32)
        for dy, wy in ((0, 1 - part_y), (1, part_y)):
            for dx, wx in ((0, 1 - part_x), (1, part_x)):
                weight = (flux * wy * wx).astype(np.float32)
                coefficients += weight[:, None] * self.grid[(cell_y + dy) * columns + cell_x + dx]
        stamps = (coefficients @ self.basis).reshape(len(y), *self.modes.stamps.shape[1:])
        height, width = stamps.shape[1:]
        for star in range(len(y)):
            left = x[star : star + 1] - width // 2
            loops.add(
                stamps[star : star + 1],
                y[star] - height // 2,
                height,
                left,
                np.array([width]),
                self.image,
            )
        return self.image

    def describe(self):
        return f"{len(self.basis) - 1} modes, numpy product"

    def own(self, inputs, catalogue):
        return truth(inputs, catalogue, self.modes.samples())


class GalSim:
    """One `InterpolatedImage` per star.

    Stars lie on pixels, so nearest-neighbour interpolation gives the stamp itself and is the
    fastest. The scales for drawing in Fourier space are not computed.
    """

    name = "galsim"

    def __init__(self, inputs, catalogue):
        self.inputs, self.catalogue = inputs, catalogue
        self.image = galsim.ImageF(np.zeros_like(inputs.scene), xmin=0, ymin=0)

    def run(self):
        self.image.fill(0)
        y, x, flux = self.catalogue
        stamps = self.inputs.psf_at(y, x)
        height, width = stamps.shape[1:]
        for star in range(len(y)):
            left, bottom = int(x[star]) - width // 2, int(y[star]) - height // 2
            # The star's part of the image, cut at the frame.
            bounds = (
                galsim.BoundsI(left, left + width - 1, bottom, bottom + height - 1)
                & self.image.bounds
            )
            profile = galsim.InterpolatedImage(
                galsim.ImageF(stamps[star], xmin=-(width // 2), ymin=-(height // 2)),
                scale=1.0,
                x_interpolant="nearest",
                normalization="flux",
                offset=(0, 0),
                use_true_center=False,
                calculate_stepk=False,
                calculate_maxk=False,
            )
            profile = profile.withScaledFlux(float(flux[star]))
            profile.drawImage(
                self.image[bounds],
                method="no_pixel",
                add_to_image=True,
                center=galsim.PositionD(int(x[star]), int(y[star])),
                scale=1.0,
            )
        return self.image.array

    def describe(self):
        return "one InterpolatedImage per star, nearest, no_pixel"

    def own(self, inputs, catalogue):
        return truth(inputs, catalogue)


class Photutils:
    """`make_model_image` with a `GriddedPSFModel`."""

    name = "photutils"

    def __init__(self, inputs, catalogue):
        y, x, flux = catalogue
        nx, ny = len(inputs.x.nodes), len(inputs.y.nodes)
        positions = list(zip(np.tile(inputs.x.nodes, ny), np.repeat(inputs.y.nodes, nx)))
        # The model's origin is (n - 1) / 2. A row and a column of zeros move it to n / 2.
        stamps = np.pad(inputs.stamps, [(0, 0), *((0, 1 - n % 2) for n in inputs.stamps.shape[1:])])
        self.model = GriddedPSFModel(
            NDData(stamps, meta={"grid_xypos": positions, "oversampling": 1})
        )
        self.table = Table(
            {"x_0": x.astype(float), "y_0": y.astype(float), "flux": flux.astype(float)}
        )
        self.shape, self.model_shape = inputs.scene.shape, stamps.shape[1:]

    def run(self):
        return make_model_image(self.shape, self.model, self.table, model_shape=self.model_shape)

    def describe(self):
        return "make_model_image, GriddedPSFModel"

    def own(self, inputs, catalogue):
        return truth(inputs, catalogue)


METHODS = {"matrix": Matrix, "galsim": GalSim, "photutils": Photutils}


def draw_catalogue(size, seed, count=COUNT):
    """Integer positions y, x, all different, and fluxes."""
    rng = np.random.default_rng(seed)
    y, x = np.divmod(rng.choice(size * size, count, replace=False), size)
    return y, x, rng.uniform(100, 1000, count).astype(np.float32)


def truth(inputs, catalogue, samples=None):
    """The exact image, f64, from every star's PSF in double precision."""
    samples = (inputs.samples if samples is None else samples).astype(np.float64)
    y, x, flux = catalogue
    height, width = samples.shape[2:]
    margin = max(height, width)
    image = np.zeros([n + 2 * margin for n in inputs.scene.shape])
    for star in range(len(y)):
        stamp = float(flux[star]) * exact_psf(inputs, samples, y[star], x[star])
        top, left = margin + y[star] - height // 2, margin + x[star] - width // 2
        image[top : top + height, left : left + width] += stamp
    return image[margin:-margin, margin:-margin]


def benchmark(args):
    """Returns whether every method agrees with its own model, and the rows of the table."""
    inputs = images.load(args)
    catalogue = draw_catalogue(args.size, args.seed)
    scene = np.zeros_like(inputs.scene)
    scene[catalogue[0], catalogue[1]] = catalogue[2]
    inputs = Inputs(scene, inputs.samples, inputs.y, inputs.x)
    write_scene(args.work, scene)
    names = args.methods.split(",") if args.methods else list(METHODS)
    warnings.filterwarnings("ignore", module="photutils")
    entries = [
        timing.plan(name, lambda name=name: METHODS[name](inputs, catalogue)) for name in names
    ]
    exact = truth(inputs, catalogue)

    def check(entry, image):
        entry.error = _relative(image, exact)
        entry.own_error = _relative(image, entry.method.own(inputs, catalogue))

    timing.in_turn(entries, args.repeat, check)
    results = table.rows(entries, args.size, args.grid)
    ok = all(row["relative_l2_own_model"] <= RIGHT for row in results)
    results += psfield.beside(args, unit=None, method="auto")
    table.show(
        f"{COUNT} stars of one pixel, {args.size} x {args.size} pixels, {args.grid} x {args.grid} samples, {args.threads} threads",
        results,
    )
    return ok, results


def _relative(image, expected):
    return float(np.linalg.norm(image - expected) / np.linalg.norm(expected))

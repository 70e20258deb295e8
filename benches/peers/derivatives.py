"""Images and gradients in PyTorch: deepinv's `SpaceVaryingBlur` and psfield's `SpatiallyVaryingBlur`.

Both have one PSF: elliptical Moffat profiles on a grid of samples, bilinear in between, as a mean and the components
that psfield finds. They are deepinv's filters, and their coefficients at every pixel are its multipliers. Both are
source-anchored (`mask_first=True`). deepinv's padding is `circular`, its fastest for a frame of 2^n pixels, so errors
are measured only at pixels further than a stamp from the edge. It transforms its filters in each call, as its users
have it. psfield's plan is outside the timed part.

Errors are relative L2 differences from the direct sum in double precision at random pixels. With the default
tolerance they are the rounding of single precision. The methods run in turn, so that a slow phase of the machine
affects both. Ratios are medians over the rounds.

The program needs the packages of `python/tests/requirements-derivatives.txt`.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import torch

# The folder of this file has a module of the same name as the package.
HERE = Path(__file__).resolve().parent
sys.path = [folder for folder in sys.path if Path(folder).resolve() != HERE]

import psfield  # noqa: E402
from psfield.torch import SpatiallyVaryingBlur  # noqa: E402

BETA = 3.0
"""Exponent of the Moffat profiles."""
SAME = 1e-5
"""Largest difference, over the peak, of a PSF of psfield and the sum of filters times multipliers: single precision
of psfield's basis, and rounding."""


def samples(grid, stamp, size):
    """Stamps `[sample, y, x]` and their positions. Width and ellipticity change smoothly over the field."""
    v, u = np.indices((stamp, stamp)) - stamp // 2
    stamps, positions = [], []
    for fy in np.linspace(-1, 1, grid):
        for fx in np.linspace(-1, 1, grid):
            fwhm = 2.8 + 0.3 * fx + 0.2 * fy + 0.3 * (fx * fx + fy * fy)
            e1, e2 = 0.08 * (fx * fx - fy * fy) + 0.02 * fx, 0.16 * fx * fy - 0.03 * fy
            square = (1 - e1) * u * u + (1 + e1) * v * v - 2 * e2 * u * v
            scale = 4 * (2 ** (1 / BETA) - 1) / fwhm**2
            profile = (1 + scale * square) ** -BETA
            stamps.append(profile / profile.sum())
            positions.append(((fx + 1) / 2 * (size - 1), (fy + 1) / 2 * (size - 1)))
    return np.array(stamps), np.array(positions)


def stars_on_sky(size, rng):
    """Stars of many fluxes on a sky of 100, one in a hundred pixels, `[y, x]`, f32."""
    light = np.full((size, size), 100, dtype=np.float32)
    count = size * size // 100
    np.add.at(light, tuple(rng.integers(0, size, (2, count))), 10 ** rng.uniform(1, 5, count))
    return light


def terms(model, grid, size):
    """The filters `[k, v, u]` and multipliers `[k, y, x]` of a model, f64. The mean has the multiplier 1."""
    nodes = np.linspace(0, size - 1, grid)
    hats = np.array([np.interp(np.arange(size), nodes, row) for row in np.eye(grid)])
    values = model.coefficients.reshape(grid, grid, -1)
    multipliers = np.einsum("jik,jy,ix->kyx", values, hats, hats, optimize=True)
    filters = np.concatenate([model.mean[None], model.components])
    multipliers = np.concatenate([np.ones((1, size, size)), multipliers])
    x, y = np.random.default_rng(3).integers(0, size, (2, 100))
    psfs = np.einsum("kn,kvu->nvu", multipliers[:, y, x], filters)
    difference = np.abs(model.evaluate(x.astype(float), y.astype(float)) - psfs).max()
    if difference > SAME * psfs.max():
        raise SystemExit(f"the PSFs differ by {difference / psfs.max():.1e} of the peak")
    return filters, multipliers


def direct(filters, multipliers, pixels, places, transposed):
    """The image or, if `transposed`, the gradient at places `(y, x)` by definition, f64."""
    half = filters.shape[-1] // 2
    sums = []
    for y, x in places:
        if transposed:
            part = pixels[y - half : y - half + 2 * half, x - half : x - half + 2 * half]
            sums.append(np.einsum("kvu,vu,k->", filters, part, multipliers[:, y, x], optimize=True))
        else:
            # The light at `(y, x) - (v, u)` reaches the pixel through the stamp's pixel `(v, u)` from its centre.
            part = (slice(y - half + 1, y + half + 1), slice(x - half + 1, x + half + 1))
            light = (multipliers[(slice(None), *part)] * pixels[part])[:, ::-1, ::-1]
            sums.append(np.einsum("kvu,kvu->", filters, light))
    return np.array(sums)


def seconds(work):
    # Threads that have just finished other work wait busily for more. They go to sleep in this pause.
    time.sleep(0.3)
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=2048, help="columns and rows of the frame")
    parser.add_argument("--grid", type=int, default=5, help="samples along each axis")
    parser.add_argument("--stamp", type=int, default=32, help="columns and rows of a stamp, an even number")
    parser.add_argument("--rank", default="auto", help="psfield's number of components, as in `PsfModel.from_samples`")
    parser.add_argument("--tolerance", type=float, default=1e-6, help="psfield's tolerance")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--pixels", type=int, default=1000, help="pixels at which errors are measured")
    args = parser.parse_args()
    import deepinv

    # psfield warns that the samples have more components than the model. The comparison is with the model.
    warnings.simplefilter("ignore", psfield.PsfieldWarning)
    torch.set_num_threads(args.threads)
    psfield.set_threads(args.threads)
    size = args.size
    given = samples(args.grid, args.stamp, size)
    model = psfield.PsfModel.from_samples(
        *given, field_shape=(size, size), rank=args.rank, interpolation="bilinear"
    )
    filters, multipliers = terms(model, args.grid, size)
    rng = np.random.default_rng(1)
    light = stars_on_sky(size, rng)
    gradient = rng.standard_normal((size, size), dtype=np.float32)
    places = rng.integers(args.stamp, size - args.stamp, (args.pixels, 2))
    truths = (
        direct(filters, multipliers, light.astype(float), places, False),
        direct(filters, multipliers, gradient.astype(float), places, True),
    )

    single = [torch.from_numpy(a[None, None].astype(np.float32)) for a in (filters, multipliers)]
    methods = {
        "deepinv": deepinv.physics.SpaceVaryingBlur(*single, padding="circular", use_fft=True),
        "psfield": SpatiallyVaryingBlur(model.plan((size, size), args.tolerance, device="cpu")),
    }
    x = torch.from_numpy(light)[None, None].requires_grad_()
    g = torch.from_numpy(gradient)[None, None]
    times = {name: [] for name in methods}
    errors = {}
    # The first round is not timed.
    for _ in range(args.rounds + 1):
        for name, method in methods.items():
            forward, image = seconds(lambda: method(x))
            backward, (found,) = seconds(lambda: torch.autograd.grad(image, x, g))
            times[name].append((forward, backward))
            results = (array.detach().numpy()[0, 0][tuple(places.T)] for array in (image, found))
            errors[name] = [np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(results, truths)]

    print(f"{size} x {size}, {len(filters)} filters of {args.stamp} x {args.stamp}, {args.threads} threads")
    print(f"deepinv {deepinv.__version__}, torch {torch.__version__}, psfield tolerance {args.tolerance:g}\n")
    print(f"{'method':<10} {'forward s':>10} {'backward s':>10} {'back/forw':>10} {'error':>9} {'of gradient':>12}")
    timed = {name: np.array(found[1:]) for name, found in times.items()}
    for name, found in timed.items():
        forward, backward = np.median(found, axis=0)
        ratio = np.median(found[:, 1] / found[:, 0])
        columns = f"{name:<10} {forward:>10.4f} {backward:>10.4f} {ratio:>10.2f}"
        print(columns, "{:>9.1e} {:>12.1e}".format(*errors[name]))
    forward, backward = np.median(timed["deepinv"] / timed["psfield"], axis=0)
    both = np.median(timed["deepinv"].sum(axis=1) / timed["psfield"].sum(axis=1))
    print(f"\ndeepinv / psfield: forward {forward:.1f}, backward {backward:.1f}, both {both:.1f}")


if __name__ == "__main__":
    main()

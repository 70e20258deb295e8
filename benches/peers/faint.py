"""Faint galaxies without sky noise: UFig draws their photons, psfield their photons or their images.

Both draw one catalogue: exponential discs with log-normal numbers of photons. UFig has a Moffat PSF for each
galaxy. psfield has stamps of the same Moffat PSFs on a grid, bilinear in between.
Each method runs in an interpreter that has it: `--method ufig`, `--method psfield` (the mean image) or
`--method photons` (psfield photon by photon).
"""

import argparse
import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

STAMP = 64
BETA = 2.5


def fwhm_px(x, y, size):
    """The FWHM of the PSF at a position: it grows across the frame."""
    return 3.0 + 0.6 * x / size + 0.4 * y / size


def catalogue(args):
    """Columns of galaxies. `q` is the axis ratio, `angle` is in degrees from +x towards +y."""
    rng = np.random.default_rng(args.seed)
    sigma = np.sqrt(2 * np.log(args.mean / args.median))
    y, x = rng.uniform(0, args.size - 1, (2, args.count))
    return {
        "x": x,
        "y": y,
        "flux": args.median * np.exp(sigma * rng.normal(size=args.count)),
        "re": 8 ** rng.uniform(0, 1, args.count),
        "n": np.ones(args.count),
        "q": rng.uniform(0.3, 1, args.count),
        "angle": rng.uniform(0, 180, args.count),
    }


class UFig:
    """`render_galaxies_flexion` of UFig. Photons are 32-bit counts, and their numbers are given."""

    def __init__(self, galaxies, args):
        from ufig.plugins.render_galaxies_flexion import Plugin

        count = len(galaxies["x"])
        zeros, (q, angle) = np.zeros(count), (galaxies["q"], np.radians(galaxies["angle"]))
        # UFig's ellipticity is (a^2 - b^2) / (a^2 + b^2).
        e = (1 - q**2) / (1 + q**2)
        self.image = np.zeros((args.size, args.size), dtype=np.float32)
        columns = SimpleNamespace(
            # Pixel 0 of UFig begins at 0.
            x=galaxies["x"] + 0.5,
            y=galaxies["y"] + 0.5,
            nphot=np.random.default_rng(args.seed + 1).poisson(galaxies["flux"]),
            sersic_n=galaxies["n"],
            r50=galaxies["re"] * np.sqrt((1 + q**2) / 2),
            e1=e * np.cos(2 * angle),
            e2=e * np.sin(2 * angle),
            psf_beta=np.full((count, 1), BETA),
            psf_fwhm=fwhm_px(galaxies["x"], galaxies["y"], args.size),
            psf_dx_offset=np.zeros((count, 1)),
            psf_dy_offset=np.zeros((count, 1)),
            **{f"psf_{name}": zeros for name in ("e1", "e2", "f1", "f2", "g1", "g2", "kurtosis")},
        )
        parameters = SimpleNamespace(
            seed=args.seed,
            gal_render_seed_offset=900,
            sersicprecision=9,
            gammaprecision=13,
            gammaprecisionhigh=4,
            n_threads_photon_rendering=args.threads,
            psf_flexion_suppression=-0.12,
        )
        from ivy.context import create_ctx

        context = create_ctx(
            parameters=parameters, galaxies=columns, numgalaxies=count, image=self.image
        )
        self.context, self.plugin = context, Plugin(context)

    def run(self):
        self.image[:] = 0
        self.context.image = self.image
        self.plugin()
        return self.image


class Psfield:
    """The mean image by psfield, at `--tolerance`. The first run also makes the blocks of the field."""

    def __init__(self, galaxies, args):
        # The folder of this file has a module of the same name.
        sys.path = [
            folder
            for folder in sys.path
            if Path(folder).resolve() != Path(__file__).parent.resolve()
        ]
        import psfield

        nodes = np.linspace(0, args.size - 1, args.grid)
        positions = np.array([(x, y) for y in nodes for x in nodes])
        v, u = np.indices((STAMP, STAMP)) - STAMP // 2
        alpha = fwhm_px(*positions.T, args.size) / (2 * np.sqrt(2 ** (1 / BETA) - 1))
        samples = (1 + (u**2 + v**2) / alpha[:, None, None] ** 2) ** -BETA
        samples /= samples.sum(axis=(1, 2), keepdims=True)
        model = psfield.PsfModel.from_samples(samples, positions, interpolation="bilinear")
        self.plan = model.plan((args.size, args.size), args.tolerance, device="cpu")
        self.galaxies = galaxies

    def run(self):
        return self.plan.simulate(catalog=self.galaxies)


class Photons(Psfield):
    """The photons of all galaxies by psfield, without sky."""

    def run(self):
        from psfield.detector import Detector

        camera = Detector(photon_noise=True)
        return self.plan.expose(
            None, self.galaxies, detector=camera, seed=1, shoot_below=1e7
        ).counts


METHODS = {"ufig": UFig, "psfield": Psfield, "photons": Photons}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--method", choices=METHODS, required=True)
    parser.add_argument(
        "--size", type=int, default=4096, help="pixels along each side of the frame"
    )
    parser.add_argument("--count", type=int, default=100_000, help="number of galaxies")
    parser.add_argument(
        "--median", type=float, default=12, help="median number of photons of a galaxy"
    )
    parser.add_argument("--mean", type=float, default=89, help="mean number of photons of a galaxy")
    parser.add_argument(
        "--grid", type=int, default=71, help="samples of psfield's PSF along each side"
    )
    parser.add_argument("--tolerance", type=float, default=1e-3)
    parser.add_argument(
        "--threads",
        type=int,
        default=2,
        help="of UFig. psfield takes all cores (RAYON_NUM_THREADS)",
    )
    parser.add_argument(
        "--repeat", type=int, default=3, help="runs after the first one, which is not timed"
    )
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    method = METHODS[args.method](catalogue(args), args)
    image, seconds, processor = method.run(), [], []
    for _ in range(args.repeat):
        wall, cpu = time.perf_counter(), time.process_time()
        image = method.run()
        seconds.append(time.perf_counter() - wall)
        processor.append(time.process_time() - cpu)
    photons = float(np.sum(image, dtype=np.float64))
    row = {
        "method": args.method,
        "galaxies": args.count,
        "photons": photons,
        "seconds_min": min(seconds),
        "seconds_processor": min(processor),
        "ns_per_photon_and_core": 1e9 * min(processor) / photons,
    }
    print(json.dumps(row))


if __name__ == "__main__":
    main()

"""Times and checks psfield and peer methods for convolution with a PSF that varies over the field.

README.md in this folder describes them.
"""

import argparse
import json
import os
import resource
import sys
from pathlib import Path


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--size", type=int, default=1024, help="pixels along each axis of the frame (default 1024)"
    )
    parser.add_argument(
        "--grid", type=int, default=71, help="PSF samples along each axis (default 71)"
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument(
        "--repeat", type=int, default=3, help="timed runs of each method (default 3)"
    )
    parser.add_argument(
        "--methods", help="names separated by commas (default: all, with --stars all for stars)"
    )
    parser.add_argument(
        "--stars", action="store_true", help="2916 one-pixel stars instead of a scene"
    )
    groups = "real work: groups of psfield bench --real (default all)"
    parser.add_argument("--real", nargs="?", const="all", metavar="GROUP,...", help=groups)
    parser.add_argument("--sizes", help="with --real: sides of the frames, separated by commas")
    parser.add_argument(
        "--quick", action="store_true", help="with --real: a small version of every case"
    )
    parser.add_argument(
        "--scene", type=Path, help="FITS image of size x size pixels (default: random, from --seed)"
    )
    parser.add_argument(
        "--samples", type=Path, help="psf-samples file on a regular grid (default: made here)"
    )
    parser.add_argument("--preset", help="psfield samples this telescope, for instance survey-2m")
    parser.add_argument("--psfield", help="path of the program psfield, timed on the same files")
    parser.add_argument(
        "--tolerances", default="1e-3,1e-6", help="tolerances of psfield (default 1e-3,1e-6)"
    )
    parser.add_argument(
        "--pixels", type=int, default=300, help="number of random pixels to check (default 300)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--work",
        type=Path,
        default=Path("peers-work"),
        help="folder for scene.fits and samples.fits",
    )
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if args.preset and not args.psfield:
        parser.error("--preset needs --psfield")
    if args.real and not args.psfield:
        parser.error("--real needs --psfield")
    if args.preset and args.samples:
        parser.error("--preset and --samples exclude each other")
    return args


def settle(threads):
    """Starts this program again with the environment that fast runs need.

    Libraries read these variables before Python can set them. With them, freed memory stays with
    the process (glibc). Fresh pages for every temporary array would double the time of
    `fftconvolve` on large frames, and more on a virtual machine.
    """
    wanted = {
        f"{library}_NUM_THREADS": str(threads) for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")
    }
    wanted |= {
        "MALLOC_MMAP_MAX_": "0",
        "MALLOC_TRIM_THRESHOLD_": str(10**11),
        "MALLOC_TOP_PAD_": str(2**26),
    }
    if any(os.environ.get(name) != value for name, value in wanted.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | wanted)


def main():
    args = arguments()
    settle(args.threads)
    if args.real:
        import real as chosen
    elif args.stars:
        import stars as chosen
    else:
        import images as chosen

    ok, results = chosen.benchmark(args)
    print(
        f"peak memory of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB"
    )
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n")
    if not ok:
        sys.exit("the image of a method differs from its own model, so its time is not valid")


if __name__ == "__main__":
    main()

"""Stars of many magnitudes through a PSF with spikes that reach across the frame: time and memory by stamp size.

The PSF has a Moffat core, a halo that falls with the third power of the radius, and four spikes. It varies over
3 x 3 samples. Stamps of more than 382 pixels get wings. Each run is one process, from reading the files to the
written image.
"""

import argparse
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np


def stamps(size, side):
    """PSF samples `[sample, y, x]` and their positions."""
    across = np.arange(size) - size // 2
    x, y = across[None, :], across[:, None]
    square = x**2 + y**2
    core_like = np.exp(-(across**2) / 4.0)
    along = 1 / (1 + across**2 / 100.0)
    spikes = core_like[None, :] * along[:, None] + core_like[:, None] * along[None, :]
    places = [(u, v) for v in (0.0, 0.5, 1.0) for u in (0.0, 0.5, 1.0)]
    samples = np.empty((len(places), size, size))
    for sample, (u, v) in zip(samples, places, strict=True):
        fwhm = 2.2 + 0.6 * u + 0.3 * v**2
        sample[:] = (1 + square * 1.3 / fwhm**2) ** -3.0
        sample += 3e-4 * (1 + 0.2 * u) * (1 + square / 25.0) ** -1.5
        sample += 2e-3 * (1 + 0.1 * v) * spikes
        sample /= sample.sum()
    return samples, (side - 1) * np.array(places)


def write_models(args):
    """Write a model for each size of stamps."""
    # The folder of this file has a module of the same name.
    here = Path(__file__).resolve().parent
    sys.path = [folder for folder in sys.path if Path(folder).resolve() != here]
    import psfield

    field = (args.side, args.side)
    for size in args.stamps:
        model = psfield.PsfModel.from_samples(*stamps(size, args.side), field_shape=field)
        model.write(args.work / f"model{size}.fits", overwrite=True)


def catalogue(path, count, side, seed):
    """Write stars of magnitude 3 to 24, whose number grows with 10^(0.3 m). Magnitude 25 is a flux of 100."""
    rng = np.random.default_rng(seed)
    few, many = 10 ** (0.3 * 3), 10 ** (0.3 * 24)
    magnitude = np.log10(few + (many - few) * rng.random(count)) / 0.3
    x, y = rng.uniform(0, side - 1, (2, count))
    flux = 100 * 10 ** (0.4 * (25 - magnitude))
    np.savetxt(path, np.transpose([x, y, flux]), "%.9g", ",", header="x,y,flux", comments="")


def run(command):
    """The seconds and the largest memory (MB) of a process."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"failed: {' '.join(map(str, command))}")
    return time.perf_counter() - start, usage.ru_maxrss / 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--psfield", default="psfield", help="the command")
    parser.add_argument("--side", type=int, default=4096, help="columns and rows of the frame")
    parser.add_argument("--count", type=int, default=20000, help="number of stars")
    parser.add_argument("--stamps", type=int, nargs="+", default=[63, 1023, 4095])
    parser.add_argument("--floors", type=float, nargs="+", default=[1.0, 0.0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--work", type=Path, default=Path("wings"), help="folder for the files")
    args = parser.parse_args()
    args.work.mkdir(exist_ok=True)
    catalogue(args.work / "stars.csv", args.count, args.side, seed=1)
    shape = f"{args.side},{args.side}"
    # In a process of its own: the memory of a command counts that of the process which starts it.
    writer = multiprocessing.get_context("spawn").Process(target=write_models, args=(args,))
    writer.start()
    writer.join()
    options = ["--catalog", args.work / "stars.csv", "--shape", shape, "--tolerance", "1e-3"]
    first = {}
    print("stamps  floor  seconds  times the first  MB")
    for floor in args.floors:
        for size in args.stamps:
            files = ["--psf", args.work / f"model{size}.fits", "-o", args.work / "image.fits"]
            command = [args.psfield, "simulate", *files, *options, "--floor", str(floor)]
            runs = [run([*command, "--overwrite", "--quiet"]) for _ in range(args.repeats)]
            seconds, memory = min(runs)
            first.setdefault(floor, seconds)
            ratio = seconds / first[floor]
            print(f"{size:6}  {floor:5g}  {seconds:7.2f}  {ratio:15.1f}  {memory:.0f}", flush=True)


if __name__ == "__main__":
    main()

"""The benchmark of real work: psfield's rows of `psfield bench --real`, and the peers' times."""

import functools
import json
import time
import warnings

import numpy as np

import galaxies
import plots
import psfield
import stars
from inputs import Axis, Inputs, optical_samples, random_scene
from methods import Single
from pool import Pool

STARS = 100, 1000
"""Numbers of stars that are drawn. The difference of their times gives the time of a star."""
GALAXIES = 300
WINGS = 1023
"""The side of the PSF of the group `wings`."""
SOURCES_OF_FLOOR = 10_000
"""Stars, and as many galaxies, of the group `floor`: at most one for 100 pixels."""
SOURCES_OF_PHOTONS = 100_000
"""Stars of the group `starphotons`, galaxies of `galaxyphotons`: at most one for 100 pixels."""
STARS_OF_SERIES = 2000
"""Stars in each exposure of the group `starseries`."""
ORDER = (
    "pixels",
    "light",
    "stars",
    "galaxies",
    "floor",
    "wings",
    "starphotons",
    "galaxyphotons",
    "frames",
    "fields",
    "colours",
    "series",
    "starseries",
)


class Peers:
    """Times of the peers in seconds. Each time is measured once for each size of frame."""

    def __init__(self, args):
        self.args = args
        kept = self._samples, self._images, self._star, self._galaxy
        self.samples, self.images, self.star, self.galaxy = map(functools.cache, kept)

    def best(self, row):
        """The name of the fastest peer for a case, and its seconds."""
        size, amount = row["size"][0], row["amount"]
        if row["group"] == "stars":
            name, seconds = min(self.star(size).items(), key=lambda item: item[1])
            return name, seconds * amount
        if row["group"] == "starseries":
            name, seconds = min(self.star(size).items(), key=lambda item: item[1])
            return name, seconds * STARS_OF_SERIES * amount
        if row["group"] == "starphotons":
            name, seconds = min(self.star(size).items(), key=lambda item: item[1])
            return name, seconds * min(SOURCES_OF_PHOTONS, size**2 // 100)
        if row["group"] == "galaxyphotons":
            return galaxies.GalSim.name, self.galaxy(size) * min(SOURCES_OF_PHOTONS, size**2 // 100)
        if row["group"] == "galaxies":
            return galaxies.GalSim.name, self.galaxy(size) * amount
        if row["group"] == "floor":
            each = self.star(size)[stars.GalSim.name] + self.galaxy(size)
            return galaxies.GalSim.name, each * min(SOURCES_OF_FLOOR, size**2 // 100)
        frames = int(amount) if row["group"] in ("frames", "fields", "colours", "series") else 1
        stamp = WINGS if row["group"] == "wings" else None
        return "fftconvolve", self.images(size, frames, stamp)

    def _samples(self):
        grid = self.args.grid
        samples = optical_samples(grid)
        return samples.reshape(grid, grid, *samples.shape[1:])

    def inputs(self, scene, stamp=None):
        """The inputs of a method. `stamp` is the side of larger stamps, to which zeros are added."""
        size, samples = len(scene), self.samples()
        if stamp:
            # Four samples about the middle: all of them would need much memory.
            middle = (len(samples) - 1) // 2
            samples = samples[middle : middle + 2, middle : middle + 2]
            margin = stamp - samples.shape[-1]
            samples = np.pad(samples, [(0, 0)] * 2 + [(margin // 2, margin - margin // 2)] * 2)
        y, x = (Axis.new(np.linspace(0, size - 1, count), size) for count in samples.shape[:2])
        return Inputs(scene, samples, y, x)

    def _images(self, size, frames, stamp):
        """Seconds of `frames` images with one PSF, with stamps of another side if one is given."""
        scene = random_scene(size, self.args.seed)
        single = Single(self.inputs(scene, stamp), Pool(self.args.threads))

        def run():
            for _ in range(frames):
                single.run()

        return fastest(run, self.args.repeat)

    def _star(self, size):
        """Seconds of a star, for each peer.

        GalSim and photutils use one thread. Their times are divided by the number of threads, as if
        as many processes shared the sources.
        """
        warnings.filterwarnings("ignore", module="photutils")
        inputs = self.inputs(np.zeros((size, size), dtype=np.float32))
        out = {}
        for peer in (stars.GalSim, stars.Photutils):
            few, many = (
                fastest(peer(inputs, catalogue).run, self.args.repeat)
                for catalogue in (stars.draw_catalogue(size, self.args.seed, n) for n in STARS)
            )
            out[peer.name] = (many - few) / (STARS[1] - STARS[0]) / self.args.threads
        return out

    def _galaxy(self, size):
        """Seconds of a galaxy, divided by the number of threads."""
        inputs = self.inputs(np.zeros((size, size), dtype=np.float32))
        peer = galaxies.GalSim(inputs, GALAXIES, self.args.seed)
        return fastest(peer.run, self.args.repeat) / GALAXIES / self.args.threads


def fastest(run, repeat):
    """Seconds of the fastest of `repeat` runs, after one that is not timed."""
    run()
    seconds = []
    for _ in range(repeat):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def benchmark(args):
    """Measures, and writes `real.json`, `real.md` and the plots in the working folder.

    Rows of other groups in an earlier `real.json` are kept if they were measured with the same options.
    """
    args.work.mkdir(parents=True, exist_ok=True)
    report = psfield.real(args)
    rows = report["rows"]
    options = {name: value for name, value in report["options"].items() if name != "groups"}
    peers = Peers(args)
    for row in rows:
        row["peer"], row["seconds_peer"] = peers.best(row)
    path = args.work / "real.json"
    kept = json.loads(path.read_text()) if path.exists() else {}
    if isinstance(kept, dict) and kept.get("options") == options:
        groups = {row["group"] for row in rows}
        rows += [row for row in kept["rows"] if row["group"] not in groups]
    rows.sort(key=lambda row: ORDER.index(row["group"]))
    path.write_text(json.dumps({"options": options, "rows": rows}, indent=1) + "\n")
    table = markdown(rows)
    (args.work / "real.md").write_text(table)
    print("\n" + table)
    plots.draw(rows, args.work)
    return True, rows


HEAD = "case", "PSF", "model", "plan", "first run", "run", "one PSF", "best peer", "error", "memory"


def markdown(rows):
    """One table. Times are in seconds."""
    lines = [HEAD, ["---"] * len(HEAD)]
    for row in rows:
        seconds = (row[f"seconds{part}"] for part in ("_model", "_plan", "_first", "", "_single"))
        error, memory = row["relative_l2"], row["peak_memory_bytes"]
        lines.append(
            [
                case(row),
                row["psf"],
                *(number(value) for value in seconds),
                f"{number(row['seconds_peer'])} {row['peer']}",
                "-" if error is None else f"{error:.0e}".replace("e-0", "e-"),
                "-" if memory is None else f"{memory / 2**30:.2f} GiB",
            ]
        )
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def case(row):
    amount, unit = row["amount"], row["unit"]
    frame = " x ".join(map(str, row["size"]))
    if row["group"] == "pixels":
        return frame
    if row["group"] in ("series", "starseries"):
        return f"{row['group']}, {amount:.0f} exposures of {frame}"
    if row["group"].endswith("photons"):
        return f"{frame}, {row['group'].removesuffix('photons')} sources of {amount:.0f} photons"
    if row["group"] == "frames":
        return f"{amount:.0f} frames of {frame}"
    if row["group"] == "fields":
        return f"{amount:.0f} fields, frames of {frame}"
    return (
        f"{frame}, {amount:g} {unit}"
        if amount < 1e4
        else f"{frame}, {amount:.0e} {unit}".replace("e+0", "e")
    )


def number(value):
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"

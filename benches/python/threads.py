"""Ways to make many frames on the cores of one machine.

A loop over `simulate`, one call with a stack of scenes, and calls from threads of Python, with one
thread of psfield or with all of them. Prints milliseconds per frame: the median of several rounds,
in which the ways take turns. Lit frames have light in every pixel, others a catalogue of 100 stars.

    python benches/python/threads.py
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

import psfield


def ways(
    plan: psfield.Plan, frames: list[dict[str, Any]], pool: ThreadPoolExecutor
) -> dict[str, Callable[[], object]]:
    """Return functions that make all frames."""

    def make(frame: dict[str, Any]) -> object:
        return plan.simulate(**frame)

    def one_each() -> None:
        psfield.set_threads(1)
        list(pool.map(make, frames))
        psfield.set_threads(None)

    found: dict[str, Callable[[], object]] = {"loop": lambda: [make(frame) for frame in frames]}
    if "scene" in frames[0]:
        scenes = np.stack([frame["scene"] for frame in frames])
        found["stack"] = lambda: plan.simulate(scenes)
    found["Python threads"] = lambda: list(pool.map(make, frames))
    found["Python threads, set_threads(1)"] = one_each
    return found


def main() -> None:
    """Print a line for each kind and size of frames."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sides", type=int, nargs="+", default=[64, 128, 256, 512, 1024])
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    cores = os.cpu_count() or 1
    print(f"{cores} cores, milliseconds per frame")
    rng = np.random.default_rng(1)
    for side in options.sides:
        model = psfield.PsfModel.from_telescope(
            field_shape=(side, side), samples=(4, 4), stamp_size=32, oversampling=2
        )
        plan = model.plan((side, side), device="cpu")
        count = int(np.clip(2**22 // side**2, 8, 256))
        shape, stars = (count, side, side), (count, 2, 100)
        lit = [{"scene": scene} for scene in rng.uniform(0, 1, shape).astype(np.float32)]
        catalogs = [
            {"catalog": {"x": x, "y": y, "flux": np.ones(100)}}
            for x, y in rng.uniform(0, side - 1, stars)
        ]
        for kind, frames in (("lit", lit), ("100 stars", catalogs)):
            with ThreadPoolExecutor(cores) as pool:
                seconds: dict[str, list[float]] = {}
                for _ in range(options.rounds):
                    for name, make_all in ways(plan, frames, pool).items():
                        start = time.perf_counter()
                        make_all()
                        seconds.setdefault(name, []).append(time.perf_counter() - start)
            medians = (
                f"{name} {1e3 * statistics.median(all_rounds) / count:.3f}"
                for name, all_rounds in seconds.items()
            )
            print(f"{side} x {side}, {kind}: " + ", ".join(medians))


if __name__ == "__main__":
    main()

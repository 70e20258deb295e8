"""Time `Plan.simulate` and the same call of the Rust library in turn.

Usage: python benches/python/simulate.py MODEL.fits [SIZE] [TOLERANCE] [ROUNDS]

First install the package and run ``cargo build --release -p psfield --example time_simulation``.
MODEL.fits is a model of ``psfield fit`` over a field of at least SIZE x SIZE pixels. The program
prints the median ratio of the times, the peak memory of this process, and the memory of the scene,
the image and the plan.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import psfield

REPEAT = 7


def main() -> None:
    """Run the rounds."""
    model = sys.argv[1]
    given = [*sys.argv[2:], *["4096", "1e-3", "8"][len(sys.argv) - 2 :]]
    size, tolerance, rounds = int(given[0]), float(given[1]), int(given[2])
    example = (
        Path(__file__).resolve().parents[2] / "target" / "release" / "examples" / "time_simulation"
    )
    y, x = np.mgrid[:size, :size]
    scene = (1.0 + (3 * x + 5 * y) % 7).astype(np.float32)
    del x, y
    plan = psfield.PsfModel.read(model).plan(scene.shape, tolerance, device="cpu")
    plan.simulate(scene)
    whole, execution = [], []
    for _ in range(rounds):
        ran = subprocess.run(
            [example, model, str(size), str(tolerance), str(REPEAT)],
            capture_output=True,
            text=True,
            check=True,
        )
        rust = [[float(v) for v in line.split()] for line in ran.stdout.splitlines()]
        python = []
        for _ in range(REPEAT):
            began = time.perf_counter()
            image = plan.simulate(scene)
            python.append(time.perf_counter() - began)
            del image
        mine, whole_call = min(python), min(total for total, _ in rust)
        without_check = min(total - check for total, check in rust)
        whole.append(mine / whole_call)
        execution.append(mine / without_check)
        print(
            f"Python {mine:.4f} s, Rust {whole_call:.4f} s,"
            f" Rust without the check of the scene {without_check:.4f} s"
        )
    print(f"Python over Rust: {statistics.median(whole):.3f}")
    print(f"Python over Rust without the check: {statistics.median(execution):.3f}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    arrays = 2 * scene.nbytes / 2**20
    kept = plan.summary.kept_bytes / 2**20
    print(f"peak memory {peak:.0f} MiB, scene and image {arrays:.0f} MiB, plan {kept:.0f} MiB")


if __name__ == "__main__":
    main()

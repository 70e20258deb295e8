"""Plans once, then runs all methods in turn, so that a slow phase of the machine affects all."""

import time
from dataclasses import dataclass, field

import numpy as np

RIGHT = 3e-6
"""Largest relative L2 difference of an image from its own model, in single precision."""


@dataclass
class Timed:
    """A method with the times of its plan and of each run, in seconds."""

    method: object
    prepare: float
    seconds: list = field(default_factory=list)
    processor: list = field(default_factory=list)
    """Processor time of each run, summed over threads. Other programs disturb it less."""
    error: float = np.nan
    """Relative L2 error to the truth."""
    own_error: float = np.nan
    """Relative L2 difference from the double-precision sum over the method's own model."""

    @property
    def minimum(self):
        return min(self.seconds)

    @property
    def median(self):
        return float(np.median(self.seconds))


def plan(name, make):
    start = time.perf_counter()
    method = make()
    entry = Timed(method, time.perf_counter() - start)
    print(f"  {name}: planned in {entry.prepare:.2f} s, {method.describe()}", flush=True)
    return entry


def in_turn(entries, repeat, check):
    """Runs all methods `repeat` times, after a first round that is not timed.

    `check(entry, image)` gets the image of the first round.
    """
    for entry in entries:
        check(entry, entry.method.run())
    for _ in range(repeat):
        for entry in entries:
            start, processor = time.perf_counter(), time.process_time()
            entry.method.run()
            entry.seconds.append(time.perf_counter() - start)
            entry.processor.append(time.process_time() - processor)

"""The benchmark of whole images."""

import inputs as data
import psfield
import table
import timing
from methods import METHODS
from pool import Pool
from reference import Reference
from timing import RIGHT


def load(args):
    """The inputs that the command line asks for."""
    samples = args.samples
    if args.preset:
        args.work.mkdir(parents=True, exist_ok=True)
        samples = args.work / f"{args.preset}-{args.grid}.fits"
        psfield.sample(args.psfield, args.preset, args.grid, samples)
    return data.prepare(args.work, args.size, args.grid, args.seed, args.scene, samples)


def benchmark(args):
    """Returns whether every method agrees with its own model, and the rows of the table."""
    inputs = load(args)
    names = args.methods.split(",") if args.methods else list(METHODS)
    reference = Reference(inputs, args.pixels, args.seed + 1)
    pool = Pool(args.threads)
    entries = [timing.plan(name, lambda name=name: METHODS[name](inputs, pool)) for name in names]

    def check(entry, image):
        entry.error = reference.error(image)
        entry.own_error = reference.error(image, entry.method.own(reference))

    timing.in_turn(entries, args.repeat, check)
    results = table.rows(entries, args.size, args.grid)
    ok = all(row["relative_l2_own_model"] <= RIGHT for row in results)
    unit = next((e.minimum for e in entries if e.method.name == "single"), None)
    # psfield runs in its own process after the peers are removed: their plans fill the memory.
    entries.clear()
    results += psfield.beside(args, unit)
    table.show(
        f"{args.size} x {args.size} pixels, {args.grid} x {args.grid} samples, {args.threads} threads",
        results,
    )
    return ok, results

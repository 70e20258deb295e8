"""Runs psfield's command line on the same files and reads the output of `psfield bench`."""

import json
import os
import subprocess
import tempfile
from pathlib import Path


def offers_bench(binary):
    try:
        return subprocess.run([binary, "bench", "--help"], capture_output=True).returncode == 0
    except OSError:
        return False


def beside(args, unit, method="lowrank"):
    """psfield's rows for the files in the working folder. Prints the reason if there are none."""
    if not args.psfield:
        print("psfield: skipped, no --psfield")
        return []
    if not offers_bench(args.psfield):
        print(f"psfield: skipped, {args.psfield} has no command `bench`")
        return []
    files = args.work / "scene.fits", args.work / "samples.fits"
    return bench(args.psfield, *files, args.threads, args.tolerances.split(","), unit, method)


def bench(binary, scene, samples, threads, tolerances, unit, method):
    """Rows of the table, one per tolerance. `unit` is the time of `single` (s) or `None`."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "bench.json"
        command = [
            binary,
            "bench",
            "--scene",
            scene,
            "--psf",
            samples,
            "--methods",
            method,
            "--tolerances",
            ",".join(tolerances),
        ]
        subprocess.run(
            [*command, "--threads", str(threads), "--json", out],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        found = json.loads(out.read_text())["rows"]
    # The row without a tolerance is psfield's own single PSF, the unit of its ratios.
    return [_row(entry, unit) for entry in found if entry["tolerance"] is not None]


def _row(entry, unit):
    seconds = entry["seconds"]
    return {
        "method": f"psfield {entry['tolerance']:g}",
        "detail": f"{entry['method']}, error as psfield reports it",
        "size": entry["size"],
        "samples": entry.get("samples"),
        "seconds_prepare": entry.get("seconds_plan"),
        "seconds_min": seconds,
        "seconds_median": entry.get("seconds_median"),
        "seconds_processor": None,
        "ratio_to_single": None if unit is None else seconds / unit,
        "relative_l2": entry.get("relative_l2"),
        "relative_l2_own_model": None,
    }


def real(args):
    """The report of `psfield bench --real`. Its table appears on the terminal."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "bench.json"
        groups = "--real" if args.real == "all" else f"--real={args.real}"
        command = [args.psfield, "bench", groups, "--threads", str(args.threads)]
        command += ["--repeat", str(args.repeat), "--seed", str(args.seed), "--json", out]
        command += ["--pixels", str(args.pixels)]
        command += ["--quick"] if args.quick else []
        command += ["--sizes", args.sizes] if args.sizes else []
        # Without the settings of `settle`, with which freed memory stays with the process.
        environment = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_")}
        subprocess.run(command, check=True, env=environment)
        return json.loads(out.read_text())


def sample(binary, preset, grid, out):
    """Samples one of psfield's telescopes on a uniform grid."""
    command = [
        binary,
        "sample",
        "--preset",
        preset,
        "--uniform",
        f"{grid},{grid}",
        "-o",
        out,
        "--overwrite",
        "-q",
    ]
    subprocess.run(command, check=True)

"""Observes a survey of a large camera: seconds, memory, and checks of the frames.

    cargo build --release -p psfield-cli
    python benches/peers/survey.py target/release/psfield FOLDER

18 detectors of 4088 x 4088 pixels, three dithers, 10^5 stars and 10^5 galaxies. `--size 512 --sources 20000` makes a
small one. `--kill N` kills the run N times at random, continues it, and compares the files with those of a run in one
piece. `--sextractor` finds 961 isolated stars on a distorted, turned detector with `source-extractor` (Debian), and
prints how far they are from the table of sources. Needs psfield (Python), astropy and NumPy.
"""

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

sys.path.pop(0)
import numpy as np
import psfield
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS

SCALE, GAP = 0.11, 60
SURVEY = """catalog = "sky.fits"
camera = "camera.toml"
epoch = 2016.0
output = "{folder}/{{exposure}}.fits"
truth_table = "{folder}/{{exposure}}_{{detector}}_sources.fits"
frames = "{folder}/frames.csv"
[simulate]
tolerance = 1e-3
[band.r]
zero_point = 26.5
sky_e_per_s = 0.8
[[pointing]]
ra = 150
dec = 2
rotation_deg = 15
date = "2031-05-17"
band = "r"
exposure_s = 140
dithers_arcsec = [[0, 0], [60, 35], [-40, 70]]
"""
SETTINGS = """photon_noise = true
read_noise_e = 8.0
dark_e_per_s = 0.01
gain_e_per_adu = 1.2
bias_adu = 500
bits = 16
full_well_e = 75000
"""


def write_survey(folder, size, sources):
    """Write the files of a survey."""
    folder.mkdir(parents=True, exist_ok=True)
    model = psfield.PsfModel.from_telescope(
        "survey-2m", field_shape=(size, size), samples=(9, 9), stamp_size=64, oversampling=4
    )
    detectors = ""
    for number in range(18):
        row, column = divmod(number, 6)
        # Detectors have PSFs of their own, so that none shares another's plan.
        model.write(folder / f"psf_{number}.fits", overwrite=True)
        place = [(column - 2.5) * (size + GAP) * SCALE, (row - 1) * (size + GAP) * SCALE]
        detectors += (
            f'[[detector]]\nname = "S{number + 1:02d}"\nshape = [{size}, {size}]\n'
            f'psf = "psf_{number}.fits"\nsettings = "ccd.toml"\n'
            f"geometry = {{ pixel_scale_arcsec = {SCALE}, centre_arcsec = {place},"
            f" rotation_deg = {180 if row == 2 else 0} }}\n"
        )
    (folder / "camera.toml").write_text(detectors)
    (folder / "ccd.toml").write_text(SETTINGS)
    rng = np.random.default_rng(7)
    stars, width, height = sources // 2, *(np.array([3.3, 1.7]) * (size + GAP) * SCALE / 3600)
    is_star = np.arange(sources) < stars
    Table({
        "ra": 150 + rng.uniform(-width, width, sources),
        "dec": 2 + rng.uniform(-height, height, sources),
        "mag": np.where(is_star, rng.uniform(17, 26, sources), rng.uniform(20, 27, sources)),
        "re_arcsec": np.where(is_star, 0, rng.gamma(2, 0.2, sources) + 0.05),
        "n": rng.choice([1.0, 1.0, 1.5, 2.5, 4.0], sources),
        "q": rng.uniform(0.2, 1, sources),
        "pa_deg": rng.uniform(0, 180, sources),
        "pmra": rng.normal(0, 10, sources) * is_star,
        "pmdec": rng.normal(0, 10, sources) * is_star,
        "parallax": rng.exponential(1, sources) * is_star,
    }).write(folder / "sky.fits", overwrite=True)  # fmt: skip
    for name in ("whole", "killed"):
        (folder / f"{name}.toml").write_text(SURVEY.format(folder=name))


def observe(command, folder, name):
    """Start the survey, with a fixed date in its headers."""
    environment = {**os.environ, "SOURCE_DATE_EPOCH": "1800000000"}
    line = [command, "-q", "observe", str(folder / f"{name}.toml")]
    return subprocess.Popen(line, env=environment, stderr=subprocess.DEVNULL)


def check_stars(folder):
    """Print how far isolated stars that source-extractor finds are from the table of sources."""
    size, scale = 1024, 0.2 / 3600
    offsets = np.mgrid[-60:61, -60:61] / 4
    stamps = [(1 + (offsets**2).sum(axis=0) / width**2) ** -3.0 for width in (2.6, 3.1, 2.8, 3.0)]
    corners = [(x, y) for y in (0, size - 1) for x in (0, size - 1)]
    model = psfield.PsfModel.from_samples(stamps, corners, oversampling=4, field_shape=(size, size))
    model.write(folder / "isolated_psf.fits", overwrite=True)
    header = fits.Header({
        "CRPIX1": -200.0, "CRPIX2": 1300.0, "CRVAL1": 0.0, "CRVAL2": 0.0,
        "CD1_1": -scale, "CD1_2": 0.02 * scale, "CD2_1": 0.01 * scale, "CD2_2": scale,
        "CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "A_ORDER": 2, "B_ORDER": 2,
        "A_2_0": 2.1e-6, "A_1_1": 3.0e-6, "B_0_2": 1.7e-6, "B_1_1": -2.0e-6,
    })  # fmt: skip
    detector = {
        "name": "N",
        "shape": [size, size],
        "psf": str(folder / "isolated_psf.fits"),
        "wcs": WCS(header),
        "settings": str(folder / "isolated.toml"),
    }
    (folder / "isolated.toml").write_text(
        "photon_noise = true\nsky_e = 100.0\nread_noise_e = 5.0\n"
    )
    words = {
        "output": str(folder / "isolated_{detector}.fits"),
        "truth_table": str(folder / "isolated_{detector}_table.fits"),
    }
    pointings = [{"ra": 40, "dec": 30, "rotation_deg": 50}]
    empty = {"ra": [1.0], "dec": [1.0], "flux": [1.0]}
    frame = psfield.Survey(empty, [dict(detector)], pointings, **words).frames[0]
    rng = np.random.default_rng(2)
    places = np.mgrid[30 : size - 20 : 32, 30 : size - 20 : 32].reshape(2, -1)
    places = places + rng.uniform(-8, 8, places.shape)
    sky = WCS(fits.Header.fromstring(frame.header)).pixel_to_world(*places)
    stars = {"ra": sky.ra.deg, "dec": sky.dec.deg, "flux": 10 ** rng.uniform(4.3, 5.3, len(sky))}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        psfield.observe(stars, [detector], pointings, overwrite=True, **words)
    (folder / "columns.param").write_text("XWIN_IMAGE\nYWIN_IMAGE\n")
    (folder / "none.conv").write_text("CONV NORM\n1 2 1\n2 4 2\n1 2 1\n")
    subprocess.run(
        ["source-extractor", "isolated_N.fits", "-PARAMETERS_NAME", "columns.param",
         "-FILTER_NAME", "none.conv", "-CATALOG_NAME", "found.cat", "-CATALOG_TYPE", "ASCII_HEAD",
         "-VERBOSE_TYPE", "QUIET"],
        cwd=folder, check=True,
    )  # fmt: skip
    found = Table.read(folder / "found.cat", format="ascii.sextractor")
    truth = Table.read(folder / "isolated_N_table.fits")
    x, y = found["XWIN_IMAGE"] - 1, found["YWIN_IMAGE"] - 1
    far = np.array([np.hypot(x - row["x"], y - row["y"]).min() for row in truth])
    print(f"{len(truth)} stars: distance median {np.median(far):.4f}, most {far.max():.4f} pixels")


def main():
    """Run the survey and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("command")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--size", type=int, default=4088)
    parser.add_argument("--sources", type=int, default=200_000)
    parser.add_argument("--kill", type=int, default=0)
    parser.add_argument("--sextractor", action="store_true")
    asked = parser.parse_args()
    folder = asked.folder
    write_survey(folder, asked.size, asked.sources)
    start = time.perf_counter()
    if observe(asked.command, folder, "whole").wait():
        sys.exit("the survey failed")
    seconds = time.perf_counter() - start
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    print(f"54 frames of {asked.size}^2 pixels: {seconds:.0f} s, at most {memory:.2f} GiB")
    if asked.kill:
        random.seed(1)
        for _ in range(asked.kill):
            run = observe(asked.command, folder, "killed")
            time.sleep(random.uniform(0.1, 2 * seconds / asked.kill))
            run.send_signal(signal.SIGKILL)
            run.wait()
        observe(asked.command, folder, "killed").wait()
        names = sorted(path.name for path in (folder / "whole").iterdir())
        others = sorted(path.name for path in (folder / "killed").iterdir())
        same = all(
            (folder / "whole" / name).read_bytes() == (folder / "killed" / name).read_bytes()
            for name in names
        )
        print(f"killed {asked.kill} times: {'same' if same and names == others else 'other'} bytes")
        print(sorted(set(others) ^ set(names)))
    if asked.sextractor:
        check_stars(folder)


main()

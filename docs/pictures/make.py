"""Make the pictures of the README: a scene, the PSF over the field, and the simulated image.

    cargo build --release -p psfield-cli
    python docs/pictures/make.py target/release/psfield

The scene is a cut of the scene of `psfield demo`. The telescope is that of the demo, with a frame
of 320 x 320 pixels. Needs the standard library only.
"""

import csv
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

#: Pixels of the frame along each axis, and the frame's first pixel in the demo's scene.
SIZE, CORNER = 320, (590, 520)
#: Sides of the PSF stamps in the picture, and their number along each axis.
STAMP, ACROSS = 20, 8


def read_image(path):
    """Return the planes of the primary image of a FITS file, each a list of rows."""
    data, at, cards = path.read_bytes(), 0, {}
    while "END" not in cards:
        for _ in range(36):
            card = data[at : at + 80].decode("ascii")
            at += 80
            cards[card[:8].strip()] = card[10:].split("/")[0].strip()
    kind, size = {"-32": ("f", 4), "-64": ("d", 8)}[cards["BITPIX"]]
    nx, ny, planes = (int(cards.get(f"NAXIS{i}", 1)) for i in (1, 2, 3))
    values = struct.unpack_from(f">{nx * ny * planes}{kind}", data, at)
    rows = [values[row * nx : (row + 1) * nx] for row in range(ny * planes)]
    return [rows[plane * ny : (plane + 1) * ny] for plane in range(planes)]


def write_image(path, rows, zoom):
    """Write rows of equal length as a FITS image, each pixel as zoom x zoom pixels."""
    rows = [[value for value in row for _ in range(zoom)] for row in rows for _ in range(zoom)]
    values = {"SIMPLE": "T", "BITPIX": -32, "NAXIS": 2, "NAXIS1": len(rows[0]), "NAXIS2": len(rows)}
    head = "".join(f"{key:8}= {value:>20}".ljust(80) for key, value in values.items()) + "END"
    body = b"".join(struct.pack(f">{len(row)}f", *row) for row in rows)
    path.write_bytes(head.ljust(2880).encode() + body + b"\0" * (-len(body) % 2880))


def scene_rows(demo):
    """Return the light of the demo in the frame: galaxies, and stars in their nearest pixels."""
    x0, y0 = CORNER
    light = read_image(demo / "scene.fits")[0]
    rows = [list(row[x0 : x0 + SIZE]) for row in light[y0 : y0 + SIZE]]
    with open(demo / "stars.csv", newline="") as table:
        for star in csv.DictReader(table):
            x, y = round(float(star["x"])) - x0, round(float(star["y"])) - y0
            if 0 <= x < SIZE and 0 <= y < SIZE:
                rows[y][x] += float(star["flux"])
    return rows


def mosaic(stamps):
    """Return stamps side by side, the first at the lower left."""
    rows = []
    for first in range(0, ACROSS * ACROSS, ACROSS):
        beside = stamps[first : first + ACROSS]
        rows += [[value for stamp in beside for value in stamp[y]] for y in range(len(stamps[0]))]
    return rows


def main(program):
    """Run the commands, and write the pictures next to this file."""
    folder = Path(__file__).resolve().parent
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)

        def psfield(*arguments):
            subprocess.run([program, *map(str, arguments), "--quiet"], check=True)

        psfield("demo", "--out", work / "demo")
        telescope = (work / "demo" / "telescope.toml").read_text()
        small = telescope.replace("nx = 1024, ny = 1024", f"nx = {SIZE}, ny = {SIZE}")
        (work / "telescope.toml").write_text(small)
        psf, image = work / "samples.fits", work / "image.fits"
        psfield("sample", work / "telescope.toml", "--uniform", "9,9", "-o", psf)
        scene = [work / "demo" / "scene.fits", "--catalog", work / "demo" / "stars.csv"]
        frame = ",".join(map(str, (*CORNER, SIZE, SIZE)))
        psfield("simulate", *scene, "--psf", psf, "--frame", frame, "-o", image)

        step = (SIZE - 1) / (ACROSS - 1)
        places = [(step * i, step * j) for j in range(ACROSS) for i in range(ACROSS)]
        lines = ["x,y", *(f"{x},{y}" for x, y in places)]
        (work / "places.csv").write_text("\n".join(lines) + "\n")
        stamps = work / "stamps.fits"
        places = ["--at", work / "places.csv", "--pixels", "native", "--size", STAMP]
        psfield("evaluate", psf, *places, "-o", stamps)

        write_image(work / "scene_zoomed.fits", scene_rows(work / "demo"), zoom=2)
        write_image(work / "psf_zoomed.fits", mosaic(read_image(stamps)), zoom=4)
        write_image(work / "image_zoomed.fits", read_image(image)[0], zoom=2)
        for name, limits in [("scene", "0,500"), ("psf", "0,0.06"), ("image", "0,500")]:
            zoomed, picture = work / f"{name}_zoomed.fits", folder / f"{name}.png"
            psfield("preview", zoomed, "--range", limits, "-o", picture, "--overwrite")


if __name__ == "__main__":
    main(sys.argv[1])

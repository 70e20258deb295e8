"""Checks what `psfield demo` wrote, with nothing but the standard library."""

import csv
import json
import struct
import sys
from pathlib import Path
from xml.etree import ElementTree


def fits_pixels(path):
    """Shape and values of the primary image of a FITS file of BITPIX -32 or -64."""
    data = path.read_bytes()
    assert len(data) % 2880 == 0, f"{path}: not whole FITS blocks"
    cards, at = {}, 0
    while "END" not in cards:
        for _ in range(36):
            card = data[at : at + 80].decode("ascii")
            at += 80
            cards[card[:8].strip()] = card[10:].split("/")[0].strip()
    shape = [int(cards[f"NAXIS{i}"]) for i in range(int(cards["NAXIS"]), 0, -1)]
    count = 1
    for n in shape:
        count *= n
    kind = {"-32": "f", "-64": "d"}[cards["BITPIX"]]
    size = struct.calcsize(kind)
    return cards, shape, struct.unpack(f">{count}{kind}", data[at : at + count * size])


def main(folder):
    report = json.loads((folder / "report.json").read_text())
    assert sorted(p.name for p in folder.iterdir()) == sorted(report["files"]), "the files are not those listed"

    cards, shape, image = fits_pixels(folder / "image.fits")
    _, scene_shape, scene = fits_pixels(folder / "scene.fits")
    assert shape == scene_shape == [1024, 1024], shape
    assert "HISTORY" in cards and "PSFIELD" in cards, "the image does not say how it was made"
    with open(folder / "stars.csv", newline="") as table:
        stars = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(table)]
    assert len(stars) == report["stars"]
    # The flux is kept except what crosses the frame's edges, both ways.
    inside = sum(s["flux"] for s in stars if 0 <= s["x"] <= 1023 and 0 <= s["y"] <= 1023)
    light = sum(scene) + inside
    assert abs(sum(image) / light - 1) < 0.01, (sum(image), light)

    # The engine keeps every PSF within its default tolerance.
    assert report["spot_check"]["max_over_peak"] < 1e-4, report["spot_check"]
    assert report["model_error_max"] < 0.02, report["model_error_max"]
    assert report["fwhm_px_max"] > 1.3 * report["fwhm_px_min"], "the PSF hardly varies"
    assert report["patch_relative_l2"] > 1e-4, "patches cannot be exact"
    for name in report["files"]:
        if name.endswith(".png"):
            assert (folder / name).read_bytes().startswith(b"\x89PNG\r\n\x1a\n"), name
        if name.endswith(".svg"):
            assert ElementTree.parse(folder / name).getroot().tag.endswith("}svg"), name
    print(f"{folder}: {len(report['files'])} files as they should be")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

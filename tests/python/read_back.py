"""Compares stamps of a PSFEx model (GalSim) and a gridded library (photutils) with psfield's.

Usage: read_back.py MODEL.psf MODEL_STAMPS.fits LIBRARY.fits LIBRARY_STAMPS.fits

The stamps are PSF samples: a cube and a table POSITIONS (0-based pixels), values not scaled.
Prints the largest error over the peak of each, as JSON: {"galsim": ..., "photutils": ...}.
"""

import json
import sys

import galsim
import galsim.des
import numpy as np
from astropy.io import fits
from photutils.psf import GriddedPSFModel


def samples(path):
    with fits.open(path) as hdus:
        table = hdus["POSITIONS"].data
        return hdus[0].data.astype(float), table["X"].astype(float), table["Y"].astype(float), hdus[0].header


def largest_error(found, truth):
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(found, truth, strict=True))


def by_galsim(path, stamps):
    truth, x, y, header = samples(stamps)
    model = galsim.des.DES_PSFEx(path)
    assert abs(model.getSampleScale() * header["OVERSAMP"] - 1) < 1e-12
    # FITS pixels count from 1. GalSim's reference point is the middle of the array, as psfield's.
    assert header["CENX"] == (truth.shape[2] - 1) / 2 and header["CENY"] == (truth.shape[1] - 1) / 2
    found = [model.getPSFArray(galsim.PositionD(px + 1, py + 1)) for px, py in zip(x, y, strict=True)]
    return largest_error(found, truth)


def by_photutils(path, stamps):
    truth, x, y, header = samples(stamps)
    model = GriddedPSFModel.read(path, format="webbpsf")
    oversampling = header["OVERSAMP"]
    assert np.all(np.asarray(model.oversampling) == oversampling)
    rows, columns = np.mgrid[: truth.shape[1], : truth.shape[2]]
    dx, dy = (columns - header["CENX"]) / oversampling, (rows - header["CENY"]) / oversampling
    found = [model.evaluate(px + dx, py + dy, 1.0, px, py) for px, py in zip(x, y, strict=True)]
    return largest_error(found, truth)


if __name__ == "__main__":
    psfex, psfex_stamps, library, library_stamps = sys.argv[1:]
    errors = {"galsim": by_galsim(psfex, psfex_stamps), "photutils": by_photutils(library, library_stamps)}
    print(json.dumps(errors))

"""Simulate the frame described by a PSFEx file and a SExtractor catalogue.

    python psfex_and_catalog.py [FOLDER]

Needs astropy. The example first makes the two files, ``stars.psf`` and ``stars.cat`` in FOLDER
(default: ``output/psfex_and_catalog`` next to this file). If you have such files, start at
`simulate`. It writes ``image.fits``, the counts of a CCD, and ``truth.fits``, the image without
noise.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

import psfield
from psfield.detector import Detector

SHAPE = (1000, 800)
#: The magnitude of a source of flux 1, in the unit of the image.
ZERO_POINT = 25.0
SEED = 3


def make_psfex_file(path: Path) -> None:
    """Write a PSFEx model: a Moffat profile with a width that is a polynomial of degree 2."""
    oversampling = 2
    dy, dx = np.mgrid[-25:26, -25:26] / oversampling

    def stamp(x: float, y: float) -> NDArray[np.float64]:
        fwhm = 2.8 + 0.8 * ((x - 400) / 400) ** 2 + 0.3 * (y - 500) / 500
        return (1 + (dx**2 + dy**2) * 4 * (2 ** (1 / 3) - 1) / fwhm**2) ** -3

    positions = [
        (x, y) for y in np.linspace(0, SHAPE[0] - 1, 5) for x in np.linspace(0, SHAPE[1] - 1, 5)
    ]
    model = psfield.PsfModel.from_samples(
        [stamp(x, y) for x, y in positions], positions, field_shape=SHAPE, oversampling=oversampling
    )
    model.write(path, format="psfex", degree=2, overwrite=True)


def make_catalogue(path: Path) -> None:
    """Write stars like SExtractor with ``CATALOG_TYPE FITS_LDAC``. The first pixel is 1."""
    rng = np.random.default_rng(SEED)
    count = 400
    objects = fits.BinTableHDU.from_columns(
        [
            fits.Column("NUMBER", "J", array=np.arange(1, count + 1)),
            fits.Column("X_IMAGE", "D", unit="pixel", array=rng.uniform(30, SHAPE[1] - 30, count)),
            fits.Column("Y_IMAGE", "D", unit="pixel", array=rng.uniform(30, SHAPE[0] - 30, count)),
            fits.Column("MAG_AUTO", "E", unit="mag", array=rng.uniform(14, 20, count)),
        ],
        name="LDAC_OBJECTS",
    )
    card = np.array([["SIMPLE  =                    T".ljust(80)]])
    frame = fits.BinTableHDU.from_columns(
        [fits.Column("Field Header Card", "80A", array=card[0])], name="LDAC_IMHEAD"
    )
    fits.HDUList([fits.PrimaryHDU(), frame, objects]).writeto(path, overwrite=True)


def simulate(
    psf: Path, catalogue: Path
) -> tuple[psfield.PsfModel, dict[str, NDArray[np.float64]], NDArray[np.float32]]:
    """Return the model, the stars and the image of two files."""
    # The planes and the polynomial are used as stored. Between the pixels of the stamps PSFEx
    # models are interpolated by Lanczos-3, as in GalSim.
    model = psfield.PsfModel.read(psf)
    for note in model.notes:
        print(note)

    # The role of each column. Positions become 0-based and magnitudes become fluxes.
    stars = psfield.read_catalog(
        catalogue, columns="x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO", one_based=True, zero_point=ZERO_POINT
    )
    return model, stars, model.plan(SHAPE).simulate(catalog=stars)


def main(folder: Path) -> None:
    """Run the example and write its files to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    psf, catalogue = folder / "stars.psf", folder / "stars.cat"
    make_psfex_file(psf)
    make_catalogue(catalogue)

    model, stars, image = simulate(psf, catalogue)
    header = fits.Header([("MAGZERO", ZERO_POINT, "magnitude of flux 1")])
    fits.writeto(folder / "truth.fits", image, header, overwrite=True)

    # Sky and read noise are in electrons. Equal seeds give equal frames.
    ccd = Detector(
        photon_noise=True,
        sky_e=200,
        read_noise_e=5,
        full_well_e=90_000,
        gain_e_per_adu=1.5,
        bias_adu=300,
        bits=16,
    )
    exposure = ccd.expose(image, seed=SEED)
    counts = exposure.counts.astype(np.uint16)
    fits.writeto(folder / "image.fits", counts, header, overwrite=True)
    saturated = exposure.report.saturated_pixels
    print(f"counts from {counts.min()} to {counts.max()}, {saturated} pixels saturated")

    # Photometry: the light within 10 pixels of isolated stars, compared with their magnitudes.
    apart = np.hypot(*(np.subtract.outer(stars[axis], stars[axis]) for axis in "xy"))
    np.fill_diagonal(apart, np.inf)
    isolated = np.flatnonzero(apart.min(axis=1) > 25)
    y, x = np.indices(SHAPE)
    measured = [
        image[np.hypot(x - stars["x"][i], y - stars["y"][i]) < 10].sum(dtype=float)
        for i in isolated
    ]
    faint = -2.5 * np.log10(np.array(measured) / stars["flux"][isolated])
    print(
        f"{len(stars['x'])} stars, {len(isolated)} of them isolated: within 10 pixels they are"
        f" {np.median(faint):.3f} mag fainter than in total"
    )

    # The PSF of a star depends on its position.
    for at in [(400, 500), (0, 0), (799, 999)]:
        peak = model.evaluate(*at, pixels="frame").max()
        print(f"brightest pixel of a star at {at}: {100 * peak:.2f} % of its light")


if __name__ == "__main__":
    main(
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parent / "output" / Path(__file__).stem
    )

"""Which image of a file a job takes, and the header of the frame that it writes."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("dask")
fits, wcs = (pytest.importorskip(f"astropy.{name}") for name in ("io.fits", "wcs"))

from psfield.dask._fits import FitsFiles  # noqa: E402
from psfield.dask._job import scene_of, shape_without_reading  # noqa: E402

SETTINGS = {
    "anchor": "source", "scene_pixels": "point", "precision": "f32", "tolerance": 1e-3,
    "tolerance_on": "aperture",
    "floor": 0.0,
}  # fmt: skip


def written(path, *hdus):
    """Write images to a file: the primary is empty, unless one is a PrimaryHDU."""
    first = () if hdus and isinstance(hdus[0], fits.PrimaryHDU) else (fits.PrimaryHDU(),)
    fits.HDUList([*first, *hdus]).writeto(path)
    return path


def test_the_image_of_a_file(tmp_path):
    plane, other = np.ones((4, 5)), np.zeros((6, 7))
    primary = written(tmp_path / "a.fits", fits.PrimaryHDU(plane), fits.ImageHDU(other, name="DQ"))
    only = written(tmp_path / "b.fits", fits.ImageHDU(plane, name="SCI"))
    two = written(
        tmp_path / "c.fits", fits.ImageHDU(plane, name="SCI"), fits.ImageHDU(other, name="DQ")
    )
    for job in (
        {"scene": primary},
        {"scene": only},
        {"scene": two, "extension": "SCI"},
        {"scene": two, "extension": 1},
    ):
        pixels, _ = scene_of(job)
        assert pixels.shape == shape_without_reading(job) == (4, 5), job
    with pytest.raises(OSError, match=r"c.fits: the file has 2 images \(1 SCI, 2 DQ\).*extension"):
        scene_of({"scene": two})
    with pytest.raises(OSError, match=r"c.fits: there is no extension 'ERR'"):
        scene_of({"scene": two, "extension": "ERR"})
    with pytest.raises(OSError, match=r"d.fits: the file has no images"):
        scene_of({"scene": written(tmp_path / "d.fits")})
    with pytest.raises(OSError, match=r"e.fits: .* is not an image \[y, x\]"):
        scene_of({"scene": written(tmp_path / "e.fits", fits.PrimaryHDU(np.ones((2, 3, 4))))})


@pytest.mark.parametrize("distorted", [False, True], ids=["TAN", "TAN-SIP"])
def test_the_header_of_a_finer_scene_is_carried(tmp_path, distorted):
    kind = "-SIP" if distorted else ""
    header = fits.Header({"CTYPE1": "RA---TAN" + kind, "CTYPE2": "DEC--TAN" + kind})
    header.update({"CRPIX1": 50.0, "CRPIX2": 40.0, "CRVAL1": 150.0, "CRVAL2": 2.0})
    header.update({"CD1_1": -1e-4, "CD2_2": 1e-4, "OBJECT": "M 51"})
    if distorted:
        header.update({"A_ORDER": 2, "B_ORDER": 2, "A_2_0": 1e-5, "B_0_2": -2e-5})
    settings = {**SETTINGS, "oversample": 4, "frame": (3, 2, 10, 8)}
    path = str(tmp_path / "frame.fits")
    FitsFiles("mark", settings).write(path, {"image": np.zeros((8, 10))}, {}, header)
    found = fits.getheader(path)
    assert found["OBJECT"] == "M 51"
    # Pixel (x, y) of the image is centred at (4 (x + 3) + 1.5, 4 (y + 2) + 1.5) of the scene.
    of_image = wcs.WCS(found).all_pix2world([[6.0, 5.0]], 0)
    of_scene = wcs.WCS(header).all_pix2world([[4 * 9 + 1.5, 4 * 7 + 1.5]], 0)
    assert np.abs(of_image - of_scene).max() < 1e-11

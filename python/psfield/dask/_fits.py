"""Frames as FITS files."""

from __future__ import annotations

import os
import re
import socket
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from psfield import _native

#: Keywords that are not copied from the scene: those of its storage, and those of this module.
_OWN = re.compile(
    r"SIMPLE|XTENSION|BITPIX|NAXIS\d*|EXTEND|PCOUNT|GCOUNT|GROUPS|EXTNAME|EXTVER|EXTLEVEL|INHERIT"
    r"|BSCALE|BZERO|BLANK|DATAMIN|DATAMAX|CHECKSUM|DATASUM|PSFIELD|PSFCMD|PSFTOL|PSFTOLON|PSFFLOOR|PSFDROP."
    r"|PSFANCH|PSFSCPIX|PSFPREC|PSFSEED|PSFMETH|PSFDEV|PSFRANK|PSFNORM|PSFJOB|PSFCHK."
)
#: Name of an unfinished file: the output, the batch, the machine and the process.
_UNFINISHED = re.compile(r"\.(.+)\.psfield-[0-9a-f]{12}-.+-\d+")


@dataclass(frozen=True)
class FitsFiles:
    """One file per frame. The image is first, additional output is in extensions named after it.

    ``mark`` is part of the names of the unfinished files of this batch.
    """

    mark: str
    settings: dict[str, Any]

    def write(
        self, path: str, frames: Mapping[str, Any], job: Mapping[str, Any], header: Any
    ) -> None:
        """Write a file. No partial file is left if that fails."""
        from astropy.io import fits

        (_, image), *others = frames.items()
        extensions = (fits.ImageHDU(array, name=name.upper()) for name, array in others)
        hdus = fits.HDUList([fits.PrimaryHDU(image), *extensions])
        for hdu in hdus:
            if hdu is hdus[0] or hdu.data.shape == np.shape(image):
                self._carry(header, hdu.header)
        self._sign(hdus[0].header, job)
        folder, name = os.path.split(path)
        os.makedirs(folder, exist_ok=True)
        unfinished = os.path.join(
            folder, f".{name}.{self.mark}-{socket.gethostname()}-{os.getpid()}"
        )
        try:
            with open(unfinished, "wb") as file:
                hdus.writeto(file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(unfinished, path)
        except BaseException:
            if os.path.exists(unfinished):
                os.remove(unfinished)
            raise

    def remove_unfinished(self, outputs: Collection[str]) -> None:
        """Remove unfinished files of these outputs that killed workers left, in any batch."""
        for folder in {os.path.dirname(path) for path in outputs}:
            if not os.path.isdir(folder):
                continue
            with os.scandir(folder) as entries:
                names = [(entry.name, _UNFINISHED.fullmatch(entry.name)) for entry in entries]
            for name, match in names:
                if match and os.path.join(folder, match[1]) in outputs:
                    os.remove(os.path.join(folder, name))

    def _carry(self, scene: Any, header: Any) -> None:
        """Copy the cards of the scene, with the world coordinates of the image's pixels."""
        if scene is None:
            return
        from astropy.io import fits

        first = (0, 0) if self.settings["frame"] is None else self.settings["frame"][:2]
        text = scene.tostring(sep="", endcard=False, padding=False)
        moved = fits.Header.fromstring(
            _native.image_cards(text, first, self.settings["oversample"]), sep=""
        )
        for card in moved.cards:
            if card.keyword and not _OWN.fullmatch(card.keyword):
                header.append(card, end=True)

    def _sign(self, header: Any, job: Mapping[str, Any]) -> None:
        """Write how the image was made."""
        header["PSFIELD"] = (_native.__version__, "version of psfield that made this image")
        header["PSFANCH"] = (self.settings["anchor"], "PSF is that of the source or output pixel")
        header["PSFSCPIX"] = (self.settings["scene_pixels"], "light in the scene's pixels")
        header["PSFPREC"] = (self.settings["precision"], "working precision")
        allowed = "relative L2 error allowed for any pixel's PSF"
        header["PSFTOL"] = (self.settings["tolerance"], allowed)
        on = "aperture: tolerance bounds flux in circles too"
        header["PSFTOLON"] = (self.settings["tolerance_on"], on)
        if self.settings["floor"] > 0:
            header["PSFFLOOR"] = (self.settings["floor"], "floor of sources, flux per pixel")
        if job.get("seed") is not None:
            header["PSFSEED"] = (int(job["seed"]), "seed of the scene and of the noise")
        with warnings.catch_warnings():
            # Long keywords become HIERARCH cards.
            warnings.simplefilter("ignore")
            for keyword, value in job.get("header", {}).items():
                header[keyword] = value

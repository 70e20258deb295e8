"""Positions on the sky, by the world coordinates of astropy and gwcs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from psfield import _native
from psfield._astropy import cards_of


class Sky(NamedTuple):
    """World coordinates of an image.

    ``wcs`` is an object of astropy (``WCS``) or of gwcs, for the pixels of a scene that is
    ``oversample`` times finer than the image. Its first pixel is pixel ``first`` (x, y) of the
    whole scene.
    """

    wcs: Any
    oversample: int = 1
    first: tuple[int, int] = (0, 0)

    def pixels(self, place: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return x and y, in 0-based pixels of the image, of a ``SkyCoord``.

        A pair (right ascension, declination) in degrees is in the celestial frame of the world
        coordinates. Both are NaN where the projection has no pixel.
        """
        if isinstance(place, tuple):
            place = _coordinates(place, self.wcs)
        try:
            pixels = self.wcs.world_to_pixel(place)
        except Exception as error:
            # Astropy's NoConvergence: sources so far off that the distortion cannot be inverted.
            if not hasattr(error, "best_solution"):
                raise
            solution = np.array(error.best_solution, dtype=float)
            for rows in (error.divergent, error.slow_conv):  # type: ignore[attr-defined]
                if rows is not None:
                    solution[rows] = np.nan
            pixels = (solution[:, 0], solution[:, 1])
        x, y = (
            (np.asarray(axis, dtype=float) + start + 0.5) / self.oversample - 0.5
            for axis, start in zip(pixels, self.first, strict=True)
        )
        return x, y

    def cards(self) -> str:
        """Return the cards of a header with these world coordinates of the image."""
        if not self.has_cards():
            raise TypeError(
                f"wcs: a file of sources needs an astropy WCS, not {type(self.wcs).__name__}: read"
                " the table with astropy, and give the table"
            )
        if self._has_tables():
            raise ValueError(
                "wcs: its distortion is a table (CPDIS or D2IMDIS), which a file of sources cannot"
                " use: read the table with astropy, and give the table"
            )
        x0, y0 = (-start / self.oversample for start in self.first)
        return _native.image_cards(cards_of(self.wcs), (x0, y0), self.oversample)

    def known_cards(self) -> str | None:
        """Return the cards if psfield itself knows these world coordinates, else None."""
        if not self.has_cards() or self._has_tables():
            return None
        cards = self.cards()
        return cards if _native.knows_sky(cards) else None

    def degrees(self, place: Any) -> tuple[Any, Any]:
        """Return longitude and latitude of a ``SkyCoord`` in the frame of the world coordinates."""
        from astropy.wcs.utils import wcs_to_celestial_frame

        angles = place.transform_to(wcs_to_celestial_frame(self.wcs)).spherical
        return angles.lon.deg, angles.lat.deg

    def has_cards(self) -> bool:
        """Return whether a header can hold these world coordinates."""
        return hasattr(self.wcs, "to_header")

    def _has_tables(self) -> bool:
        tables = ("cpdis1", "cpdis2", "det2im1", "det2im2")
        return any(getattr(self.wcs, table, None) is not None for table in tables)


class FrameSky(NamedTuple):
    """World coordinates of a file, as the text of its cards."""

    text: str

    def has_cards(self) -> bool:
        """Return whether a header can hold these world coordinates."""
        return True

    def cards(self) -> str:
        """Return the cards."""
        return self.text

    def known_cards(self) -> str | None:
        """Return the cards if psfield itself knows these world coordinates, else None."""
        return self.text if _native.knows_sky(self.text) else None

    def pixels(self, place: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Refuse positions on the sky, whose pixels psfield does not know."""
        raise ValueError(
            "catalog: its positions are on the sky, but psfield does not know the world coordinates"
            " of the frame: give positions in pixels"
        )

    def degrees(self, place: Any) -> tuple[Any, Any]:
        """Return longitude and latitude of a ``SkyCoord`` in the frame of the world coordinates."""
        from astropy.io.fits import Header
        from astropy.wcs import WCS

        return Sky(WCS(Header.fromstring(self.text))).degrees(place)


def sky_of(scene: Any, wcs: Any, oversample: int, first: tuple[int, int]) -> Sky | None:
    """Return the world coordinates that are given for an image, or else those of its scene.

    ``first`` is the first pixel (x, y) of the scene, if that is a part of the whole scene.
    """
    if wcs is not None:
        return wcs if isinstance(wcs, Sky) else Sky(wcs)
    own = getattr(scene, "wcs", None)
    return None if own is None else Sky(own, oversample, first)


def is_sky(values: Any) -> bool:
    """Return whether values are a ``SkyCoord``."""
    return hasattr(values, "transform_to") and hasattr(values, "spherical")


def _coordinates(place: tuple[Any, Any], wcs: Any) -> Any:
    from astropy.coordinates import SkyCoord
    from astropy.wcs import WCS
    from astropy.wcs.utils import wcs_to_celestial_frame

    frame = wcs_to_celestial_frame(wcs) if isinstance(wcs, WCS) else "icrs"
    return SkyCoord(*place, unit="deg", frame=frame)

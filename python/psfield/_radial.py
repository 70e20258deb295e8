"""Light profiles that are known as tables of brightness by radius."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: The half-light radius of a Gaussian, in standard deviations.
_HALF_LIGHT = math.sqrt(2 * math.log(2))
#: Ratios of neighbouring standard deviations, tried in turn until the sum is close enough.
_RATIOS = (2.0, 1.7, 1.5, 1.4, 1.3, 1.2, 1.1, 1.05, 1.02, 1.01)
#: Brightness below this fraction of the mean does not weigh more in the fit.
_FAINT = 0.1


class RadialProfile:
    """A galaxy's light from a table of brightness by radius, as a sum of Gaussians.

    Sources of a catalogue are stars and galaxies with Sersic profiles. A profile of another kind
    enters as a few Gaussians with the same centre, which are galaxies with ``n = 0.5``: see
    `catalog`. So it works wherever a catalogue does, with spectra, velocities and on the command
    line.

    The Gaussians have positive fluxes, and their sum fits the table (a multi-Gaussian expansion:
    Emsellem, Monnet and Bacon 1994, A&A 285, 723). This suits light that falls with the radius,
    without a sharp edge, as that of galaxies does.

    Parameters
    ----------
    radius : array_like
        Increasing radii in pixels, from 0 or larger, of at least three points. Within the first
        point, the light is about constant. Beyond the last one it soon ends.
    brightness : array_like
        The brightness at each radius, 0 or larger, in any unit.
    tolerance : float
        The largest allowed `deviation`, from 1e-6 to 1.

    Attributes
    ----------
    sigma : ndarray
        The standard deviations of the Gaussians, in pixels.
    fraction : ndarray
        The fraction of the flux in each Gaussian. The sum is 1.
    deviation : float
        The sum over the table of the absolute difference between the Gaussians and the table, each
        weighted with its area, as a fraction of the flux.

    Raises
    ------
    ValueError
        If the table is not valid, or if no sum of Gaussians is as close to it.

    Examples
    --------
    A modified Hubble profile:

    >>> import numpy as np
    >>> import psfield
    >>> radius = np.geomspace(0.1, 30, 60)
    >>> hubble = psfield.RadialProfile(radius, (1 + (radius / 2) ** 2) ** -1.5)
    >>> hubble.deviation < 1e-4
    True
    >>> catalog = hubble.catalog(x=[30.2, 71.0], y=[40.0, 22.5], flux=[500.0, 900.0], q=0.6)
    >>> round(catalog["flux"].sum())
    1400
    """

    sigma: NDArray[np.float64]
    fraction: NDArray[np.float64]
    deviation: float

    def __init__(
        self, radius: ArrayLike, brightness: ArrayLike, *, tolerance: float = 1e-4
    ) -> None:
        radii, table = _checked(radius, brightness)
        if not 1e-6 <= tolerance <= 1:
            raise ValueError(f"tolerance must be from 1e-6 to 1, got {tolerance}")
        # The areas of the rings between the midpoints of the radii.
        edges = np.concatenate([radii[:1] * 0, (radii[1:] + radii[:-1]) / 2, radii[-1:]])
        area = np.pi * np.diff(edges**2)
        flux = float(table @ area)
        weight = np.sqrt(area / np.maximum(table, _FAINT * flux / area.sum()))
        smallest = radii[radii > 0][0] / 4
        best = math.inf
        for ratio in _RATIOS:
            count = 1 + math.ceil(math.log(radii[-1] / smallest) / math.log(ratio))
            sigma = smallest * ratio ** np.arange(count)
            shapes = np.exp(-0.5 * (radii[:, np.newaxis] / sigma) ** 2)
            peaks = _positive_solution(shapes * weight[:, np.newaxis], table * weight)
            deviation = float(np.abs(shapes @ peaks - table) @ area) / flux
            if deviation < best:
                best = deviation
                fluxes = peaks * sigma**2
                kept = fluxes > 0
                self.sigma, self.fraction = sigma[kept], fluxes[kept] / fluxes.sum()
                self.deviation = deviation
            if best <= tolerance:
                return
        raise ValueError(
            f"brightness: the closest sum of Gaussians differs from the table by {best:.1e} of its "
            f"flux, more than the tolerance of {tolerance:g}: allow a larger tolerance, give more "
            "points, or draw a profile with a sharp edge as an image"
        )

    def __repr__(self) -> str:
        return f"<RadialProfile: {len(self.sigma)} Gaussians, deviation {self.deviation:.1e}>"

    def catalog(
        self,
        x: ArrayLike,
        y: ArrayLike,
        flux: ArrayLike,
        *,
        q: ArrayLike = 1.0,
        angle: ArrayLike = 0.0,
        scale: ArrayLike = 1.0,
        **columns: ArrayLike,
    ) -> dict[str, Any]:
        """Return the rows of a catalogue with galaxies of this profile.

        Each galaxy has a row for each Gaussian, one galaxy after the other.

        Parameters
        ----------
        x, y, flux : array_like
            Positions and total fluxes of the galaxies.
        q, angle : array_like
            Minor over major axis, and the angle of the major axis in degrees from +x towards +y.
            Radii of the table are those along the major axis.
        scale : array_like
            The factor by which the radii of the table are multiplied.
        **columns : array_like
            Further columns for each galaxy, such as ``g1`` and ``g2``, ``sed`` or ``teff``, ``vx``
            and ``vy``.

        Returns
        -------
        dict
            The columns x, y, flux, re, n, q, angle and the further ones.

        Raises
        ------
        ValueError
            If columns have different lengths.

        Examples
        --------
        >>> import numpy as np
        >>> import psfield
        >>> radius = np.linspace(0, 20, 81)
        >>> disc = psfield.RadialProfile(radius, np.exp(-radius / 2))
        >>> catalog = disc.catalog([10, 20], [15, 15], [100, 300], q=0.5, sed=["red", "blue"])
        >>> len(catalog["x"]) == 2 * len(disc.sigma)
        True
        """
        given = {"x": x, "y": y, "flux": flux, "q": q, "angle": angle, "scale": scale, **columns}
        shared = {name: np.atleast_1d(np.asarray(column)) for name, column in given.items()}
        galaxies = shared["x"].size
        for name, column in shared.items():
            if column.shape not in ((1,), (galaxies,)):
                raise ValueError(
                    f"{name} must be one value or one for each of {galaxies} galaxies, "
                    f"got shape {column.shape}"
                )
        rows = {
            name: np.repeat(np.broadcast_to(column, galaxies), len(self.sigma))
            for name, column in shared.items()
        }
        rows["flux"] = rows["flux"] * np.tile(self.fraction, galaxies)
        rows["re"] = rows.pop("scale") * np.tile(_HALF_LIGHT * self.sigma, galaxies)
        rows["n"] = np.full(len(rows["re"]), 0.5)
        return rows


def _checked(
    radius: ArrayLike, brightness: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the columns of a table, or raise an error."""
    radii, table = (np.array(column, dtype=np.float64) for column in (radius, brightness))
    if radii.ndim != 1 or len(radii) < 3 or table.shape != radii.shape:
        raise ValueError(
            "radius and brightness must be two lists of the same three or more points, got shapes "
            f"{radii.shape} and {table.shape}"
        )
    if not (np.isfinite(radii).all() and radii[0] >= 0 and (np.diff(radii) > 0).all()):
        raise ValueError("radius must increase from 0 or larger, and be finite")
    if not (np.isfinite(table).all() and (table >= 0).all() and table.any()):
        raise ValueError("brightness must be finite, 0 or larger, and not 0 everywhere")
    return radii, table


def _positive_solution(
    matrix: NDArray[np.float64], target: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the ``x >= 0`` for which ``matrix @ x`` is closest to the target.

    The method of Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23.
    """
    x = np.zeros(matrix.shape[1])
    active = np.zeros(len(x), dtype=bool)
    enough = 1e-12 * np.abs(matrix.T @ target).max()
    for _ in range(3 * len(x)):
        gain = np.where(active, -np.inf, matrix.T @ (target - matrix @ x))
        if gain.max() <= enough:
            break
        active[np.argmax(gain)] = True
        while True:
            solution = np.zeros(len(x))
            solution[active] = np.linalg.lstsq(matrix[:, active], target, rcond=None)[0]
            negative = active & (solution <= 0)
            if not negative.any():
                break
            # As far towards the solution as all values stay positive. The first to end leaves.
            steps = np.full(len(x), np.inf)
            steps[negative] = x[negative] / (x[negative] - solution[negative])
            step = steps.min()
            x += step * (solution - x)
            active &= steps > step
            x[~active] = 0.0
        x = solution
    return x

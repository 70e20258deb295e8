"""Plots of images, PSFs and plans, with matplotlib.

matplotlib is an optional package (``pip install matplotlib``), imported only when a function here
is called. Every function draws into the axes that it is given, or into a new figure, and returns
the axes. Axes count 0-based pixels, from the bottom to the top.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from psfield._arrays import check_real, plain, shape_of
from psfield._choices import boolean, choice
from psfield.metrics import compare, measure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from psfield._model import PsfModel
    from psfield._plan import Plan
    from psfield._survey import Survey

__all__ = [
    "plot_focal_plane",
    "plot_image",
    "plot_plan",
    "plot_psf_field",
    "plot_residuals",
    "plot_shapes",
]

#: The asinh scale of images is linear up to this part of their range, or up to their noise.
FAINTEST_OF_IMAGE = 1e-4
#: The asinh scale of PSFs is linear up to this part of the highest peak.
FAINTEST_OF_PSF = 1e-3
#: Positions of a default grid.
PSFS, WHISKERS = 49, 240
#: Part of a cell of the grid that a stamp or the longest whisker takes.
FILLED = 0.9
#: Whiskers get no longer if all ellipticities are below this value, so that round PSFs look round.
LEAST_ELLIPTICITY = 0.01


def plot_focal_plane(
    survey: Survey,
    *,
    exposures: list[str] | None = None,
    catalog: Any = None,
    ax: Axes | None = None,
) -> Axes:
    """Show where the detectors of a survey are on the sky.

    Each exposure has a colour, and the detectors of the first one have their names. The plane is
    tangent to the sky at the middle of the frames, with north up and east to the left.

    Parameters
    ----------
    survey : psfield.Survey
        The survey.
    exposures : list of str, optional
        Names of exposures. By default all.
    catalog : table, optional
        Sources with columns ``ra`` and ``dec`` (degrees), shown as dots.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into. By default those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> import psfield
    >>> from psfield import plot
    >>> detector = {"name": "N", "shape": [40, 30], "psf": "psf.fits"}
    >>> detector["geometry"] = {"pixel_scale_arcsec": 0.5}
    >>> survey = psfield.Survey("sky.csv", [detector], [{"ra": 10, "dec": 20}], "{exposure}.fits")
    >>> ax = plot.plot_focal_plane(survey)
    >>> [text.get_text() for text in ax.texts]
    ['N']
    >>> plt.close(ax.figure)
    """
    frames = [frame for frame in survey.frames if exposures is None or frame.exposure in exposures]
    if not frames:
        raise ValueError(f"exposures: the survey has none of {exposures}")
    corners = np.array([frame.corners_deg for frame in frames])
    # The mean direction, which a mean of right ascensions is not at 0 or at a pole.
    x, y, z = _directions(corners[..., 0], corners[..., 1]).reshape(3, -1).mean(axis=1)
    centre = np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arctan2(z, np.hypot(x, y)))
    if ax is None:
        ax = _pyplot().subplots(figsize=(6.4, 5.8), layout="constrained")[1]
    if catalog is not None:
        east, north = _tangent(np.asarray(catalog["ra"]), np.asarray(catalog["dec"]), centre)
        ax.plot(east, north, ".", color="0.75", markersize=2, zorder=0)
    names = list(dict.fromkeys(frame.exposure for frame in sorted(frames, key=lambda f: f.seed)))
    first = {frame.exposure: frame for frame in reversed(frames)}
    east, north = _tangent(corners[..., 0], corners[..., 1], centre)
    for frame, along, across in zip(frames, east, north, strict=True):
        colour = f"C{names.index(frame.exposure) % 10}"
        around = np.append(along, along[0]), np.append(across, across[0])
        label = frame.exposure if frame is first[frame.exposure] else None
        ax.plot(*around, color=colour, linewidth=1, label=label)
        # The first corner is the first pixel.
        ax.plot(along[0], across[0], "o", color=colour, markersize=3)
        if frame.exposure == names[0]:
            ax.text(along.mean(), across.mean(), frame.detector, ha="center", va="center")
    span_x, span_y = np.ptp(east), np.ptp(north)
    ax.set(
        xlabel="towards east (arcmin)",
        ylabel="towards north (arcmin)",
        aspect="equal",
        title=f"RA {centre[0]:.4f}, Dec {centre[1]:+.4f}",
        xlim=(east.max() + 0.05 * span_x, east.min() - 0.05 * span_x),
        ylim=(north.min() - 0.05 * span_y, north.max() + 0.05 * span_y),
    )
    if len(names) > 1:
        ax.legend(fontsize="small", title="exposure")
    return ax


def _directions(ra: NDArray[np.float64], dec: NDArray[np.float64]) -> NDArray[np.float64]:
    ra, dec = np.radians(ra), np.radians(dec)
    return np.array([np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)])


def _tangent(
    ra: NDArray[np.float64], dec: NDArray[np.float64], centre: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return offsets towards east and north in arcminutes, on the plane that touches the centre."""
    ra0, dec0 = np.radians(centre)
    ra, dec = np.radians(ra) - ra0, np.radians(dec)
    forward = np.sin(dec0) * np.sin(dec) + np.cos(dec0) * np.cos(dec) * np.cos(ra)
    forward = np.where(forward > 0, forward, np.nan)
    east = np.cos(dec) * np.sin(ra) / forward
    north = (np.cos(dec0) * np.sin(dec) - np.sin(dec0) * np.cos(dec) * np.cos(ra)) / forward
    return 60 * np.degrees(east), 60 * np.degrees(north)


def plot_image(
    image: Any,
    *,
    ax: Axes | None = None,
    stretch: Literal["asinh", "linear"] = "asinh",
    colorbar: bool = True,
) -> Axes:
    """Show an image in grey.

    The scale begins one standard deviation of the noise below the sky and ends at the brightest
    pixel. The sky is the median. The noise is estimated by the median absolute deviation from it.

    Parameters
    ----------
    image : array_like, astropy CCDData or Quantity
        ``[y, x]``. Pixels that are not finite stay empty.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into. By default those of a new figure.
    stretch : {'asinh', 'linear'}
        Scale of the grey values. ``asinh`` is linear up to twice the noise above the sky, or up to
        1e-4 of the range if that is more, and logarithmic for brighter pixels.
    colorbar : bool
        Add a colour bar, with the unit of the image if it has one.

    Returns
    -------
    matplotlib.axes.Axes

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> import numpy as np
    >>> from psfield import plot
    >>> image = np.random.default_rng(1).normal(100, 5, (40, 60))
    >>> image[20, 30] = 9000
    >>> ax = plot.plot_image(image)
    >>> ax.get_xlabel(), ax.images[0].get_array().shape
    ('x (pixels)', (40, 60))
    >>> plt.close(ax.figure)
    """
    pixels, unit = _pixels(image, "image"), getattr(image, "unit", None)
    choice(stretch, "stretch", ("asinh", "linear"))
    boolean(colorbar, "colorbar")
    ax = _axes(ax, pixels.shape[::-1])
    norm, ticks = _scale(pixels, stretch)
    shown = ax.imshow(pixels, origin="lower", cmap="gray", norm=norm, interpolation="nearest")
    if colorbar:
        bar = ax.figure.colorbar(shown, ax=ax, label="" if unit is None else str(unit))
        _set_ticks(bar, ticks)
    return _labelled(ax)


def plot_psf_field(
    model: PsfModel,
    *,
    shape: tuple[int, int] | None = None,
    grid: tuple[int, int] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Show the PSFs at a grid of positions, each at its own position.

    All stamps have one grey scale, which is linear up to a thousandth of the highest peak and
    logarithmic above. They are magnified to fill the cells of the grid. The title says how much.

    Parameters
    ----------
    model : PsfModel
        The model of the PSF.
    shape : (int, int), optional
        Rows and columns of the frame. By default the field of the model or, if the model does not
        state it, the range of its positions.
    grid : (int, int), optional
        Rows and columns of the grid. By default about 49 positions in cells that are nearly square.
    ax : matplotlib.axes.Axes, optional
        As for `plot_image`.

    Returns
    -------
    matplotlib.axes.Axes

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> import psfield
    >>> narrow, wide = [[0, 1, 0], [1, 4, 1], [0, 1, 0]], [[1, 2, 1], [2, 4, 2], [1, 2, 1]]
    >>> model = psfield.PsfModel.from_samples([narrow, wide], [(0, 50), (199, 50)])
    >>> ax = psfield.plot.plot_psf_field(model, shape=(100, 200), grid=(2, 4))
    >>> len(ax.images), ax.get_title()
    (8, 'PSFs, magnified 15 times')
    >>> plt.close(ax.figure)
    """
    first, length = _extent(model, shape)
    x, y, cell = _positions(first, length, grid, PSFS)
    stamps = model.evaluate(x, y)
    peak = stamps.max()
    ny, nx = model.stamp_shape
    # Distances from the source to the edges of a stamp, in frame pixels.
    left, bottom = ((centre + 0.5) / model.oversampling for centre in model.centre)
    right, top = nx / model.oversampling - left, ny / model.oversampling - bottom
    half = np.array([max(left, right), max(bottom, top)])
    scale = float((FILLED * cell / (2 * half)).min())
    ax = _axes(ax, length)
    from matplotlib.colors import AsinhNorm

    norm = AsinhNorm(linear_width=FAINTEST_OF_PSF, vmin=0, vmax=1)
    for column, row, stamp in zip(x, y, stamps, strict=True):
        shown = ax.imshow(
            stamp / peak,
            extent=(
                column - scale * left,
                column + scale * right,
                row - scale * bottom,
                row + scale * top,
            ),
            origin="lower",
            cmap="gray",
            norm=norm,
            interpolation="nearest",
        )
    bar = ax.figure.colorbar(shown, ax=ax, label="relative to the highest peak")
    _set_ticks(bar, np.array([0, 1e-3, 1e-2, 1e-1, 1]))
    _show_field(ax, first, length)
    ax.set_title(f"PSFs, magnified {scale:.3g} times")
    return _labelled(ax)


def plot_shapes(
    model: PsfModel,
    *,
    shape: tuple[int, int] | None = None,
    grid: tuple[int, int] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Show the shapes of the PSFs at a grid of positions as whiskers.

    A whisker has the direction of the major axis. Its length is the ellipticity ``(a**2 - b**2) /
    (a**2 + b**2)`` of an ellipse with axes ``a >= b``, from the adaptive moments. A key shows the
    scale. A round PSF is a dot. The colour is the FWHM of a fitted Gaussian. PSFs are measured on
    the pixels of their stamps, by `psfield.metrics.measure`. A grey cross marks a PSF that could
    not be measured. Oversampled stamps avoid that, because pixels as wide as the PSF hide its
    shape.

    Parameters
    ----------
    model : PsfModel
        The model of the PSF.
    shape : (int, int), optional
        As for `plot_psf_field`.
    grid : (int, int), optional
        Rows and columns of the grid. By default about 240 positions in cells that are nearly
        square.
    ax : matplotlib.axes.Axes, optional
        As for `plot_image`.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        The field is not known, or no PSF could be measured. The text says why.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> import numpy as np
    >>> import psfield
    >>> v, u = np.mgrid[-8:9, -8:9]
    >>> stamps = [np.exp(-(u**2 / (8 + 2 * i) + v**2 / 8)) for i in range(2)]
    >>> model = psfield.PsfModel.from_samples(stamps, [(0, 50), (199, 50)], noise=0)
    >>> ax = psfield.plot.plot_shapes(model, shape=(100, 200), grid=(3, 6))
    >>> len(ax.collections[0].get_offsets())
    18
    >>> plt.close(ax.figure)
    """
    first, length = _extent(model, shape)
    x, y, cell = _positions(first, length, grid, WHISKERS)
    found = measure(model.evaluate(x, y))
    size, fwhm = found["ellipticity"], found["fwhm_px"] / model.oversampling
    angle = np.arctan2(found["e2"], found["e1"]) / 2
    measured = np.isfinite(size) & np.isfinite(angle) & np.isfinite(fwhm)
    if not measured.any():
        raise ValueError(f"no PSF could be measured: {found['note'][0]}")
    longest = max(float(size[measured].max()), LEAST_ELLIPTICITY)
    size, angle = size[measured], angle[measured]
    ax = _axes(ax, length)
    whiskers = ax.quiver(
        x[measured],
        y[measured],
        size * np.cos(angle),
        size * np.sin(angle),
        fwhm[measured],
        angles="xy",
        scale_units="xy",
        scale=longest / (FILLED * float(cell.min())),
        pivot="mid",
        headwidth=0,
        headlength=0,
        headaxislength=0,
        width=0.005,
        minlength=1.5,
        cmap="viridis",
    )
    ax.plot(x[~measured], y[~measured], "x", color="grey")
    # The scale of the key: the largest of 1, 2 and 5 times a power of ten in the longest whisker.
    power = 10 ** np.floor(np.log10(longest))
    key = power * max(step for step in (1, 2, 5) if step * power <= longest)
    # The key lies in the second line of the title, for which the layout has room.
    right = 0.01 + key / longest * FILLED * float(cell.min()) / length[0]
    height = ax.get_window_extent().height / ax.figure.dpi
    above = 1 + 0.11 / height
    ax.quiverkey(whiskers, right, above, key, f"|e| = {key:g}", labelpos="E", color="black")
    ax.figure.colorbar(whiskers, ax=ax, label="FWHM of a Gaussian fit (pixels)")
    _show_field(ax, first, length)
    ax.set_title("PSF shapes\n", loc="left")
    return _labelled(ax)


def plot_residuals(image: Any, reference: Any, *, axes: Any = None) -> Any:
    """Show an image, its reference, and their difference.

    Image and reference have the scale of the reference (`plot_image`). The title of the difference
    is the relative L2 error, and the largest difference divided by the peak of the reference
    (`psfield.metrics.compare`).

    Parameters
    ----------
    image, reference : array_like, astropy CCDData or Quantity
        Finite arrays ``[y, x]`` of the same shape and unit.
    axes : sequence of matplotlib.axes.Axes, optional
        Three axes to draw into. By default those of a new figure.

    Returns
    -------
    sequence of matplotlib.axes.Axes
        The three axes.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> import numpy as np
    >>> from psfield import plot
    >>> reference = np.full((20, 30), 2.0)
    >>> axes = plot.plot_residuals(reference + 0.01, reference)
    >>> print(axes[2].get_title())
    difference
    relative L2: 5.0e-03
    largest / peak: 5.0e-03
    >>> plt.close(axes[2].figure)
    """
    pixels, truth = _pixels(image, "image"), _pixels(reference, "reference")
    unit, of_truth = (getattr(of, "unit", None) for of in (image, reference))
    if unit != of_truth:
        raise ValueError(f"image has the unit {unit}, but reference has {of_truth}")
    errors = compare(pixels, truth)
    if axes is None:
        axes = _new_axes(truth.shape[::-1], 3)
    if np.shape(axes) != (3,):
        raise ValueError(f"axes must be three axes, got {axes!r}")
    norm, ticks = _scale(truth, "asinh")
    limit = errors.max_abs or 1.0
    label = "" if unit is None else str(unit)
    panels = (
        ("image", pixels, {"cmap": "gray", "norm": norm}),
        ("reference", truth, {"cmap": "gray", "norm": norm}),
        ("difference", pixels - truth, {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}),
    )
    for ax, (title, values, colours) in zip(axes, panels, strict=True):
        shown = ax.imshow(values, origin="lower", interpolation="nearest", **colours)
        bar = ax.figure.colorbar(shown, ax=ax, label=label)
        if title != "difference":
            _set_ticks(bar, ticks)
        _labelled(ax).set_title(title)
    relative, largest = (
        "undefined" if error is None else f"{error:.1e}"
        for error in (errors.relative_l2, errors.max_over_peak)
    )
    axes[2].set_title(f"difference\nrelative L2: {relative}\nlargest / peak: {largest}")
    return axes


def plot_plan(plan: Plan, *, ax: Axes | None = None) -> Axes:
    """Show the blocks of a plan, coloured by their numbers of modes.

    Where the PSF varies strongly, a block needs more modes to reach the tolerance, and blocks may
    be smaller. The time of a simulation grows with the modes. A dashed line shows the image, if it
    is only a part of the scene.

    Parameters
    ----------
    plan : Plan
        The plan.
    ax : matplotlib.axes.Axes, optional
        As for `plot_image`.

    Returns
    -------
    matplotlib.axes.Axes
        In pixels of the scene.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> import psfield
    >>> model = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    >>> ax = psfield.plot.plot_plan(model.plan((40, 60), tolerance=1e-3))
    >>> ax.get_title()
    'blocks: 1, modes per block: 1.00 (mean)'
    >>> plt.close(ax.figure)
    """
    blocks = plan.blocks
    modes = blocks["modes"]
    left, bottom = blocks["x0"] - 0.5, blocks["y0"] - 0.5
    right, top = left + blocks["nx"], bottom + blocks["ny"]
    corners = np.stack([left, bottom, right, bottom, right, top, left, top], axis=-1)
    ax = _axes(ax, plan.shape[::-1])
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import BoundaryNorm
    from matplotlib.patches import Rectangle

    fewest, most = int(modes.min()), int(modes.max())
    shown = PolyCollection(
        list(corners.reshape(-1, 4, 2)),
        array=modes,
        norm=BoundaryNorm(np.arange(fewest, most + 2) - 0.5, 256),
        cmap="viridis",
        edgecolor="white",
        linewidth=0.5,
    )
    ax.add_collection(shown)
    bar = ax.figure.colorbar(shown, ax=ax, label="modes")
    _set_ticks(bar, np.arange(fewest, most + 1, 1 + (most - fewest) // 10))
    finer = plan._settings["oversample"]
    x0, y0, ny, nx = (finer * n for n in (*plan._shown(None), *plan.image_shape))
    if (x0, y0, ny, nx) != (0, 0, *plan.shape):
        corner = (x0 - 0.5, y0 - 0.5)
        ax.add_patch(Rectangle(corner, nx, ny, fill=False, edgecolor="red", linestyle="--"))
    ny, nx = plan.shape
    _show_field(ax, np.zeros(2), np.array([nx, ny], float))
    ax.set_title(f"blocks: {len(blocks)}, modes per block: {modes.mean():.2f} (mean)")
    return _labelled(ax, "pixels of the scene")


def _pyplot() -> Any:
    """Return matplotlib's pyplot."""
    try:
        from matplotlib import pyplot
    except ImportError as error:
        message = "psfield.plot needs matplotlib: pip install matplotlib"
        raise ImportError(message, name="matplotlib") from error
    return pyplot


def _axes(ax: Any, length: Any) -> Any:
    """Return the given axes, or those of a new figure with room for columns and rows."""
    return _new_axes(length, 1) if ax is None else ax


def _new_axes(length: Any, count: int) -> Any:
    """Return axes in a row, in a new figure of a height that suits their columns and rows."""
    columns, rows = length
    # In inches, with room for labels, title and colour bar.
    width, beside, above = (6.4, 1.9, 0.9) if count == 1 else (4.6, 1.7, 1.5)
    height = min(max((width - beside) * rows / columns + above, 2.4), 9.0)
    size = (width * count, height)
    return _pyplot().subplots(1, count, figsize=size, layout="constrained")[1]


def _labelled(ax: Axes, unit: str = "pixels") -> Axes:
    """Return axes with labels, and with squares for pixels."""
    ax.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})", aspect="equal")
    return ax


def _show_field(ax: Any, first: NDArray[np.float64], length: NDArray[np.float64]) -> None:
    """Set the limits of axes to a field that begins at a pixel ``(x, y)``."""
    (left, bottom), (right, top) = first - 0.5, first - 0.5 + length
    ax.set(xlim=(left, right), ylim=(bottom, top))


def _pixels(image: Any, name: str) -> NDArray[np.float64]:
    """Return the pixels of an image. Unlike those of a scene they need not be finite."""
    pixels = plain(image, name)
    check_real(pixels, name)
    if pixels.ndim != 2 or pixels.size == 0:
        raise ValueError(f"{name} must be an array [y, x], got one of shape {pixels.shape}")
    return pixels.astype(np.float64)


def _scale(pixels: NDArray[np.float64], stretch: str) -> tuple[Any, NDArray[np.float64]]:
    """Return the scale of an image for matplotlib, and values for its colour bar."""
    from matplotlib.colors import FuncNorm, Normalize

    known = pixels[np.isfinite(pixels)]
    sky = float(np.median(known)) if known.size else 0.0
    noise = 1.4826 * float(np.median(np.abs(known - sky))) if known.size else 0.0
    most = float(known.max(initial=sky))
    least = max(sky - noise, float(known.min(initial=sky)))
    if most <= least:
        most = least + max(1.0, abs(least))
    if stretch == "linear":
        return Normalize(least, most), _rounded(np.linspace(least, most, 6))
    width = max(2 * noise, FAINTEST_OF_IMAGE * (most - least))

    def forward(values: Any) -> Any:
        return np.arcsinh((values - sky) / width)

    def inverse(values: Any) -> Any:
        return sky + width * np.sinh(values)

    ticks = inverse(np.linspace(forward(least), forward(most), 6))
    return FuncNorm((forward, inverse), vmin=least, vmax=most), _rounded(ticks)


def _rounded(ticks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ascending values with as few digits as their differences need, within their range."""
    gaps = np.diff(ticks)
    nearest = np.minimum([*gaps, gaps[-1]], [gaps[0], *gaps])
    step = 10.0 ** np.floor(np.log10(nearest) - 1)
    rounded = np.rint(ticks / step)
    rounded[0], rounded[-1] = np.ceil(ticks[0] / step[0]), np.floor(ticks[-1] / step[-1])
    values: NDArray[np.float64] = rounded * step
    return values


def _set_ticks(bar: Any, ticks: NDArray[Any]) -> None:
    bar.set_ticks(ticks, labels=[f"{tick + 0.0:.10g}" for tick in ticks], minor=False)
    bar.minorticks_off()


def _extent(
    model: PsfModel, shape: tuple[int, int] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the first pixel of a field, and its columns and rows."""
    shape = model.field_shape if shape is None else shape_of(shape, "shape")
    if shape is not None:
        return np.zeros(2), np.array(shape[::-1], float)
    first, last = model.positions.min(axis=0), model.positions.max(axis=0)
    if not (last > first).all():
        raise ValueError("the model does not state its field: give shape=(ny, nx)")
    return first, last - first + 1


def _positions(
    first: NDArray[np.float64],
    length: NDArray[np.float64],
    grid: tuple[int, int] | None,
    count: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y of the centres of a grid of cells, and columns and rows of a cell."""
    if grid is None:
        columns, rows = np.maximum(1, np.rint(length * np.sqrt(count / length.prod()))).astype(int)
    else:
        rows, columns = shape_of(grid, "grid")
    cell = length / (columns, rows)
    row, column = np.indices((rows, columns)).reshape(2, -1)
    x, y = (first[i] - 0.5 + cell[i] * (of + 0.5) for i, of in enumerate((column, row)))
    return x, y, cell

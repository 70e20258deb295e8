"""Which interpolation over the field for which samples? A contest against the truth.

    python benches/python/interpolators.py [--quick] [DOCS]

Writes ``interpolators.json`` (all errors) and ``interpolators.svg`` to DOCS (default: ``docs``),
and the tables of ``interpolators.md`` there. Needs psfield, GalSim and Matplotlib. Takes about 20
minutes on two cores, 1 minute with ``--quick`` (fewer samples and fields).

Each field can be drawn at any position, so the truth is known. Samples lie at random positions,
like stars. The corners of the field are among them. Errors are those of PSFs at 300 other
positions.
"""

from __future__ import annotations

import argparse
import functools
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import psfield
import psfield.metrics

SHAPE = (1024, 1024)
SIZE, TESTS, SEED = 48, 300, 11
COUNTS = (16, 64, 250, 1000)
METHODS = (
    "auto",
    "kriging",
    "natural-neighbour",
    "delaunay",
    "idw",
    "polynomial=2",
    "polynomial=4",
    "polynomial=6",
    "polynomial=8",
    "nearest",
)
#: A polynomial needs this many samples for each of its terms.
SAMPLES_PER_TERM = 1.2

Array = NDArray[np.float64]
Draw = Callable[[float, float], Array]

_v, _u = np.mgrid[-SIZE // 2 : SIZE // 2, -SIZE // 2 : SIZE // 2] / (SIZE / 6.4)
_APERTURE = (np.hypot(_u, _v) <= 1) & (np.hypot(_u, _v) > 0.3)


def telescope(strength: float, bump: Callable[[float, float], float] | None = None) -> Draw:
    """Return the PSF of a telescope whose aberrations (waves) grow with ``strength``.

    Focus, coma and astigmatism are polynomials of degree 1 to 3 of the field position. ``bump``
    adds focus in places.
    """

    def draw(x: float, y: float) -> Array:
        fx, fy = (x - 511.5) / 511.5, (y - 511.5) / 511.5
        r2 = _u**2 + _v**2
        focus = 0.06 * (fx**2 + fy**2) + 0.03 * fx + 0.03 * fx * fy**2
        focus += 0.0 if bump is None else bump(x, y) / strength
        coma = 0.1 * (3 * r2 - 2) * (fx * _u + (fy + 0.3 * fx**2) * _v)
        astigmatism = (fx**2 - fy**2 + 0.4 * fx) * (_u**2 - _v**2) + 4 * (fx * fy + 0.2) * _u * _v
        wave = strength * (focus * (2 * r2 - 1) + coma + 0.06 * astigmatism)
        pupil = np.fft.fft2(_APERTURE * np.exp(2j * np.pi * wave))
        psf = np.fft.fftshift(np.abs(pupil) ** 2)
        return np.asarray(psf / psf.sum())

    return draw


def roman() -> Draw:
    """Return Roman's PSF in H158 on detector 7, drawn by GalSim at twice the pixels' sampling."""
    import galsim
    import galsim.roman

    def draw(x: float, y: float) -> Array:
        place = galsim.PositionD(1 + 4 * x * 1021.75 / 1023, 1 + 4 * y * 1021.75 / 1023)
        psf = galsim.roman.getPSF(7, "H158", SCA_pos=place, wavelength=1580.0, pupil_bin=8)
        image = psf.drawImage(nx=SIZE, ny=SIZE, scale=0.055, method="no_pixel", dtype=float)
        return np.asarray(image.array / image.array.sum())

    return draw


def step(x: float, y: float) -> float:
    """Return the focus (waves) of four chips at different heights."""
    return 0.06 * (x > 511.5) - 0.04 * (y > 511.5)


def hot_spot(x: float, y: float) -> float:
    """Return the focus (waves) of a bump that covers 3 % of the field."""
    return 0.15 * float(np.exp(-((x - 640) ** 2 + (y - 380) ** 2) / (2 * 70.0**2)))


#: Each field, and the signal to noise of its samples (None: no noise).
FIELDS: dict[str, tuple[Callable[[], Draw], float | None]] = {
    "Roman H158": (roman, None),
    "smooth telescope": (functools.partial(telescope, 1.0), None),
    "out of alignment": (functools.partial(telescope, 4.0), None),
    "steps between chips": (functools.partial(telescope, 1.0, step), None),
    "hot spot": (functools.partial(telescope, 1.0, hot_spot), None),
    "stars of S/N 20": (functools.partial(telescope, 2.0), 20.0),
    "stars of S/N 60": (functools.partial(telescope, 2.0), 60.0),
    "stars of S/N 200": (functools.partial(telescope, 2.0), 200.0),
}


def with_noise(stamps: Array, signal_to_noise: float, rng: np.random.Generator) -> Array:
    """Add white noise: the norm of a stamp is ``signal_to_noise`` times it, up to a factor of 2.

    The flux of a star counts as known: the noise of a stamp has the sum 0.
    """
    norms = np.linalg.norm(stamps, axis=(1, 2), keepdims=True)
    sigma = norms / signal_to_noise * np.exp(rng.uniform(-0.7, 0.7, (len(stamps), 1, 1)))
    noise = rng.normal(size=stamps.shape)
    return np.asarray(stamps + sigma * (noise - noise.mean(axis=(1, 2), keepdims=True)))


def shapes(stamps: Array) -> tuple[Array, Array]:
    """Return the complex ellipticity (distortion) and the size of stamps, by adaptive moments."""
    found = np.full((len(stamps), 2), np.nan, dtype=complex)
    for row, stamp in zip(found, stamps, strict=True):
        try:
            moments = psfield.metrics.adaptive_moments(stamp)
        except ValueError:
            continue  # No moments: a PSF that is far off.
        row[:] = moments.e1 + 1j * moments.e2, moments.sigma
    return found[:, 0], found[:, 1].real


def errors(stamps: Array, positions: Array, method: str, at: Array, truth: Array) -> dict[str, Any]:
    """Return the errors of one method."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", psfield.PsfieldWarning)
        model = psfield.PsfModel.from_samples(
            stamps, positions, field_shape=SHAPE, interpolation=method, normalise="keep"
        )
        found = model.evaluate(*at.T)
        report = model.fit_report()
    norms = np.linalg.norm(truth, axis=(1, 2))
    l2 = np.linalg.norm(found - truth, axis=(1, 2)) / norms
    (e, size), (e_true, size_true) = shapes(found), shapes(truth)
    return {
        "l2_median": float(np.median(l2)),
        "l2_99": float(np.quantile(l2, 0.99)),
        "ellipticity_median": float(np.nanmedian(np.abs(e - e_true))),
        "size_median": float(np.nanmedian(np.abs(size / size_true - 1))),
        "interpolation": model.interpolation.split("=")[0],
        "rank": model.rank,
        "leave_one_out": None if report is None else report.leave_one_out.median,
    }


def contest(fields: list[str], counts: tuple[int, ...]) -> list[dict[str, Any]]:
    """Run the contest. Return one row for each field, number of samples and method."""
    rows = []
    corners = [(0, 0), (1023, 0), (0, 1023), (1023, 1023)]
    for name in fields:
        make, signal_to_noise = FIELDS[name]
        draw, rng = make(), np.random.default_rng(SEED)
        places = np.concatenate([corners, rng.uniform(0, 1023, (max(counts) - 4, 2))])
        at = rng.uniform(20, 1003, (TESTS, 2))
        every = np.array([draw(x, y) for x, y in places])
        truth = np.array([draw(x, y) for x, y in at])
        if signal_to_noise is not None:
            every = with_noise(every, signal_to_noise, rng)
        for count in counts:
            for method in METHODS:
                degree = int(method.split("=")[1]) if "=" in method else 0
                if SAMPLES_PER_TERM * (degree + 1) * (degree + 2) / 2 > count:
                    continue
                found = errors(every[:count], places[:count], method, at, truth)
                rows.append({"field": name, "samples": count, "method": method} | found)
                print(f"{name:20} {count:5} {method:18} {found['l2_median']:.1e}", flush=True)
    return rows


def tables(rows: list[dict[str, Any]], counts: tuple[int, ...]) -> str:
    """Return the tables of the page: for each field the methods by number of samples."""
    text = []
    for name in dict.fromkeys(row["field"] for row in rows):
        of_field = [row for row in rows if row["field"] == name]
        text += [f"### {name}", "", "| interpolation | " + " | ".join(map(str, counts)) + " |"]
        text.append("|---" * (len(counts) + 1) + "|")
        best = {n: min(r["l2_median"] for r in of_field if r["samples"] == n) for n in counts}
        for method in METHODS:
            cells = []
            for count in counts:
                found = [r for r in of_field if (r["samples"], r["method"]) == (count, method)]
                if not found:
                    cells.append("")
                    continue
                row = found[0]
                cell = (
                    f"{row['l2_median']:.1e} / {row['ellipticity_median']:.0e}"
                    f" / {row['size_median']:.0e}"
                )
                cells.append(f"**{cell}**" if row["l2_median"] <= 1.05 * best[count] else cell)
            text.append(f"| {method} | " + " | ".join(cells) + " |")
        text.append("")
    return "\n".join(text)


def picture(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the errors against the number of samples."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.rcParams["svg.hashsalt"] = "psfield"
    names = list(dict.fromkeys(row["field"] for row in rows))
    columns = 4
    figure, axes = plt.subplots(
        -(-len(names) // columns), columns, figsize=(11, 5.6), sharex=True, layout="constrained"
    )
    colours = dict(zip(METHODS[1:], plt.get_cmap("tab10").colors, strict=False))
    for name, ax in zip(names, axes.flat, strict=False):
        for method in [*METHODS[1:], "auto"]:
            of_method = [r for r in rows if (r["field"], r["method"]) == (name, method)]
            x, y = [r["samples"] for r in of_method], [r["l2_median"] for r in of_method]
            if method == "auto":
                ax.loglog(x, y, "o", color="k", mfc="none", ms=9, label="auto (default)")
            else:
                ax.loglog(x, y, "-", marker=".", lw=1.2, color=colours[method], label=method)
        ax.set_title(name, fontsize=10)
        ax.grid(alpha=0.3)
    for ax in np.atleast_2d(axes)[-1]:
        ax.set_xlabel("samples")
    for ax in np.atleast_2d(axes)[:, 0]:
        ax.set_ylabel("error of the PSF, median")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    most = max((ax.get_legend_handles_labels() for ax in axes.flat), key=lambda h: len(h[1]))
    handles, labels = most
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=9)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Run the contest and write its files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer samples and fields")
    parser.add_argument("docs", nargs="?", type=Path, default=Path("docs"), metavar="DOCS")
    asked = parser.parse_args()
    fields = list(FIELDS)
    counts = COUNTS
    if asked.quick:
        fields, counts = ["smooth telescope", "steps between chips", "stars of S/N 60"], (16, 64)
    rows = contest(fields, counts)
    asked.docs.mkdir(parents=True, exist_ok=True)
    (asked.docs / "interpolators.json").write_text(json.dumps(rows, indent=1) + "\n")
    picture(rows, asked.docs / "interpolators.svg")
    page = asked.docs / "interpolators.md"
    if page.exists():
        begin, end = "<!-- tables -->\n", "<!-- end of tables -->"
        before, rest = page.read_text().split(begin)
        after = rest.split(end)[1]
        page.write_text(before + begin + "\n" + tables(rows, counts) + "\n" + end + after)


if __name__ == "__main__":
    main()

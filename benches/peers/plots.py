"""Plots of the benchmark of real work: cost against pixels, against light and sources, and of what is skipped."""

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator

# Okabe and Ito's colours, which colour-blind readers can tell apart.
COLOURS = "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00"
MARKERS = "osD^v"
SCATTERED = {"color": COLOURS[4], "marker": MARKERS[4]}
ONE_PSF = {"label": "psfield, one PSF", "color": "#777777", "linestyle": ":", "marker": "."}
DRAWN = {
    "label": "psfield, all drawn as light",
    "color": "#56B4E9",
    "linestyle": "--",
    "marker": "s",
}
SHOT = {
    "label": "psfield, all photon by photon",
    "color": "#E69F00",
    "linestyle": "--",
    "marker": "^",
}
PEERS = {
    "fftconvolve": ("scipy fftconvolve, one PSF", "black"),
    "galsim": ("GalSim", "#0072B2"),
    "photutils": ("photutils", "#009E73"),
}
FIGURES = {
    "cost_with_sources": ("light", "stars", "galaxies"),
    "cost_of_bright_and_faint": ("floor", "wings", "starphotons", "galaxyphotons"),
}
"""The groups of each figure, one panel each."""
TITLES = {
    "wings": "wings of 1023 pixels",
    "starphotons": "exposures of $10^5$ stars",
    "galaxyphotons": "exposures of $10^5$ galaxies",
}
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "psfield",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "lines.markersize": 5,
}


def draw(rows, folder):
    """Writes `cost_with_pixels.svg`, `cost_with_sources.svg` and `cost_of_bright_and_faint.svg`, if there are rows for
    them."""
    groups = {}
    for row in rows:
        groups.setdefault(row["group"], []).append(row)
    with plt.rc_context(STYLE):
        if "pixels" in groups:
            save(pixels(groups["pixels"]), folder / "cost_with_pixels.svg")
        for name, of_figure in FIGURES.items():
            panels = [group for group in of_figure if group in groups]
            if panels:
                save(amounts(panels, groups), folder / f"{name}.svg")


def pixels(rows):
    figure, panels = plt.subplots(1, 2, figsize=(9, 5), sharey=True, layout="constrained")
    sides = sorted({row["size"][0] for row in rows})
    first = ("seconds_model", "seconds_plan", "seconds_first")
    for axes, title, keys in zip(
        panels, ("first frame, with model and plan", "further frames"), (first, ("seconds",))
    ):
        for psf, colour, marker in zip(unique(row["psf"] for row in rows), COLOURS, MARKERS):
            own = sorted((row["size"][0], total(row, keys)) for row in rows if row["psf"] == psf)
            axes.plot(*zip(*own), color=colour, marker=marker, label=f"psfield: {psf}")
        for key, style in ("seconds_single", ONE_PSF), ("seconds_peer", peer("fftconvolve")):
            least = [min(row[key] for row in rows if row["size"][0] == side) for side in sides]
            axes.plot(sides, least, **style)
        axes.set(title=title, xscale="log", yscale="log", xlabel="side of the frame (pixels)")
        axes.set_xticks(sides, map(str, sides))
        axes.minorticks_off()
    panels[0].set_ylabel("time (s)")
    legend(figure, panels[:1])
    return figure


def amounts(groups, rows_of):
    figure, panels = plt.subplots(
        1, len(groups), figsize=(1 + 3.6 * len(groups), 4.6), squeeze=False, layout="constrained"
    )
    for axes, group in zip(panels[0], groups):
        rows = sorted(rows_of[group], key=lambda row: row["amount"])
        amount = [row["amount"] for row in rows]

        def line(*keys, rows=rows, amount=amount, axes=axes, **style):
            axes.plot(amount, [total(row, keys) for row in rows], **style)

        first = {
            "label": "psfield, first frame, with model and plan",
            "linestyle": "-.",
            "mfc": "white",
        }
        line("seconds_model", "seconds_plan", "seconds_first", **SCATTERED, **first)
        line("seconds", label="psfield, further frames", **SCATTERED)
        if rows[0]["seconds_single"] is not None:
            line("seconds_single", **ONE_PSF)
        if group.endswith("photons"):
            line("seconds_simpler", **DRAWN)
            line("seconds_photons", **SHOT)
        line("seconds_peer", **peer(rows[0]["peer"]))
        frame = " x ".join(map(str, rows[0]["size"]))
        axes.set(title=f"{TITLES.get(group, group)}\n{frame} pixels", yscale="log")
        if group == "light":
            # 0 % has a place on this axis.
            axes.set_xscale("symlog", linthresh=0.1, linscale=0.5)
            axes.set_xlim(-0.03, 150)
            axes.set_xticks(amount, [f"{value:g}" for value in amount])
            axes.set_xlabel("pixels with light (%)")
        elif group == "floor":
            axes.set_xscale("symlog", linthresh=0.01, linscale=0.5)
            axes.set_xlim(-0.003, 20)
            axes.set_xticks(amount, [f"{value:g}" for value in amount])
            axes.set_xlabel("floor (flux per pixel), fluxes of 1 to $10^6$")
        elif group == "wings":
            axes.set_xticks(amount, [f"{value:g}" for value in amount])
            axes.set_xlabel("stamps of the wings")
        elif group.endswith("photons"):
            axes.set_xscale("log")
            axes.set_xticks(amount, [f"{value:g}" for value in amount])
            axes.set_xlabel("photons of each source")
        else:
            axes.set_xscale("log")
            axes.set_xlabel(f"number of {group}")
        axes.minorticks_off()
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
    panels[0][0].set_ylabel("time (s)")
    legend(figure, panels[0])
    return figure


def peer(name):
    """The style of a peer."""
    label, colour = PEERS[name]
    return {"label": label, "color": colour, "linestyle": "--", "marker": "x"}


def total(row, keys):
    return sum(row[key] for key in keys)


def unique(values):
    return list(dict.fromkeys(values))


def legend(figure, panels):
    """One legend below the panels."""
    entries = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles))
    figure.legend(
        entries.values(), entries.keys(), loc="outside lower center", ncols=3, frameon=False
    )


def save(figure, path):
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)

"""Make the pictures at the tops of pages.

    cargo build --release -p psfield-cli
    PYTHONPATH=python python docs/pictures/make_pages.py target/release/psfield [NAME ...]

Each function makes one picture, NAME.png. Without a NAME, all are made. Charts take their numbers
from the tables of their pages. Images are made by psfield, from the files of `psfield demo`. Needs
the packages of docs/requirements.txt.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from astropy.io import fits
from matplotlib.colors import LogNorm
from matplotlib.patches import FancyBboxPatch, Rectangle
from PIL import Image

import psfield

mpl.use("Agg")
plt.rcParams.update({"font.size": 9, "axes.titlesize": 10, "image.origin": "lower"})

PICTURES = Path(__file__).resolve().parent
ROOT = PICTURES.parents[1]
DEMO = Path("psfield-demo")
#: Pixels of the demo's frame along each axis, and a part of it with stars and galaxies.
SIZE, PART = 1024, (slice(520, 840), slice(590, 910))


def read_table(page, heading):
    """Return the first table after a heading, as lists of text."""
    text = (ROOT / page).read_text(encoding="utf-8")
    section = text[re.search(f"^#+ {heading}$", text, re.M).end() :]
    lines = re.search(r"^\|.*\n\| ?---.*\n((?:\|.*\n)+)", section, re.M)[1].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def numbers(cells):
    """Return the last number of each cell: the largest where a cell has "90 % / largest"."""
    return [float(re.findall(r"[\d.]+(?:e-?\d+)?", cell)[-1]) for cell in cells]


def show(ax, image, title, top=500.0):
    """Draw light on an asinh scale from 0 to ``top``."""
    ax.imshow(np.arcsinh(np.asarray(image) / top * 30), cmap="gray", vmin=0, vmax=np.arcsinh(30))
    ax.set(title=title, xticks=[], yticks=[])


def psf_sheet(model, across, down, size=20):
    """Return PSFs at positions over the demo's field side by side, each over the largest peak."""
    step_x, step_y = (SIZE - 1) / max(across - 1, 1), (SIZE - 1) / max(down - 1, 1)
    x, y = np.meshgrid(step_x * np.arange(across), step_y * np.arange(down))
    stamps = model.evaluate(x.ravel(), y.ravel(), pixels="frame", size=size)
    sheet = stamps.reshape(down, across, *stamps.shape[1:]).transpose(0, 2, 1, 3)
    return sheet.reshape(down * stamps.shape[1], -1) / stamps.max()


def scene_of_the_demo():
    """Return the light of the demo: galaxies, and stars in their nearest pixels."""
    scene = fits.getdata(DEMO / "scene.fits").astype(float)
    stars = np.genfromtxt(DEMO / "stars.csv", delimiter=",", names=True)
    x, y = (np.rint(stars[axis]).astype(int) for axis in "xy")
    seen = (x >= 0) & (x < SIZE) & (y >= 0) & (y < SIZE)
    np.add.at(scene, (y[seen], x[seen]), stars["flux"][seen])
    return scene


def canvas(x, y):
    """Return an axis without frame for boxes, with 1.5 inches per unit."""
    figure = plt.figure(figsize=(1.5 * (x[1] - x[0]), 1.5 * (y[1] - y[0])))
    ax = figure.add_axes((0, 0, 1, 1), xlim=x, ylim=y)
    ax.axis("off")
    return ax


def box(ax, x, y, title, text, width=1.0, colour="#e8f0f4"):
    """Draw a box about a point, as high as its title and the lines of its text."""
    height = 0.32 + (0.06 + 0.104 * (text.count("\n") + 1) if text else 0)
    corner = (x - width / 2, y - height / 2)
    edge = {"boxstyle": "round,pad=0,rounding_size=0.06", "facecolor": colour}
    ax.add_patch(FancyBboxPatch(corner, width, height, edgecolor="#4a6572", **edge))
    top = y + height / 2
    ax.text(x, top - 0.1, title, ha="center", va="top", weight="bold")
    ax.text(x, top - 0.29, text, ha="center", va="top", fontsize=8, linespacing=1.4)


def arrow(ax, start, end):
    """Draw an arrow."""
    line = {"arrowstyle": "-|>", "color": "#4a6572", "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", end, start, arrowprops=line)


def index(program):
    """A scene, its PSF and its image, on the first page and in the README."""
    model = psfield.PsfModel.read(DEMO / "model.fits")
    scene = scene_of_the_demo()
    _, axes = plt.subplots(1, 3, figsize=(9.6, 3.5), layout="constrained")
    show(axes[0], scene[PART], "input scene")
    show(axes[1], psf_sheet(model, 8, 8), "PSF over the field", 1)
    show(axes[2], psfield.simulate(scene, model)[PART], "simulated image")


def python(program):
    """A model, an image, and the difference from the exact image."""
    model = psfield.PsfModel.read(DEMO / "model.fits")
    scene = scene_of_the_demo()
    image = model.plan(scene.shape, tolerance=1e-3, precision="f64").simulate(scene)
    exact = model.plan(scene.shape, tolerance=0, precision="f64").simulate(scene)
    error = np.abs(image - exact)[PART] / exact[PART].max()
    _, axes = plt.subplots(1, 3, figsize=(9.6, 3.3), layout="constrained")
    show(axes[0], psf_sheet(model, 8, 8), "model: the PSF over the field", 1)
    show(axes[1], image[PART], "plan.simulate(scene), tolerance 1e-3")
    drawn = axes[2].imshow(error, cmap="gray", norm=LogNorm(1e-9, 1e-3))
    axes[2].set(title="error / peak of this part", xticks=[], yticks=[])
    plt.colorbar(drawn, ax=axes[2])


def guide(program):
    """A scene, its image and a raw frame, by the commands of the guide."""
    light = [DEMO / "scene.fits", "--catalog", DEMO / "stars.csv", "--psf", DEMO / "model.fits"]
    noise = "--photon-noise --sky 200 --read-noise 5 --gain 2 --bias 300 --bits 16 --seed 1"
    for arguments in (["simulate", *light], ["expose", "image.fits", *noise.split()]):
        output = "image.fits" if arguments[0] == "simulate" else "raw.fits"
        subprocess.run([program, *map(str, arguments), "-o", output, "--quiet"], check=True)
    _, axes = plt.subplots(1, 3, figsize=(9.6, 3.5), layout="constrained")
    show(axes[0], scene_of_the_demo()[PART], "scene")
    show(axes[1], fits.getdata("image.fits")[PART], "psfield simulate")
    raw = fits.getdata("raw.fits")[PART].astype(float)
    show(axes[2], 2 * (raw - np.median(raw)) + 60, "psfield expose: a raw frame")


def formats(program):
    """PSFs written to files of several formats and read back."""
    model = psfield.PsfModel.read(DEMO / "model.fits")
    kinds = {
        "psfield's model": {},
        "PSF samples, 9 x 9": {"format": "psf-samples", "grid_shape": (9, 9)},
        "gridded library, 9 x 9": {"format": "gridded", "grid_shape": (9, 9)},
        "PSFEx, degree 8": {"format": "psfex", "degree": 8},
    }
    _, axes = plt.subplots(2, 2, figsize=(9.6, 3.4), layout="constrained")
    exact = psf_sheet(model, 8, 3)
    for ax, (name, settings) in zip(axes.flat, kinds.items()):
        model.write("file", **settings, overwrite=True)
        read = psf_sheet(psfield.PsfModel.read("file"), 8, 3)
        error = np.abs(read - exact).max()
        words = f"within {error:.0e} of the peak" if error else "exact"
        show(ax, read, f"{name}: {words}", 1)


def cluster(program):
    """An image in chunks, and the light that one chunk needs."""
    model = psfield.PsfModel.read(DEMO / "model.fits")
    image = model.plan((SIZE, SIZE), tolerance=1e-3).simulate(scene_of_the_demo())
    reach = max(model.stamp_shape) // 2
    _, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
    show(ax, image, "chunks of 256 x 256 pixels")
    for edge in (256, 512, 768):
        ax.axvline(edge - 0.5, color="#6fb7d8", lw=1)
        ax.axhline(edge - 0.5, color="#6fb7d8", lw=1)
    for margin, style in ((0, "-"), (reach, "--")):
        first, side = 255.5 - margin, 256 + 2 * margin
        edge = "#f2a33a" if margin else "#6fb7d8"
        frame = {"fill": False, "lw": 2, "linestyle": style, "edgecolor": edge}
        ax.add_patch(Rectangle((first, first), side, side, **frame))
    label = "light that one chunk needs"
    ax.text(524 + reach, 400, label, color="#f2a33a", backgroundcolor="k")
    ax.set(ylim=(140, 660))


def gpu(program):
    """The times of the page's table."""
    rows = read_table("docs/gpu.md", "Speed")
    _, ax = plt.subplots(figsize=(8, 2.8), layout="constrained")
    for place, column, name, colour in [
        (-0.3, 5, "16 threads of the processor", "#9aa5ab"),
        (-0.1, 1, "GPU, end to end", "#1f77b4"),
        (0.1, 4, "of which the host", "#8fbcdb"),
        (0.3, 2, "of which kernels", "#c6dcec"),
    ]:
        times = numbers([row[column] for row in rows])
        bars = ax.bar(np.arange(len(rows)) + place, times, 0.2, label=name, color=colour)
        ax.bar_label(bars, [f"{time:g}" for time in times], fontsize=8)
    ax.set_xticks(range(len(rows)), [row[0] for row in rows])
    ax.set(yscale="log", ylim=(0.4, 250), ylabel="milliseconds", xlabel="pixels of the frame")
    ax.legend(loc="upper left", fontsize=8)


def coming_from(program):
    """The stars of the page's section on GalSim, drawn by both."""
    text = (ROOT / "docs/coming_from.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text.split("\n## photutils")[0], re.M | re.S)
    names = {}
    with contextlib.redirect_stdout(io.StringIO()):
        for block in blocks:
            exec(block, names)
    theirs, ours = names["theirs"].array, names["ours"]
    error = (ours - theirs) / theirs.max()
    limit = np.abs(error).max()
    _, axes = plt.subplots(1, 3, figsize=(9.6, 2.6), layout="constrained")
    for ax, image, name in zip(axes, (theirs, ours), ("GalSim", "psfield")):
        show(ax, image, f"200 stars: {name}", 3000)
    drawn = axes[2].imshow(error, cmap="RdBu_r", vmin=-limit, vmax=limit)
    axes[2].set(title="difference / peak", xticks=[], yticks=[])
    plt.colorbar(drawn, ax=axes[2], format="%.0e")


def accuracy(program):
    """Errors against the tolerance, the samples and the components, from the page's tables."""
    page = "docs/accuracy.md"
    _, axes = plt.subplots(1, 3, figsize=(9.6, 2.9), layout="constrained", sharey=True)
    columns = [("largest error of e", "#c44e52"), ("90 % of errors of e", "#1f77b4")]
    engine, samples, rank = (
        read_table(page, heading) for heading in ("Engine", "Interpolation", "Components")
    )
    samples = [row for row in samples if row[1].startswith("bicubic")]
    for ax, rows, column, label in [
        (axes[0], engine, 1, "tolerance of the engine"),
        (axes[1], samples, 2, "samples along each axis"),
        (axes[2], rank, 2, "components"),
    ]:
        across = [float(row[0].split(" x ")[0]) for row in rows]
        for part, (name, colour) in zip((1, 0), columns):
            values = [float(row[column].split(" / ")[part]) for row in rows]
            ax.loglog(across, values, "o-", color=colour, label=name)
        ax.set(xlabel=label)
        ax.grid(alpha=0.3)
    for ax, rows in ((axes[1], samples), (axes[2], rank)):
        labels = [row[0].split(" x ")[0] for row in rows]
        ax.set_xticks([int(label) for label in labels], labels)
        ax.minorticks_off()
    axes[0].set_ylabel("error of the eccentricity e")
    axes[0].legend(fontsize=8)


def stability(program):
    """Measured figures and limits of the page's first table, for the method auto."""
    rows = [row for row in read_table("STABILITY.md", "Scenes") if "refused" not in row[-1]]
    figure, ax = plt.subplots(figsize=(8, 2.6), layout="constrained")
    for precision, colour in (("f32", "#1f77b4"), ("f64", "#c44e52")):
        pairs = [row[-1].split(" ≤ ") for row in rows if row[0].endswith(f", {precision}")]
        measured, limits = np.array(pairs, float).T
        case = np.arange(1, len(pairs) + 1)
        ax.plot(
            case, np.where(measured, measured, np.nan), "o", ms=3.5, color=colour, label=precision
        )
        ax.plot(case, limits, "_", ms=7, color=colour, label=f"limit of {precision}")
    ax.set(yscale="log", ylim=(1e-17, 1e-2), xlabel="scene (a row of the first table)")
    ax.set_ylabel("largest error / peak")
    figure.legend(fontsize=8, loc="outside right upper")


def stages(program):
    """The stages, and the crates of each."""
    ax = canvas((-0.6, 5.6), (-0.4, 1.4))
    for x, y, title, crates in [
        (0, 1, "PSF source", "psf-optics\npsf-stars\npsf-io"),
        (1.25, 1, "samples", "psf-sample"),
        (2.5, 1, "PSF model", "psf-basis\ncoeff-field\nspectra"),
        (2.5, 0, "scene", "psf-io\nsersic"),
        (3.75, 0.5, "plan, image", "conv-core"),
        (5, 1, "raw frame", "psf-detector"),
        (5, 0, "measurements", "psf-metrics"),
    ]:
        box(ax, x, y, title, crates)
    for start, end in [
        ((0.5, 1), (0.75, 1)),
        ((1.75, 1), (2, 1)),
        ((3, 0.9), (3.25, 0.6)),
        ((3, 0.1), (3.25, 0.4)),
        ((4.25, 0.6), (4.5, 0.9)),
        ((4.25, 0.4), (4.5, 0.1)),
    ]:
        arrow(ax, start, end)
    joins = "psfield joins the stages. psfield-cli,\npsfield-lab and psfield-python use it.\n"
    ax.text(-0.5, 0, joins + "psf-types holds the data\nthat passes between stages.", va="center")


def api(program):
    """The way from a PSF to an image, by the names of the package."""
    ax = canvas((-0.75, 5.65), (-0.45, 0.45))
    makers = "from_samples, from_basis\nfrom_function, from_telescope\nfrom_gridded_psf_model, read"
    for x, title, text in [
        (0, "PSF", makers),
        (1.63, "PsfModel", "evaluate, fit_report\nat, for_spectrum\nwrite"),
        (3.26, "Plan", "simulate, adjoint\nlinear_operator\nspot_check"),
        (4.89, "image", "metrics.compare\nmetrics.measure\nDetector.expose"),
    ]:
        box(ax, x, 0, title, text, 1.3)
    for x in (0.65, 2.28, 3.91):
        arrow(ax, (x, 0), (x + 0.33, 0))


def contributing(program):
    """The checks of the page's first table."""
    ax = canvas((-0.95, 7.55), (-0.45, 0.45))
    for x, name, text in [
        (0, ".ci/fast", "for every commit:\nformat, clippy, unit tests,\ncontracts, stages"),
        (
            2.2,
            ".ci/run",
            "before a change lands:\nall tests, the Python package,\nthe pages, fuzzers",
        ),
        (4.4, ".ci/extra", "sometimes:\nlicences, large stamps, the site,\nlong fuzzing"),
        (6.6, ".ci/release", "for a release:\nwheel, archives, packages,\nnotices"),
    ]:
        box(ax, x, 0, name, text, 1.75)
    for x in (0.88, 3.08, 5.28):
        arrow(ax, (x, 0), (x + 0.45, 0))


def paths(program):
    """Which features work on which paths: the table of the page."""
    rows = read_table("docs/paths.md", "What works where")
    names = ["simulate", "batch", "series", "Plan", "series", "batch", "simulate"]
    _, ax = plt.subplots(figsize=(8.4, 4.4), layout="constrained")
    works = np.array([[cell == "yes" for cell in row[1:]] for row in rows])
    colours = mpl.colors.ListedColormap(["#f2d9c4", "#9cc5a1"])
    ax.imshow(works, cmap=colours, origin="upper", aspect="auto")
    ax.set_xticks(np.arange(-0.5, 7), minor=True)
    ax.set_yticks(np.arange(-0.5, len(rows)), minor=True)
    ax.grid(which="minor", color="white")
    for y, row in enumerate(rows):
        for x, cell in enumerate(row[1:]):
            ax.text(x, y, "" if cell == "yes" else cell, ha="center", va="center")
    ax.set_yticks(range(len(rows)), [row[0] for row in rows])
    ax.set_xticks(range(len(names)), names)
    ax.xaxis.tick_top()
    for x, text in ((1, "command line"), (3.5, "Python"), (5.5, "Dask")):
        ax.text(x, -1.5, text, ha="center", weight="bold")
    ax.tick_params(which="both", length=0)


def bright_and_faint(program):
    """Stars with noise, and the noise-free light that is drawn with three floors."""
    y, x = (np.mgrid[-63:64, -63:64]).astype(float)
    r2 = x**2 + y**2
    spikes = np.exp(-(x**2)) / (1 + np.abs(y)) + np.exp(-(y**2)) / (1 + np.abs(x))
    stamp = (1 + r2 / 3) ** -1.6 + 0.02 * spikes * np.exp(-r2 / 1500)
    model = psfield.PsfModel.from_samples(stamp, (0, 0))
    rng = np.random.default_rng(4)
    count, noise = 60, 8.0
    stars = {
        "x": np.append(rng.uniform(0, 160, count), 80.3),
        "y": np.append(rng.uniform(0, 160, count), 79.6),
        "flux": np.append(10 ** rng.uniform(2, 4.5, count), 5e5),
    }
    camera = psfield.detector.Detector(photon_noise=True, read_noise_e=noise)
    whole = model.plan((160, 160)).simulate(None, stars)
    _, axes = plt.subplots(1, 4, figsize=(9.6, 2.7), layout="constrained")

    def draw(ax, image, title):
        ax.imshow(np.arcsinh(image / noise), cmap="gray", vmin=-1, vmax=7)
        ax.set(title=title, xticks=[], yticks=[])

    draw(axes[0], camera.expose(whole, seed=1).counts, "with noise")
    for ax, part in zip(axes[1:], (0, 0.1, 1)):
        plan = model.plan((160, 160), floor=part * noise)
        name = {0: "floor 0", 0.1: "a tenth of the noise", 1: "the noise"}[part]
        draw(ax, plan.simulate(None, stars), name)


def observe(program):
    """The detectors of two exposures on the sky, and a part of a frame with its sources."""
    shape, scale = (600, 600), 0.2
    model = psfield.PsfModel.from_telescope(
        field_shape=shape, samples=(5, 5), stamp_size=48, oversampling=4
    )
    model.write("psf.fits", overwrite=True)
    camera = [
        {
            "name": f"N{3 * row + column + 1}",
            "shape": shape[::-1],
            "psf": "psf.fits",
            "settings": "ccd.toml",
            "geometry": {
                "pixel_scale_arcsec": scale,
                "centre_arcsec": [(column - 1) * 640 * scale, (row - 0.5) * 640 * scale],
            },
        }
        for row in range(2)
        for column in range(3)
    ]
    Path("ccd.toml").write_text("photon_noise = true\nsky_e = 60.0\nread_noise_e = 4.0\n")
    rng = np.random.default_rng(3)
    count = 3000
    is_star = np.arange(count) < count // 2
    sky = {
        "ra": 150 + rng.uniform(-0.08, 0.08, count),
        "dec": 2 + rng.uniform(-0.07, 0.07, count),
        "flux": 10 ** rng.uniform(1.5, 4.5, count),
        "re_arcsec": np.where(is_star, 0, rng.gamma(2, 0.3, count) + 0.1),
        "n": rng.choice([1.0, 2.5, 4.0], count),
        "q": rng.uniform(0.3, 1, count),
        "pa_deg": rng.uniform(0, 180, count),
    }
    pointing = {"ra": 150, "dec": 2, "rotation_deg": 20, "dithers_arcsec": [[0, 0], [30, 20]]}
    with contextlib.redirect_stderr(io.StringIO()):
        survey = psfield.Survey(
            sky,
            camera,
            [pointing],
            "{exposure}_{detector}.fits",
            truth_table="{exposure}_{detector}_t.fits",
        )
        survey.observe(overwrite=True)
    _, axes = plt.subplots(1, 2, figsize=(8.6, 4.3), layout="constrained")
    psfield.plot.plot_focal_plane(survey, catalog=sky, ax=axes[0])
    part = (slice(200, 420), slice(200, 420))
    counts = fits.getdata("001-1_N2.fits")[part]
    axes[1].imshow(np.arcsinh((counts - 60) / 10), cmap="gray", vmin=-1, vmax=5)
    with fits.open("001-1_N2_t.fits") as hdus:
        table = hdus[1].data
    x, y = table["x"] - 200, table["y"] - 200
    inside = (x > 3) & (x < 216) & (y > 3) & (y < 216) & (table["flux"] > 1000)
    axes[1].plot(x[inside], y[inside], "o", mfc="none", mec="C1", markersize=9)
    axes[1].set(title="a part of N2, with its table of sources", xticks=[], yticks=[])


def core_and_wings(program):
    """One bright star through stamps of two sizes, and through a PSF with wings."""
    y, x = np.mgrid[-700:701, -700:701].astype(float)
    a, b = (x + y) / 2**0.5, (x - y) / 2**0.5
    r2 = x**2 + y**2
    spikes = sum(np.exp(-(u**2) / 3) / (1 + v**2 / 60) for u, v in ((x, y), (a, b), (b, a)))
    rings = 1 + 0.6 * np.cos(np.sqrt(r2) / 12)
    stamp = (1 + r2 / 3) ** -3 + 1e-4 * rings * (1 + r2 / 30) ** -1.4 + 1e-3 * spikes
    model = psfield.PsfModel.from_samples(stamp, (0, 0))
    star = {"x": [250.3], "y": [230.7], "flux": [3e8]}
    _, axes = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
    for ax, size in zip(axes, (63, 511, None)):
        image = model.plan((600, 700), stamp_size=size).simulate(None, star)
        ax.imshow(np.arcsinh(image), cmap="gray", vmin=0, vmax=12, origin="lower")
        title = "with wings" if size is None else f"stamps of {size}"
        ax.set(title=title, xticks=[], yticks=[])


def derivatives(program):
    """Inputs, the image and the loss, with the derivatives back."""
    ax = canvas((-0.8, 4.9), (-0.55, 1.6))
    inputs = [
        (1.25, "light", "[..., y, x]"),
        (0.5, "coefficients", "[position, component]"),
        (-0.25, "stamps", "mean, components"),
    ]
    for y, title, text in inputs:
        box(ax, 0, y, title, text, 1.5)
        ax.annotate("", (1.45, 0.62), (0.78, y + 0.08), arrowprops={"arrowstyle": "-|>", "color": "#4a6572"})
        back = {"arrowstyle": "-|>", "color": "#b5651d", "linestyle": "--"}
        ax.annotate("", (0.78, y - 0.08), (1.45, 0.38), arrowprops=back)
    box(ax, 2.1, 0.5, "image", "blur(light, ...)", 1.25)
    box(ax, 4.1, 0.5, "loss", "a number", 1.25)
    arrow(ax, (2.75, 0.58), (3.45, 0.58))
    ax.annotate("", (2.75, 0.42), (3.45, 0.42), arrowprops=back)
    ax.text(3.1, 0.22, "derivatives", ha="center", va="top", color="#b5651d")


def migration(program):
    """The types of 0.1.0 and the types that replace them."""
    ax = canvas((-0.85, 5.65), (-0.25, 1.45))
    for x, new, old in [
        (0, "Psf", "PsfInput\nOpenedPsf"),
        (1.6, "Scene", "SceneSources\nSceneLayout\nSceneParts"),
        (3.2, "SimulateOptions", "SimulationOptions\nPlanOptions\nDeviceOptions"),
        (4.8, "Simulator", "Simulation\nSimulationPlan"),
    ]:
        box(ax, x, 1, "0.1.0", old, 1.4, "#f1f1f1")
        arrow(ax, (x, 0.6), (x, 0.2))
        box(ax, x, 0, new, "", 1.4)


def main(program, names):
    """Make pictures in a folder with the files of the demo, and store them next to this file."""
    makers = (index, python, guide, formats, cluster, gpu, coming_from, accuracy)
    makers += (stability, stages, api, contributing, migration, paths, bright_and_faint)
    makers += (core_and_wings, derivatives, observe)
    program = Path(program).resolve()
    with tempfile.TemporaryDirectory() as work:
        os.chdir(work)
        subprocess.run([program, "demo", "--quiet"], check=True)
        for make in makers:
            if names and make.__name__ not in names:
                continue
            make(program)
            plt.savefig("picture.png", dpi=100)
            plt.close("all")
            picture = PICTURES / f"{make.__name__}.png"
            image = Image.open("picture.png").convert("RGB")
            red, *others = (np.asarray(band) for band in image.split())
            is_grey = all(np.array_equal(red, band) for band in others)
            image.convert("L" if is_grey else "RGB").save(picture, optimize=True)
            print(picture, picture.stat().st_size // 1000, "kB")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])

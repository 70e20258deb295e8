"""Plots, and the tables that notebooks show."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
from conftest import gaussian_stamp, relative_l2, widening_model

import psfield
from psfield import metrics, plot

FIELD = (96, 128)


@pytest.fixture
def plt():
    """Return matplotlib's pyplot without open figures, and close those of the test."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.close("all")
    yield pyplot
    pyplot.close("all")


def elliptical_model(angle: float, q: float = 0.5) -> psfield.PsfModel:
    """Return a model of one Gaussian with its major axis at an angle."""
    y, x = np.mgrid[-12:13, -12:13]
    along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    stamp = np.exp(-0.5 * (along**2 + (across / q) ** 2) / 9)
    return psfield.PsfModel.from_samples(stamp, (0, 0), field_shape=FIELD)


def whisker_vectors(ax) -> tuple[np.ndarray, np.ndarray]:
    """Return middles and vectors of the whiskers, in pixels of the field."""
    whiskers = ax.collections[0]
    vectors = np.column_stack([whiskers.U, whiskers.V]) / whiskers.scale
    return whiskers.get_offsets(), vectors


def drawn(ax) -> np.ndarray:
    """Return a figure as it is drawn."""
    ax.figure.canvas.draw()
    return np.asarray(ax.figure.canvas.buffer_rgba())


def test_an_import_of_psfield_does_not_import_matplotlib():
    code = "import sys, psfield; psfield.plot.plot_image; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize("call", ["image", "psf_field", "shapes", "residuals", "plan"])
def test_without_matplotlib_the_error_says_how_to_install_it(call, model, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    image = np.eye(5)
    arguments = {"image": (image,), "residuals": (image, image), "plan": (model.plan(FIELD),)}
    with pytest.raises(ImportError, match="pip install matplotlib"):
        getattr(plot, f"plot_{call}")(*arguments.get(call, (model,)))


def test_given_axes_are_used(plt, model):
    figure, axes = plt.subplots(2, 4)
    image, plan = np.eye(20), model.plan(FIELD, 1e-2)
    top, bottom = axes
    assert plot.plot_image(image, ax=top[0]) is top[0]
    assert plot.plot_psf_field(model, ax=top[1]) is top[1]
    assert plot.plot_shapes(model, ax=top[2]) is top[2]
    assert plot.plot_plan(plan, ax=top[3]) is top[3]
    assert plot.plot_residuals(image, image + 1, axes=bottom[:3]) is not None
    assert [len(ax.images) for ax in bottom] == [1, 1, 1, 0]
    assert plt.get_fignums() == [figure.number]


def test_an_image_keeps_its_orientation_and_its_brightest_pixel_is_white(plt):
    rng = np.random.default_rng(2)
    image = rng.normal(1000, 5, (40, 60))
    image[30, 10] = 50_000
    shown = plot.plot_image(image).images[0]
    assert shown.origin == "lower" and np.array_equal(shown.get_array(), image)
    levels = shown.norm(np.array([image.min(), 1000.0, 1015.0, 2000.0, 50_000.0]))
    # The sky is dark, a pixel 3 sigma above it is darker than a faint star.
    assert levels[0] <= 0 < levels[1] < 0.06
    assert levels[1] < levels[2] < levels[3] < levels[4] == pytest.approx(1)
    assert levels[3] > 0.4, "a star of 2 % of the brightest is visible"
    linear = plot.plot_image(image, stretch="linear").images[0]
    assert linear.norm(2000.0) == pytest.approx(1005 / 49_005, rel=0.02)


def test_images_with_units_and_without_light_can_be_shown(plt):
    units = pytest.importorskip("astropy.units")
    nddata = pytest.importorskip("astropy.nddata")
    image = np.arange(12.0).reshape(3, 4)
    for given in (image * units.electron, nddata.CCDData(image, unit="electron")):
        ax = plot.plot_image(given)
        assert ax.images[0].colorbar.ax.get_ylabel() == "electron"
        assert np.array_equal(ax.images[0].get_array(), image)
    for flat in (
        np.zeros((3, 4)),
        np.full((3, 4), np.nan),
        np.full((3, 4), -7),
        np.full((3, 4), 1e20),
    ):
        drawn(plot.plot_image(flat))
    assert plot.plot_image(image, colorbar=False).images[0].colorbar is None
    with pytest.raises(ValueError, match="must be an array"):
        plot.plot_image([1.0, 2.0])
    with pytest.raises(ValueError, match="stretch must be"):
        plot.plot_image(image, stretch="log")


def test_colour_bars_have_few_digits(plt):
    image = np.random.default_rng(3).normal(1000, 5, (50, 50))
    image[3, 4] = 61_234.5
    bar = plot.plot_image(image).images[0].colorbar
    ticks = bar.get_ticks()
    assert (np.diff(ticks) > 0).all() and len(ticks) == 6
    assert ticks[0] >= bar.vmin and ticks[-1] <= bar.vmax
    assert max(len(label.get_text()) for label in bar.ax.get_yticklabels()) <= 6


def test_stamps_stand_at_their_positions(plt):
    # The centre of the stamps is not in their middle.
    stamps = [gaussian_stamp(sigma, 15, shift=(2, -1)) for sigma in (1.5, 2.0, 1.6, 2.2)]
    corners = [(0, 0), (127, 0), (0, 95), (127, 95)]
    model = psfield.PsfModel.from_samples(stamps, corners, field_shape=FIELD, centre=(9, 6))
    ax = plot.plot_psf_field(model, grid=(2, 4))
    assert len(ax.images) == 8
    assert ax.get_xlim() == (-0.5, 127.5) and ax.get_ylim() == (-0.5, 95.5)
    expected = [(x, y) for y in (23.5, 71.5) for x in (15.5, 47.5, 79.5, 111.5)]
    for (x, y), shown in zip(expected, ax.images):
        left, right, bottom, top = shown.get_extent()
        pixel = (right - left) / 15
        assert (top - bottom) / 15 == pytest.approx(pixel)
        # The brightest pixel is that of the source.
        values = shown.get_array()
        row, column = np.unravel_index(np.argmax(values), values.shape)
        assert left + (column + 0.5) * pixel == pytest.approx(x)
        assert bottom + (row + 0.5) * pixel == pytest.approx(y)
        # It stays in its cell.
        assert x - 16 < left and right < x + 16 and y - 24 < bottom and top < y + 24
        wanted = model.evaluate(x, y)
        assert relative_l2(values * np.max(wanted), wanted * np.max(values)) < 1e-12
    norms = {id(shown.norm) for shown in ax.images}
    assert len(norms) == 1 and ax.images[0].norm.vmax == 1
    assert max(float(shown.get_array().max()) for shown in ax.images) == pytest.approx(1)


def test_the_field_comes_from_the_shape_the_model_or_the_positions(plt, model):
    assert plot.plot_psf_field(model).get_xlim() == (-0.5, 127.5)
    assert plot.plot_psf_field(model, shape=(50, 60)).get_xlim() == (-0.5, 59.5)
    places = [(10, 20), (40, 20), (10, 70), (40, 70)]
    free = psfield.PsfModel.from_samples([gaussian_stamp(2.0)] * 4, places)
    for draw in (plot.plot_psf_field, plot.plot_shapes):
        ax = draw(free)
        assert ax.get_xlim() == (9.5, 40.5) and ax.get_ylim() == (19.5, 70.5)
    alone = psfield.PsfModel.from_samples(gaussian_stamp(2.0), (0, 0))
    with pytest.raises(ValueError, match=re.escape("give shape=(ny, nx)")):
        plot.plot_shapes(alone)
    assert len(plot.plot_psf_field(alone, shape=(64, 64)).images) == 49


@pytest.mark.parametrize("degrees", [0, 30, 90, 135])
def test_whiskers_lie_along_the_major_axis(plt, degrees):
    angle = np.deg2rad(degrees)
    middles, vectors = whisker_vectors(plot.plot_shapes(elliptical_model(angle), grid=(3, 4)))
    assert len(middles) == 12 and middles[0] == pytest.approx((15.5, 15.5))
    cross = vectors[:, 0] * np.sin(angle) - vectors[:, 1] * np.cos(angle)
    assert np.abs(cross / np.hypot(*vectors.T)).max() < 1e-3
    # The longest whisker takes 0.9 of a cell, which has 32 x 32 pixels.
    assert np.hypot(*vectors.T) == pytest.approx(0.9 * 32)


def test_whiskers_are_as_long_as_the_ellipticity_and_have_the_colour_of_the_fwhm(plt, model):
    ax = plot.plot_shapes(model, grid=(4, 5))
    middles, vectors = whisker_vectors(ax)
    found = metrics.measure(model.evaluate(*np.transpose(middles)))
    lengths = np.hypot(*vectors.T)
    assert lengths / lengths.max() == pytest.approx(
        found["ellipticity"] / max(found["ellipticity"])
    )
    assert np.allclose(ax.collections[0].get_array(), found["fwhm_px"] / model.oversampling)
    key = next(artist for artist in ax.get_children() if hasattr(artist, "label"))
    assert found["ellipticity"].max() / 2.5 <= key.U <= found["ellipticity"].max()
    assert key.label == f"|e| = {key.U:g}" and key in ax.get_children()


def test_oversampled_stamps_of_a_narrow_psf_can_be_measured(plt):
    y, x = np.mgrid[-16:17, -16:17] / 4
    stamp = np.exp(-0.5 * ((x / 0.6) ** 2 + (y / 0.4) ** 2))
    narrow = psfield.PsfModel.from_samples(stamp, (0, 0), field_shape=FIELD, oversampling=4)
    on_frame = metrics.measure(narrow.evaluate(50, 50, pixels="frame"))
    assert on_frame["note"][0] != ""  # the PSF is narrower than a pixel of the frame
    ax = plot.plot_shapes(narrow, grid=(3, 4))
    assert len(ax.collections[0].get_offsets()) == 12
    fwhm = 2 * np.sqrt(2 * np.log(2) * 0.6 * 0.4)
    assert np.allclose(ax.collections[0].get_array(), fwhm, rtol=1e-3)


def test_round_psfs_get_no_long_whiskers(plt):
    model = psfield.PsfModel.from_samples(gaussian_stamp(2.0), (0, 0), field_shape=FIELD)
    _, vectors = whisker_vectors(plot.plot_shapes(model, grid=(3, 4)))
    assert np.hypot(*vectors.T).max() < 0.1


def test_psfs_that_cannot_be_measured_are_marked(plt):
    # The second sample is a ring, which is no Gaussian.
    y, x = np.mgrid[-8:9, -8:9]
    hollow = np.where(np.hypot(x, y) > 7, 1.0, 0.0)
    both = psfield.PsfModel.from_samples(
        [gaussian_stamp(2.0), hollow], [(0, 50), (99, 50)], interpolation="nearest", noise=0
    )
    notes = metrics.measure(both.evaluate([0, 99], [50, 50]))["note"]
    assert (notes[0], notes[1] != "") == ("", True)
    ax = plot.plot_shapes(both, shape=(100, 100), grid=(1, 2))
    assert len(ax.collections[0].get_offsets()) == 1
    assert ax.lines[0].get_xdata().tolist() == [74.5]
    nothing = psfield.PsfModel.from_samples(hollow, (0, 0), field_shape=FIELD)
    with pytest.raises(ValueError, match="no PSF could be measured: "):
        plot.plot_shapes(nothing)


def test_residuals_show_the_difference_and_its_size(plt):
    reference = np.random.default_rng(4).normal(100, 1, (20, 30))
    image = reference.copy()
    image[4, 7] -= 2
    axes = plot.plot_residuals(image, reference)
    difference = axes[2].images[0]
    assert np.array_equal(difference.get_array(), image - reference)
    assert difference.get_clim() == pytest.approx((-2, 2))
    assert axes[0].images[0].norm is axes[1].images[0].norm
    errors = metrics.compare(image, reference)
    title = axes[2].get_title()
    assert f"{errors.relative_l2:.1e}" in title and f"{errors.max_over_peak:.1e}" in title
    equal = plot.plot_residuals(reference, reference)
    assert "relative L2: 0.0e+00" in equal[2].get_title()
    assert "undefined" in plot.plot_residuals(image, np.zeros((20, 30)))[2].get_title()
    with pytest.raises(ValueError, match="three axes"):
        plot.plot_residuals(image, reference, axes=axes[:2])


def test_residuals_need_one_unit_and_shape(plt):
    units = pytest.importorskip("astropy.units")
    with pytest.raises(ValueError, match="image has the unit adu"):
        plot.plot_residuals(np.eye(3) * units.adu, np.eye(3))
    with pytest.raises(ValueError, match="shape"):
        plot.plot_residuals(np.eye(3), np.eye(4))


@pytest.mark.parametrize(
    ("settings", "covered"),
    [
        ({}, None),
        ({"anchor": "output"}, None),
        ({"region": (30, 20, 50, 40)}, None),
        ({"frame": (10, 20, 100, 60)}, None),
        ({"frame": (10, 20, 100, 60), "anchor": "output"}, (10, 20, 100, 60)),
        ({"region": (30, 20, 50, 40), "anchor": "output"}, (30, 20, 50, 40)),
        ({"oversample": 2, "frame": (2, 3, 40, 30)}, None),
        ({"oversample": 2, "frame": (2, 3, 40, 30), "anchor": "output"}, (4, 6, 80, 60)),
    ],
    ids=str,
)
def test_blocks_cover_the_pixels_exactly_once(plt, model, settings, covered):
    plan = model.plan(FIELD, 1e-3, device="cpu", **settings)
    counts = np.zeros(FIELD, int)
    for x0, y0, nx, ny, _ in plan.blocks:
        assert 0 <= x0 <= x0 + nx <= FIELD[1] and 0 <= y0 <= y0 + ny <= FIELD[0]
        counts[y0 : y0 + ny, x0 : x0 + nx] += 1
    x0, y0, nx, ny = plan.light_region if covered is None else covered
    expected = np.zeros(FIELD, int)
    expected[y0 : y0 + ny, x0 : x0 + nx] = 1
    assert np.array_equal(counts, expected)
    summary = plan.summary
    assert len(plan.blocks) == summary.blocks
    assert plan.blocks["modes"].mean() == pytest.approx(summary.mean_modes)
    assert plan.blocks["modes"].max() == summary.most_modes
    # The plot shows these blocks in the scene, and where the image is.
    ax = plot.plot_plan(plan)
    assert ax.get_xlim() == (-0.5, 127.5) and ax.get_ylim() == (-0.5, 95.5)
    shown = ax.collections[0]
    assert np.array_equal(shown.get_array(), plan.blocks["modes"])
    for path, block in zip(shown.get_paths(), plan.blocks, strict=True):
        box = path.get_extents()
        assert (box.x0 + 0.5, box.y0 + 0.5) == (block["x0"], block["y0"])
        assert (box.width, box.height) == (block["nx"], block["ny"])
    frame = [(patch.get_xy(), patch.get_width(), patch.get_height()) for patch in ax.patches]
    image = {
        "frame": ((9.5, 19.5), 100, 60),
        "region": ((29.5, 19.5), 50, 40),
        "oversample": ((3.5, 5.5), 80, 60),
    }
    which = next((name for name in ("oversample", "frame", "region") if name in settings), None)
    assert frame == ([] if which is None else [image[which]])
    drawn(ax)


@pytest.mark.parametrize(("tolerance", "numbers"), [(0.3, 1), (1e-6, 2)])
def test_numbers_of_modes_have_whole_ticks(plt, tolerance, numbers):
    model = widening_model((400, 600), noise=0, interpolation="bicubic")
    plan = model.plan((400, 600), tolerance)
    assert len(np.unique(plan.blocks["modes"])) >= numbers
    ax = plot.plot_plan(plan)
    drawn(ax)
    ticks = ax.collections[0].colorbar.get_ticks()
    assert ticks[0] == plan.blocks["modes"].min() and 1 <= len(ticks) <= 11
    assert np.array_equal(ticks, np.rint(ticks))


def test_models_say_what_they_are(model):
    stamps = [gaussian_stamp(sigma) for sigma in (1.5, 2.0)]
    one = psfield.PsfModel.from_samples(stamps[0], (0, 0))
    assert repr(one) == "<PsfModel: 1 sample, stamps 17 x 17, oversampling 1>"
    coloured = psfield.PsfModel.from_samples(stamps, [(0, 0)] * 2, wavelengths_um=[0.5, 0.7])
    assert "2 samples, at 2 wavelengths (0.5 to 0.7 um), stamps" in repr(coloured)
    numbered = psfield.PsfModel.from_samples(stamps[0], (0, 0), frame_numbers=[3])
    assert "1 sample, at 1 frame (3), stamps" in repr(numbered)


def test_a_table_of_a_model_starts_no_fit():
    model = widening_model()
    html = model._repr_html_()
    assert "<td>not fitted yet</td>" in html and "Interpolation" not in html
    assert "<th>Samples</th><td>16</td>" in html and "96 x 128 (rows x columns)" in html
    assert model._repr_html_() == html
    rank = model.rank
    html = model._repr_html_()
    assert f"<th>Components</th><td>{rank}</td>" in html
    assert f"<th>Interpolation</th><td>{model.interpolation}</td>" in html
    given = psfield.PsfModel.from_basis(
        model.mean, model.components, model.coefficients, model.positions
    )
    assert f"<th>Components</th><td>{rank}</td>" in given._repr_html_()
    assert "<th>Field</th><td>not stated</td>" in given._repr_html_()


def test_tables_of_plans_and_results(model):
    plan = model.plan(FIELD, 1e-3, device="cpu", frame=(0, 0, 100, 90))
    assert repr(plan) == (
        "<Plan: scenes 96 x 128, frame (0, 0, 100, 90), tolerance 0.001, f32, on the CPU>"
    )
    html = plan._repr_html_()
    assert "<th>Tolerance</th><td>0.001 (" in html and f"<td>{plan.summary.blocks}</td>" in html
    assert "<th>Frame (x0, y0, nx, ny)</th><td>(0, 0, 100, 90)</td>" in html
    assert "Region" not in html and "Oversampling" not in html
    check = psfield.SpotCheck(1, 2, 1e-9, 3.0, None, 4.0, 5.0, 6.0, 7, None, True)
    html = check._repr_html_()
    assert "<caption>SpotCheck</caption>" in html and "<th>passed</th><td>True</td>" in html
    assert "<td>1e-09</td>" in html and "worst_source" not in html
    assert "<th>relative_l2</th>" in metrics.compare([1.0, 2.0], [1.0, 3.0])._repr_html_()
    stamp = gaussian_stamp(2.0)
    for measure in (metrics.fit_gaussian, metrics.adaptive_moments, metrics.quadrupole_moments):
        assert "<td>8</td>" in measure(stamp)._repr_html_()


def test_tables_are_escaped():
    from psfield._html import table

    assert table("a<b", {"x&y": "<script>"}) == (
        "<table><caption>a&lt;b</caption><tr><th>x&amp;y</th><td>&lt;script&gt;</td></tr></table>"
    )

"""Images of scenes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import direct_sum, gaussian_stamp, relative_l2, widening_model

import psfield

#: Rounding of transforms, for images of PSFs without zeros.
ROUNDING = {"f32": 1e-6, "f64": 1e-13}


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("method", ["auto", "lowrank"])
def test_the_image_is_the_direct_sum(model, scene, precision, method):
    image = model.plan(scene.shape, 0.0, precision, "cpu", method=method).simulate(scene)
    assert image.dtype == {"f32": np.float32, "f64": np.float64}[precision]
    assert relative_l2(image, direct_sum(model, scene)) < ROUNDING[precision]


def test_the_tolerance_holds(model, scene):
    truth = direct_sum(model, scene)
    for tolerance in (1e-1, 1e-3):
        assert relative_l2(model.plan(scene.shape, tolerance).simulate(scene), truth) < tolerance


def test_the_paper_s_anchoring_gathers(model):
    scene = np.zeros((96, 128))
    scene[40, 100] = 1.0
    image = model.plan(scene.shape, 0.0, "f64", anchor="output").simulate(scene)
    # Pixel (97, 41) gathers light with its own PSF.
    own = model.evaluate(97, 41)
    assert image[41, 97] == pytest.approx(own[8 + 1, 8 - 3], rel=1e-12)
    assert abs(image[41, 97] - model.evaluate(100, 40)[9, 5]) > 1e-5


def test_a_frame_sees_light_from_around_it(model):
    scene = np.zeros((100, 140))
    scene[3, 60] = 10.0
    image = model.plan(scene.shape, 0.0, "f64", frame=(10, 5, 120, 80)).simulate(scene)
    assert image.shape == (80, 120)
    # Two rows below the first of the frame. The PSF at (50, -2) is that of the nearest (50, 0).
    expected = 10.0 * model.evaluate(50, 0)[8 + 2, 8]
    assert image[0, 50] == pytest.approx(expected, rel=1e-9)


def test_a_finer_scene_keeps_its_flux(model):
    scene = np.zeros((192, 256), np.float32)
    scene[100, 100] = 7.0
    image = model.plan(scene.shape, 1e-3, oversample=2).simulate(scene)
    assert image.shape == (96, 128)
    assert image.sum() == pytest.approx(7.0, rel=1e-3)


def test_light_integrated_over_pixels_of_the_scene(model):
    """The scene's pixel is taken out: the flux stays, and the image is sharper."""
    scene = np.zeros((96, 128))
    scene[50, 60] = 7.0
    point, integrated = (
        model.plan(scene.shape, 1e-4, "f64", scene_pixels=pixels).simulate(scene)
        for pixels in ("point", "integrated")
    )
    assert integrated.sum() == pytest.approx(point.sum(), rel=1e-6)
    assert integrated.max() > 1.01 * point.max()
    plan = model.plan(scene.shape, scene_pixels="integrated")
    assert plan.summary.scene_pixels == "integrated"


def test_the_same_scene_gives_the_same_bytes_on_any_number_of_threads(model, scene):
    plan = model.plan(scene.shape, 1e-3)
    before = psfield.threads()
    try:
        images = []
        for count in (1, 2, 5):
            psfield.set_threads(count)
            assert psfield.threads() == count
            images.append(plan.simulate(scene))
    finally:
        psfield.set_threads(before)
    assert all(np.array_equal(images[0], image) for image in images[1:])
    with pytest.raises(ValueError, match="count must be at least 1"):
        psfield.set_threads(0)


@pytest.fixture(scope="module")
def plan(model):
    """A plan for scenes of 96 x 128 pixels."""
    return model.plan((96, 128), 1e-3)


class TestArrays:
    """Every memory layout gives the same image. Invalid scenes are refused."""

    @pytest.mark.parametrize(
        "layout",
        [
            lambda a: a.astype(">f4"),
            lambda a: a.astype(">f8"),
            lambda a: a.astype(np.float64),
            lambda a: np.asfortranarray(a),
            lambda a: np.repeat(np.repeat(a, 2, 0), 3, 1)[::2, ::3],
            lambda a: np.pad(a, 5)[5:-5, 5:-5],
            lambda a: a[::-1].copy()[::-1],
            lambda a: a[:, ::-1].copy()[:, ::-1],
            lambda a: (
                np.frombuffer(b"\0" + a.tobytes(), np.uint8)[1:].view(np.float32).reshape(a.shape)
            ),
            lambda a: a.tolist(),
            lambda a: np.ma.masked_array(a, mask=np.zeros(a.shape, bool)),
        ],
        ids=[
            "f4 of FITS",
            "f8 of FITS",
            "f8",
            "columns first",
            "strided",
            "cut out",
            "upside down",
            "mirrored",
            "unaligned",
            "lists",
            "masked",
        ],
    )
    def test_layouts(self, plan, scene, layout):
        single = scene.astype(np.float32)
        assert np.array_equal(plan.simulate(layout(single)), plan.simulate(single))

    def test_read_only_input_is_taken_and_left_alone(self, plan, scene):
        single = scene.astype(np.float32)
        single.flags.writeable = False
        before = single.copy()
        plan.simulate(single)
        assert np.array_equal(single, before)

    def test_whole_numbers(self, plan):
        scene = np.zeros((96, 128), np.uint16)
        scene[50, 50] = 60_000
        assert plan.simulate(scene).sum() == pytest.approx(60_000, rel=1e-5)

    def test_out_is_filled_and_returned(self, plan, scene):
        expected = plan.simulate(scene)
        wide = np.full((100, 140), np.nan, np.float32)
        for out in (
            np.full((96, 128), np.nan, np.float32),
            wide[2:98, 6:134],
            np.asfortranarray(np.full((96, 128), np.nan, np.float32)),
            np.full((96, 128), np.nan, np.float32)[::-1],
            np.full((96, 256), np.nan, np.float32)[:, ::2],
        ):
            assert plan.simulate(scene, out=out) is out
            assert np.array_equal(out, expected)
        assert np.isnan(wide[:2]).all() and np.isnan(wide[:, :6]).all()

    def test_out_may_be_the_scene(self, plan, scene):
        single = scene.astype(np.float32)
        expected = plan.simulate(single)
        plan.simulate(single, out=single)
        assert np.array_equal(single, expected)

    @pytest.mark.parametrize(
        ("out", "error", "text"),
        [
            (np.zeros((96, 127), np.float32), ValueError, "out must have shape"),
            (np.zeros((96, 128), np.float64), ValueError, "type float32, got"),
            (np.zeros((96, 128), ">f4"), ValueError, "type float32"),
            ([[0.0] * 128] * 96, TypeError, "out must be a NumPy array"),
        ],
    )
    def test_bad_out(self, plan, scene, out, error, text):
        with pytest.raises(error, match=text):
            plan.simulate(scene, out=out)

    def test_read_only_out(self, plan, scene):
        out = np.zeros((96, 128), np.float32)
        out.flags.writeable = False
        with pytest.raises(ValueError, match="out is read-only"):
            plan.simulate(scene, out=out)

    @pytest.mark.parametrize(
        ("bad", "error", "text"),
        [
            (np.zeros((96, 127)), ValueError, r"scenes of shape \(96, 128\), got \(96, 127\)"),
            (np.zeros((0, 128)), ValueError, "scene is empty"),
            (np.zeros(96), ValueError, r"an array \[y, x\], got one of shape \(96,\)"),
            (np.zeros((1, 1, 96, 127)), ValueError, r"scenes of shape \(96, 128\)"),
            (np.zeros((96, 128), complex), TypeError, "scene must be real numbers, got complex128"),
            (np.zeros((96, 128), object), TypeError, "real numbers, got object"),
            (np.full((96, 128), "a"), TypeError, "real numbers"),
            ("scene.fits", TypeError, "got the path .scene.fits.: did you mean catalog=?"),
            (
                np.full((96, 128), 1e300),
                ValueError,
                r"beyond single precision \(3\.4e38\): choose precision='f64'",
            ),
            (
                np.ma.masked_array(np.zeros((96, 128)), mask=np.eye(96, 128)),
                ValueError,
                "96 values are masked",
            ),
        ],
    )
    def test_bad_scenes(self, plan, bad, error, text):
        with pytest.raises(error, match=text):
            plan.simulate(bad)

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    def test_values_that_are_not_finite(self, plan, value):
        for dtype in (np.float32, np.float64):
            scene = np.zeros((96, 128), dtype)
            scene[17, 23] = value
            with pytest.raises(ValueError, match=r"17, 23"):
                plan.simulate(scene)

    def test_nothing_at_all(self, plan):
        with pytest.raises(ValueError, match="nothing to simulate"):
            plan.simulate()


class TestSettings:
    """Settings of plans."""

    @pytest.mark.parametrize(
        ("settings", "error", "text"),
        [
            ({"tolerance": 1.0}, ValueError, "tolerance"),
            ({"tolerance": -1e-3}, ValueError, "tolerance"),
            ({"tolerance": float("nan")}, ValueError, "tolerance"),
            ({"precision": "f16"}, ValueError, "precision must be f32 or f64"),
            ({"device": "tpu"}, ValueError, "device must be auto, cpu or gpu, got tpu"),
            ({"anchor": "middle"}, ValueError, "source or output"),
            ({"tolerance_on": "flux"}, ValueError, "l2 or aperture"),
            ({"scene_pixels": "cell"}, ValueError, "point or integrated"),
            ({"method": "direct"}, ValueError, "method must be auto or lowrank"),
            ({"method": "fast"}, ValueError, "method must be auto or lowrank, got fast"),
            ({"oversample": 0}, ValueError, "oversample must be at least 1"),
            ({"stamp_size": 0}, ValueError, "stamp_size must be at least 1"),
            ({"frame": (0, 0, 200, 10)}, ValueError, "frame"),
            ({"precision": "f64", "device": "gpu"}, (ValueError, OSError), "."),
        ],
    )
    def test_bad_settings(self, model, settings, error, text):
        with pytest.raises(error, match=text):
            model.plan((96, 128), **settings)

    @pytest.mark.parametrize(
        ("shape", "error", "text"),
        [
            ((96,), TypeError, "shape must be"),
            ((96.5, 128), TypeError, "shape must be"),
            ((0, 128), ValueError, "at least"),
            ((-5, 128), ValueError, "at least"),
            ("ab", TypeError, "shape must be"),
            ((97, 128), ValueError, "field of"),
        ],
    )
    def test_bad_shapes(self, model, shape, error, text):
        with pytest.raises(error, match=text):
            model.plan(shape)


def test_a_plan_tells_of_itself(model):
    plan = model.plan((96, 128), 1e-2, "f64")
    assert plan.shape == plan.image_shape == (96, 128)
    assert (plan.tolerance, plan.dtype, plan.model) == (1e-2, np.float64, model)
    assert plan.summary.tiles >= 1 and plan.summary.anchor == "source"
    assert "128 x 96 pixels in f64, tolerance 1e-2" in plan.describe()
    assert repr(plan) == "<Plan: scenes 96 x 128, tolerance 0.01, f64, on the CPU>"


def test_spot_checks_tell_right_from_wrong(model, scene):
    plan = model.plan(scene.shape, 1e-3)
    catalog = {"x": [5.25, 60.0], "y": [7.5, 90.5], "flux": [500.0, 20.0]}
    with pytest.warns(psfield.PsfieldWarning, match="too coarse to be interpolated"):
        image = plan.simulate(scene, catalog)
    check = plan.spot_check(scene, catalog, image=image, pixels=300)
    assert check.passed is True and check.pixels == 300 and check.relative_rms < check.limit
    assert plan.spot_check(scene, catalog, pixels=300) == check
    assert plan.spot_check(scene, catalog, image=1.1 * image).passed is False
    assert plan.spot_check(catalog=catalog).passed is True


def test_a_psf_without_pixel_response_gets_it_once():
    sigma, size = 6.0, 65
    # The Gaussian, averaged over frame pixels of four stamp pixels.
    edges = (np.arange(size)[:, None] - 32 + [-2.0, 2.0]) / (math.sqrt(2) * sigma)
    along = np.diff([[math.erf(v) for v in pair] for pair in edges])[:, 0] / 2
    places = [(20, 20)]
    bare = psfield.PsfModel.from_samples(
        [gaussian_stamp(sigma, size)], places, oversampling=4, pixel_response_included=False
    )
    full = psfield.PsfModel.from_samples([np.outer(along, along)], places, oversampling=4)
    assert bare.pixel_response_included is False and full.pixel_response_included is True
    star = {"x": [20.25], "y": [20.0], "flux": [1.0]}
    with_it, included = (m.plan((40, 40), 0.0, "f64").simulate(catalog=star) for m in (bare, full))
    # Without the pixel response the star would be narrower by percents.
    assert relative_l2(with_it, included) < 1e-3
    sharp = psfield.PsfModel.from_samples([gaussian_stamp(sigma, size)], places, oversampling=4)
    assert relative_l2(sharp.plan((40, 40), 0.0, "f64").simulate(catalog=star), included) > 0.02


def test_small_and_odd_frames():
    stamp = gaussian_stamp(1.0, 5)
    model = psfield.PsfModel.from_samples(stamp[None], [(0, 0)])
    for shape in [(1, 1), (1, 7), (13, 1), (31, 29)]:
        image = model.plan(shape, 0.0, "f64").simulate(np.ones(shape))
        assert relative_l2(image, direct_sum(model, np.ones(shape))) < ROUNDING["f64"]


def test_light_where_there_is_no_psf_is_an_error():
    model = widening_model((40, 40), outside="error")
    shifted = psfield.PsfModel.from_samples(
        [gaussian_stamp(1.0)] * 4, [(10, 10), (30, 10), (10, 30), (30, 30)], outside="error"
    )
    scene = np.zeros((40, 40))
    scene[20, 20] = 1.0
    assert shifted.plan(scene.shape).simulate(scene).sum() == pytest.approx(1.0, rel=1e-4)
    scene[0, 0] = 1.0
    model.plan(scene.shape).simulate(scene)
    with pytest.raises(ValueError, match="outside"):
        shifted.plan(scene.shape).simulate(scene)


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
def test_spot_checks_know_galaxies_frames_and_finer_scenes(model):
    scene = np.random.default_rng(2).random((96, 128))
    catalog = {
        "x": [5.3, 60.0, -3.0],
        "y": [7.5, 50.5, 20.0],
        "flux": [500.0, 2000.0, 900.0],
        "re": [0.0, 4.0, 5.0],
        "n": [1.0, 1.0, 2.0],
    }
    for words in ({}, {"frame": (9, 4, 100, 80)}, {"oversample": 2}, {"anchor": "output"}):
        plan = model.plan(scene.shape, 1e-3, **words)
        for sources in (None, catalog):
            check = plan.spot_check(scene, sources, pixels=300, seed=4)
            assert check.passed is True and check.relative_rms < 1e-2, (words, check)
    # A galaxy in the wrong place is found.
    plan = model.plan(scene.shape, 1e-3)
    image = plan.simulate(scene, {**catalog, "x": [5.3, 60.5, -3.0]})
    assert plan.spot_check(scene, catalog, image=image, pixels=300, seed=4).passed is False


class TestStacks:
    """Many scenes ``[n, y, x]`` in one call."""

    @pytest.fixture
    def scenes(self, scene):
        return np.stack([(1 + n) * np.roll(scene, n) for n in range(7)])

    @pytest.mark.parametrize(
        "settings", [{}, {"precision": "f64"}, {"anchor": "output"}, {"oversample": 2}]
    )
    def test_images_are_those_of_single_scenes(self, model, scenes, settings):
        plan = model.plan(scenes.shape[1:], tolerance=1e-3, device="cpu", **settings)
        images = plan.simulate(scenes)
        assert images.dtype == plan.dtype
        assert np.array_equal(images, [plan.simulate(scene) for scene in scenes])
        assert np.array_equal(images, plan.simulate(list(scenes)))

    def test_out(self, model, scenes):
        plan = model.plan(scenes.shape[1:], tolerance=1e-3, device="cpu")
        expected = plan.simulate(scenes)
        for out in (np.full_like(expected, np.nan), np.full_like(expected, np.nan)[::-1, :, ::-1]):
            assert plan.simulate(scenes, out=out) is out
            assert np.array_equal(out, expected)
        with pytest.raises(ValueError, match="out must have shape"):
            plan.simulate(scenes, out=np.empty_like(expected[0]))

    def test_units(self, model, scenes):
        units = pytest.importorskip("astropy.units")
        plan = model.plan(scenes.shape[1:], tolerance=1e-3, device="cpu")
        for stack in (scenes * units.electron, [scene * units.electron for scene in scenes]):
            images = plan.simulate(stack)
            assert images.unit == units.electron
            assert np.array_equal(images.value, plan.simulate(scenes))
        with pytest.raises(ValueError, match=r"scene\[1\] has the unit None"):
            plan.simulate([scenes[0] * units.electron, scenes[1]])

    def test_bad_stacks(self, model, scenes):
        plan = model.plan(scenes.shape[1:], tolerance=1e-3, device="cpu")
        with pytest.raises(ValueError, match="a stack of scenes has no catalogue"):
            plan.simulate(scenes, {"x": [1], "y": [1], "flux": [1]})
        with pytest.raises(ValueError, match="scene: the plan is for scenes of shape"):
            plan.simulate(scenes[:, 1:])
        with pytest.raises(ValueError, match=r"scene\[3\]: "):
            plan.simulate(np.where(np.arange(7)[:, None, None] == 3, np.nan, scenes))
        masked = np.ma.masked_array(scenes[0], mask=np.eye(*scenes[0].shape))
        with pytest.raises(ValueError, match=r"scene\[1\].*masked"):
            plan.simulate([scenes[0], masked])
        with pytest.raises(ValueError, match="scene is empty"):
            plan.simulate(scenes[:0])


def test_a_plan_for_another_model_keeps_the_tolerance(model, scene):
    samples = model.evaluate(*model.positions.T)[::-1]
    other = psfield.PsfModel.from_samples(samples, model.positions)
    plan = model.plan(scene.shape, tolerance=1e-3, device="cpu")
    kept, new = plan.with_psf(other), other.plan(scene.shape, tolerance=1e-3, device="cpu")
    assert kept.model is other and kept.tolerance == 1e-3
    assert kept.summary.tile_shape == plan.summary.tile_shape
    # Each plan may differ by the tolerance.
    assert relative_l2(kept.simulate(scene), new.simulate(scene)) < 2e-3
    assert relative_l2(plan.simulate(scene), new.simulate(scene)) > 5e-3


@pytest.mark.filterwarnings("ignore::psfield.PsfieldWarning")
@pytest.mark.parametrize("words", [{}, {"frame": (9, 4, 100, 80)}, {"oversample": 2}])
def test_regions_with_sources_are_those_of_the_whole(model, words):
    scene = np.random.default_rng(2).random((96, 128))
    catalog = {
        "x": [5.3, 30.0, -3.0],
        "y": [7.5, 20.5, 20.0],
        "flux": [500.0, 2000.0, 900.0],
        "re": [0.0, 4.0, 5.0],
        "n": [1.0, 1.0, 2.0],
    }
    whole = model.plan(scene.shape, 1e-2, **words).simulate(scene, catalog)
    plan = model.plan(scene.shape, 1e-2, region=(0, 0, 40, 30), **words)
    x0, y0, nx, ny = plan.light_region
    assert (
        relative_l2(
            plan.simulate(scene[y0 : y0 + ny, x0 : x0 + nx], catalog), whole[:30, :40].astype(float)
        )
        < 1e-6
    )
    other = plan.for_region((20, 10, 33, 31))
    assert relative_l2(other.simulate(scene, catalog), whole[10:41, 20:53].astype(float)) < 1e-6

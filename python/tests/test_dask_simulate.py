"""Scenes as chunked Dask arrays."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import relative_l2

import psfield

da = pytest.importorskip("dask.array")

import psfield.dask  # noqa: E402
from psfield.dask import _region, _simulate  # noqa: E402

#: Relative L2 error: chunks share transforms with other neighbours, which changes only rounding.
ROUNDING = {"f32": 1e-6, "f64": 1e-14}
SHAPE = (120, 150)


def stamp(sigma: float, ratio: float, shape: tuple[int, int], lean: float = 0.0) -> np.ndarray:
    """A skewed Gaussian about ``n // 2``."""
    ny, nx = shape
    y, x = np.mgrid[:ny, :nx] - np.reshape([ny // 2, nx // 2], (2, 1, 1)).astype(float)
    values = np.exp(-(x**2 + (y * ratio) ** 2) / (2 * sigma**2)) * (1 + lean * np.tanh(x + y))
    return values / values.sum()


def model_of(shape: tuple[int, int] = (17, 17), **options) -> psfield.PsfModel:
    x, y = np.meshgrid([0.0, 75.0, 149.0], [0.0, 60.0, 119.0])
    stamps = [
        stamp(1.2 + 0.004 * px + 0.01 * py, 1 + 0.003 * px, shape, 0.5)
        for px, py in zip(x.ravel(), y.ravel())
    ]
    return psfield.PsfModel.from_samples(stamps, np.column_stack([x.ravel(), y.ravel()]), **options)


@pytest.fixture(scope="module")
def model() -> psfield.PsfModel:
    return model_of()


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    rng = np.random.default_rng(7)
    return (rng.random(SHAPE) ** 8).astype(np.float32)


@pytest.mark.parametrize(
    "chunks",
    [(30, 38), (120, 150), (40, 1), (7, 11), (120, 50), ((3, 100, 17), (60, 1, 1, 88)), (119, 149)],
    ids=str,
)
def test_edges_of_chunks_leave_no_trace(model, scene, chunks) -> None:
    lazy = da.from_array(scene, chunks=chunks)
    image = psfield.dask.simulate(lazy, model, 1e-2)
    assert image.chunks == lazy.chunks
    assert (
        relative_l2(image.compute(), model.plan(SHAPE, 1e-2, device="cpu").simulate(scene))
        < ROUNDING["f32"]
    )


@pytest.mark.filterwarnings("ignore:the samples do not determine")
def test_an_interpolation_of_ones_own(scene) -> None:
    def linear(positions, values):
        terms = np.column_stack([np.ones(len(positions)), positions])
        slopes = np.linalg.lstsq(terms, values, rcond=None)[0]
        return lambda at: np.column_stack([np.ones(len(at)), at]) @ slopes

    model = model_of(interpolation=linear, field_shape=SHAPE)
    image = psfield.dask.simulate(da.from_array(scene, chunks=(50, 60)), model, 1e-3)
    expected = model.plan(SHAPE, 1e-3, device="cpu").simulate(scene)
    assert relative_l2(image.compute(scheduler="processes"), expected) < ROUNDING["f32"]


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("anchor", ["source", "output"])
@pytest.mark.parametrize("tolerance", [0.1, 1e-4, 0.0])
def test_any_tolerance(model, scene, tolerance, anchor, precision) -> None:
    lazy = da.from_array(scene, chunks=(50, 50))
    image = psfield.dask.simulate(lazy, model, tolerance, precision, anchor=anchor)
    expected = model.plan(SHAPE, tolerance, precision, "cpu", anchor=anchor).simulate(scene)
    assert image.dtype == expected.dtype
    assert image._meta.dtype == expected.dtype
    got = image.compute()
    assert got.dtype == expected.dtype
    assert relative_l2(got, expected) < ROUNDING[precision]


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((16, 10), {}),
        ((9, 20), {"centre": (18, 2)}),
        ((1, 1), {}),
        ((33, 33), {"oversampling": 2.0}),
        ((16, 16), {"pixel_response_included": False}),
    ],
    ids=["even", "off centre", "one pixel", "oversampled", "without pixel response"],
)
def test_stamps_that_reach_further_to_one_side(scene, shape, options) -> None:
    model = model_of(shape, **options)
    image = psfield.dask.simulate(da.from_array(scene, chunks=(40, 50)), model, 1e-3)
    assert (
        relative_l2(image.compute(), model.plan(SHAPE, 1e-3, device="cpu").simulate(scene))
        < ROUNDING["f32"]
    )


@pytest.mark.parametrize("stamp_size", [5, 8, 40])
def test_stamps_of_another_size(model, scene, stamp_size) -> None:
    image = psfield.dask.simulate(
        da.from_array(scene, chunks=(40, 50)), model, 1e-3, stamp_size=stamp_size
    )
    expected = model.plan(SHAPE, 1e-3, device="cpu", stamp_size=stamp_size).simulate(scene)
    assert relative_l2(image.compute(), expected) < ROUNDING["f32"]


def test_light_that_is_left_out_shows(model, scene, monkeypatch) -> None:
    """Missing light around a chunk is an error. It would give an image with seams."""
    monkeypatch.setattr(_simulate, "reach", lambda *_, **__: ((3, 3), (3, 3)))
    image = psfield.dask.simulate(da.from_array(scene, chunks=(40, 50)), model)
    with pytest.raises(RuntimeError, match="the image needs the light"):
        image.compute()


@pytest.mark.parametrize(
    "frame", [(13, 9, 80, 70), (0, 0, 150, 120), (149, 119, 1, 1), (1, 40, 149, 40)], ids=str
)
@pytest.mark.parametrize("chunks", [(30, 38), (7, 150)], ids=str)
def test_frame_inside_a_larger_scene(model, scene, frame, chunks) -> None:
    image = psfield.dask.simulate(da.from_array(scene, chunks=chunks), model, frame=frame)
    expected = model.plan(SHAPE, device="cpu", frame=frame).simulate(scene)
    assert image.shape == expected.shape
    assert relative_l2(image.compute(), expected) < ROUNDING["f32"]


def test_chunks_of_a_frame_are_those_of_the_scene(model, scene) -> None:
    image = psfield.dask.simulate(
        da.from_array(scene, chunks=(40, 50)), model, frame=(30, 0, 100, 90)
    )
    assert image.chunks == ((40, 40, 10), (20, 50, 30))


@pytest.mark.parametrize("oversample", [2, 3])
def test_finer_scenes(scene, oversample) -> None:
    model = model_of((21, 21), oversampling=3.0)
    image = psfield.dask.simulate(
        da.from_array(scene, chunks=(35, 47)), model, 1e-3, oversample=oversample
    )
    expected = model.plan(SHAPE, 1e-3, device="cpu", oversample=oversample).simulate(scene)
    assert image.shape == expected.shape == (120 // oversample, 150 // oversample)
    assert relative_l2(image.compute(), expected) < ROUNDING["f32"]


@pytest.mark.parametrize("oversample", [1, 2])
@pytest.mark.parametrize("shape", [(21, 21), (3, 3)], ids=["wide", "narrow"])
def test_scenes_integrated_over_their_pixels(scene, oversample, shape) -> None:
    """The filter makes stamps wider, those of narrow PSFs most."""
    model = model_of(shape, oversampling=float(oversample))
    words = {"oversample": oversample, "scene_pixels": "integrated"}
    image = psfield.dask.simulate(da.from_array(scene, chunks=(35, 47)), model, 1e-3, **words)
    expected = model.plan(SHAPE, 1e-3, device="cpu", **words).simulate(scene)
    assert relative_l2(image.compute(), expected) < ROUNDING["f32"]


def test_dark_chunks_cost_nothing(model, monkeypatch) -> None:
    planned = []
    plan = psfield.PsfModel.plan
    monkeypatch.setattr(
        psfield.PsfModel,
        "plan",
        lambda *given, **words: planned.append(words) or plan(*given, **words),
    )
    for kept in ("_PLANS", "_TILES"):
        monkeypatch.setattr(_region, kept, type(_region._PLANS)(100))
    dark = da.zeros(SHAPE, chunks=(30, 30), dtype=np.float32)
    image = psfield.dask.simulate(dark, model).compute()
    assert image.shape == SHAPE
    assert not image.any()
    assert not planned


def test_catalogue(model, scene) -> None:
    rng = np.random.default_rng(3)
    catalog = {
        "x": np.append(rng.uniform(-6, 156, 60), [49.0, 50.0, 49.5]),
        "y": np.append(rng.uniform(-6, 126, 60), [39.0, 40.0, 39.5]),
        "flux": np.append(rng.uniform(1, 100, 60), [500.0, 500.0, 500.0]),
    }
    lazy = da.from_array(scene, chunks=(40, 50))
    with pytest.warns(psfield.PsfieldWarning, match="stars"):
        image = psfield.dask.simulate(lazy, model, catalog=catalog).compute(scheduler="sync")
    with pytest.warns(psfield.PsfieldWarning, match="stars"):
        expected = model.plan(SHAPE, device="cpu").simulate(scene, catalog)
    assert relative_l2(image, expected) < ROUNDING["f32"]


@pytest.mark.filterwarnings("ignore:the PSF stamps are too coarse:psfield.PsfieldWarning")
def test_galaxies(model) -> None:
    catalog = {
        "x": [20.0, 99.0, 149.5],
        "y": [20.0, 80.0, 3.0],
        "flux": [1e3, 2e3, 1e3],
        "re": [4.0, 9.0, 5.0],
        "n": [1.0, 4.0, 2.0],
    }
    image = psfield.dask.simulate(
        da.zeros(SHAPE, chunks=(40, 50)), model, catalog=catalog
    ).compute()
    expected = model.plan(SHAPE, device="cpu").simulate(np.zeros(SHAPE), catalog)
    assert relative_l2(image, expected) < ROUNDING["f32"]


@pytest.mark.parametrize("dtype", ["u1", ">i2", ">f4", "<f8", "?"])
def test_types_of_scenes(model, scene, dtype) -> None:
    pixels = (scene * 200).astype(dtype)
    image = psfield.dask.simulate(da.from_array(pixels, chunks=(60, 60)), model)
    assert image.dtype == np.float32
    expected = model.plan(SHAPE, device="cpu").simulate(pixels)
    assert relative_l2(image.compute(), expected) < ROUNDING["f32"]


def test_nothing_is_computed_before_it_is_asked_for(model) -> None:
    def refuse(block):
        raise AssertionError("computed")

    lazy = da.zeros(SHAPE, chunks=(40, 50)).map_blocks(refuse, dtype=float, meta=np.empty((0, 0)))
    image = psfield.dask.simulate(lazy, model)
    assert image.shape == SHAPE
    with pytest.raises(AssertionError, match="computed"):
        image.compute()


def test_same_scene_same_name(model, scene) -> None:
    lazy = da.from_array(scene, chunks=(40, 50))
    name = psfield.dask.simulate(lazy, model).name
    assert psfield.dask.simulate(lazy, model_of()).name == name
    assert psfield.dask.simulate(lazy, model, 1e-3).name != name
    assert psfield.dask.simulate(lazy, model_of((15, 15))).name != name
    catalog = {"x": [1.0], "y": [1.0], "flux": [1.0]}
    assert psfield.dask.simulate(lazy, model, catalog=catalog).name != name


def test_pixels_that_cannot_be(model, scene) -> None:
    bad = scene.copy()
    bad[100, 20] = np.nan
    image = psfield.dask.simulate(da.from_array(bad, chunks=(40, 50)), model)
    with pytest.raises(ValueError, match="is NaN"):
        image.compute()
    # A chunk that the light of this pixel does not reach.
    assert np.isfinite(image[:30, 80:].compute()).all()
    masked = np.ma.masked_less(scene, 0.5)
    with pytest.raises(ValueError, match="masked: fill them"):
        psfield.dask.simulate(
            da.from_array(masked, chunks=(40, 50), asarray=False), model
        ).compute()


def test_scenes_that_cannot_be(model, scene) -> None:
    lazy = da.from_array(scene, chunks=(40, 50))
    with pytest.raises(TypeError, match="from_array"):
        psfield.dask.simulate(scene, model)
    with pytest.raises(ValueError, match="compute_chunk_sizes"):
        psfield.dask.simulate(lazy[lazy[:, 0] > 0.1], model)
    with pytest.raises(ValueError, match=r"\[y, x\]"):
        psfield.dask.simulate(lazy[None], model)
    with pytest.raises(ValueError, match="empty"):
        psfield.dask.simulate(lazy[:0], model)
    with pytest.raises(TypeError, match="real numbers"):
        psfield.dask.simulate(lazy * 1j, model)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tolerance": 1.0}, "tolerance must be"),
        ({"tolerance": np.nan}, "tolerance must be"),
        ({"precision": "f16"}, "precision must be f32 or f64"),
        ({"device": "tpu"}, "device must be auto, cpu or gpu"),
        ({"anchor": "here"}, "anchor must be source or output"),
        ({"method": "direct"}, "method must be auto or lowrank"),
        ({"oversample": 0}, "oversample must be at least 1"),
        ({"oversample": 7}, "must be a multiple of oversample=7"),
        ({"stamp_size": 0}, "stamp_size must be at least 1"),
        ({"frame": (0, 0, 151, 120)}, "reaches beyond the scene"),
        ({"frame": (-1, 0, 10, 10)}, "reaches beyond the scene"),
        ({"frame": (0, 0, 0, 10)}, "a frame of 0 x 10 pixels is empty"),
        ({"catalog": {"x": [1.0]}}, "there is no such column"),
    ],
    ids=str,
)
def test_options_that_cannot_be(model, scene, options, message) -> None:
    with pytest.raises(ValueError, match=message):
        psfield.dask.simulate(da.from_array(scene, chunks=(40, 50)), model, **options)

"""Invalid arguments: the error names the argument and the values that it accepts."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import gaussian_stamp

import psfield
from psfield import detector, metrics


@pytest.mark.parametrize(
    ("settings", "error", "text"),
    [
        ({"tolerance": "1e-3"}, TypeError, "tolerance must be a number, got '1e-3'"),
        ({"tolerance": None}, TypeError, "tolerance must be a number, got None"),
        ({"precision": 32}, TypeError, "precision must be f32 or f64"),
        ({"precision": None}, TypeError, "precision must be f32 or f64"),
        ({"precision": np.float16}, ValueError, "precision must be f32 or f64"),
        ({"precision": "f16"}, ValueError, "got 'f16'"),
        ({"device": "cuda"}, ValueError, "device must be auto, cpu or gpu, got cuda"),
        ({"memory": -1}, ValueError, "memory must be at least 0, got -1"),
        ({"memory": 1e9}, TypeError, "memory must be an integer"),
        ({"memory": 2**70}, ValueError, "memory must be at most"),
        ({"oversample": 2.0}, TypeError, "oversample must be an integer, got 2.0"),
        ({"stamp_size": -3}, ValueError, "stamp_size must be at least 1, got -3"),
        ({"gpu_adapter": 3}, TypeError, "gpu_adapter must be a string, got 3"),
    ],
)
def test_plans(model, settings, error, text):
    with pytest.raises(error, match=re.escape(text)):
        model.plan((96, 128), **settings)


def test_plans_are_made_by_models(model):
    with pytest.raises(TypeError, match=re.escape("make a Plan with PsfModel.plan")):
        psfield.Plan(model, (96, 128))


def test_the_region_of_another_plan(model):
    with pytest.raises(TypeError, match="region must be"):
        model.plan((96, 128), region=(0, 0, 20, 20)).for_region(None)


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"seed": -1}, ValueError, "seed must be at least 0, got -1"),
        ({"pixels": 2.5}, TypeError, "pixels must be an integer"),
        ({"pixels": 10**12}, ValueError, "pixels must be at most 12288"),
    ],
)
def test_spot_checks(model, scene, options, error, text):
    with pytest.raises(error, match=text):
        model.plan(scene.shape, 1e-3).spot_check(scene, **options)


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"centre": 3}, TypeError, "centre must be two numbers (x, y), got 3"),
        ({"centre": (1, 2, 3)}, TypeError, "centre must be two numbers"),
        ({"oversampling": (2, 2)}, TypeError, "oversampling must be a number, got (2, 2)"),
        ({"noise": "0.1"}, TypeError, "noise must be a number"),
        ({"interpolation": 3}, TypeError, "interpolation must be a name, an object"),
        ({"normalise": True}, TypeError, "normalise must be a string, got True"),
        # bool("no") is True.
        (
            {"pixel_response_included": "no"},
            TypeError,
            "pixel_response_included must be True or False, got 'no'",
        ),
    ],
)
def test_models(options, error, text):
    with pytest.raises(error, match=re.escape(text)):
        psfield.PsfModel.from_samples([gaussian_stamp(1.5)], [(1, 1)], **options)


def test_no_stamps_at_all():
    with pytest.raises(ValueError, match="stamps is empty"):
        psfield.PsfModel.from_samples([], [])


def test_tables_without_positions():
    with pytest.raises(ValueError, match="positions must be a table with columns x and y"):
        psfield.PsfModel.from_samples([gaussian_stamp(1.5)], {"ra": [1.0], "dec": [2.0]})


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"size": 2.5}, TypeError, "size must be an integer, got 2.5"),
        ({"size": "7"}, TypeError, "size must be an integer, got '7'"),
        ({"size": 2**62}, ValueError, "would fill more than"),
        ({"sub_pixel": 2}, TypeError, "sub_pixel must be True or False, got 2"),
        ({"pixels": "native"}, ValueError, "pixels must be stamp or frame, got native"),
    ],
)
def test_evaluate(model, options, error, text):
    with pytest.raises(error, match=re.escape(text)):
        model.evaluate(3.0, 4.0, **options)


def test_positions_that_do_not_go_together(model):
    with pytest.raises(
        ValueError, match=re.escape("x and y of the shapes (2,) and (3,) cannot be broadcast")
    ):
        model.evaluate([1, 2], [1, 2, 3])


@pytest.mark.parametrize(
    ("count", "error"),
    [(0, ValueError), (-1, ValueError), (1.5, TypeError), ("2", TypeError), (10**9, ValueError)],
)
def test_threads(count, error):
    with pytest.raises(error, match="count must be"):
        psfield.set_threads(count)


def test_columns_that_differ_in_case_alone(model):
    plan = model.plan((96, 128), 1e-3)
    expected = plan.simulate(catalog={"x": [40.0], "y": [30.0], "flux": [1.0]})
    # The column with exactly the right name is used.
    for table in (
        {"X": [41.0], "x": [40.0], "y": [30.0], "flux": [1.0]},
        {"x": [40.0], "X": [41.0], "y": [30.0], "flux": [1.0]},
    ):
        assert np.array_equal(plan.simulate(catalog=table), expected)
    with pytest.raises(ValueError, match='column "flux": the column exists more than once'):
        plan.simulate(catalog={"x": [40.0], "y": [30.0], "FLUX": [1.0], "Flux": [2.0]})


class TestUnits:
    """Units that cannot be converted are refused."""

    def test_magnitudes_do_not_add_up(self, model, scene):
        units = pytest.importorskip("astropy.units")
        plan = model.plan(scene.shape, 1e-3)
        with pytest.raises(ValueError, match="scene: its unit is mag"):
            plan.simulate(scene * units.mag)
        with pytest.raises(ValueError, match="catalog: flux: its unit is mag"):
            plan.simulate(catalog={"x": [1.0], "y": [1.0], "flux": [20.0] * units.mag})
        with pytest.raises(ValueError, match="catalog: flux: its unit is mag"):
            plan.simulate(catalog={"x": [1.0], "y": [1.0], "flux": [20.0] * units.ABmag})

    def test_angles_are_no_pixels(self, model):
        units = pytest.importorskip("astropy.units")
        at = np.array([[10.0, 20.0]])
        assert np.array_equal(
            model.evaluate(10 * units.pix, 20 * units.pix), model.evaluate(10, 20)
        )
        with pytest.raises(ValueError, match="x: 'arcsec'"):
            model.evaluate(10 * units.arcsec, 20)
        with pytest.raises(ValueError, match="positions: 'arcsec'"):
            psfield.PsfModel.from_samples([gaussian_stamp(1.5)], at * units.arcsec)
        catalog = {"x": [1.0], "y": [1.0], "flux": [1.0], "re": [3.0] * units.arcsec, "n": [1.0]}
        plan = model.plan((96, 128), 1e-3)
        with pytest.raises(ValueError, match="catalog: re: 'arcsec'"):
            plan.simulate(catalog=catalog)

    def test_out_has_the_unit_of_the_scene(self, model, scene):
        units = pytest.importorskip("astropy.units")
        plan = model.plan(scene.shape, 1e-3)
        out = np.zeros(scene.shape, np.float32) * units.Jy
        assert plan.simulate(scene * units.Jy, out=out) is out
        with pytest.raises(ValueError, match="out has the unit Jy, but the scene has none"):
            plan.simulate(scene, out=out)


class TestMetrics:
    @pytest.mark.parametrize(
        ("options", "error", "text"),
        [
            ({"size": -1}, ValueError, "size must be at least 0, got -1"),
            ({"size": 2.5}, TypeError, "size must be an integer"),
            ({"size": 3, "about": 3}, TypeError, "about must be (column, row)"),
            ({"size": 3, "about": (-1, 2)}, ValueError, "about: column must be at least 0"),
            # Without a size the window would be the whole stamp.
            ({"about": (3, 3)}, ValueError, "give its size too"),
        ],
    )
    def test_windows(self, options, error, text):
        for measured in (
            metrics.fit_gaussian,
            metrics.adaptive_moments,
            metrics.quadrupole_moments,
        ):
            with pytest.raises(error, match=re.escape(text)):
                measured(gaussian_stamp(1.5), **options)

    def test_starts(self):
        with pytest.raises(TypeError, match="start must be three numbers"):
            metrics.adaptive_moments(gaussian_stamp(1.5), start=3)
        with pytest.raises(ValueError, match="sigma must be above 0"):
            metrics.adaptive_moments(gaussian_stamp(1.5), start=(8, 8, -1))

    @pytest.mark.parametrize("bad", [None, "a", np.ones((2, 2), complex)])
    def test_what_cannot_be_compared(self, bad):
        with pytest.raises(TypeError, match="result must be real numbers"):
            metrics.compare(bad, np.ones((2, 2)))


def test_detectors(tmp_path):
    with pytest.raises(ValueError, match="sky_e must be finite, got nan"):
        detector.Detector(sky_e=float("nan"))
    with pytest.raises(FileNotFoundError, match=r"missing\.toml"):
        detector.Detector.from_toml(tmp_path / "missing.toml")


def test_rows_of_out_that_share_memory(model, scene):
    # Several threads must not write to the same bytes. The row written last wins, as in NumPy.
    plan = model.plan(scene.shape, 1e-3)
    memory = np.zeros(scene.size, np.float32)
    out = np.lib.stride_tricks.as_strided(memory, scene.shape, (4, 4))
    expected = plan.simulate(scene)
    plan.simulate(scene, out=out)
    assert memory[scene.shape[0] + scene.shape[1] - 2] == expected[-1, -1]


@pytest.mark.parametrize("raised", [KeyboardInterrupt, SystemExit])
def test_a_function_that_asks_for_an_end(raised):
    calls = []

    def draw(x, y):
        calls.append((x, y))
        if len(calls) > 3:
            raise raised
        return gaussian_stamp(1.5)

    with pytest.raises(raised):
        psfield.PsfModel.from_function(draw, (10, 10))

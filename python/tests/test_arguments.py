"""Arguments that cannot be: the error names the argument and says what it should be."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import gaussian_stamp

import psfield


@pytest.mark.parametrize(
    ("settings", "error", "text"),
    [
        ({"tolerance": "1e-3"}, TypeError, "tolerance must be a number, got '1e-3'"),
        ({"tolerance": None}, TypeError, "tolerance must be a number, got None"),
        ({"precision": np.float32}, TypeError, "precision must be a text"),
        ({"precision": "float32"}, ValueError, "precision must be f32 or f64, got float32"),
        ({"device": "cuda"}, ValueError, "device must be auto, cpu or gpu, got cuda"),
        ({"memory": -1}, ValueError, "memory must be at least 0, got -1"),
        ({"memory": 1e9}, TypeError, "memory must be a whole number"),
        ({"memory": 2**70}, ValueError, "memory must be at most"),
        ({"oversample": 2.0}, TypeError, "oversample must be a whole number, got 2.0"),
        ({"stamp_size": -3}, ValueError, "stamp_size must be at least 1, got -3"),
        ({"stamp_size": 2**62}, ValueError, "would fill more than"),
        ({"gpu_adapter": 3}, TypeError, "gpu_adapter must be a text, got 3"),
    ],
)
def test_plans(model, settings, error, text):
    with pytest.raises(error, match=re.escape(text)):
        model.plan((96, 128), **settings)


def test_plans_are_made_by_models(model):
    with pytest.raises(TypeError, match=re.escape("use PsfModel.plan")):
        psfield.Plan(model, (96, 128))


def test_the_region_of_another_plan(model):
    with pytest.raises(TypeError, match="region must be"):
        model.plan((96, 128), region=(0, 0, 20, 20)).for_region(None)


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"seed": -1}, ValueError, "seed must be at least 0, got -1"),
        ({"pixels": 2.5}, TypeError, "pixels must be a whole number"),
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
        ({"interpolation": 3}, TypeError, "interpolation must be a text, got 3"),
        ({"normalise": True}, TypeError, "normalise must be a text, got True"),
        # A text that says no would be taken for yes.
        ({"pixel_response_included": "no"}, TypeError, "pixel_response_included must be True or False, got 'no'"),
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
        ({"size": 2.5}, TypeError, "size must be a whole number, got 2.5"),
        ({"size": "7"}, TypeError, "size must be a whole number, got '7'"),
        ({"size": 2**62}, ValueError, "would fill more than"),
        ({"sub_pixel": 2}, TypeError, "sub_pixel must be True or False, got 2"),
        ({"pixels": "native"}, ValueError, "pixels must be stamp or frame, got native"),
    ],
)
def test_evaluate(model, options, error, text):
    with pytest.raises(error, match=re.escape(text)):
        model.evaluate(3.0, 4.0, **options)


def test_positions_that_do_not_go_together(model):
    with pytest.raises(ValueError, match=re.escape("x and y of the shapes (2,) and (3,) cannot be broadcast")):
        model.evaluate([1, 2], [1, 2, 3])


@pytest.mark.parametrize(("count", "error"), [(0, ValueError), (-1, ValueError), (1.5, TypeError), ("2", TypeError), (10**9, ValueError)])
def test_threads(count, error):
    with pytest.raises(error, match="count must be"):
        psfield.set_threads(count)


def test_columns_that_differ_in_case_alone(model):
    plan = model.plan((96, 128), 1e-3)
    expected = plan.simulate(catalog={"x": [40.0], "y": [30.0], "flux": [1.0]})
    # That of the very name is meant.
    for table in ({"X": [41.0], "x": [40.0], "y": [30.0], "flux": [1.0]}, {"x": [40.0], "X": [41.0], "y": [30.0], "flux": [1.0]}):
        assert np.array_equal(plan.simulate(catalog=table), expected)
    with pytest.raises(ValueError, match="which column is flux: FLUX or Flux"):
        plan.simulate(catalog={"x": [40.0], "y": [30.0], "FLUX": [1.0], "Flux": [2.0]})

"""The tests of deepinv for linear operators, run with `psfield.torch.SpatiallyVaryingBlur`."""

from __future__ import annotations

import functools
import importlib
import inspect
import itertools

import numpy as np
import pytest
from conftest import gaussian_stamp

import psfield

torch = pytest.importorskip("torch")
deepinv = pytest.importorskip("deepinv")

from psfield.torch import SpatiallyVaryingBlur  # noqa: E402

theirs = importlib.import_module("deepinv.tests.test_physics")

#: One of their operators, which all tests of linear operators name.
KNOWN = "deblur_valid"
#: Their tests look for this name in lists, and make no exceptions for it.
NAME = "inpainting"
#: Their tests of linear operators at least. Fewer would mean that they have other names now.
LEAST = 18


@functools.cache
def blur_of(shape: tuple[int, int]) -> SpatiallyVaryingBlur:
    """A PSF that widens to the right, narrow enough for a stable inverse."""
    corners = [(x, y) for y in (0, shape[0] - 1) for x in (0, shape[1] - 1)]
    stamps = [gaussian_stamp(0.55 if x == 0 else 0.7, 7) for x, _ in corners]
    model = psfield.PsfModel.from_samples(stamps, corners, field_shape=shape)
    return SpatiallyVaryingBlur(model.plan(shape, 1e-5))


@functools.cache
def squared_norm(shape: tuple[int, int]) -> float:
    """The largest squared singular value of the plan as a matrix."""
    plan = blur_of(shape).plan
    pixels = np.eye(shape[0] * shape[1], dtype=np.float32).reshape(-1, *shape)
    matrix = plan.simulate(pixels).reshape(len(pixels), -1)
    return float(np.linalg.norm(matrix.astype(float), 2) ** 2)


def find_operator(name, device, imsize=None, get_physics_param=False):
    """Return what their function of this name returns, for one operator."""
    imsize = imsize or (2, 16, 20)
    blur = blur_of(tuple(imsize[-2:]))
    physics = deepinv.physics.LinearPhysics(A=blur, A_adjoint=blur.adjoint, img_size=imsize)
    found = (physics, imsize, torch.tensor(squared_norm(blur.plan.shape)), torch.float32)
    return (*found, []) if get_physics_param else found


def linear_tests():
    """Yield their tests of linear operators with all arguments but the name of the operator."""
    for name, test in vars(theirs).items():
        marks = [mark.args for mark in getattr(test, "pytestmark", ()) if mark.args]
        if not name.startswith("test_") or KNOWN not in dict(marks[::-1]).get("name", ()):
            continue
        others = {argument: values for argument, values in marks if argument != "name"}
        for values in itertools.product(*others.values()):
            words = dict(zip(others, values))
            yield pytest.param(test, words, id="-".join([name, *map(str, values)]))


def run(test, words, monkeypatch, folder, finder=find_operator):
    monkeypatch.setattr(theirs, "find_operator", finder)
    monkeypatch.chdir(folder)
    torch.manual_seed(0)
    fixtures = {"device": torch.device("cpu"), "rng": torch.Generator().manual_seed(0)}
    needed = inspect.signature(test).parameters
    given = {"name": NAME, **words, **fixtures}
    test(**{argument: given[argument] for argument in needed})


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(("test", "words"), list(linear_tests()))
def test_theirs(test, words, monkeypatch, tmp_path):
    run(test, words, monkeypatch, tmp_path)


def test_their_tests_are_found():
    assert len(list(linear_tests())) >= LEAST


@pytest.mark.filterwarnings("default")
def test_a_wrong_adjoint_fails(monkeypatch, tmp_path):
    def wrong(*arguments, **words):
        physics, *others = find_operator(*arguments, **words)
        blur = physics.forw
        return deepinv.physics.LinearPhysics(A=blur, A_adjoint=blur), *others

    with pytest.raises(AssertionError):
        run(theirs.test_operators_adjointness, {}, monkeypatch, tmp_path, wrong)

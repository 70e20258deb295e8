"""Plans as linear operators: adjoints, SciPy's interface, deconvolution."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from conftest import relative_l2, widening_model

#: Rounding of scalar products of 10^4 numbers.
DOT = {"f32": 1e-6, "f64": 1e-12}


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize(
    "words",
    [
        {},
        {"anchor": "output"},
        {"frame": (10, 5, 100, 80)},
        {"oversample": 2},
        {"region": (30, 20, 50, 41)},
        {"frame": (10, 5, 100, 80), "region": (0, 0, 17, 80), "anchor": "output"},
    ],
)
def test_dot_products(precision, words):
    operator = widening_model().plan((96, 128), 1e-3, precision, **words).linear_operator()
    rng = np.random.default_rng(5)
    rows, columns = operator.shape
    scene, image = (
        rng.random(columns).astype(operator.dtype),
        rng.random(rows).astype(operator.dtype),
    )
    forward = np.dot(operator.matvec(scene).astype(float), image.astype(float))
    backward = np.dot(scene.astype(float), operator.rmatvec(image).astype(float))
    assert abs(forward - backward) <= DOT[precision] * abs(forward)


@pytest.mark.parametrize("words", [{}, {"region": (30, 20, 50, 41)}])
def test_stacks_of_any_axes(words):
    plan = widening_model().plan((96, 128), 1e-3, **words)
    rng = np.random.default_rng(5)
    scenes = rng.random((2, 96, 128))
    images = plan.simulate(scenes)
    assert np.array_equal(plan.simulate(scenes[:, None]), images[:, None])
    assert np.array_equal(plan.simulate(list(scenes[:, None])), images[:, None])
    out = np.empty((2, 1, *plan.image_shape), np.float32)
    assert plan.simulate(scenes[:, None], out=out) is out and np.array_equal(out[:, 0], images)
    apart = np.empty((4, 1, *plan.image_shape), np.float32)[::2]
    assert np.array_equal(plan.simulate(scenes[:, None], out=apart)[:, 0], images)
    back = plan.adjoint(images)
    assert np.array_equal(back, [plan.adjoint(image) for image in images])
    assert np.array_equal(plan.adjoint(images[:, None]), back[:, None])
    assert np.array_equal(plan.adjoint(list(images)), back)
    with pytest.raises(ValueError, match="images of shape"):
        plan.adjoint(images[..., 1:])
    with pytest.raises(ValueError, match=r"scene\[1\] has the shape"):
        plan.simulate([scenes[0], scenes[1, 1:]])


def test_scipy_solves_with_it():
    linalg = pytest.importorskip("scipy.sparse.linalg")
    plan = widening_model().plan((96, 128), 0.0, "f64")
    truth = np.zeros((96, 128))
    truth[20:70:10, 15:120:15] = 10.0
    image = plan.simulate(truth)
    found = linalg.lsqr(plan.linear_operator(), image.ravel(), atol=0, btol=0, iter_lim=200)[
        0
    ].reshape(truth.shape)
    # The residual of the solution. The truth has details that the PSF removes.
    assert relative_l2(plan.simulate(found), image) < 1e-2
    assert relative_l2(found, truth) < relative_l2(image, truth)


def test_richardson_lucy_improves_for_twenty_iterations():
    plan = widening_model().plan((96, 128), 1e-4, "f64")
    truth = np.full((96, 128), 1.0)
    # Stars, and squares of a few pixels.
    truth[10:90:16, 10:120:16] += 200.0
    for y, x in [(20, 20), (50, 90), (70, 40)]:
        truth[y : y + 6, x : x + 8] += 50.0
    image = plan.simulate(truth)
    weight = plan.adjoint(np.ones(plan.image_shape))
    estimate = np.full(plan.shape, image.mean())
    errors = [relative_l2(estimate, truth)]
    for _ in range(20):
        estimate *= plan.adjoint(image / plan.simulate(estimate)) / weight
        errors.append(relative_l2(estimate, truth))
    assert all(after < before for before, after in itertools.pairwise(errors))
    assert errors[-1] < 0.9 * errors[1]


@pytest.mark.parametrize("anchor", ["source", "output"])
def test_regions_put_together_are_the_whole(anchor):
    model = widening_model()
    scene = np.random.default_rng(8).random((96, 128))
    for words in ({}, {"frame": (9, 4, 110, 85)}):
        whole = model.plan(scene.shape, 1e-2, anchor=anchor, **words)
        image = whole.simulate(scene)
        rows, columns = image.shape
        pieces = np.full_like(image, np.nan)
        plan = None
        for y in range(0, rows, 37):
            for x in range(0, columns, 50):
                region = (x, y, min(50, columns - x), min(37, rows - y))
                plan = (
                    plan.for_region(region)
                    if plan
                    else model.plan(scene.shape, 1e-2, anchor=anchor, region=region, **words)
                )
                x0, y0, nx, ny = plan.light_region
                piece = plan.simulate(scene[y0 : y0 + ny, x0 : x0 + nx])
                assert piece.shape == plan.image_shape == (region[3], region[2])
                assert (
                    np.array_equal(piece, plan.simulate(scene))
                    or relative_l2(piece, plan.simulate(scene)) < 1e-6
                )
                pieces[y : y + region[3], x : x + region[2]] = piece
        assert relative_l2(pieces, image.astype(float)) < 1e-6
        assert plan.region == region


def test_regions_that_cannot_be():
    model = widening_model()
    with pytest.raises(ValueError, match="region"):
        model.plan((96, 128), region=(100, 0, 50, 10))
    with pytest.raises(TypeError, match="four integers"):
        model.plan((96, 128), region=(0, 0, 5))
    with pytest.raises(ValueError, match="is empty"):
        model.plan((96, 128), region=(0, 0, 0, 5))
    plan = model.plan((96, 128), region=(10, 10, 20, 20))
    with pytest.raises(ValueError, match="for the light_region"):
        plan.simulate(np.ones((20, 20)))
    with pytest.raises(ValueError, match="cannot be checked"):
        plan.spot_check(np.ones((96, 128)))

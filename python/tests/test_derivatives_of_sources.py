"""`SpatiallyVaryingBlur.draw` of `psfield.torch` and `psfield.jax`: images, derivatives, errors."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import widening_model

import psfield

torch = pytest.importorskip("torch")
jax = pytest.importorskip("jax")

from psfield.jax import SpatiallyVaryingBlur as BlurInJax  # noqa: E402
from psfield.torch import SpatiallyVaryingBlur  # noqa: E402

SHAPE = (60, 80)
COLUMNS = ("x", "y", "flux", "re", "n", "q", "angle")
#: Plans whose images differ in shape or in meaning.
PLANS = [
    {},
    {"anchor": "output"},
    {"frame": (10, 5, 60, 50)},
    {"region": (30, 20, 40, 31)},
]
#: The stamps are coarse, which does not matter for derivatives.
pytestmark = pytest.mark.filterwarnings("ignore:the PSF stamps are too coarse")
#: Comparison with differences. The fast mode multiplies the Jacobian matrix by random vectors.
DIFFERENCES = {"atol": 1e-6, "rtol": 1e-6, "fast_mode": True, "check_undefined_grad": False}


def plan_of(tolerance=0.0, precision="f64", **words):
    return widening_model(SHAPE).plan(SHAPE, tolerance, precision, floor=0.0, **words)


def stars(count=30, seed=4):
    """Stars on the frame and beyond its edges, one of them without flux."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-5, 85, count), rng.uniform(-5, 65, count)
    flux = rng.uniform(0.5, 3.0, count)
    flux[0] = 0.0
    return {"x": x, "y": y, "flux": flux}


def galaxies(count=5, seed=5, star=False):
    """Galaxies and, if wanted, a star."""
    rng = np.random.default_rng(seed)
    re = rng.uniform(1.0, 3.0, count)
    if star:
        re[-1] = 0.0
    return {
        **stars(count, seed),
        "re": re,
        "n": rng.uniform(0.7, 1.5, count),
        "q": rng.uniform(0.3, 0.9, count),
        "angle": rng.uniform(0.0, 180.0, count),
    }


def tensors(catalog):
    return {name: torch.tensor(values, requires_grad=True) for name, values in catalog.items()}


def gradients(draw, catalog, weights):
    """Return the gradient of ``sum(weights * draw(catalog))`` by PyTorch."""
    given = tensors(catalog)
    (draw(given) * weights).sum().backward()
    return {name: values.grad.numpy() for name, values in given.items()}


@pytest.mark.parametrize("words", PLANS)
@pytest.mark.parametrize("catalog", [stars(), galaxies(star=True)], ids=["stars", "galaxies"])
def test_images_are_those_of_the_plan(catalog, words):
    plan = plan_of(1e-3, "f32", **words)
    seen = {**catalog, "flux": np.where(catalog["flux"] == 0, 1e-30, catalog["flux"])}
    expected = plan.simulate(catalog=seen)
    image = SpatiallyVaryingBlur(plan).draw(tensors(catalog))
    assert image.dtype == torch.float32
    np.testing.assert_allclose(image.detach(), expected, atol=1e-7 * expected.max())
    in_jax = BlurInJax(plan).draw({name: values.astype("f4") for name, values in catalog.items()})
    np.testing.assert_allclose(in_jax, expected, atol=1e-4 * expected.max())


@pytest.mark.parametrize("words", PLANS)
def test_derivatives_with_respect_to_stars(words):
    blur = SpatiallyVaryingBlur(plan_of(**words))

    def draw(*columns):
        return blur.draw(dict(zip(COLUMNS, columns, strict=False)))

    assert torch.autograd.gradcheck(draw, tuple(tensors(stars()).values()), eps=1e-6, **DIFFERENCES)


@pytest.mark.parametrize("words", PLANS)
def test_derivatives_with_respect_to_galaxies(words):
    blur = SpatiallyVaryingBlur(plan_of(1e-9, **words))

    def draw(*columns):
        return blur.draw(dict(zip(COLUMNS, columns, strict=True)))

    assert torch.autograd.gradcheck(
        draw, tuple(tensors(galaxies()).values()), eps=1e-4, **DIFFERENCES
    )


def test_derivatives_within_a_tolerance():
    weights = torch.rand(SHAPE, dtype=torch.float64)
    catalog = galaxies(12, star=True)
    exact = gradients(SpatiallyVaryingBlur(plan_of(1e-9)).draw, catalog, weights)
    blur = SpatiallyVaryingBlur(plan_of(1e-4, "f32"))
    for name, found in gradients(blur.draw, catalog, weights.float()).items():
        error = np.abs(found - exact[name]).max() / np.abs(exact[name]).max()
        assert error < 1e-3, name


def test_both_packages_agree():
    plan, catalog = plan_of(), galaxies(star=True)
    weights = np.random.default_rng(1).random(SHAPE)
    expected = gradients(SpatiallyVaryingBlur(plan).draw, catalog, torch.tensor(weights))
    jax.config.update("jax_enable_x64", True)
    try:
        found = jax.jit(jax.grad(lambda given: (BlurInJax(plan).draw(given) * weights).sum()))(
            catalog
        )
    finally:
        jax.config.update("jax_enable_x64", False)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12, atol=1e-14)


def test_single_numbers_and_batches():
    plan = plan_of(1e-4, "f32")
    blur, in_jax = SpatiallyVaryingBlur(plan), BlurInJax(plan)
    x = torch.tensor([[20.0, 41.5], [30.25, 10.0]], requires_grad=True)
    weights = torch.rand(2, *SHAPE)
    images = blur.draw({"x": x, "y": 30.0, "flux": [2.0, 1.0]})
    (images * weights).sum().backward()
    each = [blur.draw({"x": row, "y": 30.0, "flux": [2.0, 1.0]}) for row in x]
    assert torch.equal(images, torch.stack(each))
    mapped = torch.func.vmap(
        torch.func.grad(lambda x, g: (blur.draw({"x": x, "y": 30.0, "flux": 1.0}) * g).sum())
    )(x.detach(), weights)
    assert torch.allclose(mapped * torch.tensor([2.0, 1.0]), x.grad, rtol=1e-5)
    found = jax.vmap(
        jax.grad(lambda x, g: (in_jax.draw({"x": x, "y": 30.0, "flux": 1.0}) * g).sum())
    )(x.detach().numpy(), weights.numpy())
    np.testing.assert_allclose(found, mapped, rtol=1e-4)
    shared = jax.vmap(
        jax.grad(lambda g, x: (in_jax.draw({"x": x, "y": 30.0, "flux": 1.0}) * g).sum(), 1),
        (0, None),
    )
    np.testing.assert_allclose(
        shared(weights.numpy(), x[0].detach().numpy())[0], found[0], rtol=1e-4
    )
    assert blur.draw({"x": [], "y": [], "flux": []}).sum() == 0.0


def test_plain_numbers_keep_their_digits():
    plan = plan_of()
    star = {"x": [30.1], "y": 20.7, "flux": [1000.1]}
    expected = plan.simulate(catalog=star)
    np.testing.assert_allclose(SpatiallyVaryingBlur(plan).draw(star), expected, rtol=1e-12)


def test_derivatives_are_taken_once():
    blur = SpatiallyVaryingBlur(plan_of())
    x = torch.tensor([30.0], dtype=torch.float64, requires_grad=True)
    image = blur.draw({"x": x, "y": 30.0, "flux": 1.0})
    (gradient,) = torch.autograd.grad((image**2).sum(), x, create_graph=True)
    with pytest.raises(RuntimeError, match="only once"):
        gradient.sum().backward()


@pytest.mark.parametrize("blur", [SpatiallyVaryingBlur, BlurInJax])
def test_errors(blur):
    draw = blur(plan_of(1e-3, "f32")).draw
    good = {"x": [1.0], "y": [1.0], "flux": [1.0]}
    for catalog, error, words in [
        ([1.0, 2.0], TypeError, "catalog must be a dict"),
        ({"x": [1.0], "y": [1.0]}, ValueError, "needs a column 'flux'"),
        ({**good, "re": [1.0]}, ValueError, "needs a column 'n'"),
        ({**good, "mag": [20.0]}, ValueError, "a column 'mag'"),
        ({**good, "x": [float("nan")]}, ValueError, "source 0"),
        (
            {**good, "re": 1.0, "n": 1.0, "q": 1.5, "angle": 0.0},
            ValueError,
            "source 0: .*axis ratio",
        ),
    ]:
        with pytest.raises(error, match=words):
            draw(catalog)


def test_wings_have_no_derivatives(tmp_path):
    widening_model(SHAPE, across=3, size=41).write(tmp_path / "core.fits")
    model = psfield.PsfModel.read(tmp_path / "core.fits", wings="power=3,40")
    x = torch.tensor([30.0], requires_grad=True)
    image = SpatiallyVaryingBlur(model.plan(SHAPE)).draw({"x": x, "y": 30.0, "flux": 1.0})
    with pytest.raises(ValueError, match="wings"):
        image.sum().backward()

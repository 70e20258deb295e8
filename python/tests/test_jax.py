"""`psfield.jax`: results of the plan, transformations in any order, errors."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from conftest import ROOT, gaussian_stamp, widening_model

import psfield

jax = pytest.importorskip("jax")

from psfield.jax import SpatiallyVaryingBlur  # noqa: E402

SHAPE = (96, 128)
PLANS = [
    {},
    {"anchor": "output"},
    {"frame": (10, 5, 100, 80)},
    {"oversample": 2},
    {"region": (30, 20, 50, 41)},
]
#: Rounding of differences of numbers of about 1 in double precision.
ROUNDING = 1e-12
#: Rounding of sums of 10^4 numbers in single precision, added in two orders.
ROUNDING_F32 = 1e-5
#: Step of central differences, for parameters of about 0.01 to 1.
STEP = 1e-5
#: Error of central differences with this step: rounding of a sum of 600 pixels, over the step.
CENTRAL_DIFFERENCES = 1e-7
#: Error of derivatives in single precision, relative to the largest: rounding, and the tolerance
#: 1e-5 of the plan and of the weights of the samples.
OF_PLAN_F32 = 1e-4


def blur_of(precision="f32", tolerance=1e-3, **words):
    return SpatiallyVaryingBlur(widening_model(SHAPE).plan(SHAPE, tolerance, precision, **words))


def random(*shape, dtype=np.float32):
    return np.random.default_rng(7).random(shape).astype(dtype)


@contextlib.contextmanager
def x64(on):
    jax.config.update("jax_enable_x64", on)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.fixture(scope="module")
def blur():
    return blur_of()


@pytest.mark.parametrize("words", PLANS)
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_results_are_those_of_the_plan(precision, words):
    blur = blur_of(precision, **words)
    plan = blur.plan
    _, _, columns, rows = plan.light_region
    shape = (rows, columns) if plan.region else plan.shape
    with x64(precision == "f64"):
        for outer in [(), (2, 3), (1, 1), (0, 2)]:
            light = random(*outer, *shape, dtype=plan.dtype)
            image = random(*outer, *plan.image_shape, dtype=plan.dtype)
            made, back = blur(light), blur.adjoint(image)
            assert made.shape == image.shape and back.shape == light.shape
            assert made.dtype == back.dtype == plan.dtype
            if light.size:
                assert np.array_equal(made, plan.simulate(light))
                assert np.array_equal(back, plan.adjoint(image))
            assert np.array_equal(jax.jit(blur)(light), made)
            assert np.array_equal(jax.jit(blur.adjoint)(image), back)
            assert np.array_equal(jax.vjp(blur, light)[1](image)[0], back)


def test_whole_scenes_of_a_region():
    blur = blur_of(region=(30, 20, 50, 41))
    x0, y0, columns, rows = blur.plan.light_region
    light = random(2, *SHAPE)
    assert np.array_equal(blur(light), blur.plan.simulate(light))
    expected = np.zeros_like(light)
    expected[:, y0 : y0 + rows, x0 : x0 + columns] = blur.adjoint(np.ones((2, 41, 50), np.float32))
    assert np.array_equal(jax.grad(lambda x: blur(x).sum())(light), expected)


def test_transformations(blur):
    light = jax.numpy.asarray(random(4, 3, *SHAPE))
    image = blur(light)
    gradient = blur.adjoint(2 * image)

    def square(x):
        return (blur(x) ** 2).sum()

    for wrap in (lambda function: function, jax.jit):
        for axis in (0, 1, -1):
            moved = jax.numpy.moveaxis(light, 0, axis)
            assert np.array_equal(wrap(jax.vmap(blur, axis))(moved), image)
            assert np.array_equal(wrap(jax.vmap(jax.vmap(blur), axis, 1))(moved)[:, 2], image[2])
        assert np.array_equal(wrap(jax.grad(square))(light), gradient)
        assert np.array_equal(wrap(jax.vmap(jax.grad(square)))(light), gradient)
        assert np.array_equal(wrap(jax.grad(jax.checkpoint(square)))(light), gradient)
        tangent = wrap(lambda x: jax.jvp(blur, (x,), (3 * x,))[1])(light)
        assert np.array_equal(tangent, blur(3 * light))
        transposed = wrap(jax.linear_transpose(blur, light))(2 * image)[0]
        assert np.array_equal(transposed, gradient)
        curvature = wrap(jax.hessian(lambda s: square(s * light[0, 0])))(2.0)
        assert np.isclose(curvature, 2 * (image[0, 0] ** 2).sum(), rtol=ROUNDING_F32)
    assert np.array_equal(jax.lax.map(blur, light), image)


def test_one_call_for_a_batch(blur, monkeypatch):
    shapes = []

    def applied(plan, pixels, transposed):
        shapes.append(pixels.shape)
        return np.zeros_like(pixels)

    monkeypatch.setattr("psfield.jax.applied", applied)
    jax.vmap(jax.grad(lambda x: (blur(x) ** 2).sum()))(random(5, *SHAPE))
    assert shapes == [(5, *SHAPE)] * 2


def test_derivatives_to_second_order():
    from jax.test_util import check_grads

    shape = (8, 10)
    plan = widening_model(shape, across=2, size=5).plan(shape, 0.0, "f64")
    blur = SpatiallyVaryingBlur(plan)
    with x64(True):
        light = random(2, *shape, dtype=np.float64)
        for operator in (blur, blur.adjoint):
            # Differences of a linear operator are exact for any step.
            check_grads(operator, (light,), 2, atol=ROUNDING, rtol=ROUNDING, eps=1.0)
            check_grads(lambda x, of=operator: of(x) ** 2 / 2, (light,), 2)
        with pytest.raises(AssertionError):
            check_grads(lambda x: blur(x) + blur(jax.lax.stop_gradient(x)), (light,), 1)


def with_psf(precision="f64", tolerance=0.0, words=None, **of_psf):
    """An operator, light for it, and parameters of its PSF that are not those of the model."""
    choices = {"across": 3, "size": 9, "rank": 2, "interpolation": "kriging", **of_psf}
    model = widening_model((24, 24), **choices)
    plan = model.plan((24, 24), tolerance, precision, **(words or {}))
    rng = np.random.default_rng(7)
    given = {}
    for name in ("mean", "components", "coefficients"):
        values = getattr(model, name)
        given[name] = values + 0.1 * np.abs(values).mean() * rng.random(values.shape)
    return SpatiallyVaryingBlur(plan), rng.random((24, 24)).astype(plan.dtype), given


def weighted(blur, weight):
    """Return a function of light and parameters: the sum of the image times a weight."""
    return lambda light, given: (weight * blur(light, **given)).sum()


def weight_of(*shape):
    return np.random.default_rng(11).random(shape) - 0.5


@pytest.mark.parametrize(
    ("of_psf", "words"),
    [
        ({}, {}),
        ({"normalise": "keep"}, {"anchor": "output"}),
        ({"interpolation": "delaunay"}, {"anchor": "output", "oversample": 2}),
        ({"interpolation": "bicubic", "across": 4}, {"region": (5, 3, 9, 12)}),
    ],
)
def test_derivatives_with_respect_to_the_psf(of_psf, words):
    blur, light, given = with_psf(words=words, **of_psf)
    weight = weight_of(*blur.plan.image_shape)
    own = blur.plan.with_psf(blur.plan.model.with_parameters())

    def value(light, **changed):
        """Return the number without JAX."""
        plan = own.with_psf(own.model.with_parameters(**{**given, **changed}))
        return (weight * plan.simulate(light)).sum()

    with x64(True):
        loss = weighted(blur, weight)
        at_once = jax.value_and_grad(loss, (0, 1))(light, given)
        compiled = jax.jit(jax.value_and_grad(loss, (0, 1)))(light, given)
        found, (of_light, of_psf) = at_once
        np.testing.assert_allclose(found, value(light), rtol=ROUNDING)
        np.testing.assert_allclose((of_light * light).sum(), found, rtol=ROUNDING)
        for one, other in zip(jax.tree.leaves(at_once), jax.tree.leaves(compiled), strict=True):
            assert one.dtype == np.float64
            np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=ROUNDING)
        for name, values in given.items():
            direction = weight_of(*values.shape)
            ends = [value(light, **{name: values + step * direction}) for step in (STEP, -STEP)]
            expected = (ends[0] - ends[1]) / (2 * STEP)
            product = (of_psf[name] * direction).sum()
            assert abs(product - expected) < CENTRAL_DIFFERENCES
            # A wrong derivative is further away.
            assert abs(1.001 * product - expected) > CENTRAL_DIFFERENCES


def test_transformations_of_parameters():
    blur, _, given = with_psf()
    with x64(True):
        lights, weight = random(3, 24, 24, dtype=np.float64), weight_of(24, 24)
        loss = weighted(blur, weight)
        gradient, of_psf = jax.grad(loss, (0, 1)), jax.grad(loss, 1)
        # Derivatives with respect to the PSF differ between examples.
        singles = [gradient(one, given) for one in lights]
        of_each = jax.tree.map(lambda *of: np.stack(of), *singles)
        total = jax.tree.map(lambda of: of.sum(0), of_each[1])
        assert not np.allclose(*of_each[1]["coefficients"][:2], rtol=0, atol=1e-3)
        stacked = jax.tree.map(lambda values: np.stack([values] * 3), given)

        def check(found, expected):
            for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
                np.testing.assert_allclose(one, other, rtol=0, atol=ROUNDING)

        for wrap in (lambda function: function, jax.jit):
            check(wrap(jax.vmap(gradient, (0, None)))(lights, given), of_each)
            check(wrap(jax.vmap(gradient))(lights, stacked), of_each)
            check(wrap(jax.vmap(gradient, (1, None)))(np.moveaxis(lights, 0, 1), given), of_each)
            check(
                wrap(jax.vmap(of_psf, (None, 0)))(lights[1], stacked)["mean"][0],
                singles[1][1]["mean"],
            )
            check(wrap(of_psf)(lights, given), total)
            check(wrap(jax.vmap(jax.grad(loss), (0, None)))(lights, given), of_each[0])
            over = jax.grad(lambda of: jax.vmap(lambda one: loss(one, of))(lights).sum())
            check(wrap(over)(given), total)
            check(wrap(jax.grad(jax.checkpoint(loss), 1))(lights, given), total)
            check(wrap(jax.grad(lambda of: jax.jit(loss)(lights, of)))(given), total)
            one_by_one = jax.lax.map(lambda one: of_psf(one, given), jax.numpy.asarray(lights))
            check(one_by_one, of_each[1])
            images = wrap(jax.vmap(lambda one: blur(one, **given)))(lights)
            assert np.array_equal(images, blur(lights, **given))
            assert wrap(lambda of: blur(lights[:0], **of))(given).shape == (0, 24, 24)
            assert not wrap(of_psf)(lights[:0], given)["coefficients"].any()


def test_calls_for_parameters(monkeypatch):
    blur, _, given = with_psf("f32", 1e-4)
    calls = []

    def applied(plan, pixels, transposed):
        calls.append((pixels.shape, transposed))
        return psfield._operator.applied(plan, pixels, transposed)

    def gradients(plan, light, image, wanted):
        calls.append((light.shape, sorted(wanted)))
        return psfield._operator.gradients(plan, light, image, wanted)

    monkeypatch.setattr("psfield.jax.applied", applied)
    monkeypatch.setattr("psfield.jax.gradients", gradients)
    lights, stack = random(5, 24, 24), (5, 24, 24)

    def loss(lights, given):
        return (blur(lights, **given) ** 2).sum()

    for differentiate, expected in [
        (jax.vmap(jax.grad(loss), (0, None)), [(stack, False), (stack, True)]),
        (jax.grad(loss), [(stack, False), (stack, True)]),
        (
            lambda lights, given: jax.grad(lambda of: loss(lights, {**given, "mean": of}))(
                given["mean"]
            ),
            [(stack, False), (stack, ["mean"])],
        ),
        (
            jax.vmap(jax.grad(loss, 1), (0, None)),
            [(stack, False)] + 5 * [((24, 24), sorted(given))],
        ),
    ]:
        calls.clear()
        jax.block_until_ready(differentiate(lights, given))
        assert calls == expected


def test_types_of_parameters():
    blur, light, given = with_psf("f32", 1e-5)
    double = with_psf()[0]
    weight = weight_of(24, 24).astype(np.float32)
    with x64(True):
        expected = jax.grad(weighted(double, weight), (0, 1))(light.astype(float), given)
        for dtype in (np.float32, np.float64):
            of_type = {name: values.astype(dtype) for name, values in given.items()}
            for wrap in (lambda function: function, jax.jit):
                found = wrap(jax.grad(weighted(blur, weight), (0, 1)))(light, of_type)
                assert found[0].dtype == np.float32
                assert all(of.dtype == dtype for of in found[1].values())
                for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected)):
                    scale = np.abs(other).max()
                    np.testing.assert_allclose(one / scale, other / scale, rtol=0, atol=OF_PLAN_F32)
    # Without double precision, JAX rounds the parameters.
    found = jax.grad(weighted(blur, weight), 1)(light, given)
    assert all(of.dtype == np.float32 for of in found.values())
    whole = np.ones(given["coefficients"].shape, int)
    image = blur(light, coefficients=whole)
    assert np.array_equal(image, blur(light, coefficients=whole.astype(np.float32)))


@pytest.mark.parametrize("name", ["mean", "components", "coefficients"])
def test_parameters_may_be_given_in_part(name):
    blur, light, given = with_psf()
    model = blur.plan.model
    names = "mean", "components", "coefficients"
    whole = {**{other: getattr(model, other) for other in names}, name: given[name]}
    with x64(True):
        loss = weighted(blur, weight_of(24, 24))
        part = jax.grad(loss, 1)(light, {name: given[name]})
        np.testing.assert_allclose(
            part[name], jax.grad(loss, 1)(light, whole)[name], rtol=0, atol=ROUNDING
        )


def test_derivatives_with_parameters_are_taken_once():
    blur, light, given = with_psf("f32", 1e-4)

    def of(mean):
        return (blur(light, mean=mean) ** 2).sum()

    mean = jax.numpy.asarray(given["mean"])
    with pytest.raises(NotImplementedError, match="Differentiation rule"):
        jax.grad(lambda mean: jax.grad(of)(mean).sum())(mean)
    with pytest.raises(TypeError, match=r"forward-mode .* custom_vjp"):
        jax.jvp(of, (mean,), (mean,))


def test_models_without_parameters_are_refused(tmp_path):
    light, coefficients = random(24, 24), np.ones((9, 2))

    def blurred(model, **words):
        blur = SpatiallyVaryingBlur(model.plan((24, 24), 1e-3, **words))
        for wrap in (lambda function: function, jax.jit):
            wrap(lambda of: blur(light, coefficients=of))(coefficients)

    widening_model((24, 24), across=3, size=41).write(tmp_path / "core.fits")
    with pytest.raises(ValueError, match="PSF with wings"):
        blurred(psfield.PsfModel.read(tmp_path / "core.fits", wings="power=3,40"))
    stamps = [gaussian_stamp(sigma, 9) for sigma in (1.0, 1.5)]
    of_colours = psfield.PsfModel.from_samples(stamps, [(0, 0)] * 2, wavelengths_um=[0.5, 0.8])
    with pytest.raises(ValueError, match=r"plan in colour .*PsfModel\.for_spectrum"):
        blurred(of_colours, bandpass=([0.5, 0.8], [1.0, 1.0]), sed="powerlaw:0")

    def mean(positions, values):
        return lambda at: np.tile(values.mean(0), (len(at), 1))

    with pytest.raises(ValueError, match=r"interpolation of your own \(mean\)"):
        blurred(with_psf(interpolation=mean)[0].plan.model)


def test_errors_of_parameters():
    blur, light, given = with_psf("f32", 1e-4)
    coefficients = given["coefficients"]
    for bad, text in [
        ({"coefficients": coefficients[:, :1]}, "coefficients, one for each component"),
        ({"coefficients": coefficients[0]}, r"coefficients must be an array \[position"),
        ({"mean": np.ones((3, 3))}, "stamps of 3 x 3 pixels .* have 9 x 9"),
        ({"components": np.ones(9)}, r"components must be an array \[component, y, x\]"),
        ({"coefficients": np.nan * coefficients}, "is NaN"),
    ]:
        with pytest.raises(ValueError, match=text):
            blur(light, **bad)
        with pytest.raises(jax.errors.JaxRuntimeError, match=text):
            jax.block_until_ready(jax.jit(lambda of: blur(light, **of))(bad))
    with pytest.raises(TypeError, match="coefficients must be real numbers, got complex64"):
        jax.jit(lambda of: blur(light, coefficients=of))(1j * coefficients)
    with jax.enable_x64(True), pytest.raises(TypeError, match="under jit, the context"):
        jax.jit(lambda of: blur(light, **of))(given)


ON_ONE_CORE = """
    import os, sys
    os.sched_setaffinity(0, {next(iter(os.sched_getaffinity(0)))})
    sys.path.insert(0, TESTS)
    import jax, numpy as np
    from conftest import widening_model
    from psfield.jax import SpatiallyVaryingBlur
    blur = SpatiallyVaryingBlur(widening_model((256, 256)).plan((256, 256), 1e-3))
    @jax.jit
    def work(x):
        return (blur(x) + blur(jax.numpy.sin(x)) + blur.adjoint(x)).sum()
    @jax.jit
    def differentiate(x, of):
        return jax.grad(lambda of: blur(x, coefficients=of).sum())(of).sum()
    lights = [np.full((4, 256, 256), n, np.float32) for n in range(8)]
    results = [work(x) for x in lights]
    results += [differentiate(x, blur.plan.model.coefficients) for x in lights[:2]]
    print(len([float(result) for result in results]))
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
def test_one_core_is_enough():
    # A callback that needs a thread of JAX would wait for itself.
    program = textwrap.dedent(ON_ONE_CORE).replace("TESTS", repr(str(ROOT / "python" / "tests")))
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120
    )
    assert ran.stdout == "10\n", ran.stderr


def test_copies(blur):
    light = random(*SHAPE)
    assert np.array_equal(pickle.loads(pickle.dumps(blur))(light), blur(light))
    given = {"coefficients": 1.5 * blur.plan.model.coefficients}
    expected = blur(light, **given)
    assert np.array_equal(pickle.loads(pickle.dumps(blur))(light, **given), expected)
    assert repr(blur) == f"SpatiallyVaryingBlur({blur.plan!r})"


def test_errors(blur):
    with pytest.raises(TypeError, match="jax_enable_x64"):
        blur_of("f64")(random(*SHAPE))
    double = random(*SHAPE, dtype=np.float64)
    with jax.enable_x64(True):
        assert blur_of("f64")(double).dtype == np.float64
        with pytest.raises(TypeError, match="under jit, the context"):
            jax.jit(blur_of("f64"))(double)
        with pytest.raises(TypeError, match=r"float64.*precision='f64'"):
            blur(double)
    with pytest.raises(TypeError, match=r"image has the type int32.*convert it"):
        jax.jit(blur.adjoint)(np.ones(SHAPE, np.int32))
    with pytest.raises(ValueError, match=r"shape \[\.\.\., 96, 128\], got \[2, 96, 127\]"):
        jax.vmap(blur)(random(3, 2, 96, 127))
    dark = np.full(SHAPE, np.nan, np.float32)
    with pytest.raises(ValueError, match="must be a finite number"):
        blur(dark)
    with pytest.raises(jax.errors.JaxRuntimeError, match="must be a finite number"):
        jax.jit(blur)(dark).block_until_ready()
    with pytest.raises(TypeError, match=r"plan must be a psfield\.Plan, got PsfModel"):
        SpatiallyVaryingBlur(blur.plan.model)


def test_the_package_to_install_is_named():
    program = "import sys; sys.modules['jax'] = None; import psfield.jax"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.stderr.endswith("ImportError: psfield.jax needs JAX: pip install jax\n")

"""`psfield.torch`: results of the plan, derivatives to any order, workers, errors."""

from __future__ import annotations

import copy
import io
import os
import pickle
import subprocess
import sys
import types
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import widening_model

import psfield

torch = pytest.importorskip("torch")

from torch.autograd.gradcheck import GradcheckError  # noqa: E402

from psfield.torch import SpatiallyVaryingBlur  # noqa: E402

SHAPE = (96, 128)
#: Plans whose scenes, images or sides differ in shape or in meaning.
PLANS = [
    {},
    {"anchor": "output"},
    {"frame": (10, 5, 100, 80)},
    {"oversample": 2},
    {"region": (30, 20, 50, 41)},
    {"frame": (10, 5, 100, 80), "region": (0, 0, 17, 80), "anchor": "output"},
]
#: Rounding of differences of numbers of about 1 in double precision.
ROUNDING = 1e-12
#: Rounding of sums of 10^4 numbers in single precision, added in two orders.
ROUNDING_F32 = 1e-5
#: Step of central differences, for parameters of about 0.01 to 1.
STEP = 1e-5
#: Error of central differences with this step: rounding of the image, over the step.
CENTRAL_DIFFERENCES = 1e-8
#: Comparison with differences. The fast mode multiplies the Jacobian matrix by random vectors.
DIFFERENCES = {
    "eps": STEP,
    "atol": CENTRAL_DIFFERENCES,
    "rtol": CENTRAL_DIFFERENCES,
    "fast_mode": True,
    "check_undefined_grad": False,
}
#: Error of derivatives in single precision: rounding, and the tolerance 1e-5 of the plan and of the
#: weights of the samples, for light of up to 1.
OF_PLAN_F32 = 1e-4


def blur_of(precision="f32", tolerance=1e-3, shape=SHAPE, **words):
    return SpatiallyVaryingBlur(widening_model(shape).plan(shape, tolerance, precision, **words))


def small(**words):
    """A small operator without an error of its own."""
    shape = (6, 7)
    model = widening_model(shape, across=2, size=5)
    return SpatiallyVaryingBlur(model.plan(shape, 0.0, "f64", **words))


def random(*shape, dtype=torch.float32, **words):
    generator = torch.Generator().manual_seed(7)
    return torch.rand(*shape, generator=generator, dtype=dtype, **words)


@pytest.fixture(scope="module")
def blur():
    return blur_of()


@pytest.mark.parametrize("words", PLANS)
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_results_are_those_of_the_plan(precision, words):
    blur = blur_of(precision, **words)
    plan, dtype = blur.plan, getattr(torch, {"f32": "float32", "f64": "float64"}[precision])
    _, _, columns, rows = plan.light_region
    shape = (rows, columns) if plan.region else plan.shape
    for outer in [(), (1,), (2, 3), (1, 1)]:
        light = random(*outer, *shape, dtype=dtype, requires_grad=True)
        image = blur(light)
        assert np.array_equal(image.detach(), plan.simulate(light.detach().numpy()))
        gradient = random(*image.shape, dtype=dtype)
        image.backward(gradient)
        expected = plan.adjoint(gradient.numpy())
        assert np.array_equal(light.grad, expected)
        assert np.array_equal(blur.adjoint(gradient), expected)
    assert blur(random(0, 2, *shape, dtype=dtype)).shape == (0, 2, *plan.image_shape)
    assert blur.adjoint(random(0, *plan.image_shape, dtype=dtype)).shape == (0, *shape)


@pytest.mark.parametrize("words", [words for words in PLANS if "region" in words])
def test_whole_scenes_of_a_region(words):
    blur = blur_of(**words)
    x0, y0, columns, rows = blur.plan.light_region
    light = random(2, *SHAPE, requires_grad=True)
    image = blur(light)
    assert np.array_equal(image.detach(), blur.plan.simulate(light.detach().numpy()))
    image.sum().backward()
    expected = torch.zeros_like(light)
    expected[:, y0 : y0 + rows, x0 : x0 + columns] = blur.adjoint(torch.ones_like(image))
    assert torch.equal(light.grad, expected)


def test_tensors_of_any_layout(blur):
    light = random(3, 2, *SHAPE)
    expected = blur(light)
    assert torch.equal(blur(light.transpose(0, 1)), expected.transpose(0, 1))
    assert torch.equal(blur(light.mT.contiguous().mT), expected)
    assert torch.equal(blur(light.to(memory_format=torch.channels_last)), expected)
    assert torch.equal(blur(light[:1].expand(5, 2, *SHAPE)), expected[:1].expand(5, 2, *SHAPE))
    assert torch.equal(blur(torch.nn.Parameter(light)), expected)
    # The gradient of a sum is one number, expanded.
    light.requires_grad_()
    blur(light).sum().backward()
    assert torch.equal(light.grad, blur.adjoint(torch.ones(3, 2, *SHAPE)))
    negative = torch.complex(light.detach(), light.detach()).conj().imag
    assert negative.is_neg() and torch.equal(blur(negative), blur(-light).detach())


def test_nothing_is_copied(blur, monkeypatch):
    seen = []

    def applied(plan, pixels, transposed):
        seen.extend((pixels, psfield._operator.applied(plan, pixels, transposed)))
        return seen[1]

    monkeypatch.setattr("psfield.torch.applied", applied)
    light = random(2, *SHAPE)
    image = blur(light)
    assert [array.ctypes.data for array in seen] == [light.data_ptr(), image.data_ptr()]


# PyTorch calls functions that it deprecates itself.
@pytest.mark.filterwarnings("ignore:.*torch.jit")
@pytest.mark.parametrize("words", [{}, {"anchor": "output", "frame": (1, 2, 6, 3)}])
def test_derivatives_to_second_order(words):
    blur = small(**words)
    light = random(6, 7, dtype=torch.float64, requires_grad=True)
    image = random(*blur.plan.image_shape, dtype=torch.float64, requires_grad=True)
    # Differences of a linear operator are exact for any step.
    limits = {"eps": 1.0, "atol": ROUNDING, "rtol": 0.0}
    for operator, pixels in ((blur, light), (blur.adjoint, image)):
        assert torch.autograd.gradcheck(operator, pixels, check_forward_ad=True, **limits)
        assert torch.autograd.gradgradcheck(operator, pixels, check_fwd_over_rev=True, **limits)
        # The second derivative of a square is not zero.
        assert torch.autograd.gradgradcheck(lambda x, of=operator: of(x) ** 2 / 2, pixels)
    with pytest.raises(GradcheckError):
        torch.autograd.gradcheck(lambda x: blur(x) + blur(x.detach()), light)


@pytest.mark.filterwarnings("ignore:.*torch.jit")
def test_function_transforms(blur):
    func, light = torch.func, random(4, 3, *SHAPE)
    image = blur(light)
    for axis in (0, 1, -1):
        moved = light.movedim(0, axis)
        assert torch.equal(func.vmap(blur, in_dims=axis)(moved), image)
        assert torch.equal(func.vmap(func.vmap(blur), in_dims=axis)(moved), image)
    gradient = blur.adjoint(2 * image)
    assert torch.equal(func.vmap(func.grad(lambda x: (blur(x) ** 2).sum()))(light), gradient)
    assert torch.equal(func.vmap(func.vjp(blur, light[0])[1])(2 * image)[0], gradient)
    assert torch.equal(func.jvp(blur, (light,), (3 * light,))[1], blur(3 * light))
    curvature = func.hessian(lambda s: (blur(s * light[0, 0]) ** 2).sum())(torch.tensor(2.0))
    assert torch.isclose(curvature, 2 * (image[0, 0] ** 2).sum(), rtol=ROUNDING_F32)


def test_unused_gradients_are_not_computed(blur, monkeypatch):
    calls = []

    def applied(plan, pixels, transposed):
        calls.append(transposed)
        return psfield._operator.applied(plan, pixels, transposed)

    monkeypatch.setattr("psfield.torch.applied", applied)
    weight = torch.ones((), requires_grad=True)
    (weight * blur(random(*SHAPE)).sum()).backward()
    assert calls == [False] and weight.grad is not None


# The compiler emits warnings about its own code.
@pytest.mark.filterwarnings("ignore")
def test_compiled_code_calls_it(blur):
    light = random(2, *SHAPE, requires_grad=True)
    compiled = torch.compile(lambda x: (blur(2 * x) + 1).sum(), backend="eager")
    compiled(light).backward()
    assert torch.allclose(light.grad, 2 * blur.adjoint(torch.ones_like(light)), rtol=ROUNDING_F32)


def test_many_threads_at_once(blur):
    light = random(8, *SHAPE)

    def step(x):
        x = x.clone().requires_grad_()
        image = blur(x)
        (image**2).sum().backward()
        return image.detach(), x.grad

    with ThreadPoolExecutor(4) as pool:
        images, gradients = (torch.stack(list(found)) for found in zip(*pool.map(step, light)))
    assert torch.equal(images, blur(light))
    assert torch.equal(gradients, blur.adjoint(2 * images))


class Blurred(torch.utils.data.Dataset):
    """Images of scenes, and the gradient of their squares."""

    def __init__(self, blur, light):
        self.blur, self.light = blur, light

    def __len__(self):
        return len(self.light)

    def __getitem__(self, index):
        light = self.light[index].clone().requires_grad_()
        image = self.blur(light)
        (image**2).sum().backward()
        return image.detach(), light.grad


@pytest.mark.parametrize("start", ["fork", "spawn"])
# Python 3.12 warns of forks of a process with threads, PyTorch of more workers than cores.
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore:This DataLoader will create")
def test_workers_of_data_loaders(blur, start):
    if start == "fork" and not hasattr(os, "fork"):
        pytest.skip("there is no fork here")
    light = random(6, *SHAPE)
    expected = blur(light)
    loader = torch.utils.data.DataLoader(
        Blurred(blur, light),
        batch_size=3,
        num_workers=2,
        multiprocessing_context=start,
        timeout=100,
    )
    images, gradients = (torch.cat(found) for found in zip(*loader))
    assert torch.equal(images, expected)
    assert torch.equal(gradients, blur.adjoint(2 * expected))


def test_copies_and_files(blur):
    light = random(*SHAPE)
    model = torch.nn.Sequential(torch.nn.Identity(), blur)
    assert not model.state_dict() and not list(model.parameters())
    model.load_state_dict(model.state_dict())
    copied = copy.deepcopy(model)
    assert copied[1] is not blur and copied[1].plan is blur.plan
    file = io.BytesIO()
    torch.save(model, file)
    file.seek(0)
    for other in (
        copied,
        copy.copy(blur),
        pickle.loads(pickle.dumps(blur)),
        torch.load(file, weights_only=False),
    ):
        assert torch.equal(other(light), blur(light))
    assert repr(blur) == f"SpatiallyVaryingBlur({blur.plan!r}, engine='auto')"


class Doubling(torch.nn.Module):
    """A stand-in for the operations of PyTorch."""

    def __init__(self, plan):
        super().__init__()
        self.register_buffer("factor", torch.tensor(2.0))

    def forward(self, light):
        return self.factor * light


def test_operations_of_torch(blur, monkeypatch):
    module = types.SimpleNamespace(TilesInTorch=Doubling)
    monkeypatch.setitem(sys.modules, "psfield._torch_tiles", module)
    by_torch = SpatiallyVaryingBlur(blur.plan, engine="torch")
    light = random(2, *SHAPE, requires_grad=True)
    assert torch.equal(by_torch(light), 2 * light)
    adjoint = by_torch.adjoint(light)
    assert torch.equal(adjoint, 2 * light)
    (adjoint**2).sum().backward()
    assert torch.equal(light.grad, 8 * light)
    # `auto` chooses by the device.
    assert blur(torch.ones(2, *SHAPE, device="meta")).device.type == "meta"
    assert by_torch.to(torch.float64)(light).dtype == torch.float32
    assert not by_torch.state_dict() and "Doubling" not in str(pickle.dumps(by_torch))
    assert by_torch(random(0, *SHAPE)).shape == (0, *SHAPE)


def test_errors(blur):
    with pytest.raises(TypeError, match=r"float64.*make the plan with precision='f64'"):
        blur(random(*SHAPE, dtype=torch.float64))
    with pytest.raises(TypeError, match=r"image has the type float16.*convert it$"):
        blur.adjoint(random(*SHAPE).half())
    with pytest.raises(TypeError, match=r"light must be a torch\.Tensor, got ndarray"):
        blur(np.ones(SHAPE, np.float32))
    with pytest.raises(ValueError, match=r"shape \[\.\.\., 96, 128\], got \[2, 96, 127\]"):
        blur(random(2, 96, 127))
    with pytest.raises(ValueError, match=r"shape \[.*\] or \[\.\.\., 96, 128\], got \[5\]"):
        blur_of(region=(30, 20, 50, 41))(random(5))
    with pytest.raises(ValueError, match="must be a finite number"):
        blur(torch.full(SHAPE, torch.nan))
    with pytest.raises(ValueError, match="on the device meta, but the native engine"):
        SpatiallyVaryingBlur(blur.plan, engine="native")(torch.ones(SHAPE, device="meta"))
    with pytest.raises(ValueError, match="engine must be auto, native or torch, got gpu"):
        SpatiallyVaryingBlur(blur.plan, engine="gpu")
    with pytest.raises(TypeError, match=r"plan must be a psfield\.Plan, got PsfModel"):
        SpatiallyVaryingBlur(blur.plan.model)


def psf_model(across=3, normalise="unit", interpolation="kriging", **words):
    """A PSF over 24 x 24 pixels with a mean and two components."""
    choices = {"rank": 2, "normalise": normalise, "interpolation": interpolation}
    return widening_model((24, 24), across=across, size=9, **choices, **words)


def with_psf(precision="f64", tolerance=0.0, words=None, **of_psf):
    """An operator, light for it, and parameters of its PSF that are not those of the model."""
    model = psf_model(**of_psf)
    plan = model.plan((24, 24), tolerance, precision, **(words or {}))
    dtype = getattr(torch, plan.dtype.name)
    light = random(24, 24, dtype=dtype, requires_grad=True)
    given = {}
    for name in ("mean", "components", "coefficients"):
        values = torch.tensor(getattr(model, name))
        changed = values + 0.1 * values.abs().mean() * random(*values.shape, dtype=values.dtype)
        given[name] = changed.requires_grad_()
    return SpatiallyVaryingBlur(plan), light, given


def difference(blur, light, weight, given, directions):
    """Return the derivative of ``sum(weight * image)`` along directions, by NumPy."""

    def value(step):
        arrays = {
            name: (values + step * directions[name]).numpy(force=True)
            for name, values in given.items()
        }
        own = blur.plan.with_psf(blur.plan.model.with_parameters())
        plan = own.with_psf(own.model.with_parameters(**arrays))
        return (weight * plan.simulate(light)).sum()

    return (value(STEP) - value(-STEP)) / (2 * STEP)


# PyTorch calls functions that it deprecates itself.
@pytest.mark.filterwarnings("ignore:.*torch.jit")
@pytest.mark.parametrize(
    ("of_psf", "words"),
    [
        ({}, {}),
        ({"normalise": "keep"}, {}),
        ({}, {"anchor": "output"}),
        ({"normalise": "keep"}, {"anchor": "output"}),
        ({}, {"oversample": 2}),
        ({}, {"region": (5, 3, 9, 12)}),
        ({"interpolation": "bicubic", "across": 4}, {"frame": (2, 1, 20, 22)}),
        ({"interpolation": "delaunay"}, {"anchor": "output", "oversample": 2}),
        ({"interpolation": "natural-neighbour"}, {"region": (5, 3, 9, 12), "anchor": "output"}),
        ({"interpolation": "polynomial=2", "oversampling": 1.5}, {}),
    ],
)
def test_derivatives_with_respect_to_the_psf(of_psf, words):
    blur, light, given = with_psf(words=words, **of_psf)

    def image(light, mean, components, coefficients):
        return blur(light, mean=mean, components=components, coefficients=coefficients)

    assert torch.autograd.gradcheck(image, (light, *given.values()), **DIFFERENCES)


@pytest.mark.filterwarnings("ignore:.*torch.jit")
def test_every_element_of_small_parameters():
    stamps = [[[1, 2, 1]], [[2, 3, 2]]]
    model = psfield.PsfModel.from_samples(stamps, [(0, 0), (5, 0)], noise=0)
    blur = SpatiallyVaryingBlur(model.plan((2, 6), 0.0, "f64"))
    light = random(2, 2, 6, dtype=torch.float64, requires_grad=True)
    names = "mean", "components", "coefficients"
    given = {name: torch.tensor(getattr(model, name), requires_grad=True) for name in names}

    def image(light, *values):
        return blur(light, **dict(zip(names, values)))

    each = {**DIFFERENCES, "fast_mode": False}
    assert torch.autograd.gradcheck(image, (light, *given.values()), **each)
    for name in names:
        # Half of the derivative is missing.
        def partly(values, name=name):
            whole, cut = ({**given, name: of} for of in (values, values.detach()))
            return blur(light, **whole) + blur(light, **cut)

        with pytest.raises(GradcheckError):
            torch.autograd.gradcheck(partly, given[name], **each)


def test_parameters_of_the_model_give_its_image():
    blur, light, _ = with_psf()
    model = blur.plan.model
    found = blur(light, coefficients=torch.tensor(model.coefficients)).detach()
    assert torch.allclose(found, blur(light), rtol=0, atol=ROUNDING)


def test_a_batch_adds_its_gradients():
    blur, _, given = with_psf()
    light = random(2, 24, 24, dtype=torch.float64)
    weight = random(2, 24, 24, dtype=torch.float64) - 0.5
    (weight * blur(light, **given)).sum().backward()
    of_singles = []
    for one, of_one in zip(light, weight):
        loss = (of_one * blur(one, **given)).sum()
        of_singles.append(torch.autograd.grad(loss, list(given.values())))
    for parameter, *singles in zip(given.values(), *of_singles):
        assert torch.allclose(parameter.grad, sum(singles), rtol=0, atol=ROUNDING)
        assert not torch.allclose(*singles, rtol=0, atol=1e-3)
    # Further axes, and a gradient that is one number, expanded.
    for outer in ((2, 1), (0,)):
        stack = light.reshape(2, 1, 24, 24) if outer == (2, 1) else light[:0]
        image = blur(stack, **given)
        assert image.shape == (*outer, 24, 24)
        (found,) = torch.autograd.grad(image.sum(), given["coefficients"])
        (expected,) = torch.autograd.grad(blur(stack, **given).sum(), given["coefficients"])
        assert torch.equal(found, expected) and found.any() == bool(stack.numel())


def test_only_wanted_derivatives_are_computed(monkeypatch):
    blur, light, given = with_psf()
    calls = []

    def gradients(plan, light, image, wanted):
        calls.append(set(wanted))
        return psfield._operator.gradients(plan, light, image, wanted)

    monkeypatch.setattr("psfield.torch.gradients", gradients)
    for wanted in ({"coefficients"}, {"light"}, {"mean"}, {"components", "light"}):
        tensors = {"light": light, **given}
        tensors = {name: tensor.detach().clone() for name, tensor in tensors.items()}
        for name in wanted:
            tensors[name].requires_grad_()
        blur(**tensors).sum().backward()
        assert calls.pop() == wanted
        for name, tensor in tensors.items():
            assert (tensor.grad is not None) == (name in wanted)
            if name in wanted:
                full = torch.autograd.grad(
                    blur(light, **given).sum(), {**given, "light": light}[name]
                )
                assert torch.allclose(tensor.grad, full[0], rtol=0, atol=ROUNDING)
                calls.clear()
    assert not blur(light.detach(), coefficients=given["coefficients"].detach()).requires_grad


@pytest.mark.parametrize("name", ["mean", "components", "coefficients"])
def test_parameters_may_be_given_in_part(name):
    blur, light, given = with_psf()
    weight = random(24, 24, dtype=torch.float64) - 0.5
    directions = {name: random(*given[name].shape, dtype=torch.float64) - 0.5}
    given = {name: given[name]}
    (weight * blur(light, **given)).sum().backward()
    arrays = light.numpy(force=True), weight.numpy()
    expected = difference(blur, *arrays, given, directions)
    found = (given[name].grad * directions[name]).sum()
    assert found.item() == pytest.approx(expected, rel=1e-6)  # The error of the difference.
    assert abs(expected) > 1e-3


def test_single_precision():
    blur, light, given = with_psf("f32", 1e-5)
    double, _, _ = with_psf()
    of_double = light.detach().double().requires_grad_()
    weight = random(24, 24, dtype=torch.float64) - 0.5
    (weight * double(of_double, **given)).sum().backward()
    expected = {name: parameter.grad.clone() for name, parameter in given.items()}
    for dtype in (torch.float32, torch.float64):
        of_type = {name: p.detach().to(dtype).requires_grad_() for name, p in given.items()}
        light.grad = None
        (weight.float() * blur(light, **of_type)).sum().backward()
        assert light.grad.dtype == torch.float32
        assert torch.allclose(light.grad.double(), of_double.grad, rtol=0, atol=OF_PLAN_F32)
        for name, parameter in of_type.items():
            assert parameter.grad.dtype == dtype
            scale = expected[name].abs().max()
            assert torch.allclose(
                parameter.grad.double() / scale, expected[name] / scale, rtol=0, atol=OF_PLAN_F32
            )


@pytest.mark.filterwarnings("ignore:.*torch.jit")
def test_function_transforms_of_parameters():
    blur, light, given = with_psf()
    light, weight = random(3, 24, 24, dtype=torch.float64), 2.0

    def loss(light, given):
        return weight * (blur(light, **given) ** 2).sum()

    fixed = {name: parameter.detach() for name, parameter in given.items()}
    func, total = torch.func, loss(light, given)
    total.backward()
    found = func.grad(loss, 1)(light, fixed)
    of_each = func.vmap(func.grad(loss, 1), (0, None))(light, fixed)
    stacked = {name: values.expand(2, *values.shape) for name, values in fixed.items()}
    of_stacked = func.vmap(func.grad(loss, 1), (None, 0))(light, stacked)
    of_light = func.vmap(func.grad(loss), (0, None))(light, fixed)
    for name, parameter in given.items():
        assert torch.equal(found[name], parameter.grad)
        assert torch.equal(of_stacked[name], parameter.grad.expand(2, *parameter.shape))
        for n, one in enumerate(of_each[name]):
            assert torch.equal(one, func.grad(loss, 1)(light[n], fixed)[name])
    assert torch.equal(of_light, func.grad(loss)(light, fixed))
    images = func.vmap(lambda x: blur(x, **given))(light)
    assert torch.equal(images, blur(light, **given))


@pytest.mark.filterwarnings("ignore:.*torch.jit")
def test_derivatives_with_parameters_are_taken_once():
    blur, light, given = with_psf()
    coefficients = given["coefficients"]
    loss = (blur(light, coefficients=coefficients) ** 2).sum()
    (gradient,) = torch.autograd.grad(loss, coefficients, create_graph=True)
    with pytest.raises(RuntimeError, match="only once"):
        gradient.sum().backward()

    def of(values):
        return (blur(light.detach(), coefficients=values) ** 2).sum()

    with pytest.raises(RuntimeError, match="only once"):
        torch.func.grad(lambda values: torch.func.grad(of)(values).sum())(coefficients.detach())
    with pytest.raises(NotImplementedError, match="jvp"):
        torch.func.jvp(of, (coefficients.detach(),), (coefficients.detach(),))


def test_parameters_that_change_before_the_gradient_are_refused():
    blur, light, given = with_psf()
    loss = blur(light, coefficients=given["coefficients"]).sum()
    with torch.no_grad():
        given["coefficients"].add_(1.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()
    # The kept plan is not that of the changed tensor.
    image = blur(light, coefficients=given["coefficients"])
    fresh = SpatiallyVaryingBlur(blur.plan)
    assert torch.equal(image, fresh(light, coefficients=given["coefficients"]))


def test_copies_take_parameters():
    blur, light, given = with_psf()
    expected = blur(light, **given)
    for other in (copy.deepcopy(blur), pickle.loads(pickle.dumps(blur))):
        assert torch.equal(other(light, **given), expected)


def test_an_optimiser_finds_the_coefficients():
    blur, light, _ = with_psf()
    light = light.detach()
    truth = torch.tensor(blur.plan.model.coefficients)
    image = blur(light, coefficients=truth)
    scale = truth.abs().max()
    # Numbers of about 1, for the steps of the optimiser.
    found = torch.zeros_like(truth, requires_grad=True)
    choices = {"line_search_fn": "strong_wolfe", "tolerance_grad": 0, "tolerance_change": 0}
    optimiser = torch.optim.LBFGS([found], max_iter=60, **choices)

    def loss():
        optimiser.zero_grad()
        residual = ((blur(light, coefficients=scale * found) - image) ** 2).sum()
        residual.backward()
        return residual

    start = optimiser.step(loss)
    assert loss() < 1e-12 * start
    # An error of 1e-6 of the image, amplified by the deconvolution.
    assert (found.detach() - truth / scale).abs().max() < 1e-3


def chromatic_model():
    y, x = np.mgrid[-4:5, -4:5]
    stamps = [np.exp(-(x**2 + y**2) / (2 * w)) for w in (1.0, 1.5)]
    return psfield.PsfModel.from_samples(stamps, [(0, 0)] * 2, wavelengths_um=[0.5, 0.8])


def test_models_without_parameters_are_refused(tmp_path):
    light, coefficients = torch.rand(24, 24), torch.ones(9, 2)

    def blurred(model, **words):
        blur = SpatiallyVaryingBlur(model.plan((24, 24), 1e-3, **words))
        return blur(light, coefficients=coefficients)

    widening_model((24, 24), across=3, size=41).write(tmp_path / "core.fits")
    with pytest.raises(ValueError, match="PSF with wings"):
        blurred(psfield.PsfModel.read(tmp_path / "core.fits", wings="power=3,40"))
    with pytest.raises(ValueError, match=r"plan in colour .*PsfModel\.for_spectrum"):
        blurred(chromatic_model(), bandpass=([0.5, 0.8], [1.0, 1.0]), sed="powerlaw:0")

    def mean(positions, values):
        return lambda at: np.tile(values.mean(0), (len(at), 1))

    with pytest.raises(ValueError, match=r"interpolation of your own \(mean\)"):
        blurred(psf_model(interpolation=mean))


def test_errors_of_parameters():
    blur, light, given = with_psf()
    with pytest.raises(ValueError, match=r"coefficients, one for each component.* got 1"):
        blur(light, coefficients=given["coefficients"][:, :1])
    with pytest.raises(ValueError, match=r"coefficients must be an array \[position, component\]"):
        blur(light, coefficients=given["coefficients"][0])
    with pytest.raises(ValueError, match=r"stamps of 3 x 3 pixels .* have 9 x 9"):
        blur(light, mean=torch.ones(3, 3))
    with pytest.raises(ValueError, match=r"components must be an array \[component, y, x\]"):
        blur(light, components=torch.ones(9))
    with pytest.raises(ValueError, match="is NaN"):
        blur(light, coefficients=given["coefficients"] * torch.nan)
    with pytest.raises(TypeError, match=r"mean must be a torch\.Tensor, got ndarray"):
        blur(light, mean=np.ones((9, 9)))
    with pytest.raises(TypeError, match="coefficients must be real numbers, got complex128"):
        blur(light, coefficients=given["coefficients"] * 1j)
    with pytest.raises(ValueError, match=r"mean is on the device meta.* mean\.cpu\(\)"):
        blur(light, mean=torch.ones(9, 9, device="meta"))
    with pytest.raises(ValueError, match="light is on the device meta, but parameters of the PSF"):
        blur(light.to("meta"), mean=torch.ones(9, 9))
    uncentred = psf_model(centring="none").plan((24, 24), 0.0, "f64")
    with pytest.raises(ValueError, match="has no mean stamp"):
        SpatiallyVaryingBlur(uncentred)(light, mean=torch.ones(9, 9))


def test_it_is_imported_only_on_request():
    program = (
        "import sys, psfield; assert not {'torch', 'jax'} & set(sys.modules);"
        " sys.modules['torch'] = None; import psfield.torch"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.stderr.endswith("ImportError: psfield.torch needs PyTorch: pip install torch\n")

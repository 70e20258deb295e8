"""Plans that PyTorch executes give the images of the native engine."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from conftest import gaussian_stamp, widening_model

import psfield

torch = pytest.importorskip("torch")

from psfield._torch_tiles import TilesInTorch, _transform_size  # noqa: E402

#: Largest difference from the engine, relative to the brightest pixel. In f32, both round their
#: transforms by up to about half of it. In f64, transforms of these sizes round by 1e-15.
ROUNDING = {"float32": 1e-6, "float64": 1e-12}
#: A perturbed weight changes by this fraction, far more than rounding.
PERTURBED = 1e-3

SHAPE = (96, 128)
CORNERS = ((0, 0), (127, 0), (0, 95), (127, 95))
TORCH_TYPES = {"f32": torch.float32, "f64": torch.float64}


def of_basis(normalise, with_mean):
    """Return a model whose components have flux, so that the flux of its PSFs varies."""
    stamps = [gaussian_stamp(sigma, size=18)[1:] for sigma in (1.0, 1.5, 2.5)]
    components = np.linalg.qr(np.reshape(stamps, (3, -1)).T)[0].T.reshape(3, 17, 18)
    components *= np.sign(components.sum(axis=(1, 2), keepdims=True))
    coefficients = np.array([[1, 0.1, 0.2], [1.1, 0.2, -0.1], [0.9, 0.0, 0.3], [1.0, 0.3, 0.1]])
    return psfield.PsfModel.from_basis(
        gaussian_stamp(1.7, size=18)[1:] if with_mean else None,
        components,
        (0.3 if with_mean else 1.0) * coefficients,
        CORNERS,
        field_shape=SHAPE,
        centre=(9.0, 8.0),
        interpolation="bilinear",
        normalise=normalise,
    )


def shifted():
    """Return a model of stamps that are not square and have their centre off the middle."""
    stamps = [gaussian_stamp(1.2 + 0.3 * i, 19, shift=(3, -2))[:, 4:] for i in range(4)]
    return psfield.PsfModel.from_samples(
        stamps, CORNERS, field_shape=SHAPE, centre=(8.0, 7.0), interpolation="bilinear"
    )


MODELS = {
    "widening": widening_model,
    "off centre": shifted,
    "unit flux": lambda: of_basis("unit", True),
    "kept flux": lambda: of_basis("keep", True),
    "unit flux without mean": lambda: of_basis("unit", False),
    "kept flux without mean": lambda: of_basis("keep", False),
}
SETTINGS = [
    {"tolerance": 1e-2},
    {"frame": (10, 5, 100, 80)},
    {"oversample": 2},
    {"oversample": 3, "frame": (1, 2, 37, 25)},
    {"region": (30, 20, 50, 41)},
    {"frame": (10, 5, 100, 80), "region": (0, 0, 17, 80)},
    {"oversample": 2, "region": (3, 7, 40, 30)},
]


def light_of(plan, *outer, seed=3):
    """Return light everywhere with some bright pixels."""
    rng = np.random.default_rng(seed)
    light = rng.random((*outer, *plan.shape))
    light[rng.random(light.shape) > 0.998] += 100.0
    return light.astype(plan.dtype)


def part_of(plan, light):
    """Return the part of light that reaches the image."""
    x0, y0, columns, rows = plan.light_region
    return light[..., y0 : y0 + rows, x0 : x0 + columns]


def difference(result, reference):
    """Return the largest difference, relative to the largest value of the reference."""
    result, reference = np.asarray(result, float), np.asarray(reference, float)
    assert result.shape == reference.shape
    return np.abs(result - reference).max() / np.abs(reference).max()


def check(plan, *outer):
    """Compare the image and the adjoint by autograd with those of the engine."""
    rounding = ROUNDING[str(plan.dtype)]
    light = light_of(plan, *outer)
    given = torch.from_numpy(light).requires_grad_()
    images = TilesInTorch(plan)(given)
    assert images.dtype == given.dtype and images.is_contiguous()
    assert difference(images.detach(), plan.simulate(light)) <= rounding
    other = np.random.default_rng(4).random(images.shape).astype(plan.dtype)
    images.backward(torch.from_numpy(other))
    adjoint = plan.adjoint(other)
    gradient = given.grad.numpy()
    if plan.region is not None:
        # The engine's adjoint is only this part. No other light reaches the image.
        part = part_of(plan, gradient)
        assert np.count_nonzero(gradient) == np.count_nonzero(part)
        gradient = part
    assert difference(gradient, adjoint) <= rounding


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("anchor", ["source", "output"])
@pytest.mark.parametrize("name", MODELS)
def test_models(name, anchor, precision):
    model = MODELS[name]()
    for tolerance in (0.0, 1e-3):
        check(model.plan(SHAPE, tolerance, precision, anchor=anchor))


@pytest.mark.parametrize("anchor", ["source", "output"])
@pytest.mark.parametrize("settings", SETTINGS)
def test_settings(settings, anchor):
    for precision in ("f32", "f64"):
        check(widening_model().plan(SHAPE, precision=precision, anchor=anchor, **settings))


@pytest.mark.parametrize("anchor", ["source", "output"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 37), (41, 1), (3, 5), (37, 53), (101, 97)])
def test_small_and_odd_frames(shape, anchor):
    """Most of these frames are smaller than the stamps."""
    model = widening_model((101, 97), size=45)
    for precision in ("f32", "f64"):
        check(model.plan(shape, precision=precision, anchor=anchor), 2)


@pytest.mark.parametrize("anchor", ["source", "output"])
def test_batches_of_frames(anchor, monkeypatch):
    plan = widening_model((256, 256)).plan((256, 256), 1e-4, anchor=anchor)
    assert len(set(plan.blocks["modes"])) > 1
    check(plan, 64)
    # In steps of one part of one frame, and in a single step.
    light = torch.from_numpy(light_of(plan, 3))
    tiles = TilesInTorch(plan)
    images = tiles(light)
    for pixels in (1, 1 << 30):
        monkeypatch.setattr("psfield._torch_tiles._PIXELS_PER_THREAD", pixels)
        assert difference(tiles(light), images) <= ROUNDING["float32"]


@pytest.mark.parametrize("anchor", ["source", "output"])
def test_blocks_of_all_kinds(anchor, monkeypatch):
    nodes = [(x, y) for y in (0, 150) for x in (0, 300, 413, 599)]
    model = psfield.PsfModel.from_basis(
        None,
        gaussian_stamp(1.3) / np.linalg.norm(gaussian_stamp(1.3)),
        [[0.0], [0.0], [1.0], [2.0]] * 2,
        nodes,
        field_shape=(151, 600),
        interpolation="bilinear",
        normalise="keep",
    )
    plan = model.plan((151, 600), 1e-3, anchor=anchor, region=(100, 3, 400, 140))
    # PSFs of some blocks are zero.
    assert {(*block,) for block in plan.blocks[["nx", "modes"]].tolist()} > {(150, 0), (150, 1)}
    check(plan, 2)
    # Blocks are divided into parts.
    monkeypatch.setattr("psfield._torch_tiles._LARGEST_PART", 20)
    check(plan, 2)
    check(widening_model().plan(SHAPE, 1e-1, anchor=anchor))


def test_any_leading_axes_and_parts_of_light():
    plan = widening_model().plan(SHAPE, 1e-3, "f64", region=(30, 20, 50, 41))
    tiles = TilesInTorch(plan)
    light = torch.from_numpy(light_of(plan, 2, 3))
    images = tiles(light)
    assert images.shape == (2, 3, 41, 50)
    rounding = ROUNDING["float64"]
    assert difference(tiles(part_of(plan, light)), images) == 0
    for index in np.ndindex(2, 3):
        assert difference(tiles(light[index]), images[index]) <= rounding
    # Strides of any kind.
    assert difference(tiles(light.mT.contiguous().mT), images) == 0
    assert tiles(light[:0]).shape == (0, 3, 41, 50)
    assert not tiles(torch.zeros_like(light)).any()


# PyTorch itself uses parts that it calls deprecated for derivatives of batches.
@pytest.mark.filterwarnings("ignore:.torch.jit")
@pytest.mark.parametrize("anchor", ["source", "output"])
@pytest.mark.parametrize("oversample", [1, 2])
def test_derivatives(anchor, oversample):
    model = widening_model((16, 12), size=7)
    plan = model.plan((16, 12), 1e-3, "f64", anchor=anchor, oversample=oversample)
    tiles = TilesInTorch(plan)
    light = torch.from_numpy(light_of(plan, 2)).requires_grad_()
    assert torch.autograd.gradcheck(tiles, light, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(lambda light: tiles(light) ** 2, light)
    light, tangent = light.detach(), torch.from_numpy(light_of(plan, 2, seed=5))
    rounding = ROUNDING["float64"]
    _, along = torch.func.jvp(tiles, (light,), (tangent,))
    assert difference(along, tiles(tangent)) <= rounding
    columns = torch.func.jacfwd(tiles)(light[0])
    assert difference(torch.func.jacrev(tiles)(light[0]), columns) <= rounding
    one_by_one = torch.func.vmap(tiles, in_dims=2, out_dims=1)(light.movedim(0, 2))
    assert difference(one_by_one.movedim(1, 0), tiles(light)) <= rounding


def test_a_light_that_is_fitted():
    plan = widening_model().plan(SHAPE, 1e-3, "f64")
    tiles = TilesInTorch(plan)
    image = tiles(torch.from_numpy(light_of(plan)))
    light = torch.zeros(SHAPE, dtype=torch.float64, requires_grad=True)
    # Its step is below 2 / (largest eigenvalue of A^T A), which is about 1 for unit flux.
    optimizer = torch.optim.SGD([light], lr=0.9)
    losses = []
    for _ in range(20):
        optimizer.zero_grad()
        loss = ((tiles(light) - image) ** 2).sum() / 2
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] < 0.3 * losses[0]


@pytest.mark.parametrize("anchor", ["source", "output"])
def test_a_wrong_weight_or_kernel_is_noticed(anchor):
    """The comparison with the engine would not pass by chance."""
    plan = widening_model().plan(SHAPE, 1e-3, anchor=anchor)
    light = light_of(plan)
    expected = plan.simulate(light)
    y, x = np.unravel_index(light.argmax(), SHAPE)
    for name in ("weights", "spectra"):
        tiles = TilesInTorch(plan)
        (group,) = tiles._groups
        if name == "weights":
            # Of the first kernel, and of the part with the brightest pixel.
            rows, columns = group.shape
            part = group.places.index((y // rows * rows, x // columns * columns))
            group.weights[part] *= 1 + PERTURBED
        else:
            group.spectra[0] *= 1 + PERTURBED
        assert difference(tiles(torch.from_numpy(light)), expected) > 10 * ROUNDING["float32"]


def test_results_are_the_same_every_time():
    plan = widening_model().plan(SHAPE, 1e-3)
    tiles = TilesInTorch(plan)
    light = torch.from_numpy(light_of(plan, 3))
    torch.use_deterministic_algorithms(True)
    try:
        images = tiles(light)
    finally:
        torch.use_deterministic_algorithms(False)
    for again in (tiles, copy.deepcopy(tiles), pickle.loads(pickle.dumps(tiles))):
        assert torch.equal(again(light), images)
    assert not tiles.state_dict()
    assert "scenes 96 x 128" in repr(tiles)


def test_light_that_cannot_be():
    plan = widening_model().plan(SHAPE, 1e-3, region=(30, 20, 50, 41))
    tiles = TilesInTorch(plan)
    light = torch.from_numpy(light_of(plan))
    with pytest.raises(TypeError, match=r"light must be torch.float32, .* got torch.float64"):
        tiles(light.double())
    with pytest.raises(TypeError, match=r"light must be torch.float32, .* got torch.int64"):
        tiles(light.long())
    with pytest.raises(ValueError, match=r"scenes of shape \(96, 128\), or \(57, 66\) .*got"):
        tiles(light[1:])
    with pytest.raises(ValueError, match="got \\(128,\\)"):
        tiles(light[0])
    with pytest.raises(ValueError, match="light is on meta, but the plan's buffers on cpu"):
        tiles(light.to("meta"))
    with pytest.raises(TypeError, match=r"must not be converted to torch.float64"):
        copy.deepcopy(tiles).double()(light.double())
    # Without values, the shape is known.
    assert copy.deepcopy(tiles).to("meta")(light.to("meta")).shape == (41, 50)


def test_plans_that_need_the_engine():
    waves = [0.5, 0.6]
    stamps = [gaussian_stamp(sigma) for sigma in (1.2, 1.8)]
    chromatic = psfield.PsfModel.from_samples(stamps, [(0, 0)] * 2, wavelengths_um=waves)
    plan = chromatic.plan((20, 30), bandpass=([0.5, 0.6], [1.0, 1.0]), sed="blackbody:5000")
    with pytest.raises(ValueError, match="in colour needs the native engine"):
        TilesInTorch(plan)
    y, x = np.mgrid[-200:201, -200:201].astype(float)
    wide = psfield.PsfModel.from_samples((1 + (x**2 + y**2) / 3) ** -1.5, (0, 0))
    assert wide.fit_report().wings is not None
    with pytest.raises(ValueError, match="with wings needs the native engine"):
        TilesInTorch(wide.plan((20, 30)))
    # The engine needs a PSF only where light is.
    at = [(0, 0), (20, 0), (0, 40), (20, 40)]
    part = psfield.PsfModel.from_samples(
        [gaussian_stamp(1.5)] * 4, at, outside="error", interpolation="bilinear"
    )
    plan = part.plan((41, 41))
    plan.simulate(np.eye(41) * (np.arange(41) <= 20))
    with pytest.raises(ValueError, match=r"\(21, 0\)"):
        TilesInTorch(plan)
    TilesInTorch(part.plan((41, 21)))


def test_sizes_of_transforms():
    for at_least in range(1, 3000):
        size = _transform_size(at_least)
        assert at_least <= size <= max(8, 1.25 * at_least)
        assert size % 2 == 0 or size < 16

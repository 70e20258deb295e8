"""Interpolations and bases of the caller's own."""

import functools
import pickle

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator, RBFInterpolator
from sklearn.decomposition import NMF, FastICA
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF

import psfield

SHAPE = (200, 300)
SIZE = 16


def truth(x, y):
    """Return Gaussians that widen and shear over the field, on pixels of half the size."""
    v, u = (np.mgrid[:SIZE, :SIZE] - SIZE // 2)[..., np.newaxis]
    width = 8 + 3 * np.sin(x / 150) + y / 100
    stamps = np.exp(-(u**2 + v**2 + 0.5 * np.cos(y / 120) * u * v) / width)
    return np.moveaxis(4 * stamps / stamps.sum(axis=(0, 1)), -1, 0)


def samples(count=80):
    """Return stamps at random positions, and the positions."""
    rng = np.random.default_rng(1)
    corners = [(0, 0), (299, 0), (0, 199), (299, 199)]
    at = np.concatenate([corners, rng.uniform(0, 1, (count - 4, 2)) * (299, 199)])
    return truth(*at.T), at


def model(**choices):
    stamps, at = samples()
    settings = {"field_shape": SHAPE, "oversampling": 2, "noise": 0} | choices
    return psfield.PsfModel.from_samples(stamps, at, **settings)


def parabola(positions, values):
    """Fit a polynomial of degree 2 by least squares."""

    def terms(at):
        x, y = at.T / 100
        return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])

    solution = np.linalg.lstsq(terms(positions), values, rcond=None)[0]
    return lambda at: terms(at) @ solution


INTERPOLATIONS = {
    "RBFInterpolator": RBFInterpolator,
    "GaussianProcessRegressor": GaussianProcessRegressor(RBF(120.0), alpha=1e-9, optimizer=None),
    "parabola": parabola,
    "a partial": functools.partial(RBFInterpolator, kernel="quintic"),
}
BASES = {
    "NMF": NMF(8, init="nndsvda", max_iter=2000, tol=1e-3),
    "FastICA": FastICA(8, random_state=0),
    "stamps": samples(10)[0],
}


def distance(a, b):
    return np.max(np.linalg.norm(a - b, axis=(1, 2)) / np.linalg.norm(b, axis=(1, 2)))


def check_all_of(found):
    """Check a model in all its uses: image, report, file, pickle, finer scene, adjoint."""
    rng = np.random.default_rng(2)
    light = rng.exponential(1.0, SHAPE)
    plan = found.plan(SHAPE, tolerance=1e-4, tolerance_on="l2", precision="f64")
    assert plan.spot_check(light, pixels=200).passed
    # The adjoint.
    other = rng.normal(size=SHAPE)
    a, b = np.vdot(plan.simulate(light), other), np.vdot(light, plan.adjoint(other))
    assert abs(a - b) < 1e-9 * np.linalg.norm(light) * np.linalg.norm(other)
    # Leave one out.
    report = found.fit_report()
    assert report.samples == 80
    assert len(report.errors) == 80
    assert report.leave_one_out.predicted > 60
    # Files and pickles.
    found.write("own.fits", overwrite=True)
    x, y = rng.uniform(0, 1, (2, 50)) * [[299], [199]]
    for again in (psfield.PsfModel.read("own.fits"), pickle.loads(pickle.dumps(found))):
        assert again.interpolation == found.interpolation
        assert distance(again.evaluate(x, y), found.evaluate(x, y)) < 1e-12
    assert pickle.loads(pickle.dumps(found)).fit_report() == report
    # A finer scene.
    finer = found.plan((400, 600), oversample=2, tolerance_on="l2", precision="f64")
    assert finer.spot_check(rng.exponential(1.0, (400, 600)), pixels=100).passed
    return report


@pytest.mark.parametrize("name", INTERPOLATIONS)
def test_an_interpolation_in_all_its_uses(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = INTERPOLATIONS[name]
    found = model(interpolation=own)
    report = check_all_of(found)
    assert report.leave_one_out.folds == 10
    known = "RBFInterpolator" if name == "a partial" else name
    assert known in found.interpolation
    assert "table" in found.interpolation
    # The table holds the interpolation up to its error.
    built_in = model()
    values = built_in.coefficients
    at = built_in.positions
    exact = own.fit(at, values).predict if hasattr(own, "fit") else own(at, values)
    x, y = np.random.default_rng(3).uniform(0, 1, (2, 200)) * [[299], [199]]
    expected = built_in.mean + np.tensordot(
        exact(np.column_stack([x, y])), built_in.components, axes=1
    )
    assert distance(found.evaluate(x, y), expected) < 2e-5


@pytest.mark.parametrize("name", BASES)
def test_a_basis_in_all_its_uses(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = model(basis=BASES[name])
    report = check_all_of(found)
    count = 10 if name == "stamps" else 8
    assert found.given_components.shape == (count, SIZE, SIZE)
    flat = found.components.reshape(found.rank, -1)
    assert np.abs(flat @ flat.T - np.eye(found.rank)).max() < 1e-12
    # The given components are sums of those of the model.
    given = found.given_components.reshape(count, -1)
    rest = given - given @ flat.T @ flat
    assert np.linalg.norm(rest) < 1e-9 * np.linalg.norm(given)
    assert report.max_error < 0.1
    assert pickle.loads(pickle.dumps(found)).given_components.shape == given.shape[:1] + (SIZE,) * 2


def test_wavelengths_have_one_table():
    stamps, at = samples(30)
    wide = np.roll(stamps, 1, axis=2)
    found = psfield.PsfModel.from_samples(
        np.concatenate([stamps, wide]),
        np.concatenate([at, at]),
        wavelengths_um=[0.5] * 30 + [0.7] * 30,
        field_shape=SHAPE,
        interpolation=RBFInterpolator,
        noise=0,
    )
    x, y = np.random.default_rng(3).uniform(0, 1, (2, 20)) * [[299], [199]]
    short, middle, long = (found.at(wavelength_um=w).evaluate(x, y) for w in (0.5, 0.6, 0.7))
    assert distance(middle, (short + long) / 2) < 1e-12
    assert distance(np.roll(short, 1, axis=2), long) < 0.03
    assert found.fit_report().leave_one_out.predicted > 40


def test_every_constructor_takes_an_interpolation():
    stamps, at = samples(20)
    own = {"interpolation": RBFInterpolator, "table_error": 1e-4}
    mean, flat = stamps.mean(axis=0), (stamps - stamps.mean(axis=0)).reshape(20, -1)
    components = np.linalg.svd(flat, full_matrices=False)[2][:3]
    model = psfield.PsfModel.from_basis(
        mean, components.reshape(3, SIZE, SIZE), flat @ components.T, at, field_shape=SHAPE, **own
    )
    assert model.interpolation.startswith("RBFInterpolator (table=")
    assert model.fit_report() is None
    telescope = psfield.PsfModel.from_telescope(
        field_shape=(60, 80), samples=(4, 5), stamp_size=16, **own
    )
    assert telescope.interpolation.startswith("RBFInterpolator (table=")


@pytest.mark.parametrize(
    ("own", "error", "text"),
    [
        (3, TypeError, "must be a name, an object with fit and predict, or a function"),
        (lambda at, values: values, TypeError, "must return a function of positions"),
        (lambda at, values: lambda at: np.zeros((len(at), 99)), ValueError, r"of shape .*99"),
        (
            lambda at, values: lambda at: np.full((len(at), values.shape[1]), np.nan),
            ValueError,
            "finite",
        ),
        (
            lambda at, values: lambda at: np.tile(at[:, :1] > 77.3, values.shape[1]) * 0.1,
            ValueError,
            r"too rough near \(7\d.*table_error",
        ),
        (LinearNDInterpolator, ValueError, "too rough|finite"),
    ],
)
def test_an_interpolation_that_does_not_suit(own, error, text):
    with pytest.raises(error, match=text):
        model(interpolation=own, table_error=1e-7)


def test_errors_of_the_callers_code_are_passed_on():
    def failing(positions, values):
        raise RuntimeError("no licence for this method")

    with pytest.raises(RuntimeError, match="no licence"):
        model(interpolation=failing)

    def later(positions, values):
        def predict(at):
            if len(at) > 100:
                raise ZeroDivisionError("too many")
            return np.zeros((len(at), values.shape[1]))

        return predict

    with pytest.raises(ValueError, match="too many") as raised:
        model(interpolation=later)
    assert isinstance(raised.value.__cause__, ZeroDivisionError)
    with pytest.raises(ValueError, match="table_error must be above 0"):
        model(interpolation=parabola, table_error=0)


def test_settings_of_the_built_in_basis_are_refused():
    with pytest.raises(ValueError, match="rank does not apply together with basis"):
        model(basis=BASES["stamps"], rank=3)


def test_bad_pixels_do_not_count():
    stamps, at = samples()
    rng = np.random.default_rng(4)
    noisy = stamps + 3e-3 * rng.normal(size=stamps.shape)
    bad = rng.uniform(size=stamps.shape) < 0.03
    spoilt = np.where(bad, np.nan, noisy)
    settings = {"field_shape": SHAPE, "oversampling": 2}
    clean = psfield.PsfModel.from_samples(noisy, at, **settings)
    masked = psfield.PsfModel.from_samples(spoilt, at, weights=~bad * 1.0, **settings)
    filled = psfield.PsfModel.from_samples(np.where(bad, 0.1, noisy), at, **settings)
    x, y = rng.uniform(0, 1, (2, 50)) * [[299], [199]]
    exact = truth(x, y)
    of_clean, of_masked, of_filled = (
        distance(model.evaluate(x, y), exact) for model in (clean, masked, filled)
    )
    assert of_masked < 1.3 * of_clean < 0.5 * of_filled
    assert masked.rank <= clean.rank + 2
    assert masked.fit_report().samples == len(at)
    for weights, text in (
        (-np.ones(len(at)), "at least 0"),
        (np.ones(3), "shape"),
        (np.ones((len(at), 3, 3)), "shape of the stamps"),
        (np.zeros(len(at)), "flux 0"),
    ):
        with pytest.raises(ValueError, match=text):
            psfield.PsfModel.from_samples(stamps, at, weights=weights, **settings)


def test_kriging_weighs_samples_by_their_noise():
    stamps, at = samples(150)
    rng = np.random.default_rng(5)
    sigma = np.linalg.norm(stamps, axis=(1, 2)).mean() * rng.choice([0.003, 0.05], len(at))
    noisy = stamps + sigma[:, np.newaxis, np.newaxis] * rng.normal(size=stamps.shape)
    settings = {"field_shape": SHAPE, "oversampling": 2, "interpolation": "kriging"}
    x, y = rng.uniform(20, 180, (2, 100))
    exact = truth(x, y)

    def error(model):
        return np.sqrt(np.mean(np.sum((model.evaluate(x, y) - exact) ** 2, axis=(1, 2))))

    plain = psfield.PsfModel.from_samples(noisy, at, **settings)
    weighted = psfield.PsfModel.from_samples(noisy, at, weights=sigma**-2, **settings)
    neighbours = psfield.PsfModel.from_samples(
        noisy, at, **settings | {"interpolation": "natural-neighbour"}
    )
    assert error(weighted) < error(plain) < 0.9 * error(neighbours)
    assert weighted.fit_report().expected_error > 0

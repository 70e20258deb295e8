"""`psfield.simulate`, `psfield.example` and models of telescopes."""

from __future__ import annotations

import numpy as np
import pytest

import psfield

STARS = {"x": [20.0, 50.5], "y": [30.0, 10.25], "flux": [1000.0, 500.0]}


@pytest.fixture(scope="module")
def model() -> psfield.PsfModel:
    """Return the PSF of the survey telescope over a small frame."""
    return psfield.PsfModel.from_telescope(
        "survey-2m", field_shape=(60, 80), samples=(7, 7), stamp_size=24, oversampling=4
    )


def test_one_call_equals_a_plan(model: psfield.PsfModel) -> None:
    scene = np.zeros((60, 80), np.float32)
    scene[30, 40] = 100.0
    plan = model.plan((60, 80), tolerance=1e-4)
    call = {"tolerance": 1e-4}
    for image, expected in [
        (psfield.simulate(scene, model, **call), plan.simulate(scene)),
        (psfield.simulate(STARS, model, **call), plan.simulate(catalog=STARS)),
        (psfield.simulate(scene, model, STARS, **call), plan.simulate(scene, STARS)),
        (psfield.simulate(scene.tolist(), model, **call), plan.simulate(scene)),
        (psfield.simulate([scene, scene], model, **call), plan.simulate([scene, scene])),
    ]:
        np.testing.assert_array_equal(image, expected)


def test_the_shape_of_a_catalogue_is_that_of_the_field_or_given(model: psfield.PsfModel) -> None:
    assert psfield.simulate(STARS, model).shape == (60, 80)
    assert psfield.simulate(STARS, model, shape=(50, 70)).shape == (50, 70)
    assert psfield.simulate(STARS, model, oversample=3).shape == (60, 80)


def test_what_one_call_refuses(model: psfield.PsfModel) -> None:
    scene = np.zeros((60, 80))
    everywhere = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    with pytest.raises(TypeError, match=r"simulate\(scene, model\)"):
        psfield.simulate(model, scene)
    with pytest.raises(TypeError, match="both catalogues"):
        psfield.simulate(STARS, model, STARS)
    with pytest.raises(TypeError, match="leave it out"):
        psfield.simulate(scene, model, shape=(60, 80))
    with pytest.raises(TypeError, match="no argument 'zero_point'"):
        psfield.simulate(STARS, model, zero_point=30)
    with pytest.raises(ValueError, match="only magnitudes: set flux"):
        psfield.simulate({"x": [1], "y": [1], "mag": [20]}, model)
    with pytest.raises(ValueError, match="no field_shape"):
        psfield.simulate({"x": [1], "y": [1], "flux": [1]}, everywhere)


def test_warnings_name_the_line_of_the_caller(model: psfield.PsfModel) -> None:
    coarse = psfield.PsfModel.from_samples([[0, 1, 0], [1, 4, 1], [0, 1, 0]], (0, 0))
    stars = {"x": [5.3], "y": [4.2], "flux": [1.0]}
    plan = coarse.plan((10, 12))
    for call in (
        lambda: psfield.simulate(stars, coarse, shape=(10, 12)),
        lambda: plan.simulate(catalog=stars),
    ):
        with pytest.warns(psfield.PsfieldWarning, match="too coarse") as caught:
            call()
        assert {warning.filename for warning in caught} == {__file__}


def test_the_example_is_always_the_same_and_right() -> None:
    catalog, model = psfield.example((100, 150))
    again, _ = psfield.example((100, 150))
    assert all(np.array_equal(catalog[name], again[name]) for name in catalog)
    assert 0 < np.count_nonzero(catalog["re"]) < len(catalog["re"])
    check = model.plan((100, 150), tolerance=1e-3).spot_check(catalog=catalog, pixels=200)
    assert check.passed


def test_a_telescope_has_the_field_and_the_stamps_that_are_asked(model: psfield.PsfModel) -> None:
    assert (model.field_shape, model.stamp_shape, model.oversampling) == ((60, 80), (96, 96), 4.0)
    assert model.positions.min(axis=0).tolist() == [0.0, 0.0]
    assert model.positions.max(axis=0).tolist() == [79.0, 59.0]
    lens = psfield.PsfModel.from_telescope("wide-field-lens", samples=(2, 2))
    assert (lens.field_shape, lens.stamp_shape, lens.oversampling) == ((4096, 4096), (32, 32), 2.0)
    finer = psfield.PsfModel.from_telescope("wide-field-lens", samples=(2, 2), oversampling=3)
    assert finer.stamp_shape == (48, 48)


def test_a_telescope_file_is_read_and_diffraction_widens_with_the_wavelength(
    tmp_path: object,
) -> None:
    path = f"{tmp_path}/telescope.toml"
    with open(path, "w") as file:
        file.write(
            "wavelength_nm = 600.0\npixel_scale_arcsec = 0.05\nframe = { nx = 30, ny = 20 }\n"
            "stamp = { nx = 32, ny = 32 }\naperture = { diameter_m = 1.0 }\n"
        )
    model = psfield.PsfModel.from_telescope(path, samples=(2, 3))
    assert (model.field_shape, len(model.positions)) == ((20, 30), 6)
    wavelengths = (0.5, 0.7, 0.9)
    colours = psfield.PsfModel.from_telescope(
        path, samples=(2, 2), oversampling=1, wavelengths_um=wavelengths
    )
    stamps = [colours.at(wavelength_um=um).evaluate(15, 10) for um in wavelengths]
    sizes = [psfield.metrics.fit_gaussian(stamp).fwhm for stamp in stamps]
    # The pixel adds a constant to the square of the width.
    assert sizes[0] < 0.8 * sizes[1] < 0.8 * 0.85 * sizes[2], sizes


def test_wrong_telescopes_are_named(tmp_path: object) -> None:
    with pytest.raises(ValueError, match=r"survey-2m, wide-field-lens.*no file nothing\.toml"):
        psfield.PsfModel.from_telescope("nothing.toml")
    with pytest.raises(ValueError, match="wavelengths_um is empty"):
        psfield.PsfModel.from_telescope(wavelengths_um=[])
    with pytest.raises(ValueError, match="oversampling"):
        psfield.PsfModel.from_telescope(oversampling=0)
    path = f"{tmp_path}/wrong.toml"
    with open(path, "w") as file:
        file.write("wavelength_nm = -1\n")
    with pytest.raises(ValueError, match=r"wrong\.toml"):
        psfield.PsfModel.from_telescope(path)

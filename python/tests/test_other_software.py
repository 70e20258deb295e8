"""Comparisons with photutils, GalSim and files of other software."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from conftest import gaussian_stamp, relative_l2

import psfield

#: Rounding of splines and files in single precision, relative to the peak.
OF_PEAK = 1e-6
#: GalSim's Lanczos kernel comes from a table.
LANCZOS = 1e-4
#: The error of GalSim on these stars is 1e-3 of the peak. The spline of photutils, cut to the same
#: size, reaches 8.6e-4.
STARS = 1.0e-3
#: Largest error of a galaxy's image, relative to its peak, at a tolerance of 1e-5, and the error of
#: its shear. GalSim's own errors are included.
GALAXIES = 2e-4
SHEAR = 1e-4
MODEL = "psfex/DECam_00154912_12.psf"


def rows(path):
    """Return the columns of a CSV."""
    with open(path, newline="") as file:
        table = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {name: np.array([float(row[name]) for row in table]) for name in table[0]}


def photutils_model(across=4, size=65, oversampling=4):
    """Return a gridded model of photutils whose PSF widens and moves over 200 x 300 pixels."""
    psf, nddata = pytest.importorskip("photutils.psf"), pytest.importorskip("astropy.nddata")
    places = [(x, y) for y in np.linspace(0, 199, across) for x in np.linspace(0, 299, across + 1)]
    # The stamps are faint at their edges, like those of libraries. The splines differ there.
    stamps = [
        oversampling**2 * gaussian_stamp((1.2 + x / 1000) * oversampling, size, (y / 100, -x / 200))
        for x, y in places
    ]
    return psf.GriddedPSFModel(
        nddata.NDData(np.array(stamps), meta={"grid_xypos": places, "oversampling": oversampling})
    )


class TestPhotutils:
    """photutils' `GriddedPSFModel`."""

    @pytest.mark.parametrize(("size", "oversampling"), [(65, 4), (64, 4), (25, 1), (49, 3)])
    def test_stars_at_100_positions(self, size, oversampling):
        gridded = photutils_model(size=size, oversampling=oversampling)
        model = psfield.PsfModel.from_gridded_psf_model(gridded)
        rng = np.random.default_rng(3)
        largest = 0.0
        for x, y in zip(rng.uniform(0, 299, 100), rng.uniform(0, 199, 100)):
            own = model.evaluate(x, y, pixels="frame", sub_pixel=True, size=7)
            column, row = np.floor(x + 0.5), np.floor(y + 0.5)
            ys, xs = np.mgrid[-3:4, -3:4]
            theirs = gridded.evaluate(xs + column, ys + row, 1.0, x, y)
            largest = max(largest, np.abs(own - theirs).max() / theirs.max())
        assert largest < OF_PEAK

    def test_an_image_of_stars(self):
        gridded = photutils_model(size=41, oversampling=2)
        plan = psfield.PsfModel.from_gridded_psf_model(gridded).plan((200, 300), 0.0, "f64")
        rng = np.random.default_rng(4)
        stars = {
            "x": rng.uniform(20, 280, 30),
            "y": rng.uniform(20, 180, 30),
            "flux": rng.uniform(1, 100, 30),
        }
        image = plan.simulate(catalog=stars)
        ys, xs = np.mgrid[:200, :300].astype(float)
        theirs = sum(gridded.evaluate(xs, ys, f, x, y) for x, y, f in zip(*stars.values()))
        assert np.abs(image - theirs).max() < OF_PEAK * theirs.max()

    def test_there_and_back(self):
        gridded = photutils_model()
        model = psfield.PsfModel.from_gridded_psf_model(gridded, field_shape=(200, 300))
        again = model.to_gridded_psf_model()
        assert np.allclose(again.data, gridded.data, rtol=0, atol=OF_PEAK * gridded.data.max())
        assert np.array_equal(np.asarray(again.grid_xypos), np.asarray(gridded.grid_xypos))
        assert again.meta["psfield_max_error"] is None
        finer = model.to_gridded_psf_model((9, 9))
        assert len(finer.data) == 81
        assert 0 < finer.meta["psfield_max_error"] < 0.05

    def test_what_cannot_be_taken_over(self):
        class Uneven:
            data = np.ones((1, 5, 5))
            grid_xypos = ((0, 0),)
            oversampling = (2, 4)

        with pytest.raises(ValueError, match="the same in x and y"):
            psfield.PsfModel.from_gridded_psf_model(Uneven())


class TestGalsim:
    """GalSim, if it is installed."""

    def test_psfex_models_written_here(self, model, tmp_path):
        galsim, des = pytest.importorskip("galsim"), pytest.importorskip("galsim.des")
        model.write(tmp_path / "model.psf", format="psfex", degree=2)
        read = psfield.PsfModel.read(tmp_path / "model.psf")
        theirs = des.DES_PSFEx(str(tmp_path / "model.psf"))
        for x, y in [(0, 0), (60.5, 30.25), (127, 95)]:
            # Positions of GalSim are 1-based.
            drawn = (
                theirs.getPSF(galsim.PositionD(x + 1, y + 1))
                .drawImage(nx=17, ny=17, scale=1.0, method="no_pixel")
                .array
            )
            own = read.evaluate(x, y, size=17)
            assert np.abs(own - drawn).max() < LANCZOS * drawn.max()

    def test_a_function_of_galsim(self):
        galsim = pytest.importorskip("galsim")

        def draw(x, y):
            psf = galsim.Moffat(beta=3.5, fwhm=2.5 + x / 400).shear(g1=0.05 * y / 300)
            return psf.drawImage(nx=33, ny=33, scale=1.0)

        model = psfield.PsfModel.from_function(draw, (300, 400), threshold=1e-3)
        for x, y in [(13.0, 250.0), (222.0, 111.0), (399.0, 299.0)]:
            assert (
                relative_l2(model.evaluate(x, y), draw(x, y).array / draw(x, y).array.sum()) < 1e-3
            )

    @pytest.mark.parametrize(
        ("re", "n", "q", "angle"),
        [
            (0.1, 0.5, 1, 0),
            (0.5, 4, 0.4, 30),
            (1.5, 1, 0.2, 70),
            (3, 2.5, 0.6, 120),
            (8, 1.5, 0.7, 10),
        ],
    )
    def test_galaxies(self, re, n, q, angle):
        galsim = pytest.importorskip("galsim")
        accurate = galsim.GSParams(
            folding_threshold=1e-4,
            maxk_threshold=1e-5,
            kvalue_accuracy=1e-8,
            stepk_minimum_hlr=20,
            maximum_fft_size=32768,
        )
        size, across, place = 192, 200, (95.3, 96.8)
        # The same stamps for both, oversampled by 4.
        y, x = (np.mgrid[:across, :across] - across // 2) / 4
        stamp = (1 + (x**2 + y**2) / 2.5**2) ** -2.5
        model = psfield.PsfModel.from_samples([stamp], [(0, 0)], oversampling=4)
        ours = model.plan((size, size), tolerance=1e-5, precision="f64").simulate(
            catalog={
                "x": place[0],
                "y": place[1],
                "flux": 1,
                "re": re,
                "n": n,
                "q": q,
                "angle": angle,
            }
        )
        psf = galsim.InterpolatedImage(
            galsim.ImageD(stamp / stamp.sum()),
            scale=0.25,
            x_interpolant="lanczos15",
            use_true_center=False,
            gsparams=accurate,
            calculate_stepk=False,
            calculate_maxk=False,
        )
        # The half-light radius of GalSim is that of the round profile of equal area.
        light = galsim.Sersic(n=n, half_light_radius=re * np.sqrt(q), gsparams=accurate)
        light = light.shear(q=q, beta=angle * galsim.degrees)
        theirs = galsim.Convolve(light, psf, gsparams=accurate).drawImage(
            nx=size,
            ny=size,
            scale=1,
            method="no_pixel",
            dtype=float,
            offset=[at - (size - 1) / 2 for at in place],
        )
        assert np.abs(ours - theirs.array).max() < GALAXIES * theirs.array.max()

        def shape(image):
            """Return the reduced shear and the size by adaptive moments."""
            found = galsim.hsm.FindAdaptiveMom(
                galsim.ImageD(image),
                guess_sig=3,
                guess_centroid=galsim.PositionD(place[0] + 1, place[1] + 1),
                hsmparams=galsim.hsm.HSMParams(convergence_threshold=1e-9, max_mom2_iter=2000),
            )
            return found.observed_shape.g1, found.observed_shape.g2, found.moments_sigma

        (g1, g2, own_size), (h1, h2, their_size) = shape(ours), shape(theirs.array)
        assert max(abs(g1 - h1), abs(g2 - h2)) < SHEAR
        assert abs(own_size / their_size - 1) < 2 * SHEAR


class TestOutsideData:
    """Files and true images made by other software."""

    def test_a_library_as_photutils_reads_it(self, outside_data):
        psf = pytest.importorskip("photutils.psf")
        gridded = psf.GriddedPSFModel.read(outside_data / "stdpsf/PSFSTD_WFC3IR_F160W.fits")
        model = psfield.PsfModel.from_gridded_psf_model(gridded)
        (left, low), (right, high) = (
            np.min(gridded.grid_xypos, axis=0),
            np.max(gridded.grid_xypos, axis=0),
        )
        rng = np.random.default_rng(3)
        ys, xs = np.mgrid[-12:13, -12:13]
        for x, y in zip(rng.uniform(left, right, 100), rng.uniform(low, high, 100)):
            own = model.evaluate(x, y, pixels="frame", sub_pixel=True, size=25)
            theirs = gridded.evaluate(xs + np.floor(x + 0.5), ys + np.floor(y + 0.5), 1.0, x, y)
            assert np.abs(own - theirs).max() < OF_PEAK * theirs.max()

    def test_a_psfex_model_as_galsim_draws_it(self, outside_data):
        fits = pytest.importorskip("astropy.io.fits")
        at = rows(outside_data / "psfex/DECam_00154912_12_positions.csv")
        for name, words, limit in [
            ("modelgrid", {}, OF_PEAK),
            ("native_galsim", {"pixels": "frame", "size": 48}, LANCZOS),
        ]:
            truth = fits.getdata(outside_data / f"psfex/DECam_00154912_12_{name}.fits").astype(
                float
            )
            model = psfield.PsfModel.read(
                outside_data / MODEL, normalise="keep" if name == "modelgrid" else "unit"
            )
            x, y = at["x_image_1based"][: len(truth)] - 1, at["y_image_1based"][: len(truth)] - 1
            own = model.evaluate(x, y, **words)
            assert np.abs(own - truth).max() < limit * truth.max()

    def test_roman_stars_as_galsim_draws_them(self, outside_data):
        fits = pytest.importorskip("astropy.io.fits")
        model = psfield.PsfModel.read(
            outside_data / "roman/epsf4x_samples1024.fits", normalise="keep"
        )
        truth = fits.getdata(outside_data / "roman/stars_truth.fits").astype(float)
        image = model.plan(truth.shape, stamp_size=25).simulate(
            catalog=rows(outside_data / "roman/stars.csv")
        )
        assert relative_l2(image, truth) < STARS

    def test_a_scene_against_the_exact_sum(self, outside_data):
        fits = pytest.importorskip("astropy.io.fits")
        for anchor in ("source", "output"):
            model = psfield.PsfModel.read(
                outside_data / "strong/samples512.fits", interpolation="bilinear", rank="full"
            )
            scene = fits.getdata(outside_data / "strong/scene512.fits")
            truth = fits.getdata(outside_data / f"strong/scene512_{anchor}.fits").astype(float)
            # The byte order of FITS.
            assert not scene.dtype.isnative
            assert (
                relative_l2(model.plan(scene.shape, 0.0, anchor=anchor).simulate(scene), truth)
                < 1e-6
            )

"""Measurements and detectors."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from conftest import gaussian_stamp

from psfield import detector, metrics

#: Full width at half maximum of a Gaussian over its sigma.
FWHM = 2 * np.sqrt(2 * np.log(2))


class TestMetrics:
    """Measurements of stamps whose size and shape are known."""

    stamp = gaussian_stamp(2.0, 41, shift=(0.3, -0.2), q=1.5)

    def test_gaussian_fits(self):
        fit = metrics.fit_gaussian(self.stamp)
        assert (fit.x, fit.y) == pytest.approx((20.3, 19.8), abs=1e-6)
        assert (fit.fwhm_minor, fit.fwhm_major) == pytest.approx((2.0 * FWHM, 3.0 * FWHM), rel=1e-6)
        assert fit.fwhm == pytest.approx(np.sqrt(6.0) * FWHM, rel=1e-6)
        assert fit.eccentricity == pytest.approx(np.sqrt(1 - (2 / 3) ** 2), rel=1e-6)
        with pytest.deprecated_call(match="eccentricity"):
            assert fit.ellipticity == fit.eccentricity
        assert fit.angle == pytest.approx(np.pi / 2, abs=1e-6)
        assert fit.flux == pytest.approx(1.0, rel=1e-6) and fit.background is None
        lifted = metrics.fit_gaussian(self.stamp + 0.01, background=True, size=31)
        assert lifted.background == pytest.approx(0.01, rel=1e-6)
        assert metrics.fit_gaussian(self.stamp, round=True).eccentricity == 0.0

    def test_moments(self):
        for moments in (
            metrics.adaptive_moments(self.stamp),
            metrics.quadrupole_moments(self.stamp),
        ):
            assert moments.sigma == pytest.approx(np.sqrt(6.0), rel=1e-4)
            assert moments.e1 == pytest.approx((4 - 9) / (4 + 9), rel=1e-4)
            assert moments.g1 == pytest.approx((2 - 3) / (2 + 3), rel=1e-4)
            assert (moments.e2, moments.g2) == pytest.approx((0, 0), abs=1e-9)

    def test_the_moments_are_galsim_s(self):
        galsim = pytest.importorskip("galsim")
        stamp = gaussian_stamp(2.0, 41) + 0.3 * gaussian_stamp(4.0, 41, q=0.7)
        theirs = galsim.hsm.FindAdaptiveMom(galsim.Image(stamp))
        own = metrics.adaptive_moments(stamp)
        # GalSim stops at 1e-6.
        assert own.sigma == pytest.approx(theirs.moments_sigma, rel=1e-5)
        assert (own.g1, own.g2) == pytest.approx(
            (theirs.observed_shape.g1, theirs.observed_shape.g2), abs=1e-5
        )

    def test_comparisons(self):
        truth = np.arange(1.0, 13.0).reshape(3, 4)
        result = truth.copy()
        result[1, 2] += 0.5
        found = metrics.compare(result, truth)
        assert found.max_abs == 0.5 and found.max_abs_index == (1, 2)
        assert found.mae == pytest.approx(0.5 / 12) and found.mse == pytest.approx(0.25 / 12)
        assert found.relative_l2 == pytest.approx(0.5 / np.linalg.norm(truth))
        assert found.max_over_peak == pytest.approx(0.5 / 12)
        same = metrics.compare(truth, truth)
        assert same.relative_l2 == 0.0 and same.snr_db is None
        assert metrics.compare(truth, 0 * truth).relative_l2 is None
        with pytest.raises(ValueError, match="shape"):
            metrics.compare(truth, truth[:2])

    def test_tables(self):
        stamps = np.stack([gaussian_stamp(s, 31) for s in (1.5, 2.0, 2.5)] + [np.zeros((31, 31))])
        table = metrics.measure(stamps)
        assert table["fwhm_px"][:3] == pytest.approx(FWHM * np.array([1.5, 2.0, 2.5]), rel=1e-6)
        elongated = metrics.measure(self.stamp)
        assert elongated["ellipticity"] == pytest.approx(5 / 13, rel=1e-4)
        assert elongated["eccentricity"] == pytest.approx(np.sqrt(1 - 4 / 9), rel=1e-6)
        assert np.isnan(table["fwhm_px"][3]) and table["note"][3] and not table["note"][0]
        image = np.zeros((60, 80))
        image[10:41, 20:51] = stamps[1]
        of_image = metrics.measure(image, [(35, 25), (900, 3)], size=21)
        assert of_image["x_centroid"][0] == pytest.approx(35.0, abs=1e-6)
        assert "outside the image" in of_image["note"][1]

    @pytest.mark.parametrize(
        ("bad", "error", "text"),
        [
            (np.zeros((21, 21)), ValueError, "."),
            (np.full((21, 21), np.nan), ValueError, "."),
            (np.ones(21), ValueError, r"\[y, x\]"),
            (np.ones((21, 21), complex), TypeError, "real"),
            (np.zeros((0, 5)), ValueError, "empty"),
        ],
    )
    def test_what_cannot_be_measured(self, bad, error, text):
        for measure in (metrics.fit_gaussian, metrics.adaptive_moments, metrics.quadrupole_moments):
            with pytest.raises(error, match=text):
                measure(bad)


class TestDetector:
    """From light to counts."""

    def test_the_chain(self):
        ccd = detector.Detector(
            photon_noise=True,
            sky_e=100.0,
            read_noise_e=5.0,
            gain_e_per_adu=2.0,
            bias_adu=300,
            bits=np.int64(12),
        )
        light = np.zeros((200, 300), np.float32)
        light[5, 7] = 1e6
        exposure = ccd.expose(light, 42)
        assert exposure.counts.dtype == np.float32 and exposure.counts.shape == light.shape
        assert exposure.counts[5, 7] == ccd.saturation == 4095
        assert exposure.flags[5, 7] == detector.SATURATED and exposure.report.saturated_pixels == 1
        good = exposure.counts[exposure.flags == 0]
        assert good.mean() == pytest.approx(350, abs=0.1)
        assert good.std() == pytest.approx(np.sqrt(125) / 2, rel=0.02)
        assert np.array_equal(good, np.round(good)) and ccd.unit == "adu"
        assert np.array_equal(ccd.expose(light, 42).counts, exposure.counts)
        assert not np.array_equal(ccd.expose(light, 43).counts, exposure.counts)
        assert ccd.expose(light.astype(float), 1).counts.dtype == np.float64

    def test_a_perfect_detector_changes_nothing(self):
        light = np.random.default_rng(1).random((30, 40))
        assert np.array_equal(detector.Detector().expose(light, 0).counts, light)
        assert detector.Detector().unit == "electron"

    def test_bad_pixels(self):
        mask = np.zeros((30, 40), np.uint8)
        mask[3, 4] = detector.DEAD
        exposure = detector.Detector().expose(np.ones((30, 40)), 0, bad_pixels=mask)
        assert exposure.counts[3, 4] == 0 and exposure.flags[3, 4] == detector.DEAD
        with pytest.raises(ValueError, match="mask"):
            detector.Detector().expose(np.ones((30, 41)), 0, bad_pixels=mask)
        with pytest.raises(ValueError):
            detector.Detector().expose(np.ones((30, 40)), 0, bad_pixels=mask + 100)

    def test_parameters(self, tmp_path):
        ccd = detector.Detector(
            read_noise_e=3.0, bad_pixels={"dead_fraction": 0.1}, full_well_e=None
        )
        assert ccd.params["bad_pixels"]["dead_fraction"] == 0.1
        assert repr(ccd).startswith("Detector(read_noise_e=3.0, bad_pixels=")
        again = pickle.loads(pickle.dumps(ccd))
        assert again.params == ccd.params
        (tmp_path / "ccd.toml").write_text(
            "read_noise_e = 3.0\n[bad_pixels]\ndead_fraction = 0.1\n"
        )
        assert detector.Detector.from_toml(tmp_path / "ccd.toml").params == ccd.params

    @pytest.mark.parametrize(
        ("params", "error", "text"),
        [
            ({"reed_noise": 1.0}, TypeError, "reed_noise"),
            ({"read_noise_e": -1.0}, ValueError, "read_noise_e"),
            ({"read_noise_e": "low"}, TypeError, "read_noise_e must be a number, got .low."),
            ({"read_noise_e": np.ones(3)}, TypeError, "read_noise_e must be a number"),
            ({"dark_e_per_s": 1.0}, ValueError, "exposure_s"),
            ({"bits": 40}, ValueError, "bits"),
        ],
    )
    def test_bad_parameters(self, params, error, text):
        with pytest.raises(error, match=text):
            detector.Detector(**params)

    def test_files(self, tmp_path):
        with pytest.raises((OSError, ValueError), match=r"none\.toml"):
            detector.Detector.from_toml(tmp_path / "none.toml")
        (tmp_path / "bad.toml").write_text("reed_noise = 1.0\n")
        with pytest.raises(ValueError, match=r"(?s)bad\.toml.*reed_noise"):
            detector.Detector.from_toml(tmp_path / "bad.toml")

    def test_light_that_cannot_be(self):
        for bad in (np.full((5, 5), np.nan), np.zeros((0, 5)), np.zeros(5)):
            with pytest.raises(ValueError):
                detector.Detector().expose(bad, 0)

//! Valid and invalid descriptions of detectors.

use psf_detector::{Detector, DetectorError, DetectorParams};

const ALL: &str = r#"
    name = "CCD"
    electrons_per_flux = 0.8
    exposure_s = 150.0
    photon_noise = true
    sky_e = 45.0
    sky_gradient_e_per_px = { x = 0.01 }
    dark_e_per_s = 0.02
    response_rms = 0.005
    full_well_e = 90000.0
    read_noise_e = 5.0
    gain_e_per_adu = 1.5
    bias_adu = 500.0
    bits = 16
    pattern_seed = 3
    [bad_pixels]
    dead_fraction = 1e-4
    hot_fraction = 1e-4
    hot_dark_e_per_s = 20.0
    bad_column_fraction = 1e-3
"#;

#[test]
fn every_key_is_read_and_none_is_required() {
    let params = Detector::from_toml_str(ALL).unwrap().params().clone();
    assert_eq!(params.sky_gradient_e_per_px.unwrap().x, 0.01);
    assert_eq!((params.bits, params.pattern_seed), (Some(16), 3));
    assert_eq!(params.bad_pixels.hot_dark_e_per_s, 20.0);
    assert_eq!(
        Detector::from_toml_str("").unwrap().params(),
        &DetectorParams::default()
    );
    let text = toml::to_string(&params).unwrap();
    assert_eq!(Detector::from_toml_str(&text).unwrap().params(), &params);
}

#[test]
fn values_out_of_range_are_named() {
    for (text, key) in [
        ("electrons_per_flux = 0.0", "electrons_per_flux"),
        ("electrons_per_flux = nan", "electrons_per_flux"),
        ("exposure_s = -1.0", "exposure_s"),
        ("sky_e = -1.0", "sky_e"),
        ("sky_e = inf", "sky_e"),
        ("sky_gradient_e_per_px = { x = nan }", "sky_gradient_e_per_px.x"),
        ("exposure_s = 1.0\ndark_e_per_s = -1.0", "dark_e_per_s"),
        ("response_rms = 1.0", "response_rms"),
        ("full_well_e = 0.0", "full_well_e"),
        ("read_noise_e = -5.0", "read_noise_e"),
        ("gain_e_per_adu = 0.0", "gain_e_per_adu"),
        ("bias_adu = inf", "bias_adu"),
        ("bits = 0", "bits"),
        ("bits = 25", "bits"),
        ("[bad_pixels]\ndead_fraction = 1.5", "bad_pixels.dead_fraction"),
        (
            "[bad_pixels]\ndead_fraction = 0.6\nhot_fraction = 0.6",
            "bad_pixels.hot_fraction",
        ),
        (
            "[bad_pixels]\nbad_column_fraction = -0.1",
            "bad_pixels.bad_column_fraction",
        ),
    ] {
        match Detector::from_toml_str(text) {
            Err(error @ DetectorError::Setting { .. }) => {
                assert!(
                    error.to_string().starts_with(&format!("{key} must be ")),
                    "{text}: {error}"
                );
            }
            other => panic!("{text}: {other:?}"),
        }
    }
}

#[test]
fn errors_name_the_key_that_a_setting_needs() {
    for (text, key, other) in [
        ("dark_e_per_s = 1.0", "dark_e_per_s", "exposure_s"),
        (
            "[bad_pixels]\nhot_fraction = 0.1",
            "bad_pixels.hot_fraction",
            "bad_pixels.hot_dark_e_per_s",
        ),
        (
            "[bad_pixels]\nhot_dark_e_per_s = 5.0",
            "bad_pixels.hot_dark_e_per_s",
            "exposure_s",
        ),
    ] {
        let error = Detector::from_toml_str(text).unwrap_err().to_string();
        assert!(error.contains(key) && error.contains(other), "{error}");
    }
    assert_eq!(
        Detector::from_toml_str("dark_e_per_s = 1.0")
            .unwrap_err()
            .to_string(),
        "a dark current (dark_e_per_s) needs an exposure time: set exposure_s"
    );
}

#[test]
fn unknown_keys_and_missing_files_are_named() {
    for (text, key) in [
        ("read_noise = 5.0", "read_noise"),
        ("[bad_pixels]\ndead = 0.1", "dead"),
        ("bits = 1.5", "bits"),
    ] {
        let error = Detector::from_toml_str(text).unwrap_err();
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(source.contains(key), "{source}");
    }
    let error = Detector::from_toml_file("not-there.toml").unwrap_err();
    assert!(error.to_string().contains("not-there.toml"));
}

//! Telescope files: accepted and refused content, and the messages.

use std::error::Error;

use psf_optics::{OpticsError, SURVEY_2M_TOML, Telescope, TelescopeParams, WIDE_FIELD_LENS_TOML};
use psf_types::{Position, PsfSource};

const GOOD: &str = r#"
wavelength_nm = 600
pixel_scale_arcsec = 0.1
frame = { nx = 1000, ny = 800 }
stamp = { nx = 32, ny = 24, oversampling = 2 }
[aperture]
diameter_m = 1.0
obscuration = 0.3
spider = { vanes = 4, width_m = 0.02, angle_deg = 45 }
[wavefront]
unit = "nm"
modes = [{ noll = 4, terms = [{ x = 2, value = 40 }, { value = -3.5 }] }]
[seeing]
r0_m = 0.15
outer_scale_m = 22
[detector]
pixel_integration = false
blur_sigma_px = 0.3
"#;

/// Returns the messages of the whole chain of an error.
fn chain(error: OpticsError) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(source) = next {
        text.push('\n');
        text.push_str(&source.to_string());
        next = source.source();
    }
    text
}

fn refused(from: &str, to: &str) -> String {
    assert!(
        GOOD.contains(from),
        "the file contains the text to replace: {from}"
    );
    chain(Telescope::from_toml_str(&GOOD.replacen(from, to, 1)).unwrap_err())
}

#[test]
fn a_full_description_is_read_and_written_back() {
    let telescope = Telescope::from_toml_str(GOOD).unwrap();
    let grid = telescope.grid();
    assert_eq!((grid.nx(), grid.ny(), grid.oversampling()), (32, 24, 2.0));
    assert!(!grid.pixel_response_included());
    assert_eq!((telescope.field().nx(), telescope.field().ny()), (1000, 800));
    let text = toml::to_string(telescope.params()).unwrap();
    assert_eq!(
        &toml::from_str::<TelescopeParams>(&text).unwrap(),
        telescope.params()
    );
}

#[test]
fn unknown_and_missing_keys_and_wrong_types_are_named() {
    for (from, to, expected) in [
        (
            "obscuration = 0.3",
            "obstruction = 0.3",
            "unknown field `obstruction`",
        ),
        ("x = 2,", "z = 2,", "unknown field `z`"),
        ("diameter_m = 1.0", "", "missing field `diameter_m`"),
        ("wavelength_nm = 600", "", "missing field `wavelength_nm`"),
        ("value = 40", "power = 40", "unknown field `power`"),
        (
            "r0_m = 0.15",
            "r0_m = \"good\"",
            "invalid type: string \"good\", expected f64",
        ),
        ("nx = 1000", "nx = -1000", "invalid value: integer `-1000`"),
        ("nx = 1000", "nx = 10.5", "invalid type: floating point `10.5`"),
        ("\"nm\"", "\"mm\"", "unknown variant `mm`"),
        ("[seeing]", "[seeing", "TOML parse error"),
    ] {
        let message = refused(from, to);
        assert!(message.contains(expected), "{to}: {message}");
        assert!(message.contains("line"), "the message names the place: {message}");
    }
}

#[test]
fn values_out_of_range_name_their_key() {
    for (from, to, expected) in [
        (
            "wavelength_nm = 600",
            "wavelength_nm = 0",
            "wavelength_nm must be a number of nm above 0, got 0",
        ),
        (
            "pixel_scale_arcsec = 0.1",
            "pixel_scale_arcsec = nan",
            "pixel_scale_arcsec must be",
        ),
        (
            "diameter_m = 1.0",
            "diameter_m = inf",
            "aperture.diameter_m must be",
        ),
        (
            "obscuration = 0.3",
            "obscuration = 1.0",
            "aperture.obscuration must be",
        ),
        (
            "vanes = 4",
            "vanes = 0",
            "aperture.spider.vanes must be a whole number from 1 to 64, got 0",
        ),
        (
            "width_m = 0.02",
            "width_m = 1.0",
            "aperture.spider.width_m must be",
        ),
        (
            "oversampling = 2",
            "oversampling = 0",
            "stamp.oversampling must be",
        ),
        ("oversampling = 2", "padding = 0.5", "stamp.padding must be"),
        ("nx = 32", "nx = 0", "a stamp of 0 x 24 pixels is empty"),
        ("ny = 800", "ny = 0", "a frame of 1000 x 0 pixels is empty"),
        (
            "noll = 4",
            "noll = 0",
            "wavefront.modes[0].noll must be an index from 1 to 231, got 0",
        ),
        (
            "value = -3.5",
            "value = inf",
            "wavefront.modes[0].terms[1].value must be a finite number",
        ),
        (
            "x = 2, value = 40",
            "value = 40",
            "wavefront.modes[0].terms[1] repeats the term x = 0, y = 0",
        ),
        (
            "x = 2,",
            "x = 21,",
            "wavefront.modes[0].terms[0].x must be a power from 0 to 20, got 21",
        ),
        ("r0_m = 0.15", "r0_m = -1.0", "seeing.r0_m must be"),
        ("r0_m = 0.15", "fwhm_arcsec = 0", "seeing.fwhm_arcsec must be"),
        (
            "r0_m = 0.15",
            "r0_m = 0.1\nfwhm_arcsec = 1",
            "exactly one of seeing.r0_m and seeing.fwhm_arcsec",
        ),
        (
            "r0_m = 0.15",
            "",
            "exactly one of seeing.r0_m and seeing.fwhm_arcsec must be given, got 0",
        ),
        (
            "outer_scale_m = 22",
            "outer_scale_m = 0",
            "seeing.outer_scale_m must be",
        ),
        (
            "outer_scale_m = 22",
            "at_wavelength_nm = 0",
            "seeing.at_wavelength_nm must be",
        ),
        (
            "blur_sigma_px = 0.3",
            "blur_sigma_px = -0.3",
            "detector.blur_sigma_px must be",
        ),
        (
            "pixel_scale_arcsec = 0.1",
            "pixel_scale_arcsec = 1e-5",
            "choose a pixel scale closer to lambda / D",
        ),
        ("nx = 32", "nx = 20000", "the PSF would need transforms of"),
    ] {
        let message = refused(from, to);
        assert!(message.contains(expected), "{to}: {message}");
    }
    let mode = "modes = [{ noll = 4, terms = [] }, { noll = 4, terms = [] }]\n#";
    assert!(refused("modes", mode).contains("wavefront.modes[1] repeats noll = 4"));
}

#[test]
fn errors_of_files_name_the_file() {
    let missing = Telescope::from_toml_file("/no/such/telescope.toml").unwrap_err();
    assert!(matches!(missing, OpticsError::Read { .. }));
    assert!(missing.to_string().contains("/no/such/telescope.toml"));
    let path = std::env::temp_dir().join(format!("psf-optics-{}.toml", std::process::id()));
    std::fs::write(&path, GOOD.replace("diameter_m = 1.0", "diameter_m = -1.0")).unwrap();
    let message = chain(Telescope::from_toml_file(&path).unwrap_err());
    std::fs::write(&path, GOOD).unwrap();
    assert!(Telescope::from_toml_file(&path).is_ok());
    std::fs::remove_file(&path).unwrap();
    assert!(
        message.contains(&path.display().to_string()) && message.contains("aperture.diameter_m"),
        "{message}"
    );
}

#[test]
fn a_too_steep_wavefront_is_refused_only_where_it_is_too_steep() {
    let steep = GOOD.replace("value = 40 }", "value = 60000 }");
    let telescope = Telescope::from_toml_str(&steep).unwrap();
    assert!(telescope.draw(Position::new(499.5, 0.0).unwrap()).is_ok());
    let error = telescope.draw(Position::new(0.0, 0.0).unwrap()).unwrap_err();
    let source = error.source().unwrap().to_string();
    assert!(source.contains("the wavefront at (0, 0) sends light"), "{source}");
    assert!(
        telescope.draw(Position::new(1e300, 0.0).unwrap()).is_err(),
        "an overflow does not give a PSF"
    );
}

#[test]
fn the_presets_are_as_documented() {
    let presets = [
        (Telescope::survey_2m(), SURVEY_2M_TOML, (9232, 9216), 2.0, 0.074),
        (
            Telescope::wide_field_lens(),
            WIDE_FIELD_LENS_TOML,
            (4096, 4096),
            0.18,
            11.7,
        ),
    ];
    for (telescope, text, frame, diameter, scale) in presets {
        let params = telescope.params();
        assert_eq!(&toml::from_str::<TelescopeParams>(text).unwrap(), params);
        assert_eq!((params.frame.nx, params.frame.ny), frame);
        assert_eq!(
            (params.aperture.diameter_m, params.pixel_scale_arcsec),
            (diameter, scale)
        );
        let corner = Position::of_pixel(frame.0 as i64 - 1, 0);
        let centre = Position::of_pixel(frame.0 as i64 / 2, frame.1 as i64 / 2);
        let [corner, centre] = [corner, centre].map(|p| telescope.draw(p).unwrap());
        let peak = |s: &psf_types::Stamp| s.values().iter().copied().fold(0.0, f64::max);
        assert!(
            peak(&corner) < 0.7 * peak(&centre),
            "{}: the corner differs visibly",
            params.name
        );
        for stamp in [corner, centre] {
            assert!(
                stamp.flux() > 0.99 && stamp.flux() < 1.0,
                "{}: {}",
                params.name,
                stamp.flux()
            );
        }
    }
}

/// "About 3 %" is the r.m.s. over the field.
const NEIGHBOURS: std::ops::Range<f64> = 0.025..0.035;

#[test]
fn neighbours_of_a_71_grid_of_the_survey_telescope_differ_by_3_per_cent() {
    let telescope = Telescope::survey_2m();
    let step = |i: i32, n: usize| f64::from(i) * (n - 1) as f64 / 70.0;
    let draw = |i, j| {
        telescope
            .draw(Position::new(step(i, 9232), step(j, 9216)).unwrap())
            .unwrap()
            .into_values()
    };
    let (mut sum, mut count) = (0.0, 0.0);
    for j in (0..70).step_by(7) {
        for i in (0..70).step_by(7) {
            let here = draw(i, j);
            for other in [draw(i + 1, j), draw(i, j + 1)] {
                sum += (&here - &other).mapv(|v| v * v).sum() / here.mapv(|v| v * v).sum();
                count += 1.0;
            }
        }
    }
    let rms = f64::sqrt(sum / count);
    assert!(NEIGHBOURS.contains(&rms), "{rms}");
}

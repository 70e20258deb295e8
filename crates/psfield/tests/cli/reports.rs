//! `reproduce` and `validate`.

use serde_json::Value;

use crate::desk::Desk;

/// A frame, samples and objects as small as they can be; every stage runs.
const TINY: &str = "reproduce --report out --quick --frame 420,420 --samples 8 --objects 3 --image-side 96 --galaxy-side 96 \
                    --adaptive-threshold 0.2 --json";

const FIGURES: [&str; 10] = [
    "singular-values",
    "sampling",
    "fwhm",
    "ellipticity-differences",
    "ellipticity-distribution",
    "mae-distribution",
    "mse-map",
    "e1-map",
    "e2-map",
    "galaxy",
];

fn number(value: &Value, pointer: &str) -> f64 {
    value
        .pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("no number at {pointer}"))
}

/// The page holds all it shows.
fn check_page(desk: &Desk, name: &str) {
    let page = String::from_utf8(desk.bytes(name)).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    assert!(page.contains("prefers-color-scheme") && page.contains("@media print"));
    for outside in ["http", "url(", "<script", "<link"] {
        assert!(!page.contains(outside), "{name}: {outside}");
    }
    assert_eq!(page.matches("<img").count(), page.matches("src=\"data:").count());
}

#[test]
fn a_tiny_reproduction_has_every_figure_and_number() {
    let desk = Desk::empty();
    let run = desk.run(TINY);
    assert_eq!(run.code, Some(0), "{run:?}");
    let printed = run.json();
    let written: Value = serde_json::from_slice(&desk.bytes("out/report.json")).unwrap();
    for report in [&printed, &written] {
        assert_eq!(number(report, "/samples"), 64.0);
        assert_eq!(number(report, "/objects"), 9.0);
        assert_eq!(number(report, "/stars/summary/objects"), 9.0);
        assert_eq!(report["targets"].as_array().unwrap().len(), 16);
        // Two kinds at four tolerances.
        assert_eq!(report["tolerances"].as_array().unwrap().len(), 8);
        assert_eq!(report["interpolations"].as_array().unwrap().len(), 4);
        // A single PSF, psfield at two tolerances, four sizes of patches.
        assert_eq!(report["table_1"]["sizes"][0]["rows"].as_array().unwrap().len(), 7);
        assert_eq!(report["basis"]["singular_values"].as_array().unwrap().len(), 64);
        assert_eq!(number(report, "/basis/cumulative_weights/63"), 1.0);
    }
    assert!(
        written["software"]["command"]
            .as_str()
            .unwrap()
            .contains("--samples 8")
    );
    assert!(
        written["inputs"]["telescope"]
            .as_str()
            .unwrap()
            .contains("survey-2m")
    );

    // Seams of patches are far above what the engine adds.
    let patches = number(&written, "/large_galaxy/patch_relative_l2");
    let ours = number(&written, "/large_galaxy/lowrank_relative_l2");
    assert!(patches > 1e-3 && ours < 1e-4, "{patches} {ours}");
    // Samples far apart: the interpolation dominates at fine tolerances, the engine at the coarsest one.
    let star_errors: Vec<f64> = (0..8)
        .step_by(2)
        .map(|row| number(&written, &format!("/tolerances/{row}/summary/relative_l2/mean")))
        .collect();
    assert!(
        star_errors.windows(2).all(|w| w[1] <= w[0] * 1.05),
        "{star_errors:?}"
    );

    for figure in FIGURES {
        let svg = String::from_utf8(desk.bytes(&format!("out/{figure}.svg"))).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("<text"), "{figure}");
        assert!(
            desk.bytes(&format!("out/{figure}.png")).starts_with(b"\x89PNG"),
            "{figure}"
        );
    }
    check_page(&desk, "out/report.html");
    let table = String::from_utf8(desk.bytes("out/stars.csv")).unwrap();
    assert_eq!(table.lines().count(), 10);

    let again = desk.run(TINY);
    assert_eq!(again.code, Some(1));
    assert!(again.stderr.contains("--overwrite"), "{again:?}");
}

#[test]
fn a_model_is_validated_by_the_samples_that_it_came_from_and_by_others() {
    let desk = Desk::new();
    let fitted = desk.run("fit samples.fits -o model.fits --rank full");
    assert_eq!(fitted.code, Some(0), "{fitted:?}");
    let run = desk.run("validate model.fits --truth samples.fits --report same --json");
    assert_eq!(run.code, Some(0), "{run:?}");
    let same = run.json();
    assert_eq!(same["truth"], "samples");
    assert_eq!(number(&same, "/objects/summary/objects"), 9.0);
    // Files hold samples in single precision; the model returns them at their own positions.
    assert!(number(&same, "/objects/summary/mae_over_mean/largest") < 1e-5);
    assert!(number(&same, "/objects/summary/ellipticity/largest") < 1e-3);
    check_page(&desk, "same/report.html");

    // A model of a single component cannot hold nine different PSFs.
    desk.run("fit samples.fits -o coarse.fits --rank 1");
    let run = desk.run("validate coarse.fits --truth samples.fits --report coarse --json");
    assert!(number(&run.json(), "/objects/summary/mae_over_mean/largest") > 1e-3);

    let of_model = desk.run("validate model.fits --truth model.fits --report model");
    assert_eq!(of_model.code, Some(1));
    assert!(of_model.stderr.contains("psfield evaluate"), "{of_model:?}");
}

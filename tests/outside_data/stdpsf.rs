//! STDPSF libraries against photutils, for every file and detector.

use libtest_mimic::{Failed, Trial};
use psfield::psf_io::{FileKind, detect, read_stdpsf};
use psfield::psf_types::Position;

use crate::data::{ensure, file, trial};
use crate::libraries::Truth;

/// File, detector, and whether there is a truth at the detector's pixels.
const CASES: [(&str, Option<usize>, bool); 4] = [
    ("PSFSTD_WFC3IR_F160W", None, true),
    ("STDPSF_ACSWFC_F814W_mock", Some(1), false),
    ("STDPSF_ACSWFC_F814W_mock", Some(2), false),
    ("STDPSF_NRCA1_F150W_mock", None, false),
];

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials: Vec<Trial> = CASES
        .into_iter()
        .map(|(name, detector, native)| {
            trial(format!("stdpsf: {}", case(name, detector)), move || {
                library(name, detector, native)
            })
        })
        .collect();
    trials.push(trial("stdpsf: the detectors differ".into(), detectors));
    trials
}

fn case(name: &str, detector: Option<usize>) -> String {
    detector.map_or_else(|| name.to_owned(), |n| format!("{name}_det{n}"))
}

fn library(name: &str, detector: Option<usize>, native: bool) -> Result<(), Failed> {
    let path = file(&format!("stdpsf/{name}.fits"));
    ensure(detect(&path)? == FileKind::Stdpsf, || {
        format!("{name} is not detected as {}", FileKind::Stdpsf)
    })?;
    let library = read_stdpsf(&path, detector)?;
    let case = case(name, detector);
    let truth = Truth::open("stdpsf", &case)?;
    truth.check_own_grid(library.samples(), &case)?;
    if native {
        truth.check_native(library.samples(), &case)?;
    }
    // The files count pixels from 1 and their first sample is at 0, which is -1 here.
    let first = library.samples().positions().as_slice()[0];
    ensure(first == Position::of_pixel(-1, -1), || {
        format!("the first sample of {case} is at {first}")
    })
}

fn detectors() -> Result<(), Failed> {
    let path = file("stdpsf/STDPSF_ACSWFC_F814W_mock.fits");
    let error = read_stdpsf(&path, None).expect_err("there are two detectors");
    ensure(
        error.setting() == Some("detector") && error.to_string().contains("2 (WFC1)"),
        || error.to_string(),
    )?;
    let other = read_stdpsf(&path, Some(1))?;
    let truth = Truth::open("stdpsf", "STDPSF_ACSWFC_F814W_mock_det2")?;
    truth.check_own_grid_differs(other.samples(), "STDPSF_ACSWFC_F814W_mock_det2")
}

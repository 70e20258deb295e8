//! `Psf::open` reads real files of every kind with the defaults of their formats.

use libtest_mimic::{Failed, Trial};
use psfield::psf_basis::RankSelection;
use psfield::psf_io::{FileKind, PlaneOrder};
use psfield::psf_types::Normalisation;
use psfield::{FitChoices, Psf, PsfFileOptions};

use crate::data::{ensure, file, trial};
use crate::libraries::Truth;

const STPSF: &str = "nircam_nrca1_f200w_fovp101_samp4_npsf16_mock";

pub(crate) fn trials() -> Vec<Trial> {
    let detector = |n| PsfFileOptions {
        detector: Some(n),
        ..PsfFileOptions::default()
    };
    let order = |order| PsfFileOptions {
        plane_order: Some(order),
        ..PsfFileOptions::default()
    };
    let one = PsfFileOptions::default;
    let mut trials: Vec<Trial> = [
        ("stdpsf", "PSFSTD_WFC3IR_F160W", "", one()),
        ("stdpsf", "STDPSF_NRCA1_F150W_mock", "", one()),
        ("stdpsf", "STDPSF_ACSWFC_F814W_mock", "_det1", detector(1)),
        ("stdpsf", "STDPSF_ACSWFC_F814W_mock", "_det2", detector(2)),
        ("stpsf", STPSF, "_as_cards", order(PlaneOrder::Cards)),
        ("stpsf", STPSF, "", order(PlaneOrder::Sorted)),
    ]
    .into_iter()
    .map(|(folder, name, which, options)| {
        trial(format!("Psf::open: {name}{which}"), move || {
            library(folder, name, which, &options)
        })
    })
    .collect();
    trials.push(trial("Psf::open: two detectors".into(), two_detectors));
    trials
}

/// A library is opened without scaling and with every component, and notes say how it was read.
fn library(folder: &'static str, name: &str, which: &str, options: &PsfFileOptions) -> Result<(), Failed> {
    let path = file(&format!("{folder}/{name}.fits"));
    let opened = Psf::open_with(path, options, &FitChoices::default())?;
    let kind = if folder == "stpsf" {
        FileKind::Stpsf
    } else {
        FileKind::Stdpsf
    };
    ensure(opened.kind() == Some(kind), || {
        format!("the file is detected as {:?}", opened.kind())
    })?;
    let Some((samples, fit)) = opened.samples() else {
        return Err("a library holds samples".into());
    };
    ensure(
        fit.rank == RankSelection::Full && fit.normalisation == Normalisation::Keep,
        || format!("{fit:?}"),
    )?;
    let says = if options.plane_order.is_some() {
        "order"
    } else {
        "detector"
    };
    ensure(
        options == &PsfFileOptions::default()
            || opened.notes().iter().any(|note| note.to_string().contains(says)),
        || format!("no note mentions the {says}: {:?}", opened.notes()),
    )?;
    let truth_name = format!("{name}{which}");
    let truth = Truth::open(folder, if folder == "stpsf" { name } else { &truth_name })?;
    truth.check_own_grid(samples, &truth_name)?;
    // With the defaults of the format, not with the options of the comparison.
    let error = truth.own_grid_error_of(opened.model()?, &truth_name)?;
    ensure(error <= 1e-6, || {
        format!("error of {error:e} with the format's own options")
    })
}

fn two_detectors() -> Result<(), Failed> {
    let path = file("stdpsf/STDPSF_ACSWFC_F814W_mock.fits");
    match Psf::open_with(path, &PsfFileOptions::default(), &FitChoices::default()) {
        Err(error) => ensure(error.setting() == Some("detector"), || error.to_string()),
        Ok(psf) => Err(format!("{psf:?}").into()),
    }
}

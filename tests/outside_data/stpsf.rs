//! An STPSF library against photutils, in both orders of its planes. Also writes libraries and
//! reads them back.

use libtest_mimic::{Failed, Trial};
use psfield::psf_io::{FileKind, PlaneOrder, detect, read_stdpsf, read_stpsf, write_gridded};

use crate::data::{ensure, file, trial};
use crate::libraries::Truth;

const NAME: &str = "nircam_nrca1_f200w_fovp101_samp4_npsf16_mock";

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("stpsf: planes in the order of the cards".into(), || {
            library(PlaneOrder::Cards, true)
        }),
        trial("stpsf: planes sorted, as photutils 3.0 reads them".into(), || {
            library(PlaneOrder::Sorted, false)
        }),
        trial(
            "stpsf: WebbPSF 1.2.1 wrote its planes as its cards say".into(),
            || library(PlaneOrder::Auto, true),
        ),
        trial("stpsf: the orders of planes differ".into(), orders),
        trial("stpsf: STDPSF libraries written and read back".into(), written),
    ]
}

fn truth_name(as_cards: bool) -> String {
    if as_cards {
        format!("{NAME}_as_cards")
    } else {
        NAME.to_owned()
    }
}

fn library(order: PlaneOrder, as_cards: bool) -> Result<(), Failed> {
    let path = file(&format!("stpsf/{NAME}.fits"));
    let kind = detect(&path)?;
    ensure(kind == FileKind::Stpsf, || {
        format!("the file is detected as {kind}")
    })?;
    let library = read_stpsf(&path, order)?;
    ensure(library.detector() == Some("NRCA1"), || {
        format!("detector {:?}", library.detector())
    })?;
    Truth::open("stpsf", NAME)?.check_own_grid(library.samples(), &truth_name(as_cards))
}

fn orders() -> Result<(), Failed> {
    let path = file(&format!("stpsf/{NAME}.fits"));
    let truth = Truth::open("stpsf", NAME)?;
    truth.check_own_grid_differs(
        read_stpsf(&path, PlaneOrder::Cards)?.samples(),
        &truth_name(false),
    )?;
    truth.check_own_grid_differs(
        read_stpsf(&path, PlaneOrder::Sorted)?.samples(),
        &truth_name(true),
    )
}

/// Also for grids that differ in x and y, where the writer adds planes between the samples.
fn written() -> Result<(), Failed> {
    let directory = tempfile::tempdir()?;
    for (name, detector, planes) in [
        ("PSFSTD_WFC3IR_F160W", None, 9),
        ("STDPSF_ACSWFC_F814W_mock", Some(2), 100),
    ] {
        let library = read_stdpsf(file(&format!("stdpsf/{name}.fits")), detector)?;
        let path = directory.path().join(name);
        let count = write_gridded(&path, library.samples(), &[], false)?;
        ensure(count == planes, || format!("{name}: {count} planes"))?;
        let back = read_stpsf(&path, PlaneOrder::Auto)?;
        let case = detector.map_or_else(|| name.to_owned(), |n| format!("{name}_det{n}"));
        Truth::open("stdpsf", &case)?.check_own_grid(back.samples(), &case)?;
    }
    Ok(())
}

//! A PSFEx model and a gridded library must hold the stamps that psfield evaluates from them.

use std::path::Path;
use std::process::Command;

use libtest_mimic::{Failed, Trial};
use ndarray::Array3;
use psfield::convert::{SamplesAt, to_gridded, to_psfex};
use psfield::evaluate::{EvaluateOptions, evaluate};
use psfield::psf_io::{self, FileKind, Precision};
use psfield::psf_types::{FrameShape, Normalisation, Position, PsfSamples, SamplePositions, StampGrid};
use psfield::{FitChoices, FitOptions, Psf, PsfFileOptions};

use crate::{python, script};

/// PSFEx's planes and GalSim's stamps are in single precision.
const SAME: f64 = 1e-6;
/// The field is not square, and its middle lies between pixels.
const FIELD: (usize, usize) = (1200, 800);

pub(crate) fn trials() -> Vec<Trial> {
    [24, 25]
        .map(|size| {
            Trial::test(
                format!("stamps of {size} x {size} pixels are read back"),
                move || read_back(size),
            )
        })
        .into()
}

/// A PSF that is asymmetric, not of unit flux, and varies over the field.
fn samples(size: usize) -> Result<PsfSamples, Failed> {
    let field = FrameShape::new(FIELD.0, FIELD.1)?;
    let positions: Vec<Position> = (0..20)
        .map(|k| Position::of_pixel(1199 * (k % 5) / 4, 799 * (k / 5) / 3))
        .collect();
    let centre = (size / 2) as f64;
    let stamps = Array3::from_shape_fn((20, size, size), |(j, y, x)| {
        let (u, v) = (positions[j].x() / 1200.0, positions[j].y() / 800.0);
        let (dx, dy) = ((x as f64 - centre) / 2.0, (y as f64 - centre) / 2.0);
        let sigma = 1.3 + 0.4 * u - 0.2 * v * v;
        let r2 = (dx - 0.2 * v).powi(2) + 1.3 * (dy + 0.1 * u).powi(2) + 0.4 * dx * dy;
        0.1 * (-0.5 * r2 / (sigma * sigma)).exp()
    });
    let grid = StampGrid::new(size, size)?.with_oversampling(2.0)?;
    Ok(PsfSamples::new(
        stamps,
        SamplePositions::new(positions, Some(field))?,
        grid,
    )?)
}

fn read_back(size: usize) -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let path = |name: &str| folder.path().join(name);
    let keep = FitOptions {
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    };
    let input = Psf::new(samples(size)?, keep);
    let psfex = to_psfex(&input, Some(3))?;
    psf_io::write_psfex(path("model.psf"), &psfex.model, &[], false)?;
    let library = to_gridded(&input, &SamplesAt::Own)?;
    psf_io::write_gridded(path("library.fits"), &library.samples, &[], false)?;

    let positions = [(0.0, 0.0), (1199.0, 799.0), (433.25, 610.5), (900.0, 12.75)];
    stamps_of(
        &path("model.psf"),
        FileKind::Psfex,
        &positions,
        &path("model_stamps.fits"),
    )?;
    stamps_of(
        &path("library.fits"),
        FileKind::Stpsf,
        &positions,
        &path("library_stamps.fits"),
    )?;
    let files = [
        "model.psf",
        "model_stamps.fits",
        "library.fits",
        "library_stamps.fits",
    ]
    .map(path);
    let [galsim, photutils] = errors(&files)?;
    println!("{size} x {size}: GalSim {galsim:.2e}, photutils {photutils:.2e} of the peak");
    ensure(galsim <= SAME && photutils <= SAME, galsim, photutils)?;

    // Stamps at other positions differ, so the comparison can fail.
    let moved = positions.map(|(x, y)| (0.9 * x + 60.0, y));
    stamps_of(&path("model.psf"), FileKind::Psfex, &moved, &path("moved.fits"))?;
    let wrong = psf_io::read_samples(path("moved.fits"))?;
    let labels = psf_io::read_samples(path("model_stamps.fits"))?;
    let mislabelled = PsfSamples::new(
        wrong.stamps().to_owned(),
        labels.positions().clone(),
        wrong.grid(),
    )?;
    psf_io::write_samples(path("wrong.fits"), &mislabelled, &[], Precision::Double, false)?;
    let files = ["model.psf", "wrong.fits", "library.fits", "library_stamps.fits"].map(path);
    let [galsim, photutils] = errors(&files)?;
    ensure(galsim > 100.0 * SAME && photutils <= SAME, galsim, photutils)
}

fn ensure(holds: bool, galsim: f64, photutils: f64) -> Result<(), Failed> {
    if holds {
        return Ok(());
    }
    Err(format!("GalSim {galsim:e}, photutils {photutils:e}, at most {SAME:e} of the peak").into())
}

/// Evaluates the PSFs of a file at positions, without scaling.
fn stamps_of(psf: &Path, kind: FileKind, positions: &[(f64, f64)], output: &Path) -> Result<(), Failed> {
    let choices = FitChoices {
        normalisation: Some(Normalisation::Keep),
        ..FitChoices::default()
    };
    let opened = Psf::open_with(psf, &PsfFileOptions::default(), &choices)?;
    if opened.kind() != Some(kind) {
        return Err(format!("the file is detected as {:?}", opened.kind()).into());
    }
    let positions: Result<Vec<Position>, _> = positions.iter().map(|&(x, y)| Position::new(x, y)).collect();
    let stamps = evaluate(opened.model()?, positions?, EvaluateOptions::default())?;
    psf_io::write_samples(output, &stamps, &[], Precision::Double, true)?;
    Ok(())
}

/// The largest errors that GalSim and photutils find.
fn errors(files: &[std::path::PathBuf]) -> Result<[f64; 2], Failed> {
    let run = Command::new(python())
        .arg(script("read_back.py"))
        .args(files)
        .output()?;
    let (out, said) = (
        String::from_utf8_lossy(&run.stdout),
        String::from_utf8_lossy(&run.stderr),
    );
    if !run.status.success() {
        return Err(format!("read_back.py failed: {said}").into());
    }
    let object: serde_json::Value = serde_json::from_str(&out).map_err(|e| format!("{e} in {out}"))?;
    let error = |name: &str| object[name].as_f64().ok_or_else(|| format!("no {name} in {out}"));
    Ok([error("galsim")?, error("photutils")?])
}

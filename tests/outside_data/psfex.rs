//! A real PSFEx model against its own polynomial and against GalSim.

use libtest_mimic::{Failed, Trial};
use ndarray::{Array3, s};
use psfield::evaluate::{EvaluateOptions, OutputGrid, evaluate};
use psfield::metrics::{Comparison, Summary};
use psfield::psf_io::FileKind;
use psfield::psf_types::{Normalisation, Position, PsfSamples};
use psfield::{FitChoices, Psf, PsfFileOptions, convert, psf_io};

use crate::data::{ensure, file, trial};

/// The truth is stored in single precision.
const STORED: f64 = 1e-6;
/// The error of GalSim's table of the Lanczos kernel.
const LANCZOS: f64 = 1e-4;

const MODEL: &str = "psfex/DECam_00154912_12.psf";

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("psfex: the model's own grid".into(), own_grid),
        trial("psfex: drawn by GalSim".into(), drawn_by_galsim),
        trial("psfex: through a model file and back".into(), through_a_model),
        trial("psfex: through samples and back".into(), through_samples),
    ]
}

/// The first positions of the list, 0-based.
fn positions(count: usize) -> Result<Vec<Position>, Failed> {
    let list = file("psfex/DECam_00154912_12_positions.csv");
    let [x, y] = psf_io::read_columns(list, ["x_image_1based", "y_image_1based"])?;
    x.iter()
        .zip(&y)
        .take(count)
        .map(|(x, y)| Ok(Position::new(x - 1.0, y - 1.0)?))
        .collect()
}

fn opened(normalisation: Normalisation) -> Result<Psf, Failed> {
    let choices = FitChoices {
        normalisation: Some(normalisation),
        ..FitChoices::default()
    };
    let opened = Psf::open_with(file(MODEL), &PsfFileOptions::default(), &choices)?;
    ensure(opened.kind() == Some(FileKind::Psfex), || {
        format!("the file is detected as {:?}", opened.kind())
    })?;
    Ok(opened)
}

/// The largest error over the peak of each plane.
fn max_over_peak(stamps: &PsfSamples, truth: &Array3<f64>) -> Result<f64, Failed> {
    let errors: Result<Vec<f64>, _> = Comparison::by_plane(stamps.stamps(), truth.view())?
        .iter()
        .map(Comparison::max_over_peak)
        .collect();
    Ok(Summary::of(errors?)?.max())
}

fn own_grid() -> Result<(), Failed> {
    let truth = psf_io::read_cube::<f64>(file("psfex/DECam_00154912_12_modelgrid.fits"))?;
    let positions = positions(truth.dim().0)?;
    ensure(positions.len() == 100, || {
        format!("{} positions", positions.len())
    })?;
    let psf = opened(Normalisation::Keep)?;
    let model = psf.model()?;
    let stamps = evaluate(model, positions.clone(), EvaluateOptions::default())?;
    let error = max_over_peak(&stamps, &truth)?;
    println!("psfex, own grid: largest error / peak {error:.2e}");
    ensure(error <= STORED, || format!("{error:e}, at most {STORED:e}"))?;
    // The test would notice 1-based positions taken for 0-based ones.
    let shifted = positions
        .iter()
        .map(|p| Position::new(p.x() + 1.0, p.y() + 1.0))
        .collect::<Result<_, _>>()?;
    let wrong = max_over_peak(&evaluate(model, shifted, EvaluateOptions::default())?, &truth)?;
    ensure(wrong > STORED, || {
        format!("a shift of one pixel changes only {wrong:e}")
    })
}

fn drawn_by_galsim() -> Result<(), Failed> {
    let truth = psf_io::read_cube::<f64>(file("psfex/DECam_00154912_12_native_galsim.fits"))?;
    let input = opened(Normalisation::Unit)?;
    let positions = positions(truth.dim().0)?;
    let options = EvaluateOptions {
        grid: OutputGrid::Native,
        size: Some(48),
        sub_pixel: false,
    };
    let stamps = evaluate(input.model()?, positions, options)?;
    let errors: Result<Vec<f64>, _> = Comparison::by_plane(stamps.stamps(), truth.view())?
        .iter()
        .map(Comparison::relative_l2)
        .collect();
    let errors = Summary::of(errors?)?;
    println!(
        "psfex, GalSim: relative L2 median {:.2e}, largest {:.2e}",
        errors.median(),
        errors.max()
    );
    ensure(errors.max() <= LANCZOS, || {
        format!("largest {:e}, at most {LANCZOS:e}", errors.max())
    })
}

fn through_a_model() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("model.fits");
    let psf = opened(Normalisation::Unit)?;
    let record = psf.stored().ok_or("a PSFEx model is a model")?;
    psf_io::write_model(&path, record, &[], &[], false)?;
    let converted = convert::to_psfex(&Psf::open(&path)?, None)?;
    same_planes(&converted.model, "through a model file")
}

fn through_samples() -> Result<(), Failed> {
    let input = opened(Normalisation::Keep)?;
    let at = convert::SamplesAt::Grid { nx: 5, ny: 4 };
    let samples = convert::to_samples(&input, &at)?;
    let options = psfield::FitOptions {
        normalisation: Normalisation::Keep,
        ..psfield::FitOptions::default()
    };
    let converted = convert::to_psfex(&Psf::new(samples, options), Some(2))?;
    same_planes(&converted.model, "through 5 x 4 samples")
}

/// The planes agree with the file's in single precision, relative to the peak of the first plane.
fn same_planes(model: &psf_io::PsfexModel, how: &str) -> Result<(), Failed> {
    let original = psf_io::read_psfex(file(MODEL), None)?;
    ensure(model.planes().dim() == original.planes().dim(), || {
        format!("{how}: {:?}", model.planes().dim())
    })?;
    let peak = original
        .planes()
        .slice(s![0, .., ..])
        .iter()
        .fold(0.0f64, |m, v| m.max(v.abs()));
    let difference = &model.planes() - &original.planes();
    let largest = difference.iter().fold(0.0f64, |m, v| m.max(v.abs())) / peak;
    println!("psfex, {how}: planes differ by {largest:.2e} of the peak");
    ensure(largest <= STORED, || {
        format!("{how}: {largest:e}, at most {STORED:e}")
    })
}

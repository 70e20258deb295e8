//! Files of PSFs.

use psf_io::{
    HduChoice, PlaneOrder, Precision, PsfexModel, ScopesimOptions, StampCubeOptions, read_model_file,
    read_psfex, read_samples, read_scopesim, read_stamp_cube, read_stdpsf, read_stpsf, write_model,
    write_psfex, write_samples,
};
use psf_types::Position;

use super::case::Case;

/// Files in the format `psf-samples`.
pub fn samples(data: &[u8]) -> usize {
    let mut case = Case::new("samples", data);
    if let Some(samples) = case.read(|path| read_samples(path)) {
        case.comes_back(
            &samples,
            |path, samples| write_samples(path, samples, &[], Precision::Double, true),
            |path| read_samples(path),
        );
    }
    case.reads()
}

/// Files in the format `psf-model`.
pub fn model(data: &[u8]) -> usize {
    let mut case = Case::new("model", data);
    if let Some(file) = case.read(|path| read_model_file(path)) {
        let parts = (file.record().clone(), file.singular_values().to_vec());
        case.comes_back(
            &parts,
            |path, (record, values)| write_model(path, record, values, &[], true),
            |path| {
                let file = read_model_file(path)?;
                Ok((file.record().clone(), file.singular_values().to_vec()))
            },
        );
    }
    case.reads()
}

/// PSFEx models and their PSFs.
pub fn psfex(data: &[u8]) -> usize {
    let mut case = Case::new("psfex", data);
    case.read(|path| read_psfex(path, Some(&HduChoice::Number(1))));
    // The format stores single precision. Values that TZERO has shifted may need double precision.
    let is_single = |model: &PsfexModel| {
        model
            .planes()
            .iter()
            .all(|&value| f64::from(value as f32) == value)
    };
    if let Some(model) = case.read(|path| read_psfex(path, None)).filter(is_single) {
        case.comes_back(
            &model,
            |path, model| write_psfex(path, model, &[], true),
            |path| read_psfex(path, None),
        );
    }
    case.reads()
}

/// STPSF libraries.
pub fn stpsf(data: &[u8]) -> usize {
    let mut case = Case::new("stpsf", data);
    for order in [PlaneOrder::Auto, PlaneOrder::Cards, PlaneOrder::Sorted] {
        case.read(|path| read_stpsf(path, order));
    }
    case.reads()
}

/// STDPSF libraries.
pub fn stdpsf(data: &[u8]) -> usize {
    let mut case = Case::new("stdpsf", data);
    for detector in [None, Some(1), Some(2)] {
        case.read(|path| read_stdpsf(path, detector));
    }
    case.reads()
}

/// Field-varying PSFs of ScopeSim.
pub fn scopesim(data: &[u8]) -> usize {
    let mut case = Case::new("scopesim", data);
    let options = ScopesimOptions::new(0.25)
        .expect("a scale above 0")
        .with_field_centre(Position::of_pixel(5, 5));
    let at_wavelength = options.with_wavelength_um(1.5).expect("a wavelength above 0");
    for options in [options, at_wavelength] {
        case.read(|path| read_scopesim(path, &options));
    }
    case.reads()
}

/// Cubes of stamps, with and without positions.
pub fn stamp_cube(data: &[u8]) -> usize {
    let mut case = Case::new("stamp_cube", data);
    let positions = (0..3).map(|i| Position::of_pixel(10 * i, i * i)).collect();
    for options in [
        StampCubeOptions::default(),
        StampCubeOptions::default()
            .with_positions(positions)
            .with_oversampling(2.0)
            .with_centre(1.5, 1.0),
        StampCubeOptions::default().with_extension(HduChoice::Number(1)),
    ] {
        case.read(|path| read_stamp_cube(path, &options));
    }
    case.reads()
}

//! Images, plain and compressed, and their headers.

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;
use ndarray::Array2;
use psf_io::{Card, ImageReader, SkyCoordinates, detect, read_cube, read_header, read_image, read_positions};
use psf_types::Position;

use super::case::Case;

/// Images and cubes, read at once and by bands.
pub fn image(data: &[u8]) -> usize {
    let mut case = Case::new("image", data);
    case.read(|path| detect(path));
    case.read(|path| read_image::<f32>(path));
    case.read(|path| read_cube::<f64>(path));
    if let Some(header) = case.read(|path| read_header(path)) {
        for card in &header {
            drop((card.value(), card.comment_text(), card.to_string()));
        }
        drop(header.shifted_origin(3.0, 4.0));
    }
    whole_and_by_bands(&mut case);
    case.reads()
}

/// Checks that an image read at once can also be read by bands, with equal pixels.
fn whole_and_by_bands(case: &mut Case) {
    let whole = case.read(|path| read_image::<f64>(path));
    let bands = case.read(|path| {
        let mut reader = ImageReader::open(path)?;
        let (nx, ny) = (reader.shape().nx(), reader.shape().ny());
        // Reads the last rows first.
        let middle = ny / 2;
        let lower = reader.read_rows::<f64>(middle..ny)?;
        let upper = reader.read_rows::<f64>(0..middle)?;
        let rows = upper.into_iter().chain(lower).collect();
        Ok(Array2::from_shape_vec((ny, nx), rows).expect("all rows"))
    });
    match (&whole, &bands) {
        (Some(whole), Some(bands)) => assert_eq!(whole.image().pixels(), bands),
        (None, None) => {}
        _ => panic!(
            "the ways to read disagree: at once {}, by bands {}",
            whole.is_some(),
            bands.is_some()
        ),
    }
}

/// Images compressed by tiles.
pub fn compressed(data: &[u8]) -> usize {
    let mut case = Case::new("compressed", data);
    case.read(|path| detect(path));
    case.read(|path| read_image::<f32>(path));
    case.read(|path| read_cube::<f64>(path));
    whole_and_by_bands(&mut case);
    case.reads()
}

/// Files compressed as a whole. Damaged gzip is read unchanged, and other data are compressed
/// first.
pub fn gzip(data: &[u8]) -> usize {
    let mut case = if data.starts_with(&[0x1f, 0x8b]) {
        Case::new("gzip", data)
    } else {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(data).expect("writing to a Vec cannot fail");
        Case::new("gzip", &encoder.finish().expect("writing to a Vec cannot fail"))
    };
    case.read(|path| detect(path));
    case.read(|path| read_header(path));
    case.read(|path| read_image::<f32>(path));
    case.read(|path| read_positions(path));
    whole_and_by_bands(&mut case);
    case.reads()
}

/// World coordinates of any header.
pub fn sky(data: &[u8]) -> usize {
    let mut case = Case::new("sky", data);
    let Some(header) = case.read(|path| read_header(path)) else {
        return case.reads();
    };
    let shifted = header.shifted_origin(-3.0, 1e12);
    for header in [header, shifted] {
        let Ok(sky) = SkyCoordinates::from_header(&header) else {
            continue;
        };
        let crpix = ["CRPIX1", "CRPIX2"].map(|keyword| match header.get(keyword).and_then(Card::value) {
            Some(psf_io::CardValue::Real(value)) => value,
            Some(psf_io::CardValue::Integer(value)) => value as f64,
            _ => 0.0,
        });
        let near = (0..9).map(|i| {
            (
                crpix[0] + f64::from(i % 3) - 2.0,
                crpix[1] + f64::from(i / 3) * 100.0,
            )
        });
        for (x, y) in near.chain([(0.0, 0.0), (1e3, -1e3), (1e15, 1e300)]) {
            let Ok(position) = Position::new(x, y) else {
                continue;
            };
            let place = crate::limits::within_limits(|| sky.sky(position));
            let Some((longitude, latitude)) = place else {
                continue;
            };
            assert!(
                longitude.is_finite() && latitude.abs() <= 90.0,
                "{position} lies at {longitude}, {latitude}"
            );
            crate::limits::within_limits(|| sky.pixel(longitude, latitude));
        }
        for (longitude, latitude) in [
            (0.0, 90.0),
            (180.0, -90.0),
            (-1e9, 12.0),
            (f64::NAN, 0.0),
            (1.0, 1e300),
        ] {
            crate::limits::within_limits(|| sky.pixel(longitude, latitude));
        }
    }
    case.reads() + 1
}

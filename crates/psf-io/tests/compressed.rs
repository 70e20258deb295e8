//! Files compressed by gzip, and images compressed in tiles.

mod support;

use std::io::Write;
use std::path::{Path, PathBuf};

use fitsio::FitsFile;
use fitsio::images::{ImageDescription, ImageType, WriteImage};
use flate2::Compression;
use flate2::write::GzEncoder;
use ndarray::{Array2, s};
use psf_io::{
    Card, CatalogOptions, FileKind, ImageReader, IoError, IoErrorKind, Place, Precision, detect,
    read_catalog, read_header, read_image, read_image_hdu, read_positions_with, read_samples, write_samples,
};
use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
use support::{IMAGE, SIMPLE, Scratch, assert_error, chain, f32s, f64s, i16s, image, names, table};

/// Quantised floats have a step of sigma / 16, where sigma is the noise.
const STEPS_PER_SIGMA: f64 = 16.0;
const NX: usize = 70;
const NY: usize = 60;

/// The beginning of the message about damaged gzip data.
const BAD_GZIP: &str = "the gzip data are damaged or cut short after";

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn pixels(path: &Path) -> Result<Array2<f64>, IoError> {
    read_image::<f64>(path).map(|read| read.into_parts().0.into_pixels())
}

/// Small whole numbers without a repeating pattern.
fn counts() -> Vec<i32> {
    let mut state = 12345_u32;
    (0..NX * NY)
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as i32
        })
        .collect()
}

/// Writes an image in tiles through CFITSIO, with the options `how` of its extended file names.
fn tiled<T: WriteImage>(path: &Path, how: &str, data_type: ImageType, values: &[T]) -> PathBuf {
    let description = ImageDescription {
        data_type,
        dimensions: &[NY, NX],
    };
    let name = format!("{}[compress {how}]", path.display());
    let mut file = FitsFile::create(name)
        .with_custom_primary(&description)
        .open()
        .unwrap();
    let hdu = file.hdu(1).unwrap();
    hdu.write_key(&mut file, "OBJECT", "M31").unwrap();
    hdu.write_key(&mut file, "CRPIX1", 5.5).unwrap();
    hdu.write_image(&mut file, values).unwrap();
    path.to_owned()
}

#[test]
fn whole_numbers_in_tiles_are_read_back() {
    let scratch = Scratch::new();
    let values = counts();
    let expected = Array2::from_shape_vec((NY, NX), values.iter().map(|&v| f64::from(v)).collect()).unwrap();
    for how in ["R", "R 30,20", "G", "GZ2", "P", "R 70,60"] {
        let path = tiled(
            &scratch.path(&format!("{how}.fits")),
            how,
            ImageType::Long,
            &values,
        );
        assert!(
            std::fs::read(&path).unwrap().windows(8).any(|w| w == b"ZCMPTYPE"),
            "{how} compresses"
        );
        assert_eq!(pixels(&path).unwrap(), expected, "{how}");
        assert_eq!(detect(&path).unwrap(), FileKind::Image);
        let header = read_header(&path).unwrap();
        let keywords: Vec<String> = header.iter().map(Card::keyword).collect();
        // The crate fitsio has added EXTNAME.
        assert_eq!(keywords, ["EXTNAME", "OBJECT", "CRPIX1"], "{how}");
        let mut reader = ImageReader::open(&path).unwrap();
        for first in [50, 0, 7] {
            let band = reader.read_rows::<f64>(first..first + 10).unwrap();
            assert_eq!(
                band,
                expected.slice(s![first..first + 10, ..]),
                "{how}, rows from {first}"
            );
        }
    }
}

#[test]
fn quantised_floats_are_read_back_within_a_step() {
    let scratch = Scratch::new();
    // The pixels are uniform from 0 to 256. CFITSIO's noise estimate is below twice the true sigma.
    let largest_step = 2.0 * 256.0 / 12.0_f64.sqrt() / STEPS_PER_SIGMA;
    let values: Vec<f32> = counts().iter().map(|&v| v as f32 + 0.25).collect();
    for how in ["R; q 16", "G; q 16"] {
        let path = tiled(
            &scratch.path(&format!("{how}.fits")),
            how,
            ImageType::Float,
            &values,
        );
        let read = pixels(&path).unwrap();
        let error = read
            .iter()
            .zip(&values)
            .map(|(a, &b)| (a - f64::from(b)).abs())
            .fold(0.0, f64::max);
        assert!(error > 0.0 && error <= largest_step, "{how}: {error}");
    }
    let path = tiled(&scratch.path("exact.fits"), "G; q 0", ImageType::Float, &values);
    assert!(
        pixels(&path)
            .unwrap()
            .iter()
            .zip(&values)
            .all(|(a, &b)| *a == f64::from(b))
    );
}

#[test]
fn undefined_pixels_in_tiles_are_refused() {
    let scratch = Scratch::new();
    let mut values: Vec<f32> = counts().iter().map(|&v| v as f32 + 0.25).collect();
    values[3 * NX + 4] = f32::NAN;
    let exact = tiled(&scratch.path("exact.fits"), "G; q 0", ImageType::Float, &values);
    // One pixel and one row of 40 are undefined. The first file stores them as NaN, the other as a
    // special number among the quantised values.
    let quantised = scratch.put("quantised.fits.gz", include_bytes!("data/quantised_nan.fits.gz"));
    for (path, expected) in [(exact, 1), (quantised, 41)] {
        let first =
            format!(", pixel [3, 4] (0-based, x last): the value is NaN. Among the pixels read, {expected} ");
        assert_error(pixels(&path), IoErrorKind::Data, &first);
    }
}

#[test]
fn broken_tiles_are_errors() {
    let scratch = Scratch::new();
    let path = tiled(&scratch.path("a.fits"), "R", ImageType::Long, &counts());
    let good = std::fs::read(&path).unwrap();
    let forged = |from: &str, to: &str| {
        let mut bytes = good.clone();
        let at = bytes
            .windows(from.len())
            .position(|w| w == from.as_bytes())
            .expect(from);
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        let path = scratch.put("forged.fits", &bytes);
        let error = pixels(&path).unwrap_err();
        assert!(names(&error, &path), "{error}");
        error
    };
    let number = |keyword: &str, value: &str| format!("{keyword:<8}= {value:>20}");
    for (keyword, from, to) in [
        ("ZNAXIS1", "70", "2000000000"),
        ("ZNAXIS2", "60", "61"),
        ("ZNAXIS2", "60", "0"),
        ("ZTILE1", "70", "-1"),
        ("ZTILE2", "1", "2000000000"),
        ("ZBITPIX", "32", "33"),
        ("ZNAXIS", "2", "7"),
        ("ZVAL1", "32", "0"),
        ("ZVAL2", "4", "3"),
    ] {
        let error = forged(&number(keyword, from), &number(keyword, to));
        assert_eq!(error.kind(), IoErrorKind::Header, "{keyword} = {to}: {error}");
    }
    // CFITSIO reads the parameter by its number, and so takes it for another parameter.
    let keyword = |keyword: &str| Place::Keyword {
        hdu: 1,
        keyword: keyword.to_owned(),
    };
    assert_eq!(
        forged("'BYTEPIX '", "'BLOCKSIZE'").place(),
        Some(&keyword("ZVAL2"))
    );
    // Parameters in the other order are recognised by their sizes.
    let mut bytes = good.clone();
    for (from, to) in [
        (number("ZVAL1", "32"), number("ZVAL1", "4")),
        (number("ZVAL2", "4"), number("ZVAL2", "32")),
        ("'BLOCKSIZE'".to_owned(), "'BYTEPIX  '".to_owned()),
    ] {
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes());
        let at = at.expect(&from);
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    }
    let at = bytes.windows(8).position(|w| w == b"ZNAME2  ").unwrap();
    bytes[at..at + 21].copy_from_slice(b"ZNAME2  = 'BLOCKSIZE'");
    assert_eq!(
        pixels(&scratch.put("swapped.fits", &bytes)).unwrap(),
        pixels(&path).unwrap()
    );
    assert_eq!(
        forged("'RICE_1  '", "'MAGIC_1 '").place(),
        Some(&keyword("ZCMPTYPE"))
    );
    let hcompress = tiled(&scratch.path("h.fits"), "H", ImageType::Long, &counts());
    assert!(chain(&pixels(&hcompress).unwrap_err()).contains("funpack"));
    // The heap of tiles is overwritten.
    let mut bytes = good.clone();
    let length = bytes.len();
    bytes[length - 4000..length - 3000].fill(0xff);
    let path = scratch.put("heap.fits", &bytes);
    if let Ok(read) = pixels(&path) {
        assert_ne!(read, pixels(&scratch.put("good.fits", &good)).unwrap());
    }
    let cut = scratch.put("cut.fits", &good[..length - 2880]);
    assert_error(pixels(&cut), IoErrorKind::Damaged, "the file is cut short");
}

#[test]
fn every_kind_of_file_is_read_through_gzip() {
    let scratch = Scratch::new();
    let plain = image(
        SIMPLE,
        -32,
        &[3, 2],
        &["OBJECT  = 'M31'"],
        &f32s(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
    );
    let path = scratch.put("named-otherwise.fits", &gzip(&plain));
    assert_eq!(pixels(&path).unwrap()[[1, 2]], 6.0);
    assert_eq!(read_header(&path).unwrap().len(), 1);
    assert_eq!(detect(&path).unwrap(), FileKind::Image);
    let mut reader = ImageReader::open(&path).unwrap();
    assert_eq!(reader.read_rows::<f32>(1..2).unwrap()[[0, 0]], 4.0);
    // Several members in one file, and data after the last HDU.
    let mut members = gzip(&plain[..1000]);
    members.extend(gzip(&[&plain[1000..], b"left over"].concat()));
    assert_eq!(
        pixels(&scratch.put("members.fits.gz", &members)).unwrap()[[0, 1]],
        2.0
    );

    let mut stars = image(SIMPLE, 8, &[], &[], &[]);
    stars.extend(image(IMAGE, 16, &[2, 1], &["EXTNAME = 'SCI'"], &i16s(&[1, 2])));
    stars.extend(table(
        "T",
        &[("x", "D"), ("y", "D"), ("flux", "D")],
        1,
        &[],
        &f64s(&[1.5, 2.5, 3.5]),
    ));
    let path = scratch.put("stars.gz", &gzip(&stars));
    assert_eq!(read_catalog(&path).unwrap()[0].flux(), 3.5);
    assert_eq!(
        read_positions_with(&path, &CatalogOptions::new()).unwrap()[0].y(),
        2.5
    );
    let image = read_image_hdu::<f32>(&path, Some(&"SCI".parse().unwrap())).unwrap();
    assert_eq!(image.image().pixels()[[0, 1]], 2.0);

    let positions = SamplePositions::new(vec![Position::of_pixel(1, 2)], None).unwrap();
    let grid = StampGrid::new(3, 3).unwrap();
    let samples = PsfSamples::new(ndarray::Array3::from_elem((1, 3, 3), 0.1), positions, grid).unwrap();
    let path = scratch.path("samples.fits");
    write_samples(&path, &samples, &[], Precision::Double, false).unwrap();
    let path = scratch.put("samples.fits.gz", &gzip(&std::fs::read(&path).unwrap()));
    assert_eq!(read_samples(&path).unwrap(), samples);
}

#[test]
fn broken_gzip_files_are_errors() {
    let scratch = Scratch::new();
    let good = gzip(&image(SIMPLE, 32, &[NX, NY], &[], &support::i32s(&counts())));
    for length in (2..good.len()).step_by(97) {
        let path = scratch.put("cut.fits.gz", &good[..length]);
        let error = pixels(&path).unwrap_err();
        assert!(names(&error, &path), "{length}: {error}");
        assert_error(Err::<(), _>(error), IoErrorKind::Damaged, BAD_GZIP);
    }
    let mut damaged = good.clone();
    let last = damaged.len() - 6;
    damaged[last] ^= 1; // the check sum
    assert_error(
        pixels(&scratch.put("sum.gz", &damaged)),
        IoErrorKind::Damaged,
        BAD_GZIP,
    );
    // The gzip data are sound, but the FITS file in them is cut short.
    let plain = image(SIMPLE, 32, &[NX, NY], &[], &support::i32s(&counts()));
    let path = scratch.put("short.gz", &gzip(&plain[..plain.len() - 2880]));
    let (needed, length) = (plain.len(), plain.len() - 2880);
    let cut =
        format!("HDU 0: the file is cut short: at least {needed} bytes are needed, but there are {length}.");
    assert_error(pixels(&path), IoErrorKind::Damaged, &cut);
    let path = scratch.put("text.csv.gz", &gzip(b"x,y,flux\n1,2,3\n"));
    assert!(chain(&read_catalog(&path).unwrap_err()).contains("gunzip"));
}

#[test]
fn small_gzip_files_cannot_fill_the_disk() {
    let scratch = Scratch::new();
    // The header claims 4 TB, none of which exist.
    let header = image(SIMPLE, -64, &[1_000_000, 500_000], &[], &[]);
    let packed = gzip(&header[..2880]);
    let (length, allowed) = (packed.len(), (1 << 30) + 100 * packed.len());
    assert!(length < 1000);
    let text = format!("{length} bytes of gzip data would unpack to more than {allowed} bytes:");
    assert_error(
        pixels(&scratch.put("claim.gz", &packed)),
        IoErrorKind::Limit,
        &text,
    );
    // 1.5 GB of zeros after a small image, in 1.5 MB.
    let small = image(SIMPLE, 8, &[2, 1], &[], &[1, 2]);
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&small).unwrap();
    let zeros = vec![0; 1 << 20];
    for _ in 0..1500 {
        encoder.write_all(&zeros).unwrap();
    }
    let path = scratch.put("tail.gz", &encoder.finish().unwrap());
    assert!(std::fs::metadata(&path).unwrap().len() < 10 << 20);
    assert_error(pixels(&path), IoErrorKind::Limit, "would unpack to more than");
}

#[test]
fn no_copy_is_left_behind() {
    let scratch = Scratch::new();
    let copies = || {
        let folder = std::fs::read_dir(std::env::temp_dir()).unwrap();
        let of_here = |name: &str| {
            name.starts_with("psfield-") && Path::new(name).extension().is_some_and(|e| e == "fits")
        };
        folder
            .flatten()
            .filter(|entry| of_here(&entry.file_name().to_string_lossy()))
            .filter_map(|entry| entry.metadata().ok())
            // Other tests run at the same time, but none of them makes a file of this size.
            .filter(|found| found.len() == 2880 * 14)
            .count()
    };
    let plain = image(SIMPLE, 8, &[37000, 1], &[], &vec![7; 37000]);
    assert_eq!(plain.len(), 2880 * 14);
    let path = scratch.put("a.fits.gz", &gzip(&plain));
    let reader = ImageReader::open(&path).unwrap();
    assert_eq!(copies(), 1, "the reader reads from a copy");
    drop(reader);
    assert_eq!(copies(), 0);
    pixels(&path).unwrap();
    detect(&path).unwrap();
    assert_eq!(copies(), 0);
}

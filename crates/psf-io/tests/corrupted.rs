//! For any bytes in a file, reading returns a value or an error: no panic, no hang, no unbounded
//! memory.

mod support;

use std::path::Path;

use fitsio::FitsFile;
use fitsio::images::{ImageDescription, ImageType};

use ndarray::{Array2, Array3, array};
use psf_io::{
    Card, HeaderCards, IoError, IoErrorKind, PlaneOrder, Precision, PsfexAxis, PsfexModel, PsfexPolynomial,
    ScopesimOptions, StampCubeOptions, detect, read_catalog, read_cube, read_header, read_image,
    read_model_file, read_positions, read_psfex, read_samples, read_scopesim, read_stamp_cube, read_stdpsf,
    read_stpsf, write_image, write_model, write_psfex, write_samples,
};
use psf_types::{
    FrameShape, Image, Interpolation, Normalisation, OutsidePolicy, Position, PsfBasis, PsfModelRecord,
    PsfSamples, SampleCoefficients, SamplePositions, StampGrid,
};
use support::{SIMPLE, Scratch, assert_error, i16s, image, libraries, table};

fn positions() -> SamplePositions {
    let positions = (0..3).map(|i| Position::of_pixel(i, 2 * i)).collect();
    SamplePositions::new(positions, FrameShape::new(10, 10).ok()).unwrap()
}

/// One small file of every kind.
fn files(scratch: &Scratch) -> Vec<Vec<u8>> {
    let path = scratch.path("good.fits");
    let mut files = Vec::new();
    let mut keep = |written: Result<(), IoError>| {
        written.unwrap();
        files.push(std::fs::read(&path).unwrap());
    };
    let cards = [
        Card::new("LONG", "text ".repeat(40), "").unwrap(),
        Card::new("CRPIX1", 3.5, "").unwrap(),
    ];
    let pixels = Array2::from_shape_fn((9, 11), |(y, x)| (x * y) as f32);
    keep(write_image(
        &path,
        &Image::new(pixels).unwrap(),
        &HeaderCards::new(),
        &cards,
        true,
    ));
    let grid = StampGrid::new(4, 4).unwrap();
    let samples = PsfSamples::new(Array3::from_elem((3, 4, 4), 0.1), positions(), grid).unwrap();
    keep(write_samples(&path, &samples, &[], Precision::Double, true));
    let mut components = Array3::zeros((1, 4, 4));
    components[[0, 1, 1]] = 1.0;
    let record = PsfModelRecord::new(
        PsfBasis::new(Some(Array2::from_elem((4, 4), 0.1)), components, grid).unwrap(),
        SampleCoefficients::new(array![[0.1], [0.2], [0.3]], positions()).unwrap(),
        Interpolation::Bilinear,
        OutsidePolicy::Nearest,
        Normalisation::Unit,
    );
    keep(write_model(&path, &record.unwrap(), &[1.0, 0.5], &[], true));
    let scaled = ["BSCALE  = 2.0", "BZERO   = 32768", "BLANK   = -5"];
    files.push(image(SIMPLE, 16, &[3, 4], &scaled, &i16s(&[1; 12])));
    let mut stars = image(SIMPLE, 8, &[], &["EXTEND  = T"], &[]);
    stars.extend(table(
        "T",
        &[("x", "I"), ("y", "I"), ("flux", "I")],
        3,
        &["TNULL1  = 7", "TZERO2  = 1.5"],
        &i16s(&[1; 9]),
    ));
    files.push(stars);
    files.extend([
        libraries::stpsf(&[]),
        libraries::stdpsf(3, 2),
        libraries::scopesim(),
    ]);
    let axis = |name| PsfexAxis::new(name, 4.5, 9.0).unwrap();
    let polynomial = PsfexPolynomial::new(axis("X_IMAGE"), axis("Y_IMAGE"), 1).unwrap();
    let psfex = PsfexModel::new(Array3::from_elem((3, 4, 4), 0.1), 0.5, Some(polynomial)).unwrap();
    write_psfex(&path, &psfex, &[], true).unwrap();
    files.push(std::fs::read(&path).unwrap());
    for (how, scale) in [("R", 1.0), ("G", 1.0), ("GZ2", 1.0), ("P", 1.0), ("R; q 16", 1.3)] {
        files.push(tiled(scratch, how, scale));
    }
    files.push(b"# stars\nx,y,flux\n1,2,3\n4,\"5\",6e3\n".to_vec());
    files
}

fn scopesim_options() -> ScopesimOptions {
    let options = ScopesimOptions::new(0.25)
        .unwrap()
        .with_field_centre(Position::of_pixel(5, 5));
    options.with_wavelength_um(1.5).unwrap()
}

/// An image in tiles. Its values are whole numbers unless `scale` changes them.
fn tiled(scratch: &Scratch, how: &str, scale: f32) -> Vec<u8> {
    let path = scratch.path(&format!("{how}.fits"));
    std::fs::remove_file(&path).ok();
    let name = format!("{}[compress {how}]", path.display());
    let whole = scale.fract() == 0.0;
    let description = ImageDescription {
        data_type: if whole { ImageType::Long } else { ImageType::Float },
        dimensions: &[10, 12],
    };
    let mut file = FitsFile::create(name)
        .with_custom_primary(&description)
        .open()
        .unwrap();
    let hdu = file.hdu(1).unwrap();
    let values: Vec<f32> = (0..120).map(|i| ((i * i) % 97) as f32 * scale).collect();
    hdu.write_image(&mut file, &values).unwrap();
    drop(file);
    std::fs::read(path).unwrap()
}

/// Reads a file in every way and returns the number of successes. Each error must have a text that
/// names the file.
fn read_all(path: &Path) -> usize {
    let outcomes = [
        detect(path).map(drop),
        read_image::<f32>(path).map(|read| drop(read.header().shifted_origin(3.0, 4.0))),
        read_image::<f64>(path).map(drop),
        read_cube::<f64>(path).map(drop),
        read_header(path).map(|header| {
            header
                .iter()
                .for_each(|card| drop((card.value(), card.comment_text(), card.to_string())));
        }),
        read_samples(path).map(drop),
        read_model_file(path).map(drop),
        read_catalog(path).map(drop),
        read_positions(path).map(drop),
        read_stpsf(path, PlaneOrder::Auto).map(drop),
        read_stdpsf(path, None).map(drop),
        read_scopesim(path, &scopesim_options()).map(drop),
        read_psfex(path, None).map(drop),
        read_stamp_cube(path, &StampCubeOptions::default()).map(drop),
    ];
    for error in outcomes.iter().filter_map(|outcome| outcome.as_ref().err()) {
        assert!(support::names(error, path), "{error}");
        assert!(!support::chain(error).is_empty());
    }
    outcomes.iter().filter(|outcome| outcome.is_ok()).count()
}

#[test]
fn files_cut_short_are_errors() {
    let scratch = Scratch::new();
    for (kind, good) in files(&scratch).iter().enumerate() {
        let whole = read_all(&scratch.put("whole", good));
        assert!(whole >= 2, "kind {kind} reads in {whole} ways");
        for length in (0..good.len()).step_by(2880 / 7) {
            read_all(&scratch.put("cut", &good[..length]));
        }
    }
}

#[test]
fn the_error_for_a_cut_file_says_that_it_is_cut() {
    let scratch = Scratch::new();
    let good = image(SIMPLE, 16, &[60, 70], &[], &i16s(&[1; 4200]));
    for length in [1, 2879, 2880, 2881, 5000, 2880 + 8399] {
        let path = scratch.put("cut", &good[..length]);
        let (kind, part) = if length == 1 {
            (IoErrorKind::Format, "not a FITS file".to_owned())
        } else {
            (
                IoErrorKind::Damaged,
                format!(": HDU 0: the file is cut short: ... there are {length}."),
            )
        };
        let (start, end) = part.split_once("...").unwrap_or((&part, ""));
        for part in [start, end] {
            assert_error(read_image::<f32>(&path), kind, part);
        }
    }
    // The file is cut in its second HDU.
    let path = scratch.path("samples");
    let samples = files(&scratch).swap_remove(1);
    let table = samples.windows(8).position(|w| w == b"XTENSION").unwrap();
    for length in [table + 3, table + 100, table + 2880, table + 2880 + 10] {
        std::fs::write(&path, &samples[..length]).unwrap();
        assert_error(
            read_samples(&path),
            IoErrorKind::Damaged,
            ": HDU 1: the file is cut short",
        );
    }
    std::fs::write(&path, &samples[..table]).unwrap();
    assert_error(
        read_samples(&path),
        IoErrorKind::Format,
        "the file has no binary table",
    );
}

/// Every `STRIDE`-th byte is changed in turn. The number is prime, so that all columns of the
/// records are changed.
const STRIDE: usize = 13;

#[test]
fn changed_bytes_do_no_harm() {
    let scratch = Scratch::new();
    for good in files(&scratch) {
        for (at, change) in (0..good.len())
            .step_by(STRIDE)
            .zip([0xff, 0x01, 0x80, 0x0f].into_iter().cycle())
        {
            let mut bad = good.clone();
            bad[at] ^= change;
            read_all(&scratch.put("bad", &bad));
        }
    }
}

#[test]
fn changed_numbers_in_headers_do_no_harm() {
    let scratch = Scratch::new();
    for good in files(&scratch) {
        let digits = (0..good.len()).filter(|&at| good[at].is_ascii_digit() && (at % 80) >= 10);
        for at in digits {
            for digit in *b"09-E'" {
                let mut bad = good.clone();
                bad[at] = digit;
                read_all(&scratch.put("bad", &bad));
            }
            let mut longer = good.clone();
            for place in longer
                .iter_mut()
                .skip(at)
                .take(18)
                .take_while(|b| **b == b' ' || b.is_ascii_digit())
            {
                *place = b'9';
            }
            read_all(&scratch.put("bad", &longer));
        }
    }
}

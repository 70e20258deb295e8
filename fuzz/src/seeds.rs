//! Small valid files, from which mutations start.

use std::io::Write;
use std::path::Path;

use fitsio::FitsFile;
use fitsio::images::{ImageDescription, ImageType};
use flate2::Compression;
use flate2::write::GzEncoder;
use ndarray::{Array2, Array3, array};
use psf_io::{
    Card, CardValue, HeaderCards, IoError, Precision, PsfexAxis, PsfexModel, PsfexPolynomial, write_gridded,
    write_image, write_model, write_psfex, write_samples,
};
use psf_types::{
    FrameShape, Image, Interpolation, Normalisation, OutsidePolicy, Position, PsfBasis, PsfModelRecord,
    PsfSamples, SampleCoefficients, SamplePositions, StampGrid,
};

use crate::support::{IMAGE, SIMPLE, f32s, f64s, i16s, i32s, i64s, image, libraries, table};

/// The bytes of a file that `write` makes.
fn written(write: impl FnOnce(&Path) -> Result<(), IoError>) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("seed");
    write(&path).expect("a valid seed");
    std::fs::read(path).expect("the file that was written")
}

fn primary() -> Vec<u8> {
    image(SIMPLE, 8, &[], &["EXTEND  = T"], &[])
}

/// Images of every type, scaled images, an image in an extension, and cubes.
pub fn images() -> Vec<Vec<u8>> {
    let pixels = Array2::from_shape_fn((9, 11), |(y, x)| (x * y) as f32);
    let cards = [
        Card::new("LONG", "text ".repeat(40), "").expect("a valid card"),
        Card::new("CRPIX1", 3.5, "").expect("a valid card"),
        Card::new("DATASEC", "[1:11,1:9]", "").expect("a valid card"),
    ];
    let image_of = Image::new(pixels).expect("finite pixels");
    let scaled = ["BSCALE  = 2.0", "BZERO   = 32768", "BLANK   = -5"];
    let mut second = primary();
    second.extend(image(IMAGE, 32, &[4, 3], &["EXTNAME = 'SCI'"], &i32s(&[7; 12])));
    second.extend(image(IMAGE, 8, &[4, 3], &["EXTNAME = 'DQ'"], &[1; 12]));
    vec![
        written(|path| write_image(path, &image_of, &HeaderCards::new(), &cards, true)),
        image(SIMPLE, 16, &[3, 4], &scaled, &i16s(&[1; 12])),
        image(SIMPLE, 64, &[3, 4, 1], &[], &i64s(&[1 << 40; 12])),
        image(SIMPLE, -64, &[3, 2, 4], &[], &f64s(&[0.25; 24])),
        image(SIMPLE, -32, &[5, 5, 1, 1], &[], &f32s(&[1e-40; 25])),
        // CFITSIO has room for 99 axes.
        image(SIMPLE, 8, &[1; 99], &[], &[7]),
        second,
    ]
}

/// Images compressed in tiles by several algorithms, with integers and with quantised floats.
pub fn tiled() -> Vec<Vec<u8>> {
    let whole = ["R", "G", "P", "R 5,4", "G 10,12", "P 10,12"].map(|how| tiles(how, 1.0));
    let floats = ["R; q 16", "G; q 4", "R; qz 8", "G 5,4; q 0"].map(|how| tiles(how, 1.3));
    whole.into_iter().chain(floats).collect()
}

/// An image that CFITSIO compresses in tiles, as `how` says in its syntax for file names.
fn tiles(how: &str, scale: f32) -> Vec<u8> {
    let whole = scale.fract() == 0.0;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("tiles.fits");
    let description = ImageDescription {
        data_type: if whole { ImageType::Long } else { ImageType::Float },
        dimensions: &[10, 12],
    };
    let mut file = FitsFile::create(format!("{}[compress {how}]", path.display()))
        .with_custom_primary(&description)
        .open()
        .expect("CFITSIO creates an image");
    let hdu = file.hdu(1).expect("the image is the second HDU");
    let values: Vec<f32> = (0..120).map(|i| ((i * i) % 97) as f32 * scale).collect();
    hdu.write_image(&mut file, &values)
        .expect("CFITSIO writes an image");
    drop(file);
    std::fs::read(path).expect("the file that was written")
}

/// FITS files, which the target compresses, and gzip files.
pub fn zipped() -> Vec<Vec<u8>> {
    let mut files = images();
    files.truncate(3);
    files.extend(catalogs().pop());
    let zipped: Vec<_> = files
        .iter()
        .map(|bytes| {
            let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(bytes).expect("writing to a Vec cannot fail");
            encoder.finish().expect("writing to a Vec cannot fail")
        })
        .collect();
    files.extend(zipped);
    files
}

fn positions(count: i64) -> SamplePositions {
    let positions = (0..count)
        .map(|i| Position::of_pixel(i % 2 * 7, i / 2 * 9))
        .collect();
    SamplePositions::new(positions, FrameShape::new(20, 20).ok()).expect("positions within the field")
}

fn few_samples(nx: usize) -> PsfSamples {
    let stamps = Array3::from_shape_fn((4, 5, nx), |(k, y, x)| 0.1 + (k * y) as f64 * 0.01 + x as f64);
    PsfSamples::new(stamps, positions(4), StampGrid::new(nx, 5).expect("a grid")).expect("valid samples")
}

/// Samples in both precisions.
pub fn samples() -> Vec<Vec<u8>> {
    [Precision::Double, Precision::Single]
        .map(|precision| written(|path| write_samples(path, &few_samples(4), &[], precision, true)))
        .into()
}

fn record(centred: bool, interpolation: Interpolation) -> PsfModelRecord {
    let grid = StampGrid::new(4, 4).expect("a grid");
    let mut components = Array3::zeros((2, 4, 4));
    components[[0, 1, 1]] = 1.0;
    components[[1, 2, 2]] = -1.0;
    let mean = centred.then(|| Array2::from_elem((4, 4), 0.1));
    let values = array![[0.1, 0.0], [0.2, -1.0], [0.3, 0.5], [1e-3, 2.0]];
    PsfModelRecord::new(
        PsfBasis::new(mean, components, grid).expect("an orthonormal basis"),
        SampleCoefficients::new(values, positions(4)).expect("finite coefficients"),
        interpolation,
        OutsidePolicy::Nearest,
        Normalisation::Unit,
    )
    .expect("a valid model")
}

/// Models with and without centring.
pub fn models() -> Vec<Vec<u8>> {
    let bilinear = record(true, Interpolation::Bilinear);
    let polynomial = record(false, "polynomial=1".parse().expect("an interpolation"));
    vec![
        written(|path| write_model(path, &bilinear, &[1.0, 0.5, 0.1], &[], true)),
        written(|path| write_model(path, &polynomial, &[], &[], true)),
    ]
}

/// A polynomial and a constant PSF.
pub fn psfex() -> Vec<Vec<u8>> {
    let axis = |name| PsfexAxis::new(name, 4.5, 9.0).expect("a valid axis");
    let polynomial = PsfexPolynomial::new(axis("X_IMAGE"), axis("Y_IMAGE"), 1).expect("degree 1");
    [(3, Some(polynomial)), (1, None)]
        .map(|(terms, polynomial)| {
            let planes = Array3::from_elem((terms, 4, 4), 0.125);
            let model = PsfexModel::new(planes, 0.5, polynomial).expect("a valid model");
            written(|path| write_psfex(path, &model, &[], true))
        })
        .into()
}

/// Libraries in WebbPSF's layout and by psfield's writer.
pub fn stpsf() -> Vec<Vec<u8>> {
    let later = ["VERSION = '1.3.0'", "FOVPIXEL= 5"];
    vec![
        libraries::stpsf(&[]),
        libraries::stpsf(&later),
        written(|path| write_gridded(path, &few_samples(5), &[], true).map(drop)),
    ]
}

/// A library of one detector, and one of several side by side.
pub fn stdpsf() -> Vec<Vec<u8>> {
    vec![
        libraries::stdpsf(3, 2),
        libraries::stdpsf(6, 6),
        libraries::stdpsf(1, 1),
    ]
}

/// One file with its map as an image, and one with its map as a table.
pub fn scopesim() -> Vec<Vec<u8>> {
    let rows = [[-1.0, 0.0, 0.0], [1.0, 0.5, 1.0], [0.0, 2.0, 2.0]];
    let rows: Vec<u8> = rows.iter().flat_map(|row| f64s(row)).collect();
    let columns = [("x", "D"), ("y", "D"), ("layer", "D")];
    let with_table = [
        libraries::scopesim_primary(),
        table("MAP", &columns, 3, &[], &rows),
        libraries::scopesim_kernels(3, 1.5),
    ];
    vec![libraries::scopesim(), with_table.concat()]
}

/// Cubes and single stamps.
pub fn stamp_cubes() -> Vec<Vec<u8>> {
    let cards = ["OVERSAMP= 2", "CENX    = 1.0", "CENY    = 1.5"];
    let mut second = primary();
    second.extend(image(IMAGE, -32, &[4, 3, 3], &cards, &f32s(&[0.5; 36])));
    vec![
        image(SIMPLE, -64, &[4, 4, 3], &cards, &f64s(&[0.0625; 48])),
        image(SIMPLE, -32, &[5, 3], &[], &f32s(&[0.2; 15])),
        second,
    ]
}

/// Text tables of several kinds, and FITS tables.
pub fn catalogs() -> Vec<Vec<u8>> {
    let texts = [
        "# stars\nx,y,flux\n1,2,3\n4,\"5\",6e3\n",
        "x y flux re n q angle\n1.5 2 100 3.0 4 0.5 30\n7 8 1e3 nan nan nan nan\n",
        "#   1 NUMBER   Running number\n#   2 X_IMAGE  Position [pixel]\n#   3 Y_IMAGE  Position [pixel]\n\
         #   4 FLUX_AUTO  Flux [count]\n 1 1.0 20.25 1234.5\n 2 512.5 7.0 -3e-1\n",
        "ra,dec,mag\n10.01,20.02,21.5\n9.99,19.97,18\n,,\n",
        "x\ty\tflux\n1\t2\t3\n",
        "x,y,flux,sed,vx,vy\n1,2,3,red.csv:nm@z=0.5,0.1,0\n4,5,6,blackbody:5000,0,0\n",
        "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: x, datatype: float64}\n# - {name: y, datatype: float64}\n\
         # - {name: flux, unit: mJy, datatype: float64}\n# - {name: note, datatype: string}\n# schema: astropy-2.0\n\
         x y flux note\n1.0 2.0 3.0 \"a note\"\n1.0 2.0 \"\" b\n",
    ];
    let mut integers = primary();
    let columns = [("x", "I"), ("y", "I"), ("flux", "I")];
    let nulls = ["TNULL1  = 7", "TZERO2  = 1.5"];
    integers.extend(table("T", &columns, 3, &nulls, &i16s(&[1; 9])));
    let mut mixed = primary();
    let columns = [
        ("NAME", "4A"),
        ("X_IMAGE", "D"),
        ("FLUX_AUTO", "E"),
        ("Y_IMAGE", "D"),
        ("V", "2E"),
    ];
    let row = [
        b"star".to_vec(),
        f64s(&[3.5]),
        f32s(&[10.0]),
        f64s(&[4.5]),
        f32s(&[1.0, 2.0]),
    ]
    .concat();
    mixed.extend(table("LDAC_OBJECTS", &columns, 2, &[], &row.repeat(2)));
    let mut coloured = primary();
    let columns = [("x", "D"), ("y", "D"), ("flux", "D"), ("SED", "14A")];
    let units = ["TUNIT1  = 'pix'", "TUNIT3  = 'Jy'"];
    let row = [f64s(&[1.0, 2.0, 3.0]), b"blackbody:4000".to_vec()].concat();
    coloured.extend(table("STARS", &columns, 2, &units, &row.repeat(2)));
    let mut all: Vec<Vec<u8>> = texts.iter().map(|text| text.as_bytes().to_vec()).collect();
    all.extend([mixed, integers, coloured]);
    all
}

/// Bandpasses and spectra, in text and in FITS.
pub fn curves() -> Vec<Vec<u8>> {
    let texts = [
        "wavelength_nm,throughput\n400,0\n450,0.5\n650,0.75\n700,0\n",
        "# wavelength [Angstrom]  transmission\n4000 0.0\n5000 0.5\n7000 0.25\n",
        "lambda_um,g,r\n0.4,0,0\n0.5,1,0\n0.7,0,1\n",
        "blackbody:5800@z=0.1\npowerlaw:-2\nsed.csv:nm:photons@z=1\n",
    ];
    let mut fits = primary();
    let columns = [("WAVELENGTH", "D"), ("THROUGHPUT", "D")];
    let units = ["TUNIT1  = 'nm'"];
    fits.extend(table(
        "BAND",
        &columns,
        3,
        &units,
        &f64s(&[400.0, 0.0, 500.0, 1.0, 600.0, 0.0]),
    ));
    let mut all: Vec<Vec<u8>> = texts.iter().map(|text| text.as_bytes().to_vec()).collect();
    all.push(fits);
    all
}

/// Images of one pixel with the headers of the comparison with astropy.
pub fn sky() -> Vec<Vec<u8>> {
    let cases = include_str!("../../crates/psf-io/tests/data/sky_coordinates.json");
    let cases: serde_json::Value = serde_json::from_str(cases).expect("valid JSON in the tests' data");
    let header = |case: &serde_json::Value| -> HeaderCards {
        let card = |(keyword, value): (&String, &serde_json::Value)| {
            let value: CardValue = match (value.as_str(), value.as_i64(), value.as_f64()) {
                (Some(text), ..) => text.into(),
                (_, Some(number), _) => number.into(),
                (.., number) => number.expect("a number").into(),
            };
            Card::new(keyword, value, "").expect("a valid card")
        };
        case["header"]
            .as_object()
            .expect("a header")
            .iter()
            .map(card)
            .collect()
    };
    let pixel = Image::new(Array2::<f32>::zeros((1, 1))).expect("finite pixels");
    let cases = cases.as_array().expect("a list of cases");
    cases
        .iter()
        .map(|case| written(|path| write_image(path, &pixel, &header(case), &[], true)))
        .collect()
}

/// A model and samples as JSON.
pub fn records() -> Vec<Vec<u8>> {
    let model = record(true, Interpolation::Bilinear);
    vec![
        serde_json::to_vec(&model).expect("a record can be written"),
        serde_json::to_vec(&few_samples(4)).expect("samples can be written"),
    ]
}

/// Descriptions of small telescopes.
pub fn telescopes() -> Vec<Vec<u8>> {
    let plain = r#"
wavelength_nm = 600.0
pixel_scale_arcsec = 0.1
frame = { nx = 64, ny = 48 }
stamp = { nx = 16, ny = 16, oversampling = 1, padding = 2.0 }

[aperture]
diameter_m = 2.0
obscuration = 0.3
spider = { vanes = 4, width_m = 0.05, angle_deg = 45.0 }

[wavefront]
unit = "nm"

[[wavefront.modes]]
noll = 4
terms = [{ value = 20.0 }, { x = 1, value = 5.0 }, { x = 1, y = 2, value = -3.0 }]

[detector]
pixel_integration = true
blur_sigma_px = 0.2
"#;
    let seeing = r#"
name = "ground"
wavelength_nm = 500.0
pixel_scale_arcsec = 0.25
frame = { nx = 32, ny = 32 }
stamp = { nx = 12, ny = 12 }
aperture = { diameter_m = 1.0 }
seeing = { fwhm_arcsec = 0.8, at_wavelength_nm = 500.0, outer_scale_m = 20.0 }
"#;
    [plain, seeing].map(|text| text.as_bytes().to_vec()).into()
}

/// Descriptions of detectors.
pub fn detectors() -> Vec<Vec<u8>> {
    let text = "photon_noise = true\nexposure_s = 100.0\ndark_e_per_s = 0.5\nfull_well_e = 60000.0\nread_noise_e = 4.0\n";
    vec![text.as_bytes().to_vec()]
}

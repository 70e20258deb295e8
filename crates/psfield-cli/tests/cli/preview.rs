//! `psfield preview`.

use std::process::Command;

use ndarray::{Array2, Array3};
use psfield::psf_io;

use crate::desk::{Desk, NX, NY, assert_keys};

/// Bytes of a FITS block, and of the header of `pixels.fits`.
const BLOCK: usize = 2880;

/// A FITS file of one HDU with these cards.
fn fits(cards: &[&str], data: impl IntoIterator<Item = u8>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for card in cards.iter().chain(&["END"]) {
        bytes.extend(format!("{card:<80}").bytes());
    }
    bytes.resize(bytes.len().next_multiple_of(BLOCK), b' ');
    bytes.extend(data);
    bytes.resize(bytes.len().next_multiple_of(BLOCK), 0);
    bytes
}

/// A FITS image of floats with 3 columns.
fn of_floats(values: &[f32]) -> Vec<u8> {
    let rows = format!("NAXIS2  = {}", values.len() / 3);
    let cards = [
        "SIMPLE  = T",
        "BITPIX  = -32",
        "NAXIS   = 2",
        "NAXIS1  = 3",
        &rows,
    ];
    fits(&cards, values.iter().flat_map(|v| v.to_be_bytes()))
}

fn png(desk: &Desk, name: &str) -> image::DynamicImage {
    image::load_from_memory_with_format(&desk.bytes(name), image::ImageFormat::Png).unwrap()
}

#[test]
fn an_image_becomes_a_picture() {
    let desk = Desk::new();
    let run = desk.done("preview scene.fits");
    assert!(
        run.stdout.starts_with("scene.png: 61 x 51 pixels, asinh from "),
        "{run:?}"
    );
    let picture = png(&desk, "scene.png");
    assert_eq!((picture.width() as usize, picture.height() as usize), (NX, NY));
    assert!(picture.as_luma8().is_some());
    desk.refused("preview scene.fits", 1, &["scene.png", "--overwrite"]);
    desk.refused(
        "preview scene.fits -o scene.fits --overwrite",
        2,
        &["scene.fits", "also an input"],
    );

    let report = desk
        .done("preview scene.fits --max-size 20 --colormap viridis --zscale -o v.png --json")
        .json();
    assert_keys(
        &report,
        &["output", "limits", "stretch", "colormap", "undefined_pixels"],
    );
    assert_eq!(report["binning"], 4);
    assert_eq!(report["picture_size"], serde_json::json!([16, 13]));
    assert!(png(&desk, "v.png").as_rgb8().is_some());
}

#[test]
fn values_are_where_they_belong() {
    let desk = Desk::empty();
    desk.write(
        "a.fits",
        of_floats(&[0.0, 5.0, 10.0, f32::NAN, f32::INFINITY, -4.0]),
    );
    let run = desk.done("preview a.fits --stretch linear --range 0,10");
    assert!(
        run.stdout
            .contains("linear from 0 to 10, 2 pixels without a value"),
        "{run:?}"
    );
    let (magenta, grey) = ([255, 0, 255], |v: u8| [v; 3]);
    let picture = png(&desk, "a.png");
    let pixels: Vec<[u8; 3]> = picture.as_rgb8().unwrap().pixels().map(|p| p.0).collect();
    // Row 0 is the last of the file.
    assert_eq!(pixels, [magenta, magenta, grey(0), grey(0), grey(128), grey(255)]);
    // Whole numbers with BLANK.
    let cards = [
        "SIMPLE  = T",
        "BITPIX  = 8",
        "NAXIS   = 2",
        "NAXIS1  = 3",
        "NAXIS2  = 1",
        "BLANK   = 7",
    ];
    desk.write("b.fits", fits(&cards, [0, 7, 9]));
    desk.done("preview b.fits --percentile 0,100 --stretch linear");
    let picture = png(&desk, "b.png");
    let pixels: Vec<[u8; 3]> = picture.as_rgb8().unwrap().pixels().map(|p| p.0).collect();
    assert_eq!(pixels, [grey(0), magenta, grey(255)]);
    // Tiny limits are shown without rows of zeros.
    let run = desk.done("preview a.fits --range -6.795561e-16,10 -o e.png");
    assert!(run.stdout.contains("from -6.79556e-16 to 10,"), "{run:?}");
    // A negative limit is not read as an option.
    desk.done("preview a.fits --range -1.5,10 -o c.png");
    desk.done("preview a.fits --range=-1.5,-1 -o d.png");
}

#[test]
fn planes_and_compressed_files() {
    let desk = Desk::new();
    let cube = Array3::from_shape_fn((3, 5, 7), |(k, y, x)| if k == 1 { (x + y) as f64 } else { 4.0 });
    psf_io::write_cube(desk.path("cube.fits"), cube.view(), &[], false).unwrap();
    desk.done("preview cube.fits --plane 1 --percentile 0,100 --stretch linear");
    let picture = png(&desk, "cube.png");
    let grey = picture.as_luma8().unwrap();
    assert_eq!((grey.get_pixel(0, 4)[0], grey.get_pixel(6, 0)[0]), (0, 255));
    for (arguments, needles) in [
        ("cube.fits", ["the axes are [3, ", "--plane"]),
        ("cube.fits --plane 3", ["no plane 3", "has 3"]),
        ("cube.fits --plane 0", ["every finite pixel is 4", "--range"]),
        ("cube.fits --plane 1 --extension 2", ["cube.fits", "HDU 2"]),
        ("scene.fits --plane 1", ["no plane 1", "has 1"]),
    ] {
        desk.refused(&format!("preview {arguments} -o no.png"), 1, &needles);
    }
    let zipped = Command::new("gzip")
        .arg("-k")
        .arg(desk.path("scene.fits"))
        .status();
    if zipped.is_ok_and(|status| status.success()) {
        desk.done("preview scene.fits.gz");
        desk.done("preview scene.fits -o plain.png");
        assert_eq!(desk.bytes("scene.png"), desk.bytes("plain.png"));
    }
}

#[test]
fn what_cannot_be_shown_is_said() {
    let desk = Desk::new();
    desk.write("nan.fits", of_floats(&[f32::NAN; 6]));
    desk.write_image("flat.fits", Array2::from_elem((20, 30), 7.5));
    let mut star = Array2::zeros((200, 300));
    star[[3, 4]] = 9.0;
    desk.write_image("star.fits", star);
    for (arguments, code, needles) in [
        ("nan.fits", 1, ["nan.fits", "none of the 6 pixels"]),
        ("flat.fits", 1, ["flat.fits", "finite pixel is 7.5"]),
        ("flat.fits --zscale", 1, ["flat.fits", "finite pixel is 7.5"]),
        ("star.fits", 1, ["0.5 and 99.8", "from 0 to 9"]),
        ("scene.fits --range 3,3", 2, ["--range", "not a range"]),
        ("scene.fits --range 3", 2, ["--range", "LO,HI"]),
        ("scene.fits --range nan,3", 2, ["--range", "finite"]),
        ("scene.fits --percentile 50,101", 2, ["--percentile", "0 to 100"]),
        ("scene.fits --percentile -1,99", 2, ["--percentile", "0 to 100"]),
        (
            "scene.fits --percentile 1,99 --zscale",
            2,
            ["--percentile", "--zscale"],
        ),
        ("scene.fits --range 0,1 --zscale", 2, ["--range", "--zscale"]),
        ("scene.fits --stretch power", 2, ["power", "asinh"]),
        ("scene.fits --colormap jet", 2, ["jet", "viridis"]),
        ("scene.fits --max-size 0", 2, ["--max-size", "0"]),
    ] {
        desk.refused(&format!("preview {arguments} -o no.png"), code, &needles);
    }
    desk.refused("preview scene.fits -o scene.jpg", 2, &["scene.jpg", ".png"]);
    // An image of one value has a picture if limits are given.
    desk.done("preview flat.fits --range 0,10");
    desk.done("preview star.fits --percentile 0,100");
}

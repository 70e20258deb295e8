//! Reading images.

mod support;

use ndarray::{Array2, array};
use psf_io::{
    Card, HduChoice, HeaderCards, IoError, IoErrorKind, Place, read_cards, read_cube, read_header,
    read_header_hdu, read_image, read_image_hdu,
};
use support::{IMAGE, SIMPLE, Scratch, assert_error, chain, f32s, f64s, hdu, i16s, i32s, i64s, image, names};

fn pixels(path: &std::path::Path) -> Result<Array2<f64>, IoError> {
    read_image::<f64>(path).map(|read| read.into_parts().0.into_pixels())
}

#[test]
fn every_bitpix_is_read() {
    let scratch = Scratch::new();
    let expected = array![[1.0, 2.0, 3.0], [4.0, 5.0, 100.0]];
    let values = [1, 2, 3, 4, 5, 100];
    let files = [
        (8, values.map(|v: i32| v as u8).to_vec()),
        (16, i16s(&values.map(|v| v as i16))),
        (32, i32s(&values)),
        (64, i64s(&values.map(i64::from))),
        (-32, f32s(&values.map(|v| v as f32))),
        (-64, f64s(&values.map(f64::from))),
    ];
    for (bitpix, data) in files {
        let path = scratch.put("a.fits", &image(SIMPLE, bitpix, &[3, 2], &[], &data));
        assert_eq!(pixels(&path).unwrap(), expected, "BITPIX {bitpix}");
        let single = read_image::<f32>(&path).unwrap().into_parts().0.into_pixels();
        assert_eq!(single.mapv(f64::from), expected, "BITPIX {bitpix} as f32");
    }
}

#[test]
fn scaling_is_applied() {
    let scratch = Scratch::new();
    let unsigned = image(SIMPLE, 16, &[2, 1], &["BZERO   = 32768"], &i16s(&[-32768, 32767]));
    assert_eq!(
        pixels(&scratch.put("u.fits", &unsigned)).unwrap(),
        array![[0.0, 65535.0]]
    );
    let scaled = image(
        SIMPLE,
        -32,
        &[2, 1],
        &["BSCALE  = 0.5", "BZERO   = 1.0"],
        &f32s(&[2.0, -4.0]),
    );
    let path = scratch.put("s.fits", &scaled);
    assert_eq!(pixels(&path).unwrap(), array![[2.0, -1.0]]);
    assert!(
        read_header(&path).unwrap().is_empty(),
        "scaling belongs to the input's structure"
    );
}

#[test]
fn trailing_axes_of_length_one_do_not_count() {
    let scratch = Scratch::new();
    let bytes = image(SIMPLE, 16, &[2, 1, 1, 1], &[], &i16s(&[7, 8]));
    assert_eq!(
        pixels(&scratch.put("a.fits", &bytes)).unwrap(),
        array![[7.0, 8.0]]
    );
}

/// A file with an empty primary HDU, an image without pixels, SCI, its mask, and a second SCI.
fn mosaic(primary: &[&str]) -> Vec<u8> {
    let mut bytes = image(SIMPLE, 8, &[], primary, &[]);
    bytes.extend(image(IMAGE, 8, &[0, 5], &[], &[]));
    for (cards, values) in [
        (&["EXTNAME = 'SCI'", "GAIN    = 2.0"][..], [1, 2]),
        (&["EXTNAME = 'MASK'", "INHERIT = F"], [3, 4]),
        (&["EXTNAME = 'sci'", "EXTVER  = 2"], [5, 6]),
    ] {
        bytes.extend(image(IMAGE, 16, &[2, 1], cards, &i16s(&values)));
    }
    bytes
}

#[test]
fn the_only_image_with_pixels_is_taken() {
    let scratch = Scratch::new();
    let mut bytes = image(SIMPLE, 8, &[], &["EXTEND  = T"], &[]);
    bytes.extend(image(IMAGE, 8, &[0, 5], &[], &[]));
    bytes.extend(image(IMAGE, 16, &[2, 1], &["EXTNAME = 'SCI'"], &i16s(&[1, 2])));
    let path = scratch.put("a.fits", &bytes);
    assert_eq!(pixels(&path).unwrap(), array![[1.0, 2.0]]);
    assert_eq!(
        read_header(&path).unwrap().get("EXTNAME").and_then(Card::value),
        Some("SCI".into())
    );
}

#[test]
fn the_primary_image_takes_precedence_over_extensions() {
    let scratch = Scratch::new();
    let mut bytes = image(SIMPLE, 16, &[2, 1], &[], &i16s(&[7, 8]));
    bytes.extend(image(IMAGE, 16, &[2, 1], &["EXTNAME = 'MASK'"], &i16s(&[1, 0])));
    let path = scratch.put("a.fits", &bytes);
    assert_eq!(pixels(&path).unwrap(), array![[7.0, 8.0]]);
}

#[test]
fn one_of_several_images_must_be_chosen() {
    let scratch = Scratch::new();
    let path = scratch.put("a.fits", &mosaic(&[]));
    let error = pixels(&path).unwrap_err();
    assert_eq!(
        (error.kind(), error.setting()),
        (IoErrorKind::Setting, Some("hdu"))
    );
    let text = error.to_string();
    assert!(
        text.contains("the file has 3 images")
            && text.contains("2 \"SCI\" (2 x 1)")
            && text.contains("4 \"sci\",2 (2 x 1)"),
        "{text}"
    );
    let of = |choice: &str| {
        let choice: HduChoice = choice.parse().unwrap();
        read_image_hdu::<f64>(&path, Some(&choice)).map(|read| read.into_parts().0.into_pixels())
    };
    for (choice, expected) in [
        ("2", 1.0),
        ("3", 3.0),
        ("SCI", 1.0),
        ("mask", 3.0),
        ("sci,1", 1.0),
        ("SCI,2", 5.0),
    ] {
        assert_eq!(of(choice).unwrap()[[0, 0]], expected, "{choice}");
    }
    for choice in ["0", "1", "5", "WHT", "SCI,3", "MASK,2"] {
        let error = of(choice).unwrap_err();
        assert!(names(&error, &path), "{error}");
        let part = format!("HDU {choice} is none of the images with pixels in the file");
        assert_error(of(choice), IoErrorKind::Setting, &part);
        assert_error(of(choice), IoErrorKind::Setting, "\"MASK\"");
    }
}

#[test]
fn cards_of_the_exposure_are_inherited() {
    let scratch = Scratch::new();
    let primary = [
        "EXPTIME = 30.0",
        "GAIN    = 1.0",
        "EXTEND  = T",
        "HISTORY taken",
        "ORIGIN  = 'here'",
    ];
    let path = scratch.put("a.fits", &mosaic(&primary));
    let of = |choice: &str| read_header_hdu(&path, Some(&choice.parse().unwrap())).unwrap();
    let keywords = |cards: &HeaderCards| cards.iter().map(Card::keyword).collect::<Vec<_>>();
    assert_eq!(keywords(&of("2")), ["EXPTIME", "ORIGIN", "EXTNAME", "GAIN"]);
    assert_eq!(of("2").get("GAIN").and_then(Card::value), Some(2.0.into()));
    assert_eq!(keywords(&of("MASK")), ["EXTNAME"]);
}

#[test]
fn a_header_needs_no_pixels() {
    let scratch = Scratch::new();
    let empty = |first, cards: &[&str]| image(first, 8, &[], cards, &[]);
    let primary = empty(SIMPLE, &["ORIGIN  = 'here'"]);
    let frame = empty(IMAGE, &["EXTNAME = 'FRAME'", "CTYPE1  = 'RA---TAN'"]);
    let pixels = image(IMAGE, 8, &[2, 2], &["EXTNAME = 'SCI'"], &[0; 4]);
    let has = |name: &str, bytes: &[u8], choice: Option<&str>, keyword: &str| {
        let choice = choice.map(|choice| choice.parse().unwrap());
        let cards = read_cards(scratch.put(name, bytes), choice.as_ref()).unwrap();
        cards.get(keyword).is_some()
    };
    assert!(has("a.fits", &primary, None, "ORIGIN"));
    let both = [primary.clone(), frame.clone()].concat();
    assert!(has("b.fits", &both, None, "CTYPE1") && has("b.fits", &both, Some("FRAME"), "CTYPE1"));
    assert!(!has("b.fits", &both, Some("0"), "CTYPE1"));
    // The image is preferred to headers without pixels, unless one of these headers is chosen.
    let all = [primary, frame, pixels].concat();
    assert!(!has("c.fits", &all, None, "CTYPE1") && has("c.fits", &all, Some("1"), "CTYPE1"));
    let result = read_cards(scratch.path("c.fits"), Some(&"3".parse().unwrap()));
    assert_error(
        result,
        IoErrorKind::Setting,
        "HDU 3 is none of the images (with or without pixels)",
    );
    let two = [&all[..], &image(IMAGE, 8, &[2, 2], &[], &[0; 4])].concat();
    let result = read_cards(scratch.put("d.fits", &two), None);
    assert_error(result, IoErrorKind::Setting, "the file has 2 images");
}

#[test]
fn files_without_an_image_are_refused_with_a_reason() {
    let scratch = Scratch::new();
    let cube = scratch.put("cube.fits", &image(SIMPLE, 8, &[2, 1, 3], &[], &[0; 6]));
    let error = pixels(&cube).unwrap_err();
    assert!(names(&error, &cube) && error.to_string().contains("cube"));
    assert_error(pixels(&cube), IoErrorKind::Axes, "HDU 0: the axes are [3, 1, 2] ");
    assert_eq!(read_cube::<f32>(&cube).unwrap().dim(), (3, 1, 2));

    let spectrum = scratch.put("line.fits", &image(SIMPLE, 8, &[5], &[], &[0; 5]));
    assert_error(pixels(&spectrum), IoErrorKind::Axes, "the axes are [5] ");
    let empty = scratch.put("empty.fits", &image(SIMPLE, 8, &[], &[], &[]));
    assert_error(pixels(&empty), IoErrorKind::Format, "no image with pixels");
    let text = scratch.put("text.fits", b"x,y\n1,2\n");
    assert_error(pixels(&text), IoErrorKind::Format, "not a FITS file");
    let zipped = scratch.put("zip.fits", b"BZh91AY and so on");
    assert!(chain(&pixels(&zipped).unwrap_err()).contains("bunzip2"));
    let missing = scratch.path("none.fits");
    let error = pixels(&missing).unwrap_err();
    assert!(names(&error, &missing) && error.kind() == IoErrorKind::NotFound);
    assert_error(
        pixels(missing.parent().unwrap()),
        IoErrorKind::Format,
        "not a regular file",
    );
}

#[test]
fn undefined_pixels_are_counted_and_located() {
    let scratch = Scratch::new();
    let values = [0.0, 1.0, f64::INFINITY, 3.0, f64::NAN, 5.0];
    for (bitpix, data) in [(-64, f64s(&values)), (-32, f32s(&values.map(|v| v as f32)))] {
        let path = scratch.put("a.fits", &image(SIMPLE, bitpix, &[2, 3], &[], &data));
        let (hdu, index) = (0, vec![1, 0]);
        let error = pixels(&path).unwrap_err();
        assert_eq!(error.place(), Some(&Place::Pixel { hdu, index }));
        assert_error(
            pixels(&path),
            IoErrorKind::Data,
            "the value is inf. Among the pixels read, 2 pixel(s) are NaN",
        );
    }
    let blank = image(
        SIMPLE,
        16,
        &[3, 1],
        &["BLANK   = -1", "BSCALE  = 2.0"],
        &i16s(&[5, -1, 7]),
    );
    let blank = scratch.put("b.fits", &blank);
    assert_error(
        pixels(&blank),
        IoErrorKind::Data,
        "pixel [0, 1] (0-based, x last): the value is NaN. Among the pixels read, 1 pixel(s)",
    );
}

#[test]
fn values_beyond_single_precision_are_refused() {
    let scratch = Scratch::new();
    let path = scratch.put("a.fits", &image(SIMPLE, -64, &[2, 1], &[], &f64s(&[1.0, 1e300])));
    assert_error(read_image::<f32>(&path), IoErrorKind::Limit, "single precision");
    assert_eq!(pixels(&path).unwrap()[[0, 1]], 1e300);
    let path = scratch.put(
        "b.fits",
        &image(SIMPLE, 16, &[2, 1], &["BSCALE  = 1E300"], &i16s(&[0, 2])),
    );
    assert_error(read_image::<f32>(&path), IoErrorKind::Limit, "single precision");
    assert_eq!(pixels(&path).unwrap()[[0, 1]], 2e300);
}

#[test]
fn headers_that_break_the_standard_are_refused() {
    let scratch = Scratch::new();
    let cases: &[(&[&str], &str)] = &[
        (&[SIMPLE, "BITPIX  = 8"], "NAXIS"),
        (&[SIMPLE, "BITPIX  = 7", "NAXIS   = 0"], "BITPIX"),
        (&[SIMPLE, "BITPIX  = 'a'", "NAXIS   = 0"], "BITPIX"),
        (&[SIMPLE, "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 3"], "NAXIS2"),
        (&[SIMPLE, "BITPIX  = 8", "NAXIS   = 1", "NAXIS1  = -3"], "NAXIS1"),
        (&[SIMPLE, "BITPIX  = 8", "NAXIS   = 100000"], "NAXIS"),
    ];
    for (cards, keyword) in cases {
        let path = scratch.put("a.fits", &hdu(cards, &[]));
        let error = pixels(&path).unwrap_err();
        let (hdu, keyword) = (0, (*keyword).to_owned());
        assert_eq!(error.place(), Some(&Place::Keyword { hdu, keyword }), "{error}");
    }
}

#[test]
fn axes_beyond_those_of_cfitsio_are_refused() {
    let scratch = Scratch::new();
    let of_axes = |count: usize| image(SIMPLE, 8, &vec![1; count], &[], &[7]);
    let path = scratch.put("a.fits", &of_axes(99));
    assert_eq!(pixels(&path).unwrap(), array![[7.0]]);
    for count in [100, 150, 999] {
        let path = scratch.put("a.fits", &of_axes(count));
        assert_error(pixels(&path), IoErrorKind::Header, "must be 0 to 99");
    }
}

#[test]
fn scaling_that_is_no_number_is_refused() {
    let scratch = Scratch::new();
    for card in [
        "BSCALE  = '2.0'",
        "BZERO   = 'abc'",
        "BSCALE  = NaN",
        "BZERO   = T",
        "BZERO   =",
        "BSCALE  = 0.0",
    ] {
        let path = scratch.put("a.fits", &image(SIMPLE, 16, &[2, 1], &[card], &i16s(&[1, 2])));
        assert_error(pixels(&path), IoErrorKind::Header, "a finite number");
    }
}

#[test]
fn forged_sizes_are_refused_before_memory_is_taken() {
    let scratch = Scratch::new();
    let big = usize::try_from(i64::MAX).unwrap();
    for axes in [
        &[4_000_000, 4_000_000][..],
        &[big, big],
        &[big, 1],
        &[65536, 65536, 65536, 65536],
    ] {
        let path = scratch.put("a.fits", &image(SIMPLE, -64, axes, &[], &[0; 100]));
        let error = pixels(&path).unwrap_err();
        assert!(
            matches!(error.kind(), IoErrorKind::Damaged | IoErrorKind::Header),
            "{error}"
        );
    }
    let path = scratch.put("a.fits", &image(SIMPLE, -32, &[1000, 1000], &[], &[0; 100]));
    let (needed, length) = (2880 * 1390, 2 * 2880);
    let cut =
        format!("HDU 0: the file is cut short: at least {needed} bytes are needed, but there are {length}.");
    assert_error(pixels(&path), IoErrorKind::Damaged, &cut);
}

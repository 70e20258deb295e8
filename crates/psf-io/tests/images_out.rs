//! Writing images and reading them back.

mod support;

use ndarray::{Array2, array};
use psf_io::{Card, CardValue, HeaderCards, IoErrorKind, read_header, read_image, write_image, write_text};
use psf_types::Image;
use support::{SIMPLE, Scratch, assert_error, chain, f32s, image};

#[test]
fn pixels_come_back_bit_by_bit() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let values = array![
        [-0.0, 5e-324, f64::MIN_POSITIVE / 2.0],
        [f64::MAX, 1.0 / 3.0, -1e-310]
    ];
    write_image(
        &path,
        &Image::new(values.clone()).unwrap(),
        &HeaderCards::new(),
        &[],
        false,
    )
    .unwrap();
    let back = read_image::<f64>(&path).unwrap().into_parts().0.into_pixels();
    assert_eq!(back.mapv(f64::to_bits), values.mapv(f64::to_bits));

    let values = array![[-0.0_f32, 1e-45, f32::MAX]];
    write_image(
        &path,
        &Image::new(values.clone()).unwrap(),
        &HeaderCards::new(),
        &[],
        true,
    )
    .unwrap();
    let back = read_image::<f32>(&path).unwrap().into_parts().0.into_pixels();
    assert_eq!(back.mapv(f32::to_bits), values.mapv(f32::to_bits));
}

#[test]
fn cards_are_copied_and_added_cards_replace_them() {
    let scratch = Scratch::new();
    let cards = [
        "CRPIX1  =                 10.5 / [pix] reference",
        "TELESCOP= 'Roman   '           / observatory",
        "VERSION = 'old     '",
        "LONG    = 'It''s the first part of a rather long text, which goes on in the &'",
        "CONTINUE  'next record' / and has a comment",
        "HISTORY bias subtracted",
        "COMMENT   two   blanks",
        "HIERARCH ESO DET GAIN = 2.5 / [e-/ADU]",
        "CHECKSUM= 'abcdefghijklmnop'",
        "DATE.OBS= 'illegal keyword'",
    ];
    let input = scratch.put("in.fits", &image(SIMPLE, 8, &[1, 1], &cards, &[0]));
    let (image, header) = read_image::<f32>(&input).unwrap().into_parts();
    let output = scratch.path("out.fits");
    let added = [
        Card::new("VERSION", "new", "").unwrap(),
        Card::history("psfield simulate"),
    ];
    write_image(&output, &image, &header, &added, false).unwrap();

    let text = std::fs::read(&output).unwrap();
    let written: Vec<&[u8]> = text
        .chunks(80)
        .take_while(|card| !card.starts_with(b"END "))
        .collect();
    for card in cards
        .iter()
        .filter(|c| !["VERSION", "CHECKSU", "DATE.OB"].contains(&&c[..7]))
    {
        let record = format!("{card:<80}");
        assert_eq!(
            written.iter().filter(|r| **r == record.as_bytes()).count(),
            1,
            "{card}"
        );
    }
    let header = read_header(&output).unwrap();
    assert_eq!(
        header.get("VERSION").and_then(Card::value),
        Some(CardValue::Text("new".into()))
    );
    assert!(header.get("CHECKSUM").is_none());
    let texts: Vec<String> = header.iter().map(ToString::to_string).collect();
    assert!(
        texts
            .iter()
            .any(|t| t.starts_with("COMMENT DATE.OBS= 'illegal keyword'"))
    );
    assert!(texts.last().unwrap().starts_with("HISTORY psfield simulate"));
    // A second pass changes nothing.
    let again = scratch.path("again.fits");
    write_image(&again, &image, &header, &[], false).unwrap();
    assert_eq!(std::fs::read(&again).unwrap(), text);
}

#[test]
fn long_headers_are_written_whole() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let cards: Vec<Card> = (0..500)
        .map(|i| Card::new(&format!("KEY{i}"), i, "").unwrap())
        .collect();
    let pixels = Array2::from_shape_fn((40, 50), |(y, x)| (50 * y + x) as f32);
    let image = Image::new(pixels).unwrap();
    write_image(&path, &image, &HeaderCards::new(), &cards, false).unwrap();
    let back = read_image::<f32>(&path).unwrap();
    assert_eq!(back.image(), &image);
    assert!(
        cards
            .iter()
            .all(|card| back.header().get(&card.keyword()) == Some(card))
    );
}

#[test]
fn names_are_taken_literally() {
    let scratch = Scratch::new();
    let image = Image::new(array![[1.0_f32, 2.0]]).unwrap();
    for name in [
        "!a.fits",
        "a[1].fits",
        "b(c).fits",
        "d+2",
        " e.fits",
        "~f.fits",
        "mem:",
        "-",
        "é€.fits",
    ] {
        let path = scratch.path(name);
        write_image(&path, &image, &HeaderCards::new(), &[], false)
            .unwrap_or_else(|e| panic!("{name}: {}", chain(&e)));
        assert!(path.is_file(), "{name}");
        assert_eq!(read_image::<f32>(&path).unwrap().image(), &image, "{name}");
        let error = write_image(&path, &image, &HeaderCards::new(), &[], false).unwrap_err();
        assert_eq!(
            (error.kind(), error.setting()),
            (IoErrorKind::Exists, Some("overwrite"))
        );
        write_image(&path, &image, &HeaderCards::new(), &[], true).unwrap();
    }
}

#[test]
fn compressed_files_and_standard_output_are_refused() {
    let scratch = Scratch::new();
    let image = Image::new(array![[1.0_f32, 2.0]]).unwrap();
    let refused = |path: &std::path::Path, expected: &str| {
        let written = write_image(path, &image, &HeaderCards::new(), &[], true);
        assert_error(written, IoErrorKind::Request, expected);
        assert!(!path.exists());
    };
    for (ending, tool) in [("gz", "gzip"), ("FZ", "fpack"), ("bz2", "bzip2"), ("xz", "xz")] {
        let plain = scratch.path("a.fits");
        let expected = format!("write {} and run {tool} on it", plain.display());
        refused(&scratch.path(&format!("a.fits.{ending}")), &expected);
    }
    refused("-".as_ref(), "standard output is not supported");
    assert_error(
        write_text("table.csv.gz", "", false),
        IoErrorKind::Request,
        "write table.csv and run gzip",
    );
}

#[test]
fn sections_of_a_raw_frame_are_not_copied() {
    let scratch = Scratch::new();
    let sections = ["DATASEC", "TRIMSEC", "BIASSEC", "CCDSEC", "DETSEC", "DATASECB"];
    let cards: Vec<String> = sections
        .map(|keyword| format!("{keyword:<8}= '[1:2,1:1]'"))
        .into();
    let mut cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    cards.extend(["CHECKSUM= 'abc'", "DATASUM = '123'", "BUNIT   = 'electron'"]);
    let path = scratch.put(
        "raw.fits",
        &image(SIMPLE, -32, &[2, 1], &cards, &f32s(&[1.0, 2.0])),
    );
    let read = read_image::<f32>(&path).unwrap();
    let kept: Vec<String> = read.header().iter().map(Card::keyword).collect();
    assert_eq!(kept, ["BUNIT"]);
}

#[test]
fn many_threads_may_read_and_write_at_once() {
    let scratch = Scratch::new();
    let shared = scratch.path("shared.fits");
    let image = Image::new(Array2::from_shape_fn((100, 120), |(y, x)| (y * x) as f64)).unwrap();
    write_image(&shared, &image, &HeaderCards::new(), &[], false).unwrap();
    std::thread::scope(|scope| {
        for thread in 0..8 {
            let (scratch, shared, image) = (&scratch, &shared, &image);
            scope.spawn(move || {
                for _ in 0..50 {
                    assert_eq!(read_image::<f64>(shared).unwrap().image(), image);
                    let own = scratch.path(&format!("{thread}.fits"));
                    write_image(&own, image, &HeaderCards::new(), &[], true).unwrap();
                    assert_eq!(read_image::<f64>(&own).unwrap().image(), image);
                }
            });
        }
    });
}

//! Writing images of whole numbers and reading them back.

mod support;

use ndarray::array;
use psf_io::{Card, HeaderCards, IntegerKind, IoErrorKind, read_image, write_integers};
use support::{Scratch, assert_error};

#[test]
fn every_kind_holds_the_ends_of_its_range() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    for (kind, bitpix) in [
        (IntegerKind::Unsigned8, "8"),
        (IntegerKind::Unsigned16, "16"),
        (IntegerKind::Signed32, "32"),
    ] {
        let (lowest, highest) = kind.range();
        let (lowest, highest) = (f64::from(lowest), f64::from(highest));
        let pixels = array![[lowest, highest, 0.0], [1.0, 100.0, highest - 1.0]];
        let cards = [Card::new("BUNIT", "adu", "").unwrap()];
        write_integers(&path, pixels.view(), kind, &HeaderCards::new(), &cards, true).unwrap();
        let back = read_image::<f64>(&path).unwrap();
        assert_eq!(back.image().pixels(), pixels);
        assert_eq!(back.header().get("BUNIT"), Some(&cards[0]));
        assert!(back.header().get("BZERO").is_none(), "BZERO is not copied");
        let text = std::fs::read(&path).unwrap();
        assert!(text[80..160].starts_with(format!("BITPIX  = {bitpix:>20}").as_bytes()));

        for bad in [lowest - 1.0, highest + 1.0, 0.5, f64::NAN] {
            let pixels = array![[0.0, 0.0], [0.0, bad]];
            let before = std::fs::read(&path).unwrap();
            let result = write_integers(&path, pixels.view(), kind, &HeaderCards::new(), &[], true);
            assert_error(result, IoErrorKind::Request, "[1, 1] ([y, x], 0-based) is ");
            assert_eq!(std::fs::read(&path).unwrap(), before, "an old file stays");
        }
    }
}

#[test]
fn the_cards_of_a_scaled_input_do_not_disturb() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let header: HeaderCards = [
        Card::new("BZERO", 7.0, "").unwrap(),
        Card::new("BSCALE", 2.0, "").unwrap(),
    ]
    .into_iter()
    .collect();
    let pixels = array![[1_u8, 2], [3, 255]];
    write_integers(&path, pixels.view(), IntegerKind::Unsigned16, &header, &[], false).unwrap();
    let back = read_image::<f32>(&path).unwrap();
    assert_eq!(back.image().pixels(), pixels.mapv(f32::from));
}

#[test]
fn bits_choose_the_kind() {
    use IntegerKind::{Signed32, Unsigned8, Unsigned16};
    let kinds = [1, 8, 9, 16, 17, 24].map(IntegerKind::of_bits);
    assert_eq!(
        kinds,
        [Unsigned8, Unsigned8, Unsigned16, Unsigned16, Signed32, Signed32]
    );
}

//! World coordinates against astropy's (`data/sky_coordinates.py`).

use psf_io::{Card, CardValue, HeaderCards, SkyCoordinates, WorldCoordinatesError};
use psf_types::Position;
use serde_json::Value;

/// The largest error in pixels. astropy's own inverse of distortions is accurate to 1e-7.
const PIXEL_ERROR: f64 = 1e-6;
/// The largest error in degrees, for pixels of at least 0.18 arcseconds.
const SKY_ERROR: f64 = 1e-11;

fn cases() -> Vec<Value> {
    serde_json::from_str(include_str!("data/sky_coordinates.json")).unwrap()
}

fn header(case: &Value) -> HeaderCards {
    let card = |(keyword, value): (&String, &Value)| {
        let value: CardValue = match value {
            Value::String(text) => text.as_str().into(),
            Value::Number(number) if number.is_i64() => number.as_i64().unwrap().into(),
            number => number.as_f64().unwrap().into(),
        };
        Card::new(keyword, value, "").unwrap()
    };
    case["header"].as_object().unwrap().iter().map(card).collect()
}

/// The pairs of pixel and sky position of a case.
fn pairs(case: &Value) -> Vec<([f64; 2], [f64; 2])> {
    let list = |name: &str| -> Vec<[f64; 2]> { serde_json::from_value(case[name].clone()).unwrap() };
    list("pixels").into_iter().zip(list("sky")).collect()
}

#[test]
fn pixels_and_places_agree_with_astropy() {
    let cases = cases();
    assert_eq!(cases.len(), 29);
    for case in &cases {
        let name = &case["name"];
        let sky = SkyCoordinates::from_header(&header(case)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut largest = 0.0_f64;
        for ([x, y], [longitude, latitude]) in pairs(case) {
            let found = sky
                .pixel(longitude, latitude)
                .unwrap_or_else(|| panic!("{name}: {x} {y}"));
            let error = (found.x() - x).abs().max((found.y() - y).abs());
            assert!(error <= PIXEL_ERROR, "{name}: pixel {x} {y} came back as {found}");
            largest = largest.max(error);
            // The inverse direction. Longitudes are undefined at the pole.
            let place = sky.sky(Position::new(x, y).unwrap()).unwrap();
            let turn = (place.0 - longitude + 180.0).rem_euclid(360.0) - 180.0;
            let along = turn * latitude.to_radians().cos();
            assert!(
                along.abs().max((place.1 - latitude).abs()) <= SKY_ERROR,
                "{name}: {place:?}"
            );
        }
        println!("{name}: {largest:.1e} pixel");
    }
}

#[test]
fn every_number_of_a_header_counts() {
    // If one of its numbers is removed, a header is refused or gives other pixels. Inverses of SIP
    // are not used.
    for case in cases() {
        let whole = header(&case);
        let ([x, y], [longitude, latitude]) = pairs(&case)[5];
        for keyword in whole.iter().map(Card::keyword) {
            let unused = keyword.starts_with("AP_") || keyword.starts_with("BP_");
            let is_default = |value| whole.get(&keyword).and_then(Card::value) == Some(value);
            if unused || is_default(CardValue::Real(0.0)) {
                continue;
            }
            let without: HeaderCards = whole
                .iter()
                .filter(|card| card.keyword() != keyword)
                .cloned()
                .collect();
            let found = SkyCoordinates::from_header(&without)
                .ok()
                .and_then(|sky| sky.pixel(longitude, latitude));
            let same =
                found.is_some_and(|p| (p.x() - x).abs() < PIXEL_ERROR && (p.y() - y).abs() < PIXEL_ERROR);
            assert!(!same, "{}: {keyword}", case["name"]);
        }
    }
}

#[test]
fn headers_that_are_not_understood_name_the_keyword() {
    let good = header(&cases()[0]);
    let with = |keyword: &str, value: CardValue| {
        let mut header = good.clone();
        header.set(Card::new(keyword, value, "").unwrap());
        SkyCoordinates::from_header(&header).map(|_| ()).unwrap_err()
    };
    for (keyword, value) in [
        ("CTYPE1", "GLON-TAN".into()),
        ("CTYPE1", "RA---HPX".into()),
        ("CTYPE1", "RA".into()),
        ("CTYPE2", "DEC--SIN".into()),
        ("CUNIT1", "pixel".into()),
        ("CRPIX1", "one".into()),
    ] {
        match with(keyword, value) {
            WorldCoordinatesError::Unsupported { keyword: named, .. } => {
                assert!(named == keyword || named == "CTYPE2", "{named}");
            }
            other => panic!("{other:?}"),
        }
    }
    for missing in ["CTYPE1", "CRVAL2", "CRPIX1"] {
        let mut header = good.clone();
        header.remove(missing);
        let error = SkyCoordinates::from_header(&header).unwrap_err();
        assert!(
            matches!(&error, WorldCoordinatesError::Missing { keyword, .. } if keyword == missing),
            "{error}"
        );
    }
    assert!(matches!(
        SkyCoordinates::from_header(&HeaderCards::new()),
        Err(WorldCoordinatesError::Missing { .. })
    ));
    let mut singular = good.clone();
    for keyword in ["CD1_1", "CD1_2", "CD2_1", "CD2_2"] {
        singular.set(Card::new(keyword, 1e-5, "").unwrap());
    }
    assert_eq!(
        SkyCoordinates::from_header(&singular).unwrap_err(),
        WorldCoordinatesError::Singular
    );
}

#[test]
fn no_distortion_is_ignored() {
    let cases = cases();
    let plain = header(&cases[0]);
    let with = |header: &HeaderCards, keyword: &str, value: CardValue| {
        let mut header = header.clone();
        header.set(Card::new(keyword, value, "").unwrap());
        SkyCoordinates::from_header(&header)
    };
    for (keyword, value) in [
        ("CPDIS1", "LOOKUP".into()),
        ("CQDIS2", "Lookup".into()),
        ("D2IMDIS1", "LOOKUP".into()),
        ("D2IMARR", 1.into()),
        ("PV1_0", 1.into()),
        ("PV1_1", 0.5.into()),
        ("PV1_2", 45.0.into()),
        ("PV1_3", 12.0.into()),
        ("CTYPE1", "RA---TAN-TPD".into()),
    ] {
        let error = with(&plain, keyword, value).unwrap_err();
        assert!(
            matches!(&error, WorldCoordinatesError::Unsupported { keyword: named, .. } if named == keyword),
            "{keyword}: {error}"
        );
    }
    for keyword in ["PV1_0", "PV1_3"] {
        with(&plain, keyword, 0.0.into()).unwrap();
    }
    with(&plain, "PV1_2", 90.0.into()).unwrap();
    assert!(matches!(
        with(&plain, "A_ORDER", 2.into()),
        Err(WorldCoordinatesError::Missing { keyword, .. }) if keyword == "B_ORDER"
    ));
    // SIP is applied even if CTYPEi does not end in -SIP.
    let mut compared = 0;
    for case in &cases {
        let whole = header(case);
        let mut unsaid = whole.clone();
        for keyword in ["CTYPE1", "CTYPE2"] {
            let Some(CardValue::Text(ctype)) = whole.get(keyword).and_then(Card::value) else {
                panic!("{keyword} is a text");
            };
            unsaid.set(Card::new(keyword, ctype.trim_end_matches("-SIP"), "").unwrap());
        }
        if unsaid != whole {
            compared += 1;
            let found = SkyCoordinates::from_header(&unsaid).unwrap();
            for ([x, y], [longitude, latitude]) in pairs(case) {
                let pixel = found.pixel(longitude, latitude).unwrap();
                assert!((pixel.x() - x).abs() < PIXEL_ERROR && (pixel.y() - y).abs() < PIXEL_ERROR);
            }
        }
    }
    assert!(compared > 0);
}

#[test]
fn extreme_positions_give_finite_pixels_or_none() {
    for case in cases() {
        let sky = SkyCoordinates::from_header(&header(&case)).unwrap();
        for (longitude, latitude) in [
            (f64::NAN, 0.0),
            (0.0, 91.0),
            (f64::INFINITY, 0.0),
            (0.0, f64::NAN),
            (-1e-17, 90.0),
            (720.0, -90.0),
        ] {
            if let Some(position) = sky.pixel(longitude, latitude) {
                assert!(position.x().is_finite() && position.y().is_finite());
            }
        }
        assert!(sky.pixel(0.0, 91.0).is_none() && sky.pixel(f64::NAN, 0.0).is_none());
    }
}

#[test]
fn pixels_far_off_give_finite_positions_or_none() {
    for case in cases() {
        let sky = SkyCoordinates::from_header(&header(&case)).unwrap();
        // Here mapproj would return vectors of length zero or NaN, and panic with debug assertions.
        for (x, y) in [(1e15, 1e300), (-1e300, 0.0), (1e250, 1e250)] {
            let far = Position::new(x, y).unwrap();
            assert_eq!(sky.sky(far), None, "{} at {x}, {y}", case["name"]);
        }
        for far in [1e6, 1e15] {
            if let Some((longitude, latitude)) = sky.sky(Position::new(far, -far).unwrap()) {
                assert!(
                    longitude.is_finite() && latitude.abs() <= 90.0,
                    "{} at {far}",
                    case["name"]
                );
            }
        }
    }
}

//! Catalogues with named columns, stars and galaxies.

mod support;

use psf_io::{
    Card, Catalog, CatalogColumns, CatalogOptions, HeaderCards, IoError, IoErrorKind, ObservationDate, Place,
    Row, SkyCoordinates, SourceColours, read_catalog_with, read_columns, read_positions_with,
};
use support::{SIMPLE, Scratch, assert_error, chain, f32s, f64s, i16s, i32s, image, names, table};

fn options(columns: &str) -> CatalogOptions {
    CatalogOptions::new().with_columns(columns.parse().unwrap())
}

fn read(text: &str, options: &CatalogOptions) -> Result<Catalog, IoError> {
    let scratch = Scratch::new();
    read_catalog_with(scratch.put("a.csv", text.as_bytes()), options)
}

fn fits(tables: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = image(SIMPLE, 8, &[], &[], &[]);
    for table in tables {
        bytes.extend(table);
    }
    bytes
}

/// The tables of SExtractor's FITS_LDAC: the header of the frame in one cell, then the objects.
fn ldac(objects: Vec<u8>) -> Vec<u8> {
    let cell = [b' '; 160];
    let header = table("LDAC_IMHEAD", &[("Field Header Card", "160A")], 1, &[], &cell);
    fits(&[header, objects])
}

#[test]
fn sextractor_catalogues_are_read_in_both_forms() {
    let scratch = Scratch::new();
    let ascii = "#   1 NUMBER          Running object number\n\
                 #   2 FLUX_APER       Flux vector within fixed circular aperture(s)  [count]\n\
                 #   4 FLUX_AUTO       Flux within a Kron-like elliptical aperture    [count]\n\
                 #   5 X_IMAGE         Object position along x                        [pixel]\n\
                 #   6 Y_IMAGE         Object position along y                        [pixel]\n\
                 \x20        1     10.5     11.5     1234.5     1.0000    20.2500\n\
                 \x20        2     10.5     11.5      -3e-1   512.5000     7.0000\n";
    let row = |number: i32, flux: f32, x: f64, y: f64| {
        [i32s(&[number]), f32s(&[0.0, 0.0, flux]), f64s(&[x, y])].concat()
    };
    let columns = [
        ("NUMBER", "1J"),
        ("FLUX_APER", "2E"),
        ("FLUX_AUTO", "1E"),
        ("X_IMAGE", "1D"),
        ("Y_IMAGE", "1D"),
    ];
    let rows = [row(1, 1234.5, 1.0, 20.25), row(2, -0.3, 512.5, 7.0)].concat();
    let objects = table("LDAC_OBJECTS", &columns, 2, &[], &rows);
    let options = options("x=X_IMAGE,y=Y_IMAGE,flux=FLUX_AUTO").with_one_based(true);
    for bytes in [ascii.as_bytes().to_vec(), ldac(objects)] {
        let path = scratch.put("sex.cat", &bytes);
        let catalog = read_catalog_with(&path, &options).unwrap();
        let stars: Vec<_> = catalog
            .stars()
            .iter()
            .map(|s| (s.position().x(), s.position().y(), s.flux() as f32))
            .collect();
        assert_eq!(stars, [(0.0, 19.25, 1234.5), (511.5, 6.0, -0.3)]);
        let positions = read_positions_with(&path, &options).unwrap();
        assert_eq!(positions[1], catalog.stars()[1].position());
        assert_eq!(read_columns(&path, ["number"]).unwrap(), [[1.0, 2.0]]);
        // The error lists the columns of the objects, not those of the frame's header.
        let error = read_catalog_with(&path, &CatalogOptions::new()).unwrap_err();
        assert!(
            names(&error, &path) && error.to_string().contains("X_IMAGE"),
            "{error}"
        );
    }
}

#[test]
fn magnitudes_need_a_zero_point() {
    let text = "x,y,mag\n1,2,20\n1,2,27.5\n";
    let error = read(text, &CatalogOptions::new()).unwrap_err();
    assert_eq!(error.setting(), Some("zero_point"));
    assert_setting(Err::<(), _>(error), "the column \"mag\" holds magnitudes");
    let with = CatalogOptions::new().with_zero_point(25.0).unwrap();
    let stars = read(text, &with).unwrap().into_parts().0;
    assert!((stars[0].flux() - 100.0).abs() < 1e-10 && (stars[1].flux() - 0.1).abs() < 1e-13);
    assert!(CatalogOptions::new().with_zero_point(f64::NAN).is_err());
    // Fluxes do not use a zero point, and the reader does not guess which column is meant.
    for text in ["x,y,flux\n1,2,20\n", "x,y,mag,flux\n1,2,20,7\n"] {
        assert_setting(read(text, &with), "the column \"flux\" holds fluxes");
    }
    let chosen = with.clone().with_columns("mag=mag".parse().unwrap());
    let star = read("x,y,mag,flux\n1,2,20,7\n", &chosen).unwrap().stars()[0];
    assert!((star.flux() - 100.0).abs() < 1e-10);
    // A flux is preferred to a magnitude.
    assert_eq!(
        read("x,y,mag,flux\n1,2,20,7\n", &CatalogOptions::new())
            .unwrap()
            .stars()[0]
            .flux(),
        7.0
    );
}

#[test]
fn sky_coordinates_are_not_counted_from_one() {
    let options = CatalogOptions::new().with_sky(sky()).with_one_based(true);
    let result = read("ra,dec,flux\n150,2,3\n", &options);
    assert_eq!(result.as_ref().unwrap_err().setting(), Some("one_based"));
    let part = "the columns \"ra\" and \"dec\" are sky coordinates, which are not counted from 1";
    assert_setting(result, part);
}

#[test]
fn rows_without_a_profile_are_stars() {
    let text = "x,y,flux,re,n,q,angle\n1,2,3,2.5,4,0.5,30\n1,2,3,0,4,0.5,30\n1,2,3,0,,,\n1,2,-3,0,0,9,9\n";
    let catalog = read(text, &CatalogOptions::new()).unwrap();
    assert_eq!(
        (
            catalog.stars().len(),
            catalog.galaxies().len(),
            catalog.invalid_rows()
        ),
        (3, 1, 0)
    );
    let profile = catalog.galaxies()[0].profile();
    assert_eq!(
        (
            profile.half_light_radius_px(),
            profile.index(),
            profile.axis_ratio(),
            profile.angle_deg()
        ),
        (2.5, 4.0, 0.5, 30.0)
    );
    let round = read("x y flux r sersic\n1 2 3 4 1\n", &options("re=r,n=sersic")).unwrap();
    let profile = round.galaxies()[0].profile();
    assert_eq!((profile.axis_ratio(), profile.angle_deg()), (1.0, 0.0));
    let result = read("x,y,flux,re\n1,2,3,4\n", &CatalogOptions::new());
    assert_error(
        result,
        IoErrorKind::Table,
        "column \"n\": there is no such column",
    );
}

#[test]
fn bad_rows_are_named_or_counted() {
    let head = "x,y,flux,re,n,q,angle\n1,2,3,4,1,1,0\n";
    let cases = [
        ("nan,2,3,4,1,1,0", "column \"x\": a finite number is needed"),
        ("1,,3,4,1,1,0", "column \"y\": a finite number is needed"),
        ("1,2,,4,1,1,0", "column \"flux\": a finite number is needed"),
        ("1,2,inf,4,1,1,0", "column \"flux\": a finite number is needed"),
        ("1,2,0,4,1,1,0", "column \"flux\": the flux of the source is 0"),
        ("1,2,0,0,,,", "column \"flux\": the flux of the source is 0"),
        ("1,2,3,,4,1,0", "column \"re\": the half-light radius is missing"),
        ("1,2,3,,,,", "column \"re\": the half-light radius is missing"),
        (
            "1,2,3,nan,4,1,0",
            "column \"re\": the half-light radius is missing",
        ),
        ("1,2,3,-4,1,1,0", "re must be"),
        ("1,2,3,4,,1,0", "n must be"),
        ("1,2,3,4,nan,1,0", "n must be"),
        ("1,2,3,4,0,1,0", "n must be"),
        ("1,2,3,4,9,1,0", "n must be from 0.3 to 8"),
        ("1,2,3,4,0.2,1,0", "n must be"),
        ("1,2,3,4,1,1.5,0", "q must be"),
        ("1,2,3,4,1,,0", "q must be"),
        ("1,2,3,4,1,0.5,", "angle"),
    ];
    for (bad, problem) in cases {
        let text = format!("{head}{bad}\n5,6,7,0,0,0,0\n");
        let error = read(&text, &CatalogOptions::new()).unwrap_err();
        let told = chain(&error);
        assert!(told.contains("line 3") && told.contains(problem), "{bad}: {told}");
        let catalog = read(&text, &CatalogOptions::new().with_invalid_skipped(true)).unwrap();
        assert_eq!(
            (
                catalog.stars().len(),
                catalog.galaxies().len(),
                catalog.invalid_rows()
            ),
            (1, 1, 1),
            "{bad}"
        );
    }
    // Text that is not a number makes a broken table, not an invalid source.
    let text = format!("{head}1,2,3px,4,1,1,0\n");
    let result = read(&text, &CatalogOptions::new().with_invalid_skipped(true));
    assert_error(
        result,
        IoErrorKind::Data,
        "line 3, column \"flux\": a finite number",
    );
}

#[test]
fn shear_is_applied_to_the_ellipse_of_q_and_angle() {
    // Rounding error of a few operations.
    const ROUNDING: f64 = 1e-12;
    let near =
        |found: f64, expected: f64| assert!((found - expected).abs() <= ROUNDING, "{found} {expected}");
    let text = "x,y,flux,re,n,g1,g2\n1,2,3,2,4,0.12,-0.16\n1,2,3,0,0,,\n";
    let catalog = read(text, &CatalogOptions::new()).unwrap();
    assert_eq!(catalog.stars().len(), 1);
    let (profile, q): (_, f64) = (catalog.galaxies()[0].profile(), 0.8 / 1.2);
    near(profile.half_light_radius_px(), 2.0 / q.sqrt());
    near(profile.axis_ratio(), q);
    near(profile.angle_deg(), 0.5 * (-0.16_f64).atan2(0.12).to_degrees());
    // Shear along the major axis of an ellipse. The axis ratios multiply.
    let text = "x y flux r n q angle e1 e2\n1 2 3 2 4 0.5 90 -0.2 0\n";
    let galaxies = read(text, &options("re=r,g1=e1,g2=e2")).unwrap().into_parts().1;
    let profile = galaxies[0].profile();
    near(profile.half_light_radius_px(), 2.0 / q.sqrt());
    near(profile.axis_ratio(), 0.5 * q);
    near(profile.angle_deg().rem_euclid(180.0), 90.0);
    // Sky coordinates do not turn the shear: it refers to the axes of the pixels.
    let on_sky = CatalogOptions::new().with_sky(sky());
    let galaxies = read("ra,dec,flux,re,n,g1,g2\n150,2,3,2,4,0.2,0\n", &on_sky);
    near(galaxies.unwrap().galaxies()[0].profile().angle_deg(), 0.0);

    for (g, problem) in [
        ("1,0", "the reduced shear"),
        ("-0.8,0.6", "the reduced shear"),
        ("0.1,", "the reduced shear"),
    ] {
        let text = format!("x,y,flux,re,n,g1,g2\n5,6,7,1,1,0,0\n1,2,3,2,4,{g}\n");
        let told = chain(&read(&text, &CatalogOptions::new()).unwrap_err());
        assert!(told.contains("line 3") && told.contains(problem), "{told}");
        let skipping = CatalogOptions::new().with_invalid_skipped(true);
        assert_eq!(read(&text, &skipping).unwrap().invalid_rows(), 1);
    }
}

#[test]
fn magnitudes_beyond_doubles_are_no_sources() {
    let with = CatalogOptions::new().with_zero_point(25.0).unwrap();
    for (bad, problem) in [
        ("1e6", "column \"mag\": the flux of the source is 0"),
        ("-1e6", "has flux inf"),
    ] {
        let told = chain(&read(&format!("x,y,mag\n1,2,20\n1,2,{bad}\n"), &with).unwrap_err());
        assert!(told.contains("line 3") && told.contains(problem), "{told}");
    }
}

#[test]
fn undefined_values_of_fits_tables_name_row_and_column() {
    let scratch = Scratch::new();
    let columns = [("X", "I"), ("Y", "I"), ("FLUX", "I")];
    let bytes = fits(&[table(
        "T",
        &columns,
        2,
        &["TNULL2  = -9"],
        &i16s(&[1, 2, 3, 4, -9, 6]),
    )]);
    let path = scratch.put("a.fits", &bytes);
    let error = read_catalog_with(&path, &CatalogOptions::new()).unwrap_err();
    let (row, column) = (Row::Index(1), "Y".to_owned());
    assert_eq!(error.place(), Some(&Place::Value { row, column }));
    let skipping = CatalogOptions::new().with_invalid_skipped(true);
    assert_eq!(read_catalog_with(&path, &skipping).unwrap().invalid_rows(), 1);
    assert!(
        read_positions_with(&path, &skipping).is_err(),
        "a position stands for its row"
    );
}

#[test]
fn one_of_several_tables_must_be_chosen() {
    let scratch = Scratch::new();
    let objects = |name: &str, x: f64| {
        table(
            name,
            &[("x", "D"), ("y", "D"), ("flux", "D")],
            1,
            &[],
            &f64s(&[x, 2.0, 3.0]),
        )
    };
    let path = scratch.put("a.fits", &fits(&[objects("CHIP1", 1.0), objects("CHIP2", 9.0)]));
    let result = read_catalog_with(&path, &CatalogOptions::new());
    assert_eq!(result.as_ref().unwrap_err().setting(), Some("table"));
    assert_setting(result, "\"CHIP2\" (rows: 1): choose one");
    let of =
        |choice: &str| read_catalog_with(&path, &CatalogOptions::new().with_table(choice.parse().unwrap()));
    assert_eq!(of("chip2").unwrap().stars()[0].position().x(), 9.0);
    assert_eq!(of("1").unwrap().stars()[0].position().x(), 1.0);
    for choice in ["0", "3", "CHIP3"] {
        assert_setting(of(choice), &format!("HDU {choice} is none of the binary tables"));
    }
}

/// Asserts that a setting is needed, wrong or without effect.
#[track_caller]
fn assert_setting<T>(result: Result<T, IoError>, part: &str) {
    assert_error(result, IoErrorKind::Setting, part);
}

/// A frame with 0.1 arcseconds per pixel around (150, 2) degrees.
fn sky() -> SkyCoordinates {
    let mut header = HeaderCards::new();
    for (keyword, value) in [
        ("CRPIX1", 1.0),
        ("CRPIX2", 1.0),
        ("CRVAL1", 150.0),
        ("CRVAL2", 2.0),
        ("CDELT1", -0.1 / 3600.0),
        ("CDELT2", 0.1 / 3600.0),
    ] {
        header.push(Card::new(keyword, value, "").unwrap());
    }
    header.push(Card::new("CTYPE1", "RA---TAN", "").unwrap());
    header.push(Card::new("CTYPE2", "DEC--TAN", "").unwrap());
    SkyCoordinates::from_header(&header).unwrap()
}

#[test]
fn sky_coordinates_go_through_the_frames_world_coordinates() {
    let text = "ra,dec,flux\n150,2,3\n330,-2,1\n150,2.001,4\n";
    let result = read(text, &CatalogOptions::new());
    assert_eq!(result.as_ref().unwrap_err().setting(), Some("sky"));
    assert_setting(
        result,
        "\"ra\" and \"dec\" are sky coordinates, but the world coordinates",
    );
    let options = CatalogOptions::new().with_sky(sky());
    let catalog = read(text, &options).unwrap();
    assert_eq!((catalog.stars().len(), catalog.rows_off_projection()), (2, 1));
    let second = catalog.stars()[1].position();
    assert!(
        second.x().abs() < 1e-9 && (second.y() - 36.0).abs() < 1e-6,
        "{second}"
    );
    let scratch = Scratch::new();
    let path = scratch.put("a.csv", text.as_bytes());
    assert_error(
        read_positions_with(&path, &options),
        IoErrorKind::Data,
        ": line 3: the position on the sky is outside the projection",
    );
    let error = read("ra,dec,flux\n1,91,3\n", &options).unwrap_err();
    assert!(chain(&error).contains("declination"), "{error}");
}

#[test]
fn spectra_of_sources_are_read_on_request() {
    let scratch = Scratch::new();
    let path = scratch.put(
        "seds.csv",
        b"x,y,flux,re,n,sed\n1,2,3,0,,red\n4,5,6,2.5,1,blackbody:4000\n7,8,9,0,,powerlaw:-1@z=2\n",
    );
    let plain = read_catalog_with(&path, &CatalogOptions::new()).unwrap();
    assert_eq!(plain.colours(), None);
    let options = CatalogOptions::new().with_colours(true);
    let catalog = read_catalog_with(&path, &options).unwrap();
    assert_eq!((catalog.stars().len(), catalog.galaxies().len()), (2, 1));
    let names = ["red", "powerlaw:-1@z=2", "blackbody:4000"].map(str::to_owned);
    assert_eq!(catalog.colours(), Some(&SourceColours::Names(names.to_vec())));

    let path = scratch.put("teff.csv", b"x,y,flux,teff\n1,2,3,5800\n4,5,6,\n7,8,9,-3\n");
    let error = read_catalog_with(&path, &options).unwrap_err();
    assert!(
        error.to_string().contains("line 3") && error.to_string().contains("teff"),
        "{error}"
    );
    let catalog = read_catalog_with(&path, &options.with_invalid_skipped(true)).unwrap();
    assert_eq!((catalog.stars().len(), catalog.invalid_rows()), (1, 2));
    assert_eq!(
        catalog.colours(),
        Some(&SourceColours::Temperatures(vec![5800.0]))
    );
}

#[test]
fn spectra_are_read_from_fits_tables() {
    let scratch = Scratch::new();
    let row = |x: f64, name: &[u8; 6]| [&f64s(&[x, 2.0, 3.0])[..], name].concat();
    let rows = [row(1.0, b"red   "), row(4.0, b"f.dat\0")].concat();
    let columns = [("x", "D"), ("y", "D"), ("flux", "D"), ("SED", "6A")];
    let path = scratch.put("seds.fits", &fits(&[table("STARS", &columns, 2, &[], &rows)]));
    let catalog = read_catalog_with(&path, &CatalogOptions::new().with_colours(true)).unwrap();
    let names = vec!["red".to_owned(), "f.dat".to_owned()];
    assert_eq!(catalog.colours(), Some(&SourceColours::Names(names)));
    let columns = [("x", "D"), ("y", "D"), ("flux", "D"), ("SED", "D")];
    let rows = f64s(&[1.0, 2.0, 3.0, 4.0]);
    let path = scratch.put("wrong.fits", &fits(&[table("STARS", &columns, 1, &[], &rows)]));
    let error = read_catalog_with(&path, &CatalogOptions::new().with_colours(true)).unwrap_err();
    assert!(error.to_string().contains("texts are needed"), "{error}");
    // Two texts in one row, and a width by which CFITSIO would divide.
    for (form, dimensions) in [
        ("6A3", "COMMENT"),
        ("6A0", "COMMENT"),
        ("6A", "TDIM4   = '(3,2)'"),
        ("6A", "TDIM4   = '(0,2)'"),
    ] {
        let columns = [("x", "D"), ("y", "D"), ("flux", "D"), ("SED", form)];
        let rows = row(1.0, b"red   ");
        let bytes = fits(&[table("STARS", &columns, 1, &[dimensions], &rows)]);
        let path = scratch.put("wide.fits", &bytes);
        let error = read_catalog_with(&path, &CatalogOptions::new().with_colours(true)).unwrap_err();
        assert!(error.to_string().contains("one in each row"), "{error}");
        // The column is not read without colours.
        assert_eq!(
            read_catalog_with(&path, &CatalogOptions::new())
                .unwrap()
                .stars()
                .len(),
            1
        );
    }
}

/// A table of one galaxy, with a value and a unit in one column, as ECSV, FITS and SExtractor write it.
fn one_galaxy(changed: &str, value: f64, unit: &str) -> [Vec<u8>; 3] {
    let columns = [
        ("x", 3.0),
        ("y", 4.0),
        ("flux", 5.0),
        ("re", 2.0),
        ("n", 1.0),
        ("q", 0.5),
        ("angle", 30.0),
    ]
    .map(|(name, plain)| {
        if name == changed {
            (name, value)
        } else {
            (name, plain)
        }
    });
    let unit_of = |name: &str| if name == changed { unit } else { "" };
    let values = columns.map(|(_, value)| value);
    let row = values.map(|value| value.to_string()).join(" ");
    let names = columns.map(|(name, _)| name);
    let entry = |name: &str| match unit_of(name) {
        "" => format!("# - {{name: {name}, datatype: float64}}\n"),
        unit => format!("# - {{name: {name}, unit: {unit}, datatype: float64}}\n"),
    };
    let ecsv = format!(
        "# %ECSV 1.0\n# ---\n# datatype:\n{}# schema: astropy-2.0\n{}\n{row}\n",
        names.map(entry).concat(),
        names.join(" ")
    );
    let mut numbered = names.iter().zip(1..);
    let cards: Vec<String> = numbered
        .clone()
        .filter(|(name, _)| !unit_of(name).is_empty())
        .map(|(name, number)| format!("TUNIT{number}  = '{}'", unit_of(name)))
        .collect();
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    let binary = table("STARS", &names.map(|name| (name, "D")), 1, &cards, &f64s(&values));
    let comment = |(name, number): (&&str, i32)| match unit_of(name) {
        "" => format!("# {number} {name} a column\n"),
        unit => format!("# {number} {name} a column [{unit}]\n"),
    };
    let ascii = format!("{}{row}\n", numbered.by_ref().map(comment).collect::<String>());
    [ecsv.into_bytes(), fits(&[binary]), ascii.into_bytes()]
}

/// A value of a catalogue, and the number that it must be.
type Expected = (fn(&Catalog) -> f64, f64);

#[test]
fn units_are_converted_or_refused_in_every_kind_of_table() {
    let scratch = Scratch::new();
    let flux = |catalog: &Catalog| catalog.galaxies()[0].flux();
    let angle = |catalog: &Catalog| catalog.galaxies()[0].profile().angle_deg();
    let cases: [(&str, f64, &str, Option<Expected>); 9] = [
        ("angle", 0.5, "rad", Some((angle, 0.5_f64.to_degrees()))),
        ("angle", 600.0, "arcmin", Some((angle, 10.0))),
        ("angle", 1.0, "m", None),
        ("flux", 5.0, "mJy", Some((flux, 5e-3))),
        ("flux", 5.0, "Jy", Some((flux, 5.0))),
        ("flux", 5.0, "electron", None),
        ("re", 2.0, "arcsec", None),
        ("x", 3.0, "arcsec", None),
        ("n", 1.0, "pix", None),
    ];
    let options = CatalogOptions::new().with_flux_unit("Jy");
    for (column, value, unit, expected) in cases {
        for (kind, bytes) in ["ecsv", "fits", "cat"]
            .into_iter()
            .zip(one_galaxy(column, value, unit))
        {
            let path = scratch.put(&format!("table.{kind}"), &bytes);
            let read = read_catalog_with(&path, &options);
            let Some((of, wanted)) = expected else {
                let error = read.unwrap_err();
                let place = Place::Column(column.to_owned());
                assert!(
                    error.place() == Some(&place) && error.to_string().contains(unit),
                    "{kind}: {error}"
                );
                continue;
            };
            let found = of(&read.unwrap());
            assert!(
                (found / wanted - 1.0).abs() < 1e-14,
                "{kind}, {column} in {unit}: {found}"
            );
        }
    }
    // Without the unit of an image, fluxes keep theirs, but logarithms are no fluxes.
    for (unit, fits) in [("mJy", true), ("mag", false)] {
        for bytes in one_galaxy("flux", 5.0, unit) {
            let path = scratch.put("table", &bytes);
            assert_eq!(
                read_catalog_with(&path, &CatalogOptions::new()).is_ok(),
                fits,
                "{unit}"
            );
        }
    }
}

#[test]
fn positions_on_the_sky_have_units_too() {
    let ecsv = |ra: &str, dec: &str, values: &str| {
        format!(
            "# %ECSV 1.0\n# ---\n# datatype:\n# - {{name: ra, unit: {ra}, datatype: float64}}\n\
             # - {{name: dec, unit: {dec}, datatype: float64}}\n# - {{name: flux, datatype: float64}}\nra dec flux\n{values}\n"
        )
    };
    let options = CatalogOptions::new().with_sky(sky());
    for (ra, dec, values) in [
        ("hourangle", "deg", "10 2 1"),
        ("arcsec", "arcmin", "540000 120 1"),
        ("mas", "deg", "5.4e8 2 1"),
    ] {
        let catalog = read(&ecsv(ra, dec, values), &options).unwrap();
        let at = catalog.stars()[0].position();
        assert!(at.x().hypot(at.y()) < 1e-6, "{ra}, {dec}: {at}");
    }
    let error = read(&ecsv("pix", "deg", "1 2 3"), &options).unwrap_err();
    assert_eq!(error.place(), Some(&Place::Column("ra".to_owned())));
}

#[test]
fn masked_values_are_missing_and_no_numbers() {
    let ecsv = "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: id, datatype: string}\n# - {name: x, datatype: float64}\n\
                # - {name: y, datatype: float64}\n# - {name: flux, datatype: float64}\nid x y flux\n\
                \"a b\" 1.0 2.0 3.0\nc 1.0 2.0 \"\"\n\"\" 1.0 2.0 5.0\n";
    let csv = "id,x,y,flux\n\"a b\",1.0,2.0,3.0\nc,1.0,2.0,\n,1.0,2.0,5.0\n";
    for text in [ecsv, csv] {
        let error = read(text, &CatalogOptions::new()).unwrap_err();
        assert!(
            matches!(error.place(), Some(Place::Value { column, .. }) if column == "flux"),
            "{error}"
        );
        let catalog = read(text, &CatalogOptions::new().with_invalid_skipped(true)).unwrap();
        assert_eq!((catalog.rows(), catalog.invalid_rows()), (&[0, 2][..], 1));
    }
}

#[test]
fn columns_that_change_a_source_and_are_not_read_are_named() {
    let text = "x,y,flux,pmRA,pmdec,parallax,epoch,sed,vx,vy,note\n1,2,3,4,5,6,2000,a.csv,1,2,0\n";
    let of = |options: CatalogOptions| read(text, &options).unwrap().ignored_columns().join(" ");
    assert_eq!(of(CatalogOptions::new()), "pmRA pmdec parallax epoch sed vx vy");
    let colours = CatalogOptions::new().with_colours(true).with_velocities(true);
    assert_eq!(of(colours), "pmRA pmdec parallax epoch");
    let plain = read("x_0,y_0,flux,id\n1,2,3,4\n", &CatalogOptions::new()).unwrap();
    assert_eq!((plain.ignored_columns().len(), plain.stars().len()), (0, 1));
}

/// World coordinates of a frame that is turned, mirrored or not, with a distortion.
fn turned_sky(mirrored: bool) -> SkyCoordinates {
    let mut header = HeaderCards::new();
    for (keyword, text) in [("CTYPE1", "RA---TAN-SIP"), ("CTYPE2", "DEC--TAN-SIP")] {
        header.push(Card::new(keyword, text, "").unwrap());
    }
    let sign = if mirrored { -1.0 } else { 1.0 };
    for (keyword, value) in [
        ("CRPIX1", 900.0),
        ("CRPIX2", 1100.0),
        ("CRVAL1", 150.0),
        ("CRVAL2", 62.0),
        ("CD1_1", 6e-5),
        ("CD1_2", 4e-5 * sign),
        ("CD2_1", -4e-5),
        ("CD2_2", 5e-5 * sign),
        ("A_2_0", 3e-6),
        ("B_1_1", -2e-6),
    ] {
        header.push(Card::new(keyword, value, "").unwrap());
    }
    header.push(Card::new("A_ORDER", 2, "").unwrap());
    header.push(Card::new("B_ORDER", 2, "").unwrap());
    SkyCoordinates::from_header(&header).unwrap()
}

#[test]
fn shapes_on_the_sky_become_shapes_in_pixels() {
    let (ra, dec) = (150.04_f64, 62.03_f64);
    for mirrored in [false, true] {
        let sky = turned_sky(mirrored);
        let options = CatalogOptions::new().with_sky(sky.clone());
        let profile = |text: &str| read(text, &options).unwrap().galaxies()[0].profile();
        // The pixels of an offset in arcseconds along a position angle, divided by it.
        let along = |pa_deg: f64| {
            let arcsec = 0.01;
            let (east, north) = pa_deg.to_radians().sin_cos();
            let at = |sign: f64| {
                let step = sign * arcsec / 3600.0;
                let position = sky.pixel(ra + step * east / dec.to_radians().cos(), dec + step * north);
                position.unwrap()
            };
            let (low, high) = (at(-0.5), at(0.5));
            [(high.x() - low.x()) / arcsec, (high.y() - low.y()) / arcsec]
        };
        let scale = |v: [f64; 2]| v[0].hypot(v[1]);
        let differs = |angle: f64, v: [f64; 2]| {
            let difference = angle - v[1].atan2(v[0]).to_degrees();
            (difference + 90.0).rem_euclid(180.0) - 90.0
        };
        // A thin galaxy stays along its position angle, within its width.
        let thin = profile(&format!(
            "ra,dec,flux,re_arcsec,n,q,pa_deg\n{ra},{dec},1,2,1,0.01,35\n"
        ));
        assert!((thin.half_light_radius_px() - 2.0 * scale(along(35.0))).abs() < 2e-3);
        assert!(differs(thin.angle_deg(), along(35.0)).abs() < 0.02);
        // All of the ellipse: its area, and both axes of a round one.
        let round = profile(&format!("ra,dec,flux,re_arcsec,n\n{ra},{dec},1,2,1\n"));
        let (north, east) = (along(0.0), along(90.0));
        let area = (east[0] * north[1] - east[1] * north[0]).abs() * 4.0;
        let semi_axes = round.axis_ratio() * round.half_light_radius_px().powi(2);
        assert!((semi_axes / area - 1.0).abs() < 1e-6);
        let thin_area = thin.axis_ratio() * thin.half_light_radius_px().powi(2);
        assert!((thin_area / (0.01 * area) - 1.0).abs() < 1e-6);
        // Positive g1 stretches east-west, positive g2 between north and west.
        for (shear, pa) in [
            ("0.99,0", 90.0),
            ("-0.99,0", 0.0),
            ("0,0.99", -45.0),
            ("0,-0.99", 45.0),
        ] {
            let text = format!("ra,dec,flux,re_arcsec,n,g1,g2\n{ra},{dec},1,0.01,1,{shear}\n");
            assert!(
                differs(profile(&text).angle_deg(), along(pa)).abs() < 0.01,
                "{shear}"
            );
        }
        // The same from a position in pixels.
        let at = sky.pixel(ra, dec).unwrap();
        let (x, y) = (at.x(), at.y());
        let of_pixel = profile(&format!("x,y,flux,re_arcsec,n,q,pa_deg\n{x},{y},1,2,1,0.4,35\n"));
        let of_sky = profile(&format!(
            "ra,dec,flux,re_arcsec,n,q,pa_deg\n{ra},{dec},1,2,1,0.4,35\n"
        ));
        assert!((of_pixel.angle_deg() - of_sky.angle_deg()).abs() < 1e-6);
    }
    let text = "x,y,flux,re_arcsec,n\n1,2,1,2,1\n";
    let error = read(text, &CatalogOptions::new()).unwrap_err().to_string();
    assert!(
        error.contains("re_arcsec") && error.contains("world coordinates"),
        "{error}"
    );
    assert!("re=A,pa_deg=B".parse::<CatalogColumns>().is_err());
}

#[test]
fn sources_move_to_the_date_of_the_frame() {
    let sky = turned_sky(false);
    let still = CatalogOptions::new().with_sky(sky.clone());
    let date = ObservationDate::of_julian_year(2026.0).unwrap();
    let moved = still.clone().with_date(date).with_zero_point(25.0).unwrap();
    let gaia = "ra,dec,pmra,pmdec,parallax,radial_velocity,ref_epoch,phot_g_mean_mag\n\
                150.0,62.0,1000,-2000,,,2016.0,20\n150.0,62.0,,,,,2016.0,20\n";
    let catalog = read(gaia, &moved).unwrap();
    assert!(catalog.ignored_columns().is_empty());
    let [first, second] = [0, 1].map(|star| catalog.stars()[star].position());
    let cos = 62.0_f64.to_radians().cos();
    let wanted = sky
        .pixel(150.0 + 10.0 / 3600.0 / cos, 62.0 - 20.0 / 3600.0)
        .unwrap();
    assert!((first.x() - wanted.x()).hypot(first.y() - wanted.y()) < 0.02);
    let still_there = sky.pixel(150.0, 62.0).unwrap();
    assert!((second.x() - still_there.x()).hypot(second.y() - still_there.y()) < 1e-9);
    // A parallax of one arcsecond moves a star by about as much.
    let near = "ra,dec,parallax,flux\n150.0,62.0,1000,1\n";
    let of_epoch = still.clone().with_date(date).with_epoch(2026.0);
    let at = read(near, &of_epoch).unwrap().stars()[0].position();
    let shift_deg = {
        let (ra, dec) = sky.sky(at).unwrap();
        ((ra - 150.0) * cos).hypot(dec - 62.0)
    };
    assert!((0.4..1.1).contains(&(shift_deg * 3600.0)), "{shift_deg}");
    // The epoch must be known, and both proper motions.
    let error = read(near, &still.clone().with_date(date))
        .unwrap_err()
        .to_string();
    assert!(error.contains("parallax") && error.contains("epoch"), "{error}");
    let half = "ra,dec,pmra,epoch,flux\n150.0,62.0,1,2016,1\n";
    let error = read(half, &of_epoch).unwrap_err().to_string();
    assert!(error.contains("pmdec"), "{error}");
    // Without a date, nothing moves, and the columns are named.
    let ignored = read(near, &still).unwrap();
    assert_eq!(ignored.ignored_columns(), ["parallax"]);
    assert!(ObservationDate::of_julian_year(1800.0).is_none());
    assert!((ObservationDate::of_mjd(51_544.5).unwrap().julian_year() - 2000.0).abs() < 1e-12);
}

//! Images read and written by bands of rows equal whole images, and take the memory of one band.

mod support;

use std::error::Error;
use std::ops::Range;
use std::path::Path;

use ndarray::{Array2, ArrayView2, Axis, array, concatenate, s};
use psf_io::{
    Card, HeaderCards, ImageReader, ImageWriter, IoError, IoErrorKind, Place, read_header, read_image,
    write_image,
};
use psf_types::{DataError, FrameShape, Image, Real};
use support::{IMAGE, SIMPLE, Scratch, assert_error, f32s, f64s, i16s, i32s, image, names};

/// Asserts that a request is refused with this text.
#[track_caller]
fn assert_request<T>(result: Result<T, IoError>, text: &str) {
    assert_error(result, IoErrorKind::Request, &format!(": {text}"));
}

/// The error text for rows that an image does not have.
fn beyond(rows: &Range<usize>, ny: usize) -> String {
    let (first, end) = (rows.start, rows.end);
    format!("the image has {ny} row(s), got the range {first} to {end} (0-based, the end not included)")
}

/// Asserts that `count` undefined pixels are refused, and that the error names the first, `index`.
#[track_caller]
fn assert_undefined<T>(result: Result<T, IoError>, index: [usize; 2], count: usize) {
    let error = result.map(drop).unwrap_err();
    let (hdu, index) = (0, index.to_vec());
    assert_eq!(error.place(), Some(&Place::Pixel { hdu, index }));
    let first = format!("Among the pixels read, {count} pixel(s) are NaN, infinite or BLANK");
    assert_error(Err::<(), _>(error), IoErrorKind::Data, &first);
}

/// Rows per band. The last number is larger than any image here.
const BANDS: [usize; 3] = [1, 7, 1000];

/// Reads the whole image in bands.
fn read_by_bands<T: Real>(path: &Path, rows: usize) -> Array2<T> {
    let mut reader = ImageReader::open(path).unwrap();
    let ny = reader.shape().ny();
    let bands: Vec<Array2<T>> = (0..ny)
        .step_by(rows)
        .map(|first| reader.read_rows(first..ny.min(first + rows)).unwrap())
        .collect();
    let views: Vec<ArrayView2<'_, T>> = bands.iter().map(|band| band.view()).collect();
    concatenate(Axis(0), &views).unwrap()
}

fn write_by_bands<T: Real>(writer: &mut ImageWriter<T>, pixels: ArrayView2<'_, T>, rows: usize) {
    for band in pixels.axis_chunks_iter(Axis(0), rows) {
        writer.write_rows(band).unwrap();
    }
}

/// Values of all magnitudes, including a negative zero and a subnormal number.
fn values<T: Real>(nx: usize, ny: usize) -> Array2<T> {
    let mut values = Array2::from_shape_fn((ny, nx), |(y, x)| {
        T::nearest((x as f64 - 3.5) * 10_f64.powi(y as i32 % 60 - 30))
    });
    values[[0, 0]] = -T::zero();
    values[[ny - 1, nx - 1]] = T::min_positive_value() / T::nearest(4.0);
    values
}

fn shape(nx: usize, ny: usize) -> FrameShape {
    FrameShape::new(nx, ny).unwrap()
}

fn files_in(path: &Path) -> usize {
    std::fs::read_dir(path.parent().unwrap()).unwrap().count()
}

fn assert_bands_are_the_image<T: Real>(path: &Path, what: &str) {
    let whole = read_image::<T>(path).unwrap();
    // Compares bits, because a negative zero differs from a zero.
    let bits = |pixels: ArrayView2<'_, T>| pixels.mapv(|v| v.as_f64().to_bits());
    for rows in BANDS {
        let bands = read_by_bands::<T>(path, rows);
        assert_eq!(
            bits(bands.view()),
            bits(whole.image().pixels()),
            "{what}: {rows} rows as {}",
            T::NAME
        );
    }
    let reader = ImageReader::open(path).unwrap();
    assert_eq!(reader.shape(), whole.image().shape(), "{what}");
    assert_eq!(reader.header(), whole.header(), "{what}");
}

#[test]
fn bands_equal_the_image_for_every_kind_of_file() {
    let (nx, ny) = (13, 23);
    let count = nx * ny;
    let scratch = Scratch::new();
    let cards = ["TELESCOP= 'Roman   '", "CRPIX1  = 10.5", "HISTORY made by hand"];
    let scaled = [
        "BSCALE  = 0.3",
        "BZERO   = 7.1",
        "BLANK   = 5000",
        "OBJECT  = 'sky'",
    ];
    let shorts: Vec<i16> = (0..count as i16).map(|v| 37 * v - 4000).collect();
    let longs: Vec<i32> = (0..count as i32)
        .map(|v| v.wrapping_mul(7_654_321).wrapping_sub(1_000_000_000))
        .collect();
    let floats: Vec<f32> = values::<f32>(nx, ny).iter().copied().collect();
    let doubles: Vec<f64> = values::<f64>(nx, ny).iter().copied().collect();
    let mut extension = image(SIMPLE, 8, &[], &["EXTEND  = T"], &[]);
    extension.extend(image(IMAGE, -32, &[nx, ny], &["EXTNAME = 'SCI'"], &f32s(&floats)));
    let bytes: Vec<u8> = (0..count).map(|v| v as u8).collect();
    let files = [
        ("f32", image(SIMPLE, -32, &[nx, ny], &cards, &f32s(&floats))),
        ("f64", image(SIMPLE, -64, &[nx, ny], &cards, &f64s(&doubles))),
        ("u8", image(SIMPLE, 8, &[nx, ny], &[], &bytes)),
        (
            "i16 scaled",
            image(SIMPLE, 16, &[nx, ny], &scaled, &i16s(&shorts)),
        ),
        ("i32 scaled", image(SIMPLE, 32, &[nx, ny], &scaled, &i32s(&longs))),
        (
            "f32 scaled",
            image(SIMPLE, -32, &[nx, ny], &scaled[..2], &f32s(&floats)),
        ),
        (
            "four axes",
            image(SIMPLE, 16, &[nx, ny, 1, 1], &[], &i16s(&shorts)),
        ),
        ("extension", extension),
    ];
    for (what, bytes) in files {
        let path = scratch.put("a.fits", &bytes);
        assert_bands_are_the_image::<f32>(&path, what);
        assert_bands_are_the_image::<f64>(&path, what);
    }
}

#[test]
fn rows_are_read_in_any_order_into_any_layout() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let pixels = values::<f64>(6, 9);
    let image = Image::new(pixels.clone()).unwrap();
    write_image(&path, &image, &HeaderCards::new(), &[], false).unwrap();
    let mut reader = ImageReader::open(&path).unwrap();
    for rows in [5..9, 0..2, 3..4, 0..2, 9..9, 0..0] {
        let band = reader.read_rows::<f64>(rows.clone()).unwrap();
        assert_eq!(band, pixels.slice(s![rows, ..]));
    }
    // The band may be a part of a larger frame, and its old content must not matter.
    let mut frame = Array2::from_elem((5, 10), f64::NAN);
    reader.read_rows_into(4, frame.slice_mut(s![1..4, 2..8])).unwrap();
    assert_eq!(frame.slice(s![1..4, 2..8]), pixels.slice(s![4..7, ..]));
    assert_eq!(frame.iter().filter(|v| v.is_nan()).count(), 50 - 18);
    let mut turned = Array2::from_elem((6, 3), f64::NAN);
    reader
        .read_rows_into(4, turned.view_mut().reversed_axes())
        .unwrap();
    assert_eq!(turned.t(), pixels.slice(s![4..7, ..]));
}

fn assert_bands_out_are_the_file<T: Real>() {
    let scratch = Scratch::new();
    let (whole, path) = (scratch.path("whole.fits"), scratch.path("bands.fits"));
    let header: HeaderCards = [
        Card::new("CRPIX1", 10.5, "[pix] reference").unwrap(),
        Card::new("VERSION", "old", "").unwrap(),
        Card::new("LONGTEXT", "a text that goes on and on ".repeat(5), "").unwrap(),
    ]
    .into_iter()
    .collect();
    let added = [
        Card::new("VERSION", "new", "").unwrap(),
        Card::history("psfield simulate"),
    ];
    // For 1600 x 40 pixels CFITSIO bypasses its buffers, for 13 x 23 it uses them.
    for (nx, ny) in [(13, 23), (1600, 40), (1, 1), (720, 7)] {
        let image = Image::new(values::<T>(nx, ny)).unwrap();
        write_image(&whole, &image, &header, &added, true).unwrap();
        let bytes = std::fs::read(&whole).unwrap();
        let turned = image.pixels().reversed_axes().as_standard_layout().into_owned();
        for rows in BANDS {
            for pixels in [image.pixels(), turned.t()] {
                let mut writer = ImageWriter::create(&path, image.shape(), &header, &added, true).unwrap();
                write_by_bands(&mut writer, pixels, rows);
                assert_eq!((writer.rows_written(), writer.shape()), (ny, image.shape()));
                writer.finish().unwrap();
                assert!(
                    std::fs::read(&path).unwrap() == bytes,
                    "{nx} x {ny} by {rows} rows"
                );
            }
        }
    }
    assert_eq!(files_in(&path), 2);
}

#[test]
fn a_file_written_by_bands_equals_the_file_of_write_image() {
    assert_bands_out_are_the_file::<f32>();
    assert_bands_out_are_the_file::<f64>();
}

/// Three cards. A late card has the keyword of one of them.
fn early() -> HeaderCards {
    let card = |keyword: &str, value: i64| Card::new(keyword, value, "").unwrap();
    [card("FIRST", 1), card("CHECKED", 0), card("LAST", 3)]
        .into_iter()
        .collect()
}

fn late(count: usize) -> Vec<Card> {
    let numbered = (0..count).map(|i| Card::new(&format!("LATE{i}"), i, "").unwrap());
    std::iter::once(Card::new("CHECKED", 5e-7, "largest difference found").unwrap())
        .chain(numbered)
        .collect()
}

#[test]
fn late_cards_and_early_cards_give_equal_files() {
    let scratch = Scratch::new();
    let (whole, path) = (scratch.path("whole.fits"), scratch.path("bands.fits"));
    // The header's own 8 records, 3 cards and END leave room for 24 records in the first block.
    for (nx, ny) in [(13, 23), (1600, 40), (720, 7)] {
        let image = Image::new(values::<f32>(nx, ny)).unwrap();
        for count in [0, 1, 23, 24, 25, 26, 100] {
            for room in [0, count] {
                let cards = late(count);
                write_image(&whole, &image, &early(), &cards, true).unwrap();
                let mut writer =
                    ImageWriter::create_reserving(&path, image.shape(), &early(), &[], room, true).unwrap();
                write_by_bands(&mut writer, image.pixels(), 7);
                writer.finish_with(&cards).unwrap();
                assert!(
                    std::fs::read(&path).unwrap() == std::fs::read(&whole).unwrap(),
                    "{nx} x {ny}, {count} late cards, room for {room}"
                );
            }
        }
    }
}

#[test]
fn unused_room_and_removed_cards_leave_a_sound_file() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let image = Image::new(values::<f64>(13, 23)).unwrap();
    let long = [Card::new("CHECKED", "to be found out, ".repeat(200), "").unwrap()];
    for (room, added) in [
        (200, &[][..]),
        (200, &long[..]),
        (0, &long[..]),
        (usize::MAX, &[]),
    ] {
        let mut writer =
            ImageWriter::create_reserving(&path, image.shape(), &early(), added, room, true).unwrap();
        write_by_bands(&mut writer, image.pixels(), 7);
        writer.finish_with(&late(1)).unwrap();
        let (back, header) = read_image::<f64>(&path).unwrap().into_parts();
        assert_eq!(back, image);
        let keywords: Vec<String> = header.iter().map(Card::keyword).collect();
        assert_eq!(keywords, ["FIRST", "CHECKED", "LAST", "LATE0"]);
        assert_eq!(header.get("CHECKED").and_then(Card::value), Some(5e-7.into()));
        // There is one END, in the last block of the header, with only blanks around it.
        let bytes = std::fs::read(&path).unwrap();
        let header_length = bytes.len() - (13 * 23 * 8_usize).next_multiple_of(2880);
        let records: Vec<&[u8]> = bytes[..header_length].chunks(80).collect();
        let end = records.iter().position(|r| r.starts_with(b"END     ")).unwrap();
        assert!(records.len() - end <= 36);
        assert!(records[end + 1..].iter().all(|r| r.trim_ascii().is_empty()));
    }
}

#[test]
fn undefined_pixels_of_a_band_are_located_in_the_whole_image() {
    let scratch = Scratch::new();
    let mut values = vec![1.0; 4 * 10];
    values[4 * 6 + 3] = f64::NAN;
    values[4 * 7 + 1] = f64::INFINITY;
    values[4 * 9] = f64::NEG_INFINITY;
    let singles: Vec<f32> = values.iter().map(|&v| v as f32).collect();
    let shorts: Vec<i16> = values
        .iter()
        .map(|v| if v.is_finite() { 1 } else { -9 })
        .collect();
    let scaled = ["BLANK   = -9", "BSCALE  = 2.0"];
    let files = [
        image(SIMPLE, -64, &[4, 10], &[], &f64s(&values)),
        image(SIMPLE, -32, &[4, 10], &[], &f32s(&singles)),
        image(SIMPLE, 16, &[4, 10], &scaled, &i16s(&shorts)),
    ];
    for bytes in files {
        let path = scratch.put("a.fits", &bytes);
        let mut reader = ImageReader::open(&path).unwrap();
        assert!(reader.read_rows::<f32>(0..6).is_ok());
        assert_undefined(reader.read_rows::<f32>(5..9), [6, 3], 2);
        assert_undefined(reader.read_rows::<f64>(7..8), [7, 1], 1);
        // The error also occurs if the rows are not contiguous in memory.
        let mut frame = Array2::<f32>::zeros((3, 8));
        let refused = reader.read_rows_into(7, frame.slice_mut(s![.., ..;2]));
        assert_undefined(refused, [7, 1], 2);
        // A reader can be used after an error.
        assert_eq!(reader.read_rows::<f64>(8..9).unwrap().ncols(), 4);
    }
    let path = scratch.put(
        "a.fits",
        &image(SIMPLE, -64, &[2, 2], &[], &f64s(&[1.0, 2.0, 3.0, 1e300])),
    );
    let mut reader = ImageReader::open(&path).unwrap();
    assert_eq!(reader.read_rows::<f32>(0..1).unwrap(), array![[1.0, 2.0]]);
    assert_error(
        reader.read_rows::<f32>(1..2),
        IoErrorKind::Limit,
        "single precision",
    );
    assert_eq!(reader.read_rows::<f64>(1..2).unwrap(), array![[3.0, 1e300]]);
}

#[test]
fn rows_outside_the_image_are_refused() {
    let scratch = Scratch::new();
    let path = scratch.put("a.fits", &image(SIMPLE, 8, &[2, 3], &[], &[0; 6]));
    let mut reader = ImageReader::open(&path).unwrap();
    #[expect(clippy::reversed_empty_ranges, reason = "these ranges must be refused")]
    for bad in [0..4, 3..4, 4..4, 2..1, usize::MAX..0, 0..usize::MAX] {
        let error = reader.read_rows::<f32>(bad.clone()).unwrap_err();
        assert!(names(&error, &path));
        assert_request(Err::<(), _>(error), &beyond(&bad, 3));
    }
    let mut band = Array2::<f32>::zeros((2, 2));
    for first in [2, usize::MAX] {
        let refused = reader.read_rows_into(first, band.view_mut());
        assert_request(refused, &beyond(&(first..first.saturating_add(2)), 3));
    }
    let mut narrow = Array2::<f32>::zeros((1, 1));
    let refused = reader.read_rows_into(0, narrow.view_mut());
    assert_request(
        refused,
        "a band of rows must have the 2 columns of the image, got 1",
    );
}

#[test]
fn files_that_read_image_refuses_are_not_opened() {
    let scratch = Scratch::new();
    let files = [
        image(SIMPLE, 8, &[2, 1, 3], &[], &[0; 6]),
        image(SIMPLE, 8, &[5], &[], &[0; 5]),
        image(SIMPLE, 8, &[], &[], &[]),
        image(SIMPLE, -32, &[1000, 1000], &[], &[0; 100]),
        b"x,y\n1,2\n".to_vec(),
        b"\x1f\x8b\x08\x00 and so on".to_vec(),
    ];
    for bytes in files {
        let path = scratch.put("a.fits", &bytes);
        let (whole, bands) = (
            read_image::<f32>(&path).unwrap_err(),
            ImageReader::open(&path).unwrap_err(),
        );
        assert_eq!(whole.to_string(), bands.to_string());
        assert!(names(&bands, &path));
    }
}

#[test]
fn bad_bands_are_refused_and_good_ones_may_follow() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let pixels = values::<f32>(4, 5);
    let mut writer = ImageWriter::create(&path, shape(4, 5), &HeaderCards::new(), &[], false).unwrap();
    writer.write_rows(pixels.slice(s![..2, ..])).unwrap();

    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut band = pixels.slice(s![2..4, ..]).to_owned();
        band[[1, 3]] = bad;
        let turned = band.t().as_standard_layout().into_owned();
        for band in [band.view(), turned.t()] {
            let error = writer.write_rows(band).unwrap_err();
            assert_eq!((error.kind(), error.path()), (IoErrorKind::Data, &*path));
            let cause = error.source().and_then(|source| source.downcast_ref());
            assert!(matches!(cause, Some(DataError::NonFinite { index, .. }) if *index == [3, 3]));
        }
    }
    let wide = writer.write_rows(Array2::zeros((1, 5)).view());
    assert_request(wide, "a band of rows must have the 4 columns of the image, got 5");
    let many = writer.write_rows(Array2::zeros((4, 4)).view());
    assert_request(many, &beyond(&(2..6), 5));
    assert_eq!(writer.rows_written(), 2);

    writer.write_rows(pixels.slice(s![2.., ..])).unwrap();
    writer.write_rows(Array2::zeros((0, 4)).view()).unwrap();
    let more = writer.write_rows(Array2::zeros((1, 4)).view());
    assert_request(more, &beyond(&(5..6), 5));
    writer.finish().unwrap();
    assert_eq!(read_image::<f32>(&path).unwrap().image().pixels(), pixels);
}

#[test]
fn an_image_that_is_not_finished_leaves_nothing_behind() {
    let scratch = Scratch::new();
    let path = scratch.put("a.fits", b"the old file");
    let create = |path: &Path, overwrite| {
        ImageWriter::<f64>::create(path, shape(100, 100), &HeaderCards::new(), &[], overwrite)
    };
    assert_error(create(&path, false), IoErrorKind::Exists, "exists");
    let missing = scratch.path("none").join("a.fits");
    assert_error(
        create(&missing, false),
        IoErrorKind::NotFound,
        "there is no directory",
    );

    for rows in [0, 1, 60] {
        let mut writer = create(&path, true).unwrap();
        writer.write_rows(Array2::zeros((rows, 100)).view()).unwrap();
        assert_eq!(files_in(&path), 2);
        drop(writer);
        assert_eq!(files_in(&path), 1);

        let mut writer = create(&path, true).unwrap();
        writer.write_rows(Array2::zeros((rows, 100)).view()).unwrap();
        assert_request(
            writer.finish_with(&late(2)),
            &format!("the image has 100 rows, but only {rows} were written: write the rest first"),
        );
        assert_eq!(files_in(&path), 1);
    }
    let mut complete = create(&path, true).unwrap();
    complete.write_rows(Array2::zeros((100, 100)).view()).unwrap();
    drop(complete);
    assert_eq!(std::fs::read(&path).unwrap(), b"the old file");

    // A file that appears while the image is written is kept as well.
    let other = scratch.path("b.fits");
    let mut writer = create(&other, false).unwrap();
    writer.write_rows(Array2::zeros((100, 100)).view()).unwrap();
    std::fs::write(&other, "theirs").unwrap();
    assert_error(writer.finish(), IoErrorKind::Exists, "exists");
    assert_eq!(std::fs::read(&other).unwrap(), b"theirs");
    assert_eq!(files_in(&other), 2);
}

/// The longest time allowed to discard an unfinished image, which takes milliseconds. Filling 8 GB
/// with zeros, as CFITSIO would do, takes longer on any disk.
const DISCARD_S: f64 = 2.0;

#[test]
fn a_huge_unfinished_image_is_discarded_at_once() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    for room in [0, 100] {
        let mut writer =
            ImageWriter::<f64>::create_reserving(&path, shape(1_000_000, 1000), &early(), &[], room, false)
                .unwrap();
        writer.write_rows(Array2::zeros((3, 1_000_000)).view()).unwrap();
        let started = std::time::Instant::now();
        drop(writer);
        let taken = started.elapsed().as_secs_f64();
        assert!(taken < DISCARD_S, "{taken} s");
    }
    assert!(
        std::fs::read_dir(path.parent().unwrap())
            .unwrap()
            .next()
            .is_none()
    );
}

#[test]
fn bands_go_from_one_file_to_another_while_both_are_open() {
    let scratch = Scratch::new();
    let (from, to) = (scratch.path("from.fits"), scratch.path("to.fits"));
    let image = Image::new(values::<f32>(50, 60)).unwrap();
    write_image(&from, &image, &early(), &[], false).unwrap();
    let mut reader = ImageReader::open(&from).unwrap();
    let mut writer = ImageWriter::create(&to, reader.shape(), reader.header(), &[], false).unwrap();
    let mut band = Array2::<f32>::zeros((8, 50));
    for first in (0..60).step_by(8) {
        let mut part = band.slice_mut(s![..8.min(60 - first), ..]);
        reader.read_rows_into(first, part.view_mut()).unwrap();
        writer.write_rows(part.view()).unwrap();
    }
    writer.finish().unwrap();
    assert_eq!(std::fs::read(&from).unwrap(), std::fs::read(&to).unwrap());
    assert_eq!(&read_header(&to).unwrap(), reader.header());
}

#[test]
fn planes_of_a_cube_are_images() {
    let scratch = Scratch::new();
    let path = scratch.path("cube.fits");
    let cube = ndarray::Array3::from_shape_fn((3, 5, 4), |(k, y, x)| (100 * k + 10 * y + x) as f64);
    psf_io::write_cube(&path, cube.view(), &[], false).unwrap();
    for (k, plane) in cube.outer_iter().enumerate() {
        let mut reader = ImageReader::open_plane(&path, None, k).unwrap();
        assert_eq!(reader.shape(), FrameShape::new(4, 5).unwrap());
        assert_eq!(reader.read_rows::<f64>(2..5).unwrap(), plane.slice(s![2.., ..]));
        assert_eq!(reader.read_rows_with_undefined(0..5).unwrap(), plane);
    }
    assert_request(
        ImageReader::open_plane(&path, None, 3),
        "there is no plane 3: the image has 3 plane(s), counted from 0",
    );
}

#[test]
fn undefined_pixels_are_returned_only_on_request() {
    let scratch = Scratch::new();
    let values = [1.0, f32::NAN, 3.0, f32::INFINITY];
    let path = scratch.put("a.fits", &image(SIMPLE, -32, &[2, 2], &[], &f32s(&values)));
    let mut reader = ImageReader::open(&path).unwrap();
    assert_undefined(reader.read_rows::<f64>(0..2), [0, 1], 2);
    let seen = reader.read_rows_with_undefined(0..2).unwrap();
    assert!(seen[[0, 1]].is_nan());
    assert_eq!(
        (seen[[0, 0]], seen[[1, 0]], seen[[1, 1]]),
        (1.0, 3.0, f64::INFINITY)
    );
    assert!(reader.read_rows_with_undefined(1..3).is_err());
}

#[test]
fn nan_pixels_become_a_number_and_are_counted_once() {
    let scratch = Scratch::new();
    let values: Vec<f32> = vec![1.0, f32::NAN, 3.0, 4.0, f32::NAN, f32::NAN];
    let path = scratch.put("nan.fits", &image(SIMPLE, -32, &[2, 3], &[], &f32s(&values)));
    let mut reader = ImageReader::open(&path).unwrap().with_nan_as(Some(-7.5));
    for row in [0, 1, 0, 2, 1] {
        let read = reader.read_rows::<f64>(row..row + 1).unwrap();
        let expected = |value: f32| if value.is_nan() { -7.5 } else { f64::from(value) };
        assert_eq!(
            read.row(0).to_vec(),
            [expected(values[2 * row]), expected(values[2 * row + 1])]
        );
    }
    assert_eq!(reader.nan_pixels(), 3);
    // Infinite pixels stay errors, and without the setting NaN is one.
    let path = scratch.put(
        "inf.fits",
        &image(SIMPLE, -32, &[2, 1], &[], &f32s(&[f32::NAN, f32::INFINITY])),
    );
    for (nan_as, first) in [(None, 0), (Some(0.0), 1)] {
        let mut reader = ImageReader::open(&path).unwrap().with_nan_as(nan_as);
        let (error, count) = (reader.read_rows::<f32>(0..1), 2 - first);
        assert_error(error, IoErrorKind::Data, &format!("HDU 0, pixel [0, {first}] ("));
        let error = reader.read_rows::<f32>(0..1).unwrap_err().to_string();
        assert!(error.contains(&format!("{count} pixel(s)")), "{error}");
        let error = Err::<(), _>(reader.undefined_error(|[_, x]| x == 1));
        assert_error(error, IoErrorKind::Data, "HDU 0, pixel [0, 1] (");
    }
}

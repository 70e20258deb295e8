//! Images in tiles of `RICE_1`, from CFITSIO, from astropy and from an encoder of these tests.
//! Sound tiles are read, and tiles that end too early are refused.

mod support;

use std::path::{Path, PathBuf};

use fitsio::FitsFile;
use fitsio::images::{ImageDescription, ImageType, WriteImage};
use ndarray::Array2;
use proptest::prelude::*;
use psf_io::{HduChoice, IoError, Place, read_image, read_image_hdu};
use support::{SIMPLE, Scratch, hdu, i32s, image};

const NX: usize = 70;
const NY: usize = 60;
/// Shapes of tiles: rows, single columns, tiles cut by the edges, and the whole image.
const SHAPES: [&str; 6] = ["", " 70,7", " 1,60", " 33,20", " 31,1", " 70,60"];
/// Step of quantised floats, independent of their noise.
const FIXED_STEP: f32 = 0.5;
/// Seed of the noise.
const SEED: u32 = 12345;

/// Bits without a repeating pattern.
fn noise(count: usize) -> impl Iterator<Item = u32> {
    let next = |state: &u32| Some(state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    std::iter::successors(Some(SEED), next)
        .skip(1)
        .map(|state| state >> 8)
        .take(count)
}

/// 16-bit scenes in which blocks have all codes: equal pixels, noise of a few bits with rare
/// outliers, and noise of all bits.
fn scenes() -> [Vec<i32>; 4] {
    let of = |value: fn(usize, i32) -> i32| {
        noise(NX * NY)
            .enumerate()
            .map(|(i, bits)| value(i, bits as i32))
            .collect()
    };
    [
        of(|_, _| 7),
        of(|_, bits| 100 + bits % 11 + if bits % 97 == 0 { 20_000 } else { 0 }),
        of(|_, bits| bits % 65_536 - 32_768),
        of(|i, bits| (bits % 65_536 - 32_768) >> (i / 500 * 2).min(15)),
    ]
}

/// Writes an image through CFITSIO, in tiles of this shape.
fn written<T: WriteImage>(path: &Path, how: &str, data_type: ImageType, values: &[T]) -> PathBuf {
    let description = ImageDescription {
        data_type,
        dimensions: &[NY, NX],
    };
    let mut file = FitsFile::create(format!("{}[compress R{how}]", path.display()))
        .with_custom_primary(&description)
        .open()
        .unwrap();
    let hdu = file.hdu(1).unwrap();
    hdu.write_image(&mut file, values).unwrap();
    drop(file);
    assert!(
        std::fs::read(path)
            .unwrap()
            .windows(5)
            .any(|word| word == b"RICE_"),
        "{how} compresses"
    );
    path.to_owned()
}

fn pixels(path: &Path) -> Result<Array2<f64>, IoError> {
    read_image::<f64>(path).map(|read| read.into_parts().0.into_pixels())
}

#[test]
fn tiles_of_cfitsio_are_read() {
    let scratch = Scratch::new();
    for (number, scene) in scenes().iter().enumerate() {
        for shape in SHAPES {
            let path = |kind: &str| scratch.path(&format!("{kind}{number}{shape}.fits"));
            let is = |path: PathBuf, expected: &[f64]| {
                let read = pixels(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
                assert!(read.iter().eq(expected), "{}", path.display());
            };
            let bytes: Vec<u8> = scene.iter().map(|&value| value as u8).collect();
            let shorts: Vec<i16> = scene.iter().map(|&value| value as i16).collect();
            let longs: Vec<i32> = scene.iter().map(|&value| value.wrapping_mul(65_537)).collect();
            let expected: Vec<f64> = bytes.iter().map(|&value| value.into()).collect();
            is(
                written(&path("u8"), shape, ImageType::UnsignedByte, &bytes),
                &expected,
            );
            let expected: Vec<f64> = shorts.iter().map(|&value| value.into()).collect();
            is(written(&path("i16"), shape, ImageType::Short, &shorts), &expected);
            let expected: Vec<f64> = longs.iter().map(|&value| value.into()).collect();
            is(written(&path("i32"), shape, ImageType::Long, &longs), &expected);
        }
    }
}

#[test]
fn quantised_floats_of_cfitsio_are_read() {
    let scratch = Scratch::new();
    for (number, scene) in scenes().iter().enumerate() {
        for shape in SHAPES {
            let floats: Vec<f32> = scene.iter().map(|&value| value as f32 + 0.25).collect();
            for quantised in ["; q 16", "; qz 4", &format!("; q -{FIXED_STEP}")] {
                let name = format!("{number}{shape}{quantised}.fits");
                let how = format!("{shape}{quantised}");
                let path = written(&scratch.path(&name), &how, ImageType::Float, &floats);
                let read = pixels(&path).unwrap_or_else(|e| panic!("{name}: {e}"));
                // No other scene is within this limit. compressed.rs tests the size of a step.
                let range = f64::from(*scene.iter().max().unwrap() - *scene.iter().min().unwrap());
                let most = range / 4.0 + f64::from(FIXED_STEP);
                let near = |(got, &value): (&f64, &f32)| (got - f64::from(value)).abs() <= most;
                assert!(read.iter().zip(&floats).all(near), "{name}");
            }
        }
    }
}

/// The file holds images of astropy with other block sizes than CFITSIO's. Each follows its
/// uncompressed pixels (`data/rice_blocks.py`).
#[test]
fn tiles_of_astropy_are_read() {
    let scratch = Scratch::new();
    let path = scratch.put("blocks.fits.gz", include_bytes!("data/rice_blocks.fits.gz"));
    let read = |number: usize| {
        let choice = HduChoice::Number(number);
        let read = read_image_hdu::<f64>(&path, Some(&choice));
        read.unwrap_or_else(|e| panic!("HDU {number}: {e}"))
            .into_parts()
            .0
            .into_pixels()
    };
    for pair in 0..ASTROPY_PAIRS {
        assert_eq!(read(2 * pair + 2), read(2 * pair + 1), "pair {pair}");
    }
}

/// The number of images: pixels of 1, 2 and 4 bytes, each in blocks of 16 and 32.
const ASTROPY_PAIRS: usize = 6;

/// The code that the tests' encoder uses for a block.
#[derive(Debug, Clone, Copy)]
enum Code {
    /// Uncoded differences.
    Plain,
    /// This number of low bits. The high bits are stored as a run of zeros.
    Low(u32),
}

/// A tile of `RICE_1` according to the standard. `codes` are used for the blocks in turn. Blocks of
/// equal pixels have their own code.
fn encoded(pixels: &[i32], pixel_bytes: u32, block: usize, codes: &[Code]) -> Vec<u8> {
    let pixel_bits = 8 * pixel_bytes;
    let (head_bits, plain) = match pixel_bytes {
        1 => (3, 7),
        2 => (4, 15),
        _ => (5, 26),
    };
    let mut bits = Vec::new();
    let mut put = |value: u64, count: u32| {
        let set = |bit| value.checked_shr(bit).unwrap_or(0) & 1 == 1;
        bits.extend((0..count).rev().map(set));
    };
    let mask = (1_u64 << pixel_bits) - 1;
    put(pixels[0] as u64 & mask, pixel_bits);
    let mut last = pixels[0];
    for (number, block) in pixels.chunks(block).enumerate() {
        let differences: Vec<u64> = block
            .iter()
            .map(|&pixel| {
                let unused = 32 - pixel_bits;
                let difference = i64::from(pixel.wrapping_sub(last) << unused >> unused);
                last = pixel;
                (if difference < 0 {
                    !(2 * difference)
                } else {
                    2 * difference
                }) as u64
            })
            .collect();
        if differences.iter().all(|&difference| difference == 0) {
            put(0, head_bits);
            continue;
        }
        match codes[number % codes.len()] {
            Code::Plain => {
                put(plain, head_bits);
                for &difference in &differences {
                    put(difference, pixel_bits);
                }
            }
            Code::Low(low) => {
                put(u64::from(low) + 1, head_bits);
                for &difference in &differences {
                    put(0, (difference >> low) as u32);
                    put(1, 1);
                    put(difference, low);
                }
            }
        }
    }
    bits.chunks(8)
        .map(|byte| {
            byte.iter()
                .enumerate()
                .fold(0, |sum, (i, &bit)| sum | u8::from(bit) << (7 - i))
        })
        .collect()
}

/// An image of a single tile.
fn one_tile(nx: usize, pixel_bytes: u32, block: usize, tile: &[u8]) -> Vec<u8> {
    let cards = [
        "XTENSION= 'BINTABLE'".to_owned(),
        "BITPIX  = 8".to_owned(),
        "NAXIS   = 2".to_owned(),
        "NAXIS1  = 8".to_owned(),
        "NAXIS2  = 1".to_owned(),
        format!("PCOUNT  = {}", tile.len()),
        "GCOUNT  = 1".to_owned(),
        "TFIELDS = 1".to_owned(),
        "TTYPE1  = 'COMPRESSED_DATA'".to_owned(),
        "TFORM1  = '1PB'".to_owned(),
        "ZIMAGE  = T".to_owned(),
        format!("ZBITPIX = {}", 8 * pixel_bytes),
        "ZNAXIS  = 2".to_owned(),
        format!("ZNAXIS1 = {nx}"),
        "ZNAXIS2 = 1".to_owned(),
        "ZCMPTYPE= 'RICE_1'".to_owned(),
        "ZNAME1  = 'BLOCKSIZE'".to_owned(),
        format!("ZVAL1   = {block}"),
        "ZNAME2  = 'BYTEPIX'".to_owned(),
        format!("ZVAL2   = {pixel_bytes}"),
    ];
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    let data = [i32s(&[tile.len() as i32, 0]), tile.to_vec()].concat();
    let mut bytes = image(SIMPLE, 8, &[], &["EXTEND  = T"], &[]);
    bytes.extend(hdu(&cards, &data));
    bytes
}

/// A pixel size in bytes, and pixels: random walks with limited steps and pauses.
fn walks() -> impl Strategy<Value = (u32, Vec<i32>)> {
    let steps = prop::collection::vec((0_u32..4, any::<i32>()), 1..150);
    (prop::sample::select(vec![1_u32, 2, 4]), 0_u32..9, steps).prop_map(|(bytes, size, steps)| {
        let unused = 32 - 8 * bytes;
        let mut value = 0_i32;
        let walk = steps.iter().map(|&(kind, step)| {
            let step = if kind == 0 { 0 } else { step >> (31 - size) };
            value = value.wrapping_add(step);
            // Bytes are unsigned.
            if bytes == 1 {
                value & 0xff
            } else {
                value << unused >> unused
            }
        });
        (bytes, walk.collect())
    })
}

fn codes(pixel_bytes: u32) -> impl Strategy<Value = Vec<Code>> {
    let largest = [0_u32, 5, 13, 0, 24][pixel_bytes as usize];
    let code = prop_oneof![1 => Just(Code::Plain), 4 => (0..=largest).prop_map(Code::Low)];
    prop::collection::vec(code, 1..8)
}

proptest! {
    #[test]
    fn every_code_is_followed_to_its_last_byte(
        ((pixel_bytes, walk), codes) in walks().prop_flat_map(|of| (codes(of.0), Just(of)).prop_map(|(codes, of)| (of, codes))),
        block in prop::sample::select(vec![1_usize, 2, 7, 16, 32, 64, 1024]),
        more in 0_usize..3,
        part in 0.0..1.0,
    ) {
        let scratch = Scratch::new();
        let tile = encoded(&walk, pixel_bytes, block, &codes);
        let read = |tile: &[u8]| pixels(&scratch.put("tile.fits", &one_tile(walk.len(), pixel_bytes, block, tile)));
        // CFITSIO decodes the output of the encoder. Bytes after it do not matter.
        let whole = read(&[&tile[..], &vec![0xff; more]].concat()).unwrap();
        prop_assert!(whole.iter().copied().eq(walk.iter().map(|&pixel| f64::from(pixel))));
        for length in [tile.len() - 1, (part * tile.len() as f64) as usize, 1] {
            let error = read(&tile[..length]).unwrap_err();
            let refused = error.place() == Some(&Place::Tile { hdu: 1, tile: 0 });
            prop_assert!(refused, "{length} of {} bytes", tile.len());
        }
    }
}

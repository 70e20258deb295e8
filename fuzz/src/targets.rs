//! One target for each reader.

mod case;
mod descriptions;
mod images;
mod psf;
mod tables;

pub use descriptions::{detector, records, telescope};
pub use images::{compressed, gzip, image, sky};
pub use psf::{model, psfex, samples, scopesim, stamp_cube, stdpsf, stpsf};
pub use tables::{catalog, curve};

use crate::seeds;

/// A target and its seed files.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// The name in `fuzz_targets/`.
    pub name: &'static str,
    /// Reads the bytes in several ways and returns the number of reads that succeeded.
    pub run: fn(&[u8]) -> usize,
    /// Returns valid files.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets.
pub const TARGETS: &[Target] = &[
    Target {
        name: "image",
        run: image,
        seeds: seeds::images,
    },
    Target {
        name: "compressed",
        run: compressed,
        seeds: seeds::tiled,
    },
    Target {
        name: "gzip",
        run: gzip,
        seeds: seeds::zipped,
    },
    Target {
        name: "samples",
        run: samples,
        seeds: seeds::samples,
    },
    Target {
        name: "model",
        run: model,
        seeds: seeds::models,
    },
    Target {
        name: "psfex",
        run: psfex,
        seeds: seeds::psfex,
    },
    Target {
        name: "stpsf",
        run: stpsf,
        seeds: seeds::stpsf,
    },
    Target {
        name: "stdpsf",
        run: stdpsf,
        seeds: seeds::stdpsf,
    },
    Target {
        name: "scopesim",
        run: scopesim,
        seeds: seeds::scopesim,
    },
    Target {
        name: "stamp_cube",
        run: stamp_cube,
        seeds: seeds::stamp_cubes,
    },
    Target {
        name: "catalog",
        run: catalog,
        seeds: seeds::catalogs,
    },
    Target {
        name: "curve",
        run: curve,
        seeds: seeds::curves,
    },
    Target {
        name: "sky",
        run: sky,
        seeds: seeds::sky,
    },
    Target {
        name: "records",
        run: records,
        seeds: seeds::records,
    },
    Target {
        name: "telescope",
        run: telescope,
        seeds: seeds::telescopes,
    },
    Target {
        name: "detector",
        run: detector,
        seeds: seeds::detectors,
    },
];

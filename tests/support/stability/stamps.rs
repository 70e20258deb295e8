//! Extreme stamps and samples.

use ndarray::Array2;
use psfield::fit::fit;
use psfield::psf_basis::{Centring, RankSelection};
use psfield::psf_types::{Interpolation, PsfSamples};
use psfield::{FitOptions, Method, PsfieldError};

use super::images::{Light, PRECISIONS, Precision, error, error_where};
use super::models::{
    FRAME, PATCH, SIDE, as_they_are, full, gaussian, gaussians, jumping, lattice, random, samples,
};
use super::scenes::{COLUMNS, uneven_of};
use super::{Case, Cell, Section};

/// Brightness of the wings, relative to the core.
const WING: f64 = 1e-10;
/// The frame of these cases. It is so small that patches of one pixel are affordable.
const SMALL: (usize, usize) = (48, 40);

/// A kind of samples, the options of its fit, and its number of components in addition to the mean.
pub(crate) struct Kind {
    pub(crate) name: &'static str,
    pub(crate) samples: fn() -> Result<PsfSamples, PsfieldError>,
    pub(crate) options: FitOptions,
    /// None if the spectrum falls below rounding before the samples end.
    pub(crate) components: Option<usize>,
}

fn grid() -> Vec<(f64, f64)> {
    lattice((5, 5), ((SMALL.0 - 1) as f64, (SMALL.1 - 1) as f64))
}

/// Samples on a grid of 5 x 5, whose stamps depend on the number of the sample.
fn on_grid(dim: (usize, usize), stamp: impl Fn(usize) -> Array2<f64>) -> Result<PsfSamples, PsfieldError> {
    samples(&grid(), dim, stamp)
}

fn winged(j: usize) -> Array2<f64> {
    gaussian((SIDE, SIDE), 0.1 + 0.01 * (j % 5) as f64, 0.04 * j as f64).mapv(|v| v.max(WING))
}

fn blend(share: f64) -> Array2<f64> {
    gaussian((SIDE, SIDE), 0.0, 0.0) * (1.0 - share) + gaussian((SIDE, SIDE), 1.0, 0.3) * share
}

fn noisy(j: usize) -> Array2<f64> {
    let mut noise = random(100 + j as u64);
    let stamp = gaussian((SIDE, SIDE), 0.04 * j as f64, 0.5);
    let level = 1e-2 * stamp[[SIDE / 2, SIDE / 2]];
    stamp.mapv(|v| v + level * (2.0 * noise() - 1.0))
}

pub(crate) fn kinds() -> Vec<Kind> {
    let kind = |name, samples, components| Kind {
        name,
        samples,
        options: full(Interpolation::Bilinear),
        components,
    };
    let keep = |kind: Kind| Kind {
        options: as_they_are(Interpolation::Bilinear),
        ..kind
    };
    vec![
        kind(
            "Gaussians that change smoothly",
            || gaussians(&grid(), SIDE),
            None,
        ),
        keep(kind(
            "one-pixel stamps of flux 0.5 to 1.5",
            || on_grid((1, 1), |j| Array2::from_elem((1, 1), 0.5 + j as f64 / 24.0)),
            Some(1),
        )),
        kind(
            "one-pixel stamps of unit flux",
            || on_grid((1, 1), |_| Array2::ones((1, 1))),
            Some(0),
        ),
        kind("wings of 1e-10", || on_grid((SIDE, SIDE), winged), None),
        kind(
            "identical samples",
            || on_grid((SIDE, SIDE), |_| blend(0.3)),
            Some(0),
        ),
        kind(
            "identical except for 1e-12",
            || on_grid((SIDE, SIDE), |j| blend(1e-12 * j as f64)),
            Some(1),
        ),
        kind(
            "25 samples of rank 2",
            || on_grid((SIDE, SIDE), |j| blend(j as f64 / 24.0)),
            Some(1),
        ),
        kind(
            "noise of 1e-2 of the peak, K = samples - 1",
            || on_grid((SIDE, SIDE), noisy),
            Some(24),
        ),
        keep(kind(
            "noise of 1e-2 of the peak, K = samples",
            || on_grid((SIDE, SIDE), noisy),
            Some(25),
        )),
        kind(
            "cores of one pixel next to wide ones",
            || {
                on_grid((SIDE, SIDE), |j| {
                    let mut stamp = Array2::zeros((SIDE, SIDE));
                    stamp[[SIDE / 2, SIDE / 2]] = 1.0;
                    if j % 2 == 0 { stamp } else { blend(1.0) }
                })
            },
            Some(1),
        ),
        kind(
            "negative rings",
            || {
                on_grid((SIDE, SIDE), |j| {
                    gaussian((SIDE, SIDE), 0.1, 0.04 * j as f64) * 2.0 - blend(1.0)
                })
            },
            None,
        ),
        kind(
            "stamps of 8 x 6 pixels",
            || on_grid((6, 8), |j| gaussian((6, 8), 0.02 * j as f64, 0.3)),
            None,
        ),
        kind(
            "stamps larger than the frame",
            || {
                on_grid((61, 61), |j| {
                    gaussian((61, 61), 3.0 + 0.1 * j as f64, 0.04 * j as f64)
                })
            },
            None,
        ),
        keep(kind(
            "stamps of flux 1e-20",
            || on_grid((SIDE, SIDE), |j| 1e-20 * blend(j as f64 / 24.0)),
            Some(2),
        )),
        keep(kind(
            "stamps of flux 1e20",
            || on_grid((SIDE, SIDE), |j| 1e20 * blend(j as f64 / 24.0)),
            Some(2),
        )),
    ]
}

/// The methods. Patches have one pixel, so each has its own PSF.
const METHODS: [Method; 5] = [
    Method::Direct,
    Method::Basis,
    Method::Patch(1),
    Method::LowRank,
    Method::Auto,
];

/// A pixel sums as many rounded patches as a stamp has pixels. The error grows with the root of
/// that number.
const OF_MANY_PATCHES: f64 = 5.0;

fn row(
    name: String,
    make: impl Fn() -> Result<psfield::psf_types::PsfModel, PsfieldError> + Send + Sync + 'static,
    (frame, methods): ((usize, usize), [Method; 5]),
    precision: Precision,
) -> Case {
    Case::new(format!("{name}, {}", precision.name()), move || {
        let light = Light::of(uneven_of(frame)).scaled(1.0, precision);
        methods
            .map(|method| {
                let got = make().and_then(|model| error(&model, &light, (method, precision)));
                let many = if method == Method::Patch(1) {
                    OF_MANY_PATCHES
                } else {
                    1.0
                };
                Cell::error(got, many * precision.rounding())
            })
            .to_vec()
    })
}

pub(super) fn section() -> Section {
    let mut cases = Vec::new();
    for kind in kinds() {
        for precision in PRECISIONS {
            let (samples, options) = (kind.samples, kind.options);
            let make = move || fit(samples()?, &options)?.into_model();
            cases.push(row(kind.name.to_owned(), make, (SMALL, METHODS), precision));
        }
    }
    let one = [
        ("K = 1", Centring::Mean),
        ("K = 1 without a mean stamp", Centring::None),
    ];
    for (name, centring) in one {
        for precision in PRECISIONS {
            let make = move || {
                let options = FitOptions {
                    rank: RankSelection::Fixed(1),
                    centring,
                    ..full(Interpolation::Bilinear)
                };
                fit(gaussians(&grid(), SIDE)?, &options)?.into_model()
            };
            cases.push(row(name.to_owned(), make, (SMALL, METHODS), precision));
        }
    }
    let [direct, basis, _, low_rank, auto] = METHODS;
    let patches = [direct, basis, Method::Patch(PATCH), low_rank, auto];
    for precision in PRECISIONS {
        let name = "a PSF that jumps every 16 pixels, patches of 16".to_owned();
        cases.push(row(name, jumping, (FRAME, patches), precision));
    }
    cases.extend(wings());
    Section {
        title: "Stamps",
        story: "Measured as for scenes, on frames of 48 x 40 pixels with patches of one pixel, each of which has\n\
            its own PSF. The limit for patches is five times larger, since a pixel is the sum of hundreds of\n\
            patches.\n\n\
            The last rows judge the wings of one star, 1e-10 of its core, divided by the wings. Transforms\n\
            spread their noise of 1e-16 (f64) and 1e-7 (f32) of the core over them. The direct sum, and `auto`,\n\
            which draws a single star, leave each pixel its own relative precision, as far as the model's modes\n\
            hold it. These are good to the rounding of the core: 1e-15 in f64, 7e-9 in f32.",
        columns: COLUMNS,
        cases,
    }
}

/// One star through stamps with wings, compared where only the wings reach.
fn wings() -> Vec<Case> {
    PRECISIONS
        .map(|precision| {
            // Limits for transforms, drawing and the direct sum, relative to the wings.
            let (transforms, drawn, direct) = match precision {
                Precision::F64 => (1e-15 / WING, 1e-15 / WING, 1e-10),
                // The modes of a block may leave out 7e-9 of a PSF. Little of that reaches the
                // wings.
                Precision::F32 => (1e-6 / WING, 1e-2, 1e-6),
            };
            Case::new(
                format!("wings of 1e-10, in the wings, {}", precision.name()),
                move || {
                    let mut light = Array2::zeros((SMALL.1, SMALL.0));
                    let star = (24, 20);
                    light[[star.1, star.0]] = 1.0;
                    METHODS
                        .map(|method| {
                            let limit = match method {
                                Method::Direct => direct,
                                Method::Auto => drawn,
                                _ => transforms,
                            };
                            let got = on_grid((SIDE, SIDE), winged)
                                .and_then(|samples| {
                                    fit(samples, &full(Interpolation::Bilinear))?.into_model()
                                })
                                .and_then(|model| {
                                    let exact = Light::of(light.clone());
                                    error_where(&model, &exact, (method, precision), |x, y| {
                                        // Only the corners of the stamp.
                                        x.abs_diff(star.0) == SIDE / 2 && y.abs_diff(star.1) == SIDE / 2
                                    })
                                });
                            Cell::error(got, limit)
                        })
                        .to_vec()
                },
            )
        })
        .into()
}

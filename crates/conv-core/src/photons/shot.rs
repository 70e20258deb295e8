//! The sources of a run: their order, and their photons.

use psf_types::{LightProfile, PixelRegion, PointSource, Position, Progress, RadialLight};
use rand_distr::{Distribution, Poisson, StandardNormal};
use rayon::prelude::*;

use super::corner_table::{CornerTable, PhotonStamps};
use super::corners::{Corner, MOST_NODES};
use super::counts::SourceCounts;
use super::photon_draw::WORDS_OF_PHOTON;
use super::photon_shooter::PhotonSources;
use super::random::{PhotonRng, RandomWords, hash};
use crate::galaxies::{ExtendedSources, Isophotes};
use crate::simd::vectorized;
use crate::sources::{BlockKey, block_of};
use crate::{ConvError, view};

/// A source that may reach the region. Sources are sorted by area and place, and equal ones follow each other.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Placed {
    pub(super) area: BlockKey,
    pub(super) place: u32,
    /// The hash of the position and the flux.
    pub(super) key: u64,
    /// The hash of the light's shape, if there are other sources with this key. Otherwise 0.
    pub(super) shape: u64,
    pub(super) index: usize,
}

/// The PSF of a source: a weighted mean of the PSFs of some tables, perhaps scaled to unit flux.
pub(super) struct MeanPsf<'a> {
    /// Those beyond the number of weights are not used.
    pub(super) tables: [&'a CornerTable; MOST_NODES],
    pub(super) weights: &'a [(Corner, f64)],
    pub(super) scaled: bool,
}

/// The sources of one kind and what is drawn of them.
pub(super) struct Shot<'a> {
    pub(super) points: &'a [PointSource],
    /// `None` for stars.
    pub(super) light: Option<ExtendedSources<'a>>,
    pub(super) sources: &'a PhotonSources<'a>,
    pub(super) frame: PixelRegion,
    pub(super) region: PixelRegion,
    pub(super) progress: &'a dyn Progress,
    pub(super) stamps: &'a PhotonStamps,
}

/// The light of an extended source.
struct Shape {
    isophotes: Isophotes,
    radii: RadialLight,
}

/// Columns and rows of the areas whose sources different tasks may draw.
pub(super) const AREA: i64 = 256;
/// Sources are divided into squares of this side within an area, so that neighbours use the same tables.
const SQUARE: f64 = 64.0;
/// The number of photons that are drawn together.
const PHOTONS_AT_ONCE: usize = 64;
/// Each photon chooses a corner, too.
const WORDS_AT_ONCE: usize = (1 + WORDS_OF_PHOTON) * PHOTONS_AT_ONCE;
/// Most fields have at most so many corners for a source.
const FEW_CORNERS: usize = 4;

/// Memory for photons that are drawn together.
pub(super) struct PhotonBuffers {
    /// The coordinates of their origins among the coefficients of a stamp.
    at: [[f64; 2]; PHOTONS_AT_ONCE],
    words: [u64; WORDS_AT_ONCE],
    /// Their pixels and their counts, which are 0 for rejected photons.
    landed: [([i32; 2], i32); PHOTONS_AT_ONCE],
}

impl PhotonBuffers {
    pub(super) fn new() -> Self {
        Self {
            at: [[0.0; 2]; PHOTONS_AT_ONCE],
            words: [0; WORDS_AT_ONCE],
            landed: [([0; 2], 0); PHOTONS_AT_ONCE],
        }
    }
}

impl Placed {
    pub(super) fn is_like(&self, other: &Self) -> bool {
        (self.area, self.key, self.shape) == (other.area, other.key, other.shape)
    }
}

impl Shot<'_> {
    /// The position of a source in pixels of the frame.
    pub(super) fn position(&self, index: usize) -> (f64, f64) {
        let at = self.points[index].position();
        (at.x() - self.frame.x0() as f64, at.y() - self.frame.y0() as f64)
    }

    fn shape(&self, index: usize) -> Option<Shape> {
        self.light
            .map(|sources| Shape::new((sources.light)(index).as_ref()))
    }

    /// The sources whose photons may reach the region, sorted.
    pub(super) fn placed(&self) -> Result<Vec<Placed>, ConvError> {
        let is_near = |at: f64, reach: f64, first: i64, count: usize| {
            at + reach >= first as f64 && at - reach <= (first + count as i64) as f64
        };
        let place = |index: usize| -> Result<Option<Placed>, ConvError> {
            self.progress.check_cancelled()?;
            let point = self.points[index];
            let ((x, y), region) = (self.position(index), self.region);
            let is_near = |reach: f64| {
                is_near(x, reach, region.x0(), region.shape().nx())
                    && is_near(y, reach, region.y0(), region.shape().ny())
            };
            let reach = self.stamps.reach();
            let may_reach = || {
                let shape = self.shape(index);
                shape.is_some_and(|shape| is_near(reach + shape.radii.farthest_px()))
            };
            if point.flux() == 0.0 || !(is_near(reach) || may_reach()) {
                return Ok(None);
            }
            let area = block_of((x.floor() as i64, y.floor() as i64), AREA);
            let square = |v: f64| (v.rem_euclid(AREA as f64) / SQUARE) as u32;
            let data = point
                .position()
                .bits()
                .into_iter()
                .chain([point.flux().to_bits()]);
            Ok(Some(Placed {
                area,
                place: square(y) << 8 | square(x),
                key: hash(data),
                shape: 0,
                index,
            }))
        };
        let mut placed: Vec<Placed> = (0..self.points.len())
            .into_par_iter()
            .map(place)
            .filter_map(Result::transpose)
            .collect::<Result<_, _>>()?;
        placed.par_sort_unstable();
        for equal in placed.chunk_by_mut(|a, b| a.area == b.area && a.key == b.key) {
            if equal.len() > 1 {
                for source in equal.iter_mut() {
                    source.shape = self.shape(source.index).map_or(0, |shape| shape.hash());
                }
                equal.sort_unstable();
            }
        }
        Ok(placed)
    }

    /// Shoots the photons of a source and returns their mean.
    pub(super) fn source(
        &self,
        source: Placed,
        occurrence: u64,
        psf: &MeanPsf<'_>,
        window: Option<PixelRegion>,
        counts: &mut SourceCounts,
        buffers: &mut PhotonBuffers,
    ) -> Result<f64, ConvError> {
        let index = source.index;
        let (x, y) = self.position(index);
        let corners = || {
            psf.tables
                .iter()
                .zip(psf.weights.iter().map(|(_, weight)| *weight))
        };
        let flux: f64 = corners().map(|(table, weight)| table.flux * weight).sum();
        let mut expected = self.points[index].flux() * self.sources.photons_per_flux;
        let mean = if psf.scaled { expected } else { expected * flux };
        if psf.scaled {
            if !(flux > 0.0 && flux.is_finite()) {
                let position = Position::new(x, y).map_err(ConvError::Result)?;
                return Err(psf_types::FieldError::NonPositiveFlux { position, flux }.into());
            }
            expected /= flux;
        }
        let proposals: f64 = corners()
            .map(|(table, weight)| table.proposals * weight.abs())
            .sum();
        let Ok(poisson) = Poisson::new(proposals * expected.abs()) else {
            return Ok(mean);
        };
        let shape = self.shape(index);
        let of_shape = shape.as_ref().map_or(0, Shape::hash);
        let mut rng = PhotonRng::new([self.sources.seed, source.key, of_shape, occurrence]);
        let photons: f64 = poisson.sample(&mut rng);
        // The probability of each corner but the last, summed up to it.
        let (mut limits, mut signs, mut sum) = ([u64::MAX; MOST_NODES], [1; MOST_NODES], 0.0);
        for (number, (table, weight)) in corners().enumerate() {
            sum += table.proposals * weight.abs();
            limits[number] = (sum / proposals * ONE) as u64;
            signs[number] = if weight * expected < 0.0 { -1 } else { 1 };
        }
        // No choice reaches the limits that are not used.
        limits[psf.weights.len() - 1..].fill(u64::MAX);
        let (limits, more_limits) = limits.split_at(FEW_CORNERS - 1);
        let has_more = psf.weights.len() > FEW_CORNERS;
        let own = [(x + 0.5).floor(), (y + 0.5).floor()];
        let (dx, dy) = (x - own[0], y - own[1]);
        let in_region = [
            (own[0] as i64 - self.region.x0()) as i32,
            (own[1] as i64 - self.region.y0()) as i32,
        ];
        let window = window.filter(|_| self.light.is_none());
        // Step by step for some photons at once, so that the processor works on several of them at the same time.
        let PhotonBuffers { at, words, landed } = buffers;
        at.fill(self.stamps.coordinates(dx, dy));
        let mut left = photons as u64;
        vectorized!({
            while left > 0 {
                let now = left.min(PHOTONS_AT_ONCE as u64) as usize;
                left -= now as u64;
                if let Some(shape) = &shape {
                    for at in &mut at[..now] {
                        let (ox, oy) = shape.offset(&mut rng);
                        *at = self.stamps.coordinates(dx + ox, dy + oy);
                    }
                }
                rng.look_ahead(&mut words[..(1 + WORDS_OF_PHOTON) * now]);
                let mut random = RandomWords::new(words);
                for (&at, landed) in at[..now].iter().zip(&mut *landed) {
                    let choice = random.next() >> 1;
                    let below = |limits: &[u64]| limits.iter().filter(|&&limit| choice >= limit).count();
                    let more = if has_more { below(more_limits) } else { 0 };
                    let corner = below(limits) + more;
                    *landed = match self.stamps.photon(psf.tables[corner], at, &mut random) {
                        Some((pixel, sign)) => (pixel, sign * signs[corner]),
                        None => ([0; 2], 0),
                    };
                }
                rng.skip(random.used);
                for &(pixel, sign) in &landed[..now] {
                    let is_seen = |window: PixelRegion| {
                        window.contains(view::region(pixel[0].into(), pixel[1].into(), (1, 1)))
                    };
                    if sign != 0 && window.is_none_or(is_seen) {
                        let pixel = [
                            in_region[0].wrapping_add(pixel[0]),
                            in_region[1].wrapping_add(pixel[1]),
                        ];
                        counts.count(pixel, sign);
                    }
                }
            }
        });
        Ok(mean)
    }
}

/// Half the range of a random word.
const ONE: f64 = (1_u64 << 63) as f64;

impl Shape {
    fn new(light: &dyn LightProfile) -> Self {
        Self {
            isophotes: Isophotes::of(light),
            radii: light.radial_light(),
        }
    }

    fn hash(&self) -> u64 {
        let Isophotes { xx, xy, yy } = self.isophotes;
        let map = [xx, xy, yy].map(f64::to_bits);
        hash(map.into_iter().chain(self.radii.fingerprint()))
    }

    /// The offset of a photon from the centre.
    #[inline(always)]
    fn offset(&self, rng: &mut PhotonRng) -> (f64, f64) {
        let (a, b) = (StandardNormal.sample(rng), StandardNormal.sample(rng));
        self.isophotes.offset(self.radii.offset(a, b))
    }
}

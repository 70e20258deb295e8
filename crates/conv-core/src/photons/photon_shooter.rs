//! Shoots the photons of catalogues.

use std::sync::{Arc, Mutex, OnceLock};

use ndarray::ArrayViewMut2;
use psf_types::{Anchor, LightProfile, PixelRegion, PointSource, Position, Progress, RadialLight};
use rand_distr::{Distribution, Poisson, StandardNormal};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::corner_table::{CornerTable, PhotonStamps};
use super::corners::{BLOCK, BlockCells, Corner, Corners, MOST_NODES};
use super::counts::{SharedCounts, SourceCounts};
use super::random::{PhotonRng, hash};
use crate::galaxies::ExtendedSources;
use crate::kept::Kept;
use crate::sources::{BlockKey, SourcePsfs, block_of, region_of};
use crate::stamp_interpolator::Kernel;
use crate::{ConvError, view};

/// Sources to be drawn photon by photon ([`SourcePlan::shoot_into`](crate::SourcePlan::shoot_into)).
#[derive(Debug, Clone, Copy)]
pub struct PhotonSources<'a> {
    /// Stars. Positions are in pixels of the scene.
    pub stars: &'a [PointSource],
    /// Galaxies and other extended sources.
    pub extended: ExtendedSources<'a>,
    /// The expected number of photons for a flux of 1. It must be finite and not negative.
    pub photons_per_flux: f64,
    /// The seed of the run.
    pub seed: u64,
}

/// What [`SourcePlan::shoot_into`](crate::SourcePlan::shoot_into) has drawn.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PhotonReport {
    /// The number of sources whose photons may reach the region.
    pub sources: usize,
    /// The mean of the sum of all counts of these sources, in the region and outside: their fluxes times the
    /// fluxes of their PSFs.
    pub mean: f64,
    /// The number of photons of these sources, in the region and outside. Its mean is the sum of the variances
    /// of all pixels. It exceeds [`mean`](Self::mean) by twice the light of pixels where PSFs are negative.
    pub photons: u64,
    /// The sum of the counts that were added to the region.
    pub counted: i64,
}

/// Shoots the photons of sources through the PSFs of a model.
#[derive(Debug)]
pub(crate) struct PhotonShooter {
    stars: Arc<Tables>,
    /// Those of the stars, unless stamps are truncated.
    extended: Arc<Tables>,
    blocks: Kept<BlockKey, Option<BlockCells>>,
    /// The frame pixels that a star may light relative to its own, if stars are truncated.
    window: Option<PixelRegion>,
    kernel: Kernel,
    tolerance: f64,
}

/// Tables of corners, kept for later sources.
#[derive(Debug, Default)]
struct Tables {
    stamps: Arc<OnceLock<PhotonStamps>>,
    kept: Mutex<KeptTables>,
}

#[derive(Debug, Default)]
struct KeptTables {
    by_corner: TablesByCorner,
    bytes: usize,
}

type TablesByCorner = FxHashMap<Corner, Arc<CornerTable>>;

/// A source that may reach the region. Sources are sorted by block and place, and equal ones follow each other.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Placed {
    block: BlockKey,
    place: u32,
    /// The hash of the position and the flux.
    key: u64,
    /// The hash of the light's shape, if there are other sources with this key. Otherwise 0.
    shape: u64,
    index: usize,
}

/// The PSF of a source: a weighted mean of the PSFs of some tables, perhaps scaled to unit flux.
struct MeanPsf<'a> {
    /// Those beyond the number of weights are not used.
    tables: [&'a CornerTable; MOST_NODES],
    weights: &'a [(Corner, f64)],
    scaled: bool,
}

/// The sources of one kind and what is drawn of them.
struct Shot<'a> {
    points: &'a [PointSource],
    /// `None` for stars.
    light: Option<ExtendedSources<'a>>,
    sources: &'a PhotonSources<'a>,
    frame: PixelRegion,
    region: PixelRegion,
    progress: &'a dyn Progress,
    tables: &'a Tables,
    stamps: &'a PhotonStamps,
}

/// The light of an extended source: the map from offsets of a round profile to the sky, and the radii.
struct Shape {
    /// The offset is `(xx a + xy b, yy b)`.
    xx: f64,
    xy: f64,
    yy: f64,
    radii: RadialLight,
}

/// Sources are divided into squares of this side within a block, so that neighbours use the same tables.
const SQUARE: f64 = 64.0;
/// The most sources of a task.
const PER_TASK: usize = 1 << 12;
/// About the most tables that a task holds at the same time.
const TABLES_AT_ONCE: usize = 48;
/// The corners of a block's cell, which no other block shares.
const CORNERS: usize = 4;
/// The number of photons that are drawn together.
const PHOTONS_AT_ONCE: usize = 64;
/// The largest expected number of photons of a source.
const MOST_PHOTONS: f64 = 1e8;

impl PhotonShooter {
    /// `window` holds the frame pixels that a star may light.
    pub(crate) fn new(psfs: &SourcePsfs, kernel: Kernel, window: PixelRegion, tolerance: f64) -> Self {
        let stars = Arc::new(Tables::default());
        let extended = match psfs.size() {
            None => Arc::clone(&stars),
            Some(_) => Arc::default(),
        };
        Self {
            stars,
            extended,
            blocks: Kept::new(usize::MAX),
            window: psfs.size().map(|_| window),
            kernel,
            tolerance,
        }
    }

    /// About how many tables the sources of a frame need, if the field has no nodes.
    pub(crate) fn expected_tables(&self, psfs: &SourcePsfs, frame: PixelRegion) -> usize {
        let blocks = [frame.shape().nx(), frame.shape().ny()].map(|n| n.div_ceil(BLOCK as usize));
        let cells = psfs
            .space()
            .expected_cells(frame.shape().region(), self.tolerance);
        cells.max(CORNERS * blocks[0] * blocks[1])
    }

    /// A shooter for PSFs of another field, which shares the stamps.
    pub(crate) fn for_other_field(&self) -> Self {
        let with_stamps_of = |tables: &Tables| {
            Arc::new(Tables {
                stamps: Arc::clone(&tables.stamps),
                kept: Mutex::default(),
            })
        };
        let stars = with_stamps_of(&self.stars);
        let extended = if Arc::ptr_eq(&self.stars, &self.extended) {
            Arc::clone(&stars)
        } else {
            with_stamps_of(&self.extended)
        };
        Self {
            stars,
            extended,
            blocks: Kept::new(usize::MAX),
            ..*self
        }
    }

    /// Adds the photons of sources to the counts of a region.
    pub(crate) fn shoot_into(
        &self,
        psfs: &SourcePsfs,
        sources: &PhotonSources<'_>,
        frame: PixelRegion,
        region: PixelRegion,
        counts: ArrayViewMut2<'_, i32>,
        progress: &dyn Progress,
    ) -> Result<PhotonReport, ConvError> {
        if psfs.options().anchor() == Anchor::Output {
            return Err(ConvError::Photons("sources need a plan that is source-anchored"));
        }
        let per_flux = sources.photons_per_flux;
        let fluxes = sources.stars.iter().chain(sources.extended.points);
        let brightest = fluxes.fold(0.0_f64, |most, source| most.max(source.flux().abs()));
        if !(per_flux >= 0.0 && brightest * per_flux <= MOST_PHOTONS) {
            return Err(ConvError::Photons(
                "the expected photons of a source must be from 0 to 1e8",
            ));
        }
        let counts = SharedCounts::new(counts);
        let mut report = PhotonReport::default();
        for (points, light, tables, size) in [
            (sources.stars, None, &self.stars, None),
            (
                sources.extended.points,
                Some(sources.extended),
                &self.extended,
                psfs.size(),
            ),
        ] {
            if points.is_empty() {
                continue;
            }
            let make = || PhotonStamps::new(psfs.space(), self.kernel, size);
            let shot = Shot {
                points,
                light,
                sources,
                frame,
                region,
                progress,
                tables,
                stamps: tables.stamps.get_or_init(make),
            };
            self.shoot(psfs, &shot, &counts, &mut report)?;
        }
        Ok(report)
    }

    fn shoot(
        &self,
        psfs: &SourcePsfs,
        shot: &Shot<'_>,
        counts: &SharedCounts<'_>,
        report: &mut PhotonReport,
    ) -> Result<(), ConvError> {
        let placed = shot.placed()?;
        report.sources += placed.len();
        let corners = Corners::new(psfs, self.tolerance, &self.blocks);
        let parts: Vec<&[Placed]> = placed
            .chunk_by(|a, b| a.block == b.block)
            .flat_map(|block| block.chunks(PER_TASK))
            .collect();
        let drawn: Vec<(f64, u64, i64)> = parts
            .par_iter()
            .map_init(Vec::new, |memory, part| {
                self.shoot_part(psfs, shot, part, &placed, (&corners, counts), memory)
            })
            .collect::<Result<_, _>>()?;
        for (mean, photons, counted) in drawn {
            report.mean += mean;
            report.photons += photons;
            report.counted += counted;
        }
        Ok(())
    }

    /// Shoots the photons of some sources of a block, which are a part of all sources. Returns their mean, their
    /// number and the sum of the counts.
    fn shoot_part(
        &self,
        psfs: &SourcePsfs,
        shot: &Shot<'_>,
        part: &[Placed],
        all: &[Placed],
        (corners, counts): (&Corners<'_>, &SharedCounts<'_>),
        memory: &mut Vec<i32>,
    ) -> Result<(f64, u64, i64), ConvError> {
        let block = region_of(part[0].block, BLOCK);
        let reach = shot.stamps.reach() as i64;
        let side = (BLOCK + 2 * reach) as usize;
        let area = view::region(
            block.x0() - reach - shot.region.x0(),
            block.y0() - reach - shot.region.y0(),
            (side, side),
        );
        let flux: f64 = part
            .iter()
            .map(|source| shot.points[source.index].flux().abs())
            .sum();
        let mut near = counts.for_sources(area, flux * shot.sources.photons_per_flux, std::mem::take(memory));
        // Sources before these may equal the first.
        let first = all.partition_point(|source| source < &part[0]);
        let before = all[..first].iter().rev();
        let equal = before.take_while(|source| source.is_like(&part[0])).count();
        let (mut mean, mut occurrence) = (0.0, equal as u64);
        let (mut weights, mut ends, mut tables) = (Vec::new(), Vec::new(), TablesByCorner::default());
        let (mut of_source, mut buffer, mut missing) = (Vec::new(), Vec::new(), Vec::new());
        let mut next = 0;
        while next < part.len() {
            // The corners of some sources.
            let run = next;
            weights.clear();
            ends.clear();
            missing.clear();
            if tables.len() >= TABLES_AT_ONCE {
                tables.clear();
            }
            while next < part.len() && (next == run || tables.len() + missing.len() < TABLES_AT_ONCE) {
                shot.progress.check_cancelled()?;
                let (x, y) = shot.position(part[next].index);
                let position = Position::new(x, y).map_err(ConvError::Result)?;
                corners.of(position, part[next].block, &mut of_source, &mut buffer)?;
                for &(corner, _) in &of_source {
                    if !tables.contains_key(&corner) && !missing.contains(&corner) {
                        missing.push(corner);
                    }
                }
                weights.extend_from_slice(&of_source);
                ends.push(weights.len());
                next += 1;
            }
            shot.find_tables(corners, &mut missing, psfs.options().memory_bytes(), &mut tables)?;
            let mut start = 0;
            for (number, &end) in (run..next).zip(&ends) {
                shot.progress.check_cancelled()?;
                if number > 0 {
                    let is_equal = part[number].is_like(&part[number - 1]);
                    occurrence = if is_equal { occurrence + 1 } else { 0 };
                }
                let weights = &weights[start..end];
                let psf = MeanPsf {
                    tables: std::array::from_fn(|k| &*tables[&weights[k.min(weights.len() - 1)].0]),
                    weights,
                    scaled: psfs.model.needs_flux_scaling(),
                };
                start = end;
                mean += shot.source(part[number], occurrence, &psf, self.window, &mut near)?;
            }
        }
        let drawn = (mean, near.photons, near.counted);
        *memory = counts.add(near);
        Ok(drawn)
    }
}

impl Placed {
    fn is_like(&self, other: &Self) -> bool {
        (self.block, self.key, self.shape) == (other.block, other.key, other.shape)
    }
}

impl Shot<'_> {
    /// The position of a source in pixels of the frame.
    fn position(&self, index: usize) -> (f64, f64) {
        let at = self.points[index].position();
        (at.x() - self.frame.x0() as f64, at.y() - self.frame.y0() as f64)
    }

    fn shape(&self, index: usize) -> Option<Shape> {
        self.light
            .map(|sources| Shape::new((sources.light)(index).as_ref()))
    }

    /// The sources whose photons may reach the region, sorted.
    fn placed(&self) -> Result<Vec<Placed>, ConvError> {
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
            let block = block_of((x.floor() as i64, y.floor() as i64), BLOCK);
            let square = |v: f64| (v.rem_euclid(BLOCK as f64) / SQUARE) as u32;
            let data = point
                .position()
                .bits()
                .into_iter()
                .chain([point.flux().to_bits()]);
            Ok(Some(Placed {
                block,
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
        for equal in placed.chunk_by_mut(|a, b| a.block == b.block && a.key == b.key) {
            if equal.len() > 1 {
                for source in equal.iter_mut() {
                    source.shape = self.shape(source.index).map_or(0, |shape| shape.hash());
                }
                equal.sort_unstable();
            }
        }
        Ok(placed)
    }

    /// Finds the tables of corners, kept or made now, and adds them to `tables`. Keeps new ones within the memory.
    fn find_tables(
        &self,
        corners: &Corners<'_>,
        missing: &mut Vec<Corner>,
        memory_bytes: usize,
        tables: &mut TablesByCorner,
    ) -> Result<(), ConvError> {
        let locked = || {
            self.tables
                .kept
                .lock()
                .expect("no thread panics while it looks up")
        };
        {
            let kept = locked();
            missing.retain(|corner| match kept.by_corner.get(corner) {
                Some(table) => tables.insert(*corner, Arc::clone(table)).is_some(),
                None => true,
            });
        }
        if missing.is_empty() {
            return Ok(());
        }
        let made = self.stamps.tables(&corners.psfs(missing)?);
        let mut kept = locked();
        for (&corner, table) in missing.iter().zip(made) {
            let (table, bytes) = (Arc::new(table), self.stamps.table_bytes());
            if kept.bytes + bytes <= memory_bytes && !kept.by_corner.contains_key(&corner) {
                kept.by_corner.insert(corner, Arc::clone(&table));
                kept.bytes += bytes;
            }
            tables.insert(corner, table);
        }
        Ok(())
    }

    /// Shoots the photons of a source and returns their mean.
    fn source(
        &self,
        source: Placed,
        occurrence: u64,
        psf: &MeanPsf<'_>,
        window: Option<PixelRegion>,
        counts: &mut SourceCounts,
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
        let limits = &limits[..psf.weights.len() - 1];
        let own = [(x + 0.5).floor(), (y + 0.5).floor()];
        let (dx, dy) = (x - own[0], y - own[1]);
        let in_region = [
            (own[0] as i64 - self.region.x0()) as i32,
            (own[1] as i64 - self.region.y0()) as i32,
        ];
        let window = window.filter(|_| self.light.is_none());
        // Step by step for some photons at once, so that the processor works on several of them at the same time.
        let mut at = [self.stamps.coordinates(dx, dy); PHOTONS_AT_ONCE];
        let mut left = photons as u64;
        while left > 0 {
            let now = left.min(PHOTONS_AT_ONCE as u64) as usize;
            left -= now as u64;
            if let Some(shape) = &shape {
                for at in &mut at[..now] {
                    let (ox, oy) = shape.offset(&mut rng);
                    *at = self.stamps.coordinates(dx + ox, dy + oy);
                }
            }
            for &at in &at[..now] {
                let choice = rng.next() >> 1;
                let mut corner = 0;
                for &limit in limits {
                    corner += usize::from(choice >= limit);
                }
                let Some((pixel, sign)) = self.stamps.photon(psf.tables[corner], at, &mut rng) else {
                    continue;
                };
                if let Some(window) = window
                    && !window.contains(view::region(pixel[0].into(), pixel[1].into(), (1, 1)))
                {
                    continue;
                }
                let pixel = [
                    in_region[0].wrapping_add(pixel[0]),
                    in_region[1].wrapping_add(pixel[1]),
                ];
                counts.count(pixel, sign * signs[corner]);
            }
        }
        Ok(mean)
    }
}

/// Half the range of a random word.
const ONE: f64 = (1_u64 << 63) as f64;

impl Shape {
    fn new(light: &dyn LightProfile) -> Self {
        // The squared radius of an isophote is a quadratic form. Its Cholesky factor maps the isophote to a
        // circle, and the inverse of its transpose maps back.
        let square = |dx: f64, dy: f64| light.radius(dx, dy).powi(2);
        let (xx, yy) = (square(1.0, 0.0), square(0.0, 1.0));
        let xy = 0.5 * (square(1.0, 1.0) - xx - yy);
        let first = xx.sqrt();
        let along = xy / first;
        let second = (yy - along * along).sqrt();
        Self {
            xx: 1.0 / first,
            xy: -along / (first * second),
            yy: 1.0 / second,
            radii: light.radial_light(),
        }
    }

    fn hash(&self) -> u64 {
        let map = [self.xx, self.xy, self.yy].map(f64::to_bits);
        hash(map.into_iter().chain(self.radii.fingerprint()))
    }

    /// The offset of a photon from the centre.
    #[inline(always)]
    fn offset(&self, rng: &mut PhotonRng) -> (f64, f64) {
        let (a, b) = (StandardNormal.sample(rng), StandardNormal.sample(rng));
        let (a, b) = self.radii.offset(a, b);
        (self.xx * a + self.xy * b, self.yy * b)
    }
}

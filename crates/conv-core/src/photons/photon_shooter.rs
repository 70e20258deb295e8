//! Shoots the photons of catalogues.

use std::sync::{Arc, Mutex, OnceLock};

use ndarray::ArrayViewMut2;
use psf_types::{Anchor, PixelRegion, PointSource, Position, Progress};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::corner_table::{CornerTable, PhotonStamps};
use super::corners::{BLOCK, BlockCells, Corner, Corners};
use super::counts::SharedCounts;
use super::shot::{AREA, MeanPsf, PhotonBuffers, Placed, Shot};
use crate::galaxies::ExtendedSources;
use crate::kept::{Kept, get_or_make};
use crate::plan::cost_model::PhotonWork;
use crate::sources::{BlockKey, SourcePsfs, region_of};
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

/// A summary of the photons that [`SourcePlan::shoot_into`](crate::SourcePlan::shoot_into) has drawn.
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
    /// The tables of extended sources: the stars' own, unless stamps are truncated.
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

/// The most sources of a task.
const PER_TASK: usize = 1 << 12;
/// About the most tables that a task holds at the same time.
const TABLES_AT_ONCE: usize = 48;
/// The corners of a block's cell, which no other block shares.
const CORNERS: usize = 4;
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

    /// About how many tables the sources of a frame need.
    pub(crate) fn expected_tables(&self, psfs: &SourcePsfs, frame: PixelRegion) -> usize {
        if let Some(nodes) = self.corners(psfs).node_count(frame) {
            return nodes;
        }
        let blocks = [frame.shape().nx(), frame.shape().ny()].map(|n| n.div_ceil(BLOCK as usize));
        let cells = psfs
            .space()
            .expected_cells(frame.shape().region(), self.tolerance);
        cells.max(CORNERS * blocks[0] * blocks[1])
    }

    /// The work of a photon: a mean of that at a few places of the frame.
    pub(crate) fn work_of_photon(&self, psfs: &SourcePsfs, frame: PixelRegion) -> PhotonWork {
        let (nx, ny) = (frame.shape().nx() as i64, frame.shape().ny() as i64);
        let places = [(2, 2), (1, 1), (3, 1), (1, 3), (3, 3)];
        let (corners, stamps) = (self.corners(psfs), self.stamps_of(&self.stars, psfs, None));
        let of_places: Vec<PhotonWork> = places
            .iter()
            .map(|(x, y)| Position::of_pixel(x * nx / 4, y * ny / 4))
            .filter_map(|at| corners.psfs(&[Corner::Source(at.bits())]).ok())
            .map(|vector| stamps.work(&stamps.tables(&vector)[0]))
            .collect();
        let count = of_places.len() as f64;
        let mean = |of: fn(&PhotonWork) -> f64| of_places.iter().map(of).sum::<f64>() / count;
        if of_places.is_empty() {
            // The frame has no PSF there.
            return PhotonWork::default();
        }
        PhotonWork {
            proposals: mean(|work| work.proposals),
            terms: mean(|work| work.terms),
        }
    }

    fn corners<'a>(&'a self, psfs: &'a SourcePsfs) -> Corners<'a> {
        Corners::new(psfs, self.tolerance, &self.blocks)
    }

    fn stamps_of<'a>(&self, tables: &'a Tables, psfs: &SourcePsfs, size: Option<usize>) -> &'a PhotonStamps {
        let make = || PhotonStamps::new(psfs.space(), self.kernel, size);
        get_or_make(&tables.stamps, make)
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
            let shot = Shot {
                points,
                light,
                sources,
                frame,
                region,
                progress,
                stamps: self.stamps_of(tables, psfs, size),
            };
            self.shoot(psfs, (&shot, tables), &counts, &mut report)?;
        }
        Ok(report)
    }

    fn shoot(
        &self,
        psfs: &SourcePsfs,
        (shot, tables): (&Shot<'_>, &Tables),
        counts: &SharedCounts<'_>,
        report: &mut PhotonReport,
    ) -> Result<(), ConvError> {
        let placed = shot.placed()?;
        report.sources += placed.len();
        let corners = self.corners(psfs);
        let parts: Vec<&[Placed]> = placed
            .chunk_by(|a, b| a.area == b.area)
            .flat_map(|of_area| of_area.chunks(PER_TASK))
            .collect();
        let drawn: Vec<(f64, u64, i64)> = parts
            .par_iter()
            .map_init(Vec::new, |memory, part| {
                self.shoot_part(psfs, (shot, tables), part, &placed, (&corners, counts), memory)
            })
            .collect::<Result<_, _>>()?;
        for (mean, photons, counted) in drawn {
            report.mean += mean;
            report.photons += photons;
            report.counted += counted;
        }
        Ok(())
    }

    /// Shoots the photons of some sources of an area, which are a part of all sources. Returns their mean, their
    /// number and the sum of the counts.
    fn shoot_part(
        &self,
        psfs: &SourcePsfs,
        (shot, kept): (&Shot<'_>, &Tables),
        part: &[Placed],
        all: &[Placed],
        (corners, counts): (&Corners<'_>, &SharedCounts<'_>),
        memory: &mut Vec<i32>,
    ) -> Result<(f64, u64, i64), ConvError> {
        let own = region_of(part[0].area, AREA);
        let reach = shot.stamps.reach() as i64;
        let side = (AREA + 2 * reach) as usize;
        let area = view::region(
            own.x0() - reach - shot.region.x0(),
            own.y0() - reach - shot.region.y0(),
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
        let (mut buffers, mut next) = (PhotonBuffers::new(), 0);
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
                corners.of(position, &mut of_source, &mut buffer)?;
                for &(corner, _) in &of_source {
                    if !tables.contains_key(&corner) && !missing.contains(&corner) {
                        missing.push(corner);
                    }
                }
                weights.extend_from_slice(&of_source);
                ends.push(weights.len());
                next += 1;
            }
            let memory_bytes = psfs.options().memory_bytes();
            kept.find(&mut missing, (corners, shot.stamps), memory_bytes, &mut tables)?;
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
                mean += shot.source(
                    part[number],
                    occurrence,
                    &psf,
                    self.window,
                    &mut near,
                    &mut buffers,
                )?;
            }
        }
        let drawn = (mean, near.photons, near.counted);
        *memory = counts.add(near);
        Ok(drawn)
    }
}

impl Tables {
    /// Finds the tables of corners, kept or made now, and adds them to `tables`. Keeps new ones within the memory.
    fn find(
        &self,
        missing: &mut Vec<Corner>,
        (corners, stamps): (&Corners<'_>, &PhotonStamps),
        memory_bytes: usize,
        tables: &mut TablesByCorner,
    ) -> Result<(), ConvError> {
        let locked = || self.kept.lock().expect("no thread panics while it looks up");
        let mut found = Vec::new();
        {
            let kept = locked();
            missing.retain(|corner| match kept.by_corner.get(corner) {
                Some(table) => {
                    found.push(Arc::clone(table));
                    tables.insert(*corner, Arc::clone(table)).is_some()
                }
                None => true,
            });
        }
        for table in found {
            table.read_ahead();
        }
        if missing.is_empty() {
            return Ok(());
        }
        let made = stamps.tables(&corners.psfs(missing)?);
        let mut kept = locked();
        for (&corner, table) in missing.iter().zip(made) {
            let (table, bytes) = (Arc::new(table), stamps.table_bytes());
            if kept.bytes + bytes <= memory_bytes && !kept.by_corner.contains_key(&corner) {
                kept.by_corner.insert(corner, Arc::clone(&table));
                kept.bytes += bytes;
            }
            tables.insert(corner, table);
        }
        Ok(())
    }
}

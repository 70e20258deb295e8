//! Makes the image of a scene: in memory, or by rows from one FITS file to another.

use std::ops::Range;
use std::time::Instant;

use conv_core::{ConvReal, DroppedLight, PhotonReport, RowStream, TileCounts};
use detector::ExposureReport;
use ndarray::{ArrayView2, ArrayViewMut2};
use psf_io::{Card, ImageReader, ImageWriter, IoError};
use psf_types::{Image, NoProgress};
use psfield::image_cards::shot_cards;
use psfield::{Preparation, PsfieldError, Scene, Simulator, SpotCheck, TruthTable};

use crate::context::Context;
use crate::simulate::SimulateArgs;
use crate::simulate::exposure_args::Exposing;
use crate::simulate::report::Seconds;
use crate::simulate::scene::{ReadFiles, with_nan_as};

/// The results of a simulation whose image has been written.
pub(super) struct Outcome {
    pub(super) counts: TileCounts,
    /// The light that is dropped, if there is a floor.
    pub(super) dropped: Option<DroppedLight>,
    /// The sources that were drawn photon by photon.
    pub(super) shot: Option<PhotonReport>,
    pub(super) spot_check: Option<SpotCheck>,
    pub(super) exposure: Option<ExposureReport>,
    /// NaN pixels of the scene that were replaced.
    pub(super) nan_pixels: usize,
}

/// A simulator, its scene, and what was prepared for it.
pub(super) struct Ready<'a, 's, T: ConvReal> {
    pub(super) simulator: &'a Simulator<T>,
    pub(super) scene: &'a Scene<'s, T>,
    pub(super) made: Preparation<'a>,
    /// The sources, if a table of them is wanted.
    pub(super) sources: Option<TruthTable>,
}

impl SimulateArgs {
    /// Simulates in memory and writes the image, or the counts of the detector.
    pub(super) fn in_memory<T: ConvReal>(
        &self,
        ready: &Ready<'_, '_, T>,
        read: &ReadFiles,
        exposing: Option<&Exposing>,
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Outcome> {
        let bar = context.bar("convolving");
        let clock = Instant::now();
        let Ready {
            simulator,
            scene: all,
            ..
        } = ready;
        let split = exposing
            .map(|exposing| exposing.split(simulator, all))
            .transpose()?
            .flatten();
        let scene = split.as_ref().map_or(*all, |(light, _)| light);
        let mut image = simulator.zeros();
        let counts = simulator.simulate_into(scene, image.view_mut(), &bar)?;
        let image = Image::new(image).map_err(PsfieldError::from)?;
        let photons = split.as_ref().zip(exposing);
        let photons = photons.map(|((_, faint), exposing)| exposing.shoot(simulator, faint, &bar));
        let photons = photons.transpose()?;
        let dropped = simulator.dropped_light(scene)?;
        seconds.execute = clock.elapsed().as_secs_f64();
        drop(bar);

        let spot_check = (self.spot_check > 0)
            .then(|| {
                let _spinner = context.spinner("checking");
                simulator.spot_check(scene, &image, self.checked_pixels(), &NoProgress)
            })
            .transpose()?;

        let clock = Instant::now();
        let mut cards = self.cards(ready)?;
        cards.extend(simulator.dropped_cards(dropped.as_ref())?);
        if let Some(check) = &spot_check {
            cards.extend(check.cards()?);
            if exposing.is_some() {
                cards.push(Card::comment(
                    "PSFCHK...: measured on the noise-free image, before the detector",
                ));
            }
        }
        let shot = photons.as_ref().map(|(_, report)| *report);
        cards.extend(shot.iter().flat_map(shot_cards));
        let header = simulator.carried_header(&read.header, self.scene.scene.is_some());
        let exposure = if let Some(exposing) = exposing {
            let photons = photons.as_ref().map(|(photons, _)| photons.view());
            let truth = || simulator.simulate(all);
            let table = |flags: ArrayView2<'_, u8>| {
                let sources = ready.sources.clone().map(|sources| sources.with_flags(flags));
                self.write_truth_table(sources.as_ref(), &cards)
            };
            Some(exposing.write((&image, photons), truth, table, (&header, &cards))?)
        } else {
            psf_io::write_together(|| {
                self.write_truth_table(ready.sources.as_ref(), &cards)?;
                psf_io::write_image(&self.output, &image, &header, &cards, self.overwrite)
            })?;
            None
        };
        seconds.write = clock.elapsed().as_secs_f64();
        Ok(Outcome {
            counts,
            dropped,
            shot,
            spot_check,
            exposure,
            nan_pixels: read.nan_pixels,
        })
    }

    /// Reads the scene and writes the image in bands of rows. `readers` come with the numbers of their layers.
    pub(super) fn by_bands<T: ConvReal>(
        &self,
        ready: &Ready<'_, '_, T>,
        read: &ReadFiles,
        readers: Vec<(usize, ImageReader)>,
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Outcome> {
        let Ready { simulator, scene, .. } = ready;
        let header = simulator.carried_header(&read.header, true);
        let mut cards = self.cards(ready)?;
        let dropped = simulator.dropped_light(scene)?;
        cards.extend(simulator.dropped_cards(dropped.as_ref())?);
        // Cards of a later check need room in the header. Without a check no room is reserved, so
        // that the header equals the header of an image that was made in memory.
        let late = if self.spot_check > 0 {
            SpotCheck::KEYWORDS.len()
        } else {
            0
        };
        let shape = simulator.image_shape();
        let writer =
            ImageWriter::create_reserving(&self.output, shape, &header, &cards, late, self.overwrite)?;

        let bar = context.bar("convolving");
        let clock = Instant::now();
        let mut rows = FitsRows {
            readers,
            writer,
            clock,
            read_seconds: 0.0,
            write_seconds: 0.0,
            written: Seconds::default(),
        };
        let (counts, spot_check) = simulator.stream(scene, &mut rows, self.checked_pixels(), &bar)?;
        drop(bar);
        seconds.execute = rows.written.execute;
        seconds.read += rows.written.read;
        seconds.write = rows.written.write;
        let readers = rows.readers.iter();
        let nan_pixels = readers.map(|(_, reader)| reader.nan_pixels()).sum();

        let clock = Instant::now();
        let late = spot_check.as_ref().map(SpotCheck::cards).transpose()?;
        let late = late.as_ref().map_or(&[][..], |cards| cards);
        psf_io::write_together(|| {
            self.write_truth_table(ready.sources.as_ref(), &[&cards, late].concat())?;
            rows.writer.finish_with(late)
        })?;
        seconds.write += clock.elapsed().as_secs_f64();
        Ok(Outcome {
            counts,
            dropped,
            shot: None,
            spot_check,
            exposure: None,
            nan_pixels,
        })
    }

    /// Writes the table of `--truth-table`, if there is one.
    fn write_truth_table(&self, sources: Option<&TruthTable>, cards: &[Card]) -> Result<(), IoError> {
        let Some((sources, path)) = sources.zip(self.truth_table.as_ref()) else {
            return Ok(());
        };
        sources.write(path, cards, self.overwrite)
    }

    /// Returns the number of pixels compared with the direct sum, and the seed that chooses them.
    fn checked_pixels(&self) -> (usize, u64) {
        (self.spot_check as usize, self.seed)
    }
}

/// Reads rows of the scene from its files and writes rows of the image to its file.
struct FitsRows<T: ConvReal> {
    /// The images of some layers, with the numbers of these layers.
    readers: Vec<(usize, ImageReader)>,
    writer: ImageWriter<T>,
    /// The start of the work.
    clock: Instant,
    read_seconds: f64,
    write_seconds: f64,
    /// The seconds until the last row was written. A spot check, which reads some rows again, does not count.
    written: Seconds,
}

impl<T: ConvReal> RowStream<T> for FitsRows<T> {
    type Error = PsfieldError;

    fn read(
        &mut self,
        layer: usize,
        rows: Range<usize>,
        light: ArrayViewMut2<'_, T>,
    ) -> Result<(), PsfieldError> {
        let clock = Instant::now();
        let mut readers = self.readers.iter_mut();
        let (_, reader) = readers
            .find(|(of, _)| *of == layer)
            .expect("a reader for each streamed layer");
        let read = reader.read_rows_into(rows.start, light);
        read.map_err(|error| with_nan_as(error, reader))?;
        self.read_seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }

    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), PsfieldError> {
        let clock = Instant::now();
        self.writer.write_rows(rows)?;
        self.write_seconds += clock.elapsed().as_secs_f64();
        let (read, write) = (self.read_seconds, self.write_seconds);
        self.written = Seconds {
            read,
            write,
            execute: self.clock.elapsed().as_secs_f64() - read - write,
            ..Seconds::default()
        };
        Ok(())
    }
}

//! Makes the image of a scene: in memory, or by rows from one FITS file to another.

use std::ops::Range;
use std::time::Instant;

use conv_core::{ConvReal, RowStream, TileCounts};
use detector::ExposureReport;
use ndarray::{ArrayView2, ArrayViewMut2};
use psf_io::{Card, ImageReader, ImageWriter};
use psf_types::{Image, NoProgress, Progress};
use psfield::{PixelPicker, Preparation, PsfieldError, Scene, SeriesExposure, Simulator, SpotCheck};

use crate::context::Context;
use crate::simulate::SimulateArgs;
use crate::simulate::exposure_args::Exposing;
use crate::simulate::report::Seconds;
use crate::simulate::scene::{ReadScene, with_nan_as};

/// The results of a simulation whose image has been written.
pub(super) struct Outcome {
    pub(super) counts: TileCounts,
    pub(super) spot_check: Option<SpotCheck>,
    pub(super) exposure: Option<ExposureReport>,
    /// NaN pixels of the scene that were replaced.
    pub(super) nan_pixels: usize,
}

/// A simulator and its scene.
pub(super) trait MakesImage<T: ConvReal> {
    /// A simulator for the frame.
    fn of_frame(&self) -> &Simulator<T>;

    /// Adds the image of the scene to `image`.
    fn simulate_into(
        &self,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError>;

    /// Compares an image with the direct sum. `pixels` are the number of pixels and the seed.
    fn spot_check(&self, image: &Image<T>, pixels: (usize, u64)) -> Result<SpotCheck, PsfieldError>;
}

/// A simulator and its scene, whose images can be read row by row.
pub(super) trait StreamsImage<T: ConvReal>: MakesImage<T> {
    /// Makes the image row by row.
    fn stream(&self, rows: &mut FitsRows<T>, progress: &dyn Progress) -> Result<TileCounts, PsfieldError>;

    /// Picks the pixels of a streamed image that a check compares.
    fn picker(&self, pixels: (usize, u64)) -> PixelPicker;

    /// Compares the picked pixels of a streamed image with the direct sum.
    fn spot_check_stream(
        &self,
        rows: &mut FitsRows<T>,
        picker: PixelPicker,
    ) -> Result<SpotCheck, PsfieldError>;
}

impl<T: ConvReal> MakesImage<T> for (&Simulator<T>, &Scene<'_, T>) {
    fn of_frame(&self) -> &Simulator<T> {
        self.0
    }

    fn simulate_into(
        &self,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        self.0.simulate_into(self.1, image, progress)
    }

    fn spot_check(&self, image: &Image<T>, pixels: (usize, u64)) -> Result<SpotCheck, PsfieldError> {
        self.0.spot_check(self.1, image, pixels, &NoProgress)
    }
}

impl<T: ConvReal> StreamsImage<T> for (&Simulator<T>, &Scene<'_, T>) {
    fn stream(&self, rows: &mut FitsRows<T>, progress: &dyn Progress) -> Result<TileCounts, PsfieldError> {
        self.0.stream(self.1, rows, progress)
    }

    fn picker(&self, pixels: (usize, u64)) -> PixelPicker {
        self.0.picker(self.1, true, pixels)
    }

    fn spot_check_stream(
        &self,
        rows: &mut FitsRows<T>,
        picker: PixelPicker,
    ) -> Result<SpotCheck, PsfieldError> {
        self.0.spot_check_stream(self.1, rows, picker, &NoProgress)
    }
}

impl<T: ConvReal> MakesImage<T> for SeriesExposure<'_, T> {
    fn of_frame(&self) -> &Simulator<T> {
        self.simulator()
    }

    fn simulate_into(
        &self,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        self.simulate_into(image, progress)
    }

    fn spot_check(&self, image: &Image<T>, pixels: (usize, u64)) -> Result<SpotCheck, PsfieldError> {
        self.spot_check(image, pixels, &NoProgress)
    }
}

impl SimulateArgs {
    /// Simulates in memory and writes the image, or the counts of the detector.
    pub(super) fn in_memory<T: ConvReal>(
        &self,
        (scene, made): (&impl MakesImage<T>, &Preparation<'_>),
        read: &ReadScene<T>,
        exposing: Option<&Exposing>,
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Outcome> {
        let bar = context.bar("convolving");
        let clock = Instant::now();
        let simulator = scene.of_frame();
        let mut image = simulator.zeros();
        let counts = scene.simulate_into(image.view_mut(), &bar)?;
        let image = Image::new(image).map_err(PsfieldError::from)?;
        seconds.execute = clock.elapsed().as_secs_f64();
        drop(bar);

        let spot_check = (self.spot_check > 0)
            .then(|| {
                let _spinner = context.spinner("checking");
                scene.spot_check(&image, self.checked_pixels())
            })
            .transpose()?;

        let clock = Instant::now();
        let mut cards = self.cards(simulator, made)?;
        if let Some(check) = &spot_check {
            cards.extend(check.cards()?);
            if exposing.is_some() {
                cards.push(Card::comment(
                    "PSFCHK...: measured on the noise-free image, before the detector",
                ));
            }
        }
        let header = simulator.carried_header(&read.header, self.scene.scene.is_some());
        let exposure = if let Some(exposing) = exposing {
            Some(exposing.write(&image, &header, &cards)?)
        } else {
            psf_io::write_image(&self.output, &image, &header, &cards, self.overwrite)?;
            None
        };
        seconds.write = clock.elapsed().as_secs_f64();
        Ok(Outcome {
            counts,
            spot_check,
            exposure,
            nan_pixels: read.nan_pixels,
        })
    }

    /// Reads the scene and writes the image in bands of rows. There is one reader for each layer.
    pub(super) fn by_bands<T: ConvReal>(
        &self,
        (scene, made): (&impl StreamsImage<T>, &Preparation<'_>),
        read: &ReadScene<T>,
        readers: Vec<ImageReader>,
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Outcome> {
        let simulator = scene.of_frame();
        let header = simulator.carried_header(&read.header, true);
        let cards = self.cards(simulator, made)?;
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
            picker: scene.picker(self.checked_pixels()),
            read_seconds: 0.0,
            write_seconds: 0.0,
        };
        let counts = scene.stream(&mut rows, &bar)?;
        let nan_pixels = rows.readers.iter().map(ImageReader::nan_pixels).sum();
        let (read_seconds, write_seconds) = (rows.read_seconds, rows.write_seconds);
        seconds.execute = clock.elapsed().as_secs_f64() - read_seconds - write_seconds;
        seconds.read += read_seconds;
        drop(bar);

        let spot_check = (self.spot_check > 0)
            .then(|| {
                let _spinner = context.spinner("checking");
                let picker = rows.picker.clone();
                scene.spot_check_stream(&mut rows, picker)
            })
            .transpose()?;
        let clock = Instant::now();
        let cards = spot_check.as_ref().map(SpotCheck::cards).transpose()?;
        rows.writer
            .finish_with(cards.as_ref().map_or(&[], |cards| cards))?;
        seconds.write = write_seconds + clock.elapsed().as_secs_f64();
        Ok(Outcome {
            counts,
            spot_check,
            exposure: None,
            nan_pixels,
        })
    }

    /// Returns the number of pixels compared with the direct sum, and the seed that chooses them.
    fn checked_pixels(&self) -> (usize, u64) {
        (self.spot_check as usize, self.seed)
    }
}

/// Reads rows of the scene from its file and writes rows of the image to its file. Picks the pixels
/// of the spot check from the rows that it writes.
pub(super) struct FitsRows<T: ConvReal> {
    /// One for each layer.
    readers: Vec<ImageReader>,
    writer: ImageWriter<T>,
    picker: PixelPicker,
    read_seconds: f64,
    write_seconds: f64,
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
        let reader = &mut self.readers[layer];
        let read = reader.read_rows_into(rows.start, light);
        read.map_err(|error| with_nan_as(error, reader))?;
        self.read_seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }

    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), PsfieldError> {
        let clock = Instant::now();
        for row in rows.outer_iter() {
            self.picker.pass(row.iter().map(|v| v.as_f64()));
        }
        self.writer.write_rows(rows)?;
        self.write_seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }
}

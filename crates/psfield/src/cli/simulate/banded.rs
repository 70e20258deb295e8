//! Scenes larger than memory: rows from one FITS file to another.

use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use conv_core::{ConvReal, RowStream};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_io::{Card, ImageReader, ImageWriter, IoError};
use psf_types::{Anchor, Scene};
use psfield::{PixelPicker, PsfieldError, SceneLayout, SceneParts, SceneSources, Simulation, SpotCheck};

use super::super::context::Context;
use super::prepared::Preparations;
use super::report::Seconds;
use super::{Outcome, SimulateArgs};

/// The scene's rows as they come: those of its file, with the galaxies' light.
struct SceneRows<'a, T: ConvReal> {
    reader: ImageReader,
    sources: &'a SceneSources<T>,
}

impl<T: ConvReal> SceneRows<'_, T> {
    fn read_into(&mut self, first: usize, mut light: ArrayViewMut2<'_, T>) -> Result<(), IoError> {
        let p = self.sources.padding();
        if p == 0 {
            self.reader.read_rows_into(first, light.view_mut())?;
        } else {
            light.fill(T::zero());
            let shape = self.reader.shape();
            // Rows of the file among those asked for.
            let from = first.max(p);
            let to = (first + light.nrows()).min(p + shape.ny());
            if from < to {
                let rows = self.reader.read_rows::<T>(from - p..to - p)?;
                let columns = p..p + shape.nx();
                light
                    .slice_mut(s![from - first..to - first, columns])
                    .assign(&rows);
            }
        }
        self.sources.add_galaxies(light, first);
        Ok(())
    }
}

/// Rows of the scene out of its file, rows of the image into theirs; and the pixels for the spot check as they pass.
struct FitsRows<'a, 'b, T: ConvReal> {
    scene: &'a mut SceneRows<'b, T>,
    writer: ImageWriter<T>,
    picker: PixelPicker,
    read_seconds: f64,
    write_seconds: f64,
}

impl<T: ConvReal> RowStream<T> for FitsRows<'_, '_, T> {
    type Error = PsfieldError;

    fn read(&mut self, rows: Range<usize>, light: ArrayViewMut2<'_, T>) -> Result<(), PsfieldError> {
        let clock = Instant::now();
        self.scene.read_into(rows.start, light)?;
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

/// Rows read at once for the direct sum.
const BAND: usize = 512;

/// The direct sum at pixels that are sorted by rows, with only the rows in memory that they need.
fn exact_at<T: ConvReal>(
    simulation: &Simulation,
    rows_of_scene: &mut SceneRows<'_, T>,
    scene: &Scene<T>,
    anchor: Anchor,
    pixels: &[(usize, usize)],
) -> Result<Vec<f64>, PsfieldError> {
    let mut sums = Vec::with_capacity(pixels.len());
    let mut rest = pixels;
    while let Some(&(_, first)) = rest.first() {
        let count = rest.partition_point(|&(_, row)| row < first + BAND);
        let last = rest[count - 1].1;
        let rows = simulation.rows_reaching(scene, first..=last);
        let mut light = Array2::zeros((rows.len(), scene.shape().nx()));
        rows_of_scene.read_into(rows.start, light.view_mut())?;
        sums.extend(simulation.exact_at_rows(
            scene,
            Some((light.view(), rows.start)),
            anchor,
            &rest[..count],
        )?);
        rest = &rest[count..];
    }
    Ok(sums)
}

impl SimulateArgs {
    /// Reads the scene and writes its image by bands of rows.
    pub(super) fn by_bands<T: ConvReal>(
        &self,
        path: &Path,
        preparations: &mut Preparations,
        context: &Context,
    ) -> anyhow::Result<Outcome<T>> {
        let reader = self.scene.open(path)?;
        let header = reader.header().clone();
        let mut seconds = Seconds::default();
        let reach = self
            .psf(preparations, &mut seconds, context)?
            .reach(self.stamp_size);
        let layout = SceneLayout::of_image(reader.shape(), self.scene.finer())?;
        let sources = self.scene.sources::<T>(layout, &header, reach)?;
        let scene = sources.placed.scene();
        let parts = SceneParts {
            image: true,
            ..SceneParts::of(scene)
        };
        let prepared = self.prepared(parts, scene, preparations, &mut seconds, context)?;
        sources.warn(prepared.oversampling, context);
        let simulation = &prepared.simulation;
        let plan = prepared
            .plan
            .as_ref()
            .ok_or_else(|| anyhow::anyhow!("only methods with a plan stream"))?;
        let shape = self.shown(scene)?;
        let header = sources.placed.carried_header(&header);
        let cards = self.cards::<T>(simulation.model(), &prepared.placement)?;
        // None without a check, so that the header is as long as that of an image written as a whole.
        let late = if self.spot_check > 0 {
            SpotCheck::KEYWORDS.len()
        } else {
            0
        };
        let writer =
            ImageWriter::create_reserving(&self.output, shape, &header, &cards, late, self.overwrite)?;

        let bar = context.bar("convolving");
        let clock = Instant::now();
        let mut scene_rows = SceneRows {
            reader,
            sources: &sources.placed,
        };
        let mut rows = FitsRows {
            scene: &mut scene_rows,
            writer,
            picker: PixelPicker::new(shape, self.spot_check as usize, self.seed),
            read_seconds: 0.0,
            write_seconds: 0.0,
        };
        let counts = simulation.stream(plan, scene, &mut rows, &bar)?;
        let FitsRows {
            writer,
            picker,
            read_seconds,
            write_seconds,
            ..
        } = rows;
        seconds.execute = clock.elapsed().as_secs_f64() - read_seconds - write_seconds;
        seconds.read += read_seconds;
        drop(bar);

        let spot_check = (self.spot_check > 0)
            .then(|| {
                let _spinner = context.spinner("checking");
                SpotCheck::of_picked(picker, |pixels| {
                    exact_at(simulation, &mut scene_rows, scene, self.anchor, pixels)
                })
            })
            .transpose()?;
        let spot_check = self.judged::<T>(spot_check)?;
        let clock = Instant::now();
        let cards: Vec<Card> = spot_check
            .as_ref()
            .map(SpotCheck::cards)
            .transpose()?
            .into_iter()
            .flatten()
            .collect();
        writer.finish_with(&cards)?;
        seconds.write = write_seconds + clock.elapsed().as_secs_f64();
        let plan = plan.summary().map(|summary| (summary, counts));
        Ok(Outcome {
            image_shape: shape,
            sources: scene.sources().len(),
            galaxies: sources.placed.galaxies().len(),
            invalid_rows: sources.invalid_rows,
            rows_off_projection: sources.rows_off_projection,
            seconds,
            plan,
            spot_check,
            exposure: None,
            prepared,
            streamed: true,
        })
    }
}

//! A scene in memory as a whole.

use std::time::Instant;

use conv_core::ConvReal;
use psf_io::Card;
use psfield::{SceneParts, SpotCheck};

use super::super::context::Context;
use super::exposure_args::Exposing;
use super::prepared::{Preparations, timed};
use super::report::Seconds;
use super::{Outcome, SimulateArgs};

impl SimulateArgs {
    pub(super) fn in_memory<T: ConvReal>(
        &self,
        exposing: Option<&Exposing>,
        preparations: &mut Preparations,
        context: &Context,
    ) -> anyhow::Result<Outcome<T>> {
        let spinner = context.spinner("reading");
        let mut seconds = Seconds::default();
        let reach = self
            .psf(preparations, &mut seconds, context)?
            .reach(self.stamp_size);
        let ((scene, sources, header), read) = timed(|| self.scene.read::<T>(reach))?;
        seconds.read += read;
        drop(spinner);
        // A plan serves images with stars and without.
        let parts = SceneParts {
            sources: self.scene.catalog.is_some(),
            ..SceneParts::of(&scene)
        };
        let prepared = self.prepared(parts, &scene, preparations, &mut seconds, context)?;
        sources.warn(prepared.oversampling, context);
        let simulation = &prepared.simulation;

        let bar = context.bar("convolving");
        let clock = Instant::now();
        let (image, plan) = if let Some(plan) = &prepared.plan {
            let (image, counts) = simulation.run_planned(plan, &scene, &bar)?;
            (image, plan.summary().map(|summary| (summary, counts)))
        } else {
            let method = self.method.build::<T>(self.options()?)?;
            let image = simulation.run_with(&scene, method.as_ref(), self.anchor, &bar)?;
            (image, None)
        };
        seconds.execute = clock.elapsed().as_secs_f64();
        drop(bar);

        let spot_check = (self.spot_check > 0)
            .then(|| {
                let _spinner = context.spinner("checking");
                SpotCheck::run(&image, self.spot_check as usize, self.seed, |pixels| {
                    simulation.exact_at(&scene, self.anchor, pixels)
                })
            })
            .transpose()?;
        let spot_check = self.judged::<T>(spot_check)?;

        let clock = Instant::now();
        let mut cards = self.cards::<T>(simulation.model(), &prepared.placement)?;
        if let Some(check) = &spot_check {
            cards.extend(check.cards()?);
            if exposing.is_some() {
                cards.push(Card::comment(
                    "PSFCHK...: of the noise-free image, before the detector",
                ));
            }
        }
        let header = sources.placed.carried_header(&header);
        let exposure = if let Some(exposing) = exposing {
            Some(exposing.write(&image, &header, &cards)?)
        } else {
            psf_io::write_image(&self.output, &image, &header, &cards, self.overwrite)?;
            None
        };
        seconds.write = clock.elapsed().as_secs_f64();
        Ok(Outcome {
            image_shape: image.shape(),
            sources: scene.sources().len(),
            galaxies: sources.placed.galaxies().len(),
            invalid_rows: sources.invalid_rows,
            rows_off_projection: sources.rows_off_projection,
            seconds,
            plan,
            spot_check,
            exposure,
            prepared,
            streamed: false,
        })
    }
}

//! Simulators: built, prepared, and kept for later scenes with equal settings.

use std::any::Any;
use std::rc::Rc;
use std::time::Instant;

use conv_core::ConvReal;
use psf_types::NoProgress;
use psfield::device::Placement;
use psfield::{Device, Preparation, Psf, PsfieldError, Scene, SimulationWarning, Simulator};

use crate::context::{Context, with_option};
use crate::simulate::SimulateArgs;
use crate::simulate::report::Seconds;
use crate::simulate::scene::ReadScene;

/// Simulators kept for later scenes with equal settings. The one that was used last comes first.
#[derive(Default)]
pub(crate) struct Simulators {
    kept: Vec<(String, Rc<dyn Any>)>,
    /// The largest number of simulators kept. 0 for a single scene.
    most: usize,
    /// The number of scenes for which a model or plan was made, not reused.
    pub(crate) made: usize,
    /// The last PSF that was read.
    psf: Option<(String, Psf)>,
}

impl Simulators {
    /// Keeps at most `most` simulators.
    pub(crate) fn keeping(most: usize) -> Self {
        Self {
            most,
            ..Self::default()
        }
    }

    /// Forgets all simulators and PSFs.
    pub(crate) fn forget(&mut self) {
        self.kept.clear();
        self.psf = None;
    }

    /// Forgets all simulators and all open GPUs, after an error of a GPU: it may be lost, together
    /// with the plans on it.
    pub(super) fn forget_gpus(&mut self) {
        self.kept.clear();
        psfield::device::forget_gpus();
    }

    /// Returns the PSF that `key` describes. Reads it, unless it is the last PSF that was read.
    fn psf(&mut self, key: &str, read: impl FnOnce() -> anyhow::Result<Psf>) -> anyhow::Result<Psf> {
        match &self.psf {
            Some((kept, psf)) if kept == key => Ok(psf.clone()),
            _ => {
                let psf = read()?;
                self.psf = Some((key.to_owned(), psf.clone()));
                Ok(psf)
            }
        }
    }

    /// Returns the simulator that `key` describes completely. Builds it, unless it is kept from an
    /// earlier scene.
    fn get<T: ConvReal>(
        &mut self,
        key: &str,
        build: impl FnOnce() -> anyhow::Result<Simulator<T>>,
    ) -> anyhow::Result<Rc<Simulator<T>>> {
        if let Some(place) = self.kept.iter().position(|(k, _)| k == key) {
            let found = self.kept.remove(place);
            if let Ok(simulator) = Rc::clone(&found.1).downcast::<Simulator<T>>() {
                self.kept.insert(0, found);
                return Ok(simulator);
            }
        }
        self.kept.truncate(self.most.saturating_sub(1));
        let simulator = Rc::new(build()?);
        if self.most > 0 {
            let any: Rc<dyn Any> = Rc::<Simulator<T>>::clone(&simulator);
            self.kept.insert(0, (key.to_owned(), any));
        }
        Ok(simulator)
    }
}

/// Warns if stamps are too coarse to be shifted by fractions of a pixel. `what` shifts them.
pub(super) fn warn_of_coarse_stamps(what: &str, psf: &Psf, context: &Context) {
    const NEEDED: f64 = 2.0;
    if psf.grid().oversampling() < NEEDED {
        context.warn(&format!(
            "{what} shifts stamps by fractions of a pixel, but these stamps have fewer than two pixels per pixel of the image: \
             use oversampled stamps"
        ));
    }
}

/// Runs `work`. Returns its result and the seconds that it took.
pub(super) fn timed<R>(work: impl FnOnce() -> anyhow::Result<R>) -> anyhow::Result<(R, f64)> {
    let clock = Instant::now();
    let result = work()?;
    Ok((result, clock.elapsed().as_secs_f64()))
}

impl SimulateArgs {
    /// Opens the requested GPU first, because without it the rest of the work is useless.
    pub(super) fn open_gpu(&self, context: &Context) -> Result<(), PsfieldError> {
        // A scene without an image holds only stars and galaxies, which need no GPU. A build without
        // GPU support reports the missing support at once.
        let needed = self.scene.scene.is_some() || !cfg!(feature = "gpu");
        let options = self.options();
        if options.device == Device::Gpu && needed {
            let _spinner = context.spinner("opening the GPU");
            psfield::device::open_gpu(options.gpu_adapter.as_deref())?;
        }
        Ok(())
    }

    /// Returns the PSF of the file: kept, or read anew.
    pub(super) fn psf(
        &self,
        simulators: &mut Simulators,
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Psf> {
        let key = format!("{:?}", (&self.psf, &self.fit));
        simulators.psf(&key, || {
            let _spinner = context.spinner("reading the PSF");
            let (psf, read) = timed(|| self.fit.open(&self.psf, context))?;
            seconds.read += read;
            Ok(psf)
        })
    }

    /// Returns the simulator for scenes like one that has been read: kept, or built anew.
    pub(super) fn simulator<T: ConvReal>(
        &self,
        psf: &Psf,
        read: &ReadScene<T>,
        simulators: &mut Simulators,
        context: &Context,
    ) -> anyhow::Result<Rc<Simulator<T>>> {
        let (options, shape) = (self.options(), read.files.shape);
        // Everything on which a simulator depends.
        let colour = (
            &self.colour.bandpass,
            &self.colour.dispersion,
            read.light.spectra(),
        );
        let key = format!("{:?}", (&self.psf, &self.fit, colour, shape, &options, T::NAME));
        simulators.get(&key, || {
            let psf = self.psf_of(psf, &read.light, context)?;
            let built = psf.simulator((shape.ny(), shape.nx())).options(options).build();
            built.map_err(|error| self.explained(error))
        })
    }

    /// Makes the models and the plan that a scene needs, unless they exist.
    pub(super) fn prepare<'a, T: ConvReal>(
        &self,
        simulator: &'a Simulator<T>,
        scene: &Scene<'_, T>,
        simulators: &mut Simulators,
        seconds: &mut Seconds,
        context: &Context,
    ) -> anyhow::Result<Preparation<'a>> {
        let new = !simulator.is_prepared(scene);
        if new && let Some(warning) = simulator.psf_warning(scene)? {
            context.warn(&warning.to_string());
        }
        let spinner = context.spinner("fitting and planning");
        let made = simulator.prepare(scene, &NoProgress);
        let made = made.map_err(|e| self.explained(e))?;
        drop(spinner);
        if new {
            simulators.made += 1;
            [seconds.fit, seconds.plan] = [made.fit_seconds, made.plan_seconds];
        }
        self.warn_of_placement(&made.placement, context);
        Ok(made)
    }

    /// Prints the warnings about a scene. The time in which they are found counts as planning.
    pub(super) fn warn_of_scene(
        warnings: impl FnOnce() -> Vec<SimulationWarning>,
        seconds: &mut Seconds,
        context: &Context,
    ) {
        let clock = Instant::now();
        for warning in warnings() {
            context.warn(&with_option(&warning, warning.setting()));
        }
        seconds.plan += clock.elapsed().as_secs_f64();
    }

    /// Warns if the work is not done on the GPU that was requested.
    pub(super) fn warn_of_placement(&self, placement: &Placement, context: &Context) {
        if placement.is_failure() {
            context.warn(&format!("the work is done {placement}"));
        } else if self.options().device == Device::Gpu && placement.adapter().is_none() {
            context.warn(
                "--device gpu applies to scenes with an image: stars and galaxies are drawn on the CPU",
            );
        }
    }
}

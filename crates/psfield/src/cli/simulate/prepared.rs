//! What scenes of one kind share.

use std::any::Any;
use std::sync::Arc;
use std::time::Instant;

use conv_core::ConvReal;
use psfield::{Gpus, Placement, PsfInput, Simulation, SimulationPlan};

/// Models and plan for scenes of one kind.
pub(super) struct Prepared<T: ConvReal> {
    pub(super) simulation: Simulation,
    /// Of the methods that have one.
    pub(super) plan: Option<SimulationPlan<T>>,
    /// Where images are convolved.
    pub(super) placement: Placement,
    /// Pixels of the PSF file's stamps along each side of an image pixel.
    pub(super) oversampling: f64,
    /// How long the model took, and the plan.
    pub(super) seconds: [f64; 2],
}

/// Preparations kept for the next scene of the same kind, the latest first.
#[derive(Default)]
pub(crate) struct Preparations {
    kept: Vec<(String, Arc<dyn Any + Send + Sync>)>,
    /// How many; none are kept for a single scene.
    most: usize,
    /// How many were made.
    made: usize,
    /// The last PSF that was read.
    psf: Option<(String, Arc<PsfInput>)>,
    /// The GPUs that are open.
    gpus: Gpus,
}

impl Preparations {
    /// A keeper of at most so many.
    pub(crate) fn keeping(most: usize) -> Self {
        Self {
            most,
            ..Self::default()
        }
    }

    /// How many were made, in place of found.
    pub(crate) fn made(&self) -> usize {
        self.made
    }

    /// The GPUs that are open, which all preparations share.
    pub(super) fn gpus(&mut self) -> &mut Gpus {
        &mut self.gpus
    }

    /// After trouble with a GPU: it may be lost, and the plans on it with it.
    pub(super) fn forget_gpus(&mut self) {
        self.kept.clear();
        self.gpus = Gpus::default();
    }

    /// The PSF that `key` describes, the last one or read.
    pub(super) fn psf(
        &mut self,
        key: &str,
        read: impl FnOnce() -> anyhow::Result<PsfInput>,
    ) -> anyhow::Result<Arc<PsfInput>> {
        match &self.psf {
            Some((kept, psf)) if kept == key => Ok(Arc::clone(psf)),
            _ => {
                let psf = Arc::new(read()?);
                self.psf = Some((key.to_owned(), Arc::clone(&psf)));
                Ok(psf)
            }
        }
    }

    /// Where nothing is kept, the PSF need not be there twice.
    pub(super) fn forget_single_psf(&mut self) {
        if self.most == 0 {
            self.psf = None;
        }
    }

    /// The preparation that `key` describes in full, kept or made, and whether it was made.
    pub(super) fn get<T: ConvReal>(
        &mut self,
        key: &str,
        make: impl FnOnce(&mut Gpus) -> anyhow::Result<Prepared<T>>,
    ) -> anyhow::Result<(Arc<Prepared<T>>, bool)> {
        if let Some(place) = self.kept.iter().position(|(k, _)| k == key) {
            let found = self.kept.remove(place);
            if let Ok(prepared) = Arc::clone(&found.1).downcast::<Prepared<T>>() {
                self.kept.insert(0, found);
                return Ok((prepared, false));
            }
        }
        self.kept.truncate(self.most.saturating_sub(1));
        let prepared = Arc::new(make(&mut self.gpus)?);
        self.made += 1;
        if self.most > 0 {
            let any: Arc<dyn Any + Send + Sync> = Arc::<Prepared<T>>::clone(&prepared);
            self.kept.insert(0, (key.to_owned(), any));
        }
        Ok((prepared, true))
    }
}

/// What a piece of work gives, and the seconds that it took.
pub(super) fn timed<R>(work: impl FnOnce() -> anyhow::Result<R>) -> anyhow::Result<(R, f64)> {
    let clock = Instant::now();
    let result = work()?;
    Ok((result, clock.elapsed().as_secs_f64()))
}

//! Galaxies with Sersic profiles as extended sources.

use std::sync::Arc;

use conv_core::{ExtendedSources, Light};
use psf_types::{PointSource, SersicSource};
use sersic::SersicLight;

/// Gives galaxies to `work` as extended sources.
pub(crate) fn extended<R>(galaxies: &[SersicSource], work: impl FnOnce(ExtendedSources<'_>) -> R) -> R {
    let point = |galaxy: &SersicSource| PointSource::new(galaxy.position(), galaxy.flux()).unwrap();
    let points: Vec<PointSource> = galaxies.iter().map(point).collect();
    let light = |index: usize| -> Light { Arc::new(SersicLight::new(&galaxies[index])) };
    work(ExtendedSources {
        points: &points,
        light: &light,
    })
}

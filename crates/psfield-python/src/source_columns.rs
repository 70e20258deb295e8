//! Sources as columns of numbers, for derivatives with respect to these numbers.

use ndarray::{Array2, ArrayView2, aview1};
use psfield::conv_core::{ConvReal, PointGradient};
use psfield::psf_types::{DataError, PointSource, Position, SersicProfile, SersicSource};
use psfield::{Scene, SourceGradients};

use crate::error::Failure;

/// The number of columns: x, y, flux, re (0 for a star), n, q, angle.
const COLUMNS: usize = 7;

/// Sources of an array `[column, source]`.
pub(crate) struct SourceColumns {
    stars: Vec<PointSource>,
    galaxies: Vec<SersicSource>,
    /// For each source, whether it is a galaxy.
    are_galaxies: Vec<bool>,
}

impl SourceColumns {
    /// Errors name the source.
    pub(crate) fn new(columns: ArrayView2<'_, f64>) -> Result<Self, Failure> {
        let mut found = Self {
            stars: Vec::new(),
            galaxies: Vec::new(),
            are_galaxies: Vec::new(),
        };
        for (index, source) in columns.columns().into_iter().enumerate() {
            let [x, y, flux, re, n, q, angle] = std::array::from_fn::<f64, COLUMNS, _>(|i| source[i]);
            let mut add = || -> Result<(), DataError> {
                let position = Position::new(x, y)?;
                if re == 0.0 {
                    found.stars.push(PointSource::new(position, flux)?);
                } else {
                    let profile = SersicProfile::new(re, n, q, angle)?;
                    found.galaxies.push(SersicSource::new(position, flux, profile)?);
                }
                Ok(())
            };
            add().map_err(Failure::of(format!("source {index}")))?;
            found.are_galaxies.push(re != 0.0);
        }
        Ok(found)
    }

    pub(crate) fn scene<T: ConvReal>(&self) -> Scene<'_, T> {
        Scene::dark()
            .with_stars(&self.stars)
            .with_galaxies(&self.galaxies)
    }

    /// The derivatives with respect to the numbers, `[column, source]`.
    pub(crate) fn derivatives(&self, found: &SourceGradients) -> Array2<f64> {
        let mut derivatives = Array2::zeros((COLUMNS, self.are_galaxies.len()));
        let (mut stars, mut galaxies) = (found.stars.iter(), found.galaxies.iter());
        for (&is_galaxy, mut to) in self.are_galaxies.iter().zip(derivatives.columns_mut()) {
            let values = if is_galaxy {
                galaxies.next().map(|galaxy| {
                    let PointGradient { flux, x, y } = galaxy.point;
                    let (re, angle) = (galaxy.half_light_radius_px, galaxy.angle_deg);
                    [x, y, flux, re, galaxy.index, galaxy.axis_ratio, angle]
                })
            } else {
                stars
                    .next()
                    .map(|star| [star.x, star.y, star.flux, 0.0, 0.0, 0.0, 0.0])
            };
            to.assign(&aview1(&values.expect("one for each source")));
        }
        derivatives
    }
}

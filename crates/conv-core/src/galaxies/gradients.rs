//! Derivatives with respect to extended sources.

use ndarray::{Array1, Array2, ArrayView2, s};
use psf_types::{Anchor, FrameShape, LightProfile, PixelRegion, Position};
use rayon::prelude::*;

use super::far_field::{BlockWeights, FarLight};
use super::far_products::{far_products, repeated_products};
use super::galaxy_drawer::{
    ExtendedSources, ExtendedToDraw, GalaxyDrawer, Light, Placed, Psf, Window, window_at,
};
use super::window::Drawn;
use super::window_products::{Products, WindowProducts};
use crate::overlap::shared;
use crate::sources::{PointGradient, with_unit_flux};
use crate::{ConvError, ConvReal, view};

/// The light of a source on either side of its own, along a parameter: the derivative is
/// `(after - before) / step`.
#[derive(Clone)]
pub struct Variation {
    /// The light for the smaller value of the parameter.
    pub before: Light,
    /// The light for the larger value.
    pub after: Light,
    /// The difference of the two values.
    pub step: f64,
}

impl std::fmt::Debug for Variation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let step = &self.step;
        f.debug_struct("Variation")
            .field("step", step)
            .finish_non_exhaustive()
    }
}

/// The derivatives of a number with respect to an extended source.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ExtendedGradient {
    /// With respect to flux and position.
    pub point: PointGradient,
    /// Along each [`Variation`]. Empty if the source does not reach the image.
    pub variations: Vec<f64>,
}

/// Returns the variations of the light of the source with an index.
pub type Variations<'a> = &'a (dyn Fn(usize) -> Vec<Variation> + Sync);

/// The products with a source on its window, and the lights outside it, if there is enough.
type NearAndFar = (Products, Option<Vec<FarLight>>);

/// The light outside a window is moved by this number of pixels to either side. It is smooth there, and
/// computed in single precision.
const FAR_STEP: f64 = 0.25;
/// A window that is drawn with all components, in double precision, is moved by this number of pixels.
const STEP: f64 = 1e-4;

impl<T: ConvReal> GalaxyDrawer<T> {
    /// The derivatives of `sum(image * sources)`. `image` holds the pixels of a region of the frame.
    pub(crate) fn gradients(
        &self,
        catalogue: ExtendedToDraw<'_>,
        variations: Variations<'_>,
        region: PixelRegion,
        image: ArrayView2<'_, T>,
    ) -> Result<Vec<ExtendedGradient>, ConvError> {
        let points = catalogue.sources.points;
        let of_unit_flux = with_unit_flux(points);
        let sources = ExtendedSources {
            points: &of_unit_flux,
            ..catalogue.sources
        };
        let unit = ExtendedToDraw { sources, ..catalogue };
        let placed = self.placed(unit, region, false)?;
        let found: Vec<Vec<NearAndFar>> = Self::groups(&placed)
            .par_iter()
            .map(|group| self.of_group(unit, group, variations, (region, image)))
            .collect::<Result<_, _>>()?;
        let (mut products, far): (Vec<Products>, Vec<_>) = found.into_iter().flatten().unzip();
        let with_far = products.iter_mut().zip(far);
        let with_far = with_far.filter_map(|(products, far)| Some((products, far?)));
        let (with_far, lights): (Vec<&mut Products>, Vec<Vec<FarLight>>) = with_far.unzip();
        let outside = far_products(&lights, image, region, unit.progress)?;
        for (products, sums) in with_far.into_iter().zip(outside) {
            products.add_differences(&sums, 1.0, FAR_STEP);
        }
        let mut gradients = vec![ExtendedGradient::default(); points.len()];
        for (placed, products) in placed.iter().zip(products) {
            gradients[placed.index] = products.for_flux(points[placed.index].flux());
        }
        Ok(gradients)
    }

    /// The products of an image, which holds the pixels of a region, with the sources of a group on their windows.
    /// And the light of each outside its window: its own, moved along x and y, and varied.
    fn of_group(
        &self,
        catalogue: ExtendedToDraw<'_>,
        group: &[Placed],
        variations_of: Variations<'_>,
        (region, image): (PixelRegion, ArrayView2<'_, T>),
    ) -> Result<Vec<NearAndFar>, ConvError> {
        let side = group[0].key.0;
        let local = self.local_of(group);
        let (mut near, weights) = (WindowProducts::new(side), BlockWeights::<f64>::new(side));
        let of_source = |placed: &Placed| {
            catalogue.progress.check_cancelled()?;
            let (x, y) = catalogue.position(placed.index);
            let position = Position::new(x, y).map_err(ConvError::Result)?;
            let window = window_at((x, y), side);
            let centre = (x - window.0 as f64, y - window.1 as f64);
            let (light, variations) = (catalogue.light(placed.index), variations_of(placed.index));
            let mut vectors = self.psfs.vectors();
            let slopes = vectors.with_slopes(position)?;
            let psf = self.psf(local.as_ref(), position, 1.0)?;
            let of_window = view::region(window.0, window.1, (side, side));
            let on_region = shared(of_window, region);
            let part = on_region.map(|[(columns, from_columns), (rows, from_rows)]| {
                let part = image.slice(s![from_rows, from_columns]);
                (part, (columns.start, rows.start))
            });
            let mut products = Products::none(&variations);
            let moments = match &psf {
                Psf::Local(local, coefficients) => {
                    let mut projected = Vec::new();
                    let [_, along_x, along_y] = slopes.map(|psf| {
                        vectors.set_vector(&psf);
                        vectors.project(&local.block.modes, &mut projected);
                        projected.clone()
                    });
                    if let Some((part, at)) = part {
                        let drawn = Drawn {
                            spectra: &local.spectra,
                            light: light.as_ref(),
                            centre,
                            coefficients,
                            outline: &placed.outline,
                        };
                        near.set_image(part, at);
                        products = near.of(&drawn, [&along_x, &along_y], &variations);
                    }
                    local.block.kernels.moments_of(coefficients)
                }
                Psf::Exact(psf) => {
                    if let Some((part, at)) = part {
                        let place = (window, centre, catalogue.frame.shape());
                        let light: &dyn LightProfile = light.as_ref();
                        let lights = (light, variations.as_slice());
                        products = self.exact_products(&slopes, lights, place, (part, at))?;
                    }
                    self.stamps().moments_of(psf.view())
                }
            };
            // The light outside is kept until all galaxies are done, without transforms.
            let far = placed.reach.and_then(|reach| {
                let light = catalogue.light(placed.index);
                let far = self.far_light(moments, light, (x, y), window, reach)?;
                Some(moved_and_varied(&far, variations_of(placed.index)))
            });
            if let Some((lights, (part, at))) = far.as_ref().zip(part) {
                let sums = repeated_products(lights, &weights, part, at);
                products.add_differences(&sums, -1.0, FAR_STEP);
            }
            Ok((products, far))
        };
        group.iter().map(of_source).collect()
    }

    /// The products of an image with the window of a source that is drawn with all components. `psfs` are its PSF and
    /// the derivatives with respect to x and y. The image is dark outside `part`.
    fn exact_products(
        &self,
        psfs: &[Array1<f64>; 3],
        (light, variations): (&dyn LightProfile, &[Variation]),
        (window, centre, frame): (Window, (f64, f64), FrameShape),
        (part, (column, row)): (ArrayView2<'_, T>, (usize, usize)),
    ) -> Result<Products, ConvError> {
        let (x, y) = centre;
        let mut drawn = vec![
            (light, centre),
            (light, (x + STEP, y)),
            (light, (x - STEP, y)),
            (light, (x, y + STEP)),
            (light, (x, y - STEP)),
        ];
        for variation in variations {
            drawn.extend([&variation.after, &variation.before].map(|light| (light.as_ref() as _, centre)));
        }
        let product = |values: Array2<f64>| -> f64 {
            let values = values.slice(s![row..row + part.nrows(), column..column + part.ncols()]);
            values.iter().zip(part).map(|(v, g)| v * g.as_f64()).sum()
        };
        let sums = |psf: &Array1<f64>, drawn: &[(&dyn LightProfile, (f64, f64))]| {
            let mut sums = Vec::with_capacity(drawn.len());
            let take = |values| sums.push(product(values));
            self.exact_windows(psf, 1.0, drawn, window, frame, take)?;
            Ok::<_, ConvError>(sums)
        };
        let mut products = Products::none(variations);
        products.add_differences(&sums(&psfs[0], &drawn)?, 1.0, STEP);
        // With the PSFs of pixels, that of the position does not count.
        if self.psfs.options().anchor() != Anchor::Output {
            for (sum, psf) in products.galaxy[1..].iter_mut().zip(&psfs[1..]) {
                *sum += sums(psf, &drawn[..1])?[0];
            }
        }
        Ok(products)
    }
}

/// The light of a source outside its window: its own, moved along x and y to either side, and varied.
fn moved_and_varied(far: &FarLight, variations: Vec<Variation>) -> Vec<FarLight> {
    let moved = |dx: f64, dy: f64| FarLight {
        centre: (far.centre.0 + dx, far.centre.1 + dy),
        ..far.clone()
    };
    let mut lights = vec![
        far.clone(),
        moved(FAR_STEP, 0.0),
        moved(-FAR_STEP, 0.0),
        moved(0.0, FAR_STEP),
        moved(0.0, -FAR_STEP),
    ];
    for variation in variations {
        lights.extend([variation.after, variation.before].map(|light| FarLight { light, ..far.clone() }));
    }
    lights
}

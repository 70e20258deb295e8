//! Faint light next to bright light.

use ndarray::Array2;
use psfield::Method;

use super::images::{Light, PRECISIONS, Precision, error_where};
use super::models::{FRAME, SIDE, jumping, smooth};
use super::scenes::{COLUMNS, METHODS, uneven_of};
use super::{Case, Cell, Section};

/// Largest error of faint light where it must be accurate, relative to its peak.
const FAINT: f64 = 1e-5;
/// Brightness of the bright light in these cases, relative to the faint light.
const CONTRAST: f64 = 1e12;

/// Faint texture with five stars of 1e12 on it.
pub(super) fn texture_and_stars() -> Array2<f64> {
    let mut light = uneven_of(FRAME);
    for (x, y) in STARS {
        light[[y, x]] = CONTRAST;
    }
    light
}

const STARS: [(usize, usize); 5] = [(12, 10), (70, 15), (45, 40), (20, 66), (84, 61)];

/// Faint texture with a disc of bright pixels.
pub(super) fn texture_and_disc() -> Array2<f64> {
    let mut light = uneven_of(FRAME);
    for ((y, x), value) in light.indexed_iter_mut() {
        if x.abs_diff(48).pow(2) + y.abs_diff(40).pow(2) < 64 {
            *value = CONTRAST;
        }
    }
    light
}

/// Returns whether the stamp of any bright pixel reaches a pixel.
fn reached(light: &Array2<f64>, x: usize, y: usize) -> bool {
    let reach = SIDE / 2;
    let rows = y.saturating_sub(reach)..(y + reach + 1).min(FRAME.1);
    let columns = x.saturating_sub(reach)..(x + reach + 1).min(FRAME.0);
    light
        .slice(ndarray::s![rows, columns])
        .iter()
        .any(|&v| v > 1e-3 * CONTRAST)
}

pub(super) fn section() -> Section {
    /// A scene and the limits for its faint light: by transforms and by `auto`, each in f64 and
    /// f32.
    type Row = (&'static str, fn() -> Array2<f64>, [[f64; 2]; 2]);
    // Noise of the bright light: its rounding times the contrast.
    let noise = [1e-15 * CONTRAST, 1e-6 * CONTRAST];
    let rows: [Row; 2] = [
        (
            "next to five stars of 1e12",
            texture_and_stars,
            [noise, [FAINT; 2]],
        ),
        (
            "next to a disc of 200 pixels of 1e12",
            texture_and_disc,
            [noise, noise],
        ),
    ];
    let cases = rows
        .into_iter()
        .flat_map(|(name, light, [by_transforms, by_auto])| {
            PRECISIONS.map(move |precision| {
                Case::new(format!("{name}, {}", precision.name()), move || {
                    let index = usize::from(precision == Precision::F32);
                    METHODS
                        .map(|method| {
                            let limit = match method {
                                Method::Direct => FAINT,
                                Method::Auto => by_auto[index],
                                _ => by_transforms[index],
                            };
                            let light = Light::of(light()).scaled(1.0, precision);
                            let model = if matches!(method, Method::Patch(_)) {
                                jumping()
                            } else {
                                smooth()
                            };
                            let got = model.and_then(|model| {
                                error_where(&model, &light, (method, precision), |x, y| {
                                    !reached(&light.pixels, x, y)
                                })
                            });
                            Cell::error(got, limit)
                        })
                        .to_vec()
                })
            })
        })
        .collect();
    Section {
        title: "Faint light next to bright light",
        story: "The largest difference where no bright light reaches, divided by the peak of the light there.\n\n\
            **A remaining limit:** a transform spreads rounding noise of its brightest light over all of its\n\
            pixels, 1e-7 of that light in f32 and 1e-16 in f64. Transforms only (`basis`, `patch`, `lowrank`)\n\
            therefore cannot hold a range of 1e12 in f32. `auto` draws single bright pixels apart and holds\n\
            this range next to stars. Bright *extended* light would have to be drawn apart as well. In an image\n\
            this costs ordinary galaxies many times their transform, since nothing distinguishes their own\n\
            wings from faint light that matters. There f32 is good to 1e-6 of the brightest light nearby. This is below\n\
            its photon noise up to 1e12 electrons. For more, use `--precision f64` or `--method direct`.",
        columns: COLUMNS,
        cases,
    }
}

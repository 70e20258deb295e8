//! psfield beside patches of constant PSF.

use metrics::Summary;
use ndarray::Array2;

use crate::plot::{Picture, PictureAxes, PlotError, Scale, pictures};
use crate::readable::short;
use crate::report::Reproduction;
use crate::report::document::{NamedFigure, Section, Table};

impl Reproduction {
    pub(super) fn galaxy_section(&self) -> Result<Section, PlotError> {
        let galaxy = &self.large_galaxy;
        let peak = galaxy.original.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let sky = Scale::Asinh {
            soft: peak * 0.02,
            high: peak,
        };
        let relative = |image: &Array2<f64>| (image - &galaxy.exact) * (100.0 / peak);
        let (of_patches, of_lowrank) = (relative(&galaxy.patches), relative(&galaxy.lowrank));
        let most = |image: &Array2<f64>| {
            let sizes = Summary::of(image.iter().map(|v| v.abs())).ok();
            sizes
                .and_then(|s| s.quantile(0.998).ok())
                .unwrap_or(0.0)
                .max(1e-15)
        };
        let difference = Scale::Difference {
            most: most(&of_patches),
        };
        let patches = format!("patches of {} pixels", galaxy.patch);
        let patches_off = format!("patches less exact, {} pixels", galaxy.patch);
        let (flux, percent) = ("flux a pixel", "% of the peak");
        let figure = pictures(&[
            panel("original", &galaxy.original, sky, flux),
            panel("psfield, transforms alone", &galaxy.lowrank, sky, flux),
            panel(patches.as_str(), &galaxy.patches, sky, flux),
            panel(patches_off.as_str(), &of_patches, difference, percent),
            panel(
                "psfield less exact, the same colours",
                &of_lowrank,
                difference,
                percent,
            ),
            panel(
                "psfield less exact, its own colours",
                &of_lowrank,
                Scale::Difference {
                    most: most(&of_lowrank),
                },
                percent,
            ),
        ])?;
        Ok(Section {
            title: "An extended galaxy".to_owned(),
            paragraphs: vec![format!(
                "A galaxy over {} x {} pixels, over which the PSF varies as over the whole field. Against the direct sum in double precision, \
                 patches are off by {} of the peak at most (relative L2 {}), psfield by {} ({}).",
                galaxy.side,
                galaxy.side,
                short(Some(galaxy.patch_max_over_peak)),
                short(Some(galaxy.patch_relative_l2)),
                short(Some(galaxy.lowrank_max_over_peak)),
                short(Some(galaxy.lowrank_relative_l2)),
            )],
            figures: vec![NamedFigure {
                name: "galaxy",
                caption: "The galaxy before and after, and the differences from the direct sum: patches leave seams where one PSF gives way to \
                          the next. In the same colours psfield's differences are too small to be seen."
                    .to_owned(),
                figure,
            }],
            ..Section::default()
        })
    }

    pub(super) fn table_1_section(&self) -> Section {
        let mut table = Table::new(
            "Seconds are those of the fastest run; the ratio is to one convolution with a single PSF in the same run. Errors are relative L2 \
             against the direct sum in double precision at random pixels.",
            &["image", "method", "setting", "seconds", "ratio", "error"],
        );
        for row in self.table_1.sizes.iter().flat_map(|outcome| &outcome.rows) {
            table.rows.push(vec![
                format!("{} x {}", row.size[0], row.size[1]),
                row.method.to_owned(),
                row.setting.clone().unwrap_or_else(|| "-".to_owned()),
                short(Some(row.seconds)),
                format!("{:.2}", row.ratio_to_single),
                short(row.relative_l2),
            ]);
        }
        Section {
            title: "Table 1: patches and psfield".to_owned(),
            paragraphs: vec![
                "Every pixel is lit, and the PSF varies over each image as over the whole field. The method single uses one PSF for the whole image: the \
                 fastest, and wrong; patch one for each patch; lowrank is psfield by transforms alone. The time of patches holds that of making their PSFs from the components; psfield's plan, made once for a model and a \
                 frame, is not in its time."
                    .to_owned(),
            ],
            tables: vec![table],
            ..Section::default()
        }
    }
}

fn panel<'a>(title: &'a str, image: &'a Array2<f64>, scale: Scale, quantity: &'a str) -> Picture<'a> {
    Picture {
        title,
        pixels: image.view(),
        scale,
        quantity,
        axes: PictureAxes::Pixels,
    }
}

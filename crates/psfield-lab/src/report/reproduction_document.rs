//! The report of a [`Reproduction`]: its text, tables and figures.

use metrics::Summary;
use ndarray::Array2;

use crate::bench::BenchRow;
use crate::plot::{
    Axis, Curve, Curves, Mark, Picture, PictureAxes, PlotError, Scale, pictures, positions_figure,
};
use crate::report::document::{Document, NamedFigure, Section, Table, short};
use crate::report::evaluation::PAPER_ECCENTRICITY_Q90;
use crate::report::object_figures::{error_table, maps, shape_figures, target_table};
use crate::report::{ModelRow, ObjectKind, Reproduction, Software};

/// The paper whose results the report measures anew with psfield.
const PAPER: &str = "Bai, Jia, Lv, Zhang, Xiang and Nie (2025): An Ultrafast Image Simulation Technique with Spatially Variable \
                     Point-spread Functions. The Astronomical Journal, doi:10.3847/1538-3881/ad9b2e, arXiv:2502.10015";

impl Reproduction {
    /// Makes the report, with all figures.
    ///
    /// # Errors
    /// [`PlotError`] when a figure cannot be drawn.
    pub fn document(&self, software: Software) -> Result<Document, PlotError> {
        let [radius, index, ratio, angle] = self.galaxy;
        let tolerance = format!("{:e} (default)", self.tolerance);
        let load = self
            .load
            .map_or_else(|| "unknown".to_owned(), |load| format!("{load:.2}"));
        let inputs = vec![
            ("paper", PAPER.to_owned()),
            ("telescope", format!("{} (preset survey-2m)", self.telescope)),
            ("frame", format!("{} pixels", self.frame)),
            ("stamps", format!("{} x {} pixels", self.stamp[0], self.stamp[1])),
            ("PSF samples", format!("{}, on a regular grid", self.samples)),
            ("objects", format!("{0} stars and {0} galaxies", self.objects)),
            (
                "galaxies",
                format!(
                    "half-light radius {radius} pixels, Sersic index {index}, axis ratio {ratio}, angle {angle} degrees"
                ),
            ),
            (
                "model",
                format!(
                    "{} components, interpolation {}, default settings",
                    self.basis.rank, self.basis.interpolation
                ),
            ),
            ("tolerance of the engine for figures and targets", tolerance),
            ("start (UTC)", self.started.clone()),
            ("load at the start (1-minute average)", load),
            ("run time (s)", format!("{:.0}", self.seconds)),
        ];
        Ok(Document {
            title: "psfield: a spatially varying PSF against the truth".to_owned(),
            software,
            inputs,
            sections: vec![
                self.accuracy_section(),
                self.basis_section()?,
                self.sampling_section()?,
                self.shape_section()?,
                self.map_section()?,
                self.galaxy_section()?,
                self.table_1_section(),
                self.colours.section()?,
                self.frames.section(),
            ],
        })
    }

    fn accuracy_section(&self) -> Section {
        let targets = target_table(
            "psfield's targets. Those for stars and galaxies hold at the default tolerance. In the paper, 90 % of the differences of eccentricity, which it calls ellipticity, are below 0.0901.",
            &self.targets,
        );
        let tolerances = error_table(
            "Stars and galaxies simulated at several tolerances (method lowrank): absolute differences from their true images.",
            &["objects", "tolerance", "seconds per frame"],
            self.tolerances.iter().map(|row| {
                let kind = match row.kind {
                    ObjectKind::Point => "stars",
                    ObjectKind::Extended => "galaxies",
                };
                let (tolerance, seconds) = (format!("{:e}", row.tolerance), short(Some(row.seconds)));
                (vec![kind.to_owned(), tolerance, seconds], &row.summary)
            }),
        );
        let interpolations = error_table(
            "PSFs evaluated directly from the model (not drawn by the engine), with several interpolators of the coefficients: absolute differences from the truth.",
            &["interpolation"],
            self.interpolations.iter().map(|row| {
                let in_use = if row.in_use { " (in use)" } else { "" };
                (vec![format!("{}{in_use}", row.interpolation)], &row.summary)
            }),
        );
        let mut tables = vec![targets, tolerances, interpolations];
        // With fewer than 9 samples along each axis, half of them are too few for this table.
        if !self.fewer_samples.is_empty() {
            tables.push(ModelRow::table(
                "Errors of models with fewer samples on regular grids, computed by the exact sum over the components. Truncation error: largest change of a sample by leaving out components (relative L2).",
                &self.fewer_samples,
            ));
        }
        tables.push(ModelRow::table(
            "Errors of the model with all components and with fewer, computed by the exact sum over the components. Truncation error: largest change of a sample by leaving out components (relative L2).",
            &self.fewer_components,
        ));
        Section {
            title: "Accuracy".to_owned(),
            paragraphs: vec![
                "Each object is measured twice in the same window by a Gaussian fit: in the image made by the fast engine, and in the true \
                 image, for which the optics are evaluated at the object's own position. The error has three parts. They come from the \
                 interpolation between samples, from the components left out (at most 1e-4, relative L2, at a sample), and from the \
                 engine's tolerance."
                    .to_owned(),
                "If the errors hardly change from one tolerance to the next, the engine's part of the error is no longer the largest. The table of \
                 interpolators shows the error that remains without the engine. Bilinear and natural neighbour interpolation miss the \
                 curvature of the PSF between samples. Cubic interpolation follows it, and so does a polynomial over the whole field \
                 (interpolation polynomial=D, of degree D) if the optics are as smooth as these."
                    .to_owned(),
            ],
            tables,
            figures: Vec::new(),
        }
    }

    fn basis_section(&self) -> Result<Section, PlotError> {
        let weights = &self.basis.cumulative_weights;
        let points = weights
            .iter()
            .enumerate()
            .map(|(k, &w)| ((k + 1) as f64, w))
            .collect();
        let at = |k: usize| k.checked_sub(1).and_then(|i| weights.get(i)).copied();
        let mark =
            |k: usize, name: &str| at(k).map(|w| Mark::Point(k as f64, w, format!("{name}: {k} components")));
        let marks = match self.basis.elbow {
            Some(elbow) if elbow == self.basis.rank => mark(elbow, "elbow and kept").into_iter().collect(),
            elbow => elbow
                .and_then(|k| mark(k, "elbow"))
                .into_iter()
                .chain(mark(self.basis.rank, "kept"))
                .collect(),
        };
        let figure = Curves {
            x: Axis::logarithmic("number of components"),
            y: Axis::linear("cumulative weight of the singular values"),
            curves: vec![Curve::new("cumulative weight", points)],
            marks,
        }
        .figure()?;
        let text = format!(
            "{} components are kept. Leaving out the others changes no sample by more than {} (relative L2). Leave-one-out error (each \
             sample is predicted from the others): median {} (relative L2).",
            self.basis.rank,
            short(Some(self.basis.max_error)),
            short(self.basis.leave_one_out_median),
        );
        let figure = NamedFigure {
            name: "singular-values",
            caption: "Cumulative weight of the singular values: the sum of the first k divided by the sum of all. The elbow and the number of components kept are marked.".to_owned(),
            figure,
        };
        Ok(Section::new("Singular values", Some(text), vec![figure]))
    }

    fn sampling_section(&self) -> Result<Section, PlotError> {
        let panels = [
            (
                format!("regular: {} samples", self.samples),
                self.sample_positions.as_slice(),
            ),
            (
                format!("non-uniform: {} samples", self.adaptive_samples),
                self.adaptive_positions.as_slice(),
            ),
        ];
        let figure = NamedFigure {
            name: "sampling",
            caption: format!(
                "Positions at which the PSF is sampled: the regular grid of this report, and psfield's non-uniform sampling, which is refined \
                 until the error of interpolation between samples is below {} (relative L2) or the number of samples reaches its limit.",
                short(Some(self.adaptive_threshold))
            ),
            figure: positions_figure(&panels, self.frame)?,
        };
        Ok(Section::new("Sampling", None, vec![figure]))
    }

    fn shape_section(&self) -> Result<Section, PlotError> {
        let figures = shape_figures(
            &[("stars", &self.stars), ("galaxies", &self.galaxies)],
            "simulated",
            Some(PAPER_ECCENTRICITY_Q90),
        )?;
        let text = format!(
            "The histograms show the {} stars at the default tolerance.",
            self.objects
        );
        Ok(Section::new("FWHM, eccentricity, MAE", Some(text), figures))
    }

    fn map_section(&self) -> Result<Section, PlotError> {
        let text = "The maps show the stars, which have unit flux, at the default tolerance.".to_owned();
        let figures = maps(&self.stars, "simulated")?;
        Ok(Section::new("Over the field", Some(text), figures))
    }

    fn galaxy_section(&self) -> Result<Section, PlotError> {
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
        let difference = |image| Scale::Difference { most: most(image) };
        let (same, own) = (difference(&of_patches), difference(&of_lowrank));
        let patches = format!("image by patches of {} pixels", galaxy.patch);
        let patches_off = format!("patches of {} pixels - exact", galaxy.patch);
        let (flux, percent) = ("flux per pixel", "difference (% of the input's peak)");
        let figure = pictures(&[
            panel("input galaxy", &galaxy.original, sky, flux),
            panel("image by psfield (lowrank)", &galaxy.lowrank, sky, flux),
            panel(patches.as_str(), &galaxy.patches, sky, flux),
            panel(patches_off.as_str(), &of_patches, same, percent),
            panel(
                "psfield - exact (colour scale of the patches)",
                &of_lowrank,
                same,
                percent,
            ),
            panel("psfield - exact (own colour scale)", &of_lowrank, own, percent),
        ])?;
        let text = format!(
            "A galaxy on {0} x {0} pixels. The PSF varies as much over this image as over the whole field. The largest error against the direct sum in double \
             precision, divided by the peak of this sum, is {1} for patches (relative L2 {2}) and {3} for psfield (relative L2 {4}).",
            galaxy.side,
            short(Some(galaxy.patch_max_over_peak)),
            short(Some(galaxy.patch_relative_l2)),
            short(Some(galaxy.lowrank_max_over_peak)),
            short(Some(galaxy.lowrank_relative_l2)),
        );
        let figure = NamedFigure {
            name: "galaxy",
            caption: "The galaxy before and after the convolution, and the differences from the direct sum (exact). Patches leave seams where the PSF \
                      changes from one patch to the next. On the same colour scale the differences of psfield are too small to be seen. \
                      In each difference, at most 0.2 % of the pixels lie outside the range of the colour bar. They have the colours of its ends."
                .to_owned(),
            figure,
        };
        Ok(Section::new("An extended galaxy", Some(text), vec![figure]))
    }

    fn table_1_section(&self) -> Section {
        let mut table = Table::new(
            "Plan: seconds to make the plan. Run: seconds of the fastest run. First image: sum of plan and run, divided by the sum for the \
             method single. More images: run, divided by the run of the method single. Error: relative L2 difference from the direct sum in double \
             precision at random pixels.",
            &[
                "image",
                "method",
                "setting",
                "plan",
                "run",
                "first image",
                "more images",
                "error",
            ],
        );
        for rows in self.table_1.sizes.iter().map(|outcome| &outcome.rows) {
            let first = |row: &BenchRow| row.seconds + row.seconds_plan.unwrap_or(0.0);
            table.rows.extend(rows.iter().map(|row| {
                vec![
                    format!("{} x {}", row.size[0], row.size[1]),
                    row.method.to_owned(),
                    row.setting.clone().unwrap_or_else(|| "-".to_owned()),
                    short(row.seconds_plan),
                    short(Some(row.seconds)),
                    format!("{:.2}", first(row) / first(&rows[0])),
                    format!("{:.2}", row.ratio_to_single),
                    short(row.relative_l2),
                ]
            }));
        }
        Section {
            title: "Table 1: patches and psfield".to_owned(),
            paragraphs: vec![
                "Every pixel has light, and the PSF varies over each image as over the whole field. The method single uses one PSF for the whole image, \
                 which is fastest but ignores the variation. The method patch uses one PSF per patch. The method lowrank is the fast engine of psfield, \
                 with Fourier transforms for all tiles of the image. The method patch computes the PSFs of all patches again in each run. The method \
                 lowrank prepares the PSFs in a plan, which is made once for a model and a frame. The column 'first image' includes the time \
                 of the plan, the column 'more images' does not."
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

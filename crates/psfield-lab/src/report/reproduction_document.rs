//! The report of a [`Reproduction`]: its text, tables and figures.

use metrics::Summary;
use ndarray::Array2;

use crate::bench::BenchRow;
use crate::plot::{Axis, Chart, Curve, Marker, Scale};
use crate::report::document::{Column, Document, Section, Table, short};
use crate::report::evaluation::PAPER_ECCENTRICITY_Q90;
use crate::report::object_figures::{error_table, target_table, with_maps, with_shapes};
use crate::report::{ModelRow, ObjectKind, Reproduction, Software, ToleranceRow};

/// The paper whose results the report measures anew with psfield.
const PAPER: &str = "Bai, Jia, Lv, Zhang, Xiang and Nie (2025): An Ultrafast Image Simulation Technique with Spatially Variable \
                     Point-spread Functions. The Astronomical Journal, doi:10.3847/1538-3881/ad9b2e, arXiv:2502.10015";

impl Reproduction {
    /// Makes the report without its [`sections`](Self::sections): its title, and the inputs and
    /// conditions of the run.
    pub fn document(&self, software: Software) -> Document {
        let [radius, index, ratio, angle] = self.galaxy;
        let (basis, [nx, ny]) = (&self.basis, self.stamp);
        let load = self
            .load
            .map_or_else(|| "unknown".to_owned(), |load| format!("{load:.2}"));
        let galaxies = format!(
            "half-light radius {radius} pixels, Sersic index {index}, axis ratio {ratio}, angle {angle} degrees"
        );
        let model = format!(
            "{} components, interpolation {}, default settings",
            basis.rank, basis.interpolation
        );
        Document {
            title: "psfield: a spatially varying PSF against the truth",
            software,
            inputs: vec![
                ("paper", PAPER.to_owned()),
                ("telescope", format!("{} (preset survey-2m)", self.telescope)),
                ("frame", format!("{} pixels", self.frame)),
                ("stamps", format!("{nx} x {ny} pixels")),
                ("PSF samples", format!("{}, on a regular grid", self.samples)),
                ("objects", format!("{0} stars and {0} galaxies", self.objects)),
                ("galaxies", galaxies),
                ("model", model),
                (
                    "tolerance of the engine for figures and targets",
                    format!("{:e} (default)", self.tolerance),
                ),
                ("start (UTC)", self.started.clone()),
                ("load at the start (1-minute average)", load),
                ("run time (s)", format!("{:.0}", self.seconds)),
            ],
            sections: Vec::new(),
        }
    }

    /// Makes the sections of the report, with all figures.
    pub fn sections(&self) -> Vec<Section> {
        let kinds = [("stars", &self.stars), ("galaxies", &self.galaxies)];
        let stars = format!(
            "The histograms show the {} stars at the default tolerance.",
            self.objects
        );
        let shapes = Section::new("FWHM, eccentricity, MAE", [&stars]);
        let maps = "The maps show the stars, which have unit flux, at the default tolerance.";
        vec![
            self.accuracy(),
            self.singular_values(),
            self.sampling(),
            with_shapes(shapes, &kinds, "simulated", Some(PAPER_ECCENTRICITY_Q90)),
            with_maps(Section::new("Over the field", [maps]), &self.stars, "simulated"),
            self.extended_galaxy(),
            self.table_1(),
            self.colours.section(),
            self.frames.section(),
        ]
    }

    fn accuracy(&self) -> Section {
        let targets = target_table(
            "psfield's targets. Those for stars and galaxies hold at the default tolerance. In the paper, 90 % of the differences of eccentricity, which it calls ellipticity, are below 0.0901.",
            &self.targets,
        );
        let of_tolerance: [Column<'_, ToleranceRow>; 3] = [
            ("objects", &|row| match row.kind {
                ObjectKind::Point => "stars".to_owned(),
                ObjectKind::Extended => "galaxies".to_owned(),
            }),
            ("tolerance", &|row| format!("{:e}", row.tolerance)),
            ("seconds per frame", &|row| short(Some(row.seconds))),
        ];
        let tolerances = error_table(
            "Stars and galaxies simulated at several tolerances (method lowrank): absolute differences from their true images.",
            &of_tolerance,
            &self.tolerances,
            |row| &row.summary,
        );
        let of_model = |caption: &str, columns: &[Column<'_, ModelRow>], rows: &[ModelRow]| {
            error_table(caption, columns, rows, |row| &row.summary)
        };
        let interpolation: Column<'_, ModelRow> = ("interpolation", &|row| {
            let in_use = row.interpolation == self.basis.interpolation;
            format!("{}{}", row.interpolation, if in_use { " (in use)" } else { "" })
        });
        let sizes: [Column<'_, ModelRow>; 3] = [
            ("samples", &|row| format!("{0} x {0}", row.samples_across)),
            ("components", &|row| row.rank.to_string()),
            ("truncation error", &|row| short(Some(row.truncation_error))),
        ];
        let exact = "computed by the exact sum over the components. Truncation error: largest change of a sample by leaving out components (relative L2).";
        let section = Section::new(
            "Accuracy",
            [
                "Each object is measured twice in the same window by a Gaussian fit: in the image made by the fast engine, and in the true \
                 image, for which the optics are evaluated at the object's own position. The error has three parts. They come from the \
                 interpolation between samples, from the components left out (at most 1e-4, relative L2, at a sample), and from the \
                 engine's tolerance.",
                "If the errors hardly change from one tolerance to the next, the engine's part of the error is no longer the largest. The table of \
                 interpolators shows the error that remains without the engine. Bilinear and natural neighbour interpolation miss the \
                 curvature of the PSF between samples. Cubic interpolation follows it, and so does a polynomial over the whole field \
                 (interpolation polynomial=D, of degree D) if the optics are as smooth as these.",
            ],
        )
        .with_table(targets)
        .with_table(tolerances)
        .with_table(of_model(
            "PSFs evaluated directly from the model (not drawn by the engine), with several interpolators of the coefficients: absolute differences from the truth.",
            &[interpolation],
            &self.interpolations,
        ));
        let fewer_samples = format!("Errors of models with fewer samples on regular grids, {exact}");
        // With fewer than 9 samples along each axis, half of them are too few for this table.
        let section = match self.fewer_samples.as_slice() {
            [] => section,
            rows => section.with_table(of_model(&fewer_samples, &sizes, rows)),
        };
        let fewer_components = format!("Errors of the model with all components and with fewer, {exact}");
        section.with_table(of_model(&fewer_components, &sizes, &self.fewer_components))
    }

    fn singular_values(&self) -> Section {
        let (basis, weights) = (&self.basis, &self.basis.cumulative_weights);
        let points = (1..).zip(weights).map(|(k, &weight)| (f64::from(k), weight));
        let mut curves = vec![Curve::new("", points.collect())];
        let marked = match basis.elbow {
            Some(elbow) if elbow == basis.rank => vec![("elbow and kept", elbow)],
            Some(elbow) => vec![("elbow", elbow), ("kept", basis.rank)],
            None => vec![("kept", basis.rank)],
        };
        for (colour, (name, k)) in (1..).zip(marked) {
            if let Some(&weight) = k.checked_sub(1).and_then(|index| weights.get(index)) {
                let at = (k as f64, weight);
                curves.push(Curve {
                    marker: Some(Marker::Circle),
                    colour: Some(colour),
                    labels: vec![(at, format!("{name}: {k} components"))],
                    ..Curve::new("", vec![at])
                });
            }
        }
        let text = format!(
            "{} components are kept. Leaving out the others changes no sample by more than {} (relative L2). Leave-one-out error (each \
             sample is predicted from the others): median {} (relative L2).",
            basis.rank,
            short(Some(basis.max_error)),
            short(basis.leave_one_out.median),
        );
        let x = Axis::logarithmic("number of components");
        let y = Axis::linear("cumulative weight of the singular values");
        Section::new("Singular values", [&text]).with_figure(
            "singular-values",
            "Cumulative weight of the singular values: the sum of the first k divided by the sum of all. The elbow and the number of components kept are marked.",
            &[Chart::new("", x, y, curves)],
        )
    }

    fn sampling(&self) -> Section {
        let (regular, other) = (&self.sample_positions, &self.adaptive_positions);
        let charts = [("regular", regular), ("non-uniform", other)].map(|(name, positions)| {
            let title = format!("{name}: {} samples", positions.len());
            Chart::positions(&title, positions, self.frame)
        });
        let caption = format!(
            "Positions at which the PSF is sampled: the regular grid of this report, and psfield's non-uniform sampling, which is refined \
             until the error of interpolation between samples is below {} (relative L2) or the number of samples reaches its limit.",
            short(Some(self.adaptive_threshold))
        );
        Section::new("Sampling", []).with_figure("sampling", &caption, &charts)
    }

    fn extended_galaxy(&self) -> Section {
        let galaxy = &self.large_galaxy;
        let peak = galaxy.original.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let sky = Scale::sky("flux per pixel", peak * 0.02, peak);
        let relative = |image: &Array2<f64>| (image - &galaxy.exact) * (100.0 / peak);
        let (of_patches, of_lowrank) = (relative(&galaxy.patches), relative(&galaxy.lowrank));
        let difference = |image: &Array2<f64>| {
            let sizes = Summary::of(image.iter().map(|v| v.abs())).ok();
            let most = sizes.and_then(|sizes| sizes.quantile(0.998).ok()).unwrap_or(0.0);
            Scale::difference("difference (% of the input's peak)", most.max(1e-15))
        };
        let (same, own) = (difference(&of_patches), difference(&of_lowrank));
        let patches = format!("patches of {} pixels", galaxy.patch);
        let charts = [
            ("input galaxy", &galaxy.original, &sky),
            ("image by psfield (lowrank)", &galaxy.lowrank, &sky),
            (&format!("image by {patches}"), &galaxy.patches, &sky),
            (&format!("{patches} - exact"), &of_patches, &same),
            (
                "psfield - exact\n(colour scale of the patches)",
                &of_lowrank,
                &same,
            ),
            ("psfield - exact\n(own colour scale)", &of_lowrank, &own),
        ]
        .map(|(title, image, scale)| Chart::picture(title, image.view(), scale));
        let text = format!(
            "A galaxy on {0} x {0} pixels. The PSF varies as much over this image as over the whole field. The largest error against the direct sum in double \
             precision, divided by the peak of this sum, is {1} for patches (relative L2 {2}) and {3} for psfield (relative L2 {4}).",
            galaxy.side,
            short(Some(galaxy.patch_max_over_peak)),
            short(Some(galaxy.patch_relative_l2)),
            short(Some(galaxy.lowrank_max_over_peak)),
            short(Some(galaxy.lowrank_relative_l2)),
        );
        Section::new("An extended galaxy", [&text]).with_figure(
            "galaxy",
            "The galaxy before and after the convolution, and the differences from the direct sum (exact). Patches leave seams where the PSF \
             changes from one patch to the next. On the same colour scale the differences of psfield are too small to be seen. \
             In each difference, at most 0.2 % of the pixels lie outside the range of the colour bar. They have the colours of its ends.",
            &charts,
        )
    }

    fn table_1(&self) -> Section {
        let first_image = |row: &BenchRow| row.seconds + row.seconds_plan.unwrap_or(0.0);
        // The first row of a size is that of the method single.
        let rows = self
            .table_1
            .iter()
            .flat_map(|size| size.rows.iter().map(|row| (row, &size.rows[0])));
        let rows: Vec<(&BenchRow, &BenchRow)> = rows.collect();
        let columns: [Column<'_, (&BenchRow, &BenchRow)>; 8] = [
            ("image", &|(row, _)| format!("{} x {}", row.size[0], row.size[1])),
            ("method", &|(row, _)| row.method.to_owned()),
            ("setting", &|(row, _)| {
                row.setting.clone().unwrap_or_else(|| "-".to_owned())
            }),
            ("plan", &|(row, _)| short(row.seconds_plan)),
            ("run", &|(row, _)| short(Some(row.seconds))),
            ("first image", &|(row, single)| {
                format!("{:.2}", first_image(row) / first_image(single))
            }),
            ("more images", &|(row, _)| format!("{:.2}", row.ratio_to_single)),
            ("error", &|(row, _)| short(row.relative_l2)),
        ];
        let table = Table::new(
            "Plan: seconds to make the plan. Run: seconds of the fastest run. First image: sum of plan and run, divided by the sum for the \
             method single. More images: run, divided by the run of the method single. Error: relative L2 difference from the direct sum in double \
             precision at random pixels.",
            &columns,
            &rows,
        );
        let text = "Every pixel has light, and the PSF varies over each image as over the whole field. The method single uses one PSF for the whole image, \
                    which is fastest but ignores the variation. The method patch uses one PSF per patch. The method lowrank is the fast engine of psfield, \
                    with Fourier transforms for all tiles of the image. The method patch computes the PSFs of all patches again in each run. The method \
                    lowrank prepares the PSFs in a plan, which is made once for a model and a frame. The column 'first image' includes the time \
                    of the plan, the column 'more images' does not.";
        Section::new("Table 1: patches and psfield", [text]).with_table(table)
    }
}

//! The files that the demonstration writes.

use std::path::PathBuf;

use anyhow::Context as _;
use metrics::Summary;
use ndarray::{Array2, ArrayView3, s};
use psf_io::{Card, HeaderCards};
use psf_types::{FrameShape, Image, PointSource, Position, PsfModel};
use psfield::evaluate::{EvaluateOptions, OutputGrid, evaluate};
use psfield::measure::{MEASUREMENT_COLUMNS, MeasureOptions, Measurement};
use psfield_lab::plot::{Axis, Chart, Figure, Scale};
use psfield_lab::preview::{Colormap, LimitRule, Percentiles, Picture, Stretch};

use super::PATCH;
use super::sky::Sky;
use crate::context::signature;

/// Number of PSFs that are shown along each side of the field.
const ACROSS: usize = 9;

/// All files that are written.
pub(super) const FILES: [&str; 13] = [
    "telescope.toml",
    "samples.fits",
    "sampling.svg",
    "model.fits",
    "psf_field.svg",
    "psf_measurements.csv",
    "scene.fits",
    "stars.csv",
    "image.fits",
    "scene.png",
    "image.png",
    "patch_error.svg",
    "report.json",
];

/// The output folder, and the files written so far.
pub(super) struct Output {
    pub(super) folder: PathBuf,
    pub(super) overwrite: bool,
    pub(super) files: Vec<String>,
}

impl Output {
    pub(super) fn new(folder: PathBuf, overwrite: bool) -> anyhow::Result<Self> {
        std::fs::create_dir_all(&folder)
            .with_context(|| format!("{}: the output folder cannot be made", folder.display()))?;
        Ok(Self {
            folder,
            overwrite,
            files: Vec::new(),
        })
    }

    /// Returns the path of a file that is about to be written, and adds the file to the list.
    pub(super) fn path(&mut self, name: &str) -> PathBuf {
        self.files.push(name.to_owned());
        self.folder.join(name)
    }

    pub(super) fn image(&mut self, name: &str, image: &Image<f32>, cards: &[Card]) -> anyhow::Result<()> {
        let path = self.path(name);
        let cards: Vec<Card> = signature().into_iter().chain(cards.iter().cloned()).collect();
        let header = HeaderCards::new();
        Ok(psf_io::write_image(path, image, &header, &cards, self.overwrite)?)
    }

    pub(super) fn catalogue(&mut self, name: &str, stars: &[PointSource]) -> anyhow::Result<()> {
        let path = self.path(name);
        let rows = stars
            .iter()
            .map(|star| (star.position().x(), star.position().y(), star.flux()));
        let columns = ["x", "y", "flux"];
        Ok(psf_io::write_csv(path, &columns, rows, self.overwrite)?)
    }

    fn figure(&mut self, name: &str, chart: Chart) -> anyhow::Result<()> {
        let svg = Figure::new(&[chart], 740.0).svg();
        Ok(psf_io::write_text(self.path(name), &svg, self.overwrite)?)
    }

    /// Draws the positions of the samples.
    pub(super) fn sampling(&mut self, positions: &[Position], frame: FrameShape) -> anyhow::Result<()> {
        let title = format!("{} samples of the PSF", positions.len());
        self.figure("sampling.svg", Chart::positions(&title, positions, frame))
    }

    /// Writes the PSFs on a grid over the frame, as a picture and as a table of measurements.
    /// Returns their FWHM, ellipticity and eccentricity.
    pub(super) fn psf_map(&mut self, model: &PsfModel, frame: FrameShape) -> anyhow::Result<[Summary; 3]> {
        let at = |k: usize, n: usize| (n - 1) as f64 * k as f64 / (ACROSS - 1) as f64;
        let positions: Result<Vec<Position>, _> = (0..ACROSS * ACROSS)
            .map(|k| Position::new(at(k % ACROSS, frame.nx()), at(k / ACROSS, frame.ny())))
            .collect();
        let on_pixels = EvaluateOptions {
            grid: OutputGrid::Native,
            ..EvaluateOptions::default()
        };
        let stamps = evaluate(model, positions?, on_pixels)?;
        let rows = MeasureOptions::default().cube(stamps.stamps(), Some(stamps.positions().as_slice()));
        let path = self.path("psf_measurements.csv");
        psf_io::write_csv(path, MEASUREMENT_COLUMNS, &rows, self.overwrite)?;
        self.figure("psf_field.svg", psf_field(stamps.stamps(), frame))?;
        let of = |value: fn(&Measurement) -> Option<f64>| Summary::of(rows.iter().filter_map(value));
        Ok([
            of(|r| r.fwhm_px)?,
            of(|r| r.ellipticity)?,
            of(|r| r.eccentricity)?,
        ])
    }

    /// Shows scene and image as pictures with one stretch, and the error of patches as a chart.
    pub(super) fn pictures(
        &mut self,
        sky: &Sky,
        image: &Image<f32>,
        by_patches: &Image<f32>,
    ) -> anyhow::Result<()> {
        let image = image.pixels().mapv(f64::from);
        let limits = LimitRule::Percentile(Percentiles::new(0.5, 99.8)?).limits(image.view())?;
        for (name, pixels) in [("scene.png", &sky.sharp().mapv(f64::from)), ("image.png", &image)] {
            let picture = Picture::new(pixels.view(), limits, Stretch::Asinh, Colormap::Grey)?;
            psf_io::write_bytes(self.path(name), &picture.png(), self.overwrite)?;
        }
        let difference = by_patches.pixels().mapv(f64::from) - &image;
        let most = Summary::of(difference.iter().map(|v| v.abs()))?.quantile(0.995)?;
        let scale = Scale::difference("flux per pixel", most.max(f64::MIN_POSITIVE));
        let title = format!(
            "image by {PATCH}-pixel patches minus image by the default method\n(only galaxies differ; 0.5 % of the pixels are beyond the colour scale)"
        );
        let chart = Chart::picture(&title, difference.view(), &scale);
        self.figure("patch_error.svg", chart)
    }
}

/// Makes a chart of PSFs `[k, y, x]` of a grid over the frame on one scale, the first at the bottom
/// left. The axes give positions on the frame.
fn psf_field(stamps: ArrayView3<'_, f64>, frame: FrameShape) -> Chart {
    let (count, ny, nx) = stamps.dim();
    let peak = stamps.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    // The background remains visible as a grey line between neighbours.
    let mut whole = Array2::from_elem(
        (count.div_ceil(ACROSS) * (ny + 1), ACROSS * (nx + 1)),
        peak * 0.02,
    );
    for (k, stamp) in stamps.outer_iter().enumerate() {
        let (y, x) = (k / ACROSS * (ny + 1), k % ACROSS * (nx + 1));
        whole.slice_mut(s![y..y + ny, x..x + nx]).assign(&stamp);
    }
    // Each PSF is in the middle of its square. The outer PSFs are at the frame's edges.
    let [x, y] = [("x", frame.nx()), ("y", frame.ny())].map(|(name, pixels)| {
        let step = (pixels - 1) as f64 / (ACROSS - 1) as f64;
        Axis::linear(&format!("{name} on the frame (pixels)"))
            .within(-0.5 * step, (ACROSS as f64 - 0.5) * step)
    });
    let title = format!("PSF over the field, one brightness scale\n(each square: {nx} x {ny} pixels)");
    let scale = Scale::sky("fraction of flux per pixel (asinh scale)", peak * 1e-3, peak);
    Chart::picture(&title, whole.view(), &scale).with_axes(x, y)
}

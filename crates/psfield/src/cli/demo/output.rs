//! What the demonstration writes.

use std::path::PathBuf;

use anyhow::Context as _;
use metrics::Summary;
use psf_io::{Card, HeaderCards};
use psf_types::{FrameShape, Image, PointSource, Position, PsfModel, PsfSamples};
use psfield::{EvaluateOptions, MEASUREMENT_COLUMNS, MeasureOptions, OutputGrid, evaluate};

use super::sky::Sky;
use crate::cli::context::signature;
use crate::cli::pictures;

/// Sky of the previews' stretch, flux a pixel.
const SOFT: f32 = 30.0;

/// All that is written.
pub(super) const FILES: [&str; 13] = [
    "telescope.toml",
    "samples.fits",
    "sampling.png",
    "model.fits",
    "psf_field.png",
    "psf_measurements.csv",
    "scene.fits",
    "stars.csv",
    "image.fits",
    "scene.png",
    "image.png",
    "patch_error.png",
    "report.json",
];

/// Where things are written.
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

    /// The path of a file, which counts as written from here on.
    pub(super) fn path(&mut self, name: &str) -> PathBuf {
        self.files.push(name.to_owned());
        self.folder.join(name)
    }

    pub(super) fn write(&self, name: &str, content: &str) -> anyhow::Result<()> {
        Ok(psf_io::write_text(
            self.folder.join(name),
            content,
            self.overwrite,
        )?)
    }

    pub(super) fn text(&mut self, name: &str, content: &str) -> anyhow::Result<()> {
        self.files.push(name.to_owned());
        self.write(name, content)
    }

    pub(super) fn samples(&mut self, name: &str, samples: &PsfSamples) -> anyhow::Result<()> {
        let path = self.path(name);
        Ok(psf_io::write_samples(
            path,
            samples,
            &signature(),
            psf_io::Precision::Single,
            self.overwrite,
        )?)
    }

    pub(super) fn image(&mut self, name: &str, image: &Image<f32>, cards: &[Card]) -> anyhow::Result<()> {
        let path = self.path(name);
        let cards: Vec<Card> = signature().into_iter().chain(cards.iter().cloned()).collect();
        Ok(psf_io::write_image(
            path,
            image,
            &HeaderCards::new(),
            &cards,
            self.overwrite,
        )?)
    }

    pub(super) fn catalogue(&mut self, name: &str, stars: &[PointSource]) -> anyhow::Result<()> {
        let path = self.path(name);
        let rows = stars
            .iter()
            .map(|star| (star.position().x(), star.position().y(), star.flux()));
        Ok(psf_io::write_csv(
            path,
            &["x", "y", "flux"],
            rows,
            self.overwrite,
        )?)
    }

    pub(super) fn picture<P>(
        &mut self,
        name: &str,
        picture: &image::ImageBuffer<P, Vec<u8>>,
    ) -> anyhow::Result<()>
    where
        P: image::Pixel<Subpixel = u8> + image::PixelWithColorType,
    {
        let path = self.path(name);
        pictures::write_png(&path, picture, self.overwrite)
    }

    /// The PSFs on a grid over the frame, as a picture and as a table of measurements: their widths and ellipticities.
    pub(super) fn psf_map(
        &mut self,
        model: &PsfModel,
        frame: FrameShape,
    ) -> anyhow::Result<(Summary, Summary)> {
        const ACROSS: usize = 9;
        let at = |k: usize, n: usize| (n - 1) as f64 * k as f64 / (ACROSS - 1) as f64;
        let positions: Result<Vec<Position>, _> = (0..ACROSS * ACROSS)
            .map(|k| Position::new(at(k % ACROSS, frame.nx()), at(k / ACROSS, frame.ny())))
            .collect();
        let on_pixels = EvaluateOptions {
            grid: OutputGrid::Native,
            ..EvaluateOptions::default()
        };
        let stamps = evaluate(model, positions?, on_pixels)?;
        self.picture(
            "psf_field.png",
            &pictures::mosaic_picture(stamps.stamps(), ACROSS, 2),
        )?;
        let rows = MeasureOptions::default().cube(stamps.stamps(), Some(stamps.positions().as_slice()));
        let path = self.path("psf_measurements.csv");
        psf_io::write_csv(path, &MEASUREMENT_COLUMNS, &rows, self.overwrite)?;
        let fwhm = Summary::of(rows.iter().filter_map(|row| row.fwhm_px))?;
        let ellipticity = Summary::of(rows.iter().filter_map(|row| row.ellipticity))?;
        Ok((fwhm, ellipticity))
    }

    pub(super) fn pictures(
        &mut self,
        sky: &Sky,
        image: &Image<f32>,
        by_patches: &Image<f32>,
    ) -> anyhow::Result<()> {
        // One stretch for both, so that they can be compared.
        let high = pictures::quantile(image.pixels(), 0.9995)?.max(SOFT);
        let stretch = |pixels: ndarray::ArrayView2<'_, f32>| pictures::asinh_picture(pixels, 0.0, SOFT, high);
        self.picture("scene.png", &stretch(sky.sharp().view()))?;
        self.picture("image.png", &stretch(image.pixels()))?;
        let difference = &by_patches.pixels() - &image.pixels();
        let scale = pictures::quantile(difference.mapv(f32::abs).view(), 0.995)?.max(f32::MIN_POSITIVE);
        self.picture(
            "patch_error.png",
            &pictures::difference_picture(difference.view(), scale),
        )
    }
}

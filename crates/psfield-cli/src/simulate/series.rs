//! `psfield series`.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime};

use anyhow::Context as _;
use conv_core::ConvReal;
use psf_io::CatalogOptions;
use psf_types::{NoProgress, Progress};
use psfield::Motion;
use psfield::colours::spectrum_file;
use psfield::image_cards::exposure_time_cards;
use psfield::series::{Exposures, LightCurves, Pointing, PointingPath, Series, SeriesFrames};
use serde::Deserialize;

use crate::UsageError;
use crate::batch::{Settings, parsed, settings, simulate_command};
use crate::context::{Context, object};
use crate::files::{FileUses, OutputFile, OutputFolder, beside};
use crate::simulate::execute::Ready;
use crate::simulate::exposure_args::Exposing;
use crate::simulate::prepared::warn_of_coarse_stamps;
use crate::simulate::report::{Report, Seconds};
use crate::simulate::scene::ReadFiles;
use crate::simulate::{SimulateArgs, Simulators};
use crate::values::Precision;

/// Simulate a series of exposures, during which the PSF, the pointing and the sources change
///
/// The file of the series gives the times of the exposures, and the options of psfield simulate in a
/// table `[simulate]`. The PSF may depend on the time (column TIME of its samples) or on the frame
/// (column FRAME: the frame's number is that of the exposure, counted from 0). Relative paths refer to the
/// folder of the file.
///
/// For each exposure, the folder gets an image (frame_0000.fits, ...), and a table of the sources as they
/// are in this exposure (frame_0000_sources.csv with row, x, y, flux). With a detector, the image holds
/// its counts, and frame_0000_truth.fits the noise-free image.
#[derive(Debug, clap::Args)]
#[command(after_long_help = SAMPLE)]
pub(crate) struct SeriesArgs {
    /// File of the series (TOML)
    #[arg(value_name = "SERIES.toml")]
    series: PathBuf,
    /// Folder for the frames. It is made if it does not exist
    #[arg(short, long, value_name = "DIR")]
    out: OutputFolder,
    /// Replace files that exist
    #[arg(long)]
    overwrite: bool,
}

/// The end of the long help.
const SAMPLE: &str = r#"The file of a series:

  start = "2026-11-27T21:00:00"    # UTC. All other times are seconds after it
  exposure_s = 30.0
  count = 100
  cadence_s = 40.0                 # from start to start [default: exposure_s]
  light_curves = "curves.csv"      # columns row, time, factor

  [pointing]                       # by how far light is shifted on the frame (pixels)
  drift_px_per_s = [0.001, 0.0]
  jitter_px = 0.05                 # r.m.s. along each axis
  path = "pointing.csv"            # columns time, dx, dy

  [simulate]
  psf = "night.fits"
  catalog = "stars.csv"
  shape = [2048, 2048]
  detector = "camera.toml"

starts_s = [0.0, 40.0, 90.0] in place of count and cadence_s sets each start. start,
exposure_s and [simulate] are required, all other keys are optional.

light_curves: the flux of a source is that of the catalogue times the factor, which is
linear between the times. row is the row of the catalogue, counted from 0. Sources without
rows are constant.

Columns vx and vy of the catalogue are velocities in pixels per second. Positions are those
at the start of the series. Moving sources leave trails.

The light of an image moves with the pointing, and its edges become dark. Give an image that
is larger than the frame (option frame of [simulate]).

Fluxes are those of one exposure. --seed in [simulate] is the seed of exposure 0, and each
next exposure has the next seed."#;

/// The content of the file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SeriesFile {
    start: toml::Value,
    exposure_s: f64,
    count: Option<usize>,
    cadence_s: Option<f64>,
    starts_s: Option<Vec<f64>>,
    light_curves: Option<PathBuf>,
    #[serde(default)]
    pointing: PointingTable,
    simulate: toml::Table,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct PointingTable {
    drift_px_per_s: [f64; 2],
    jitter_px: f64,
    path: Option<PathBuf>,
}

/// Options of `simulate` that a series refuses, and why.
const REFUSED: [(&str, &str); 6] = [
    ("output", "cannot be set: the series names its files itself"),
    ("truth", "cannot be set: the series names its files itself"),
    (
        "overwrite",
        "applies to the whole series: psfield series --overwrite",
    ),
    (
        "truth-table",
        "cannot be set: the series writes a table of the sources for each exposure",
    ),
    ("quality", "cannot be used in a series: use psfield simulate"),
    ("stream", "cannot be used in a series: use psfield simulate"),
];

impl SeriesArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let folder = self.series.parent().unwrap_or(Path::new(""));
        let text = psf_types::read_text_file(&self.series)
            .with_context(|| format!("cannot read {}", self.series.display()))?;
        let in_file = |what: String| UsageError(format!("{}: {what}", self.series.display()));
        let (file, start) = SeriesFile::parse(&text).map_err(in_file)?;
        let (options, inputs) = self.options(&file, folder).map_err(in_file)?;
        let exposures = file.exposures().map_err(in_file)?;
        let series = Series {
            pointing: file
                .pointing(folder)
                .map_err(|error| match error.downcast::<UsageError>() {
                    Ok(UsageError(what)) => in_file(what).into(),
                    Err(error) => error,
                })?,
            light_curves: file.light_curves(folder)?,
            exposures,
        };
        match options.precision {
            Precision::F32 => self.simulate::<f32>((&options, &inputs), series, start, context),
            Precision::F64 => self.simulate::<f64>((&options, &inputs), series, start, context),
        }
    }

    /// Parses the options of `simulate`, with the output of the first exposure. Returns also the files that
    /// the series reads.
    fn options(&self, file: &SeriesFile, folder: &Path) -> Result<(SimulateArgs, Vec<PathBuf>), String> {
        let in_table = |what: String| format!("[simulate]: {what}");
        let mut options: Settings = settings(file.simulate.clone(), folder).map_err(in_table)?;
        if let Some((name, why)) = REFUSED.iter().find(|(name, _)| options.has(name)) {
            return Err(in_table(format!("{name} {why}")));
        }
        let first = self.frame(0).display().to_string();
        options
            .set("output", vec![first], Path::new(""))
            .map_err(in_table)?;
        let (args, files, _) = parsed(&options, &mut simulate_command()).map_err(in_table)?;
        let mut inputs = files.inputs;
        let tables = [&file.light_curves, &file.pointing.path].into_iter().flatten();
        inputs.extend(tables.map(|path| folder.join(path)));
        Ok((args, inputs))
    }

    /// Checks, before any work, that no output replaces an input, and that no output exists unless
    /// --overwrite is given.
    fn check_outputs<'a>(
        &self,
        inputs: impl Iterator<Item = &'a Path>,
        outputs: &HashSet<PathBuf>,
    ) -> anyhow::Result<()> {
        let mut uses = FileUses::default();
        for input in inputs {
            uses.read(input, "an input of the series");
        }
        // Only outputs that exist can be inputs. So the others, which may be many, need no look.
        let folder = || format!("{}: the folder cannot be read", self.out.display());
        let entries = std::fs::read_dir(&*self.out).with_context(folder)?;
        let found: std::io::Result<Vec<PathBuf>> = entries.map(|entry| Ok(entry?.path())).collect();
        let mut found = found.with_context(folder)?;
        found.retain(|path| outputs.contains(path));
        found.sort();
        for output in &found {
            uses.write(output, "another output").map_err(UsageError)?;
            psf_io::check_output(output, self.overwrite)?;
        }
        Ok(psf_io::check_output(self.frame(0), self.overwrite)?)
    }

    /// The image of an exposure.
    fn frame(&self, number: usize) -> PathBuf {
        self.out.join(format!("frame_{number:04}.fits"))
    }

    /// The table of the sources in an exposure.
    fn sources(&self, number: usize) -> PathBuf {
        self.out.join(format!("frame_{number:04}_sources.csv"))
    }

    fn simulate<T: ConvReal>(
        &self,
        (options, inputs): (&SimulateArgs, &[PathBuf]),
        series: Series,
        start: SystemTime,
        context: &Context,
    ) -> anyhow::Result<()> {
        let clock = Instant::now();
        let options = &options.with_floor(Some(series.exposures.exposure_s()))?;
        let first = OutputFile::from(self.frame(0).into_os_string());
        let exposing = options
            .exposure
            .exposing(&first, self.overwrite, options.seed, context)?;
        options.open_gpu(context)?;
        let psf = options.psf(&mut Simulators::default(), &mut Seconds::default(), context)?;
        let spinner = context.spinner("reading");
        let velocities = |catalog: CatalogOptions| catalog.with_velocities(true);
        let field = psf.field_shape();
        let read = options
            .scene
            .read::<T>(&options.colour, false, field, velocities)?;
        drop(spinner);
        options.note_of_scene(&read.files, context);
        if series.pointing != Pointing::default() {
            warn_of_coarse_stamps("the pointing", &psf, context);
        }
        let count = series.exposures.len();
        let with_sources = read.files.sources != (0, 0);
        options.warn_of_empty_catalog(read.files.sources, context);
        let spectra = read.light.spectra();
        let of_spectra = spectra.iter().filter_map(|name| spectrum_file(name));
        let inputs = inputs.iter().map(PathBuf::as_path);
        std::fs::create_dir_all(&*self.out)
            .with_context(|| format!("{}: the folder cannot be made", self.out.display()))?;
        let with_truth = exposing
            .as_ref()
            .is_some_and(|exposing| exposing.files.truth.is_some());
        let outputs = (0..count).flat_map(|number| {
            let frame = self.frame(number);
            let truth = with_truth.then(|| beside(&frame, "truth"));
            let sources = with_sources.then(|| self.sources(number));
            [Some(frame), truth, sources].into_iter().flatten()
        });
        self.check_outputs(inputs.chain(of_spectra.map(Path::new)), &outputs.collect())?;
        let psf = options.psf_of(&psf, &read.light, context)?;
        let shape = (read.files.shape.ny(), read.files.shape.nx());
        let made = SeriesFrames::new(&psf, shape, options.options(), series, read.light);
        let mut series =
            made.map_err(|error| anyhow::Error::new(error).context(self.series.display().to_string()))?;
        let mut frames = Vec::with_capacity(count);
        let bar = context.bar("exposures");
        bar.start(count as u64);
        for number in 0..count {
            let of_all = (options, exposing.as_ref(), &read.files);
            frames.push(self.expose(of_all, (&mut series, number, start), context)?);
            bar.advance(1);
        }
        drop(bar);
        self.report(&frames, clock.elapsed().as_secs_f64(), context)
    }

    /// Simulates an exposure and writes its files.
    fn expose<T: ConvReal>(
        &self,
        (options, exposing, read): (&SimulateArgs, Option<&Exposing>, &ReadFiles),
        (frames, number, start): (&mut SeriesFrames<T>, usize, SystemTime),
        context: &Context,
    ) -> anyhow::Result<Report> {
        let context = &context.for_part(&format!("exposure {number}"));
        let exposures = &frames.series().exposures;
        let (times, exposure_s) = (exposures.times(number), exposures.exposure_s());
        let frame = self.frame(number);
        let seed = options.seed.wrapping_add(number as u64);
        let exposing = exposing
            .map(|exposing| exposing.for_frame(frame.clone(), (seed, exposure_s), self.overwrite))
            .transpose()?;
        let clock = Instant::now();
        let spinner = context.spinner("planning");
        let exposure = frames
            .exposure(number, &NoProgress)
            .map_err(|error| options.explained(error))?;
        let (simulator, scene) = (&*exposure.simulator, &exposure.scene);
        let made = simulator
            .prepare(scene, &NoProgress)
            .map_err(|error| options.explained(error))?;
        drop(spinner);
        let mut seconds = Seconds {
            plan: clock.elapsed().as_secs_f64(),
            ..Seconds::default()
        };
        // Later exposures would repeat these warnings.
        if number == 0 {
            if let Some(warning) = simulator.psf_warning(scene)? {
                context.warn(&warning.to_string());
            }
            options.warn_of_placement(&made.placement, context);
            let noise = exposing.as_ref().and_then(Exposing::noise);
            SimulateArgs::warn_of_scene(|| simulator.warnings(scene, noise), &mut seconds, context);
        }
        let ready = Ready {
            simulator,
            scene,
            made,
            sources: None,
        };
        let [dx, dy] = exposure.shift_px;
        let mut cards = exposure_time_cards(start, times)?.to_vec();
        for (keyword, shift) in [("SHIFTX", dx), ("SHIFTY", dy)] {
            let card = psf_io::Card::new(keyword, shift, "[pixel] mean shift by the pointing");
            cards.push(card?);
        }
        let of_frame = SimulateArgs {
            output: OutputFile::from(frame.into_os_string()),
            overwrite: self.overwrite,
            seed,
            cards,
            ..options.clone()
        };
        // The world coordinates move with the light.
        let s = options.scene.scene.as_ref().map_or(1, |_| options.scene.finer()) as f64;
        let read = ReadFiles {
            header: read.header.shifted_origin(-dx * s, -dy * s),
            ..read.clone()
        };
        // The table of sources waits for the image.
        let outcome = psf_io::write_together(|| {
            if read.sources != (0, 0) {
                let (path, columns) = (self.sources(number), ["row", "x", "y", "flux"]);
                psf_io::write_csv(path, &columns, &exposure.sources, self.overwrite)?;
            }
            of_frame.in_memory(&ready, &read, exposing.as_ref(), &mut seconds, context)
        })?;
        Ok(of_frame.report(&ready, &read, outcome, seconds))
    }

    fn report(&self, frames: &[Report], seconds: f64, context: &Context) -> anyhow::Result<()> {
        let folder = self.out.as_path();
        let of = |part: fn(&Seconds) -> f64| -> f64 { frames.iter().map(|frame| part(&frame.seconds)).sum() };
        let (plan, execute, write) = (of(|s| s.plan), of(|s| s.execute), of(|s| s.write));
        let report = object! { folder, frames, seconds };
        context.report(&report, || {
            let [nx, ny] = frames[0].shape;
            format!(
                "{}: {} exposures of {nx} x {ny} pixels\n\
                 seconds: {seconds:.3} in all, plan {plan:.3}, convolve {execute:.3}, write {write:.3}",
                folder.display(),
                frames.len()
            )
        })?;
        frames.iter().try_for_each(Report::verdict)
    }
}

impl SeriesFile {
    /// The content of a file, and the time of its start.
    fn parse(text: &str) -> Result<(Self, SystemTime), String> {
        let file: Self = toml::from_str(text).map_err(|e| e.to_string())?;
        let start = file.start_time()?;
        Ok((file, start))
    }

    /// The time of the start.
    fn start_time(&self) -> Result<SystemTime, String> {
        let text = match &self.start {
            toml::Value::String(text) => text.clone(),
            toml::Value::Datetime(time) => time.to_string(),
            other => other.to_string(),
        };
        psfield::image_cards::parse_utc(&text).ok_or_else(|| {
            format!("start: a date and time (UTC) is needed, as in \"2026-11-27T21:00:00\", not {text:?}")
        })
    }

    fn exposures(&self) -> Result<Exposures, String> {
        let made = match (&self.starts_s, self.count, self.cadence_s) {
            (Some(starts), None, None) => Exposures::new(starts.clone(), self.exposure_s),
            (None, Some(count), cadence) => {
                Exposures::regular(count, self.exposure_s, cadence.unwrap_or(self.exposure_s))
            }
            _ => return Err("give either count (and cadence_s, if needed) or starts_s".to_owned()),
        };
        made.map_err(|error| match error.setting() {
            Some(key) => format!("{key}: {error}"),
            None => error.to_string(),
        })
    }

    /// The pointing. Its path refers to `folder`.
    fn pointing(&self, folder: &Path) -> anyhow::Result<Pointing> {
        let table = &self.pointing;
        // Only to check the jitter.
        let jitter = Motion::fixed([0.0, 0.0]).with_jitter_px(table.jitter_px);
        jitter.map_err(|error| UsageError(format!("[pointing] jitter_px: {error}")))?;
        let path = table.path.as_ref().map(|path| {
            let path = folder.join(path);
            let [times, dx, dy] = psf_io::read_columns(&path, ["time", "dx", "dy"])?;
            PointingPath::new(times, &dx, &dy).with_context(|| path.display().to_string())
        });
        Ok(Pointing {
            drift_px_per_s: table.drift_px_per_s,
            jitter_px: table.jitter_px,
            path: path.transpose()?,
        })
    }

    /// The light curves. Their file is relative to `folder`.
    fn light_curves(&self, folder: &Path) -> anyhow::Result<LightCurves> {
        let Some(path) = &self.light_curves else {
            return Ok(LightCurves::default());
        };
        let path = folder.join(path);
        let [rows, times, factors] = psf_io::read_columns(&path, ["row", "time", "factor"])?;
        LightCurves::new(&rows, &times, &factors).with_context(|| path.display().to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::tests::spoilt;

    /// The file of the help.
    fn sample() -> &'static str {
        let start = SAMPLE.find("start =").unwrap();
        let end = SAMPLE.find("starts_s =").unwrap();
        &SAMPLE[start..end]
    }

    /// Files with random errors are understood or refused, and never cause a panic.
    #[test]
    fn spoilt_series_are_understood_or_refused() {
        const CASES: u64 = 4000;
        let series = SeriesArgs {
            series: "night/series.toml".into(),
            out: OutputFolder::from(std::ffi::OsString::from("frames")),
            overwrite: false,
        };
        let folder = Path::new("night");
        let checked = |text: &str| {
            let (file, _) = SeriesFile::parse(text)?;
            let (_, inputs) = series.options(&file, folder)?;
            file.exposures()?;
            Ok::<_, String>(inputs)
        };
        let inputs = checked(sample()).unwrap();
        for name in ["night.fits", "stars.csv", "camera.toml", "pointing.csv"] {
            assert!(inputs.contains(&folder.join(name)), "{name}: {inputs:?}");
        }
        let (mut understood, mut refused) = (0, 0);
        for case in 0..CASES {
            match checked(&spoilt(sample(), case)) {
                Ok(_) => understood += 1,
                Err(why) => {
                    assert!(!why.is_empty());
                    refused += 1;
                }
            }
        }
        assert!(
            understood > 0 && refused > 0,
            "{understood} understood, {refused} refused"
        );
    }
}

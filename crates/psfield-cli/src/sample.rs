//! `psfield sample`: samples the PSF of a telescope, or makes samples from the stars of a frame.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use ndarray::{Axis, stack};
use psf_io::{Card, FileKind};
use psf_optics::{OpticsError, Telescope};
use psf_sample::{
    AdaptiveSampling, Criterion, DifferenceMeasure, KrigingSampling, Refinement, SampleError, Sampling,
    SamplingOptions, SamplingOutcome, Verification, hold_out,
};
use psf_stars::{CoverageMap, SOURCE_COLUMNS, StarSamples};
use psf_types::{Position, PsfSamples, PsfSource, StateKind};

use crate::UsageError;
use crate::context::{Context, object, signature, write_samples};
use crate::files::OutputFile;
use crate::old_names;
use crate::star_args::{MaskArgs, StarArgs};
use crate::values::{Pair, above_zero};

/// Sample the PSF of a telescope over its field, or of the stars in a real frame
///
/// A telescope file (TOML) is sampled where kriging (Gaussian process regression) expects the largest
/// error. Each PSF is predicted before it is drawn, until errors are at most --threshold. Then random PSFs
/// verify the result (--verify). Where the PSF is not smooth, a mesh takes over, which is refined until
/// its criterion holds. Samples always cover the corners of the frame.
///
/// A frame (FITS) is sampled at its own stars: psfield subtracts the background, detects and
/// selects stars, and registers them to sub-pixel precision. The content of the file decides
/// whether it is a telescope file or a frame.
///
/// psfield demo writes an example of a telescope file (telescope.toml).
///
/// Examples:
///
/// psfield sample --preset survey-2m -o samples.fits
///
/// psfield sample frame.fits -o samples.fits --gain 1.5 --sources sources.csv
///
/// psfield sample telescope.toml -o samples.fits --hold-out 200
#[derive(Debug, clap::Args)]
pub(crate) struct SampleArgs {
    /// Telescope file (aperture, wavefront over the field, seeing, detector), or image with stars
    #[arg(value_name = "TELESCOPE.toml|FRAME.fits", required_unless_present = "preset")]
    input: Option<PathBuf>,
    /// Samples to write
    #[arg(short, long, value_name = "SAMPLES.fits")]
    output: OutputFile,
    /// Replace outputs that exist
    #[arg(long)]
    overwrite: bool,
    /// Also write N PSFs that are not samples to SAMPLES_holdout.fits, for psfield validate
    ///
    /// Telescope: PSFs at random positions between the samples. Frame: N of the stars, with their
    /// noise. These stars are left out of the samples. Undersampled stars of the method epsf
    /// (--registration) cannot be held out.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    hold_out: Option<u16>,
    #[arg(
        long,
        value_name = "N",
        help = format!("Seed that chooses the PSFs of --hold-out and --verify [default: {}]", defaults().seed)
    )]
    seed: Option<u64>,
    #[command(flatten)]
    telescope: TelescopeArgs,
    #[command(flatten)]
    frame: FrameArgs,
    #[command(flatten)]
    stars: StarArgs,
    #[command(flatten)]
    mask: MaskArgs,
}

impl SampleArgs {
    pub(crate) fn run(mut self, context: &Context) -> anyhow::Result<()> {
        match self.input.clone() {
            Some(path) if is_frame(&path, self.stars.extension.is_some())? => {
                if let (Some(threshold), None) = (self.telescope.threshold, self.stars.detection_threshold) {
                    context.note(&old_names::note(
                        "--threshold of a frame",
                        "--detection-threshold",
                    ));
                    self.stars.detection_threshold = Some(threshold);
                    self.telescope.threshold = None;
                }
                refuse(self.telescope.given(), "a frame", "telescopes")?;
                self.frame.run(&path, &self, context)
            }
            _ => {
                let given = self.frame.given().or(self.stars.given()).or(self.mask.given());
                refuse(given, "a telescope", "frames")?;
                self.telescope.run(&self, context)
            }
        }
    }

    /// The seed, unless nothing is random (`what` says why).
    fn seed(&self, is_random: bool, what: &str) -> Result<u64, UsageError> {
        if self.seed.is_some() && !is_random && self.hold_out.is_none() {
            return Err(UsageError(format!(
                "--seed chooses the PSFs of --hold-out, which is not given, {what}"
            )));
        }
        Ok(self.seed.unwrap_or(defaults().seed))
    }

    /// The file of --hold-out, next to the output. `None` without this option.
    pub(crate) fn hold_out_file(&self) -> Option<PathBuf> {
        self.hold_out.map(|_| self.output.beside("holdout"))
    }

    /// Writes the samples, and the PSFs of --hold-out if there are any.
    fn write(&self, samples: &PsfSamples, held_out: Option<&PsfSamples>) -> anyhow::Result<()> {
        psf_io::write_together(|| -> anyhow::Result<()> {
            if let (Some(path), Some(held_out)) = (self.hold_out_file(), held_out) {
                write_samples(&path, held_out, self.overwrite)?;
            }
            Ok(write_samples(&self.output, samples, self.overwrite)?)
        })
    }

    /// A line of text about the PSFs of --hold-out. Empty if there are none.
    fn held_out_text(&self, held_out: Option<&PsfSamples>) -> String {
        self.hold_out_file()
            .zip(held_out)
            .map_or_else(String::new, |(path, held_out)| {
                let path = path.display();
                format!(
                    "\n{path}: {} PSFs that are not samples, for psfield validate --reference",
                    held_out.len()
                )
            })
    }
}

/// Returns whether a file is a frame with stars rather than a telescope file. If the user has
/// `chosen` an HDU, every FITS file counts as a frame. Otherwise, FITS files of other kinds are an
/// error.
fn is_frame(path: &Path, chosen: bool) -> anyhow::Result<bool> {
    match psf_io::detect(path) {
        Ok(FileKind::Image) => Ok(true),
        Ok(FileKind::NotFits) => Ok(false),
        Ok(_) if chosen => Ok(true),
        Ok(kind) => anyhow::bail!(
            "{} is {kind}: give a telescope file (TOML) or a frame with stars (a single image [y, x])",
            path.display()
        ),
        Err(error) => Err(error.into()),
    }
}

/// The error of reading a telescope file. If the file's name does not end in `.toml`, the user may
/// have meant a frame, so the message names both kinds.
fn not_a_telescope(path: &Path, error: OpticsError) -> anyhow::Error {
    match error {
        OpticsError::InFile { source, .. } if path.extension().is_none_or(|ending| ending != "toml") => {
            let what = format!(
                "{} is neither a FITS image nor a telescope file (TOML)",
                path.display()
            );
            anyhow::Error::from(*source).context(what)
        }
        error => error.into(),
    }
}

/// Refuses a given option that applies only to inputs of another kind (`kind`).
fn refuse(given: Option<&str>, input: &str, kind: &str) -> Result<(), UsageError> {
    match given {
        None => Ok(()),
        Some(option) => Err(UsageError(format!(
            "{option} applies only to {kind}, but the input is {input}: leave this option out"
        ))),
    }
}

/// The defaults that the help texts state.
fn defaults() -> SamplingOptions {
    SamplingOptions::default()
}

/// The parser of `--method`.
fn method() -> impl TypedValueParser<Value = Refinement> {
    let values = [
        PossibleValue::new("kriging").help("Where kriging expects the largest error"),
        PossibleValue::new("mesh").help("A grid, refined where the quantity of --criterion is too large"),
    ];
    PossibleValuesParser::new(values).try_map(|text| text.parse::<Refinement>())
}

/// The parser of `--criterion`.
fn criterion() -> impl TypedValueParser<Value = Criterion> {
    let values = [
        PossibleValue::new("interpolation").help("Error of interpolating between samples"),
        PossibleValue::new("neighbours")
            .help("Difference of neighbouring samples, as in Bai, Jia et al. (needs many more samples)"),
    ];
    PossibleValuesParser::new(values).try_map(|text| text.parse::<Criterion>())
}

/// The parser of `--measure`.
fn measure() -> impl TypedValueParser<Value = DifferenceMeasure> {
    PossibleValuesParser::new(["l1", "l2"]).try_map(|text| text.parse::<DifferenceMeasure>())
}

/// Options that apply only to telescopes.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Only for a telescope")]
struct TelescopeArgs {
    /// Use a built-in telescope instead of a file
    #[arg(long, value_enum, conflicts_with = "input")]
    preset: Option<Preset>,
    #[arg(
        long,
        value_parser = method(),
        help = format!("Way to choose positions [default: {}, or mesh with --criterion or --start]", Refinement::default())
    )]
    method: Option<Refinement>,
    #[arg(
        long,
        value_name = "X",
        value_parser = above_zero,
        help = format!("Largest error of a predicted PSF, as a fraction of its norm [default: {}]", defaults().threshold)
    )]
    threshold: Option<f64>,
    #[arg(
        long,
        value_parser = measure(),
        hide_short_help = true,
        help = format!("Norm in which PSFs are compared [default: {}]", defaults().measure)
    )]
    measure: Option<DifferenceMeasure>,
    #[arg(
        long,
        value_name = "N",
        help = format!("PSFs drawn at random at the end, to verify the threshold (0: none) [default: {}]", KrigingSampling::DEFAULT_VERIFY)
    )]
    verify: Option<u16>,
    #[arg(
        long,
        value_parser = criterion(),
        hide_short_help = true,
        help = format!("For the method mesh: quantity that must not exceed --threshold [default: {}]", Criterion::default())
    )]
    criterion: Option<Criterion>,
    #[arg(
        long,
        value_name = "NX,NY",
        allow_hyphen_values = true,
        hide_short_help = true,
        help = format!("For the method mesh: coarse grid from which refinement starts [default: {0},{0}]", AdaptiveSampling::DEFAULT_START)
    )]
    start: Option<Pair>,
    #[arg(
        long,
        value_name = "N",
        help = format!("Stop with an error if more PSFs must be drawn [default: {}]", defaults().max_draws)
    )]
    max_draws: Option<usize>,
    /// If --threshold is not met, write the samples drawn so far, with a warning
    #[arg(long, hide_short_help = true)]
    accept_cap: bool,
    /// Sample a regular grid of NX x NY positions, without --threshold
    #[arg(
        long,
        value_name = "NX,NY",
        conflicts_with_all = ["method", "criterion", "threshold", "verify", "start", "max_draws", "accept_cap"]
    )]
    uniform: Option<Pair>,
    /// Draw the PSF at these wavelengths, two or more (micrometres)
    ///
    /// Diffraction and seeing depend on the wavelength. The positions are chosen at the telescope's own
    /// wavelength. A scene in colour then needs --bandpass in `psfield simulate`.
    #[arg(long, value_name = "UM,UM,...", value_parser = above_zero, value_delimiter = ',', conflicts_with = "hold_out")]
    wavelengths: Vec<f64>,
}

/// A telescope that comes with the program.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub(crate) enum Preset {
    /// 2 m off-axis survey telescope, 0.074 arcsec per pixel, 9232 x 9216
    #[value(name = "survey-2m")]
    Survey2m,
    /// Under-sampled wide-field lens, 11.7 arcsec per pixel, 4096 x 4096
    WideFieldLens,
}

impl Preset {
    pub(crate) fn telescope(self) -> Telescope {
        match self {
            Self::Survey2m => Telescope::survey_2m(),
            Self::WideFieldLens => Telescope::wide_field_lens(),
        }
    }
}

impl TelescopeArgs {
    /// Returns the first given option that applies only to telescopes.
    fn given(&self) -> Option<&'static str> {
        [
            ("--preset", self.preset.is_some()),
            ("--method", self.method.is_some()),
            ("--threshold", self.threshold.is_some()),
            ("--measure", self.measure.is_some()),
            ("--verify", self.verify.is_some()),
            ("--criterion", self.criterion.is_some()),
            ("--start", self.start.is_some()),
            ("--max-draws", self.max_draws.is_some()),
            ("--accept-cap", self.accept_cap),
            ("--uniform", self.uniform.is_some()),
            ("--wavelengths", !self.wavelengths.is_empty()),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }

    fn run(&self, asked: &SampleArgs, context: &Context) -> anyhow::Result<()> {
        let telescope = match (&asked.input, self.preset) {
            (Some(path), _) => {
                Telescope::from_toml_file(path).map_err(|error| not_a_telescope(path, error))?
            }
            (None, preset) => preset.unwrap_or(Preset::Survey2m).telescope(),
        };
        let named = |error: anyhow::Error| match &asked.input {
            Some(path) if error.is::<SampleError>() => {
                error.context(format!("with the telescope of {}", path.display()))
            }
            _ => error,
        };
        if let [_] = self.wavelengths[..] {
            const ONE: &str =
                "--wavelengths needs two or more wavelengths: for one, set wavelength_nm of the telescope";
            return Err(UsageError(ONE.to_owned()).into());
        }
        let options = self.options(asked)?;
        let mut sampling = self.draw(&telescope, &options, context).map_err(named)?;
        if !self.wavelengths.is_empty() {
            let at = sampling.samples.positions().as_slice().to_vec();
            sampling.samples = self.draw_wavelengths(&telescope, &at, context)?;
        }
        let positions = sampling.samples.positions();
        let held_out = asked.hold_out.map(|count| {
            let drawn = (usize::from(count), options.seed);
            hold_out(&telescope, positions, drawn, &context.bar("holding out"))
        });
        let held_out = held_out.transpose().map_err(|error| named(error.into()))?;
        let held_out = held_out.as_ref();
        asked.write(&sampling.samples, held_out)?;
        let found = &sampling.report;
        let place = |at: Position| [at.x(), at.y()];
        let report = object! {
            output: &asked.output,
            // The method that ended. A uniform grid has none.
            method: found.refinement.map(|method| method.to_string()),
            samples: sampling.samples.len(),
            hold_out: asked.hold_out_file(),
            held_out: held_out.map(PsfSamples::len),
            // PSFs drawn, random ones included. The mesh also draws PSFs that only its criterion uses.
            draws: if self.wavelengths.is_empty() { found.draws } else { found.draws + sampling.samples.len() },
            cells: found.cells,
            unmet_cells: found.unmet_cells,
            // The largest error measured last, and where.
            worst: found.worst,
            worst_at: found.worst_at.map(place),
            // The largest error that kriging expects.
            expected: found.expected,
            threshold: found.threshold,
            verification: found.verification.map(|random| object! {
                tests: random.tests,
                above: random.above,
                fraction_limit: random.fraction_limit(),
                worst: random.worst,
                worst_at: place(random.worst_at),
                draws: random.draws,
            }),
            outcome: match found.outcome {
                SamplingOutcome::Met => "met",
                SamplingOutcome::CellSizeReached => "cell-size-reached",
                SamplingOutcome::CapReached => "cap-reached",
                _ => "unknown",
            },
        };
        if report.unmet_cells > 0 && report.outcome == "cell-size-reached" && !self.accept_cap {
            context.warn(&format!(
                "the criterion does not hold in {} of {} cells (largest variation {:.2e}): these cells cannot be halved again: \
                 the PSF is probably discontinuous",
                report.unmet_cells, report.cells, report.worst
            ));
        }
        context.report(&report, || {
            let limit = report
                .threshold
                .map_or_else(String::new, |t| format!(" (threshold {t})"));
            format!(
                "{}: {} samples, {} PSFs drawn{}, largest error {:.2e}{limit}{}{}",
                report.output.display(),
                report.samples,
                report.draws,
                found
                    .refinement
                    .map_or_else(String::new, |method| format!(" (method {method})")),
                report.worst,
                found.verification.as_ref().map_or_else(String::new, verified),
                asked.held_out_text(held_out)
            )
        })
    }

    /// Draws the PSF at every wavelength.
    fn draw_wavelengths(
        &self,
        telescope: &Telescope,
        positions: &[Position],
        context: &Context,
    ) -> anyhow::Result<PsfSamples> {
        psfield::check_stack(positions.len() * self.wavelengths.len(), telescope.grid())?;
        let telescopes = self.wavelengths.iter().map(|&um| telescope.at_wavelength_um(um));
        let telescopes = telescopes.collect::<Result<Vec<_>, _>>()?;
        let sources: Vec<&dyn PsfSource> = telescopes.iter().map(|t| t as &dyn PsfSource).collect();
        let states = (StateKind::Wavelength, &self.wavelengths[..]);
        let bar = context.bar("drawing wavelengths");
        Ok(psf_sample::draw_states(&sources, states, positions, &bar)?)
    }

    fn options(&self, asked: &SampleArgs) -> Result<SamplingOptions, UsageError> {
        let defaults = defaults();
        let mut options = SamplingOptions {
            refinement: self.method,
            criterion: self.criterion,
            measure: self.measure.unwrap_or(defaults.measure),
            threshold: self.threshold.unwrap_or(defaults.threshold),
            start: self.start.map(|Pair(nx, ny)| (nx, ny)),
            max_draws: self.max_draws.unwrap_or(defaults.max_draws),
            verify: self.verify.map(usize::from),
            seed: defaults.seed,
            uniform: self.uniform.map(|Pair(nx, ny)| (nx, ny)),
        };
        let verifies = options.uniform.is_none() && options.refinement() == Refinement::Kriging;
        options.seed = asked.seed(verifies, "and of the method kriging, which is not used")?;
        Ok(options)
    }

    fn draw(
        &self,
        telescope: &Telescope,
        options: &SamplingOptions,
        context: &Context,
    ) -> anyhow::Result<Sampling> {
        if let Some((nx, ny)) = options.uniform {
            psfield::check_stack(nx.saturating_mul(ny), telescope.grid())
                .map_err(|e| UsageError(format!("--uniform: {e}")))?;
        }
        let refused = |e: SampleError| match (&e, options.uniform) {
            (SampleError::Setting { name, .. }, None) => {
                UsageError(format!("{}: {e}", option_of(name))).into()
            }
            _ => anyhow::Error::from(e),
        };
        let sampling = options.method().map_err(refused)?;
        let bar = context.bar("sampling");
        match sampling.sample(telescope, &bar) {
            Err(SampleError::NotMet(found)) if self.accept_cap => {
                drop(bar);
                context.warn(&found.to_string());
                Ok(found.into_sampling())
            }
            Err(SampleError::NotMet(found)) => Err(anyhow::anyhow!(
                "{found} (options --max-draws, --threshold and --accept-cap)"
            )),
            other => other.map_err(refused),
        }
    }
}

/// The option that sets what a message of sampling names.
fn option_of(name: &str) -> &'static str {
    match name {
        "the criterion" => "--criterion",
        "the number of random tests" => "--verify",
        "the largest number of draws" => "--max-draws",
        _ => "--start",
    }
}

/// A line of text about random tests.
fn verified(random: &Verification) -> String {
    format!(
        "\nverified at random: {} of {} PSFs above the threshold, largest error {:.2e}: with 95 % confidence at most {:.1} % of the field",
        random.above,
        random.tests,
        random.worst,
        100.0 * random.fraction_limit()
    )
}

/// Outputs that exist only for frames.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Only for a frame")]
struct FrameArgs {
    /// Also write a table of all sources found, with the reasons why some were rejected
    #[arg(long, value_name = "SOURCES.csv")]
    sources: Option<OutputFile>,
    /// Also write a coverage map of the field
    ///
    /// Three planes over the cells of the map: number of samples, distance to the nearest sample
    /// (pixels), and 1 inside the convex hull of the samples or 0 outside.
    #[arg(long, value_name = "COVERAGE.fits", hide_short_help = true)]
    coverage: Option<OutputFile>,
}

impl FrameArgs {
    /// Returns the first given option that applies only to frames.
    fn given(&self) -> Option<&'static str> {
        let sources = self.sources.is_some().then_some("--sources");
        sources.or(self.coverage.is_some().then_some("--coverage"))
    }

    fn run(&self, path: &Path, asked: &SampleArgs, context: &Context) -> anyhow::Result<()> {
        let seed = asked.seed(false, "for a frame")?;
        let spinner = context.spinner("finding stars");
        let (frame, _, sampling) = asked.stars.open(path, &asked.mask)?;
        let found = sampling
            .with_hold_out(asked.hold_out.map_or(0, usize::from), seed)
            .run_masked(frame)
            .with_context(|| format!("in {}", path.display()))?;
        psf_io::write_together(|| -> anyhow::Result<()> {
            if let Some(path) = &self.sources {
                psf_io::write_csv(path, &SOURCE_COLUMNS, &found.sources, asked.overwrite)?;
            }
            if let Some(path) = &self.coverage {
                write_coverage(path, &found.coverage, asked.overwrite)?;
            }
            asked.write(&found.samples, found.held_out.as_ref())
        })?;
        drop(spinner);
        warn_of(&found, context);
        let (held_out, wanted) = (found.held_out.as_ref().map_or(0, PsfSamples::len), asked.hold_out);
        if let Some(wanted) = wanted.filter(|&wanted| held_out < usize::from(wanted)) {
            context.warn(&format!(
                "only {held_out} of the {wanted} stars of --hold-out could be written: the pixels of the others have no flux"
            ));
        }
        // Number of rejected sources for each reason. A source may be rejected for several reasons.
        let counts = found.rejection_counts().into_iter();
        let rejected: BTreeMap<&str, usize> = counts.map(|(reason, count)| (reason.name(), count)).collect();
        let report = object! {
            output: &asked.output,
            samples: found.samples.len(),
            hold_out: asked.hold_out_file(),
            held_out: found.held_out.as_ref().map(PsfSamples::len),
            sources: found.sources.len(),
            rejected: &rejected,
            fwhm_px: found.fwhm_px,
            background: found.background.typical_level(),
            background_rms: found.background.typical_rms(),
            saturation: found.saturation,
            registration: &found.registration,
            coverage: found.coverage.report(),
        };
        context.report(&report, || {
            let rejected: Vec<String> = rejected
                .iter()
                .map(|(name, count)| format!("{count} {name}"))
                .collect();
            let saturation = match found.saturation.level {
                Some(_) => found.saturation.to_string(),
                None => "unknown (give --saturation)".to_owned(),
            };
            let registration = &found.registration;
            let degree = registration.field_degree.map_or_else(String::new, |degree| {
                format!(", polynomial of degree {degree} over the field")
            });
            format!(
                "{}: {} samples of {} sources\n\
                 rejected:     {} (one source may have several reasons)\n\
                 FWHM:         {:.2} pixels\n\
                 background:   {:.2}, r.m.s. {:.2}\n\
                 saturation:   {saturation}\n\
                 registration: {}, stamps of {} x {} pixels, {} per frame pixel{degree}\n\
                 coverage:     {:.0} % of the field is outside the outermost samples, largest distance to a sample {:.0} pixels{}",
                report.output.display(),
                report.samples,
                report.sources,
                if rejected.is_empty() { "none".to_owned() } else { rejected.join(", ") },
                report.fwhm_px,
                report.background,
                report.background_rms,
                registration.method,
                registration.stamp_pixels,
                registration.stamp_pixels,
                registration.oversampling,
                100.0 * report.coverage.outside_hull,
                report.coverage.largest_gap_px,
                asked.held_out_text(found.held_out.as_ref()),
            )
        })
    }
}

/// Noise of samples above this part of their norm is warned of.
const NOISY_STAMPS: f64 = 0.1;

/// Prints the warnings about the samples of a frame.
pub(crate) fn warn_of(found: &StarSamples, context: &Context) {
    for warning in found.coverage.warnings() {
        context.warn(&warning);
    }
    if let Some(level) = found.saturation.ignored {
        context.warn(&format!(
            "SATURATE = {level} in the header is not above the background ({:.2}) and is ignored: give the true level (--saturation)",
            found.background.typical_level()
        ));
    }
    let registration = &found.registration;
    if let Some(noise) = registration.stamp_noise.filter(|noise| *noise > NOISY_STAMPS) {
        context.warn(&format!(
            "the samples are the stars' own pixels, half of them with noise above {:.0} % of their norm: a model of them has this \
             noise, unless many stars share its components (more or brighter stars, or --registration epsf)",
            100.0 * noise
        ));
    }
    if registration.undersampled && registration.field_degree.is_none() {
        context.warn(&format!(
            "the stars are undersampled (FWHM {:.2} pixels) and their pixels are interpolated, which smears the PSF: more stars \
             (lower --snr or --detection-threshold) allow an oversampled PSF (--registration epsf)",
            found.fwhm_px
        ));
    }
}

/// Writes a coverage map with three planes: number of samples in each cell, distance to the nearest
/// sample, and 1 inside the convex hull of the samples or 0 outside.
pub(crate) fn write_coverage(path: &Path, map: &CoverageMap, overwrite: bool) -> anyhow::Result<()> {
    let cube = stack(Axis(0), &[map.counts(), map.distances_px(), map.inside_hull()])?;
    let (width, height) = map.cell_px();
    let mut cards = signature();
    cards.extend([
        Card::new("CELLNX", width, "width of a cell, pixels of the frame")?,
        Card::new("CELLNY", height, "height of a cell, pixels of the frame")?,
        Card::new("PLANE1", "samples", "number of samples in the cell")?,
        Card::new("PLANE2", "distance", "pixels from cell centre to nearest sample")?,
        Card::new("PLANE3", "inside", "1 inside the convex hull of the samples")?,
    ]);
    Ok(psf_io::write_cube(path, cube.view(), &cards, overwrite)?)
}

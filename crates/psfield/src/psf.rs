//! A PSF over a field, from samples, a model or a file.

mod extrapolation;
mod format_records;
mod join;
mod motion;
mod moving_native;
mod open;
mod parameters;
mod resample;
mod states;
mod wings;

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use ndarray::{Array3, ArrayView3};
use psf_io::{FileKind, PsfexModel};
use psf_sample::{SamplingMethod, SamplingReport};
use psf_types::{
    FrameShape, Position, Progress, PsfModel, PsfModelRecord, PsfSamples, PsfSource, SamplePositions,
    StampGrid, WingsRecord,
};

use crate::error::PsfieldError;
use crate::fit::{Fit, FitOptions, OwnInterpolation, fit, models_of, table_of, tabulated};

pub use extrapolation::Extrapolation;
pub use format_records::record_of_psfex;
pub use join::WingsSource;
pub use motion::Motion;
pub(crate) use motion::QUADRATURE;
pub(crate) use moving_native::MovingNative;
pub use open::{FitChoices, PsfFileOptions};
pub use parameters::PsfParameters;
pub(crate) use resample::{StampChange, native_grid_of};
pub use states::join_samples;

/// A PSF over a field, from samples, a model, or a PSF file of any format. Samples are fitted when
/// the model is first needed, and the fit is kept. Cloning is cheap: clones share the fit.
///
/// ```
/// use ndarray::Array3;
/// use psfield::Psf;
/// // A PSF that widens to the right, known in the corners of a frame of 100 x 80 pixels.
/// let corners = [(0.0, 0.0), (99.0, 0.0), (0.0, 79.0), (99.0, 79.0)];
/// let stamps = Array3::from_shape_fn((4, 17, 17), |(j, y, x)| {
///     let sigma = if j % 2 == 0 { 1.2 } else { 1.8 };
///     let square = (y as f64 - 8.0).powi(2) + (x as f64 - 8.0).powi(2);
///     (-square / (2.0 * sigma * sigma)).exp()
/// });
/// let psf = Psf::from_samples(stamps.view(), &corners)?;
/// assert_eq!(psf.model()?.rank(), 1);
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Psf(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    origin: Origin,
    source: SourceFile,
    fit: OnceLock<Fit>,
    fit_warnings: OnceLock<Vec<String>>,
    models: OnceLock<Vec<PsfModel>>,
    /// A table of a coefficient field of the caller's own.
    table: OnceLock<PsfModelRecord>,
    /// The parameters from which the PSF was made.
    parameters: OnceLock<PsfParameters>,
}

/// A note for the user on how a PSF file was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    text: String,
    setting: Option<&'static str>,
}

impl Note {
    /// The field of [`PsfFileOptions`] that changes the choice which the note reports. None if no
    /// field does.
    pub fn setting(&self) -> Option<&'static str> {
        self.setting
    }
}

impl std::fmt::Display for Note {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

/// The file that a PSF was read from, if there is one.
#[derive(Debug, Clone, Default)]
struct SourceFile {
    path: Option<PathBuf>,
    kind: Option<FileKind>,
    notes: Vec<Note>,
    /// The model of a PSFEx file. A conversion to PSFEx with the same degree writes this model
    /// unchanged.
    psfex: Option<PsfexModel>,
}

#[derive(Debug)]
enum Origin {
    Samples(PsfSamples, FitOptions),
    Record(PsfModelRecord),
    /// A model, whose coefficient field may be the caller's own.
    Model(PsfModel, SamplePositions),
}

impl From<Origin> for Psf {
    fn from(origin: Origin) -> Self {
        Self::with_source(origin, SourceFile::default())
    }
}

impl From<PsfSamples> for Psf {
    /// Takes samples with the default [`FitOptions`].
    fn from(samples: PsfSamples) -> Self {
        Self::new(samples, FitOptions::default())
    }
}

impl From<PsfModelRecord> for Psf {
    fn from(record: PsfModelRecord) -> Self {
        Origin::Record(record).into()
    }
}

impl From<Fit> for Psf {
    /// Takes a fitted model and its report.
    fn from(fit: Fit) -> Self {
        let psf = Self::from(fit.record().clone());
        psf.0.fit.get_or_init(|| fit);
        psf
    }
}

impl From<PsfModel> for Psf {
    /// Takes a model, whose coefficient field may be the caller's own. It is used as it is. Files, and
    /// stamps of another size or sampling, hold a table of the field ([`record`](Self::record)).
    fn from(model: PsfModel) -> Self {
        let first = SamplePositions::new(vec![Position::of_pixel(0, 0)], model.field_shape());
        Origin::Model(model, first.expect("one position on the field")).into()
    }
}

impl Psf {
    /// Takes samples and the options of their fit.
    pub fn new(samples: PsfSamples, options: FitOptions) -> Self {
        Origin::Samples(samples, options).into()
    }

    /// Takes samples `[sample, y, x]` at positions `(x, y)`, with the default [`FitOptions`].
    /// Positions are in pixels of the frame: 0-based, an integer is the centre of a pixel. The
    /// stamps have the frame's own pixels and are centred at index `n / 2`.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](crate::ErrorKind::Data) for stamps or positions that are not valid [`PsfSamples`].
    pub fn from_samples(stamps: ArrayView3<'_, f64>, positions: &[(f64, f64)]) -> Result<Self, PsfieldError> {
        let (_, ny, nx) = stamps.dim();
        let positions = positions.iter().map(|&(x, y)| Position::new(x, y));
        let positions = SamplePositions::new(positions.collect::<Result<_, _>>()?, None)?;
        let stamps: Array3<f64> = stamps.to_owned();
        Ok(PsfSamples::new(stamps, positions, StampGrid::new(nx, ny)?)?.into())
    }

    /// Samples the PSF of a source over the field. A source can draw the PSF at any position.
    ///
    /// # Errors
    /// [`ErrorKind::Sampling`](crate::ErrorKind::Sampling) when the source cannot draw a valid PSF, or the
    /// method fails.
    pub fn from_source(
        source: &dyn PsfSource,
        method: &dyn SamplingMethod,
        options: FitOptions,
        progress: &dyn Progress,
    ) -> Result<(Self, SamplingReport), PsfieldError> {
        let sampling = method.sample(source, progress)?;
        Ok((Self::new(sampling.samples, options), sampling.report))
    }

    fn with_source(origin: Origin, source: SourceFile) -> Self {
        Self(Arc::new(Inner {
            origin,
            source,
            fit: OnceLock::new(),
            fit_warnings: OnceLock::new(),
            models: OnceLock::new(),
            table: OnceLock::new(),
            parameters: OnceLock::new(),
        }))
    }

    /// This PSF as a model: its samples are fitted.
    pub(crate) fn fitted(&self) -> Result<Self, PsfieldError> {
        Ok(match &self.0.origin {
            Origin::Samples(..) => self.derived(self.record()?.clone(), self.0.source.clone()),
            Origin::Record(_) | Origin::Model(..) => self.clone(),
        })
    }

    /// The samples and the options of their fit. None for a PSF that was not made from samples.
    pub fn samples(&self) -> Option<(&PsfSamples, &FitOptions)> {
        match &self.0.origin {
            Origin::Samples(samples, options) => Some((samples, options)),
            _ => None,
        }
    }

    /// The stored model. None for a PSF that was made from samples or from a [`PsfModel`].
    pub fn stored(&self) -> Option<&PsfModelRecord> {
        match &self.0.origin {
            Origin::Record(record) => Some(record),
            _ => None,
        }
    }

    /// The format of the file that the PSF was read from. None if it was not read from a file.
    pub fn kind(&self) -> Option<FileKind> {
        self.0.source.kind
    }

    /// The name of the file that the PSF was read from, for messages.
    pub(crate) fn file_name(&self) -> Option<String> {
        self.0.source.path.as_ref().map(|path| path.display().to_string())
    }

    /// The shape of the field over which the PSF is known, if the samples or the model state it.
    /// For a PSFEx model, which states only the positions of its stars, it is the frame that fits
    /// them: from pixel (0, 0) as far beyond the last star as the first star is from the first
    /// pixel.
    pub fn field_shape(&self) -> Option<FrameShape> {
        let stated = self.positions().field();
        stated.or_else(|| self.psfex()?.polynomial()?.frame_shape())
    }

    /// Notes for the user on how the file was read, in plain sentences.
    pub fn notes(&self) -> &[Note] {
        &self.0.source.notes
    }

    /// The model of the PSFEx file that the PSF was read from.
    pub(crate) fn psfex(&self) -> Option<&PsfexModel> {
        self.0.source.psfex.as_ref()
    }

    /// The pixel grid of the stamps. If a model has wings, that of its core.
    pub fn grid(&self) -> StampGrid {
        match &self.0.origin {
            Origin::Samples(samples, _) => samples.grid(),
            Origin::Record(record) => record.basis().grid(),
            Origin::Model(model, _) => model.grid(),
        }
    }

    /// The pixel grid of whole PSFs: that of the wings if a model has them.
    pub fn whole_grid(&self) -> StampGrid {
        let wings = self.record_if_fitted().and_then(PsfModelRecord::wings);
        wings.map_or(self.grid(), WingsRecord::grid)
    }

    /// Positions of the samples, or of the model's nodes. Returns only pixel (0, 0) for a model
    /// whose coefficient field the caller implements, because it has no nodes.
    pub fn positions(&self) -> &SamplePositions {
        match &self.0.origin {
            Origin::Samples(samples, _) => samples.positions(),
            Origin::Record(record) => record.coefficients().positions(),
            Origin::Model(_, positions) => positions,
        }
    }

    /// The fit of the samples, made when it is first needed, or the fit from which the PSF was made. None
    /// for other PSFs.
    ///
    /// # Errors
    /// The errors of [`fit()`].
    pub fn fit(&self) -> Result<Option<&Fit>, PsfieldError> {
        let Some((samples, options)) = self.samples() else {
            return Ok(self.0.fit.get());
        };
        get_or_make(&self.0.fit, || fit(samples.clone(), options)).map(Some)
    }

    /// The model in the form that a file stores: the fit of the samples, or the stored model. For a PSF
    /// made from a [`PsfModel`], whose coefficient field may be the caller's own, it is a table of the field,
    /// with an error of at most [`OwnInterpolation::TABLE_ERROR`].
    ///
    /// # Errors
    /// The errors of [`fit()`], and [`ErrorKind::Format`](crate::ErrorKind::Format) for a PSF made from a
    /// [`PsfModel`] whose frame is not known. The errors of [`coeff_field::tabulate_field`].
    pub fn record(&self) -> Result<&PsfModelRecord, PsfieldError> {
        match &self.0.origin {
            Origin::Record(record) => Ok(record),
            Origin::Samples(..) => Ok(self.fit()?.expect("samples have a fit").record()),
            Origin::Model(model, _) => get_or_make(&self.0.table, || table_of(model)),
        }
    }

    /// Returns this PSF with an interpolation of the caller's own. The basis stays the same. The caller makes
    /// the interpolation from the coefficients of [`record`](Self::record).
    ///
    /// # Errors
    /// [`ErrorKind::Fit`](crate::ErrorKind::Fit) for an interpolation that is not smooth enough for a table
    /// ([`coeff_field::tabulate`]), and for errors of its function.
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a limit of the table's error that is not above
    /// 0.
    pub fn interpolated_by(&self, own: OwnInterpolation<'_>) -> Result<Self, PsfieldError> {
        let undivided = self.undivided()?;
        let record = undivided.record()?;
        Ok(match undivided.fit()? {
            Some(fit) => Self::from(fit.interpolated_by(own)?),
            None => Self::from(tabulated(record, own)?),
        })
    }

    /// Sentences on samples that do not determine the model ([`FitReport`](crate::fit::FitReport)). None for a
    /// PSF that does not come from samples, and before the fit.
    pub(crate) fn fit_warnings(&self) -> &[String] {
        let kept = &self.0.fit_warnings;
        match self.0.fit.get() {
            Some(fit) => get_or_make(kept, || fit.warnings()).map_or(&[], Vec::as_slice),
            None => kept.get().map_or(&[], Vec::as_slice),
        }
    }

    /// A PSF with a record that was made from this one's. It keeps the warnings of the fit.
    fn derived(&self, record: PsfModelRecord, source: SourceFile) -> Self {
        let derived = Self::with_source(Origin::Record(record), source);
        derived
            .0
            .fit_warnings
            .get_or_init(|| self.fit_warnings().to_vec());
        derived
    }

    /// The model in the form that a file stores, if it exists already. Unlike
    /// [`record`](Self::record), this never starts a fit.
    pub fn record_if_fitted(&self) -> Option<&PsfModelRecord> {
        self.stored().or_else(|| self.0.fit.get().map(Fit::record))
    }

    /// The model on the stamps' own grid, made when it is first needed.
    ///
    /// # Errors
    /// [`PsfieldError`] when the fit or the interpolator fails.
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a PSF with several states
    /// ([`states`](Self::states)).
    pub fn model(&self) -> Result<&PsfModel, PsfieldError> {
        match self.models()? {
            [model] => Ok(model),
            _ => Err(self.several_states()),
        }
    }

    /// The models of all states ([`states`](Self::states)), in the order of their values, made when
    /// they are first needed. They share their stamps. A PSF that depends on the position only has
    /// one model.
    ///
    /// # Errors
    /// [`PsfieldError`] when the fit or the interpolator fails.
    pub fn models(&self) -> Result<&[PsfModel], PsfieldError> {
        match &self.0.origin {
            Origin::Model(model, _) => Ok(std::slice::from_ref(model)),
            _ => Ok(get_or_make(&self.0.models, || models_of(self.record()?))?),
        }
    }

    /// An upper bound, in frame pixels, on the distance over which the PSF spreads light: the
    /// longer side of a stamp plus one. If stamps are cut or padded to
    /// [`stamp_size`](crate::SimulateOptions::stamp_size), the bound is `stamp_size` plus one.
    pub fn reach(&self, stamp_size: Option<usize>) -> usize {
        let grid = self.whole_grid();
        let own = grid.nx().max(grid.ny()) as f64 / grid.oversampling();
        stamp_size.unwrap_or(own.ceil() as usize).saturating_add(1)
    }
}

/// Returns the kept value. Makes it first if it does not exist yet.
///
/// No thread waits for another. If two threads call at the same time, both make the value, and one
/// result is kept. A lock could cause a deadlock: rayon may give a thread that holds the lock
/// another task, and this task could wait for the same lock.
pub(crate) fn get_or_make<V, E>(kept: &OnceLock<V>, make: impl FnOnce() -> Result<V, E>) -> Result<&V, E> {
    if let Some(value) = kept.get() {
        return Ok(value);
    }
    let made = make()?;
    Ok(kept.get_or_init(|| made))
}

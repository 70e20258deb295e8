//! PSFs that also depend on a wavelength, a time or a frame.

use ndarray::{Array2, ArrayView2, Axis, concatenate};
use psf_types::{DataError, PsfSamples, SamplePositions, SampleStates, StateKind};

use super::Psf;
use crate::error::{ErrorKind, PsfieldError};
use crate::fit::models_on;

impl Psf {
    /// The wavelengths, times or frames of the PSF: its *states*. None if the PSF depends on the
    /// position only.
    ///
    /// A PSF with several states has one basis and one model for each state
    /// ([`models`](Self::models)). An image needs one PSF per position, so choose a state
    /// ([`at_state`](Self::at_state)) or mix them.
    pub fn states(&self) -> Option<&SampleStates> {
        self.positions().states()
    }

    /// The PSF at a wavelength (micrometres), a time (seconds) or a frame (number). Between the
    /// values of the samples, coefficients are interpolated by cubics
    /// ([`coeff_field::state_weights`]). Frames are not interpolated.
    ///
    /// The result has the same basis. Samples are fitted first.
    ///
    /// ```
    /// use ndarray::Array3;
    /// use psfield::Psf;
    /// use psfield::psf_types::{
    ///     Position, PsfSamples, SamplePositions, SampleStates, StampGrid, StateKind,
    /// };
    /// // A PSF that widens with the wavelength, at two wavelengths.
    /// let stamps = Array3::from_shape_fn((2, 17, 17), |(j, y, x)| {
    ///     let square = (y as f64 - 8.0).powi(2) + (x as f64 - 8.0).powi(2);
    ///     (-square / (2.0 + j as f64)).exp()
    /// });
    /// let wavelengths = SampleStates::new(StateKind::Wavelength, &[0.5, 0.7])?;
    /// let positions = SamplePositions::with_states(vec![Position::of_pixel(0, 0); 2], None, Some(wavelengths))?;
    /// let psf = Psf::from(PsfSamples::new(stamps, positions, StampGrid::new(17, 17)?)?);
    /// let green = psf.at_state(0.55)?;
    /// assert!(green.states().is_none());
    /// assert_eq!(green.model()?.rank(), psf.models()?[0].rank());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for a value outside the range of the samples, a frame that does not
    /// exist, or a PSF without states. The errors of [`record`](Self::record).
    pub fn at_state(&self, value: f64) -> Result<Self, PsfieldError> {
        let Some(states) = self.states() else {
            let message =
                self.in_file("this PSF depends on the position only, so that no state can be chosen");
            return Err(PsfieldError::new(ErrorKind::Setting, message));
        };
        let (kind, values) = (states.kind(), states.values());
        let (first, last) = (values[0], values[values.len() - 1]);
        let is_number = matches!(kind, StateKind::Frame | StateKind::Spectrum);
        let known = if is_number {
            values.contains(&value)
        } else {
            (first..=last).contains(&value)
        };
        if !known {
            let what = kind.describe(value);
            let message = self.in_file(&format!(
                "the PSF at {what} is not known: choose {}",
                range_of(states)
            ));
            return Err(PsfieldError::new(ErrorKind::Setting, message));
        }
        let mut mixture = Array2::zeros((1, values.len()));
        for (state, weight) in coeff_field::state_weights(values, value) {
            mixture[(0, state)] = weight;
        }
        self.mixed(mixture.view(), None)
    }

    /// As [`at_state`](Self::at_state), for a value that a setting chose.
    pub(super) fn at_chosen_state(
        &self,
        kind: StateKind,
        value: f64,
        setting: &'static str,
    ) -> Result<Self, PsfieldError> {
        if self.states().map(SampleStates::kind) == Some(kind) {
            return self.at_state(value).map_err(|error| error.with_setting(setting));
        }
        let depends = match self.states() {
            Some(states) => format!("depends on the {}", states.kind()),
            None => "depends on the position only".to_owned(),
        };
        let message = self.in_file(&format!(
            "this PSF {depends}, so that no {kind} can be chosen: leave it out"
        ));
        Err(PsfieldError::of_setting(setting, message))
    }

    /// Mixes the states: `a_p(x) = sum_s W_ps a_s(x)`, with the weights `W` `[mixture, state]`. The
    /// result has one state for each mixture, with these labels. Without labels, there is one
    /// mixture, and the result depends on the position only.
    pub(crate) fn mixed(
        &self,
        mixtures: ArrayView2<'_, f64>,
        labels: Option<(StateKind, &[f64])>,
    ) -> Result<Self, PsfieldError> {
        let record = self.record()?;
        let method = (record.interpolation(), record.outside());
        let coefficients = coeff_field::mix_states(record.coefficients(), method, mixtures, labels)?;
        let mixture = record.with_parts(record.basis().clone(), coefficients)?;
        // The error of a mixture is at most the largest error of its parts.
        let mixture = mixture.with_circle_error(record.circle_error());
        let wings = record.wings().map(|wings| {
            let mixed = coeff_field::mix_states(wings.coefficients(), method, mixtures, labels)?;
            Ok::<_, PsfieldError>(wings.with_coefficients(mixed)?)
        });
        let mixture = mixture.with_wings(wings.transpose()?)?;
        let mixed = self.derived(mixture, self.0.source.clone());
        // If the models of the states exist, the new ones share their stamps.
        if let Some([first, ..]) = self.0.models.get().map(Vec::as_slice) {
            let models = models_on(mixed.record()?, first, 0)?;
            mixed.0.models.get_or_init(|| models);
        }
        Ok(mixed)
    }

    /// The error where a PSF that depends on the position only is needed.
    pub(crate) fn several_states(&self) -> PsfieldError {
        let states = self.states().expect("a PSF with several models has states");
        let kind = states.kind();
        let (setting, or) = match kind {
            StateKind::Wavelength => (Some("wavelength_um"), ", or give a bandpass"),
            StateKind::Time => (Some("time_s"), ""),
            StateKind::Frame => (Some("frame_number"), ""),
            _ => (None, ""),
        };
        let range = range_of(states);
        let message = self.in_file(&format!(
            "this PSF depends on the {kind}: choose one, {range}{or}"
        ));
        PsfieldError::new(ErrorKind::Setting, message).with_setting(setting)
    }

    /// A message that begins with the name of the PSF's file, if there is one.
    fn in_file(&self, message: &str) -> String {
        match self.file_name() {
            Some(name) => format!("{name}: {message}"),
            None => message.to_owned(),
        }
    }
}

/// The values that can be chosen, in words.
fn range_of(states: &SampleStates) -> String {
    let (kind, values) = (states.kind(), states.values());
    let (first, last) = (values[0], values[values.len() - 1]);
    match kind {
        StateKind::Frame | StateKind::Spectrum => {
            format!("one of the {} numbers from {first} to {last}", values.len())
        }
        _ => format!("from {first} to {last} {}", kind.unit()),
    }
}

/// Joins samples to fit one basis to all of them. If none of them has states, each becomes a frame,
/// numbered from 0. If all have states of one kind, such as wavelengths, these are kept.
///
/// # Errors
/// [`ErrorKind::Data`] for samples that differ in the pixels of their stamps, in their field or in
/// the kind of their states, or if two samples share their position and state. The message names
/// samples by `names`.
///
/// # Panics
/// When there are no samples, or not as many names.
pub fn join_samples(samples: &[&PsfSamples], names: &[String]) -> Result<PsfSamples, PsfieldError> {
    assert_eq!(samples.len(), names.len(), "one name for each of the samples");
    let first = samples[0];
    let kind_of = |samples: &PsfSamples| samples.positions().states().map(SampleStates::kind);
    for (other, name) in samples.iter().zip(names).skip(1) {
        let differs = |what: &str| {
            let message = format!(
                "{name}: {what} than in {}: samples of one basis must agree in this",
                names[0]
            );
            Err(PsfieldError::new(ErrorKind::Data, message))
        };
        if other.grid() != first.grid() {
            return differs("stamps have another size, centre, oversampling or pixel response");
        }
        if other.positions().field() != first.positions().field() {
            return differs("the field has another size");
        }
        if kind_of(other) != kind_of(first) {
            return differs("samples depend on another quantity (wavelength, time or frame)");
        }
    }
    let views: Vec<_> = samples.iter().map(|s| s.stamps()).collect();
    let stamps = concatenate(Axis(0), &views).expect("equal shapes");
    let at = samples
        .iter()
        .flat_map(|s| s.positions().as_slice())
        .copied()
        .collect();
    let states: Vec<f64> = match kind_of(first) {
        Some(_) => samples
            .iter()
            .filter_map(|s| s.positions().states())
            .flat_map(SampleStates::per_sample)
            .collect(),
        None => (0..)
            .zip(samples)
            .flat_map(|(frame, s)| vec![f64::from(frame); s.len()])
            .collect(),
    };
    let states = SampleStates::new(kind_of(first).unwrap_or(StateKind::Frame), &states)?;
    let field = first.positions().field();
    let positions = SamplePositions::with_states(at, field, Some(states)).map_err(|error| match error {
        DataError::DuplicateState {
            first,
            second,
            position,
            state,
        } => {
            let place = |sample| place_of(sample, samples, names);
            let (first, second) = (place(first), place(second));
            let message =
                format!("{second} has the position {position} and the {state} of {first}: remove one");
            PsfieldError::new(ErrorKind::Data, message)
        }
        error => error.into(),
    })?;
    Ok(PsfSamples::new(stamps, positions, first.grid())?)
}

/// The place of a sample among those of several files, counted from 0 in its file.
fn place_of(mut sample: usize, samples: &[&PsfSamples], names: &[String]) -> String {
    for (of_file, name) in samples.iter().zip(names) {
        if sample < of_file.len() {
            return format!("{name}: sample {sample}");
        }
        sample -= of_file.len();
    }
    unreachable!("a sample of one of the files")
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;
    use psf_types::{Position, StampGrid};

    use super::*;

    /// Rounding of sums over 15 x 15 pixels.
    const ROUNDING: f64 = 1e-13;

    fn gauss(width: f64) -> Array2<f64> {
        let at = |i: usize| i as f64 - 7.0;
        Array2::from_shape_fn((15, 15), |(y, x)| {
            (-(at(x).powi(2) + at(y).powi(2)) / (2.0 * width * width)).exp()
        })
    }

    /// Samples at two positions whose width grows with x and with the number of the frame.
    fn frame(number: usize) -> PsfSamples {
        let stamps = Array3::from_shape_fn((2, 15, 15), |(j, y, x)| {
            gauss(1.0 + 0.2 * j as f64 + 0.1 * number as f64)[(y, x)]
        });
        let at = vec![Position::of_pixel(0, 0), Position::of_pixel(9, 0)];
        let positions = SamplePositions::new(at, None).unwrap();
        PsfSamples::new(stamps, positions, StampGrid::new(15, 15).unwrap()).unwrap()
    }

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|i| format!("file{i}.fits")).collect()
    }

    #[test]
    fn frames_get_one_basis_and_keep_their_psfs() {
        let samples = join_samples(&[&frame(0), &frame(1), &frame(2)], &names(3)).unwrap();
        let psf = Psf::new(
            samples.clone(),
            crate::fit::FitOptions {
                rank: psf_basis::RankSelection::Full,
                ..crate::fit::FitOptions::default()
            },
        );
        let unit = samples.into_unit_flux();
        let models = psf.models().unwrap();
        assert_eq!(models.len(), 3);
        assert!(models[2].has_basis_of(&models[0]));
        for (sample, &position) in unit.positions().as_slice().iter().enumerate() {
            let frame = sample / 2;
            let chosen = psf.at_state(frame as f64).unwrap();
            for model in [&models[frame], chosen.model().unwrap()] {
                let found = model.psf_at(position).unwrap();
                for (a, b) in found.values().iter().zip(unit.stamp(sample)) {
                    assert!((a - b).abs() < ROUNDING, "{sample}");
                }
            }
        }
        for (error, part) in [
            (psf.at_state(0.5).unwrap_err(), "one of the 3 numbers from 0 to 2"),
            (psf.model().unwrap_err(), "depends on the frame"),
        ] {
            assert_eq!(error.kind(), ErrorKind::Setting);
            assert!(error.to_string().contains(part), "{error}");
        }
    }

    #[test]
    fn samples_that_do_not_fit_together_are_refused() {
        let wide = Psf::from(frame(0)).native(Some(11)).unwrap();
        let other = wide.samples().unwrap().0.clone();
        let error = join_samples(&[&frame(0), &other], &names(2)).unwrap_err();
        assert!(error.to_string().contains("file1.fits"), "{error}");
        let joined = join_samples(&[&frame(0), &frame(1)], &names(2)).unwrap();
        let error = join_samples(&[&joined, &frame(0)], &names(2)).unwrap_err();
        assert!(
            error.to_string().contains("depend on another quantity"),
            "{error}"
        );
    }
    #[test]
    fn repeated_samples_are_named_by_file_and_number() {
        let joined = join_samples(&[&frame(0), &frame(1)], &names(2)).unwrap();
        let error = join_samples(&[&joined, &joined], &names(2))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("file1.fits: sample 0") && error.contains("file0.fits: sample 0"),
            "{error}"
        );
    }
}

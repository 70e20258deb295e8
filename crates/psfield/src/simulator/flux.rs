//! The flux of PSFs, to which the tolerance may be relative.

use conv_core::PlanOptions;
use psf_types::{PsfModel, ToleranceOn};

use crate::error::{ErrorKind, PsfieldError};
use crate::psf::Psf;

/// PSFs have no flux if their values nearly cancel: their sum is at most this part of the sum of
/// their absolute values.
const NO_FLUX: f64 = 1e-13;

/// Refuses PSFs without flux if the tolerance is relative to their flux. `models` are models of `psf`.
pub(super) fn check_flux(psf: &Psf, models: &[PsfModel], options: &PlanOptions) -> Result<(), PsfieldError> {
    if options.tolerance_on() != ToleranceOn::Aperture || models.iter().all(has_flux) {
        return Ok(());
    }
    let file = psf
        .file_name()
        .map_or_else(String::new, |file| format!("{file}: "));
    let message = format!(
        "{file}the total flux of the PSFs is 0, so the flux in a circle has no relative error: let the tolerance bound the \
         L2 error alone (l2)"
    );
    Err(PsfieldError::new(ErrorKind::Setting, message).with_setting("tolerance_on"))
}

/// Returns whether one of some PSFs of the model has flux, or the model knows no PSFs.
fn has_flux(model: &PsfModel) -> bool {
    let weights = model.some_coefficients();
    let first = usize::from(model.is_mean_centred());
    let sums: Vec<[f64; 2]> = model
        .stamps()
        .outer_iter()
        .map(|stamp| {
            stamp
                .iter()
                .fold([0.0, 0.0], |[sum, size], v| [sum + v, size + v.abs()])
        })
        .collect();
    let mut each = weights.outer_iter();
    weights.nrows() == 0
        || each.any(|weights| {
            let mut of_psf = if first == 1 { sums[0] } else { [0.0; 2] };
            for (w, [sum, size]) in weights.iter().zip(&sums[first..]) {
                of_psf = [of_psf[0] + w * sum, of_psf[1] + w.abs() * size];
            }
            of_psf[0].abs() > NO_FLUX * of_psf[1]
        })
}

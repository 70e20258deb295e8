//! Header cards of simulated images.

use conv_core::PlanOptions;
use psf_io::{Card, CardError};
use psf_types::{PsfModel, Real};

use crate::{Method, Placement};

/// The keyword of the digest of the options of the job of a batch that made a file.
pub const JOB_KEYWORD: &str = "PSFJOB";

/// Who made a file: the version of psfield, and the `command` as a line of HISTORY.
pub fn provenance_cards(command: &str) -> Vec<Card> {
    vec![
        Card::new(
            "PSFIELD",
            env!("CARGO_PKG_VERSION"),
            "version of psfield that wrote this",
        )
        .expect("a valid card"),
        Card::history(command),
    ]
}

/// How an image was made, in the working precision `T`: method, anchoring, device, the model's components and normalisation, and the
/// tolerance of methods that have one.
///
/// A simulated image holds, after the scene's own cards ([`SceneSources::carried_header`](crate::SceneSources::carried_header)), those
/// of [`provenance_cards`], these, and those of its [`SpotCheck`](crate::SpotCheck), if any.
///
/// # Errors
/// [`CardError`] for the name of a GPU that no header can hold.
///
/// ```no_run
/// use psfield::conv_core::PlanOptions;
/// use psfield::{CpuReason, Method, Placement, PsfInput, simulation_cards};
/// let model = PsfInput::open("psf.fits", Default::default())?.into_model()?;
/// let placement = Placement::cpu(CpuReason::Asked);
/// let cards = simulation_cards::<f32>(&model, Method::Auto, PlanOptions::new(1e-3)?, &placement)?;
/// assert_eq!(cards.last().map(|card| card.keyword()), Some("PSFTOL".to_owned()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn simulation_cards<T: Real>(
    model: &PsfModel,
    method: Method,
    options: PlanOptions,
    placement: &Placement,
) -> Result<Vec<Card>, CardError> {
    let mut cards = vec![
        Card::new("PSFMETH", method.to_string(), "convolution method")?,
        Card::new(
            "PSFANCH",
            options.anchor().to_string(),
            "whose PSF applies: source or output pixel",
        )?,
        Card::new("PSFPREC", T::NAME, "working precision")?,
        Card::new(
            "PSFDEV",
            placement.adapter().unwrap_or("CPU"),
            "device that convolved images",
        )?,
        Card::new(
            "PSFRANK",
            model.rank(),
            "components of the PSF model (mean not counted)",
        )?,
        Card::new(
            "PSFNORM",
            model.normalisation().to_string(),
            "unit: every PSF has unit flux",
        )?,
    ];
    if let Some(options) = method.plan_options(options) {
        cards.push(Card::new(
            "PSFTOL",
            options.tolerance(),
            "relative L2 error allowed for any pixel's PSF",
        )?);
    }
    Ok(cards)
}

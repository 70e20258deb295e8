//! Header cards of simulated images.

use conv_core::ConvReal;
use psf_io::{Card, CardError, HeaderCards};

use crate::{Preparation, Simulator, SpotCheck};

/// The keyword for the digest of a batch job's options, in the files that the job made.
pub const JOB_KEYWORD: &str = "PSFJOB";

/// Cards of a file's origin: the version of psfield, and the `command` as a line of HISTORY.
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

impl<T: ConvReal> Simulator<T> {
    /// Cards that say how an image was made: method, anchoring, precision, device, the model's
    /// components and normalisation, and the tolerance of methods that have one.
    ///
    /// A simulated image holds the scene's own cards ([`carried_header`](Self::carried_header)),
    /// then those of [`provenance_cards`], then these, then those of its [`SpotCheck`], if any.
    ///
    /// # Errors
    /// [`CardError`] for the name of a GPU that a header cannot hold.
    pub fn cards(&self, made: &Preparation<'_>) -> Result<Vec<Card>, CardError> {
        let options = self.options();
        let mut cards = vec![
            Card::new("PSFMETH", options.method.to_string(), "convolution method")?,
            Card::new(
                "PSFANCH",
                options.anchor.to_string(),
                "whose PSF applies: source or output pixel",
            )?,
            Card::new("PSFPREC", T::NAME, "working precision")?,
            Card::new(
                "PSFDEV",
                made.placement.adapter().unwrap_or("CPU"),
                "device that convolved images",
            )?,
            Card::new(
                "PSFRANK",
                made.model.rank(),
                "components of the PSF model (mean not counted)",
            )?,
            Card::new(
                "PSFNORM",
                made.model.normalisation().to_string(),
                "unit: every PSF has unit flux",
            )?,
        ];
        if options.method.has_plan() {
            cards.push(Card::new(
                "PSFTOL",
                options.tolerance,
                "relative L2 error allowed for any pixel's PSF",
            )?);
        }
        Ok(cards)
    }

    /// Returns the cards of a scene for its image: world coordinates refer to the frame's pixels,
    /// and the cards about the making of the scene are removed. If `of_image` is true, `header` is
    /// that of the scene's image and counts its pixels. Otherwise it counts frame pixels.
    pub fn carried_header(&self, header: &HeaderCards, of_image: bool) -> HeaderCards {
        let (frame, s) = (self.frame(), self.options().oversample);
        let mut header = if of_image {
            let s0 = s as i64;
            header.shifted_origin(frame.x0() * s0, frame.y0() * s0).binned(s)
        } else {
            header.shifted_origin(frame.x0(), frame.y0())
        };
        // A scene may itself be a result. Its check and its job do not apply to this image.
        for keyword in SpotCheck::KEYWORDS.into_iter().chain([JOB_KEYWORD]) {
            header.remove(keyword);
        }
        header
    }
}

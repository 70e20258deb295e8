//! Header cards of simulated images.

use conv_core::ConvReal;
use psf_io::{Card, CardError, HeaderCards};

use crate::{Preparation, Simulator, SpotCheck};

/// The keyword that holds the digest of a batch job's options, in the files that the job made.
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
    /// Returns cards that say how an image was made: method, anchor, precision, device, the model's
    /// components and normalisation. For methods with a tolerance, a card holds it.
    ///
    /// The header of a simulated image holds, in this order: the scene's own cards
    /// ([`carried_header`](Self::carried_header)), the cards of [`provenance_cards`], these cards,
    /// and the cards of its [`SpotCheck`], if there is one.
    ///
    /// # Errors
    /// [`CardError`] for a tolerance that is not finite, which no simulator has.
    pub fn cards(&self, made: &Preparation<'_>) -> Result<Vec<Card>, CardError> {
        let options = self.options();
        let mut cards = vec![
            Card::new("PSFMETH", options.method.to_string(), "convolution method")?,
            Card::new(
                "PSFANCH",
                options.anchor.to_string(),
                "position of the PSF: source or output pixel",
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
                "unit: every PSF has unit flux, keep: as stored",
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

    /// Converts the header of a scene to cards for the image of the scene. World coordinates then
    /// refer to the frame's pixels. The cards of an earlier spot check and of a batch job are
    /// removed. If `of_image` is true, the world coordinates of `header` refer to pixels of the
    /// scene's image. Otherwise they refer to frame pixels.
    pub fn carried_header(&self, header: &HeaderCards, of_image: bool) -> HeaderCards {
        let (frame, s) = (self.frame(), self.options().oversample);
        let mut header = if of_image {
            let s0 = s as i64;
            header.shifted_origin(frame.x0() * s0, frame.y0() * s0).binned(s)
        } else {
            header.shifted_origin(frame.x0(), frame.y0())
        };
        // The scene may be an image that psfield made. Its spot check and its batch job do not
        // apply to the new image.
        for keyword in SpotCheck::KEYWORDS.into_iter().chain([JOB_KEYWORD]) {
            header.remove(keyword);
        }
        header
    }
}

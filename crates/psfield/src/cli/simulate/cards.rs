//! Header cards of an image.

use conv_core::ConvReal;
use psf_io::{Card, HeaderCards};
use psf_types::{PsfModel, Scene};

use super::super::context::{CHECK_KEYWORDS, signature};
use super::SimulateArgs;

impl SimulateArgs {
    /// What is needed to repeat the result.
    pub(super) fn cards<T: ConvReal>(&self, model: &PsfModel) -> anyhow::Result<Vec<Card>> {
        let mut cards = signature();
        cards.extend([
            Card::new("PSFMETH", self.method.to_string(), "convolution method")?,
            Card::new(
                "PSFANCH",
                self.anchor.to_string(),
                "whose PSF applies: source or output pixel",
            )?,
            Card::new("PSFPREC", T::NAME, "working precision")?,
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
        ]);
        if let Some(tolerance) = self.promised()? {
            cards.push(Card::new(
                "PSFTOL",
                tolerance,
                "relative L2 error allowed for any pixel's PSF",
            )?);
        }
        Ok(cards)
    }

    /// The scene's cards as the image carries them.
    pub(super) fn carried<T: ConvReal>(&self, header: &HeaderCards, scene: &Scene<T>) -> HeaderCards {
        let (x0, y0, finer) = (scene.frame().x0(), scene.frame().y0(), self.scene.finer());
        // A scene's header counts its own pixels, one given beside it those of the image.
        let mut header = if self.scene.scene.is_some() {
            header.shifted_origin(x0, y0).binned(finer)
        } else {
            header.shifted_origin(x0 / finer as i64, y0 / finer as i64)
        };
        // A scene that is itself a result must not lend its own check to this one.
        for keyword in CHECK_KEYWORDS {
            header.remove(keyword);
        }
        header
    }
}

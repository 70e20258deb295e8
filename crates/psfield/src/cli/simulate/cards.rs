//! Header cards of an image.

use conv_core::ConvReal;
use psf_io::{Card, HeaderCards};
use psf_types::PsfModel;
use psfield::Placement;

use super::super::context::{CHECK_KEYWORDS, signature, signature_of};
use super::SimulateArgs;
use super::scene_args::Sources;

/// The keyword of [`JobMark::digest`].
pub(crate) const JOB_KEYWORD: &str = "PSFJOB";

/// What made the files of a job.
#[derive(Debug, Clone)]
pub(crate) struct JobMark {
    /// The command line that does the same.
    pub(crate) arguments: Vec<String>,
    /// Tells the options of one job from those of another.
    pub(crate) digest: String,
}

impl SimulateArgs {
    /// What is needed to repeat the result.
    pub(super) fn cards<T: ConvReal>(
        &self,
        model: &PsfModel,
        placement: &Placement,
    ) -> anyhow::Result<Vec<Card>> {
        let mut cards = match &self.job {
            Some(mark) => {
                let mut cards = signature_of(&mark.arguments);
                let digest = mark.digest.as_str();
                cards.push(Card::new(
                    JOB_KEYWORD,
                    digest,
                    "digest of the options of the job",
                )?);
                cards
            }
            None => signature(),
        };
        cards.extend([
            Card::new("PSFMETH", self.method.to_string(), "convolution method")?,
            Card::new(
                "PSFANCH",
                self.anchor.to_string(),
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
    pub(super) fn carried<T: ConvReal>(&self, header: &HeaderCards, sources: &Sources<T>) -> HeaderCards {
        let (frame, padding) = (sources.scene.frame(), sources.padding as i64);
        let (x0, y0, finer) = (frame.x0() - padding, frame.y0() - padding, self.scene.finer());
        // A scene's header counts its own pixels, one given beside it those of the image.
        let mut header = if self.scene.scene.is_some() {
            header.shifted_origin(x0, y0).binned(finer)
        } else {
            header.shifted_origin(x0 / finer as i64, y0 / finer as i64)
        };
        // A scene that is itself a result must not lend its own check and job to this one.
        for keyword in CHECK_KEYWORDS.into_iter().chain([JOB_KEYWORD]) {
            header.remove(keyword);
        }
        header
    }
}

//! Header cards of an image.

use conv_core::ConvReal;
use psf_io::Card;
use psf_types::PsfModel;
use psfield::{JOB_KEYWORD, Placement, simulation_cards};

use super::super::context::{signature, signature_of};
use super::SimulateArgs;

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
        cards.extend(simulation_cards::<T>(
            model,
            self.method,
            self.options()?,
            placement,
        )?);
        Ok(cards)
    }
}

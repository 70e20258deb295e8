//! Header cards of simulated images.

use std::time::{SystemTime, UNIX_EPOCH};

use conv_core::ConvReal;
use psf_io::{Card, CardError, HeaderCards};

use crate::{Preparation, Simulator, SpotCheck};

/// The keyword that holds the digest of a batch job's options, in the files that the job made.
pub const JOB_KEYWORD: &str = "PSFJOB";

/// The keyword that holds the name of the PSF's file, without its folder.
pub const PSF_FILE_KEYWORD: &str = "PSFFILE";

/// Cards of a file's origin: the version of psfield, the date, and the `command` as a line of
/// HISTORY.
///
/// `DATE` is the time of the call ([`utc_now`]). If the environment variable `SOURCE_DATE_EPOCH`
/// sets this time, files of two runs can be compared byte by byte.
pub fn provenance_cards(command: &str) -> Vec<Card> {
    vec![
        Card::new(
            "PSFIELD",
            env!("CARGO_PKG_VERSION"),
            "version of psfield that wrote this",
        )
        .expect("a valid card"),
        Card::new("DATE", utc_now(), "when this was written (UTC)").expect("a valid card"),
        Card::history(command),
    ]
}

/// Returns the current date and time (UTC) as `YYYY-MM-DDThh:mm:ss`. If the environment variable
/// `SOURCE_DATE_EPOCH` holds a number of seconds since 1970, this time is returned instead.
pub fn utc_now() -> String {
    /// The first second of the year 10000, which FITS cannot write.
    const END: u64 = 253_402_300_800;
    let set = std::env::var("SOURCE_DATE_EPOCH")
        .ok()
        .and_then(|text| text.trim().parse().ok());
    let clock = || {
        SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |passed| passed.as_secs())
    };
    utc(set.unwrap_or_else(clock).min(END - 1))
}

/// The date `YYYY-MM-DDThh:mm:ss` of a number of seconds since 1970.
fn utc(seconds: u64) -> String {
    const DAYS_IN_400_YEARS: u64 = 146_097;
    let (days, time) = (seconds / 86_400, seconds % 86_400);
    // Years begin in March here, so that the leap day is the last. Day 0 is 0000-03-01.
    let days = days + 719_468;
    let (era, day) = (days / DAYS_IN_400_YEARS, days % DAYS_IN_400_YEARS);
    let year = (day - day / 1460 + day / 36_524 - day / (DAYS_IN_400_YEARS - 1)) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = 400 * era + year + u64::from(month <= 2);
    let (hour, minute, second) = (time / 3600, time / 60 % 60, time % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}")
}

impl<T: ConvReal> Simulator<T> {
    /// Returns cards that say how an image was made: method, anchor, meaning of the scene's pixels,
    /// precision, device, and the model's number of components and normalisation. A method with a
    /// tolerance has cards for it and for the errors that it bounds.
    ///
    /// The header of a simulated image holds, in this order: the scene's own cards
    /// ([`carried_header`](Self::carried_header)), the cards of [`provenance_cards`], these cards,
    /// and the cards of its [`SpotCheck`], if there is one.
    ///
    /// # Errors
    /// No error occurs. The type allows an error for a tolerance that is not finite, which no
    /// simulator has.
    pub fn cards(&self, made: &Preparation<'_>) -> Result<Vec<Card>, CardError> {
        let options = self.options();
        let mut cards = vec![
            Card::new("PSFMETH", options.method.to_string(), "convolution method")?,
            Card::new(
                "PSFANCH",
                options.anchor.to_string(),
                "PSF is that of the source or output pixel",
            )?,
            Card::new(
                "PSFSCPIX",
                options.scene_pixels.to_string(),
                "light in the scene's pixels",
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
            cards.push(Card::new(
                "PSFTOLON",
                options.tolerance_on.to_string(),
                "aperture: tolerance bounds flux in circles too",
            )?);
        }
        Ok(cards)
    }

    /// Converts the header of a scene to the header of the image that is simulated from it. If
    /// `of_image` is true, the world coordinates of `header` refer to the pixels of the image that
    /// describes the scene. Otherwise they refer to frame pixels counted from the scene's first
    /// pixel. In the result they refer to the frame's pixels. The cards of an earlier spot check,
    /// batch job and PSF file are removed.
    pub fn carried_header(&self, header: &HeaderCards, of_image: bool) -> HeaderCards {
        let (frame, s) = (self.frame(), self.options().oversample);
        let mut header = if of_image {
            let s0 = s as i64;
            header.shifted_origin(frame.x0() * s0, frame.y0() * s0).binned(s)
        } else {
            header.shifted_origin(frame.x0(), frame.y0())
        };
        // The scene may be an image that psfield made. Its spot check, batch job and PSF do not
        // apply to the new image.
        let others = [JOB_KEYWORD, PSF_FILE_KEYWORD];
        for keyword in SpotCheck::KEYWORDS.into_iter().chain(others) {
            header.remove(keyword);
        }
        header
    }
}

#[cfg(test)]
mod tests {
    use super::utc;

    #[test]
    fn dates() {
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00"),
            (951_782_399, "2000-02-28T23:59:59"),
            (951_782_400, "2000-02-29T00:00:00"),
            (1_735_689_599, "2024-12-31T23:59:59"),
            (1_740_787_200, "2025-03-01T00:00:00"),
            (4_107_542_399, "2100-02-28T23:59:59"),
            (4_107_542_400, "2100-03-01T00:00:00"),
        ] {
            assert_eq!(utc(seconds), text);
        }
    }
}

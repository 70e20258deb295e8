//! Header cards of simulated images.

use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use conv_core::{ConvReal, DroppedLight, PhotonReport};
use psf_io::{Card, CardError, HduChoice, HeaderCards};

use crate::error::{ErrorKind, PsfieldError, error_text};
use crate::simulator::{Preparation, Simulator};
use crate::spot_check::SpotCheck;

/// The keyword that holds the digest of a batch job's options, in the files that the job made.
pub const JOB_KEYWORD: &str = "PSFJOB";

/// The keyword that holds the name of the PSF's file, without its folder.
pub const PSF_FILE_KEYWORD: &str = "PSFFILE";

/// Checks that a file was made by the job with this digest of its options, and did not fail its spot check. The
/// digest stands in the primary header.
///
/// # Errors
/// A message that says what the file is, and what to do.
pub fn check_made_by(file: &Path, digest: &str) -> Result<(), String> {
    let header = psf_io::read_cards(file, Some(&HduChoice::Number(0))).map_err(|e| {
        format!(
            "{} exists and is not an image of this job: delete it, or run all jobs again with overwrite ({})",
            file.display(),
            error_text(&e)
        )
    })?;
    let failed = header.text(SpotCheck::VERDICT_KEYWORD).as_deref() == Some(SpotCheck::FAILED);
    match header.text(JOB_KEYWORD) {
        None => Err(format!(
            "{} exists and was not made by such a job: delete it, or run all jobs again with overwrite",
            file.display()
        )),
        Some(found) if found != digest => Err(format!(
            "{} exists and was made with other options ({JOB_KEYWORD} {found}, now {digest}): delete it, choose another output, \
             or run all jobs again with overwrite",
            file.display()
        )),
        Some(_) if failed => Err(format!(
            "{} exists but failed its spot check when it was made: it differs from the direct sum by more than the method promises. \
             Choose another method for this job, and delete its files or run all jobs again with overwrite",
            file.display()
        )),
        Some(_) => Ok(()),
    }
}

/// The keywords of [`Simulator::dropped_cards`].
const DROPPED_KEYWORDS: [&str; 3] = ["PSFFLOOR", "PSFDROPM", "PSFDROPF"];

/// The keywords of [`shot_cards`].
const SHOT_KEYWORDS: [&str; 2] = ["PSFSHOT", "PSFSHOTN"];

/// Cards that say how many sources were drawn photon by photon ([`Simulator::shoot`]), and of how many photons.
pub fn shot_cards(shot: &PhotonReport) -> [Card; 2] {
    let [sources, photons] = SHOT_KEYWORDS;
    [
        Card::new(
            sources,
            shot.sources,
            "sources drawn photon by photon, not checked",
        ),
        Card::new(
            photons,
            shot.photons as usize,
            "their photons, before the pixels' response",
        ),
    ]
    .map(|card| card.expect("a valid card"))
}

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

/// The first second of the year 10000, which FITS cannot write, counted from 1970.
const END: u64 = 253_402_300_800;

/// Returns the current date and time (UTC) as `YYYY-MM-DDThh:mm:ss`. If the environment variable
/// `SOURCE_DATE_EPOCH` holds a number of seconds since 1970, this time is returned instead.
pub fn utc_now() -> String {
    let set = std::env::var("SOURCE_DATE_EPOCH")
        .ok()
        .and_then(|text| text.trim().parse().ok());
    let now = set.map_or_else(SystemTime::now, |seconds: u64| {
        UNIX_EPOCH + Duration::from_secs(seconds.min(END - 1))
    });
    without_zone(&humantime::format_rfc3339_seconds(now))
}

/// Parses a date and time (UTC), `YYYY-MM-DDThh:mm:ss` with or without fractions of a second. None for
/// another text, and for a time zone other than UTC.
///
/// ```
/// assert!(psfield::image_cards::parse_utc("2026-11-27T21:00:00.25").is_some());
/// assert!(psfield::image_cards::parse_utc("2026-11-27T21:00:00+02:00").is_none());
/// ```
pub fn parse_utc(text: &str) -> Option<SystemTime> {
    humantime::parse_rfc3339_weak(text).ok()
}

/// Header cards with the times of an exposure. `from_s` and `to_s` are its start and end in seconds
/// after `start`.
///
/// | keyword | value |
/// |---|---|
/// | `DATE-OBS`, `DATE-END` | start and end (UTC), with microseconds |
/// | `EXPTIME` | duration in seconds |
///
/// ```
/// let start = psfield::image_cards::parse_utc("2026-12-31T23:59:50").expect("a time");
/// let cards = psfield::image_cards::exposure_time_cards(start, (5.0, 35.5))?;
/// assert_eq!(cards[1].value(), Some("2027-01-01T00:00:25.500000".into()));
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
///
/// # Errors
/// [`ErrorKind::Data`] for a time before the year 1970 or after 9999.
pub fn exposure_time_cards(start: SystemTime, (from_s, to_s): (f64, f64)) -> Result<[Card; 3], PsfieldError> {
    let date = |seconds: f64| {
        let distance = Duration::from_micros((seconds.abs() * 1e6).round() as u64);
        let time = if seconds < 0.0 {
            start.checked_sub(distance)
        } else {
            start.checked_add(distance)
        };
        let end = UNIX_EPOCH + Duration::from_secs(END);
        let known = time.filter(|time| (UNIX_EPOCH..end).contains(time));
        let known = known.ok_or_else(|| {
            let message = format!(
                "{seconds} s after the start is before the year 1970 or after 9999: check the times, which are in seconds"
            );
            PsfieldError::new(ErrorKind::Data, message)
        })?;
        Ok::<_, PsfieldError>(without_zone(&humantime::format_rfc3339_micros(known)))
    };
    Ok([
        Card::new("DATE-OBS", date(from_s)?, "start of the exposure (UTC)")?,
        Card::new("DATE-END", date(to_s)?, "end of the exposure (UTC)")?,
        Card::new("EXPTIME", to_s - from_s, "[s] exposure time")?,
    ])
}

/// FITS writes no letter for UTC.
fn without_zone(time: &humantime::Rfc3339Timestamp) -> String {
    time.to_string().trim_end_matches('Z').to_owned()
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

    /// Returns cards that say how much light was dropped: none without a floor.
    ///
    /// | keyword | value |
    /// |---|---|
    /// | `PSFFLOOR` | the floor, in flux per pixel |
    /// | `PSFDROPM` | the largest sum of dropped light in a pixel is at most this |
    /// | `PSFDROPF` | the fraction of the flux that is dropped at most |
    ///
    /// # Errors
    /// [`CardError`] if the light is not finite.
    pub fn dropped_cards(&self, dropped: Option<&DroppedLight>) -> Result<Vec<Card>, CardError> {
        let Some(dropped) = dropped else {
            return Ok(Vec::new());
        };
        let [floor, largest, fraction] = DROPPED_KEYWORDS;
        Ok(vec![
            Card::new(floor, self.options().floor, "floor of sources, flux per pixel")?,
            Card::new(
                largest,
                dropped.largest(),
                "most light dropped in any pixel, upper limit",
            )?,
            Card::new(
                fraction,
                dropped.fraction(),
                "fraction of flux dropped, upper limit",
            )?,
        ])
    }

    /// Converts the header of a scene to the header of the image that is simulated from it. If
    /// `of_image` is true, the world coordinates of `header` refer to the pixels of the image that
    /// describes the scene. Otherwise they refer to frame pixels counted from the scene's first
    /// pixel. In the result they refer to the frame's pixels. The cards of an earlier spot check,
    /// batch job, PSF file and floor are removed.
    pub fn carried_header(&self, header: &HeaderCards, of_image: bool) -> HeaderCards {
        let (frame, s) = (self.frame(), self.options().oversample);
        let mut header = if of_image {
            let s0 = s as i64;
            header
                .shifted_origin((frame.x0() * s0) as f64, (frame.y0() * s0) as f64)
                .binned(s)
        } else {
            header.shifted_origin(frame.x0() as f64, frame.y0() as f64)
        };
        // The scene may be an image that psfield made. Its spot check, batch job and PSF do not
        // apply to the new image.
        let others = [JOB_KEYWORD, PSF_FILE_KEYWORD];
        let keywords = SpotCheck::KEYWORDS.into_iter().chain(DROPPED_KEYWORDS);
        for keyword in keywords.chain(others).chain(SHOT_KEYWORDS) {
            header.remove(keyword);
        }
        header
    }
}

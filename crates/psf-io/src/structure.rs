//! The HDUs of a FITS file, found and checked against the file's length before anything is allocated for their data.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::fits_source::FitsSource;
use crate::gzip;
use crate::hdu::{Hdu, HduKind};
use crate::header_cards::TILED_NAME;
use crate::scanner::Scanner;
use crate::{Card, CardValue, HduChoice, HeaderCards, IoError};

const MAGIC: &[u8] = b"SIMPLE  =";
/// First bytes of files that are compressed in ways not read here, and what they are.
const COMPRESSED: &[(&[u8], &str, &str)] = &[
    (b"BZh", "compressed by bzip2", "run bunzip2 first"),
    (b"\x1f\x9d", "compressed by compress", "run uncompress first"),
    (b"\xfd7zXZ", "compressed by xz", "run unxz first"),
    (b"PK\x03\x04", "a zip archive", "run unzip first"),
];

/// What the first bytes of a file tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Magic {
    Fits,
    Other,
}

/// The HDUs of a file, all of whose data are there.
#[derive(Debug)]
pub(crate) struct FitsStructure {
    pub(crate) path: PathBuf,
    pub(crate) hdus: Vec<Hdu>,
}

impl FitsStructure {
    /// Reads every header and checks that the file is long enough for every HDU. What gzip has compressed is unpacked to a temporary file
    /// for as long as the structure or anything opened through it lives.
    pub(crate) fn scan(path: &Path) -> Result<Self, IoError> {
        if magic(path)? != Magic::Fits {
            return Err(IoError::NotFits {
                path: path.to_owned(),
            });
        }
        let source = if start_of(path)?.starts_with(gzip::GZIP) {
            FitsSource::unpacked(path, gzip::unpack(path)?)
        } else {
            FitsSource::plain(path)
        };
        let mut scanner = Scanner::open(&source)?;
        let mut hdus = Vec::new();
        while scanner.next_hdu_starts(hdus.len())? {
            hdus.push(scanner.read_hdu(hdus.len())?);
        }
        Ok(Self {
            path: path.to_owned(),
            hdus,
        })
    }

    /// The first image that has pixels.
    pub(crate) fn first_image(&self) -> Result<&Hdu, IoError> {
        if let Some(hdu) = self.hdus.iter().find(|hdu| hdu.has_pixels()) {
            return Ok(hdu);
        }
        Err(self.missing("image with pixels"))
    }

    /// The first binary table of this name (upper or lower case).
    pub(crate) fn table(&self, name: &str) -> Option<&Hdu> {
        self.tables()
            .find(|hdu| hdu.name().is_some_and(|n| n.eq_ignore_ascii_case(name)))
    }

    /// The HDU chosen.
    fn chosen(&self, choice: &HduChoice) -> Option<&Hdu> {
        self.hdus.iter().find(|hdu| choice.matches(hdu))
    }

    /// The image with pixels that is chosen. Without a choice the primary HDU's, where it has pixels, and else the only one: which of
    /// several is the science image, and which its mask or weight, is not guessed.
    pub(crate) fn image(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        if let Some(choice) = choice {
            return match self.chosen(choice) {
                Some(hdu) if hdu.has_pixels() => Ok(hdu),
                _ => Err(self.no_such(choice, "images with pixels", Hdu::has_pixels)),
            };
        }
        let first = self.first_image()?;
        let images: Vec<&Hdu> = self.hdus.iter().filter(|hdu| hdu.has_pixels()).collect();
        if first.index == 0 || images.len() == 1 {
            Ok(first)
        } else {
            Err(self.several("images", images.into_iter()))
        }
    }

    /// The HDU whose header describes the frame: an image, with pixels or without. Without a choice the image with pixels, as
    /// [`image`](Self::image) has it; where there is none the first HDU with world coordinates, or else the primary.
    pub(crate) fn header_of_frame(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        let is_image = |hdu: &Hdu| hdu.kind == HduKind::Image;
        if let Some(choice) = choice {
            return match self.chosen(choice) {
                Some(hdu) if is_image(hdu) => Ok(hdu),
                _ => Err(self.no_such(choice, "images or headers of images", is_image)),
            };
        }
        if self.first_image().is_ok() {
            return self.image(None);
        }
        let describes = |hdu: &&Hdu| is_image(hdu) && hdu.header.get("CTYPE1").is_some();
        Ok(self.hdus.iter().find(describes).unwrap_or(&self.hdus[0]))
    }

    /// The cards of an image for files of another structure. An image in an extension inherits those of an empty primary HDU,
    /// unless `INHERIT = F` says otherwise.
    pub(crate) fn cards(&self, hdu: &Hdu) -> HeaderCards {
        let primary = &self.hdus[0];
        if hdu.index == 0 || primary.has_pixels() || hdu.logical("INHERIT") == Some(false) {
            return hdu.header.carried();
        }
        hdu.header.carried().inheriting(&primary.header.carried())
    }

    /// The binary table chosen.
    pub(crate) fn chosen_table(&self, choice: &HduChoice) -> Result<&Hdu, IoError> {
        let is_table = |hdu: &Hdu| hdu.kind == HduKind::BinaryTable;
        match self.chosen(choice) {
            Some(hdu) if is_table(hdu) => Ok(hdu),
            Some(hdu) if hdu.is_ascii_table() => Err(self.ascii_table(hdu)),
            _ => Err(self.no_such(choice, "binary tables", is_table)),
        }
    }

    /// The error for a file that holds no binary table.
    pub(crate) fn no_table(&self, needed: &str) -> IoError {
        match self.hdus.iter().find(|hdu| hdu.is_ascii_table()) {
            Some(hdu) => self.ascii_table(hdu),
            None => self.missing(&format!("binary table (columns needed: {needed})")),
        }
    }

    fn ascii_table(&self, hdu: &Hdu) -> IoError {
        IoError::AsciiTable {
            path: self.path.clone(),
            hdu: hdu.index,
        }
    }

    fn no_such(&self, choice: &HduChoice, what: &'static str, fits: impl Fn(&Hdu) -> bool) -> IoError {
        IoError::NoSuchHdu {
            path: self.path.clone(),
            wanted: choice.clone(),
            what,
            found: self
                .hdus
                .iter()
                .filter(|hdu| fits(hdu))
                .map(Hdu::described)
                .collect(),
        }
    }

    /// The image with PSF stamps that is chosen; without a choice the only one with pixels.
    pub(crate) fn stamps(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        if choice.is_some() {
            return self.image(choice);
        }
        let first = self.first_image()?;
        let images = self.hdus.iter().filter(|hdu| hdu.has_pixels());
        match images.clone().nth(1) {
            None => Ok(first),
            Some(_) => Err(self.several_of("images", "--psf-extension N|NAME", images)),
        }
    }

    /// The error for HDUs of which one must be chosen.
    pub(crate) fn several<'a>(&self, what: &'static str, hdus: impl Iterator<Item = &'a Hdu>) -> IoError {
        self.several_of(what, "--extension N|NAME", hdus)
    }

    fn several_of<'a>(
        &self,
        what: &'static str,
        option: &'static str,
        hdus: impl Iterator<Item = &'a Hdu>,
    ) -> IoError {
        IoError::SeveralHdus {
            path: self.path.clone(),
            what,
            option,
            found: hdus.map(Hdu::described).collect(),
        }
    }

    /// The binary tables.
    pub(crate) fn tables(&self) -> impl Iterator<Item = &Hdu> {
        self.hdus.iter().filter(|hdu| hdu.kind == HduKind::BinaryTable)
    }

    pub(crate) fn missing(&self, what: &str) -> IoError {
        IoError::MissingHdu {
            path: self.path.clone(),
            what: what.to_owned(),
        }
    }
}

/// Tells a FITS file, also one compressed by gzip, from others by its first bytes; what is compressed otherwise is an error.
pub(crate) fn magic(path: &Path) -> Result<Magic, IoError> {
    let start = start_of(path)?;
    let refused = |what, remedy| IoError::Compressed {
        path: path.to_owned(),
        what,
        remedy,
    };
    if let Some(&(_, what, remedy)) = COMPRESSED.iter().find(|(bytes, ..)| start.starts_with(bytes)) {
        return Err(refused(what, remedy));
    }
    if start.starts_with(gzip::GZIP) {
        return if gzip::first_bytes(path, MAGIC.len())? == MAGIC {
            Ok(Magic::Fits)
        } else {
            Err(refused(
                "compressed by gzip, and not a FITS file",
                "run gunzip first",
            ))
        };
    }
    Ok(if start == MAGIC { Magic::Fits } else { Magic::Other })
}

/// The first bytes of a file.
fn start_of(path: &Path) -> Result<Vec<u8>, IoError> {
    let failed = |source| IoError::Read {
        path: path.to_owned(),
        source,
    };
    if !std::fs::metadata(path).map_err(failed)?.is_file() {
        return Err(IoError::NotAFile {
            path: path.to_owned(),
        });
    }
    let mut start = Vec::with_capacity(MAGIC.len());
    let file = File::open(path).map_err(failed)?;
    file.take(MAGIC.len() as u64)
        .read_to_end(&mut start)
        .map_err(failed)?;
    Ok(start)
}

impl Hdu {
    /// Whether this is an image that has pixels.
    pub(crate) fn has_pixels(&self) -> bool {
        self.kind == HduKind::Image && !self.axes.is_empty() && self.axes.iter().all(|&n| n > 0)
    }

    /// Whether this is a table of text.
    fn is_ascii_table(&self) -> bool {
        self.text("XTENSION").as_deref() == Some("TABLE")
    }

    /// The EXTNAME.
    pub(crate) fn name(&self) -> Option<String> {
        self.text("EXTNAME")
            .map(|name| name.trim().to_owned())
            .filter(|name| !(self.is_tiled() && name == TILED_NAME))
    }

    /// The EXTVER.
    pub(crate) fn version(&self) -> i64 {
        match self.header.get("EXTVER").and_then(Card::value) {
            Some(CardValue::Integer(version)) => version,
            _ => 1,
        }
    }

    /// Number, name and size, for a list to choose from.
    pub(crate) fn described(&self) -> String {
        let mut text = self.index.to_string();
        if let Some(name) = self.name() {
            text = format!("{text} {name:?}");
            if self.header.get("EXTVER").is_some() {
                text = format!("{text},{}", self.version());
            }
        }
        let sizes: Vec<String> = self.axes.iter().map(ToString::to_string).collect();
        match self.kind {
            HduKind::BinaryTable => format!("{text} ({} rows)", self.axes.get(1).unwrap_or(&0)),
            _ => format!("{text} ({})", sizes.join(" x ")),
        }
    }

    /// A logical keyword, if it is there and is one.
    pub(crate) fn logical(&self, keyword: &str) -> Option<bool> {
        match self.header.get(keyword)?.value()? {
            CardValue::Logical(value) => Some(value),
            _ => None,
        }
    }

    /// A text keyword, if it is there and is one.
    pub(crate) fn text(&self, keyword: &str) -> Option<String> {
        match self.header.get(keyword)?.value()? {
            CardValue::Text(value) => Some(value),
            _ => None,
        }
    }
}

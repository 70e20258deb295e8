//! Finds the HDUs of a FITS file and checks them against the length of the file, before any memory
//! is allocated for their data.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::error::{IoError, content, unreadable};
use crate::fits::hdu::{FitsSource, Hdu, HduChoice, HduKind};
use crate::fits::header_cards::HeaderCards;
use crate::fits::scan::{self, GZIP, Scanner};

/// The option of the command line that chooses an HDU, for error messages.
pub(crate) const EXTENSION_OPTION: &str = "--extension N|NAME";
const MAGIC: &[u8] = b"SIMPLE  =";
/// The first bytes of files whose compression is not supported, and what to do.
const COMPRESSED: &[(&[u8], &str)] = &[
    (b"BZh", "compressed by bzip2: run bunzip2 first"),
    (b"\x1f\x9d", "compressed by compress: run uncompress first"),
    (b"\xfd7zXZ", "compressed by xz: run unxz first"),
    (b"PK\x03\x04", "a zip archive: run unzip first"),
];

/// The HDUs of a file. Their data are known to be complete.
#[derive(Debug)]
pub(crate) struct FitsStructure {
    pub(crate) path: PathBuf,
    pub(crate) hdus: Vec<Hdu>,
}

impl FitsStructure {
    /// Reads every header and checks that the file is long enough for every HDU. A gzip file is
    /// unpacked to a temporary file. It lives as long as the structure and everything that is
    /// opened through it.
    pub(crate) fn scan(path: &Path) -> Result<Self, IoError> {
        if !is_fits(path)? {
            return Err(IoError::NotFits {
                path: path.to_owned(),
            });
        }
        let is_packed = start_of(path)?.starts_with(GZIP);
        let copy = is_packed.then(|| scan::unpack(path)).transpose()?;
        let source = FitsSource::new(path, copy);
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

    /// The first image with pixels.
    pub(crate) fn first_image(&self) -> Result<&Hdu, IoError> {
        if let Some(hdu) = self.hdus.iter().find(|hdu| hdu.has_pixels()) {
            return Ok(hdu);
        }
        Err(self.missing("image with pixels"))
    }

    /// The first binary table with this name (upper or lower case).
    pub(crate) fn table(&self, name: &str) -> Option<&Hdu> {
        self.tables()
            .find(|hdu| hdu.name().is_some_and(|n| n.eq_ignore_ascii_case(name)))
    }

    /// Works like [`table`](Self::table), but a missing table is an error. `what` describes the
    /// table.
    pub(crate) fn needed_table(&self, name: &str, what: &str) -> Result<&Hdu, IoError> {
        self.table(name).ok_or_else(|| self.missing(what))
    }

    /// The chosen HDU, which `fits` must accept.
    fn chosen(
        &self,
        choice: &HduChoice,
        what: &'static str,
        fits: impl Fn(&Hdu) -> bool,
    ) -> Result<&Hdu, IoError> {
        match self.hdus.iter().find(|hdu| choice.matches(hdu)) {
            Some(hdu) if fits(hdu) => Ok(hdu),
            _ => Err(self.no_such(choice, what, fits)),
        }
    }

    /// The only HDU that `fits` accepts. If there are several, the error says that `option` chooses
    /// one.
    pub(crate) fn only(
        &self,
        what: &'static str,
        option: &'static str,
        fits: impl Fn(&Hdu) -> bool,
    ) -> Result<&Hdu, IoError> {
        let found: Vec<&Hdu> = self.hdus.iter().filter(|hdu| fits(hdu)).collect();
        match found[..] {
            [hdu] => Ok(hdu),
            _ => Err(self.several(what, option, found.into_iter())),
        }
    }

    /// The chosen image with pixels. Without a choice it is the image of the primary HDU, or else
    /// the only image. Among several extensions the science image cannot be told from its mask or
    /// weights, so a choice is required.
    pub(crate) fn image(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        if let Some(choice) = choice {
            return self.chosen(choice, "images with pixels", Hdu::has_pixels);
        }
        match self.first_image()? {
            first if first.index == 0 => Ok(first),
            _ => self.only("images", EXTENSION_OPTION, Hdu::has_pixels),
        }
    }

    /// The HDU whose header describes the frame: an image, which need not have pixels. Without a
    /// choice it is the HDU of [`image`](Self::image). In a file without pixels it is the first HDU
    /// with world coordinates, or else the primary HDU.
    pub(crate) fn header_of_frame(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        let is_image = |hdu: &Hdu| hdu.kind == HduKind::Image;
        if let Some(choice) = choice {
            return self.chosen(choice, "images or headers of images", is_image);
        }
        if self.first_image().is_ok() {
            return self.image(None);
        }
        let describes = |hdu: &&Hdu| is_image(hdu) && hdu.header.get("CTYPE1").is_some();
        Ok(self.hdus.iter().find(describes).unwrap_or(&self.hdus[0]))
    }

    /// The cards of an image that may be copied to another file. An image in an extension inherits
    /// those of an empty primary HDU, unless `INHERIT = F`.
    pub(crate) fn cards(&self, hdu: &Hdu) -> HeaderCards {
        let primary = &self.hdus[0];
        if hdu.index == 0 || primary.has_pixels() || hdu.value("INHERIT") == Some(false) {
            return hdu.header.carried();
        }
        hdu.header.carried().inheriting(&primary.header.carried())
    }

    /// The chosen binary table.
    pub(crate) fn chosen_table(&self, choice: &HduChoice) -> Result<&Hdu, IoError> {
        let mut meant = self.hdus.iter().filter(|hdu| choice.matches(hdu)).take(1);
        match meant.find(|hdu| hdu.is_ascii_table()) {
            Some(hdu) => Err(self.ascii_table(hdu)),
            None => self.chosen(choice, "binary tables", |hdu| hdu.kind == HduKind::BinaryTable),
        }
    }

    /// The error for a file without a binary table.
    pub(crate) fn no_table(&self, needed: &str) -> IoError {
        match self.hdus.iter().find(|hdu| hdu.is_ascii_table()) {
            Some(hdu) => self.ascii_table(hdu),
            None => self.missing(&format!("binary table (columns needed: {needed})")),
        }
    }

    fn ascii_table(&self, hdu: &Hdu) -> IoError {
        let problem = format!(
            "HDU {} is an ASCII table (XTENSION = 'TABLE'), which is not supported: write it as a binary table or as CSV, as astropy's \
             Table.read(FILE).write(OTHER) does",
            hdu.index
        );
        content(&self.path, problem)
    }

    /// The error for a choice that `fits` does not accept.
    pub(crate) fn no_such(
        &self,
        choice: &HduChoice,
        what: &'static str,
        fits: impl Fn(&Hdu) -> bool,
    ) -> IoError {
        let fitting = self.hdus.iter().filter(|hdu| fits(hdu));
        IoError::NoSuchHdu {
            path: self.path.clone(),
            wanted: choice.to_string(),
            what,
            found: fitting.map(Hdu::described).collect(),
        }
    }

    /// The chosen image of PSF stamps. Without a choice it is the only image with pixels.
    pub(crate) fn stamps(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        if choice.is_some() {
            return self.image(choice);
        }
        self.first_image()?;
        self.only("images", "--psf-extension N|NAME", Hdu::has_pixels)
    }

    /// The error for several HDUs, of which `option` must choose one.
    pub(crate) fn several<'a>(
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

    /// All binary tables.
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

/// Returns whether the first bytes are those of a FITS file, which may be compressed by gzip. A
/// file with another compression is an error.
pub(crate) fn is_fits(path: &Path) -> Result<bool, IoError> {
    let start = start_of(path)?;
    if let Some(&(_, problem)) = COMPRESSED.iter().find(|(bytes, _)| start.starts_with(bytes)) {
        return Err(content(path, problem));
    }
    if !start.starts_with(GZIP) {
        return Ok(start == MAGIC);
    }
    if scan::first_bytes(path, MAGIC.len())? == MAGIC {
        return Ok(true);
    }
    Err(content(
        path,
        "a gzip file that does not hold a FITS file: run gunzip first",
    ))
}

/// The first bytes of a file, as many as [`MAGIC`] has.
fn start_of(path: &Path) -> Result<Vec<u8>, IoError> {
    let failed = unreadable(path);
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

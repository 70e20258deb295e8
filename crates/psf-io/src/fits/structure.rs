//! Finds the HDUs of a FITS file and checks them against the length of the file, before any memory
//! is allocated for their data.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::error::{IoError, IoErrorKind, Place, unreadable};
use crate::fits::hdu::{FitsSource, Hdu, HduChoice, HduKind};
use crate::fits::header_cards::HeaderCards;
use crate::fits::scan::{self, GZIP, Scanner};

/// The name of the setting that chooses an image, for errors.
const IMAGE: &str = "hdu";
/// The name of the setting that chooses a table.
pub(crate) const TABLE: &str = "table";
/// The name of the setting that chooses a PSF.
pub(crate) const PSF: &str = "extension";
pub(crate) const NOT_A_FILE: &str = "this is not a regular file";
const MAGIC: &[u8] = b"SIMPLE  =";
/// The first bytes of files whose compression is not supported, and what to do.
const COMPRESSED: &[(&[u8], &str)] = &[
    (b"BZh", "the file is compressed by bzip2: run bunzip2 first"),
    (
        b"\x1f\x9d",
        "the file is compressed by compress: run uncompress first",
    ),
    (b"\xfd7zXZ", "the file is compressed by xz: run unxz first"),
    (b"PK\x03\x04", "the file is a zip archive: run unzip first"),
];

/// The HDUs of a file. Their data are known to be complete.
#[derive(Debug)]
pub(crate) struct FitsStructure {
    pub(crate) path: PathBuf,
    pub(crate) hdus: Vec<Hdu>,
}

impl FitsStructure {
    /// Reads every header and checks that the file is long enough for every HDU. A gzip file is
    /// unpacked to a temporary file. This file is removed when the structure and all readers that
    /// were opened through it are dropped.
    pub(crate) fn scan(path: &Path) -> Result<Self, IoError> {
        if !is_fits(path)? {
            const NOT_FITS: &str = "this is not a FITS file (a FITS file starts with \"SIMPLE  =\")";
            return Err(IoError::new(path, IoErrorKind::Format, NOT_FITS));
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

    /// Works like [`table`](Self::table), but a missing table is an error, in which `what`
    /// describes the table.
    pub(crate) fn needed_table(&self, name: &str, what: &str) -> Result<&Hdu, IoError> {
        self.table(name).ok_or_else(|| self.missing(what))
    }

    /// The chosen HDU, for which `accepts` must be true. In errors, `setting` names the choice, and
    /// `what` describes the accepted HDUs.
    fn chosen(
        &self,
        choice: &HduChoice,
        setting: &'static str,
        what: &str,
        accepts: impl Fn(&Hdu) -> bool,
    ) -> Result<&Hdu, IoError> {
        match self.hdus.iter().find(|hdu| choice.matches(hdu)) {
            Some(hdu) if accepts(hdu) => Ok(hdu),
            _ => Err(self.no_such(choice, setting, what, accepts)),
        }
    }

    /// The only HDU for which `accepts` is true. If there are several, the error describes them by
    /// `what` and says that `setting` chooses one.
    pub(crate) fn only(
        &self,
        what: &str,
        setting: &'static str,
        accepts: impl Fn(&Hdu) -> bool,
    ) -> Result<&Hdu, IoError> {
        let found: Vec<&Hdu> = self.hdus.iter().filter(|hdu| accepts(hdu)).collect();
        match found[..] {
            [hdu] => Ok(hdu),
            _ => Err(self.several(what, setting, found.into_iter())),
        }
    }

    /// The chosen image with pixels. Without a choice it is the image of the primary HDU, or else
    /// the only image. Among several extensions the science image cannot be told from its mask or
    /// weights, so a choice is required.
    pub(crate) fn image(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        if let Some(choice) = choice {
            return self.chosen(choice, IMAGE, "images with pixels", Hdu::has_pixels);
        }
        match self.first_image()? {
            first if first.index == 0 => Ok(first),
            _ => self.only("images", IMAGE, Hdu::has_pixels),
        }
    }

    /// The HDU whose header describes the frame: an image, which need not have pixels. Without a
    /// choice it is the HDU of [`image`](Self::image). In a file without pixels it is the first
    /// image HDU with world coordinates, or else the primary HDU.
    pub(crate) fn header_of_frame(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        let is_image = |hdu: &Hdu| hdu.kind == HduKind::Image;
        if let Some(choice) = choice {
            return self.chosen(choice, IMAGE, "images (with or without pixels)", is_image);
        }
        if self.first_image().is_ok() {
            return self.image(None);
        }
        let describes = |hdu: &&Hdu| is_image(hdu) && hdu.header.get("CTYPE1").is_some();
        Ok(self.hdus.iter().find(describes).unwrap_or(&self.hdus[0]))
    }

    /// The cards of an image, without the cards that must not be copied to another file. An image
    /// in an extension inherits the cards of a primary HDU without pixels, unless `INHERIT = F`.
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
            None => self.chosen(choice, TABLE, "binary tables", |hdu| {
                hdu.kind == HduKind::BinaryTable
            }),
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
        const ASCII: &str = "this is an ASCII table (XTENSION = 'TABLE'), which is not supported: write it as a binary table or \
                             as CSV, for example by astropy's Table.read(FILE).write(OTHER)";
        IoError::new(&self.path, IoErrorKind::Format, ASCII).at(Place::Hdu(hdu.index))
    }

    /// The error for a choice that matches no HDU, or whose HDU `accepts` refuses.
    pub(crate) fn no_such(
        &self,
        choice: &HduChoice,
        setting: &'static str,
        what: &str,
        accepts: impl Fn(&Hdu) -> bool,
    ) -> IoError {
        let found = list(self.hdus.iter().filter(|hdu| accepts(hdu)));
        let message =
            format!("HDU {choice} is none of the {what} in the file. HDUs to choose from: [{found}]");
        IoError::new(&self.path, IoErrorKind::Setting, message).with_setting(setting)
    }

    /// The chosen image of PSF stamps. Without a choice it is the only image with pixels.
    pub(crate) fn stamps(&self, choice: Option<&HduChoice>) -> Result<&Hdu, IoError> {
        if let Some(choice) = choice {
            return self.chosen(choice, PSF, "images with pixels", Hdu::has_pixels);
        }
        self.first_image()?;
        self.only("images", PSF, Hdu::has_pixels)
    }

    /// The error for several HDUs, of which `setting` must choose one.
    pub(crate) fn several<'a>(
        &self,
        what: &str,
        setting: &'static str,
        hdus: impl ExactSizeIterator<Item = &'a Hdu>,
    ) -> IoError {
        let (count, found) = (hdus.len(), list(hdus));
        let message = format!("the file has {count} {what}, in the HDUs {found}: choose one");
        IoError::new(&self.path, IoErrorKind::Setting, message).with_setting(setting)
    }

    /// All binary tables.
    pub(crate) fn tables(&self) -> impl Iterator<Item = &Hdu> {
        self.hdus.iter().filter(|hdu| hdu.kind == HduKind::BinaryTable)
    }

    pub(crate) fn missing(&self, what: &str) -> IoError {
        IoError::new(&self.path, IoErrorKind::Format, format!("the file has no {what}"))
    }
}

/// Number, name and size of each HDU, for error messages.
fn list<'a>(hdus: impl Iterator<Item = &'a Hdu>) -> String {
    hdus.map(Hdu::described).collect::<Vec<_>>().join(", ")
}

/// Returns whether a file starts like a FITS file, which may be compressed by gzip. A file with
/// another compression is an error, and so is a gzip file that holds no FITS file.
pub(crate) fn is_fits(path: &Path) -> Result<bool, IoError> {
    let start = start_of(path)?;
    let format = |problem| Err(IoError::new(path, IoErrorKind::Format, problem));
    if let Some(&(_, problem)) = COMPRESSED.iter().find(|(bytes, _)| start.starts_with(bytes)) {
        return format(problem);
    }
    if !start.starts_with(GZIP) {
        return Ok(start == MAGIC);
    }
    if scan::first_bytes(path, MAGIC.len())? == MAGIC {
        return Ok(true);
    }
    format("this gzip file holds no FITS file, and other files must not be compressed: run gunzip first")
}

/// The first bytes of a file, as many as [`MAGIC`] has.
fn start_of(path: &Path) -> Result<Vec<u8>, IoError> {
    let failed = unreadable(path);
    if !std::fs::metadata(path).map_err(failed)?.is_file() {
        return Err(IoError::new(path, IoErrorKind::Format, NOT_A_FILE));
    }
    let mut start = Vec::with_capacity(MAGIC.len());
    let file = File::open(path).map_err(failed)?;
    file.take(MAGIC.len() as u64)
        .read_to_end(&mut start)
        .map_err(failed)?;
    Ok(start)
}

//! One HDU: what its mandatory keywords say.

use psf_types::{FrameShape, StampGrid};

use crate::error::invalid;
use crate::fits_source::FitsSource;
use crate::scanner::BLOCK;
use crate::tiled::TiledImage;
use crate::{Card, CardValue, HeaderCards, IoError};

/// The most columns of a table (FITS standard 4.0, section 7.3.1).
const MOST_COLUMNS: i64 = 999;

/// What an HDU holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HduKind {
    Image,
    BinaryTable,
    Other,
}

/// An HDU whose mandatory keywords are sound.
#[derive(Debug)]
pub(crate) struct Hdu {
    source: FitsSource,
    /// Counted from 0.
    pub(crate) index: usize,
    pub(crate) kind: HduKind,
    pub(crate) header: HeaderCards,
    pub(crate) bitpix: i64,
    /// `NAXIS1` first; of a compressed image, its own.
    pub(crate) axes: Vec<usize>,
    /// The first byte of the data in the file.
    pub(crate) data_start: u64,
    /// Bytes, without the padding to whole blocks.
    pub(crate) data_length: u64,
}

impl Hdu {
    pub(crate) fn new(source: &FitsSource, index: usize, header: HeaderCards) -> Result<Self, IoError> {
        let mut hdu = Self {
            source: source.clone(),
            index,
            kind: HduKind::Other,
            header,
            bitpix: 8,
            axes: Vec::new(),
            data_start: 0,
            data_length: 0,
        };
        hdu.kind = match (index, hdu.text("XTENSION").as_deref()) {
            (0, _) | (_, Some("IMAGE")) => HduKind::Image,
            (_, Some("BINTABLE")) => HduKind::BinaryTable,
            _ => HduKind::Other,
        };
        hdu.bitpix = hdu.structural("BITPIX", None)?;
        if ![8, 16, 32, 64, -32, -64].contains(&hdu.bitpix) {
            return Err(hdu.header_error("BITPIX", "must be 8, 16, 32, 64, -32 or -64"));
        }
        let axis_count = hdu.structural("NAXIS", None)?;
        if !(0..=999).contains(&axis_count) {
            return Err(hdu.header_error("NAXIS", "must be 0 to 999"));
        }
        for axis in 1..=axis_count {
            let keyword = format!("NAXIS{axis}");
            let length = hdu.structural(&keyword, None)?;
            let length =
                usize::try_from(length).map_err(|_| hdu.header_error(&keyword, "must not be negative"))?;
            hdu.axes.push(length);
        }
        hdu.data_length = hdu
            .checked_length()?
            .ok_or_else(|| hdu.header_error("NAXIS", "the data would be larger than any file"))?;
        // CFITSIO takes memory for so many columns when it passes the HDU, whatever is read.
        if !(0..=MOST_COLUMNS).contains(&hdu.structural("TFIELDS", Some(0))?) {
            return Err(hdu.header_error("TFIELDS", "must be 0 to 999"));
        }
        if hdu.is_tiled() {
            let TiledImage { bitpix, axes } = TiledImage::of(&hdu)?;
            (hdu.kind, hdu.bitpix, hdu.axes) = (HduKind::Image, bitpix, axes);
        }
        Ok(hdu)
    }

    /// Where the file is to be opened.
    pub(crate) fn source(&self) -> &FitsSource {
        &self.source
    }

    /// Whether a binary table holds the tiles of a compressed image; it counts as the image.
    pub(crate) fn is_tiled(&self) -> bool {
        self.index > 0
            && self.logical("ZIMAGE") == Some(true)
            && self.text("XTENSION").as_deref() == Some("BINTABLE")
    }

    /// Bytes of the data with the padding to whole blocks.
    pub(crate) fn padded_length(&self) -> Result<u64, IoError> {
        self.data_length
            .checked_next_multiple_of(BLOCK)
            .ok_or_else(|| self.header_error("NAXIS", "the data would be larger than any file"))
    }

    /// Bytes of the data; `None` where they cannot be counted.
    fn checked_length(&self) -> Result<Option<u64>, IoError> {
        if self.axes.is_empty() {
            return Ok(Some(0));
        }
        let count = |keyword, default| {
            let value = self.structural(keyword, Some(default))?;
            u64::try_from(value).map_err(|_| self.header_error(keyword, "must not be negative"))
        };
        let (parameters, groups) = (count("PCOUNT", 0)?, count("GCOUNT", 1)?);
        // In random groups the first axis has length 0 and does not count.
        let random_groups = self.index == 0 && self.axes[0] == 0 && self.logical("GROUPS") == Some(true);
        // Without a group there would be no data for the pixels that the axes promise.
        if groups == 0 && !random_groups {
            return Err(self.header_error("GCOUNT", "must be above 0"));
        }
        let axes = if random_groups {
            &self.axes[1..]
        } else {
            &self.axes[..]
        };
        Ok(axes
            .iter()
            .try_fold(1_u64, |product, &n| product.checked_mul(n as u64))
            .and_then(|pixels| pixels.checked_add(parameters))
            .and_then(|values| values.checked_mul(groups))
            .and_then(|values| values.checked_mul(self.bitpix.unsigned_abs() / 8)))
    }

    pub(crate) fn header_error(&self, keyword: &str, problem: &'static str) -> IoError {
        IoError::Header {
            path: self.source.path().to_owned(),
            hdu: self.index,
            keyword: keyword.to_owned(),
            problem,
        }
    }

    /// A whole number that the structure rests on.
    pub(crate) fn structural(&self, keyword: &str, default: Option<i64>) -> Result<i64, IoError> {
        match (self.header.get(keyword).map(Card::value), default) {
            (Some(Some(CardValue::Integer(value))), _) => Ok(value),
            (None, Some(default)) => Ok(default),
            (None, None) => Err(self.header_error(keyword, "the keyword is missing")),
            (Some(_), _) => Err(self.header_error(keyword, "must be a whole number")),
        }
    }

    /// Axes in array order, x last.
    pub(crate) fn shape(&self) -> Vec<usize> {
        self.axes.iter().rev().copied().collect()
    }

    pub(crate) fn axes_error(&self, expected: &'static str) -> IoError {
        IoError::Axes {
            path: self.source.path().to_owned(),
            hdu: self.index,
            expected,
            got: self.shape(),
        }
    }

    pub(crate) fn keyword_error(&self, keyword: &'static str, expected: &'static str) -> IoError {
        let card = self.header.get(keyword);
        let got = match card.and_then(Card::value) {
            Some(value) => value.to_string(),
            None => card.map_or_else(String::new, |card| card.to_string().trim_end().to_owned()),
        };
        IoError::Keyword {
            path: self.source.path().to_owned(),
            hdu: self.index,
            keyword,
            expected,
            got,
        }
    }

    fn optional<T>(
        &self,
        keyword: &'static str,
        expected: &'static str,
        convert: impl FnOnce(CardValue) -> Option<T>,
    ) -> Result<Option<T>, IoError> {
        let Some(card) = self.header.get(keyword) else {
            return Ok(None);
        };
        match card.value().and_then(convert) {
            Some(value) => Ok(Some(value)),
            None => Err(self.keyword_error(keyword, expected)),
        }
    }

    pub(crate) fn optional_real(&self, keyword: &'static str) -> Result<Option<f64>, IoError> {
        self.optional(keyword, "a number", |value| match value {
            CardValue::Real(value) => Some(value),
            CardValue::Integer(value) => Some(value as f64),
            _ => None,
        })
    }

    pub(crate) fn required_real(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<f64, IoError> {
        self.optional_real(keyword)?
            .ok_or_else(|| self.missing_keyword(keyword, expected))
    }

    pub(crate) fn optional_logical(&self, keyword: &'static str) -> Result<Option<bool>, IoError> {
        self.optional(keyword, "T or F", |value| match value {
            CardValue::Logical(value) => Some(value),
            _ => None,
        })
    }

    pub(crate) fn optional_integer(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<Option<i64>, IoError> {
        self.optional(keyword, expected, |value| match value {
            CardValue::Integer(value) => Some(value),
            _ => None,
        })
    }

    pub(crate) fn required_integer(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<i64, IoError> {
        self.optional_integer(keyword, expected)?
            .ok_or_else(|| self.missing_keyword(keyword, expected))
    }

    pub(crate) fn optional_text(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<Option<String>, IoError> {
        self.optional(keyword, expected, |value| match value {
            CardValue::Text(value) => Some(value),
            _ => None,
        })
    }

    /// A text keyword that holds one of the forms of a choice.
    pub(crate) fn optional_choice<T: std::str::FromStr<Err = psf_types::DataError>>(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<Option<T>, IoError> {
        self.optional_text(keyword, expected)?
            .map(|text| text.parse().map_err(invalid(self.source.path())))
            .transpose()
    }

    /// The same where there is no default.
    pub(crate) fn required_choice<T: std::str::FromStr<Err = psf_types::DataError>>(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<T, IoError> {
        self.optional_choice(keyword, expected)?
            .ok_or_else(|| self.missing_keyword(keyword, expected))
    }

    pub(crate) fn missing_keyword(&self, keyword: &'static str, expected: &'static str) -> IoError {
        IoError::MissingKeyword {
            path: self.source.path().to_owned(),
            hdu: self.index,
            keyword,
            expected,
        }
    }

    /// The grid of `nx` by `ny` stamps: `OVERSAMP`, `CENX`, `CENY`, `PIXCONV` and `STAMPINT`.
    pub(crate) fn stamp_grid(&self, nx: usize, ny: usize) -> Result<StampGrid, IoError> {
        let data = |result: Result<StampGrid, _>| result.map_err(invalid(self.source.path()));
        let grid = data(StampGrid::new(nx, ny))?;
        let centre_x = self.optional_real("CENX")?.unwrap_or(grid.centre_x());
        let centre_y = self.optional_real("CENY")?.unwrap_or(grid.centre_y());
        let grid = data(grid.with_centre(centre_x, centre_y))?;
        let grid = data(grid.with_oversampling(self.optional_real("OVERSAMP")?.unwrap_or(1.0)))?;
        let interpolation = self.optional_choice("STAMPINT", "cubic-spline or lanczos3")?;
        Ok(grid
            .with_pixel_response_included(self.optional_logical("PIXCONV")?.unwrap_or(true))
            .with_interpolation(interpolation.unwrap_or_default()))
    }

    /// The field: `FIELDNX` and `FIELDNY`, both or none.
    pub(crate) fn field(&self) -> Result<Option<FrameShape>, IoError> {
        const EXPECTED: &str = "the frame's size in pixels, a whole number above 0";
        if ["FIELDNX", "FIELDNY"]
            .iter()
            .all(|keyword| self.header.get(keyword).is_none())
        {
            return Ok(None);
        }
        let count = |keyword| {
            usize::try_from(self.required_integer(keyword, EXPECTED)?)
                .ok()
                .filter(|&n| n > 0)
                .ok_or_else(|| self.keyword_error(keyword, EXPECTED))
        };
        FrameShape::new(count("FIELDNX")?, count("FIELDNY")?)
            .map(Some)
            .map_err(invalid(self.source.path()))
    }
}

/// The cards of a grid and a field, as [`Hdu::stamp_grid`] and [`Hdu::field`] read them.
pub(crate) fn grid_cards(grid: StampGrid, field: Option<FrameShape>) -> Vec<Card> {
    let card = |keyword, value: CardValue, comment| {
        Card::new(keyword, value, comment).expect("sound keywords, finite values")
    };
    let mut cards = vec![
        card(
            "OVERSAMP",
            grid.oversampling().into(),
            "stamp pixels per frame pixel",
        ),
        card(
            "CENX",
            grid.centre_x().into(),
            "stamp index of the PSF reference point, 0-based",
        ),
        card(
            "CENY",
            grid.centre_y().into(),
            "stamp index of the PSF reference point, 0-based",
        ),
        card(
            "PIXCONV",
            grid.pixel_response_included().into(),
            "the pixel response is in the stamps",
        ),
        card(
            "STAMPINT",
            grid.interpolation().to_string().into(),
            "values between the pixels of a stamp",
        ),
    ];
    if let Some(field) = field {
        cards.push(card("FIELDNX", field.nx().into(), "columns of the frame"));
        cards.push(card("FIELDNY", field.ny().into(), "rows of the frame"));
    }
    cards
}

//! An ordered list of header cards.

use std::collections::HashSet;

use crate::fits::card::{Card, FromValue, RECORD, Record, padded};

/// Keywords about the storage of the data. They are not copied, since a new file has its own.
const STRUCTURE: &[&str] = &[
    "SIMPLE", "XTENSION", "BITPIX", "NAXIS", "EXTEND", "NEXTEND", "PCOUNT", "GCOUNT", "GROUPS", "INHERIT",
    "BLOCKED", "BSCALE", "BZERO", "BLANK", "DATAMIN", "DATAMAX", "CHECKSUM", "DATASUM", "LONGSTRN", "END",
    "TFIELDS", "THEAP", "ZIMAGE", "ZCMPTYPE", "ZBITPIX", "ZNAXIS", "ZSIMPLE", "ZTENSION", "ZEXTEND",
    "ZPCOUNT", "ZGCOUNT", "ZBLANK", "ZSCALE", "ZZERO", "ZQUANTIZ", "ZDITHER0", "ZMASKCMP", "ZHECKSUM",
    "ZDATASUM",
];
/// Further keywords about the storage of the data, without the number at their end.
const NUMBERED_STRUCTURE: &[&str] = &[
    "NAXIS", "ZNAXIS", "ZTILE", "ZNAME", "ZVAL", "PTYPE", "PSCAL", "PZERO",
];
/// Keywords about the sections of a raw frame, without the letter of an amplifier at their end. A
/// computed or cut image does not have these sections.
const SECTIONS: &[&str] = &["DATASEC", "TRIMSEC", "BIASSEC", "CCDSEC", "DETSEC", "AMPSEC"];
/// Keywords about the table of a compressed image, without the number at their end.
const NUMBERED_TABLE: &[&str] = &[
    "TTYPE", "TFORM", "TUNIT", "TNULL", "TSCAL", "TZERO", "TDISP", "TDIM",
];
/// The EXTNAME that CFITSIO gives to the table of a compressed image without a name.
pub(crate) const TILED_NAME: &str = "COMPRESSED_IMAGE";
/// Keywords that concern only the HDU in whose header they are. No other HDU inherits them.
const OWN: &[&str] = &["EXTNAME", "EXTVER", "EXTLEVEL", "HDUNAME", "HDUVER", "INHERIT"];
/// Keywords of world coordinates, without the letter of an alternate system.
const WORLD: &[&str] = &["WCSAXES", "WCSNAME", "LONPOLE", "LATPOLE"];
/// The first characters of further keywords of world coordinates. A digit follows.
const NUMBERED_WORLD: &[&str] = &[
    "CTYPE", "CRVAL", "CRPIX", "CDELT", "CUNIT", "CROTA", "CD", "PC", "PV", "PS", "LTV", "LTM", "A_", "B_",
    "AP_", "BP_",
];
/// Comments that CFITSIO writes at the top of every primary header. They are not copied.
const STANDARD_COMMENTS: [&str; 2] = [
    "  FITS (Flexible Image Transport System) format is defined in 'Astronomy",
    "  and Astrophysics', volume 376, page 359; bibcode: 2001A&A...376..359H",
];

/// The cards of a FITS header, in order. They may be copied from an input to an output.
///
/// Headers returned by [`read_image`](crate::read_image) lack the cards about the structure of the
/// input file (SIMPLE, BITPIX, NAXISn, BSCALE, CHECKSUM ...). The output has its own. They also
/// lack the cards about the sections of a raw frame (DATASEC, TRIMSEC ...).
///
/// ```
/// use psf_io::{Card, HeaderCards};
/// let mut header = HeaderCards::new();
/// header.push(Card::new("CRPIX1", 512.5, "")?);
/// header.set(Card::new("TELESCOP", "Roman", "")?);
/// let cut = header.shifted_origin(100.0, 0.0);
/// assert_eq!(cut.get("CRPIX1").and_then(Card::value), Some(412.5.into()));
/// # Ok::<(), psf_io::CardError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct HeaderCards {
    cards: Vec<Card>,
}

impl HeaderCards {
    /// Creates a list without cards.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes a list from the records of a header without its END. A CONTINUE record is added to the
    /// card before it, if the string of this card ends in `&`. Blank records at the end are
    /// dropped.
    pub(crate) fn from_records(records: impl IntoIterator<Item = Record>) -> Self {
        let mut cards: Vec<Card> = Vec::new();
        for record in records {
            match cards.last_mut() {
                Some(card) if record.starts_with(b"CONTINUE  ") && card.takes_continuation() => {
                    card.push_continuation(record);
                }
                _ => cards.push(Card::from_record(record)),
            }
        }
        while cards
            .last()
            .is_some_and(|card| card.records().iter().all(|r| r.trim_ascii().is_empty()))
        {
            cards.pop();
        }
        Self { cards }
    }

    /// Reads the records of a header, 80 characters each, one after the other and without the END.
    /// Characters that are not ASCII become `?`.
    ///
    /// ```
    /// let text = format!("{:<80}{:<80}", "CRPIX1  = 3.0", "CRPIX2  = 5.0");
    /// let header = psf_io::HeaderCards::from_text(&text);
    /// assert_eq!((header.len(), header.to_text()), (2, text));
    /// ```
    pub fn from_text(text: &str) -> Self {
        let ascii: Vec<u8> = text
            .chars()
            .map(|c| u8::try_from(c).ok().filter(u8::is_ascii).unwrap_or(b'?'))
            .collect();
        Self::from_records(ascii.chunks(RECORD).map(padded))
    }

    /// The records of all cards, 80 characters each, one after the other.
    pub fn to_text(&self) -> String {
        let records = self.cards.iter().flat_map(Card::records);
        records.map(|record| String::from_utf8_lossy(record)).collect()
    }

    /// Iterates over the cards in order.
    pub fn iter(&self) -> std::slice::Iter<'_, Card> {
        self.cards.iter()
    }

    /// Number of cards.
    pub fn len(&self) -> usize {
        self.cards.len()
    }

    /// Returns whether there are no cards.
    pub fn is_empty(&self) -> bool {
        self.cards.is_empty()
    }

    /// The first card with this keyword (upper case, at most 8 characters).
    pub fn get(&self, keyword: &str) -> Option<&Card> {
        self.cards.iter().find(|card| card.has_keyword(keyword))
    }

    /// The number of the first card with this keyword, whole or not. `None` for another type.
    pub fn number(&self, keyword: &str) -> Option<f64> {
        self.value(keyword)
    }

    /// The text of the first card with this keyword. `None` for another type.
    pub fn text(&self, keyword: &str) -> Option<String> {
        self.value(keyword)
    }

    /// The unit of the pixels (`BUNIT`), if it is stated.
    pub fn pixel_unit(&self) -> Option<String> {
        self.text("BUNIT").filter(|unit| !unit.trim().is_empty())
    }

    /// The value of the first card with this keyword, if it has this type.
    pub(crate) fn value<T: FromValue>(&self, keyword: &str) -> Option<T> {
        T::from_value(self.get(keyword)?.value()?)
    }

    /// Adds a card at the end.
    pub fn push(&mut self, card: Card) {
        self.cards.push(card);
    }

    /// Replaces the cards with the keyword of `card`, or appends `card` if there are none. Text
    /// cards (HISTORY, COMMENT) are always appended.
    pub fn set(&mut self, card: Card) {
        if card.is_commentary() {
            return self.cards.push(card);
        }
        let keyword = card.keyword();
        let place = self.cards.iter().position(|c| c.keyword() == keyword);
        self.remove(&keyword);
        match place {
            Some(place) => self.cards.insert(place, card),
            None => self.cards.push(card),
        }
    }

    /// Removes all cards with this keyword.
    pub fn remove(&mut self, keyword: &str) {
        self.cards.retain(|card| card.keyword() != keyword);
    }

    /// The cards for a cut image. Its first pixel is pixel (`x0`, `y0`), 0-based, of the image that
    /// these cards describe. It may lie between pixels, as for a telescope that points elsewhere.
    ///
    /// The reference pixels of the world coordinates become `CRPIX1 - x0` and `CRPIX2 - y0`, also
    /// in alternate systems (`CRPIX1A` ...). If a world coordinate has no CRPIX, the default
    /// 0 of FITS is shifted and added as a card. IRAF's `LTV1` and `LTV2` are shifted in the same
    /// way, if present. A card whose value is not a number is kept as it is.
    #[must_use]
    pub fn shifted_origin(&self, x0: f64, y0: f64) -> Self {
        let mut shifted = self.clone();
        for (axis, by) in [(1, x0), (2, y0)].into_iter().filter(|&(_, by)| by != 0.0) {
            shifted.change(&format!("LTV{axis}"), |value| value - by);
            for version in world_versions() {
                shifted.move_reference(&format!("{axis}{version}"), |pixel| pixel - by);
            }
        }
        shifted
    }

    /// Returns whether there are world coordinates along an axis, such as `1` or `1A`.
    fn has_world(&self, axis: &str) -> bool {
        let has = |stem: &str| self.get(&format!("{stem}{axis}")).is_some();
        has("CRVAL") || has("CTYPE")
    }

    /// Applies `moved` to the reference pixel along an axis of world coordinates. If it has no CRPIX, the
    /// default 0 of FITS is moved and added as a card.
    fn move_reference(&mut self, axis: &str, moved: impl Fn(f64) -> f64) {
        let keyword = format!("CRPIX{axis}");
        if self.get(&keyword).is_some() {
            self.change(&keyword, moved);
        } else if self.has_world(axis) {
            self.push(Card::new(&keyword, moved(0.0), "reference pixel").expect("a valid card"));
        }
    }

    /// Applies `changed` to the number in each card with this keyword, and keeps the comment of the
    /// card.
    fn change(&mut self, keyword: &str, changed: impl Fn(f64) -> f64) {
        for card in self.cards.iter_mut().filter(|card| card.has_keyword(keyword)) {
            if let Some(value) = card.value().and_then(f64::from_value)
                && let Ok(moved) = Card::new(keyword, changed(value), &card.comment_text())
            {
                *card = moved;
            }
        }
    }

    /// The cards that may be copied to a file of another structure. A card whose keyword FITS does
    /// not allow becomes a COMMENT.
    pub(crate) fn carried(&self) -> Self {
        let tiled = self.get("ZIMAGE").is_some();
        let of_table = |card: &Card, numbered: &dyn Fn(&str) -> bool| {
            tiled
                && (NUMBERED_TABLE.iter().any(|stem| numbered(stem))
                    || (card.has_keyword("EXTNAME") && card.value() == Some(TILED_NAME.into())))
        };
        let kept = |card: &&Card| {
            let keyword = card.keyword();
            let numbered = |stem: &str| {
                keyword
                    .strip_prefix(stem)
                    .is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
            };
            let standard = keyword == "COMMENT" && STANDARD_COMMENTS.contains(&card.comment_text().as_str());
            !standard
                && !STRUCTURE.contains(&keyword.as_str())
                && !SECTIONS.iter().any(|stem| {
                    let rest = keyword.strip_prefix(stem);
                    rest.is_some_and(|letter| letter.len() <= 1)
                })
                && !NUMBERED_STRUCTURE.iter().any(|stem| numbered(stem))
                && !of_table(card, &numbered)
        };
        let legal = |card: &Card| {
            if card.is_foreign() {
                Card::comment(card.to_string().trim_end())
            } else {
                card.clone()
            }
        };
        Self {
            cards: self.cards.iter().filter(kept).map(legal).collect(),
        }
    }

    /// The cards of an extension together with those that it inherits from its primary header (the
    /// convention of `INHERIT = T`). The inherited cards are listed first. A card of the primary
    /// header is not inherited if the extension has a card with this keyword. Text cards and cards
    /// that concern only one HDU, such as EXTNAME, are not inherited. World coordinates are not
    /// inherited if the extension has its own.
    pub(crate) fn inheriting(&self, primary: &Self) -> Self {
        let own: HashSet<String> = self.cards.iter().map(Card::keyword).collect();
        let has_world = own.iter().any(|keyword| keyword.starts_with("CTYPE"));
        let inherited = |card: &&Card| {
            let keyword = card.keyword();
            let stays = card.is_commentary()
                || own.contains(&keyword)
                || OWN.contains(&keyword.as_str())
                || (has_world && is_world(&keyword));
            !stays
        };
        let inherited = primary.cards.iter().filter(inherited);
        Self {
            cards: inherited.chain(&self.cards).cloned().collect(),
        }
    }

    /// Adds cards to a copy of this list, each in the way of [`set`](Self::set). Then removes the
    /// cards about the structure of a file from the copy.
    pub(crate) fn with(&self, added: &[Card]) -> Self {
        let mut all = self.clone();
        added.iter().cloned().for_each(|card| all.set(card));
        all.carried()
    }
}

/// The suffixes of world coordinate keywords: none for the primary system, `A` to `Z` for alternate
/// systems.
fn world_versions() -> impl Iterator<Item = String> {
    std::iter::once(String::new()).chain(('A'..='Z').map(String::from))
}

/// Returns whether a keyword belongs to world coordinates.
fn is_world(keyword: &str) -> bool {
    // The suffix may be the letter of an alternate system.
    WORLD
        .iter()
        .any(|word| keyword.strip_prefix(word).is_some_and(|rest| rest.len() <= 1))
        || NUMBERED_WORLD.iter().any(|stem| {
            keyword
                .strip_prefix(stem)
                .is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()))
        })
}

impl<'a> IntoIterator for &'a HeaderCards {
    type Item = &'a Card;
    type IntoIter = std::slice::Iter<'a, Card>;
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl FromIterator<Card> for HeaderCards {
    fn from_iter<I: IntoIterator<Item = Card>>(cards: I) -> Self {
        Self {
            cards: cards.into_iter().collect(),
        }
    }
}

impl HeaderCards {
    /// The cards for a binned image. Each of its pixels covers `factor` by `factor` pixels of the
    /// image that these cards describe, from the first pixel on. `factor` must be above 0.
    ///
    /// A pixel coordinate `p` (1-based) becomes `(p - 1/2) / factor + 1/2`, which changes the
    /// reference pixels. Steps in the world (`CDELTi`, `CDi_j`) are multiplied by `factor`. SIP
    /// distortions (`A_p_q`, `B_p_q`, `AP_p_q`, `BP_p_q`), which are polynomials in pixels, are
    /// multiplied by `factor^(p+q-1)`. Alternate systems change in the same way. If a world
    /// coordinate has no step or no reference pixel, the default of FITS (1 or 0) is converted and
    /// added as a card. IRAF's `LTVi` and `LTMi_i` change accordingly.
    ///
    /// ```
    /// use psf_io::{Card, HeaderCards};
    /// let mut header = HeaderCards::new();
    /// header.push(Card::new("CRPIX1", 512.5, "")?);
    /// header.push(Card::new("CD1_1", -1e-5, "")?);
    /// let binned = header.binned(4);
    /// assert_eq!(binned.get("CRPIX1").and_then(Card::value), Some(128.5.into()));
    /// assert_eq!(binned.get("CD1_1").and_then(Card::value), Some((-4e-5).into()));
    /// # Ok::<(), psf_io::CardError>(())
    /// ```
    #[must_use]
    pub fn binned(&self, factor: usize) -> Self {
        let mut binned = self.clone();
        if factor == 1 {
            return binned;
        }
        let s = factor as f64;
        let pixel = |p: f64| (p - 0.5) / s + 0.5;
        for axis in [1, 2] {
            binned.change(&format!("LTV{axis}"), pixel);
            binned.change(&format!("LTM{axis}_{axis}"), |v| v / s);
            for version in world_versions() {
                let along = format!("{axis}{version}");
                let steps: Vec<String> = (1..=9)
                    .flat_map(|i| matrix_keywords("CD", i, axis))
                    .chain([format!("CDELT{axis}")])
                    .map(|keyword| format!("{keyword}{version}"))
                    .collect();
                let has_step = steps.iter().any(|keyword| binned.get(keyword).is_some());
                binned.move_reference(&along, pixel);
                for keyword in &steps {
                    binned.change(keyword, |v| v * s);
                }
                if !has_step && binned.has_world(&along) {
                    let step = Card::new(&format!("CDELT{along}"), s, "step");
                    binned.push(step.expect("a valid card"));
                }
            }
        }
        let distortions: Vec<(String, i32)> = self
            .iter()
            .filter_map(|card| Some((card.keyword(), sip_degree(&card.keyword())?)))
            .collect();
        for (keyword, degree) in distortions {
            binned.change(&keyword, |v| v * s.powi(degree - 1));
        }
        binned
    }
}

/// The spellings of the keyword of a matrix element: `PC1_2`, and in old headers `PC01_02` and
/// `PC001002`. Wcslib reads all of them.
pub(crate) fn matrix_keywords(stem: &str, row: usize, column: usize) -> [String; 3] {
    [
        format!("{stem}{row}_{column}"),
        format!("{stem}{row:02}_{column:02}"),
        format!("{stem}{row:03}{column:03}"),
    ]
}

/// `p + q` of a SIP coefficient `A_p_q`, `B_p_q`, `AP_p_q` or `BP_p_q`.
pub(crate) fn sip_degree(keyword: &str) -> Option<i32> {
    let rest = ["AP_", "BP_", "A_", "B_"]
        .iter()
        .find_map(|stem| keyword.strip_prefix(stem))?;
    let (p, q) = rest.split_once('_')?;
    Some(p.parse::<u8>().ok().map(i32::from)? + q.parse::<u8>().ok().map(i32::from)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(lines: &[&str]) -> HeaderCards {
        HeaderCards::from_records(
            lines
                .iter()
                .map(|line| crate::fits::card::padded(line.as_bytes())),
        )
    }

    #[test]
    fn cards_about_structure_are_not_copied() {
        let carried = header(&[
            "SIMPLE  =                    T",
            "NAXIS   =                    2",
            "NAXIS1  =                   12",
            "BZERO   =                32768",
            "COMMENT   FITS (Flexible Image Transport System) format is defined in 'Astronomy",
            "COMMENT mine",
            "NAXISA  =                    1",
            "ZTILE1  =                    1",
            "Date.obs= '2026-01-01'",
            "LONG    = 'one &'",
            "CONTINUE  'two' / here",
            "",
            "",
        ])
        .carried();
        let texts: Vec<String> = carried
            .iter()
            .map(|c| c.to_string().trim_end().to_owned())
            .collect();
        assert_eq!(
            texts[..3],
            [
                "COMMENT mine",
                "NAXISA  =                    1",
                "COMMENT Date.obs= '2026-01-01'"
            ]
        );
        assert_eq!(carried.len(), 4);
        assert_eq!(carried.get("LONG").and_then(Card::value), Some("one two".into()));
    }

    #[test]
    fn the_origin_moves_in_every_coordinate_system() {
        let wcs = header(&[
            "CRPIX1  =                  512 / reference",
            "CRPIX2  =              1.5D+02",
            "CRPIX1A =                  1.0",
            "CTYPE2A = 'LINEAR'",
            "CRPIX1B = 'nonsense'",
            "CRPIX3  =                  9.0",
            "LTV1    =                 -3.0",
        ]);
        let cut = wcs.shifted_origin(10.0, -5.0);
        let value = |keyword: &str| cut.get(keyword).and_then(Card::value).unwrap();
        assert_eq!(value("CRPIX1"), 502.0.into());
        assert_eq!(cut.get("CRPIX1").unwrap().comment_text(), "reference");
        assert_eq!(value("CRPIX2"), 155.0.into());
        assert_eq!(value("CRPIX1A"), (-9.0).into());
        assert_eq!(value("CRPIX2A"), 5.0.into());
        assert_eq!(value("CRPIX1B"), "nonsense".into());
        assert_eq!(value("CRPIX3"), 9.0.into());
        assert_eq!(value("LTV1"), (-13.0).into());
        assert!(cut.get("LTV2").is_none());
        assert_eq!(wcs.shifted_origin(0.0, 0.0), wcs);
    }

    #[test]
    fn cards_about_the_table_of_a_compressed_image_are_not_copied() {
        let lines = [
            "TTYPE1  = 'COMPRESSED_DATA'",
            "TFORM1  = '1PB(7)  '",
            "EXTNAME = 'COMPRESSED_IMAGE'",
            "TELESCOP= 'here    '",
        ];
        let keywords = |cards: HeaderCards| cards.carried().iter().map(Card::keyword).collect::<Vec<_>>();
        assert_eq!(keywords(header(&lines)).len(), 4);
        let tiled = [
            &lines[..],
            &["ZIMAGE  =                    T", "ZNAME1  = 'BLOCKSIZE'"],
        ]
        .concat();
        assert_eq!(keywords(header(&tiled)), ["TELESCOP"]);
    }

    #[test]
    fn extensions_inherit_cards_about_the_exposure() {
        let primary = header(&[
            "SIMPLE  =                    T",
            "EXPTIME =                 30.0",
            "FILTER  = 'r       '",
            "EXTNAME = 'PRIMARY '",
            "CRVAL1  =                  1.0",
            "RADESYS = 'ICRS    '",
            "HISTORY of the primary",
        ]);
        let extension = header(&["FILTER  = 'i       '", "HISTORY own", "CTYPE1  = 'RA---TAN'"]);
        let keywords = |cards: &HeaderCards| cards.carried().iter().map(Card::keyword).collect::<Vec<_>>();
        let both = extension.inheriting(&primary);
        assert_eq!(
            keywords(&both),
            ["EXPTIME", "RADESYS", "FILTER", "HISTORY", "CTYPE1"]
        );
        assert_eq!(
            both.get("FILTER").and_then(Card::value),
            Some("i       ".trim_end().into())
        );
        let without = header(&["FILTER  = 'i       '"]).inheriting(&primary);
        assert_eq!(keywords(&without), ["EXPTIME", "CRVAL1", "RADESYS", "FILTER"]);
        for (keyword, world) in [
            ("CD1_2", true),
            ("WCSNAMEA", true),
            ("A_0_2", true),
            ("PVERSION", false),
            ("CDELT2B", true),
            ("CDS", false),
        ] {
            assert_eq!(is_world(keyword), world, "{keyword}");
        }
    }

    #[test]
    fn a_card_replaces_the_cards_with_its_keyword() {
        let mut cards = header(&[
            "A       =                    1",
            "B       =                    2",
            "A       =                    3",
        ]);
        cards.set(Card::new("A", 4, "").unwrap());
        cards.set(Card::history("done"));
        cards.set(Card::history("done"));
        let keywords: Vec<String> = cards.iter().map(Card::keyword).collect();
        assert_eq!(keywords, ["A", "B", "HISTORY", "HISTORY"]);
        assert_eq!(cards.get("A").and_then(Card::value), Some(4.into()));
    }

    #[test]
    fn pixels_steps_and_distortions_scale() {
        let mut header = HeaderCards::new();
        for (keyword, value) in [
            ("CRPIX1", 0.5),
            ("CRVAL1", 10.0),
            ("CDELT1", 2.0),
            ("CRVAL2", 20.0),
            ("A_2_0", 1e-5),
            ("B_0_1", 3.0),
            ("AP_1_2", 1.0),
            ("A_ORDER", 2.0),
            ("CD1_2B", 0.5),
        ] {
            header.push(Card::new(keyword, value, "").unwrap());
        }
        let binned = header.binned(2);
        for (keyword, value) in [
            ("CRPIX1", 0.5),
            ("CDELT1", 4.0),
            ("CRPIX2", 0.25),
            ("CDELT2", 2.0),
            ("A_2_0", 2e-5),
            ("B_0_1", 3.0),
            ("AP_1_2", 4.0),
            ("A_ORDER", 2.0),
            ("CD1_2B", 1.0),
            ("CRVAL1", 10.0),
        ] {
            assert_eq!(binned.value(keyword), Some(value), "{keyword}");
        }
        assert_eq!(header.binned(1), header);
    }
}

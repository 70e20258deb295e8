//! The cards of a header, in order.

mod binned;
use std::collections::HashSet;

use crate::card::Record;
use crate::{Card, CardValue};

/// Keywords that say how the data are stored, not what they are: a new file has its own.
const STRUCTURE: &[&str] = &[
    "SIMPLE", "XTENSION", "BITPIX", "NAXIS", "EXTEND", "NEXTEND", "PCOUNT", "GCOUNT", "GROUPS", "INHERIT",
    "BLOCKED", "BSCALE", "BZERO", "BLANK", "DATAMIN", "DATAMAX", "CHECKSUM", "DATASUM", "LONGSTRN", "END",
    "TFIELDS", "THEAP", "ZIMAGE", "ZCMPTYPE", "ZBITPIX", "ZNAXIS", "ZSIMPLE", "ZTENSION", "ZEXTEND",
    "ZPCOUNT", "ZGCOUNT", "ZBLANK", "ZSCALE", "ZZERO", "ZQUANTIZ", "ZDITHER0", "ZMASKCMP", "ZHECKSUM",
    "ZDATASUM",
];
/// The same with a number after them.
const NUMBERED_STRUCTURE: &[&str] = &[
    "NAXIS", "ZNAXIS", "ZTILE", "ZNAME", "ZVAL", "PTYPE", "PSCAL", "PZERO",
];
/// Keywords of the table of a compressed image, with a number after them.
const NUMBERED_TABLE: &[&str] = &[
    "TTYPE", "TFORM", "TUNIT", "TNULL", "TSCAL", "TZERO", "TDISP", "TDIM",
];
/// The name that the table of a compressed image gets when the image has none.
pub(crate) const TILED_NAME: &str = "COMPRESSED_IMAGE";
/// What names or numbers one HDU and is of no meaning for another.
const OWN: &[&str] = &["EXTNAME", "EXTVER", "EXTLEVEL", "HDUNAME", "HDUVER", "INHERIT"];
/// World coordinates: keywords, and stems that a number follows.
const WORLD: &[&str] = &["WCSAXES", "WCSNAME", "LONPOLE", "LATPOLE"];
const NUMBERED_WORLD: &[&str] = &[
    "CTYPE", "CRVAL", "CRPIX", "CDELT", "CUNIT", "CROTA", "CD", "PC", "PV", "PS", "LTV", "LTM", "A_", "B_",
    "AP_", "BP_",
];
/// What CFITSIO writes at the top of every primary header.
const STANDARD_COMMENTS: [&str; 2] = [
    "  FITS (Flexible Image Transport System) format is defined in 'Astronomy",
    "  and Astrophysics', volume 376, page 359; bibcode: 2001A&A...376..359H",
];

/// The cards of a FITS header, in order, as they pass from an input to an output.
///
/// What [`read_image`](crate::read_image) returns has no cards about the structure of the input file (SIMPLE, BITPIX,
/// NAXISn, BSCALE, CHECKSUM ...): those of the output are its own.
///
/// ```
/// use psf_io::{Card, HeaderCards};
/// let mut header = HeaderCards::new();
/// header.push(Card::new("CRPIX1", 512.5, "")?);
/// header.set(Card::new("TELESCOP", "Roman", "")?);
/// let cut = header.shifted_origin(100, 0);
/// assert_eq!(cut.get("CRPIX1").and_then(Card::value), Some(412.5.into()));
/// # Ok::<(), psf_io::CardError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct HeaderCards {
    cards: Vec<Card>,
}

impl HeaderCards {
    /// No cards.
    pub fn new() -> Self {
        Self::default()
    }

    /// The cards of a header without its END; CONTINUE records join the card they belong to.
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

    /// The cards in order.
    pub fn iter(&self) -> std::slice::Iter<'_, Card> {
        self.cards.iter()
    }

    /// Number of cards.
    pub fn len(&self) -> usize {
        self.cards.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.cards.is_empty()
    }

    /// The first card with this keyword (upper case, at most 8 characters).
    pub fn get(&self, keyword: &str) -> Option<&Card> {
        self.cards.iter().find(|card| card.has_keyword(keyword))
    }

    /// Adds a card at the end.
    pub fn push(&mut self, card: Card) {
        self.cards.push(card);
    }

    /// Puts a card in the place of those with its keyword, or at the end; text cards (HISTORY, COMMENT) are always added.
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

    /// The cards for an image whose first pixel is the pixel (`x0`, `y0`), 0-based, of this one.
    ///
    /// The reference pixels of the world coordinates move along, `CRPIX1 - x0` and `CRPIX2 - y0`, those of the alternate
    /// systems (`CRPIX1A` ...) too; where a world coordinate has no CRPIX, it stands for 0 and is added. So do IRAF's
    /// `LTV1` and `LTV2`. Keywords whose value is not a number stay as they are.
    #[must_use]
    pub fn shifted_origin(&self, x0: i64, y0: i64) -> Self {
        let mut shifted = self.clone();
        for (axis, by) in [(1, x0), (2, y0)].into_iter().filter(|&(_, by)| by != 0) {
            shifted.add_to(&format!("LTV{axis}"), -(by as f64));
            for version in std::iter::once(String::new()).chain(('A'..='Z').map(String::from)) {
                let keyword = format!("CRPIX{axis}{version}");
                let has = |name: &str| shifted.get(&format!("{name}{axis}{version}")).is_some();
                if shifted.get(&keyword).is_some() {
                    shifted.add_to(&keyword, -(by as f64));
                } else if has("CRVAL") || has("CTYPE") {
                    shifted
                        .cards
                        .push(Card::new(&keyword, -(by as f64), "reference pixel").expect("a keyword"));
                }
            }
        }
        shifted
    }

    fn add_to(&mut self, keyword: &str, difference: f64) {
        self.change(keyword, |value| value + difference);
    }

    /// Changes every number under a keyword; its comment stays.
    fn change(&mut self, keyword: &str, changed: impl Fn(f64) -> f64) {
        for card in self.cards.iter_mut().filter(|card| card.has_keyword(keyword)) {
            let value = match card.value() {
                Some(CardValue::Real(value)) => value,
                Some(CardValue::Integer(value)) => value as f64,
                _ => continue,
            };
            if let Ok(moved) = Card::new(keyword, changed(value), &card.comment_text()) {
                *card = moved;
            }
        }
    }

    /// The cards that go over to a file of another structure. A card whose keyword FITS does not allow becomes a comment.
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

    /// The cards of an extension that also inherits those of its primary header (the convention of `INHERIT = T`): the primary's come
    /// first, but for those that the extension has too, texts, names of HDUs, and, where the extension has world coordinates of
    /// its own, the primary's.
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

    /// These cards and others, each of which takes the place of those with its keyword; none about structure.
    pub(crate) fn with(&self, added: &[Card]) -> Self {
        let mut all = self.clone();
        added.iter().cloned().for_each(|card| all.set(card));
        all.carried()
    }
}

/// Whether a keyword is of world coordinates.
fn is_world(keyword: &str) -> bool {
    // A letter may name an alternate system.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn header(lines: &[&str]) -> HeaderCards {
        HeaderCards::from_records(lines.iter().map(|line| crate::card_text::padded(line.as_bytes())))
    }

    #[test]
    fn structure_stays_behind_and_the_rest_goes_over() {
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
        let cut = wcs.shifted_origin(10, -5);
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
        assert_eq!(wcs.shifted_origin(0, 0), wcs);
    }

    #[test]
    fn the_table_of_a_compressed_image_stays_behind() {
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
    fn extensions_inherit_what_describes_the_exposure() {
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
    fn a_card_replaces_its_namesakes() {
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
}

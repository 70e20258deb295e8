//! Headers of images with larger pixels.

use super::HeaderCards;
use crate::Card;

impl HeaderCards {
    /// The cards for an image each of whose pixels covers `factor` by `factor` pixels of this one, from its first on.
    ///
    /// A pixel coordinate `p` (1-based) becomes `(p - 1/2) / factor + 1/2`: reference pixels move along, steps in the world
    /// (`CDELTi`, `CDi_j`) grow by the factor, and SIP distortions (`A_p_q` and their kin), which are polynomials in pixels, by
    /// `factor^(p + q - 1)`; alternate systems too. A world coordinate without a step has one of 1, which is added. So do IRAF's `LTVi`
    /// and `LTMi_i`.
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
            for version in std::iter::once(String::new()).chain(('A'..='Z').map(String::from)) {
                let keyword = |stem: &str| format!("{stem}{axis}{version}");
                let has = |name: &str| binned.get(&keyword(name)).is_some();
                let in_world = has("CRVAL") || has("CTYPE");
                let missing_pixel = in_world && !has("CRPIX");
                let matrix = (1..=9).any(|i| binned.get(&format!("CD{i}_{axis}{version}")).is_some());
                let missing_step = in_world && !has("CDELT") && !matrix;
                binned.change(&keyword("CRPIX"), pixel);
                binned.change(&keyword("CDELT"), |v| v * s);
                for i in 1..=9 {
                    binned.change(&format!("CD{i}_{axis}{version}"), |v| v * s);
                }
                if missing_pixel {
                    binned.push(
                        Card::new(&keyword("CRPIX"), pixel(0.0), "reference pixel").expect("a keyword"),
                    );
                }
                if missing_step {
                    binned.push(Card::new(&keyword("CDELT"), s, "step").expect("a keyword"));
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

/// `p + q` of a SIP coefficient `A_p_q`, `B_p_q`, `AP_p_q` or `BP_p_q`.
fn sip_degree(keyword: &str) -> Option<i32> {
    let rest = ["AP_", "BP_", "A_", "B_"]
        .iter()
        .find_map(|stem| keyword.strip_prefix(stem))?;
    let (p, q) = rest.split_once('_')?;
    Some(p.parse::<u8>().ok().map(i32::from)? + q.parse::<u8>().ok().map(i32::from)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(header: &HeaderCards, keyword: &str) -> Option<f64> {
        match header.get(keyword)?.value()? {
            crate::CardValue::Real(v) => Some(v),
            crate::CardValue::Integer(v) => Some(v as f64),
            _ => None,
        }
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
            assert_eq!(number(&binned, keyword), Some(value), "{keyword}");
        }
        assert_eq!(header.binned(1), header);
    }
}

//! The polynomial of a PSFEx file in its contexts: the position, and perhaps other quantities, whose values
//! the user chooses.

use std::path::Path;

use ndarray::{Array3, Axis};

use super::{LONGEST_FRAME, PsfexAxis, PsfexPolynomial};
use crate::error::{IoError, IoErrorKind, invalid};
use crate::fits::hdu::Hdu;

/// The part of a coordinate's name between its letter and `_IMAGE`. It names the method by which
/// SExtractor measures the position.
const POSITION_KINDS: [&str; 5] = ["", "WIN", "PSF", "PEAK", "MODEL"];
/// The most contexts and groups, as in PSFEx.
const MOST: usize = 10;
/// The most terms of a polynomial.
const MOST_TERMS: usize = 10_000;
/// The scale of a coordinate on which the PSF does not depend: no frame is so long.
const ABSENT: f64 = 4.0 * LONGEST_FRAME;

/// The contexts of a polynomial. Each belongs to a group. The sum of the exponents of a group is at most
/// the degree of the group.
#[derive(Debug, Default)]
pub(super) struct Contexts {
    all: Vec<Context>,
    degrees: Vec<usize>,
    /// The coordinates of the position, each with the index of its context.
    x: Option<(usize, PsfexAxis)>,
    y: Option<(usize, PsfexAxis)>,
}

#[derive(Debug)]
struct Context {
    /// Counted from 0.
    group: usize,
    /// The scaled value of another quantity. 1 for a coordinate of the position.
    value: f64,
}

impl Contexts {
    /// Reads the contexts. A polynomial of degree 0 needs no names. `values`
    /// gives the contexts other than the position their values, by name.
    pub(super) fn read(path: &Path, hdu: &Hdu, values: &[(String, f64)]) -> Result<Self, IoError> {
        const COUNT: &str = "the number of contexts on which the PSF depends, 0 (a constant PSF) to 10";
        const DEGREE: &str = "the degree of the polynomial, 0 to 10";
        const GROUPS: &str = "the number of groups of contexts, from 1 to the number of contexts";
        const GROUP: &str = "the number of the context's group, from 1 to POLNGRP";
        let named = (1..=MOST).take_while(|i| hdu.header.get(&format!("POLNAME{i}")).is_some());
        let number = |keyword: &str, expected, range: std::ops::RangeInclusive<usize>| {
            let given = hdu.optional::<i64>(keyword, expected)?;
            let in_range = |n: i64| usize::try_from(n).ok().filter(|n| range.contains(n));
            let checked = |n| in_range(n).ok_or_else(|| hdu.keyword_error(keyword, expected));
            given.map(checked).transpose()
        };
        let named = named.count();
        let count = number("POLNAXIS", COUNT, 0..=MOST)?.unwrap_or(named);
        let without_names =
            named == 0 && number("POLDEG1", DEGREE, 0..=PsfexPolynomial::MAX_DEGREE)?.unwrap_or(0) == 0;
        if count == 0 || without_names {
            check_names(path, &[], values)?;
            return Ok(Self::default());
        }
        let groups = number("POLNGRP", GROUPS, 1..=count)?.unwrap_or(1);
        let degrees = (1..=groups).map(|group| {
            let keyword = format!("POLDEG{group}");
            let degree = number(&keyword, DEGREE, 0..=PsfexPolynomial::MAX_DEGREE)?;
            degree.ok_or_else(|| hdu.missing_keyword(&keyword, DEGREE))
        });
        let mut contexts = Self {
            degrees: degrees.collect::<Result<_, _>>()?,
            ..Self::default()
        };
        let mut others = Vec::new();
        for i in 1..=count {
            let group = number(&format!("POLGRP{i}"), GROUP, 1..=groups)?.unwrap_or(1) - 1;
            let (name, zero, scale) = scaled(hdu, i)?;
            let mut value = 1.0;
            if let Some(letter) = letter(&name) {
                let axis = PsfexAxis::new(&name, zero - 1.0, scale).map_err(invalid(path))?;
                let coordinate = if letter == 'X' {
                    &mut contexts.x
                } else {
                    &mut contexts.y
                };
                if coordinate.replace((i - 1, axis)).is_some() {
                    const ONCE: &str = "another coordinate than those before it";
                    return Err(hdu.keyword_error(&format!("POLNAME{i}"), ONCE));
                }
            } else {
                let given = values.iter().find(|(given, _)| given.eq_ignore_ascii_case(&name));
                // A missing value is an error below, which names all of them.
                value = given.map_or(0.0, |(_, value)| (value - zero) / scale);
                others.push(name);
            }
            contexts.all.push(Context { group, value });
        }
        check_names(path, &others, values)?;
        Ok(contexts)
    }

    /// The exponents of all contexts in each term, in the order of PSFEx: the first context is the fastest.
    /// `None` for too many terms.
    pub(super) fn exponents(&self) -> Option<Vec<Vec<usize>>> {
        let mut left = self.degrees.clone();
        let mut exponents = vec![0; self.all.len()];
        let mut terms = vec![exponents.clone()];
        loop {
            let next = self.all.iter().enumerate().find(|(at, context)| {
                let left = &mut left[context.group];
                if *left > 0 {
                    *left -= 1;
                    return true;
                }
                *left += std::mem::take(&mut exponents[*at]);
                false
            });
            let Some((at, _)) = next else {
                return Some(terms);
            };
            exponents[at] += 1;
            if terms.len() == MOST_TERMS {
                return None;
            }
            terms.push(exponents.clone());
        }
    }

    /// The planes of a polynomial in the position alone, at the values of the other contexts. Without a
    /// coordinate, the PSF is constant.
    pub(super) fn of_position(
        self,
        path: &Path,
        hdu: &Hdu,
        planes: Array3<f64>,
        terms: &[Vec<usize>],
    ) -> Result<(Array3<f64>, Option<PsfexPolynomial>), IoError> {
        let [x, y] = [&self.x, &self.y].map(|coordinate| coordinate.as_ref().map(|(at, _)| *at));
        let power = |exponents: &[usize], at: Option<usize>| at.map_or(0, |at| exponents[at]);
        let degree = terms.iter().map(|e| power(e, x) + power(e, y)).max().unwrap_or(0);
        if degree > PsfexPolynomial::MAX_DEGREE {
            const TOTAL: &str = "smaller: the degrees of x and y add up to more than 10";
            return Err(hdu.keyword_error("POLDEG1", TOTAL));
        }
        let is_plain = (x, y) == (Some(0), Some(1)) && self.all.len() == 2 && self.degrees.len() == 1;
        let planes = if is_plain {
            planes
        } else {
            let (_, ny, nx) = planes.dim();
            let mut reduced = Array3::zeros((PsfexPolynomial::term_count(degree), ny, nx));
            for (exponents, plane) in terms.iter().zip(planes.outer_iter()) {
                let powers = self.all.iter().zip(exponents);
                let powers = powers.map(|(context, &exponent)| context.value.powi(exponent as i32));
                let factor: f64 = powers.product();
                let (i, j) = (power(exponents, x), power(exponents, y));
                let before: usize = (0..j).map(|j| degree - j + 1).sum();
                reduced
                    .index_axis_mut(Axis(0), before + i)
                    .scaled_add(factor, &plane);
            }
            reduced
        };
        if x.is_none() && y.is_none() {
            return Ok((planes, None));
        }
        let or_absent = |coordinate: Option<(usize, PsfexAxis)>, name| match coordinate {
            Some((_, axis)) => Ok(axis),
            None => PsfexAxis::new(name, 0.0, ABSENT),
        };
        let x = or_absent(self.x, "X_IMAGE").map_err(invalid(path))?;
        let y = or_absent(self.y, "Y_IMAGE").map_err(invalid(path))?;
        let polynomial = PsfexPolynomial::new(x, y, degree).map_err(invalid(path))?;
        Ok((planes, Some(polynomial)))
    }
}

/// The name, offset and scale of context `i`. The name is in upper case.
fn scaled(hdu: &Hdu, i: usize) -> Result<(String, f64, f64), IoError> {
    const NAME: &str = "the name of a context, such as X_IMAGE or MAG_AUTO";
    const OFFSET: &str = "the offset of a context, a number";
    const SCALE: &str = "the scale of a context, a number other than 0";
    let name = hdu.required::<String>(&format!("POLNAME{i}"), NAME)?;
    let zero = hdu.required::<f64>(&format!("POLZERO{i}"), OFFSET)?;
    let keyword = format!("POLSCAL{i}");
    let scale = hdu.required::<f64>(&keyword, SCALE)?;
    if scale == 0.0 {
        return Err(hdu.keyword_error(&keyword, SCALE));
    }
    Ok((name.trim().to_ascii_uppercase(), zero, scale))
}

/// `X` or `Y` for a name such as `X_IMAGE` or `YWIN_IMAGE`, which is a coordinate in pixels.
fn letter(name: &str) -> Option<char> {
    let letter = name.chars().next().filter(|letter| "XY".contains(*letter))?;
    let kind = name[1..].strip_suffix("_IMAGE")?;
    POSITION_KINDS.contains(&kind).then_some(letter)
}

/// Checks that there is a value for each context other than the position, and for nothing else.
fn check_names(path: &Path, others: &[String], values: &[(String, f64)]) -> Result<(), IoError> {
    let refused =
        |problem: String| Err(IoError::new(path, IoErrorKind::Setting, problem).with_setting("contexts"));
    let is = |name: &String, given: &str| name.eq_ignore_ascii_case(given);
    let missing: Vec<&str> = others
        .iter()
        .filter(|name| !values.iter().any(|(given, _)| is(name, given)))
        .map(String::as_str)
        .collect();
    if !missing.is_empty() {
        return refused(format!(
            "the PSF depends on {} besides the position: choose a value",
            missing.join(" and ")
        ));
    }
    match values
        .iter()
        .find(|(given, _)| !others.iter().any(|name| is(name, given)))
    {
        None => Ok(()),
        Some((given, _)) if others.is_empty() => refused(format!(
            "there is a value for {given}, but the PSF depends on nothing but the position"
        )),
        Some((given, _)) => refused(format!(
            "there is a value for {given}, but the PSF depends on {}",
            others.join(" and ")
        )),
    }
}

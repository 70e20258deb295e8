//! The choice of a convolution method.

use std::str::FromStr;

use conv_core::{BasisConvolution, ConvReal, ConvolutionMethod, Direct, PatchConvolution};
use psf_types::Anchor;

use crate::PsfieldError;

/// How a scene is convolved. Written as `auto`, `basis`, `patch=N` or `direct`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Method {
    /// The best exact method there is: `basis`.
    #[default]
    Auto,
    /// One whole-image convolution a component ([`BasisConvolution`]).
    Basis,
    /// One PSF a patch of so many pixels ([`PatchConvolution`]); not exact.
    Patch(usize),
    /// The double sum in f64 ([`Direct`]).
    Direct,
}

impl Method {
    /// The method with an anchoring.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`] for a patch of no size.
    pub fn build<T: ConvReal>(self, anchor: Anchor) -> Result<Box<dyn ConvolutionMethod<T>>, PsfieldError> {
        Ok(match self {
            Self::Auto | Self::Basis => Box::new(BasisConvolution::new(anchor)),
            Self::Patch(size) => Box::new(PatchConvolution::new(size, anchor)?),
            Self::Direct => Box::new(Direct::new(anchor)),
        })
    }

    /// The method that [`Method::Auto`] stands for, and every other itself.
    #[must_use]
    pub fn resolved(self) -> Self {
        if self == Self::Auto { Self::Basis } else { self }
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Basis => f.write_str("basis"),
            Self::Patch(size) => write!(f, "patch={size}"),
            Self::Direct => f.write_str("direct"),
        }
    }
}

impl FromStr for Method {
    type Err = PsfieldError;
    fn from_str(text: &str) -> Result<Self, PsfieldError> {
        let refused = || PsfieldError::BadMethod { got: text.to_owned() };
        match (text, text.strip_prefix("patch=")) {
            ("auto", _) => Ok(Self::Auto),
            ("basis", _) => Ok(Self::Basis),
            ("direct", _) => Ok(Self::Direct),
            (_, Some(size)) => match size.parse() {
                Ok(size) if size > 0 => Ok(Self::Patch(size)),
                _ => Err(refused()),
            },
            _ => Err(refused()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_forms_round_trip() {
        for text in ["auto", "basis", "patch=64", "direct"] {
            assert_eq!(text.parse::<Method>().unwrap().to_string(), text);
        }
        for text in ["", "patch", "patch=0", "patch=-1", "lowrank"] {
            assert!(text.parse::<Method>().is_err(), "{text}");
        }
    }
}

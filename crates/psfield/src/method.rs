//! The choice of a convolution method.

use std::str::FromStr;

use conv_core::{
    BasisConvolution, ConvReal, ConvolutionMethod, Direct, LowRank, PatchConvolution, Paths, PlanOptions,
};

use crate::PsfieldError;

/// How a scene is convolved. Written as `auto`, `lowrank`, `basis`, `patch=N` or `direct`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Method {
    /// The fast engine, each tile in the cheapest way: transforms, the direct sum, single stamps, nothing ([`LowRank`]).
    #[default]
    Auto,
    /// The fast engine by transforms alone ([`LowRank`] with [`Paths::Transforms`]).
    LowRank,
    /// One whole-image convolution a component ([`BasisConvolution`]).
    Basis,
    /// One PSF a patch of so many pixels ([`PatchConvolution`]); not exact.
    Patch(usize),
    /// The double sum in f64 ([`Direct`]).
    Direct,
}

impl Method {
    /// The method with the options of the engine; those without a plan take the anchoring alone.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`] for a patch of no size.
    pub fn build<T: ConvReal>(
        self,
        options: PlanOptions,
    ) -> Result<Box<dyn ConvolutionMethod<T>>, PsfieldError> {
        let anchor = options.anchor();
        Ok(match self {
            Self::Auto | Self::LowRank => {
                Box::new(LowRank::new(self.plan_options(options).unwrap_or(options)))
            }
            Self::Basis => Box::new(BasisConvolution::new(anchor)),
            Self::Patch(size) => Box::new(PatchConvolution::new(size, anchor)?),
            Self::Direct => Box::new(Direct::new(anchor)),
        })
    }

    /// The options with which the method makes a [`conv_core::Plan`]; nothing for methods without one.
    pub fn plan_options(self, options: PlanOptions) -> Option<PlanOptions> {
        match self {
            Self::Auto => Some(options.with_paths(Paths::Cheapest)),
            Self::LowRank => Some(options.with_paths(Paths::Transforms)),
            _ => None,
        }
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::LowRank => f.write_str("lowrank"),
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
            ("lowrank", _) => Ok(Self::LowRank),
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
        for text in ["auto", "lowrank", "basis", "patch=64", "direct"] {
            assert_eq!(text.parse::<Method>().unwrap().to_string(), text);
        }
        for text in ["", "patch", "patch=0", "patch=-1", "low-rank"] {
            assert!(text.parse::<Method>().is_err(), "{text}");
        }
    }
}

//! The methods that are measured.

/// A method with its setting.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Contender {
    /// One PSF for the whole frame, that of its middle: a [`Plan`](conv_core::Plan) of a model whose field is constant. It has
    /// a single mode and no coefficients, and is the fastest convolution with one PSF that there is here.
    Single,
    /// The fast engine by transforms alone ([`Paths::Transforms`](conv_core::Paths::Transforms)).
    LowRank {
        /// The tolerance.
        tolerance: f64,
    },
    /// The fast engine, each tile in the cheapest way.
    Auto {
        /// The tolerance.
        tolerance: f64,
    },
    /// One PSF for each square patch ([`PatchConvolution`](conv_core::PatchConvolution)).
    Patch {
        /// Pixels along each side.
        size: usize,
    },
    /// One whole-image convolution a component ([`BasisConvolution`](conv_core::BasisConvolution)).
    Basis {
        /// The components kept, at most; the error is that to the whole model.
        rank: usize,
    },
    /// The double sum in f64 ([`Direct`](conv_core::Direct)).
    Direct,
}

impl Contender {
    /// The name of the method.
    pub fn method(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::LowRank { .. } => "lowrank",
            Self::Auto { .. } => "auto",
            Self::Patch { .. } => "patch",
            Self::Basis { .. } => "basis",
            Self::Direct => "direct",
        }
    }

    /// The setting, as `tolerance=1e-3`, `patch=64` or `rank=30`.
    pub fn setting(self) -> Option<String> {
        match self {
            Self::Single | Self::Direct => None,
            Self::LowRank { tolerance } | Self::Auto { tolerance } => Some(if tolerance == 0.0 {
                "tolerance=0".to_owned()
            } else {
                format!("tolerance={tolerance:e}")
            }),
            Self::Patch { size } => Some(format!("patch={size}")),
            Self::Basis { rank } => Some(format!("rank={rank}")),
        }
    }

    /// The tolerance, of the methods that take one.
    pub fn tolerance(self) -> Option<f64> {
        match self {
            Self::LowRank { tolerance } | Self::Auto { tolerance } => Some(tolerance),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_name_what_they_set() {
        let text = |contender: Contender| contender.setting().unwrap_or_default();
        assert_eq!(text(Contender::LowRank { tolerance: 1e-3 }), "tolerance=1e-3");
        assert_eq!(text(Contender::Auto { tolerance: 0.0 }), "tolerance=0");
        assert_eq!(text(Contender::Patch { size: 64 }), "patch=64");
        assert_eq!(text(Contender::Basis { rank: 30 }), "rank=30");
        assert_eq!(text(Contender::Direct), "");
    }
}

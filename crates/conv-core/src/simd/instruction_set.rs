//! The choice of the instruction set.

use std::sync::OnceLock;

use psf_types::{DataError, named};

/// Vector instructions of a processor.
///
/// By default, the widest that the machine has are used. The environment variable
/// [`VARIABLE`](Self::VARIABLE) can name narrower ones, to measure or test them. It is read once.
/// Results differ by rounding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum InstructionSet {
    /// Single numbers.
    Scalar,
    /// x86-64 with AVX2 and FMA: vectors of 256 bits.
    Avx2,
    /// x86-64 with AVX-512: vectors of 512 bits.
    Avx512,
    /// ARM: vectors of 128 bits.
    Neon,
}

named!(
    InstructionSet,
    "instruction set (environment variable PSFIELD_SIMD)",
    "scalar, avx2, avx512 or neon",
    "scalar" => Scalar, "avx2" => Avx2, "avx512" => Avx512, "neon" => Neon
);

impl InstructionSet {
    /// The environment variable that names an instruction set.
    pub const VARIABLE: &str = "PSFIELD_SIMD";

    /// The instruction set that computations use: the one that the environment variable names, or the
    /// widest if there is no such variable or if [`asked`](Self::asked) is an error.
    pub fn used() -> Self {
        static USED: OnceLock<InstructionSet> = OnceLock::new();
        *USED.get_or_init(|| Self::asked().ok().flatten().unwrap_or_else(Self::widest))
    }

    /// The instruction set that the environment variable names. `None` if there is no such variable.
    ///
    /// # Errors
    /// [`DataError::Setting`] for an unknown name, or instructions that this machine does not have.
    pub fn asked() -> Result<Option<Self>, DataError> {
        let Some(text) = std::env::var_os(Self::VARIABLE) else {
            return Ok(None);
        };
        let text = text.to_string_lossy();
        let asked: Self = text.parse()?;
        if asked.is_available() {
            return Ok(Some(asked));
        }
        let what = "instruction set (environment variable PSFIELD_SIMD)";
        Err(DataError::setting(what, "one that this machine has", &text))
    }

    fn widest() -> Self {
        let all = [Self::Avx512, Self::Avx2, Self::Neon];
        all.into_iter()
            .find(|set| set.is_available())
            .unwrap_or(Self::Scalar)
    }

    fn is_available(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => pulp::x86::V3::try_new().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => pulp::x86::V4::try_new().is_some(),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => pulp::aarch64::Neon::try_new().is_some(),
            // A set of other processors.
            _ => false,
        }
    }
}

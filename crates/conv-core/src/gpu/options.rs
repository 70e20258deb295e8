//! What may be asked of a GPU.

/// Limits of the work on a GPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GpuOptions {
    memory_bytes: u64,
    piece_bytes: u64,
}

impl GpuOptions {
    /// What a plan keeps on the GPU unless told otherwise: 2 GiB.
    pub const DEFAULT_MEMORY_BYTES: u64 = 2 << 30;
    /// Pieces of work unless told otherwise: 64 MiB.
    pub const DEFAULT_PIECE_BYTES: u64 = 64 << 20;

    /// The same with another limit to what the plan keeps on the GPU: spectra and coefficients. What does not fit is made anew by each
    /// execution. What is in work comes on top, a few pieces of [`with_pieces`](Self::with_pieces).
    #[must_use]
    pub fn with_memory(self, bytes: u64) -> Self {
        Self {
            memory_bytes: bytes,
            ..self
        }
    }

    /// The same with other pieces of work, in bytes; the adapter's own limit holds beside it.
    #[must_use]
    pub fn with_pieces(self, bytes: u64) -> Self {
        Self {
            piece_bytes: bytes,
            ..self
        }
    }

    /// Bytes that a plan keeps on the GPU at most.
    pub fn memory_bytes(&self) -> u64 {
        self.memory_bytes
    }

    /// Bytes of a piece of work at most.
    pub fn piece_bytes(&self) -> u64 {
        self.piece_bytes
    }
}

impl Default for GpuOptions {
    fn default() -> Self {
        Self {
            memory_bytes: Self::DEFAULT_MEMORY_BYTES,
            piece_bytes: Self::DEFAULT_PIECE_BYTES,
        }
    }
}

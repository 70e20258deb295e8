//! Writing whole numbers through CFITSIO.

use std::ffi::c_int;

use fitsio::sys;

use super::Fits;
use crate::IoError;
use crate::integer_image::IntegerKind;

impl Fits {
    /// Adds an image HDU for whole numbers; `shape` in array order (x last). CFITSIO writes the BZERO of unsigned ones.
    pub(crate) fn create_integer_image(&mut self, shape: &[usize], kind: IntegerKind) -> Result<(), IoError> {
        let bitpix = match kind {
            IntegerKind::Unsigned8 => sys::BYTE_IMG as c_int,
            IntegerKind::Unsigned16 => sys::USHORT_IMG as c_int,
            IntegerKind::Signed32 => sys::LONG_IMG as c_int,
        };
        self.create_image_of(shape, bitpix)
    }

    /// Writes pixels of such an image, from pixel `first` (0-based) on.
    pub(crate) fn write_integers(&mut self, first: usize, pixels: &[c_int]) -> Result<(), IoError> {
        let mut status = 0;
        // SAFETY: as in `write_pixels`; `pixels` are C's `int`, which TINT names.
        unsafe {
            sys::ffppr(
                self.handle.as_ptr(),
                sys::TINT as c_int,
                first as sys::LONGLONG + 1,
                pixels.len() as sys::LONGLONG,
                pixels.as_ptr().cast_mut().cast(),
                &raw mut status,
            )
        };
        self.check(status, "writing pixels")
    }
}

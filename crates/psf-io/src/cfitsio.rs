//! The part of CFITSIO that this crate needs, made safe: the only `unsafe` code of the workspace.
//!
//! Files are opened and created through the disk-file entry points (`ffdkopn`, `ffdkinit`), so that brackets, `+` and `!`
//! in a name are just characters. CFITSIO is built reentrant (a test asserts it): handles of different threads are
//! independent, also on one file, since a read-only open never shares state. A [`Fits`] stays in its thread.
#![allow(
    unsafe_code,
    reason = "CFITSIO is a C library; every call is wrapped here and nowhere else"
)]

mod write;
mod write_integers;

use std::ffi::{CString, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::ptr::{self, NonNull};

use fitsio::sys;
use psf_types::Real;

use crate::IoError;
use crate::fits_source::FitsSource;

/// The longest file name, without the closing NUL.
const NAME_LIMIT: usize = sys::FLEN_FILENAME as usize - 1;
/// CFITSIO's status for a value that the type asked for cannot hold.
const NUM_OVERFLOW: c_int = 412;

/// CFITSIO's statuses for a system call that failed while it wrote: creating, writing, closing, seeking (which writes what is buffered).
const SYSTEM_FAILURES: [c_int; 4] = [105, 106, 110, 116];

/// An open FITS file.
#[derive(Debug)]
pub(crate) struct Fits {
    handle: NonNull<sys::fitsfile>,
    /// The name for error messages; not the temporary one.
    path: PathBuf,
    /// Whether the HDU in hand is an image that this handle writes.
    writes_image: bool,
    /// Keeps an unpacked copy there for as long as it is open.
    source: Option<FitsSource>,
}

impl Fits {
    /// Opens an existing file for reading.
    pub(crate) fn open(source: &FitsSource) -> Result<Self, IoError> {
        let path = source.path();
        let name = c_name(source.file(), path)?;
        let (mut handle, mut status) = (ptr::null_mut(), 0);
        // SAFETY: `handle` and `status` are valid for writes, `name` is a NUL-terminated string within CFITSIO's limit.
        unsafe {
            sys::ffdkopn(
                &raw mut handle,
                name.as_ptr(),
                sys::READONLY as c_int,
                &raw mut status,
            )
        };
        let mut fits = Self::new(handle, path, status, "opening the file", false)?;
        fits.source = Some(source.clone());
        Ok(fits)
    }

    /// Creates the file `at`, which must not exist; errors name `path`.
    pub(crate) fn create(at: &Path, path: &Path) -> Result<Self, IoError> {
        let name = c_name(at, path)?;
        let (mut handle, mut status) = (ptr::null_mut(), 0);
        // SAFETY: as in `open`.
        unsafe { sys::ffdkinit(&raw mut handle, name.as_ptr(), &raw mut status) };
        Self::new(handle, path, status, "creating the file", true)
    }

    fn new(
        handle: *mut sys::fitsfile,
        path: &Path,
        status: c_int,
        doing: &'static str,
        writes: bool,
    ) -> Result<Self, IoError> {
        let handle = NonNull::new(handle).ok_or_else(|| failure(path, doing, status, writes))?;
        let fits = Self {
            handle,
            path: path.to_owned(),
            writes_image: false,
            source: None,
        };
        check(path, status, doing, writes)?;
        Ok(fits)
    }

    /// Writes out what is buffered and closes the file.
    pub(crate) fn close(mut self) -> Result<(), IoError> {
        let path = std::mem::take(&mut self.path);
        let writes = self.source.take().is_none();
        // What is left in `self` owns no memory, and the handle must not be closed twice.
        let this = std::mem::ManuallyDrop::new(self);
        let mut status = 0;
        // SAFETY: the handle is open and not used again. CFITSIO frees it also on failure.
        unsafe { sys::ffclos(this.handle.as_ptr(), &raw mut status) };
        check(&path, status, "closing the file", writes)
    }

    /// Goes to an HDU, counted from 0.
    pub(crate) fn move_to(&mut self, hdu: usize) -> Result<(), IoError> {
        let number = c_int::try_from(hdu + 1).unwrap_or(c_int::MAX);
        let mut status = 0;
        // SAFETY: the handle is open; a null pointer for the HDU type is allowed.
        unsafe { sys::ffmahd(self.handle.as_ptr(), number, ptr::null_mut(), &raw mut status) };
        self.check(status, "moving to an HDU")
    }

    /// Reads `pixels.len()` pixels of the image from pixel `first` (0-based) on; with `blank`, undefined integer pixels become
    /// NaN.
    pub(crate) fn read_pixels<T: Real>(
        &mut self,
        first: usize,
        pixels: &mut [T],
        blank: bool,
    ) -> Result<(), IoError> {
        let mut nan = T::nan();
        let null = if blank {
            (&raw mut nan).cast::<c_void>()
        } else {
            ptr::null_mut()
        };
        let (mut any_null, mut status) = (0, 0);
        // SAFETY: `pixels` holds as many values of the type `datatype` names as are asked for; `null` is null or points
        // to one such value, which outlives the call, as do `any_null` and `status`. (CFITSIO writes to `any_null` unasked
        // when it meets an undefined value.)
        unsafe {
            sys::ffgpv(
                self.handle.as_ptr(),
                datatype::<T>(),
                first as sys::LONGLONG + 1,
                pixels.len() as sys::LONGLONG,
                null,
                pixels.as_mut_ptr().cast(),
                &raw mut any_null,
                &raw mut status,
            )
        };
        if status == NUM_OVERFLOW && size_of::<T>() == size_of::<f32>() {
            // SAFETY: clears the message stack, which CFITSIO guards itself.
            unsafe { sys::ffcmsg() };
            return Err(IoError::Overflow {
                path: self.path.clone(),
            });
        }
        self.check(status, "reading pixels")
    }

    /// Reads the first `values.len()` numbers of a column, counted from 1; with `null`, undefined integers become NaN.
    pub(crate) fn read_column(
        &mut self,
        column: usize,
        values: &mut [f64],
        null: bool,
    ) -> Result<(), IoError> {
        let mut nan = f64::NAN;
        let null = if null {
            (&raw mut nan).cast::<c_void>()
        } else {
            ptr::null_mut()
        };
        let (mut any_null, mut status) = (0, 0);
        // SAFETY: as in `read_pixels`.
        unsafe {
            sys::ffgcv(
                self.handle.as_ptr(),
                sys::TDOUBLE as c_int,
                column as c_int,
                1,
                1,
                values.len() as sys::LONGLONG,
                null,
                values.as_mut_ptr().cast(),
                &raw mut any_null,
                &raw mut status,
            )
        };
        self.check(status, "reading a table column")
    }

    fn check(&self, status: c_int, doing: &'static str) -> Result<(), IoError> {
        // Who reads has a source.
        check(&self.path, status, doing, self.source.is_none())
    }
}

impl Drop for Fits {
    fn drop(&mut self) {
        let (mut emptied, mut status) = (0, 0);
        if self.writes_image {
            // Nobody wants this file any more. CFITSIO would fill an incomplete image up with zeros, however large it is.
            // SAFETY: the handle is open, the keyword is NUL-terminated; a null pointer keeps the comment.
            unsafe {
                sys::ffmkyj(
                    self.handle.as_ptr(),
                    c"NAXIS".as_ptr(),
                    0,
                    ptr::null(),
                    &raw mut emptied,
                )
            };
        }
        // SAFETY: the handle is open and not used again.
        unsafe { sys::ffclos(self.handle.as_ptr(), &raw mut status) };
        if emptied != 0 || status != 0 {
            // SAFETY: clears the message stack, which CFITSIO guards itself.
            unsafe { sys::ffcmsg() };
        }
    }
}

fn check(path: &Path, status: c_int, doing: &'static str, writes: bool) -> Result<(), IoError> {
    if status == 0 {
        Ok(())
    } else {
        Err(failure(path, doing, status, writes))
    }
}

/// The error for a status, with CFITSIO's text and the messages on its stack; with the system's reason where a file that is written
/// fails.
fn failure(path: &Path, doing: &'static str, status: c_int, writes: bool) -> IoError {
    // CFITSIO keeps no reason. It returns at once when the C library fails, so that `errno` is still that of the failure; nothing may
    // come before this line.
    let system = std::io::Error::last_os_error();
    let path = path.to_owned();
    let mut buffer = [0 as c_char; sys::FLEN_ERRMSG as usize];
    const { assert!(sys::FLEN_STATUS <= sys::FLEN_ERRMSG) };
    // SAFETY: the buffer is longer than any status text (30 characters and NUL).
    unsafe { sys::ffgerr(status, buffer.as_mut_ptr()) };
    let mut text = text_of(&buffer);
    // SAFETY: the buffer is as long as any message (80 characters and NUL).
    while unsafe { sys::ffgmsg(buffer.as_mut_ptr()) } != 0 {
        text = text + "; " + &text_of(&buffer);
    }
    if writes && SYSTEM_FAILURES.contains(&status) && system.raw_os_error().is_some_and(|code| code != 0) {
        return IoError::Write { path, source: system };
    }
    IoError::Cfitsio {
        path,
        doing,
        status,
        text,
    }
}

/// What stands before the first NUL.
fn text_of(buffer: &[c_char]) -> String {
    let bytes: Vec<u8> = buffer.iter().take_while(|&&c| c != 0).map(|&c| c as u8).collect();
    String::from_utf8_lossy(&bytes).trim().to_owned()
}

/// CFITSIO's code of a type.
fn datatype<T: Real>() -> c_int {
    // `Real` is sealed: f32 and f64 alone.
    (if size_of::<T>() == size_of::<f32>() {
        sys::TFLOAT
    } else {
        sys::TDOUBLE
    }) as c_int
}

/// The absolute name: CFITSIO would drop leading blanks and expand a leading `~`.
fn c_name(at: &Path, path: &Path) -> Result<CString, IoError> {
    let refused = || IoError::FileName {
        path: path.to_owned(),
        limit: NAME_LIMIT,
    };
    let absolute = std::path::absolute(at).map_err(|source| IoError::Read {
        path: path.to_owned(),
        source,
    })?;
    let bytes = absolute.into_os_string().into_encoded_bytes();
    if bytes.len() > NAME_LIMIT {
        return Err(refused());
    }
    CString::new(bytes).map_err(|_| refused())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cfitsio_is_built_reentrant() {
        // SAFETY: no arguments, no state.
        assert_eq!(unsafe { sys::fits_is_reentrant() }, 1);
    }

    #[test]
    fn names_that_cfitsio_cannot_take_are_refused() {
        let long = PathBuf::from(format!("/{}", "d/".repeat(NAME_LIMIT)));
        for bad in [Path::new("a\0b.fits"), &long] {
            assert!(
                matches!(Fits::open(&FitsSource::plain(bad)), Err(IoError::FileName { .. })),
                "{}",
                bad.display()
            );
        }
    }
}

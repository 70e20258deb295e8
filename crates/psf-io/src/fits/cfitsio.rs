//! Safe wrappers of the functions of CFITSIO that this crate needs. No other file of this crate has
//! `unsafe` code.
//!
//! Files are opened and created through the disk-file entry points (`ffdkopn`, `ffdkinit`), so that
//! brackets, `+` and `!` in a name have no special meaning. CFITSIO is built reentrant, which a
//! test asserts. Handles of different threads are independent, even if they read one file, because
//! files opened for reading never share state. A [`Fits`] cannot be sent to another thread.
#![allow(
    unsafe_code,
    reason = "CFITSIO is a C library; every call is wrapped here and nowhere else"
)]

use std::any::TypeId;
use std::ffi::{CString, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::ptr::{self, NonNull};

use fitsio::sys;
use psf_types::Real;

use crate::error::{IoError, IoErrorKind, beyond_single, unreadable, unwritable};
use crate::fits::card::{Card, RECORD, Record};
use crate::fits::hdu::FitsSource;

/// The length in bytes of the longest file name that CFITSIO accepts, without the closing NUL.
const NAME_LIMIT: usize = sys::FLEN_FILENAME as usize - 1;
/// CFITSIO's status for a value that the requested type cannot hold.
const NUM_OVERFLOW: c_int = 412;

/// CFITSIO's statuses for a failed system call when a file is written: creating, writing, closing,
/// and seeking (which flushes buffers).
const SYSTEM_FAILURES: [c_int; 4] = [105, 106, 110, 116];

/// The largest number of records that may be reserved. CFITSIO counts their bytes in an `int`, and
/// does not read back a header much longer than this (8 MB).
const RESERVE_LIMIT: usize = 100_000;

/// An open FITS file.
#[derive(Debug)]
pub(crate) struct Fits {
    handle: NonNull<sys::fitsfile>,
    /// The path for error messages, never a temporary name.
    path: PathBuf,
    /// True if the current HDU is an image that this handle writes.
    writes_image: bool,
    /// The file that is read. If it is an unpacked copy, this field keeps the copy on the disk
    /// while the handle is open. `None` if the handle writes.
    source: Option<FitsSource>,
}

impl Fits {
    /// Opens an existing file for reading.
    pub(crate) fn open(source: &FitsSource) -> Result<Self, IoError> {
        let path = source.path();
        let name = c_name(source.file(), path)?;
        let (mut handle, mut status) = (ptr::null_mut(), 0);
        let mode = sys::READONLY as c_int;
        // SAFETY: `handle` and `status` are valid for writes, `name` is a NUL-terminated string
        // within CFITSIO's limit.
        unsafe { sys::ffdkopn(&raw mut handle, name.as_ptr(), mode, &raw mut status) };
        let mut fits = Self::new(handle, path, status, "opening the file", false)?;
        fits.source = Some(source.clone());
        Ok(fits)
    }

    /// Creates the file `at`, which must not exist. Errors name `path`.
    pub(crate) fn create(at: &Path, path: &Path) -> Result<Self, IoError> {
        let name = c_name(at, path)?;
        let (mut handle, mut status) = (ptr::null_mut(), 0);
        // SAFETY: as in `open`.
        unsafe { sys::ffdkinit(&raw mut handle, name.as_ptr(), &raw mut status) };
        Self::new(handle, path, status, "creating the file", true)
    }

    /// Opens an existing file for reading and writing. Errors name `path`.
    pub(crate) fn open_to_change(at: &Path, path: &Path) -> Result<Self, IoError> {
        let name = c_name(at, path)?;
        let (mut handle, mut status) = (ptr::null_mut(), 0);
        let mode = sys::READWRITE as c_int;
        // SAFETY: as in `open`.
        unsafe { sys::ffdkopn(&raw mut handle, name.as_ptr(), mode, &raw mut status) };
        Self::new(handle, path, status, "opening the file", true)
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

    /// The path for error messages.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Flushes all buffers and closes the file.
    pub(crate) fn close(mut self) -> Result<(), IoError> {
        let path = std::mem::take(&mut self.path);
        let writes = self.source.take().is_none();
        // `drop` must not close the handle a second time. The other fields own no memory now.
        let this = std::mem::ManuallyDrop::new(self);
        let mut status = 0;
        // SAFETY: the handle is open and not used again. CFITSIO frees it even if closing fails.
        unsafe { sys::ffclos(this.handle.as_ptr(), &raw mut status) };
        check(&path, status, "closing the file", writes)
    }

    /// Moves to an HDU, counted from 0.
    pub(crate) fn move_to(&mut self, hdu: usize) -> Result<(), IoError> {
        let number = c_int::try_from(hdu + 1).unwrap_or(c_int::MAX);
        // SAFETY: the handle is open. A null pointer for the HDU type is allowed.
        self.call("moving to an HDU", |fits, status| unsafe {
            sys::ffmahd(fits, number, ptr::null_mut(), status)
        })
    }

    /// Reads `pixels.len()` pixels of the image from pixel `first` (0-based) on. With `blank`,
    /// pixels that the file marks as undefined become NaN.
    pub(crate) fn read_pixels<T: Real>(
        &mut self,
        first: usize,
        pixels: &mut [T],
        blank: bool,
    ) -> Result<(), IoError> {
        let mut nan = T::nan();
        let null = if blank { &raw mut nan } else { ptr::null_mut() }.cast::<c_void>();
        let (first, count) = (first as sys::LONGLONG + 1, pixels.len() as sys::LONGLONG);
        let (fits, data) = (self.handle.as_ptr(), pixels.as_mut_ptr().cast());
        let (mut any_null, mut status) = (0, 0);
        let (any, told) = (&raw mut any_null, &raw mut status);
        // SAFETY: `pixels` holds the requested number of values of the type that `datatype` names.
        // `null` is a null pointer or points to `nan`, a value of this type. `nan`, `any_null` and
        // `status` outlive the call. (CFITSIO writes to `any_null` whenever it finds an undefined
        // value.)
        unsafe { sys::ffgpv(fits, datatype::<T>(), first, count, null, data, any, told) };
        if status == NUM_OVERFLOW && size_of::<T>() == size_of::<f32>() {
            // SAFETY: `ffcmsg` only clears CFITSIO's message stack, which a lock protects.
            unsafe { sys::ffcmsg() };
            return Err(beyond_single(&self.path));
        }
        self.check(status, "reading pixels")
    }

    /// Reads the first `values.len()` numbers of a column. `column` is counted from 1. With `null`,
    /// undefined integers become NaN.
    pub(crate) fn read_column(
        &mut self,
        column: usize,
        values: &mut [f64],
        null: bool,
    ) -> Result<(), IoError> {
        let mut nan = f64::NAN;
        let null = if null { &raw mut nan } else { ptr::null_mut() }.cast::<c_void>();
        let (column, count) = (column as c_int, values.len() as sys::LONGLONG);
        let mut any_null = 0;
        let (data, any) = (values.as_mut_ptr().cast(), &raw mut any_null);
        // SAFETY: as in `read_pixels`.
        self.call("reading a table column", |fits, status| unsafe {
            sys::ffgcv(
                fits,
                datatype::<f64>(),
                column,
                1,
                1,
                count,
                null,
                data,
                any,
                status,
            )
        })
    }

    /// Reads the first `rows` texts of a column whose texts have `width` characters. `column` is
    /// counted from 1. Blanks at the end of a text are removed.
    pub(crate) fn read_texts(
        &mut self,
        column: usize,
        rows: usize,
        width: usize,
    ) -> Result<Vec<String>, IoError> {
        let mut texts = vec![0_u8; rows * (width + 1)];
        let mut pointers: Vec<*mut c_char> = texts
            .chunks_exact_mut(width + 1)
            .map(|text| text.as_mut_ptr().cast())
            .collect();
        let (column, count) = (column as c_int, rows as sys::LONGLONG);
        let (data, mut any_null) = (pointers.as_mut_ptr(), 0);
        let any = &raw mut any_null;
        // SAFETY: each pointer has room for a text of `width` characters and the NUL after it, which is
        // the most that CFITSIO writes. No text replaces undefined ones.
        self.call("reading a table column", |fits, status| unsafe {
            sys::ffgcvs(fits, column, 1, 1, count, ptr::null_mut(), data, any, status)
        })?;
        let text = |bytes: &[u8]| {
            let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
            String::from_utf8_lossy(&bytes[..end]).trim_end().to_owned()
        };
        Ok(texts.chunks_exact(width + 1).map(text).collect())
    }

    /// Adds an image HDU. `bitpix` is a BITPIX, or CFITSIO's code of another image type. `shape` is
    /// in array order (x last). CFITSIO writes the BZERO of unsigned numbers.
    pub(crate) fn create_image(&mut self, shape: &[usize], bitpix: c_int) -> Result<(), IoError> {
        let mut axes: Vec<sys::LONGLONG> = shape.iter().rev().map(|&n| n as sys::LONGLONG).collect();
        self.writes_image = true;
        // SAFETY: the handle is open and `axes` holds the stated number of values.
        self.call("creating an image", |fits, status| unsafe {
            sys::ffcrimll(fits, bitpix, axes.len() as c_int, axes.as_mut_ptr(), status)
        })
    }

    /// Appends the current HDU of another file, header and data. A primary image becomes an extension.
    pub(crate) fn copy_hdu(&mut self, from: &mut Self) -> Result<(), IoError> {
        self.writes_image = false;
        let from = from.handle.as_ptr();
        // SAFETY: both handles are open.
        self.call("copying an image", |fits, status| unsafe {
            sys::ffcopy(from, fits, 0, status)
        })
    }

    /// Appends the current HDU of another file, which is an image compressed in tiles, as an uncompressed image.
    pub(crate) fn copy_uncompressed(&mut self, from: &mut Self) -> Result<(), IoError> {
        self.writes_image = false;
        let from = from.handle.as_ptr();
        // SAFETY: both handles are open.
        self.call("uncompressing an image", |fits, status| unsafe {
            sys::fits_img_decompress(from, fits, status)
        })
    }

    /// The current HDU, counted from 0.
    pub(crate) fn current(&self) -> usize {
        let mut number = 1;
        // SAFETY: the handle is open, and `number` outlives the call.
        unsafe { sys::ffghdn(self.handle.as_ptr(), &raw mut number) };
        usize::try_from(number - 1).unwrap_or(0)
    }

    /// Sets the scale and the zero of the current image, in place of those of its header, which stay in the file.
    pub(crate) fn set_scaling(&mut self, (scale, zero): (f64, f64)) -> Result<(), IoError> {
        // SAFETY: the handle is open.
        self.call("setting the scale of an image", |fits, status| unsafe {
            sys::ffpscl(fits, scale, zero, status)
        })
    }

    /// Computes the cards `DATASUM` and `CHECKSUM` of the current HDU.
    pub(crate) fn renew_checksum(&mut self) -> Result<(), IoError> {
        // SAFETY: the handle is open.
        self.call("writing the checksum", |fits, status| unsafe {
            sys::ffpcks(fits, status)
        })
    }

    /// Writes pixels of the image, from pixel `first` (0-based) on.
    pub(crate) fn write_pixels<T: Copy + 'static>(
        &mut self,
        first: usize,
        pixels: &[T],
    ) -> Result<(), IoError> {
        let (first, count) = (first as sys::LONGLONG + 1, pixels.len() as sys::LONGLONG);
        let data = pixels.as_ptr().cast_mut().cast();
        // SAFETY: `pixels` holds the stated number of values, of the type that `datatype` names.
        // CFITSIO's prototype lacks a `const`, but CFITSIO copies the values into its own buffer
        // before it changes their byte order.
        self.call("writing pixels", |fits, status| unsafe {
            sys::ffppr(fits, datatype::<T>(), first, count, data, status)
        })
    }

    /// Appends a card to the header of the current HDU.
    pub(crate) fn write_card(&mut self, card: &Card) -> Result<(), IoError> {
        card.records()
            .iter()
            .try_for_each(|record| self.write_record(record))
    }

    /// Adds a record at the end of the header.
    pub(crate) fn write_record(&mut self, record: &Record) -> Result<(), IoError> {
        let mut text = [0; RECORD + 1];
        text[..RECORD].copy_from_slice(record);
        // SAFETY: `text` is NUL-terminated and at most 80 characters long.
        self.call("writing a header card", |fits, status| unsafe {
            sys::ffprec(fits, text.as_ptr().cast::<c_char>(), status)
        })
    }

    /// Reserves room in the header for `count` further records, at most [`RESERVE_LIMIT`]. Call it
    /// after the cards of the header are written and before the pixels.
    pub(crate) fn reserve_records(&mut self, count: usize) -> Result<(), IoError> {
        let count = count.min(RESERVE_LIMIT) as c_int;
        // SAFETY: the handle is open.
        self.call("reserving room in a header", |fits, status| unsafe {
            sys::ffhdef(fits, count, status)
        })
    }

    /// Removes the last `count` records of the header.
    pub(crate) fn remove_records(&mut self, count: usize) -> Result<(), IoError> {
        const DOING: &str = "removing a header card";
        let mut last = 0;
        // SAFETY: the handle is open. The pointer for the number of free records may be null.
        self.call(DOING, |fits, status| unsafe {
            sys::ffghsp(fits, &raw mut last, ptr::null_mut(), status)
        })?;
        // SAFETY: the handle is open. CFITSIO returns an error for a record that does not exist.
        (1..=last).rev().take(count).try_for_each(|number| {
            self.call(DOING, |fits, status| unsafe { sys::ffdrec(fits, number, status) })
        })
    }

    /// Adds a binary table. `columns` are the name and the TFORM of each column.
    pub(crate) fn create_table(
        &mut self,
        name: &str,
        rows: usize,
        columns: &[(&str, String)],
    ) -> Result<(), IoError> {
        let owned = |text: &str| CString::new(text).expect("names in this crate have no NUL");
        let extname = owned(name);
        let names: Vec<CString> = columns.iter().map(|(name, _)| owned(name)).collect();
        let forms: Vec<CString> = columns.iter().map(|(_, form)| owned(form)).collect();
        let pointers =
            |texts: &[CString]| -> Vec<_> { texts.iter().map(|text| text.as_ptr().cast_mut()).collect() };
        let (mut names_c, mut forms_c) = (pointers(&names), pointers(&forms));
        self.writes_image = false;
        let (rows, count) = (rows as sys::LONGLONG, columns.len() as c_int);
        let (names, forms, units) = (names_c.as_mut_ptr(), forms_c.as_mut_ptr(), ptr::null_mut());
        // SAFETY: each list holds one NUL-terminated string per column. The strings live until the
        // call returns, and CFITSIO only reads them. A null pointer stands for "no units".
        self.call("creating a table", |fits, status| unsafe {
            let kind = sys::BINARY_TBL as c_int;
            sys::ffcrtb(
                fits,
                kind,
                rows,
                count,
                names,
                forms,
                units,
                extname.as_ptr(),
                status,
            )
        })
    }

    /// Writes values to a column, starting at its first row. `column` is counted from 1.
    pub(crate) fn write_column<T: Copy + 'static>(
        &mut self,
        column: usize,
        values: &[T],
    ) -> Result<(), IoError> {
        let (column, count) = (column as c_int, values.len() as sys::LONGLONG);
        let data = values.as_ptr().cast_mut().cast();
        // SAFETY: as in `write_pixels`.
        self.call("writing a table column", |fits, status| unsafe {
            sys::ffpcl(fits, datatype::<T>(), column, 1, 1, count, data, status)
        })
    }

    /// Writes logical values to a column, starting at its first row. `column` is counted from 1.
    pub(crate) fn write_flags(&mut self, column: usize, values: &[bool]) -> Result<(), IoError> {
        let values: Vec<c_char> = values.iter().map(|&value| c_char::from(value)).collect();
        let (column, count) = (column as c_int, values.len() as sys::LONGLONG);
        let data = values.as_ptr().cast_mut().cast();
        // SAFETY: as in `write_pixels`. CFITSIO takes a `char` for each logical value.
        self.call("writing a table column", |fits, status| unsafe {
            sys::ffpcl(fits, sys::TLOGICAL as c_int, column, 1, 1, count, data, status)
        })
    }

    /// Calls a function of CFITSIO and checks its status.
    fn call(
        &mut self,
        doing: &'static str,
        function: impl FnOnce(*mut sys::fitsfile, *mut c_int) -> c_int,
    ) -> Result<(), IoError> {
        let mut status = 0;
        function(self.handle.as_ptr(), &raw mut status);
        self.check(status, doing)
    }

    fn check(&self, status: c_int, doing: &'static str) -> Result<(), IoError> {
        // Only a file open for reading has a source.
        check(&self.path, status, doing, self.source.is_none())
    }
}

impl Drop for Fits {
    fn drop(&mut self) {
        let (mut emptied, mut status) = (0, 0);
        if self.writes_image {
            // An unfinished file is of no use. CFITSIO would fill up an incomplete image of any
            // size with zeros, so the image is made empty first.
            let (fits, keyword) = (self.handle.as_ptr(), c"NAXIS".as_ptr());
            // SAFETY: the handle is open and the keyword is NUL-terminated. A null pointer keeps
            // the comment.
            unsafe { sys::ffmkyj(fits, keyword, 0, ptr::null(), &raw mut emptied) };
        }
        // SAFETY: the handle is open and not used again.
        unsafe { sys::ffclos(self.handle.as_ptr(), &raw mut status) };
        if emptied != 0 || status != 0 {
            // SAFETY: `ffcmsg` only clears CFITSIO's message stack, which a lock protects.
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

/// The error for a status, with CFITSIO's text and the messages on its stack. If a system call
/// fails while a file is written, the error has the reason of the operating system instead.
fn failure(path: &Path, doing: &'static str, status: c_int, writes: bool) -> IoError {
    // CFITSIO does not keep the system's reason. It returns at once when the C library fails, so
    // `errno` still holds the reason. This line must be the first of the function.
    let system = std::io::Error::last_os_error();
    let mut buffer = [0 as c_char; sys::FLEN_ERRMSG as usize];
    const { assert!(sys::FLEN_STATUS <= sys::FLEN_ERRMSG) };
    // SAFETY: the buffer is longer than any status text (30 characters and NUL).
    unsafe { sys::ffgerr(status, buffer.as_mut_ptr()) };
    let mut text = text_of(&buffer);
    // SAFETY: the buffer is as long as any message (80 characters and NUL).
    while unsafe { sys::ffgmsg(buffer.as_mut_ptr()) } != 0 {
        text = text + ", " + &text_of(&buffer);
    }
    if writes && SYSTEM_FAILURES.contains(&status) && system.raw_os_error().is_some_and(|code| code != 0) {
        return unwritable(path)(system);
    }
    let kind = if writes {
        IoErrorKind::Write
    } else {
        IoErrorKind::Read
    };
    IoError::new(path, kind, format!("{doing}: CFITSIO error {status}: {text}"))
}

/// The text before the first NUL.
fn text_of(buffer: &[c_char]) -> String {
    let bytes: Vec<u8> = buffer.iter().take_while(|&&c| c != 0).map(|&c| c as u8).collect();
    String::from_utf8_lossy(&bytes).trim().to_owned()
}

/// CFITSIO's code for a type.
fn datatype<T: 'static>() -> c_int {
    let types = [
        (TypeId::of::<f32>(), sys::TFLOAT),
        (TypeId::of::<f64>(), sys::TDOUBLE),
        (TypeId::of::<c_int>(), sys::TINT),
        (TypeId::of::<i64>(), sys::TLONGLONG),
    ];
    let found = types.iter().find(|(id, _)| *id == TypeId::of::<T>());
    found.expect("values are f32, f64, i32 or i64").1 as c_int
}

/// Returns the absolute name, because CFITSIO would drop leading blanks and expand a leading `~`.
fn c_name(at: &Path, path: &Path) -> Result<CString, IoError> {
    let refused = || {
        let problem = format!(
            "CFITSIO accepts file names of at most {NAME_LIMIT} bytes (with the directories) without a NUL character: use another name"
        );
        IoError::new(path, IoErrorKind::Limit, problem)
    };
    let absolute = std::path::absolute(at).map_err(unreadable(path))?;
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
            let error = Fits::open(&FitsSource::new(bad, None)).unwrap_err().to_string();
            assert!(error.contains("CFITSIO accepts file names of at most"), "{error}");
        }
    }
}

//! Writing through CFITSIO.

use std::ffi::{CString, c_char, c_int};
use std::ptr;

use fitsio::sys;
use psf_types::Real;

use super::{Fits, datatype};
use crate::IoError;
use crate::card::{RECORD, Record};

/// CFITSIO counts the bytes of reserved records in an `int`, and a header much longer than this (8 MB) is not read back.
const RESERVE_LIMIT: usize = 100_000;

impl Fits {
    /// Adds an image HDU for values of type `T`; `shape` in array order (x last).
    pub(crate) fn create_image<T: Real>(&mut self, shape: &[usize]) -> Result<(), IoError> {
        let bitpix = if size_of::<T>() == size_of::<f32>() {
            sys::FLOAT_IMG
        } else {
            sys::DOUBLE_IMG
        };
        self.create_image_of(shape, bitpix)
    }

    /// Adds an image HDU of one of CFITSIO's image types.
    pub(super) fn create_image_of(&mut self, shape: &[usize], bitpix: c_int) -> Result<(), IoError> {
        let mut axes: Vec<sys::LONGLONG> = shape.iter().rev().map(|&n| n as sys::LONGLONG).collect();
        let mut status = 0;
        // SAFETY: the handle is open and `axes` holds the number of values announced.
        unsafe {
            sys::ffcrimll(
                self.handle.as_ptr(),
                bitpix,
                axes.len() as c_int,
                axes.as_mut_ptr(),
                &raw mut status,
            )
        };
        self.writes_image = true;
        self.check(status, "creating an image")
    }

    /// Writes pixels of the image, from pixel `first` (0-based) on.
    pub(crate) fn write_pixels<T: Real>(&mut self, first: usize, pixels: &[T]) -> Result<(), IoError> {
        let mut status = 0;
        // SAFETY: `pixels` holds the number of values announced, of the type that `datatype` names. CFITSIO's prototype
        // lacks a `const`; it copies the values into a buffer of its own before it changes their byte order.
        unsafe {
            sys::ffppr(
                self.handle.as_ptr(),
                datatype::<T>(),
                first as sys::LONGLONG + 1,
                pixels.len() as sys::LONGLONG,
                pixels.as_ptr().cast_mut().cast(),
                &raw mut status,
            )
        };
        self.check(status, "writing pixels")
    }

    /// Adds a record at the end of the header.
    pub(crate) fn write_record(&mut self, record: &Record) -> Result<(), IoError> {
        let mut text = [0; RECORD + 1];
        text[..RECORD].copy_from_slice(record);
        let mut status = 0;
        // SAFETY: `text` is NUL-terminated and at most 80 characters long.
        unsafe {
            sys::ffprec(
                self.handle.as_ptr(),
                text.as_ptr().cast::<c_char>(),
                &raw mut status,
            )
        };
        self.check(status, "writing a header card")
    }

    /// Leaves room in the header for this many records more, [`RESERVE_LIMIT`] at most; to be called after its cards and before
    /// the pixels.
    pub(crate) fn reserve_records(&mut self, count: usize) -> Result<(), IoError> {
        let count = count.min(RESERVE_LIMIT) as c_int;
        let mut status = 0;
        // SAFETY: the handle is open.
        unsafe { sys::ffhdef(self.handle.as_ptr(), count, &raw mut status) };
        self.check(status, "reserving room in a header")
    }

    /// Removes the last records of the header.
    pub(crate) fn remove_records(&mut self, count: usize) -> Result<(), IoError> {
        let (mut last, mut status) = (0, 0);
        // SAFETY: the handle is open; a null pointer for the room left is allowed.
        unsafe {
            sys::ffghsp(
                self.handle.as_ptr(),
                &raw mut last,
                ptr::null_mut(),
                &raw mut status,
            )
        };
        for number in (1..=last).rev().take(count) {
            // SAFETY: the handle is open; CFITSIO refuses a record that is not there.
            unsafe { sys::ffdrec(self.handle.as_ptr(), number, &raw mut status) };
        }
        self.check(status, "removing a header card")
    }

    /// Adds a binary table with columns (name, TFORM).
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
        let pointers = |texts: &[CString]| {
            texts
                .iter()
                .map(|text| text.as_ptr().cast_mut())
                .collect::<Vec<_>>()
        };
        let (mut names_c, mut forms_c) = (pointers(&names), pointers(&forms));
        self.writes_image = false;
        let mut status = 0;
        // SAFETY: both lists hold as many NUL-terminated strings as there are columns, which live until the call returns
        // and which CFITSIO only reads; a null pointer stands for "no units".
        unsafe {
            sys::ffcrtb(
                self.handle.as_ptr(),
                sys::BINARY_TBL as c_int,
                rows as sys::LONGLONG,
                columns.len() as c_int,
                names_c.as_mut_ptr(),
                forms_c.as_mut_ptr(),
                ptr::null_mut(),
                extname.as_ptr(),
                &raw mut status,
            )
        };
        self.check(status, "creating a table")
    }

    /// Writes a column, counted from 1, from its first row on.
    pub(crate) fn write_column(&mut self, column: usize, values: &[f64]) -> Result<(), IoError> {
        let mut status = 0;
        // SAFETY: as in `write_pixels`.
        unsafe {
            sys::ffpcl(
                self.handle.as_ptr(),
                sys::TDOUBLE as c_int,
                column as c_int,
                1,
                1,
                values.len() as sys::LONGLONG,
                values.as_ptr().cast_mut().cast(),
                &raw mut status,
            )
        };
        self.check(status, "writing a table column")
    }
}

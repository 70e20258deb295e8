//! Writing through CFITSIO.

use std::ffi::{CString, c_char, c_int};
use std::ptr;

use fitsio::sys;
use psf_types::Real;

use super::{Fits, datatype};
use crate::IoError;
use crate::card::{RECORD, Record};

impl Fits {
    /// Adds an image HDU for values of type `T`; `shape` in array order (x last).
    pub(crate) fn create_image<T: Real>(&mut self, shape: &[usize]) -> Result<(), IoError> {
        let mut axes: Vec<sys::LONGLONG> = shape.iter().rev().map(|&n| n as sys::LONGLONG).collect();
        let bitpix = if size_of::<T>() == size_of::<f32>() {
            sys::FLOAT_IMG
        } else {
            sys::DOUBLE_IMG
        };
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
        self.check(status, "creating an image")
    }

    /// Writes the pixels of the image, from the first on.
    pub(crate) fn write_pixels<T: Real>(&mut self, pixels: &[T]) -> Result<(), IoError> {
        let mut status = 0;
        // SAFETY: `pixels` holds the number of values announced, of the type that `datatype` names. CFITSIO's prototype
        // lacks a `const`; it copies the values into a buffer of its own before it changes their byte order.
        unsafe {
            sys::ffppr(
                self.handle.as_ptr(),
                datatype::<T>(),
                1,
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

//! The folder of the data and the readers of its files.

use std::path::{Path, PathBuf};

use libtest_mimic::{Failed, Trial};
use psfield::psf_types::{FrameShape, Image, Interpolation, Normalisation, PsfModel, PsfSamples, Real};
use psfield::{FitOptions, Psf, psf_io};

/// The folder where the tests expect the data.
pub(crate) fn expected() -> PathBuf {
    std::env::var_os("PSFIELD_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    )
}

/// Returns whether `PSFIELD_DATA` is set.
pub(crate) fn asked_for() -> bool {
    std::env::var_os("PSFIELD_DATA").is_some()
}

/// The folder of the data, if the data is there.
pub(crate) fn folder() -> Option<PathBuf> {
    Some(expected()).filter(|folder| folder.join("roman/samples1024.fits").is_file())
}

pub(crate) fn file(name: &str) -> PathBuf {
    expected().join(name)
}

/// A named test.
pub(crate) fn trial(name: String, test: impl FnOnce() -> Result<(), Failed> + Send + 'static) -> Trial {
    Trial::test(name, test)
}

/// Fails with the message of `says` unless the condition holds.
pub(crate) fn ensure(holds: bool, says: impl FnOnce() -> String) -> Result<(), Failed> {
    if holds { Ok(()) } else { Err(says().into()) }
}

/// A pixel `(x, y)` and its true value.
pub(crate) type ExactPixel = ((usize, usize), f64);

/// One of the two simulated fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Field {
    pub(crate) name: &'static str,
    size: usize,
}

pub(crate) const ROMAN: Field = Field {
    name: "roman",
    size: 1024,
};
pub(crate) const STRONG: Field = Field {
    name: "strong",
    size: 512,
};

impl Field {
    fn path(self, what: &str) -> PathBuf {
        file(&format!("{}/{what}", self.name))
    }

    pub(crate) fn frame(self) -> Result<FrameShape, Failed> {
        Ok(FrameShape::new(self.size, self.size)?)
    }

    pub(crate) fn samples(self) -> Result<PsfSamples, Failed> {
        Ok(psf_io::read_samples(
            self.path(&format!("samples{}.fits", self.size)),
        )?)
    }

    pub(crate) fn off_grid(self) -> Result<PsfSamples, Failed> {
        Ok(psf_io::read_samples(self.path("off_grid.fits"))?)
    }

    pub(crate) fn scene<T: Real>(self) -> Result<Image<T>, Failed> {
        let image = psf_io::read_image::<T>(self.path(&format!("scene{}.fits", self.size)))?;
        Ok(image.into_parts().0)
    }

    /// The truth of an anchoring, `source` or `output`.
    pub(crate) fn truth(self, anchor: &str) -> Result<Image<f64>, Failed> {
        let name = format!("scene{}_{anchor}.fits", self.size);
        Ok(psf_io::read_image::<f64>(self.path(&name))?.into_parts().0)
    }

    /// Exact values of the truth at some pixels.
    pub(crate) fn exact(self, anchor: &str) -> Result<Vec<ExactPixel>, Failed> {
        let name = format!("scene{}_{anchor}_f64.csv", self.size);
        let [y, x, value] = psf_io::read_columns(self.path(&name), ["y", "x", "value"])?;
        Ok(x.iter()
            .zip(&y)
            .zip(value)
            .map(|((&x, &y), v)| ((x as usize, y as usize), v))
            .collect())
    }

    /// A column of the measurements of the off-grid stamps.
    pub(crate) fn measured(self, column: &str) -> Result<Vec<f64>, Failed> {
        let [values] = psf_io::read_columns(self.path("off_grid_measurements.csv"), [column])?;
        Ok(values)
    }

    /// The unscaled samples with bilinear interpolation. The truths were made from these.
    pub(crate) fn psf(self, options: FitOptions) -> Result<Psf, Failed> {
        let options = FitOptions {
            interpolation: Interpolation::Bilinear,
            normalisation: Normalisation::Keep,
            ..options
        };
        Ok(Psf::new(self.samples()?, options))
    }

    /// The model of [`psf`](Self::psf).
    pub(crate) fn model(self, options: FitOptions) -> Result<PsfModel, Failed> {
        Ok(self.psf(options)?.model()?.clone())
    }
}

//! Files that psfield writes, read by GalSim (`DES_PSFEx`) and photutils (`GriddedPSFModel`).
//!
//! `PSFIELD_PYTHON`, or else `python3`, must be a Python with `python/tests/requirements.txt`
//! installed. Without it, these tests show as ignored.

mod read_back;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use libtest_mimic::{Arguments, Trial};

fn main() {
    let arguments = Arguments::from_args();
    let available = has_readers();
    if !available {
        assert!(
            std::env::var_os("PSFIELD_PYTHON").is_none(),
            "PSFIELD_PYTHON is set, but {} does not import galsim and photutils",
            python().display()
        );
        eprintln!(
            "other software: {} does not import galsim and photutils; its tests are skipped and show as ignored",
            python().display()
        );
    }
    let trials = read_back::trials()
        .into_iter()
        .map(|trial: Trial| trial.with_ignored_flag(!available))
        .collect();
    libtest_mimic::run(&arguments, trials).exit();
}

/// The Python interpreter that runs the scripts.
fn python() -> PathBuf {
    std::env::var_os("PSFIELD_PYTHON").map_or_else(|| "python3".into(), PathBuf::from)
}

/// The path of a script of this package.
fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("python").join(name)
}

fn has_readers() -> bool {
    Command::new(python())
        .args(["-c", "import galsim.des, photutils.psf, astropy.io.fits"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

//! A folder with small samples and scenes in which `psfield` is run.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Command, Output};

use ndarray::{Array2, Array3};
use psfield::psf_io::{self, Card, HeaderCards, Precision};
use psfield::psf_types::{FrameShape, Image, Position, PsfSamples, SamplePositions, StampGrid};
use serde_json::Value;
use tempfile::TempDir;

/// The field. The middle one of 3 x 3 samples over it lies at the centre of a pixel.
pub(crate) const NX: usize = 61;
pub(crate) const NY: usize = 51;
/// Columns and rows of a stamp at the frame's pixels.
pub(crate) const STAMP: usize = 15;

/// A temporary folder, to which file names are relative.
pub(crate) struct Desk(TempDir);

/// The output of a run.
#[derive(Debug)]
pub(crate) struct Run {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Run {
    pub(crate) fn of(output: Output) -> Self {
        Self {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// The object of `--json`, which must be all of standard output.
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e} in {self:?}"))
    }
}

impl Desk {
    pub(crate) fn empty() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// A folder with `samples.fits` (3 x 3) and `scene.fits`.
    pub(crate) fn new() -> Self {
        let desk = Self::empty();
        desk.write_samples("samples.fits", &samples(3, 1));
        desk.write_image("scene.fits", scene());
        desk
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), content).unwrap();
    }

    pub(crate) fn bytes(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    pub(crate) fn write_samples(&self, name: &str, samples: &PsfSamples) {
        psf_io::write_samples(self.path(name), samples, &[], Precision::Double, true).unwrap();
    }

    pub(crate) fn write_image(&self, name: &str, pixels: Array2<f64>) {
        let cards = [
            Card::new("TELESCOP", "Small One", "where the scene comes from").unwrap(),
            Card::new("CRPIX1", 20.5, "").unwrap(),
            Card::new("CRPIX2", 30.0, "").unwrap(),
        ];
        let image = Image::new(pixels).unwrap();
        psf_io::write_image(self.path(name), &image, &HeaderCards::new(), &cards, true).unwrap();
    }

    pub(crate) fn image(&self, name: &str) -> Array2<f64> {
        let image = psf_io::read_image::<f64>(self.path(name)).unwrap();
        image.into_parts().0.into_pixels()
    }

    pub(crate) fn header(&self, name: &str) -> HeaderCards {
        psf_io::read_header(self.path(name)).unwrap()
    }

    pub(crate) fn samples(&self, name: &str) -> PsfSamples {
        psf_io::read_samples(self.path(name)).unwrap()
    }

    /// The names in the folder that begin like a temporary file's.
    pub(crate) fn temporaries(&self) -> Vec<PathBuf> {
        let found = std::fs::read_dir(self.0.path()).unwrap();
        found
            .map(|entry| entry.unwrap().path())
            .filter(|path| {
                path.file_name()
                    .unwrap()
                    .to_str()
                    .unwrap()
                    .starts_with(".psfield-")
            })
            .collect()
    }

    /// Runs a shell command in the folder. `$PSFIELD` is the program.
    pub(crate) fn shell(&self, line: &str) -> Run {
        Run::of(self.shell_command(line).output().unwrap())
    }

    pub(crate) fn shell_command(&self, line: &str) -> Command {
        let mut shell = Command::new("sh");
        shell
            .args(["-c", line])
            .env("PSFIELD", env!("CARGO_BIN_EXE_psfield"))
            .env("SOURCE_DATE_EPOCH", "0")
            .current_dir(self.0.path());
        shell
    }

    /// All files with their content.
    pub(crate) fn content(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut found = BTreeMap::new();
        let mut folders = vec![self.0.path().to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let content = std::fs::read(&path).unwrap();
                    found.insert(path, content);
                }
            }
        }
        found
    }

    /// Runs `psfield` with arguments separated by blanks.
    pub(crate) fn run(&self, arguments: &str) -> Run {
        let output = Command::new(env!("CARGO_BIN_EXE_psfield"))
            .args(arguments.split_whitespace())
            .env("SOURCE_DATE_EPOCH", "0")
            .current_dir(self.0.path())
            .output()
            .unwrap();
        Run::of(output)
    }

    /// Runs `psfield`, which must succeed without any warning.
    pub(crate) fn done(&self, arguments: &str) -> Run {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(0), "psfield {arguments}: {run:?}");
        assert_eq!(run.stderr, "", "psfield {arguments}");
        run
    }

    /// Runs `psfield`, which must succeed. Drivers of GPUs may write to standard error.
    pub(crate) fn done_with_drivers(&self, arguments: &str) -> Run {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(0), "psfield {arguments}: {run:?}");
        assert!(!run.stderr.contains("psfield: "), "psfield {arguments}: {run:?}");
        run
    }

    /// Runs `psfield`, which must succeed with a warning that contains `needle`, and without it
    /// under `-q`.
    pub(crate) fn warned(&self, arguments: &str, needle: &str) {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(0), "psfield {arguments}: {run:?}");
        assert!(
            run.stderr.starts_with("psfield: warning: ") && run.stderr.contains(needle),
            "psfield {arguments}: {run:?}"
        );
        self.done(&format!("{arguments} --overwrite -q"));
    }

    /// Runs `psfield`, which must succeed and print only notes. Each of `needles` must be in one of
    /// them. Under `-q` it must print nothing.
    pub(crate) fn noted(&self, arguments: &str, needles: &[&str]) -> Run {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(0), "psfield {arguments}: {run:?}");
        let notes = |run: &Run| run.stderr.lines().all(|line| line.starts_with("psfield: note: "));
        assert!(notes(&run), "psfield {arguments}: {run:?}");
        for needle in needles {
            assert!(
                run.stderr.contains(needle),
                "psfield {arguments}: {needle:?} is missing in {}",
                run.stderr
            );
        }
        self.done(&format!("{arguments} --overwrite -q"));
        run
    }

    /// Runs `psfield`, which must end with this status, print each of `needles` on standard error
    /// and nothing on standard output, and leave the folder as it was.
    pub(crate) fn refused(&self, arguments: &str, code: i32, needles: &[&str]) {
        let before = self.content();
        let run = self.run(arguments);
        assert_eq!(run.code, Some(code), "psfield {arguments}: {run:?}");
        for needle in needles {
            assert!(
                run.stderr.contains(needle),
                "psfield {arguments}: {needle:?} is missing in {}",
                run.stderr
            );
        }
        assert!(!run.stderr.contains("panicked"), "{run:?}");
        assert_eq!(run.stdout, "", "psfield {arguments}");
        let after = self.content();
        assert!(
            before == after,
            "psfield {arguments}: the folder changed: {:?}",
            after.keys()
        );
    }
}

/// A Gaussian at the pixels of a stamp. Its widths change over the field, and its sum is not 1.
pub(crate) fn psf(position: Position, x: f64, y: f64) -> f64 {
    let (u, v) = (position.x() / NX as f64, position.y() / NY as f64);
    let (sigma_x, sigma_y) = (1.2 + 0.5 * u + 0.2 * v * v, 1.3 + 0.4 * v - 0.2 * u * v);
    (-0.5 * ((x / sigma_x).powi(2) + (y / sigma_y).powi(2))).exp()
}

/// Samples on a regular grid of `across` x `across` over the field, each of unit flux.
pub(crate) fn samples(across: usize, oversampling: usize) -> PsfSamples {
    let at = |k: usize, n: usize| (n - 1) as f64 * k as f64 / (across - 1) as f64;
    let positions = (0..across * across).map(|k| (at(k % across, NX), at(k / across, NY)));
    samples_at(&positions.collect::<Vec<_>>(), oversampling)
}

/// Samples anywhere, each of unit flux.
pub(crate) fn samples_at(positions: &[(f64, f64)], oversampling: usize) -> PsfSamples {
    let field = FrameShape::new(NX, NY).unwrap();
    let positions: Vec<Position> = positions
        .iter()
        .map(|&(x, y)| Position::new(x, y).unwrap())
        .collect();
    let (size, s) = (STAMP * oversampling, oversampling as f64);
    let offset = |k: usize| (k as f64 - (size / 2) as f64) / s;
    let stamps = Array3::from_shape_fn((positions.len(), size, size), |(j, y, x)| {
        psf(positions[j], offset(x), offset(y))
    });
    let grid = StampGrid::new(size, size).unwrap().with_oversampling(s).unwrap();
    let positions = SamplePositions::new(positions, Some(field)).unwrap();
    PsfSamples::new(stamps, positions, grid).unwrap().into_unit_flux()
}

/// Points and a smooth patch, so far from the edges that no light leaves the frame.
pub(crate) fn scene() -> Array2<f64> {
    Array2::from_shape_fn((NY, NX), |(y, x)| {
        let inside = (8..NX - 8).contains(&x) && (8..NY - 8).contains(&y);
        let point = if (7 * x + 13 * y) % 29 == 0 { 40.0 } else { 0.0 };
        let smooth = (-0.01 * ((x as f64 - 25.0).powi(2) + (y as f64 - 30.0).powi(2))).exp();
        if inside { point + 5.0 * smooth } else { 0.0 }
    })
}

/// A scene with light in the pixels `(x, y, flux)`.
pub(crate) fn points(lit: &[(usize, usize, f64)]) -> Array2<f64> {
    let mut pixels = Array2::zeros((NY, NX));
    for &(x, y, flux) in lit {
        pixels[[y, x]] = flux;
    }
    pixels
}

/// The largest difference over the peak of the second.
pub(crate) fn difference(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    assert_eq!(a.dim(), b.dim());
    let peak = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    assert!(peak > 0.0);
    a.iter().zip(b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / peak
}

/// Checks that an object has all these keys.
pub(crate) fn assert_keys(object: &Value, keys: &[&str]) {
    for key in keys {
        assert!(object.get(key).is_some(), "no {key} in {object}");
    }
}

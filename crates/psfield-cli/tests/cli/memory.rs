//! Little memory: a command succeeds or fails with exit status 1, and leaves no half file.

use ndarray::{Array2, Array3};
use psfield::psf_io::{self, Precision};
use psfield::psf_types::{FrameShape, Position, PsfSamples, SamplePositions, StampGrid};

use crate::desk::Desk;

/// Pixels along each side of the scene.
const SIDE: usize = 2000;
/// Samples along each side of the field.
const ACROSS: usize = 20;
const STAMP: usize = 49;
/// Limits of the address space (MB). The smallest allows nothing, the largest everything.
const LIMITS: [usize; 20] = [
    100, 125, 150, 175, 200, 225, 250, 275, 300, 350, 400, 450, 500, 600, 700, 800, 1000, 1200, 1500, 2000,
];

fn desk() -> Desk {
    let desk = Desk::empty();
    let step = (SIDE - 1) as f64 / (ACROSS - 1) as f64;
    let at = |j: usize| Position::new((j % ACROSS) as f64 * step, (j / ACROSS) as f64 * step).unwrap();
    let positions: Vec<Position> = (0..ACROSS * ACROSS).map(at).collect();
    let stamps = Array3::from_shape_fn((positions.len(), STAMP, STAMP), |(j, y, x)| {
        let centre = (STAMP / 2) as f64;
        let (sigma, u, v) = (2.0 + 0.01 * j as f64, x as f64 - centre, y as f64 - centre);
        (-(u * u + v * v) / (2.0 * sigma * sigma)).exp()
    });
    let field = FrameShape::new(SIDE, SIDE).unwrap();
    let positions = SamplePositions::new(positions, Some(field)).unwrap();
    let samples = PsfSamples::new(stamps, positions, StampGrid::new(STAMP, STAMP).unwrap()).unwrap();
    psf_io::write_samples(desk.path("samples.fits"), &samples, &[], Precision::Double, true).unwrap();
    desk.write_image(
        "scene.fits",
        Array2::from_shape_fn((SIDE, SIDE), |(y, x)| 100.0 + ((x * 7 + y * 13) % 101) as f64),
    );
    desk
}

#[cfg(target_os = "linux")]
#[test]
fn a_lack_of_memory_is_an_error_and_no_crash() {
    let desk = desk();
    let given = desk.content();
    for command in [
        "fit samples.fits -o out.fits",
        "simulate scene.fits --psf samples.fits -o out.fits",
        "sample scene.fits -o out.fits",
        "sample --preset survey-2m --uniform 3,3 -o out.fits",
        "expose scene.fits --photon-noise -o out.fits",
        "measure samples.fits -o out.csv",
        "compare scene.fits scene.fits",
    ] {
        let mut short = 0;
        for limit in LIMITS {
            let limited = format!(
                "ulimit -v {}; exec \"$PSFIELD\" {command} --threads 2",
                limit * 1000
            );
            let run = desk.shell(&limited);
            let failed = run.code == Some(1) && run.stderr.contains("psfield: error: ");
            assert!(run.code == Some(0) || failed, "{command}, {limit} MB: {run:?}");
            let outputs = ["out.fits", "out.csv"].map(|name| desk.path(name));
            for output in outputs.iter().filter(|path| path.exists()) {
                assert_eq!(run.code, Some(0), "{command}, {limit} MB: {run:?}");
                std::fs::remove_file(output).unwrap();
            }
            short += usize::from(run.stderr.contains("not enough memory"));
        }
        // The other commands need little.
        let is_large = command.starts_with("fit") || command.starts_with("simulate");
        assert!(short > 0 || !is_large, "{command}: no limit was too small");
    }
    for left in desk.temporaries() {
        std::fs::remove_file(left).unwrap();
    }
    assert!(given == desk.content());
}

/// A check of stars through large stamps needs little more memory than the run itself.
#[cfg(target_os = "linux")]
#[test]
fn a_spot_check_needs_little_memory() {
    const STAMP: usize = 1023;
    /// The interpolated stamps of all stars would take 0.8 GB. The check may take this much (MB).
    const MORE: usize = 250;
    let desk = Desk::empty();
    let stamps = Array3::from_shape_fn((1, STAMP, STAMP), |(_, y, x)| {
        let [u, v] = [x, y].map(|v| v as f64 - (STAMP / 2) as f64);
        (1.0 + (u * u + v * v) / 9.0).powi(-2)
    });
    let positions = SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap();
    let samples = PsfSamples::new(stamps, positions, StampGrid::new(STAMP, STAMP).unwrap()).unwrap();
    psf_io::write_samples(desk.path("large.fits"), &samples, &[], Precision::Double, true).unwrap();
    let rows: Vec<String> = (0..100)
        .map(|i| format!("{}.3,{}.6,100", 10 * (i % 10), 10 * (i / 10)))
        .collect();
    desk.write("stars.csv", format!("x,y,flux\n{}\n", rows.join("\n")));
    let run = |check: usize, name: &str| {
        let command = format!(
            "simulate --psf large.fits --catalog stars.csv --shape 100,100 --spot-check {check} -o {name} --json --threads 2 -q"
        );
        let report = desk.done(&command).json();
        let verdict = report["spot_check"]["passed"].clone();
        (
            report["peak_memory_bytes"].as_u64().unwrap() as usize >> 20,
            verdict,
        )
    };
    let (alone, _) = run(0, "alone.fits");
    let (checked, verdict) = run(200, "checked.fits");
    assert_eq!(verdict, true);
    assert!(checked < alone + MORE, "{alone} and {checked} MiB");
}

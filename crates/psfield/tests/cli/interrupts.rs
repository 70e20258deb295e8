//! Ctrl-C and other signals in the middle of a run: the old file stays, nothing else does, and the next run works.

use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use ndarray::{Array2, Array3};
use psfield::psf_io::{self, Precision};
use psfield::psf_types::{FrameShape, Position, PsfSamples, SamplePositions, StampGrid};

use crate::desk::{Desk, Run};

/// A frame that takes a second or more to simulate: 72 MB.
const SIDE: usize = 3000;
/// What must be in the temporary file when the signal comes: more than headers, less than the frame.
const BEGUN: u64 = 1 << 20;
/// Longer than any run here takes.
const PATIENCE: Duration = Duration::from_secs(300);
const OLD: &str = "what was there before";
const SIMULATE: &str = "simulate scene.fits --psf samples.fits --stream --spot-check 0 --threads 1 --precision f64 -o out.fits --overwrite";

/// A large scene, and the PSFs of its field.
fn desk() -> Desk {
    let desk = Desk::empty();
    let field = FrameShape::new(SIDE, SIDE).unwrap();
    let far = (SIDE - 1) as f64;
    let positions = [(0.0, 0.0), (far, 0.0), (0.0, far), (far, far)];
    let positions = positions.map(|(x, y)| Position::new(x, y).unwrap()).to_vec();
    let stamps = Array3::from_shape_fn((4, 31, 31), |(j, y, x)| {
        let (sigma, u, v) = (2.0 + 0.4 * j as f64, x as f64 - 15.0, y as f64 - 15.0);
        (-(u * u + v * v) / (2.0 * sigma * sigma)).exp()
    });
    let positions = SamplePositions::new(positions, Some(field)).unwrap();
    let samples = PsfSamples::new(stamps, positions, StampGrid::new(31, 31).unwrap()).unwrap();
    psf_io::write_samples(desk.path("samples.fits"), &samples, &[], Precision::Double, true).unwrap();
    desk.write_image(
        "scene.fits",
        Array2::from_shape_fn((SIDE, SIDE), |(y, x)| ((x * 7 + y * 13) % 101) as f64),
    );
    desk.write("out.fits", OLD);
    desk
}

/// Starts a run by a line of a shell, and waits until its output is partly written.
fn begun(desk: &Desk, line: &str) -> Child {
    let mut child = desk
        .shell_command(line)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let clock = Instant::now();
    let written = || {
        desk.temporaries()
            .first()
            .and_then(|path| path.metadata().ok())
            .map_or(0, |m| m.len())
    };
    while written() < BEGUN {
        assert!(
            child.try_wait().unwrap().is_none(),
            "{line} ended before its output had begun"
        );
        assert!(clock.elapsed() < PATIENCE, "{line} writes nothing");
        std::thread::sleep(Duration::from_millis(1));
    }
    child
}

fn send(signal: &str, child: &Child) {
    let sent = std::process::Command::new("sh")
        // Twice, as `timeout` does.
        .args([
            "-c",
            &format!("kill -{signal} {0} && kill -{signal} {0}", child.id()),
        ])
        .status();
    assert!(sent.unwrap().success());
}

fn run_until(signal: &str, desk: &Desk) -> Run {
    let child = begun(desk, &format!("exec \"$PSFIELD\" {SIMULATE}"));
    send(signal, &child);
    Run::of(child.wait_with_output().unwrap())
}

#[test]
fn signals_leave_the_old_file_and_nothing_else() {
    let desk = desk();
    for (signal, code) in [("INT", 130), ("TERM", 143), ("HUP", 129)] {
        let run = run_until(signal, &desk);
        assert_eq!(run.code, Some(code), "{run:?}");
        assert_eq!(
            run.stderr,
            format!("psfield: stopped by SIG{signal}: out.fits is as it was\n")
        );
        assert_eq!(run.stdout, "");
        assert_eq!(desk.bytes("out.fits"), OLD.as_bytes());
        assert_eq!(desk.temporaries(), Vec::<PathBuf>::new());
    }
    std::fs::remove_file(desk.path("out.fits")).unwrap();
    let run = run_until("INT", &desk);
    assert_eq!(
        run.stderr,
        "psfield: stopped by SIGINT: out.fits was not written\n"
    );
    assert!(!desk.path("out.fits").exists());

    // What is killed cannot remove its file; the next run of the same output does.
    desk.write("out.fits", OLD);
    let run = run_until("KILL", &desk);
    assert_eq!(run.code, None, "{run:?}");
    assert_eq!(desk.bytes("out.fits"), OLD.as_bytes());
    let left = desk.temporaries();
    assert_eq!(left.len(), 1);
    // Another output's run leaves it alone.
    desk.done("preview scene.fits -o scene.png -q --max-size 100");
    assert_eq!(desk.temporaries(), left);
    desk.done(&format!("{SIMULATE} -q"));
    assert_eq!(desk.temporaries(), Vec::<PathBuf>::new());
    assert_eq!(desk.image("out.fits").dim(), (SIDE, SIDE));
}

#[test]
fn runs_of_one_output_leave_each_other_alone() {
    let desk = desk();
    let first = begun(&desk, &format!("exec \"$PSFIELD\" {SIMULATE}"));
    // The temporary file of a run that goes on is no leftover; stopped, so that it does not end before the other.
    send("STOP", &first);
    let left = desk.temporaries();
    desk.done("preview scene.fits -o out.fits --overwrite -q --max-size 100");
    assert_eq!(left.len(), 1);
    assert_eq!(desk.temporaries(), left);
    send("CONT", &first);
    let run = Run::of(first.wait_with_output().unwrap());
    assert_eq!(run.code, Some(0), "{run:?}");
    assert_eq!(desk.image("out.fits").dim(), (SIDE, SIDE));
    assert_eq!(desk.temporaries(), Vec::<PathBuf>::new());
}

/// As `nohup` does, and scripts for what they start in the background.
#[test]
fn signals_that_are_to_be_ignored_are() {
    let desk = desk();
    let child = begun(&desk, &format!("trap '' INT HUP; exec \"$PSFIELD\" {SIMULATE}"));
    send("INT", &child);
    send("HUP", &child);
    let run = Run::of(child.wait_with_output().unwrap());
    assert_eq!(run.code, Some(0), "{run:?}");
    assert_eq!(desk.image("out.fits").dim(), (SIDE, SIDE));
}

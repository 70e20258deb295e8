//! Ctrl-C and other signals during a run: only the old file remains, and the next run works.

use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use ndarray::{Array2, Array3};
use psfield::psf_io::{self, Precision};
use psfield::psf_types::{FrameShape, Position, PsfSamples, SamplePositions, StampGrid};

use crate::desk::{Desk, Run};

/// A frame that takes a second or more to simulate: 72 MB.
const SIDE: usize = 3000;
/// Bytes of the temporary file at which the signal is sent: more than headers, less than the frame.
const BEGUN: u64 = 1 << 20;
/// Number of runs until one is stopped in time.
const ATTEMPTS: usize = 50;
/// Longer than any run of these tests.
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

/// Starts a run by a shell command, and stops it (SIGSTOP) when its output is partly written. A run
/// that ends before is started again.
fn begun(desk: &Desk, line: &str) -> Child {
    let before = desk.path("out.fits").exists().then(|| desk.bytes("out.fits"));
    for _ in 0..ATTEMPTS {
        let mut child = desk
            .shell_command(line)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        if stopped_while_writing(desk, &mut child) {
            return child;
        }
        let run = Run::of(child.wait_with_output().unwrap());
        assert_eq!(run.code, Some(0), "{line} failed: {run:?}");
        match &before {
            Some(bytes) => std::fs::write(desk.path("out.fits"), bytes).unwrap(),
            None => std::fs::remove_file(desk.path("out.fits")).unwrap(),
        }
    }
    panic!("{line} always ends before it can be stopped");
}

fn stopped_while_writing(desk: &Desk, child: &mut Child) -> bool {
    let clock = Instant::now();
    let length = || {
        let path = desk.temporaries().into_iter().next()?;
        path.metadata().ok().map(|m| m.len())
    };
    while length().is_none_or(|written| written < BEGUN) {
        if child.try_wait().unwrap().is_some() {
            return false;
        }
        assert!(clock.elapsed() < PATIENCE, "nothing is written");
        std::thread::sleep(Duration::from_millis(1));
    }
    if !send("STOP", child) {
        return false;
    }
    // The process stops a moment after the signal.
    std::thread::sleep(Duration::from_millis(50));
    child.try_wait().unwrap().is_none() && length().is_some()
}

/// Returns whether the process still existed.
fn send(signal: &str, child: &Child) -> bool {
    let sent = std::process::Command::new("sh")
        .args(["-c", &format!("kill -{signal} {} 2> /dev/null", child.id())])
        .status();
    sent.unwrap().success()
}

/// Returns whether this process ignores the signal of this number, as under `nohup`.
fn is_ignored_here(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

fn run_until(signal: &str, desk: &Desk) -> Run {
    let child = begun(desk, &format!("exec \"$PSFIELD\" {SIMULATE}"));
    send(signal, &child);
    send("CONT", &child);
    // Sends the signal twice, as `timeout` does.
    send(signal, &child);
    Run::of(child.wait_with_output().unwrap())
}

#[test]
fn signals_leave_the_old_file_and_nothing_else() {
    let desk = desk();
    for (signal, code) in [("INT", 130), ("TERM", 143), ("HUP", 129)] {
        if is_ignored_here(code - 128) {
            println!(
                "not tested: whoever started the tests ignores SIG{signal}, and so do the programs that they start"
            );
            continue;
        }
        let run = run_until(signal, &desk);
        assert_eq!(run.code, Some(code), "{run:?}");
        assert_eq!(
            run.stderr,
            format!("psfield: interrupted (SIG{signal}), out.fits is unchanged\n")
        );
        assert_eq!(run.stdout, "");
        assert_eq!(desk.bytes("out.fits"), OLD.as_bytes());
        assert_eq!(desk.temporaries(), Vec::<PathBuf>::new());
    }
    std::fs::remove_file(desk.path("out.fits")).unwrap();
    let run = run_until("TERM", &desk);
    assert_eq!(
        run.stderr,
        "psfield: interrupted (SIGTERM), out.fits was not written\n"
    );
    assert!(!desk.path("out.fits").exists());

    // A killed process cannot remove its file. The next run that writes in the folder removes it.
    desk.write("out.fits", OLD);
    let run = run_until("KILL", &desk);
    assert_eq!(run.code, None, "{run:?}");
    assert_eq!(desk.bytes("out.fits"), OLD.as_bytes());
    let left = desk.temporaries();
    assert_eq!(left.len(), 1);
    desk.done("preview scene.fits -o scene.png -q --max-size 100");
    assert_eq!(desk.temporaries(), Vec::<PathBuf>::new());
    desk.done(&format!("{SIMULATE} -q"));
    assert_eq!(desk.image("out.fits").dim(), (SIDE, SIDE));
}

#[test]
fn runs_of_one_output_leave_each_other_alone() {
    let desk = desk();
    let first = begun(&desk, &format!("exec \"$PSFIELD\" {SIMULATE}"));
    // The temporary file of a running process is kept. That process is stopped, so that it does not
    // end before the other one.
    let left = desk.temporaries();
    desk.done("fit samples.fits -o out.fits --overwrite -q");
    assert_eq!(left.len(), 1);
    assert_eq!(desk.temporaries(), left);
    send("CONT", &first);
    let run = Run::of(first.wait_with_output().unwrap());
    assert_eq!(run.code, Some(0), "{run:?}");
    assert_eq!(desk.image("out.fits").dim(), (SIDE, SIDE));
    assert_eq!(desk.temporaries(), Vec::<PathBuf>::new());
}

/// Signals are ignored by `nohup`, and by scripts for background processes.
#[test]
fn signals_that_are_to_be_ignored_are() {
    let desk = desk();
    let child = begun(&desk, &format!("trap '' INT HUP; exec \"$PSFIELD\" {SIMULATE}"));
    send("INT", &child);
    send("HUP", &child);
    send("CONT", &child);
    let run = Run::of(child.wait_with_output().unwrap());
    assert_eq!(run.code, Some(0), "{run:?}");
    assert_eq!(desk.image("out.fits").dim(), (SIDE, SIDE));
}

/// The number of times that each command is killed. The environment variable PSFIELD_KILLS gives
/// another number.
const KILLS: u64 = 3;

/// Commands that write, and their outputs, the main one first.
const WRITERS: [(&str, &[&str]); 7] = [
    (
        "simulate scene.fits --psf samples.fits --detector ccd.toml --quality flags.fits -o out.fits",
        &["out.fits", "out_truth.fits", "flags.fits"],
    ),
    (
        "expose scene.fits --detector ccd.toml --truth out_truth.fits --quality flags.fits -o out.fits",
        &["out.fits", "out_truth.fits", "flags.fits"],
    ),
    ("fit samples.fits -o out.fits", &["out.fits"]),
    (
        "sample --preset survey-2m --uniform 5,5 -o out.fits",
        &["out.fits"],
    ),
    ("convert samples.fits --to psfex=1 -o out.fits", &["out.fits"]),
    ("evaluate samples.fits --at at.csv -o out.fits", &["out.fits"]),
    ("preview scene.fits -o out.png", &["out.png"]),
];

/// Files get their names one after the other, the main one last.
#[test]
fn a_run_that_is_killed_leaves_its_main_output_with_all_others_or_not_at_all() {
    let desk = desk();
    std::fs::remove_file(desk.path("out.fits")).unwrap();
    desk.write("ccd.toml", "photon_noise = true\nread_noise_e = 5.0\nbits = 16\n");
    desk.write("at.csv", "x,y\n30,40\n");
    let given = desk.content().len();
    let kills = std::env::var("PSFIELD_KILLS").map_or(KILLS, |text| text.parse().unwrap());
    for (line, outputs) in WRITERS {
        let remove = || {
            for name in outputs {
                let _ = std::fs::remove_file(desk.path(name));
            }
        };
        let clock = Instant::now();
        desk.done(&format!("{line} -q"));
        let (whole, mut complete) = (clock.elapsed(), 0);
        remove();
        for round in 0..kills {
            // Multiples of the golden ratio fall everywhere in the run.
            let fraction = (0.618_033_988_75 * (round as f64 + 0.5)).fract();
            let mut child = desk
                .shell_command(&format!("exec \"$PSFIELD\" {line} -q"))
                .spawn()
                .unwrap();
            std::thread::sleep(whole.mul_f64(1.05 * fraction));
            child.kill().unwrap();
            child.wait().unwrap();
            let found: Vec<_> = outputs.iter().filter(|name| desk.path(name).exists()).collect();
            let is_done = desk.path(outputs[0]).exists();
            assert!(!is_done || found.len() == outputs.len(), "{line}: only {found:?}");
            complete += usize::from(is_done);
            let is_fits = !line.starts_with("preview");
            for name in found.into_iter().filter(|_| is_fits) {
                psf_io::detect(desk.path(name)).unwrap();
            }
            remove();
        }
        // The next run that writes removes what the killed ones have left.
        desk.done(&format!("{line} -q"));
        assert_eq!(desk.temporaries(), Vec::<PathBuf>::new(), "{line}");
        remove();
        assert_eq!(desk.content().len(), given, "{line}");
        println!("{line}: {complete} of {kills} were complete");
    }
}

#[test]
fn a_batch_skips_a_job_on_which_another_works() {
    let desk = desk();
    std::fs::remove_file(desk.path("out.fits")).unwrap();
    desk.write(
        "jobs.toml",
        "[[job]]\npsf = 'samples.fits'\nscene = 'scene.fits'\noutput = 'out.fits'\nstream = true\nprecision = 'f64'\n",
    );
    let jobs = "batch jobs.toml --json";
    let status = |run: &Run| {
        let line = run.json();
        (
            line["status"].as_str().unwrap().to_owned(),
            line["reason"].clone(),
        )
    };
    let child = begun(&desk, &format!("exec \"$PSFIELD\" {jobs}"));
    let second = desk.done(jobs);
    assert_eq!(status(&second), ("skipped".to_owned(), "in progress".into()));
    send("CONT", &child);
    let first = Run::of(child.wait_with_output().unwrap());
    assert_eq!(status(&first), ("done".to_owned(), serde_json::Value::Null));
    assert_eq!(status(&desk.done(jobs)), ("skipped".to_owned(), "exists".into()));
    assert_eq!(desk.temporaries(), Vec::<PathBuf>::new());
}

//! A full disk: the error names the output and the reason, and only the old file remains.

use std::path::PathBuf;
use std::process::Command;

use psfield::psf_io;

use crate::desk::{Desk, scene};

/// The content of the files that outputs would replace.
const OLD: &str = "what was there before";

/// Every command that writes, with one output each. `$LIMIT` is put before the program.
const COMMANDS: [&str; 9] = [
    "simulate scene.fits --psf samples.fits -o OUT --overwrite",
    "simulate scene.fits --psf samples.fits -o OUT --overwrite --stream",
    "fit samples.fits -o OUT --overwrite",
    "evaluate samples.fits --at at.csv -o OUT --overwrite",
    "sample --preset survey-2m --uniform 2,2 -o OUT --overwrite",
    "expose scene.fits --detector ccd.toml --seed 1 -o OUT --overwrite",
    "convert samples.fits --to psfex=1 -o OUT --overwrite",
    "measure samples.fits -o OUT --overwrite",
    "preview scene.fits -o OUT --overwrite",
];

fn desk() -> Desk {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n3,4\n30,20\n50,40\n");
    desk.write("ccd.toml", CCD);
    desk
}

const CCD: &str = "gain_e_per_adu = 1.5\nread_noise_e = 3.0\nbits = 16\n";

#[cfg(unix)]
#[test]
fn files_that_may_not_grow() {
    for command in COMMANDS {
        let desk = desk();
        desk.write("out", OLD);
        // 512 bytes, in some shells 1024: less than any output here.
        let line = command.replace("OUT", "out");
        let run = desk.shell(&format!("ulimit -f 1; exec \"$PSFIELD\" {line}"));
        assert_eq!(run.code, Some(1), "{command}: {run:?}");
        for needle in ["psfield: error: ", "out: cannot write the file: File too large"] {
            assert!(run.stderr.contains(needle), "{command}: {run:?}");
        }
        assert_eq!(desk.bytes("out"), OLD.as_bytes(), "{command}");
        assert_eq!(desk.temporaries(), Vec::<PathBuf>::new(), "{command}");
        desk.done(&format!("{line} -q"));
        assert_ne!(desk.bytes("out"), OLD.as_bytes());
    }
}

/// A small disk in a folder, until it is dropped.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Makes the disk. None without the rights of an administrator.
    fn new(folder: PathBuf, size: &str) -> Option<Self> {
        std::fs::create_dir(&folder).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"])
            .arg(&folder)
            .output();
        mounted
            .is_ok_and(|output| output.status.success())
            .then_some(Self(folder))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let unmounted = Command::new("umount").arg(&self.0).status();
        assert!(unmounted.is_ok_and(|status| status.success()) || std::thread::panicking());
    }
}

#[test]
fn a_disk_that_fills_up() {
    let desk = desk();
    // The old image fills half of the disk, and a second one does not fit beside it. (61 x 51
    // pixels in f64 are 24.9 kB, with headers 28.8 kB.)
    let Some(disk) = SmallDisk::new(desk.path("disk"), "44k") else {
        eprintln!("skipped: a disk for the test needs the rights to mount one");
        return;
    };
    let simulate = "simulate scene.fits --psf samples.fits --precision f64 -o disk/image.fits";
    desk.done(&format!("{simulate} -q"));
    let old = desk.bytes("disk/image.fits");
    for more in ["", " --stream"] {
        let run = desk.run(&format!("{simulate} --overwrite{more}"));
        assert_eq!(run.code, Some(1), "{run:?}");
        for needle in ["psfield: error: disk/image.fits: ", "No space left on device"] {
            assert!(run.stderr.contains(needle), "{run:?}");
        }
        assert_eq!(desk.bytes("disk/image.fits"), old);
        assert_eq!(std::fs::read_dir(&disk.0).unwrap().count(), 1);
    }
    std::fs::remove_file(desk.path("disk/image.fits")).unwrap();
    desk.done(&format!("{simulate} -q"));
    assert_eq!(desk.bytes("disk/image.fits"), old);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_output_is_named() {
    let desk = Desk::new();
    for more in ["", "--json"] {
        let run = desk.shell(&format!(
            "exec \"$PSFIELD\" compare scene.fits scene.fits {more} > /dev/full"
        ));
        assert_eq!(run.code, Some(1), "{run:?}");
        assert!(
            run.stderr.contains("standard output") && run.stderr.contains("No space left on device"),
            "{run:?}"
        );
        let left = desk.shell(&format!(
            "\"$PSFIELD\" compare scene.fits scene.fits {more} | true"
        ));
        assert_eq!(left.stderr, "");
    }
}

#[test]
fn a_log_has_whole_lines() {
    let desk = Desk::new();
    desk.write("jobs.csv", "scene,output\nscene.fits,a.fits\nscene.fits,b.fits\n");
    desk.write("log.jsonl", "{\"job\": 1, \"st");
    let batch = "batch jobs.csv --set psf=samples.fits --log log.jsonl";
    desk.done(&format!("{batch} -q"));
    let log = String::from_utf8(desk.bytes("log.jsonl")).unwrap();
    let lines: Vec<&str> = log.lines().collect();
    assert_eq!((lines.len(), lines[0]), (3, "{\"job\": 1, \"st"));
    for line in &lines[1..] {
        serde_json::from_str::<serde_json::Value>(line).unwrap();
    }
    if cfg!(unix) {
        // A line fits into the space left, or nothing of it is written.
        desk.write("log.jsonl", "\n".repeat(1000));
        let run = desk.shell(&format!("ulimit -f 1; exec \"$PSFIELD\" {batch}"));
        assert_eq!(run.code, Some(1), "{run:?}");
        assert!(run.stderr.contains("log.jsonl"), "{run:?}");
        assert!(desk.bytes("log.jsonl").iter().all(|&c| c == b'\n'));
    }
    assert_eq!(
        psf_io::read_image::<f64>(desk.path("a.fits"))
            .unwrap()
            .image()
            .pixels()
            .dim(),
        scene().dim()
    );
}

/// A warning that cannot be printed does not stop the work.
#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_error_stops_nothing() {
    let desk = desk();
    desk.write("far.csv", "x,y,flux,pmra\n9000,9000,1,2\n");
    let simulate = "simulate --psf samples.fits --catalog far.csv --shape 61,51 --overwrite -o";
    let run = desk.shell(&format!("exec \"$PSFIELD\" {simulate} full.fits 2> /dev/full"));
    assert_eq!(run.code, Some(0), "{run:?}");
    desk.shell(&format!(
        "{{ \"$PSFIELD\" {simulate} closed.fits > /dev/null; echo $? > status; }} 2>&1 | true"
    ));
    assert_eq!(desk.bytes("status"), b"0\n");
    assert_eq!(desk.image("full.fits"), desk.image("closed.fits"));
}

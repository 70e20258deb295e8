//! GPUs that are lost or whose memory is full, simulated by a driver (`faulty_driver.c`): the
//! result is an error or the right image, never a wrong one.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::desk::{Desk, difference};
use crate::trials::{ROUNDING, TO};

/// The loader of Vulkan, if it can be replaced here: on Linux with a C compiler.
pub(crate) fn loader() -> Option<PathBuf> {
    let compiler = Command::new("cc").arg("--version").output().ok()?;
    let listed = ["ldconfig", "/sbin/ldconfig"]
        .iter()
        .find_map(|program| Command::new(program).arg("-p").output().ok())?;
    let listed = String::from_utf8(listed.stdout).ok()?;
    let line = listed.lines().find(|line| line.contains("libvulkan.so.1"))?;
    let path = PathBuf::from(line.split("=> ").nth(1)?);
    (compiler.status.success() && path.exists()).then_some(path)
}

fn compile(into: &Path) {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/gpu/faulty_driver.c");
    let status = Command::new("cc")
        .args(["-shared", "-fPIC", "-o"])
        .arg(into.join("libvulkan.so.1"))
        .args([source, "-ldl"])
        .status()
        .unwrap();
    assert!(status.success(), "cc {source}");
}

/// Runs with the first, second, third ... call of a kind failing, until that call is not reached.
/// Returns the number of errors.
fn errors(desk: &Desk, loader: &Path, fault: &str, needle: &str) -> usize {
    /// A larger number of calls than any run makes.
    const MOST: usize = 60;
    let library = desk.path("libvulkan.so.1");
    let folder = library.parent().unwrap().display();
    let mut errors = 0;
    for at in 1..=MOST {
        let run = desk.shell(&format!(
            "LD_LIBRARY_PATH={folder} REAL_VULKAN={} FAULT={fault} FAULT_AT={at} $PSFIELD {TO} --device gpu --gpu-memory 1K -o out.fits",
            loader.display()
        ));
        let reached = run.stderr.contains("[faulty driver]");
        if run.code == Some(0) {
            let apart = difference(&desk.image("out.fits"), &desk.image("right.fits"));
            assert!(apart <= ROUNDING, "{fault} {at}: {apart:e}");
            std::fs::remove_file(desk.path("out.fits")).unwrap();
        } else {
            assert!(reached && run.code == Some(1), "{fault} {at}: {run:?}");
            assert!(
                run.stderr.contains("psfield: error: ") && run.stderr.contains(needle),
                "{fault} {at}: {run:?}"
            );
            assert!(!desk.path("out.fits").exists(), "{fault} {at}");
            errors += 1;
        }
        if !reached {
            return errors;
        }
    }
    panic!("{fault}: still reached after {MOST} calls");
}

pub(crate) fn told() {
    let loader = loader().expect("ignored without");
    let desk = Desk::new();
    compile(desk.path("scene.fits").parent().unwrap());
    desk.done(&format!("{TO} --device cpu -o right.fits"));
    assert!(errors(&desk, &loader, "wait", "was lost") > 0);
    assert!(errors(&desk, &loader, "submit", "was lost") > 0);
    // If less memory can be used, there may be no error.
    assert!(errors(&desk, &loader, "allocation", "memory") > 0);
}

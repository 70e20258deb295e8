//! Tests of the fast engine in f32 on the processor and the GPU. Both run the same tests with the
//! same tolerances against the same references.
//!
//! Without a usable GPU, the tests on the GPU are shown as ignored. If `PSFIELD_REQUIRE_GPU` is
//! set, they fail instead. A driver that runs shaders on the processor (Mesa's lavapipe) is enough.

mod bodies;
#[allow(dead_code, reason = "each test binary uses a part")]
#[path = "../common/mod.rs"]
mod common;
#[cfg(feature = "gpu")]
mod gpu_alone;
mod on_device;
#[cfg(feature = "gpu")]
mod shaders;

use libtest_mimic::{Arguments, Failed, Trial};
use on_device::OnDevice;

fn main() {
    let arguments = Arguments::from_args();
    let gpu = OnDevice::gpu();
    if let Err(reason) = &gpu {
        assert!(
            std::env::var_os("PSFIELD_REQUIRE_GPU").is_none(),
            "PSFIELD_REQUIRE_GPU is set, but {reason}"
        );
        eprintln!("tests on the GPU are skipped and show as ignored: {reason}");
    }
    let mut trials = Vec::new();
    for (name, body) in bodies::ALL {
        trials.push(trial(
            format!("processor::{name}"),
            Some(OnDevice::processor()),
            body,
        ));
        trials.push(trial(format!("gpu::{name}"), gpu.clone().ok(), body));
    }
    #[cfg(feature = "gpu")]
    for (name, body) in gpu_alone::all() {
        trials.push(trial(format!("gpu::{name}"), gpu.clone().ok(), body));
    }
    libtest_mimic::run(&arguments, trials).exit();
}

/// A test on a device, ignored if there is no device.
fn trial(name: String, device: Option<OnDevice>, body: impl FnOnce(&OnDevice) + Send + 'static) -> Trial {
    let there = device.is_some();
    let run = move || -> Result<(), Failed> {
        if let Some(device) = &device {
            body(device);
        }
        Ok(())
    };
    let kind = if there { "" } else { "no GPU" };
    Trial::test(name, run).with_kind(kind).with_ignored_flag(!there)
}

//! The command line on a GPU.
//!
//! Without an adapter these tests show as ignored. With `PSFIELD_REQUIRE_GPU` set they fail
//! instead. A driver that runs shaders on the processor (lavapipe) is enough.

#[allow(dead_code, reason = "what the tests of the command line share")]
#[path = "../cli/desk.rs"]
mod desk;
mod faults;
mod trials;

use libtest_mimic::{Arguments, Trial};
use psfield::conv_core::gpu::adapters;

/// A test that fails by a panic.
fn trial(name: &str, test: fn()) -> Trial {
    Trial::test(name, move || {
        test();
        Ok(())
    })
}

fn main() {
    let arguments = Arguments::from_args();
    let there = adapters();
    if let Some(adapter) = there.first() {
        eprintln!("GPU tests on {adapter}");
    } else {
        assert!(
            std::env::var_os("PSFIELD_REQUIRE_GPU").is_none(),
            "PSFIELD_REQUIRE_GPU is set, but there is no GPU that could be driven here"
        );
        eprintln!("no GPU that could be driven here: its tests are skipped and show as ignored");
    }
    let on_adapter = [
        trial("gpu_and_cpu_agree", trials::agree),
        trial("the_image_says_where_it_was_made", trials::signed),
        trial("adapters_go_by_name_and_backend", trials::names),
        trial("unknown_names_list_what_is_there", trials::unknown_names),
        trial("devices_marks_the_preferred_adapter", trials::listed),
        trial("stars_alone_are_drawn_on_the_cpu", trials::stars_alone),
        trial("jobs_of_a_batch_share_a_plan_on_the_gpu", trials::batch),
        trial(
            "a_job_whose_gpu_fails_leaves_the_others_theirs",
            trials::batch_after_trouble,
        ),
        trial("benchmarks_say_what_ran_where", trials::bench),
        trial("f64_is_refused_by_the_library", trials::double),
        trial("auto_weighs_predictions_and_takes_no_software", trials::auto),
    ];
    let ignored = there.is_empty();
    let unfaulty = faults::loader().is_none();
    if unfaulty {
        eprintln!(
            "no loader of Vulkan that could be stood in for, or no C compiler: the test of faults is skipped and shows as ignored"
        );
    }
    let faults = trial("what_the_driver_fails_at_is_told", faults::told)
        .with_kind(if unfaulty { "no loader" } else { "" })
        .with_ignored_flag(ignored || unfaulty);
    let on_adapter = on_adapter.into_iter().map(|trial| {
        let kind = if ignored { "no GPU" } else { "" };
        trial.with_kind(kind).with_ignored_flag(ignored)
    });
    // If drivers cannot be hidden from a process, the case without drivers cannot be tested.
    let bare = trials::no_adapter_when_hidden();
    if !bare {
        eprintln!(
            "the drivers here cannot be hidden: the test without a GPU is skipped and shows as ignored"
        );
    }
    let without =
        trial("without_a_gpu_there_is_an_error_or_the_cpu", trials::without).with_ignored_flag(!bare);
    libtest_mimic::run(&arguments, on_adapter.chain([without, faults]).collect()).exit();
}

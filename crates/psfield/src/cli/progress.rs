//! Progress bars.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use psf_types::Progress;

/// A bar or spinner on standard error, if that is a terminal; gone when dropped.
#[derive(Debug)]
pub(crate) struct Bar(ProgressBar);

impl Bar {
    pub(crate) fn counting(what: &'static str, quiet: bool) -> Self {
        let style =
            ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}").expect("a valid template");
        Self::new(what, style, quiet)
    }

    pub(crate) fn spinning(what: &'static str, quiet: bool) -> Self {
        let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}").expect("a valid template");
        let bar = Self::new(what, style, quiet);
        if !bar.0.is_hidden() {
            bar.0.enable_steady_tick(std::time::Duration::from_millis(100));
        }
        bar
    }

    fn new(what: &'static str, style: ProgressStyle, quiet: bool) -> Self {
        // The target hides itself where standard error is no terminal.
        let target = if quiet {
            ProgressDrawTarget::hidden()
        } else {
            ProgressDrawTarget::stderr()
        };
        Self(
            ProgressBar::with_draw_target(None, target)
                .with_style(style)
                .with_message(what),
        )
    }
}

impl Bar {
    /// Does something that prints, with the bar out of the way.
    pub(crate) fn aside<R>(&self, print: impl FnOnce() -> R) -> R {
        self.0.suspend(print)
    }
}

impl Progress for Bar {
    fn start(&self, total: u64) {
        self.0.set_length(total);
    }

    fn advance(&self, steps: u64) {
        self.0.inc(steps);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

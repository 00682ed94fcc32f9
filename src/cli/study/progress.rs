//! How far a study has come: a bar on a terminal, nothing elsewhere. On standard error.

use crate::study::Progress;
use indicatif::{ProgressBar, ProgressStyle};

pub(super) struct Bar(ProgressBar);

impl Bar {
    pub(super) fn new(name: &'static str) -> Self {
        let bar = ProgressBar::no_length().with_prefix(name);
        let style = ProgressStyle::with_template("{prefix} {msg} [{wide_bar}] {pos}/{len} {eta} left");
        bar.set_style(style.expect("a template of known keys").progress_chars("=> "));
        Self(bar)
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

impl Progress for Bar {
    fn begin(&self, what: &str, steps: usize) {
        self.0.set_length(steps as u64);
        self.0.set_message(what.to_owned());
        self.0.reset();
    }

    fn step(&self) {
        self.0.inc(1);
    }
}

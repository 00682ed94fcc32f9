//! What a person sees of the running station. In: statuses, finished vehicles, the PLC's side, lines of the log. Out: on a
//! terminal a page that is drawn anew as things change, with what happened above it; else one line per vehicle.
//! Not here: what the numbers mean.

use super::line;
use crate::code::Code;
use crate::plc::{State, Status, View as Plc};
use crate::station::Finished;
use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write};
use std::sync::{Arc, Mutex, PoisonError};

/// Shared by the station's thread, the log and the main thread.
#[derive(Clone)]
pub(super) struct View(Arc<Mutex<Page>>);

struct Page {
    live: bool,
    status: Status,
    /// What the PLC's side looked like last.
    plc: Plc,
    listens: String,
    /// Lines of the page on the terminal.
    drawn: usize,
    /// Of what a person waits for, what was told last.
    told: Option<State>,
}

impl View {
    pub(super) fn new() -> Self {
        let page = Page {
            live: io::stdout().is_terminal(),
            status: Status::default(),
            plc: Plc::default(),
            listens: String::new(),
            drawn: 0,
            told: None,
        };
        Self(Arc::new(Mutex::new(page)))
    }

    fn page(&self, change: impl FnOnce(&mut Page)) {
        let mut page = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut page);
        page.draw();
    }

    pub(super) fn listens(&self, at: impl std::fmt::Display) {
        self.page(|p| p.listens = at.to_string());
    }

    pub(super) fn status(&self, status: &Status) {
        self.page(|p| {
            p.status = status.clone();
            // without a page only what a person waits for is told, and once
            let waited_for = matches!(status.state, State::WarmUp | State::Fault | State::Ready);
            if !p.live && waited_for && p.told.replace(status.state) != Some(status.state) {
                p.say(words(status.state));
            }
        });
    }

    pub(super) fn plc(&self, plc: &Plc) {
        self.page(|p| p.plc = plc.clone());
    }

    pub(super) fn fault(&self, code: Code) {
        let entry = code.entry();
        self.page(|p| p.say(&format!("fault: {code}: {} {}", entry.sentence, entry.remedy)));
    }

    pub(super) fn finished(&self, finished: &Finished) {
        self.page(|p| {
            let text = line::line(finished);
            p.say(text.trim_end());
        });
    }

    /// A line of its own.
    pub(super) fn say(&self, text: &str) {
        self.page(|p| p.say(text));
    }

    /// Leaves the page as it is; nothing is drawn over it.
    pub(super) fn end(&self) {
        self.page(|p| p.live = false);
    }
}

impl Page {
    /// A line above the page. A reader that has gone is no error.
    fn say(&mut self, text: &str) {
        let mut out = io::stdout().lock();
        if self.drawn > 0 {
            let _ = write!(out, "\x1b[{}A\x1b[J", self.drawn);
            self.drawn = 0;
        }
        let _ = writeln!(out, "{text}");
    }

    fn draw(&mut self) {
        if !self.live {
            return;
        }
        let text = self.text();
        let mut out = io::stdout().lock();
        if self.drawn > 0 {
            let _ = write!(out, "\x1b[{}A\x1b[J", self.drawn);
        }
        let _ = write!(out, "{text}");
        let _ = out.flush();
        self.drawn = text.lines().count();
    }

    fn text(&self) -> String {
        let (s, c) = (&self.status, &self.status.counters);
        let mut t = String::new();
        let on = |b: bool, name: &'static str| if b { name } else { "–" };
        let _ = writeln!(t, "── datum {} ── Ctrl-C ends ──", if s.simulated { "(simulated station)" } else { "" });
        let _ = writeln!(
            t,
            "state    {}   job {}   bars {}  projector {}  vehicle {}",
            words(s.state),
            s.active_job,
            on(s.bars_on, "on"),
            on(s.projector_on, "on"),
            on(s.vehicle_present, "there")
        );
        let _ = writeln!(
            t,
            "results  {} ok {} out of limits {} too uncertain {} not measurable {} aborted {}   cycle median {} ms p95 {} ms",
            c.results,
            c.ok,
            c.out_of_limits,
            c.too_uncertain,
            c.not_measurable,
            c.aborted,
            c.median_cycle_ms,
            c.p95_cycle_ms
        );
        let owner = self.plc.owner.map_or_else(|| "nobody".into(), |a| a.to_string());
        let _ = writeln!(
            t,
            "PLC      {}   owner {owner}   {} connected   READY {} RESULT_VALID {}",
            self.listens,
            self.plc.clients.len(),
            u8::from(self.plc.ready),
            u8::from(self.plc.result_valid)
        );
        let warning = s.warning.or(self.plc.error).map_or_else(|| "none".into(), |code| code.to_string());
        let _ = writeln!(t, "warning  {warning}");
        t
    }
}

/// The log, line by line.
impl Write for View {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let live = self.0.lock().unwrap_or_else(PoisonError::into_inner).live;
        if live {
            self.say(String::from_utf8_lossy(bytes).trim_end());
        } else {
            io::stderr().lock().write_all(bytes)?;
        }
        Ok(bytes.len())
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn words(state: State) -> &'static str {
    match state {
        State::Boot => "starting",
        State::SelfTest => "testing the devices",
        State::WarmUp => "warming up",
        State::Ready => "ready",
        State::Acquiring => "taking images",
        State::Processing => "computing",
        State::WaitAck => "waiting for the acknowledgement",
        State::JobLoad => "loading a job",
        State::Verify => "verifying",
        State::Service => "standing by",
        State::Fault => "fault",
        State::Updating => "updating",
    }
}

//! Records: what became of every vehicle, kept through power cuts and full disks.
//! In:  what the station says of a vehicle, a boot, a verification, an alarm; the raw images worth keeping.
//! Out: a [`Journal`] whose acknowledged records are never lost, read while it is written by a [`Reader`]; a ring of
//! [`Captures`]; both with limits of their own. Lists, exports and [`replay()`] of what was kept.
//! Not here: when a record is written, and what a fault of the storage means for measuring (nothing but a warning).
//!
//! ```text
//! records/
//!   lock                             held by the one writer
//!   journal-00000000000000000001     segments, each named for its first id; the oldest go first
//!   light.toml                       how long the bars have been lit
//!   captures/0000000042/             the raw images of record 42, with the calibration and model they were measured by
//! ```

mod captures;
mod disk;
mod fault;
mod frame;
mod journal;
mod query;
mod reader;
mod record;
mod recorder;
mod reference;
mod replay;
mod report;
mod time;

pub use captures::{CAPTURES, Captures, Policy, Ring, WriteError, capture_name, of_vehicles};
pub use disk::{Space, space};
pub use fault::Fault;
pub use journal::{Journal, Limits, Lock, Recovery};
pub use query::{Filter, Selection, select};
pub use reader::{Damage, Found, Reader};
pub use record::{Alarm, Boot, Event, Record, Totals, Vehicle, Verdict, Verification};
pub use recorder::Recorder;
pub use reference::Reference;
pub use replay::{REPRODUCED, Replayed, With, replay, replay_json, replay_table};
pub use report::{csv, json, json_lines, table};
pub use time::parse_time;

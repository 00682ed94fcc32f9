//! The station: one thread that owns the devices and measures one vehicle after the other.
//! In:  a configuration, devices, vehicle models, orders. Out: reports; records; lights and projector off whenever nothing
//! is measured.
//! Not here: registers and the handshake (`plc`); how images become a pose (`measure`); drivers (`hal`, `sim`).
//!
//! What happens next is decided by `plan`, which is pure; [`Machine`] does it.

mod acquire;
mod config;
mod counters;
mod devices;
mod doctor;
mod hardware;
mod hours;
mod jobs;
mod light;
mod machine;
mod outcome;
mod plan;
mod selftest;
mod simulated;
mod still;
mod verify;

pub use acquire::{Budget, LIMIT};
pub use config::{
    ArtefactKeys, CameraKeys, CameraKind, CameraTrigger, CycleKeys, JobsKeys, KEYS, Key, LightsKeys, LightsKind,
    PixelFormat, PlcKeys, PresenceKeys, PresenceKind, ProjectorKeys, ProjectorKind, RecordsKeys, SimulationKeys,
    StationFile, TemperatureKeys, TriggerKind,
};
pub use counters::Durations;
pub use devices::{bars, camera, dark, fits, presence, projector, real, temperatures};
pub use doctor::{Finding, Health, examine};
pub use hardware::{Hardware, Temperatures};
pub use hours::Hours;
pub use jobs::{Entry, Job, Jobs, Unusable, load, load_all};
pub use machine::{Finished, Machine, NoStore, Note, Pace, Parts, Store, WriteImages};
pub use selftest::{ROWS, stored_pictures};
pub use simulated::{Simulated, Traffic, World, deviation, missing, outdated, teach_one};
pub use still::{Next, Still};

//! A simulated station: devices behind the boundary of `hal`, with the faults of the world.
//! In:  a scene (body, paint, pose), a setup (lenses, lamps), a script of visits and faults. Out: devices that blocks of
//! the station drive as they would drive real ones, and the truth that no real one tells.
//! Not here: anything about how images are measured. What is left out of the light: interreflection.
//!
//! [`Body`] + [`Paint`] + pose = [`Scene`]; seen by a [`Setup`] it becomes [`Layers`], which give any number of images.

pub mod board;
mod body;
mod fault;
mod files;
mod lamp;
mod models;
mod paint;
mod picture;
mod plan;
mod pose;
mod projector;
mod random;
mod region;
mod render;
mod scene;
mod sensor;
mod setup;
mod station;

pub use body::{Arch, BUILD_MM, Body, Build, Feature, Style};
pub use fault::{Cue, Fault, Script, When};
pub use files::{calibration, features, in_image, seen, truth};
pub use models::names;
pub use paint::{PAINTS, Paint};
pub use picture::picture;
pub use plan::{Bend, Outline};
pub use pose::{Deviation, camera_from_vehicle};
pub use projector::Picture;
pub use random::Random;
pub use render::{Layers, Lit};
pub use scene::{Cover, Scene};
pub use sensor::{Dirt, Take, expose};
pub use setup::{BARS_MM, DISTANCE_MM, LINE, LONGEST, MAX_GAIN, Setup};
pub use station::{Bars, Camera, Clock, Presence, Projector, Station, Visit};

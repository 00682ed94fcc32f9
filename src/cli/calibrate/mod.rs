//! `datum calibrate`: boards in, lenses out. One file per subcommand, and what they share.

mod camera;
mod input;
mod projector;
mod report;
mod station;
mod verify;

use super::Status;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// The camera alone, from pictures or captures of a board
    Camera(camera::Arguments),
    /// Camera and projector jointly, from captures of a board with column and row fringes
    Projector(projector::Arguments),
    /// One capture of a board against a calibration
    Verify(verify::Arguments),
    /// Where the station lies, from circles with known station coordinates
    Station(station::Arguments),
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    match &a.what {
        What::Camera(a) => camera::run(a),
        What::Projector(a) => projector::run(a),
        What::Verify(a) => verify::run(a),
        What::Station(a) => station::run(a),
    }
}

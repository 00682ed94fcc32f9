//! The world of a guest with a station's devices (board/guest): plays the scene between its projector's node and its
//! camera's, and shows that `datum` measures there. `board/test guest` runs it.

#![expect(clippy::print_stdout, reason = "what was seen goes to the console")]

mod exact;
mod pins;
mod play;
mod player;
mod plc;
mod program;
#[cfg(feature = "libcamera")]
mod sensor;
mod trials;
mod v4l2;
mod vehicles;

use clap::Parser;
use std::process::ExitCode;

#[derive(Debug, clap::Parser)]
#[command(name = "guest", about = "The world of a guest with a station's devices")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Plays the scene while a program runs, and ends with its exit status
    Play(play::Arguments),
    /// Writes what datum needs in the guest: calibration, models; and the poses to compare with
    Prepare(vehicles::Arguments),
    /// Shows that datum measures in the guest
    Trials(trials::Arguments),
    /// Takes images over libcamera
    #[cfg(feature = "libcamera")]
    Libcamera(sensor::Arguments),
    /// Sends images of 2592×1944 through the camera's nodes and compares what comes out
    Exact,
}

fn main() -> ExitCode {
    let done = match Arguments::parse().command {
        Command::Play(a) => play::run(&a),
        Command::Prepare(a) => vehicles::run(&a),
        Command::Trials(a) => trials::run(&a),
        #[cfg(feature = "libcamera")]
        Command::Libcamera(a) => sensor::run(&a),
        Command::Exact => exact::run(),
    };
    done.unwrap_or_else(|e| {
        eprintln!("failed: {e:#}");
        ExitCode::FAILURE
    })
}

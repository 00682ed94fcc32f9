//! The command line: one file per subcommand. In: arguments. Out: text on standard output, errors and progress
//! on standard error, an exit status.

mod backup;
mod calibrate;
mod capture;
mod check;
mod dataset;
mod doctor;
mod measure;
mod overlay;
mod patterns;
mod records;
mod registers;
mod release;
mod reset;
mod restore;
mod run;
mod safe;
mod simulate;
mod study;
mod teach;

use anyhow::Context;
use std::io::Write;

/// What the program was asked to do.
#[derive(Debug, clap::Parser)]
#[command(name = "datum", version, about = "Measures where a vehicle's own coordinate system lies")]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// The appliance: measures vehicles as they come; without a configuration on the built-in simulated station
    Run(run::Arguments),
    /// Checks a station's configuration and explains every key
    Check(check::Arguments),
    /// Tests every device of a station and says what to do where one does not work
    Doctor(doctor::Arguments),
    /// Turns every output off: bars and projector dark, whatever state a killed program left them in
    Safe(safe::Arguments),
    /// Records one capture from the station's devices
    Capture(capture::Arguments),
    /// Measures stored captures
    Measure(measure::Arguments),
    /// Makes a vehicle model with templates from one good capture
    Teach(teach::Arguments),
    /// Releases a vehicle model for production
    Release(release::Arguments),
    /// Calibrates camera and projector from a board, verifies, surveys the station
    Calibrate(calibrate::Arguments),
    /// Writes the fringe patterns as PNGs
    Patterns(patterns::Arguments),
    /// Prints the PLC interface
    Registers(registers::Arguments),
    /// Writes captures of a simulated station, with their truth
    Simulate(simulate::Arguments),
    /// Writes labelled images to train a detector with: drawn at random, or from captures
    Dataset(dataset::Arguments),
    /// Experiments that show how well it measures, beside published tables
    Study(study::Arguments),
    /// Writes everything that makes this station this station into one file
    Backup(backup::Arguments),
    /// Makes a station from such a file
    Restore(restore::Arguments),
    /// Back to the factory's state; calibration and hours of light stay
    Reset(reset::Arguments),
    /// The journal: lists and exports records, measures kept captures again
    Records(Box<records::Arguments>),
}

/// The exit status; an error of [`run`] is bad input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    /// Done and ok.
    Done = 0,
    /// At least one capture is not ok.
    Refused = 1,
    /// Wrong usage or input.
    BadInput = 2,
    /// A device fault, or devices held by the running service.
    Device = 3,
}

/// Does what was asked.
pub fn run(arguments: Arguments) -> anyhow::Result<Status> {
    match arguments.command {
        Command::Run(a) => run::run(&a),
        Command::Check(a) => check::run(&a),
        Command::Doctor(a) => doctor::run(&a),
        Command::Safe(a) => safe::run(&a),
        Command::Capture(a) => capture::run(&a),
        Command::Measure(a) => measure::run(&a),
        Command::Teach(a) => teach::run(&a),
        Command::Release(a) => release::run(&a),
        Command::Calibrate(a) => calibrate::run(&a),
        Command::Patterns(a) => patterns::run(&a),
        Command::Registers(a) => registers::run(&a),
        Command::Simulate(a) => simulate::run(&a),
        Command::Dataset(a) => dataset::run(&a),
        Command::Study(a) => study::run(&a),
        Command::Backup(a) => backup::run(&a),
        Command::Restore(a) => restore::run(&a),
        Command::Reset(a) => reset::run(&a),
        Command::Records(a) => records::run(&a),
    }
}

/// Prints a result. A reader that has gone (`| head`) is no error.
fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(e).context("standard output"),
        _ => Ok(()),
    }
}

/// An error with its causes, as a sentence.
fn sentence(e: &dyn std::error::Error) -> String {
    let mut said = e.to_string();
    let mut cause = e.source();
    while let Some(e) = cause {
        said += &format!(": {e}");
        cause = e.source();
    }
    said + "."
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_command_line_has_no_clashes() {
        <super::Arguments as clap::CommandFactory>::command().debug_assert();
    }
}

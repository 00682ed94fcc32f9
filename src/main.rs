//! The datum program: parses, wires, reports, and nothing else.

use clap::Parser;
use datum::cli::{Arguments, Status, run};

fn main() -> std::process::ExitCode {
    let status = run(Arguments::parse()).unwrap_or_else(|e| {
        eprintln!("error: {e:#}");
        Status::BadInput
    });
    std::process::ExitCode::from(status as u8)
}

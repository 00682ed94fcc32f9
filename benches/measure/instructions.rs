//! What `datum measure` executes on the simulated capture, counted by callgrind: instructions repeat where times do not.

use crate::station::Bench;
use std::process::Command;

/// On one thread, reading the images and the files included; `None` without valgrind.
pub(crate) fn measure(b: &Bench) -> Option<u64> {
    let file = |name: &str| b.folder.join(name);
    let out = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null", env!("CARGO_BIN_EXE_datum"), "measure"])
        .arg("--calibration")
        .arg(file("calibration.toml"))
        .arg("--vehicle")
        .arg(file("bench.toml"))
        .arg(file("moved"))
        .env("RAYON_NUM_THREADS", "1")
        .output()
        .ok()?;
    let said = String::from_utf8_lossy(&out.stderr);
    let count = said.lines().find_map(|line| line.split_once("Collected :")?.1.trim().parse().ok());
    if count.is_none() {
        eprintln!("{said}");
    }
    count
}

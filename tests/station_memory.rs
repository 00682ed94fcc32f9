//! A station's memory stays where it was, cycle after cycle.
//!
//! A long run is asked for: `DATUM_CYCLES=10000 cargo test --release --test station_memory -- --nocapture`

#![expect(clippy::print_stdout, reason = "how memory went is half of what this is for")]

#[allow(dead_code, reason = "each test uses its part")]
#[path = "common/station.rs"]
mod bench;

use bench::{Bench, jobs};
use datum::sim::{PAINTS, Random, Script};
use datum::station::{SimulationKeys, StationFile};

/// Buffers still grow to the largest vehicle's during so many cycles.
const FIRST: usize = 100;
/// By how much resident memory may grow after them: in a long run, and in one that is hardly longer than them.
const FLAT: (f64, f64) = (0.02, 0.05);
/// Cycles of a long run.
const LONG: usize = 1000;

/// Resident memory, MiB.
fn resident() -> f64 {
    let statm = std::fs::read_to_string("/proc/self/statm").expect("Linux");
    let pages: f64 = statm.split(' ').nth(1).and_then(|n| n.parse().ok()).expect("of statm");
    pages * 4096.0 / (1 << 20) as f64
}

#[test]
fn memory_stays_where_it_was() {
    let cycles = std::env::var("DATUM_CYCLES").ok().and_then(|n| n.parse().ok()).unwrap_or(130);
    datum::heap::steady();
    assert!(cycles > FIRST, "DATUM_CYCLES={cycles}, allowed: more than {FIRST}");
    let config = StationFile { simulation: SimulationKeys { scale: 0.25, seed: 5 }, ..StationFile::default() };
    let mut bench = Bench::new(config, Script::default(), jobs());
    let mut random = Random::new(8, &[]);
    let (mut after_first, mut largest, mut measured) = (0.0, 0f64, 0);
    for n in 1..=cycles {
        let paint = PAINTS[n % PAINTS.len()];
        let cycle = bench.measure(paint, &mut random).expect("ready");
        measured += usize::from(cycle.outcome().pose.is_some());
        let mib = resident();
        if n == FIRST {
            after_first = mib;
        }
        largest = largest.max(mib);
        if n % (cycles / 10) == 0 {
            println!("{n} cycles, {measured} measured: {mib:.1} MiB");
        }
    }
    let growth = largest / after_first - 1.0;
    println!("{after_first:.1} MiB after {FIRST} cycles, {largest:.1} MiB at most: {:+.1} %", 100.0 * growth);
    assert!(2 * measured > cycles, "{measured} of {cycles} measured");
    assert!(growth <= if cycles < LONG { FLAT.1 } else { FLAT.0 }, "memory grew by {:.1} %", 100.0 * growth);
}

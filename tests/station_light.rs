//! The light in closed loop: every paint, from a dark hall to one beside a window.

#![expect(clippy::print_stdout, reason = "tables to read are half of what this is for")]

#[allow(dead_code, reason = "each test uses its part")]
#[path = "common/station.rs"]
mod bench;

use bench::{Bench, jobs};
use datum::plc::ResultCode;
use datum::sim::{Cue, Fault, PAINTS, Random, Script, When};
use datum::station::{SimulationKeys, StationFile};

fn config() -> StationFile {
    let mut cycle = datum::station::CycleKeys::default();
    if let Some(limit) = std::env::var("DATUM_LIMIT").ok().and_then(|s| s.parse().ok()) {
        cycle.ambient_limit = limit;
    }
    StationFile { cycle, simulation: SimulationKeys { scale: scale(), seed: 3 }, ..StationFile::default() }
}

fn scale() -> f64 {
    std::env::var("DATUM_SCALE").ok().and_then(|s| s.parse().ok()).unwrap_or(0.25)
}

#[test]
fn every_paint_is_measured_up_to_500_lx_and_beyond_measured_or_refused_with_303() {
    let mut bench = Bench::new(config(), Script::default(), jobs());
    let mut random = Random::new(1, &[]);
    println!("hall {}", datum::sim::Setup::new(0.25, 8).hall_lux());
    for lux in [20.0, 200.0, 500.0, 1000.0, 2000.0] {
        let ambient =
            Cue { when: When::Always, fault: Fault::Ambient(lux / datum::sim::Setup::new(0.25, 8).hall_lux()) };
        bench.world.set_script(Script(vec![ambient]));
        for paint in PAINTS {
            for _ in 0..2 {
                let cycle = bench.measure(paint, &mut random);
                let Some(c) = cycle else {
                    println!("{lux} {} refused {:?}", paint.name, bench.status.state);
                    bench.until(datum::plc::State::Ready, 30);
                    continue;
                };
                let o = c.outcome();
                println!(
                    "{lux:5} {:7} {:?} {:?} wrong {} acq {:?} amb {:.1} bars {:.2?} {:?} err {:.3?} tries {} {:?} {}",
                    paint.name,
                    o.result,
                    o.code,
                    c.is_wrong(),
                    o.acquisition,
                    o.ambient.unwrap_or(-1.0),
                    o.light.unwrap(),
                    c.finished.budget,
                    c.error(),
                    c.finished.tries,
                    c.finished.first,
                    c.finished.said
                );
                assert!(!bench.lit());
                let _ = ResultCode::Ok;
            }
        }
    }
}

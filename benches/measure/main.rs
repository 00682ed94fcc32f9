//! Times of a measurement at full resolution, on a capture that is simulated here, and of its parts over whole images;
//! beside OpenCV's in the same run, beside the time memory takes, with one thread and two. One table at the end.
//! `DATUM_DATA=../shared/data cargo bench --bench measure`; OpenCV is left out without DATUM_DATA or where DATUM_PYTHON
//! (else python3) has none: `pip install opencv-contrib-python-headless numpy`; instructions without valgrind.

#![expect(clippy::print_stdout, reason = "a table is what this is for")]

mod instructions;
mod parts;
mod peers;
mod station;
mod table;

use criterion::{BatchSize, Criterion};
use datum::measure::Cycle;
use station::Bench;
use std::path::Path;
use table::Table;

/// One part after the other of one vehicle's measurement.
fn measure(c: &mut Criterion, b: &Bench, threads: usize) {
    let fill = |cycle: &mut Cycle<'_>| {
        b.images().for_each(|(k, step, image)| cycle.add_fringe(k, step, image).expect("of the capture"));
    };
    let begun = || b.measurer.begin(&b.capture, &b.red, None);
    let filled = || {
        let mut cycle = begun();
        fill(&mut cycle);
        cycle
    };
    let mut group = c.benchmark_group(format!("measure_{threads}"));
    group.bench_function("begin", |bench| bench.iter(begun));
    group.bench_function("all_16_add_fringe", |bench| bench.iter_batched_ref(begun, fill, BatchSize::PerIteration));
    group.bench_function("finish", |bench| {
        bench.iter_batched(filled, |cycle| cycle.finish(&mut |_| ()), BatchSize::PerIteration);
    });
    group.bench_function("whole", |bench| {
        bench.iter(|| {
            let mut cycle = b.detecting.begin(&b.capture, &b.red, None);
            fill(&mut cycle);
            cycle.finish(&mut |_| ())
        });
    });
    group.finish();
}

fn main() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("criterion");
    let b = Bench::new();
    let images = parts::Images::new(&b);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let mut criterion = Criterion::default().output_directory(&folder).configure_from_args().sample_size(20);
            parts::bench(&mut criterion, &images, threads);
            measure(&mut criterion, &b, threads);
            criterion.final_summary();
        });
    }
    let table = Table { folder: &folder, opencv: peers::opencv(&images) };
    println!("{table}");
    match instructions::measure(&b) {
        Some(count) => println!("datum measure, files included: {:.2}e9 instructions", count as f64 * 1e-9),
        None => println!("datum measure: instructions not counted, no valgrind"),
    }
}

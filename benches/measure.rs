//! Times of a measurement at full resolution, on a capture that is simulated here: what must be done while the projector
//! plays (`begin` with the red image, `add_fringe` with each of the others) and what is left after the last image
//! (`finish`). Beside them a floor that memory sets: every sample of all images read once.
//! `cargo bench --bench measure`; on two cores `taskset -c 0,1 cargo bench --bench measure`.

use criterion::{BatchSize, Criterion};
use datum::capture::{Devices, Plan, record};
use datum::measure::{Measurer, teach};
use datum::sim::{self, Body, Deviation, Paint, Scene, Script, Setup, Station};
use datum::{Capture, Image};
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A vehicle taught where it should stand, and a capture of one that stands otherwise.
struct Bench {
    measurer: Measurer,
    capture: Capture,
    red: Image<u16>,
    fringes: Vec<Vec<Image<u16>>>,
}

impl Bench {
    fn new() -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-measure");
        let setup = Arc::new(Setup::new(1.0, 8));
        let (body, paint) = (Body::named("suv-a").expect("listed"), Paint::named("white").expect("listed"));
        let capture = |stands: Deviation, name: &str| {
            let station =
                Station::with_vehicle(Arc::clone(&setup), 1, (body.clone(), paint, stands), Script::default());
            let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
            let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
            record(&mut devices, &Plan::default(), &folder.join(name)).expect("recorded")
        };
        let good = capture(Deviation::default(), "taught");
        let scene = Scene::new(body.clone(), paint, &Deviation::default());
        let features = sim::features(&scene, &setup).expect("all in view");
        let mut taught = teach(&good, &sim::calibration(&setup), &features, "bench").expect("teaches");
        for (feature, template) in taught.model.features.iter().zip(&taught.templates) {
            let file = folder.join(feature.template.as_ref().expect("taught"));
            std::fs::write(file, template.to_bytes()).expect("writable");
        }
        taught.model.file = folder.join("bench.toml");
        let measurer = Measurer::new(sim::calibration(&setup), taught.model).expect("templates");
        let stands = Deviation { along_mm: -40.0, across_mm: 30.0, yaw_deg: 3.0, ..Deviation::default() };
        let capture = capture(stands, "moved");
        let load = |path: &PathBuf| capture.load(path).expect("just written");
        let red = load(capture.images.red.as_ref().expect("recorded"));
        let fringes = capture.fringes.iter().map(|set| set.images.iter().map(load).collect()).collect();
        Self { measurer, red, fringes, capture }
    }

    /// Every fringe image of the capture: its set, its step.
    fn images(&self) -> impl Iterator<Item = (usize, u32, &Image<u16>)> {
        self.fringes.iter().enumerate().flat_map(|(k, set)| (0u32..).zip(set).map(move |(step, i)| (k, step, i)))
    }
}

fn measure(c: &mut Criterion) {
    let b = Bench::new();
    let begun = || b.measurer.begin(&b.capture, &b.red, None);
    let filled = || {
        let mut cycle = begun();
        b.images().for_each(|(k, step, image)| cycle.add_fringe(k, step, image).expect("of the capture"));
        cycle
    };
    let (result, _) = filled().finish(&mut |_| ());
    assert_eq!(result.code, None, "{}", result.detail);
    let mut group = c.benchmark_group("measure_2592x1944");
    group.bench_function("floor_all_images_read_once", |bench| {
        let sum = |image: &Image<u16>| image.pixels.iter().map(|v| u64::from(*v)).sum::<u64>();
        bench.iter(|| sum(black_box(&b.red)) + b.images().map(|(.., image)| sum(black_box(image))).sum::<u64>());
    });
    group.bench_function("begin", |bench| bench.iter(begun));
    group.bench_function("all_16_add_fringe", |bench| {
        let add = |cycle: &mut datum::measure::Cycle<'_>| {
            b.images().for_each(|(k, step, image)| cycle.add_fringe(k, step, image).expect("of the capture"));
        };
        bench.iter_batched_ref(begun, add, BatchSize::PerIteration);
    });
    group.bench_function("finish", |bench| {
        bench.iter_batched(filled, |cycle| cycle.finish(&mut |_| ()), BatchSize::PerIteration);
    });
    group.finish();
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args().sample_size(20);
    measure(&mut criterion);
    criterion.final_summary();
}

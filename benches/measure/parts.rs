//! What a measurement is made of, over whole images: it does less, as it looks at its regions only.

use crate::station::Bench;
use criterion::Criterion;
use datum::Image;
use datum::contour::{EdgeFilter, cross_level, find_edges};
use datum::fringe::{Axis, Limits, NoiseLaw, PatternSet, PhaseMap, Stack, decode_where, unwrap};
use datum::image::Window;
use datum::lent::{Spare, side_by_side};
use rayon::prelude::*;
use std::hint::black_box;

/// Side of a region that edges are looked for in, px.
pub(crate) const REGION: usize = 400;
const NOISE: NoiseLaw = NoiseLaw { gain: 0.032, variance0: 0.2, black: 0.0 };
const WIDTH: usize = 2592;
const HEIGHT: usize = 1944;
const COUNTS: [u32; 3] = [1, 8, 64];

/// Three sets of four fringe images, and what edges are looked for in.
pub(crate) struct Images {
    sets: [Vec<Image<u16>>; 3],
    pub(crate) regions: Vec<Image<f32>>,
}

impl Images {
    /// Fringes bent as OpenCV's are; the regions are those of the capture's red image about its middle.
    pub(crate) fn new(b: &Bench) -> Self {
        let mut state = 7u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (0..4).map(|k| (state >> (16 * k) & 0xffff) as f64 / 65536.0 - 0.5).sum::<f64>() * 1.8 / 0.577
        };
        let mut image = |count: u32, step: u32| {
            let sample = |i: usize| {
                let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
                let turns = f64::from(count) * (x / WIDTH as f64 + 0.01 * (y / 300.0).sin()) + 0.25 * f64::from(step);
                (80.0 + 60.0 * (turns * std::f64::consts::TAU).cos() + noise()).round().clamp(0.0, 254.0) as u16
            };
            Image { width: WIDTH, height: HEIGHT, pixels: (0..WIDTH * HEIGHT).map(sample).collect() }
        };
        let sets = COUNTS.map(|count| (0..4).map(|step| image(count, step)).collect());
        let region = |at: (usize, usize)| {
            let row = |y: usize| b.red.row(y)[at.0..at.0 + REGION].iter().map(|v| f32::from(*v));
            Image { width: REGION, height: REGION, pixels: (at.1..at.1 + REGION).flat_map(row).collect() }
        };
        let corners = [(600, 500), (1500, 500), (600, 1000), (1500, 1000)];
        Self { sets, regions: corners.map(region).to_vec() }
    }
}

/// The stacks of a capture's sets.
struct Stacks([Stack; 3]);

impl Stacks {
    fn new() -> Self {
        let whole = Window::whole(WIDTH, HEIGHT);
        let set = |count| PatternSet::new(Axis::Column, count, 4).expect("legal");
        let stack = |count| Stack::new(set(count), 255, &[whole]).expect("legal");
        Self(COUNTS.map(stack))
    }

    fn decode(&mut self, images: &Images, set: usize) -> PhaseMap {
        let stack = &mut self.0[set];
        stack.restart(&[Window::whole(WIDTH, HEIGHT)]);
        (0..).zip(&images.sets[set]).for_each(|(step, image)| stack.add(step, image).expect("of the set"));
        decode_where(stack, 0, &NOISE, &Limits::DEFAULT, &[]).expect("complete")
    }
}

/// With the room of the round before, as a station has it.
pub(crate) fn bench(c: &mut Criterion, images: &Images, threads: usize) {
    Spare::default().serve(|| served(c, images, threads));
}

fn served(c: &mut Criterion, images: &Images, threads: usize) {
    let mut stacks = Stacks::new();
    let image = &images.sets[0][0];
    let mut group = c.benchmark_group(format!("parts_{threads}"));
    group.bench_function("read_image", |bench| {
        let sum = |rows: &[u16]| rows.iter().map(|v| u64::from(*v)).sum::<u64>();
        bench.iter(|| black_box(image).pixels.par_chunks(64 * WIDTH).map(sum).sum::<u64>());
    });
    group.bench_function("add_image", |bench| {
        let stack = &mut stacks.0[0];
        bench.iter(|| {
            stack.restart(&[Window::whole(WIDTH, HEIGHT)]);
            stack.add(0, black_box(image)).expect("of the set");
        });
    });
    group.bench_function("wrap_4", |bench| bench.iter(|| stacks.decode(black_box(images), 2)));
    group.bench_function("decode_unwrap_3x4", |bench| {
        bench.iter(|| {
            let maps: [PhaseMap; 3] = std::array::from_fn(|set| stacks.decode(black_box(images), set));
            unwrap(&maps, Axis::Column, 1280, &Limits::DEFAULT).expect("count 1")
        });
    });
    let filter = EdgeFilter { start: (10.0, 8.0), keep: (5.0, 4.0), ..EdgeFilter::default() };
    let whole = Window::whole(REGION, REGION);
    let found = |region: &Image<f32>| find_edges(region, whole, &filter, |level| NOISE.variance(level));
    let refined =
        |region: &Image<f32>| cross_level(region, &found(region), 8.0, |_| 255.0, |level| NOISE.variance(level)).len();
    group.bench_function("find_4_regions", |bench| {
        bench.iter(|| black_box(&images.regions).par_iter().map(|region| found(region).len()).sum::<usize>());
    });
    group.bench_function("edges_4_regions", |bench| {
        bench.iter(|| side_by_side(images.regions.len(), |k| refined(&black_box(images).regions[k])));
    });
    group.finish();
}

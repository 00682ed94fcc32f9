//! Times of calibration, on what is rendered here; with DATUM_DATA also on the photograph that OpenCV is timed on.
//! `DATUM_DATA=../shared/data cargo bench --bench calibrate`, and in the same minutes `../shared/data/tools/opencv_bench.py`.

use criterion::Criterion;
use datum::calibrate::target::find;
use datum::calibrate::{Terms, View, solve};
use datum::{Image, Lens};
use nalgebra::{Rotation3, Vector2, Vector3};
use std::hint::black_box;
use std::path::Path;

const WIDTH: usize = 2592;
const HEIGHT: usize = 1944;

/// A chessboard of 9×6 inner corners, 120 px a square, turned and in perspective, on grey, with shading and noise.
fn board() -> Image<f32> {
    let mut noise = 1u64;
    let mut image = Image::filled(WIDTH, HEIGHT, 0.0);
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        let mut reflectance = 0.0;
        for k in 0..4 {
            let (px, py) = (x - 1300.0 + 0.5 * f64::from(k % 2), y - 950.0 + 0.5 * f64::from(k / 2));
            let away = 1.0 + 1e-4 * px - 5e-5 * py;
            let (u, v) = ((px + 0.15 * py) / (120.0 * away), (py - 0.15 * px) / (120.0 * away));
            let (column, row) = ((u + 5.0).floor(), (v + 3.5).floor());
            let on = (0.0..10.0).contains(&column) && (0.0..7.0).contains(&row);
            let bright = (column + row).rem_euclid(2.0) == 1.0;
            reflectance += if !on {
                0.5
            } else if bright {
                0.9
            } else {
                0.1
            };
        }
        let light = 200.0 - 0.03 * x;
        *pixel = (light * reflectance / 4.0 + (noise >> 33) as f64 / f64::from(u32::MAX >> 1) * 4.0) as f32;
    }
    image
}

/// `image` at 2592×1944 by cubic convolution (a = −0.75), as OpenCV enlarges it.
fn enlarged(image: &Image<u16>) -> Image<f32> {
    const A: f64 = -0.75;
    let weight = |t: f64| match t.abs() {
        t if t <= 1.0 => ((A + 2.0) * t - (A + 3.0)) * t * t + 1.0,
        t if t < 2.0 => A * (((t - 5.0) * t + 8.0) * t - 4.0),
        _ => 0.0,
    };
    let taps = |k: usize, to: usize, from: usize| {
        let at = (k as f64 + 0.5) * from as f64 / to as f64 - 0.5;
        let first = at.floor() - 1.0;
        std::array::from_fn::<_, 4, _>(|i| {
            let tap = first + i as f64;
            (tap.clamp(0.0, from as f64 - 1.0) as usize, weight(at - tap))
        })
    };
    let mut out = Image::filled(WIDTH, HEIGHT, 0.0);
    for y in 0..HEIGHT {
        let rows = taps(y, HEIGHT, image.height);
        for x in 0..WIDTH {
            let columns = taps(x, WIDTH, image.width);
            let row = |y: usize| columns.iter().map(|(x, w)| w * f64::from(image.at(*x, y))).sum::<f64>();
            let grey: f64 = rows.iter().map(|(y, w)| w * row(*y)).sum();
            out.pixels[y * WIDTH + x] = grey.round().clamp(0.0, 255.0) as f32;
        }
    }
    out
}

fn find_chessboard(c: &mut Criterion) {
    let sought = "chessboard:9x6:30".parse().expect("a board");
    let mut images = vec![("find_chessboard_2592x1944_rendered", board())];
    if let Some(data) = std::env::var_os("DATUM_DATA") {
        let file = Path::new(&data).join("chessboard-left/left01.png");
        images.push(("find_chessboard_2592x1944_photograph", enlarged(&datum::image::read_png(&file).expect("there"))));
    }
    for (name, image) in &images {
        c.bench_function(name, |b| b.iter(|| find(black_box(image), &sought).expect("it is there")));
    }
}

/// As `calibrateCamera 20x117 pts 5 coef` there: all five terms, ours with its leave-one-out and the covariance; and as the
/// commands do it, with the terms chosen by leaving every view out for each.
fn calibrate_camera(c: &mut Criterion) {
    let board: Vec<_> = (0..117u32).map(|i| Vector2::new(f64::from(i % 13), f64::from(i / 13)) * 30.0).collect();
    let distortion = [-0.12, 0.08, 4e-4, -3e-4, 0.01];
    let lens = Lens { width: WIDTH, height: HEIGHT, fx: 2721.6, fy: 2721.6, cx: 1295.5, cy: 971.5, distortion };
    let mut state = 7u64;
    let mut gauss = || {
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        (0..12).map(|_| uniform()).sum::<f64>()
    };
    let view = |k: usize| {
        let r = Rotation3::new(Vector3::new(gauss(), gauss(), gauss()) * 0.35);
        let t = Vector3::new(-180.0 + 40.0 * gauss(), -120.0 + 30.0 * gauss(), 750.0 + 60.0 * gauss());
        let mut pixel = |p: &Vector2<f64>| {
            lens.project(&(r * p.push(0.0) + t)).expect("in front") + 0.05 * Vector2::new(gauss(), gauss())
        };
        let seen = board.iter().map(&mut pixel).enumerate().collect();
        View { name: k.to_string(), seen: [seen, Vec::new()] }
    };
    let views: Vec<View> = (0..20).map(view).collect();
    let sizes = [Some((WIDTH, HEIGHT)), None];
    for (name, terms) in [("all_terms", Terms::All), ("terms_chosen", Terms::Chosen)] {
        c.bench_function(&format!("calibrate_camera_20x117_{name}"), |b| {
            b.iter(|| solve(&board, black_box(&views), sizes, terms).expect("20 tilted views"));
        });
    }
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    find_chessboard(&mut criterion);
    calibrate_camera(&mut criterion);
    criterion.final_summary();
}

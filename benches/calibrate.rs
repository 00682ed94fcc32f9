//! Times of calibration, on images rendered here. `cargo bench --bench calibrate`

use criterion::Criterion;
use datum::Image;
use datum::calibrate::target::find;
use std::hint::black_box;

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

fn find_chessboard(c: &mut Criterion) {
    let (image, board) = (board(), "chessboard:9x6:30".parse().expect("a board"));
    c.bench_function("find_chessboard_2592x1944", |b| b.iter(|| find(black_box(&image), &board).expect("it is there")));
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    find_chessboard(&mut criterion);
    criterion.final_summary();
}

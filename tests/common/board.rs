//! Captures of a flat printed board, rendered: for tests of calibration that need no data.

use datum::calibrate::{Board, BoardKind};
use datum::capture::{Camera, Conditions, FringeSet, Images, Projector};
use datum::fringe::{Axis, PatternSet};
use datum::image::{Image, write_png};
use datum::{Capture, Lens, Point3, Pose, Rig, frame};
use nalgebra::{Rotation3, Vector2, Vector3};
use std::f64::consts::TAU;
use std::path::Path;

pub(crate) type CameraFromBoard = Pose<frame::Camera, frame::Board>;

/// A small sensor and projector that look at the same place from 227 mm apart.
pub(crate) fn rig() -> Rig {
    let lens =
        |width, height, fx: f64, cx, cy, distortion| Lens { width, height, fx, fy: 0.9994 * fx, cx, cy, distortion };
    let r = Rotation3::from_euler_angles(0.01, -0.285, -0.009);
    Rig {
        camera: lens(432, 324, 450.6, 216.8, 160.2, [-0.085, 0.1, 0.0004, -0.0003, 0.0]),
        projector: lens(640, 400, 526.0, 316.0, 261.0, [0.0; 5]),
        projector_from_camera: Pose::new(r, Vector3::new(213.0, -11.7, 77.8)),
    }
}

/// The board's middle at (x, y, z) mm before the camera, tilted about its horizontal, its vertical and the view's axis, degrees.
pub(crate) fn place(board: &Board, at: [f64; 3], tilt_deg: [f64; 3]) -> CameraFromBoard {
    let [a, b, c] = tilt_deg.map(f64::to_radians);
    let r = Rotation3::from_euler_angles(a, b, c);
    let middle = Vector2::new((board.columns - 1) as f64, (board.rows - 1) as f64) * board.pitch / 2.0;
    Pose::new(r, Vector3::from(at) - r * middle.push(0.0))
}

/// Eight places that tell a rig what it needs.
pub(crate) fn places(board: &Board) -> Vec<CameraFromBoard> {
    [
        ([0.0, 0.0, 720.0], [0.0, 0.0, 0.0]),
        ([-60.0, -40.0, 760.0], [28.0, 5.0, 3.0]),
        ([60.0, 40.0, 740.0], [-28.0, -5.0, -8.0]),
        ([60.0, -40.0, 700.0], [4.0, 28.0, 5.0]),
        ([-60.0, 40.0, 800.0], [-4.0, -26.0, -4.0]),
        ([-40.0, 0.0, 680.0], [20.0, 20.0, 10.0]),
        ([40.0, 0.0, 820.0], [-20.0, 22.0, 0.0]),
        ([0.0, 20.0, 780.0], [20.0, -20.0, -12.0]),
    ]
    .map(|(at, tilt)| place(board, at, tilt))
    .to_vec()
}

/// How bright the board is at `p` mm of its plane: print on paper with a margin, on nothing.
fn albedo(board: &Board, p: &Vector2<f64>) -> f64 {
    const WHITE: f64 = 0.9;
    const BLACK: f64 = 0.12;
    let (w, h) = ((board.columns - 1) as f64 * board.pitch, (board.rows - 1) as f64 * board.pitch);
    let margin = 1.7 * board.pitch;
    if p.x < -margin || p.y < -margin || p.x > w + margin || p.y > h + margin {
        return 0.02;
    }
    let dark = match board.kind {
        BoardKind::Chessboard => {
            let square = p / board.pitch + Vector2::new(1.0, 1.0);
            let inside = square.x > 0.0
                && square.y > 0.0
                && square.x < (board.columns + 1) as f64
                && square.y < (board.rows + 1) as f64;
            inside && (square.x.floor() + square.y.floor()) as i64 % 2 == 0
        }
        BoardKind::Circles { diameter } | BoardKind::Marked { diameter } => {
            let within = |at: Vector2<f64>, d: f64| (p - at).norm() < d / 2.0;
            let half = board.pitch / 2.0;
            let marks = [(half, 0.0), (half, board.pitch), (0.0, half)].map(|(x, y)| Vector2::new(x, y));
            let marked = matches!(board.kind, BoardKind::Marked { .. });
            board.points().into_iter().any(|c| within(c, diameter))
                || (marked && marks.into_iter().any(|m| within(m, 0.3 * diameter)))
        }
    };
    if dark { BLACK } else { WHITE }
}

/// What one ray of light within a pixel meets: albedo, projector column and row.
pub(crate) type Met = (f32, Option<(f32, f32)>);

/// Rays per pixel along each side.
pub(crate) const RAYS: usize = 4;
/// Width of what a pixel sees, px: its own size and some blur.
const WIDTH: f64 = 1.6;

fn meet(rig: &Rig, board: &Board, pose: &CameraFromBoard, x: f64, y: f64) -> Met {
    let dark = (0.02, None);
    let Some(ray) = rig.camera.ray(&Vector2::new(x, y)) else { return dark };
    let (normal, origin) = (pose.r.matrix().column(2).into_owned(), pose.t);
    let at = ray * (normal.dot(&origin) / normal.dot(&ray));
    let on_board = (pose.inverse() * Point3::new(at)).xyz.xy();
    let lit = rig.projector.project(&(rig.projector_from_camera * Point3::new(at)).xyz);
    let inside = |c: f64, size: usize| c > -0.5 && c < size as f64 - 0.5;
    let lit = lit.filter(|l| inside(l.x, rig.projector.width) && inside(l.y, rig.projector.height));
    (albedo(board, &on_board) as f32, lit.map(|l| (l.x as f32, l.y as f32)))
}

/// What every ray of light of every pixel meets, [`RAYS`]² to a pixel, row by row.
pub(crate) fn meet_all(rig: &Rig, board: &Board, pose: &CameraFromBoard) -> Vec<Met> {
    let (w, h) = (rig.camera.width, rig.camera.height);
    let step = WIDTH / RAYS as f64;
    let ray = |i: usize| {
        let (pixel, part) = (i / (RAYS * RAYS), i % (RAYS * RAYS));
        // sheared both ways: an edge along a row or a column must not meet rays four at a time
        let (i, j) = (part % RAYS, part / RAYS);
        let off = |k: usize, other: usize| (k as f64 + (other as f64 + 0.5) / RAYS as f64) * step - WIDTH / 2.0;
        meet(rig, board, pose, (pixel % w) as f64 + off(i, j), (pixel / w) as f64 + off(j, i))
    };
    (0..w * h * RAYS * RAYS).map(ray).collect()
}

/// Writes a capture of `board` at `pose` into `folder`: columns of 1, 8 and 40 fringes, rows of 1, 8 and 25 if `rows`, four
/// steps each, with shot and read noise, ambient light and a projector that is darker towards its edges.
pub(crate) fn write_capture(folder: &Path, rig: &Rig, board: &Board, pose: &CameraFromBoard, rows: bool, seed: u64) {
    const GAIN: f64 = 0.032;
    const READ_E: f64 = 6.0;
    std::fs::create_dir_all(folder).expect("the target folder is writable");
    let (w, h) = (rig.camera.width, rig.camera.height);
    let rays = meet_all(rig, board, pose);
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut gauss = || {
        // the sum of four uniform numbers of variance 1/12 is Gaussian enough for sensor noise
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        (uniform() + uniform() + uniform() + uniform()) * 3f64.sqrt()
    };
    let mut fringes = Vec::new();
    let sets = [(Axis::Column, [1, 8, 40]), (Axis::Row, [1, 8, 25])];
    for (axis, counts) in sets.into_iter().take(if rows { 2 } else { 1 }) {
        for count in counts {
            let set = PatternSet::new(axis, count, 4).expect("legal");
            let extent = if axis == Axis::Column { rig.projector.width } else { rig.projector.height };
            let mut images = Vec::new();
            for k in 0..4 {
                let light = |lit: &Option<(f32, f32)>| {
                    let Some((column, row)) = *lit else { return 0.08 };
                    let at = f64::from(if axis == Axis::Column { column } else { row });
                    let pattern = 0.5 + 0.5 * (TAU * (at + 0.5) / set.pitch(extent) + set.shift(k)).cos();
                    let (x, y) =
                        (f64::from(column) / rig.projector.width as f64, f64::from(row) / rig.projector.height as f64);
                    let vignette = 1.0 - 0.35 * ((x - 0.5).powi(2) + (y - 0.5).powi(2));
                    0.08 + 0.9 * vignette * pattern
                };
                let sample = |rays: &[Met]| {
                    let mean = rays.iter().map(|(a, lit)| f64::from(*a) * light(lit)).sum::<f64>() / rays.len() as f64;
                    let electrons = 7000.0 * mean;
                    let noise = (electrons + READ_E * READ_E).sqrt() * gauss();
                    (2.0 + GAIN * (electrons + noise)).round().clamp(0.0, 255.0) as u8
                };
                let pixels = rays.chunks_exact(RAYS * RAYS).map(sample).collect();
                let name = format!("fringe-{:02}.png", 4 * fringes.len() + k as usize);
                write_png(&folder.join(&name), &Image { width: w, height: h, pixels }).expect("writable");
                images.push(name.into());
            }
            fringes.push(FringeSet { axis, count, steps: 4, gain_dn_per_e: Some(GAIN), exposure_ms: None, images });
        }
    }
    let capture = Capture {
        folder: folder.into(),
        format: 1,
        taken_at: "2026-11-22T05:00:00Z".into(),
        camera: Camera {
            width: w,
            height: h,
            bits: 8,
            white_level: None,
            black_level: 2.0,
            read_noise_e: Some(READ_E),
            serial: Some("CAM1".into()),
        },
        images: Images::default(),
        projector: Projector { width: rig.projector.width, height: rig.projector.height },
        fringes,
        conditions: Conditions::default(),
    };
    capture.write().expect("writable");
}

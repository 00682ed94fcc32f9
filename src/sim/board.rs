//! A flat printed board before camera and projector, rendered: for calibration and its experiments.
//! In:  a rig, a board, where it stands. Out: what every pixel's rays meet; electrons; grey images with noise.
//! Not here: paint, glare, a bent board, other light than the hall's and the projector's.

use crate::calibrate::{Board, BoardKind};
use crate::capture::{Camera, Capture, Conditions, FringeSet, Images, Projector};
use crate::fringe::{self, Axis, PatternSet};
use crate::geometry::{Point3, Pose, frame};
use crate::image::Image;
use crate::optics::Rig;
use nalgebra::{Rotation3, Vector2, Vector3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Where a board stands.
pub type CameraFromBoard = Pose<frame::Camera, frame::Board>;

/// The board's middle at (x, y, z) mm before the camera, tilted about its horizontal, its vertical and the view's axis, degrees.
pub fn place(board: &Board, at: [f64; 3], tilt_deg: [f64; 3]) -> CameraFromBoard {
    let [a, b, c] = tilt_deg.map(f64::to_radians);
    let r = Rotation3::from_euler_angles(a, b, c);
    let middle = Vector2::new((board.columns - 1) as f64, (board.rows - 1) as f64) * board.pitch / 2.0;
    Pose::new(r, Vector3::from(at) - r * middle.push(0.0))
}

/// Eight places that tell a rig what it needs.
pub fn places(board: &Board) -> Vec<CameraFromBoard> {
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
pub type Met = (f32, Option<(f32, f32)>);

/// Rays per pixel along each side.
pub const RAYS: usize = 4;
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
pub fn meet_all(rig: &Rig, board: &Board, pose: &CameraFromBoard) -> Vec<Met> {
    (0..rig.camera.height).into_par_iter().flat_map_iter(|y| meet_row(rig, board, pose, y)).collect()
}

fn meet_row(rig: &Rig, board: &Board, pose: &CameraFromBoard, y: usize) -> Vec<Met> {
    let step = WIDTH / RAYS as f64;
    let ray = |i: usize| {
        let (x, part) = (i / (RAYS * RAYS), i % (RAYS * RAYS));
        // sheared both ways: an edge along a row or a column must not meet rays four at a time
        let (i, j) = (part % RAYS, part / RAYS);
        let off = |k: usize, other: usize| (k as f64 + (other as f64 + 0.5) / RAYS as f64) * step - WIDTH / 2.0;
        meet(rig, board, pose, x as f64 + off(i, j), y as f64 + off(j, i))
    };
    (0..rig.camera.width * RAYS * RAYS).map(ray).collect()
}

/// Grey levels per electron of the camera that looks at boards, its read noise (electrons) and level of no light.
pub const GAIN: f64 = 0.032;
/// See there.
pub const READ_E: f64 = 6.0;
/// See there.
pub const BLACK: f64 = 2.0;
/// Electrons of what is as bright as can be.
const FULL_E: f64 = 7000.0;

/// Electrons of every fringe image of `sets` (along which axis, how many fringes, how many steps), in their order: under ambient
/// light and a projector that is darker towards its edges.
pub fn fringes(
    rig: &Rig,
    board: &Board,
    pose: &CameraFromBoard,
    sets: &[(Axis, u32, u32)],
) -> Result<Vec<Image<f32>>, fringe::Error> {
    let mut shown = Vec::new();
    for &(axis, count, steps) in sets {
        let set = PatternSet::new(axis, count, steps)?;
        let extent = if axis == Axis::Column { rig.projector.width } else { rig.projector.height };
        shown.extend((0..steps).map(|k| (axis, TAU / set.pitch(extent), set.shift(k))));
    }
    let (w, h) = (rig.camera.width, rig.camera.height);
    let mut images = vec![Image::filled(w, h, 0f32); shown.len()];
    let mut rows: Vec<Vec<&mut [f32]>> = (0..h).map(|_| Vec::with_capacity(shown.len())).collect();
    for image in &mut images {
        rows.iter_mut().zip(image.pixels.chunks_exact_mut(w)).for_each(|(row, pixels)| row.push(pixels));
    }
    let size = [rig.projector.width as f64, rig.projector.height as f64];
    rows.par_iter_mut().enumerate().for_each(|(y, row)| {
        let rays = meet_row(rig, board, pose, y);
        for (out, &(axis, turn, shift)) in row.iter_mut().zip(&shown) {
            let light = |lit: &Option<(f32, f32)>| {
                let Some((column, row)) = *lit else { return 0.08 };
                let at = f64::from(if axis == Axis::Column { column } else { row });
                let pattern = 0.5 + 0.5 * ((at + 0.5) * turn + shift).cos();
                let (x, y) = (f64::from(column) / size[0], f64::from(row) / size[1]);
                let vignette = 1.0 - 0.35 * ((x - 0.5).powi(2) + (y - 0.5).powi(2));
                0.08 + 0.9 * vignette * pattern
            };
            for (out, rays) in out.iter_mut().zip(rays.chunks_exact(RAYS * RAYS)) {
                let mean = rays.iter().map(|(a, lit)| f64::from(*a) * light(lit)).sum::<f64>() / rays.len() as f64;
                *out = (FULL_E * mean) as f32;
            }
        }
    });
    Ok(images)
}

/// The 8-bit image of so many electrons, with shot and read noise; `normal` gives numbers of mean 0 and standard deviation 1.
pub fn exposed(electrons: &Image<f32>, mut normal: impl FnMut() -> f64) -> Image<u8> {
    let level = |e: &f32| {
        let e = f64::from(*e);
        let noise = (e + READ_E * READ_E).sqrt() * normal();
        (BLACK + GAIN * (e + noise)).round().clamp(0.0, 255.0) as u8
    };
    Image { width: electrons.width, height: electrons.height, pixels: electrons.pixels.iter().map(level).collect() }
}

/// The description of a capture of [`fringes`], whose images are `fringe-00.png` and so on; its folder is still to be named.
pub fn described(rig: &Rig, sets: &[(Axis, u32, u32)]) -> Capture {
    let mut names = (0..).map(|k: usize| format!("fringe-{k:02}.png").into());
    let set = |&(axis, count, steps): &(Axis, u32, u32)| FringeSet {
        axis,
        count,
        steps,
        gain_dn_per_e: Some(GAIN),
        exposure_ms: None,
        images: names.by_ref().take(steps as usize).collect(),
    };
    let fringes = sets.iter().map(set).collect();
    Capture {
        folder: std::path::PathBuf::new(),
        format: 1,
        taken_at: "2026-11-22T05:00:00Z".into(),
        camera: Camera {
            width: rig.camera.width,
            height: rig.camera.height,
            bits: 8,
            white_level: None,
            black_level: BLACK,
            read_noise_e: Some(READ_E),
            serial: Some("CAM1".into()),
        },
        images: Images::default(),
        projector: Projector { width: rig.projector.width, height: rig.projector.height },
        fringes,
        conditions: Conditions::default(),
    }
}

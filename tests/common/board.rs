//! Captures of a flat printed board, rendered: for tests of calibration that need no data.

use datum::calibrate::Board;
use datum::fringe::Axis;
use datum::image::write_png;
pub(crate) use datum::sim::board::*;
use datum::{Lens, Pose, Rig};
use nalgebra::{Rotation3, Vector3};
use std::path::Path;

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

/// Writes a capture of `board` at `pose` into `folder`: columns of 1, 8 and 40 fringes, rows of 1, 8 and 25 if `rows`, four
/// steps each, with noise.
pub(crate) fn write_capture(folder: &Path, rig: &Rig, board: &Board, pose: &CameraFromBoard, rows: bool, seed: u64) {
    std::fs::create_dir_all(folder).expect("the target folder is writable");
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut gauss = || {
        // the sum of four uniform numbers of variance 1/12 is Gaussian enough for sensor noise
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        (uniform() + uniform() + uniform() + uniform()) * 3f64.sqrt()
    };
    let all = [(Axis::Column, [1, 8, 40]), (Axis::Row, [1, 8, 25])];
    let of_axes = all.into_iter().take(if rows { 2 } else { 1 });
    let sets: Vec<_> = of_axes.flat_map(|(axis, counts)| counts.map(|count| (axis, count, 4))).collect();
    let mut capture = described(rig, &sets);
    capture.folder = folder.into();
    let images = fringes(rig, board, pose, &sets).expect("legal");
    for (electrons, name) in images.iter().zip(capture.fringes.iter().flat_map(|set| &set.images)) {
        write_png(&folder.join(name), &exposed(electrons, &mut gauss)).expect("writable");
    }
    capture.write().expect("writable");
}

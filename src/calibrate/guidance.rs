//! What is missing while calibrating, in words. In: where boards were seen and how they were tilted. Out: the share of the
//! field they cover, and what to take next. Not here: how good the calibration is; its covariance says that.

use super::adjust::Seen;
use crate::geometry::{Pose, frame};

/// Below it a board tells no focal length.
const TILTED_DEG: f64 = 15.0;
/// Views that should show each part of the field, and each tilt.
const ENOUGH: usize = 2;
/// Points that make a view show a part of the field.
const POINTS: usize = 4;
/// Parts of the field, three by three.
const PARTS: [&str; 9] =
    ["upper left", "the top", "upper right", "left", "the centre", "right", "lower left", "the bottom", "lower right"];
/// Columns and rows of cells whose share is the coverage.
const CELLS: (usize, usize) = (8, 6);

/// What the views show of the field.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Share of the camera's image in which points were seen.
    pub share: f64,
    /// What to take next; empty where nothing is missing.
    pub missing: Vec<String>,
}

/// How a board is tilted, degrees: about its horizontal and about its vertical axis.
fn tilts_deg(camera_from_board: &Pose<frame::Camera, frame::Board>) -> (f64, f64) {
    let normal = camera_from_board.r.matrix().column(2).into_owned();
    (normal.y.atan2(normal.z).to_degrees(), normal.x.atan2(normal.z).to_degrees())
}

/// What `views` (camera points and pose of each) show of an image of `width` × `height`.
pub(super) fn coverage(
    (width, height): (usize, usize),
    views: &[(&[Seen], Pose<frame::Camera, frame::Board>)],
) -> Coverage {
    let cell = |at: &crate::Pixel, columns: usize, rows: usize| {
        let of =
            |v: f64, size: usize, n: usize| (((v + 0.5) / size as f64 * n as f64).floor().max(0.0) as usize).min(n - 1);
        of(at.y, height, rows) * columns + of(at.x, width, columns)
    };
    let mut covered = vec![false; CELLS.0 * CELLS.1];
    let mut seen_by = [0usize; 9];
    for (seen, _) in views {
        let mut points = [0usize; 9];
        for (_, at) in *seen {
            covered[cell(at, CELLS.0, CELLS.1)] = true;
            points[cell(at, 3, 3)] += 1;
        }
        seen_by.iter_mut().zip(points).for_each(|(n, p)| *n += usize::from(p >= POINTS));
    }
    let mut missing = Vec::new();
    for (part, n) in PARTS.iter().zip(seen_by).filter(|(_, n)| *n < ENOUGH) {
        missing.push(format!("{} at {part}, tilted", more(n)));
    }
    let tilts: Vec<(f64, f64)> = views.iter().map(|(_, pose)| tilts_deg(pose)).collect();
    for (axis, edge, tilted) in [
        ("horizontal", "top", tilts.iter().filter(|t| t.0.abs() >= TILTED_DEG).count()),
        ("vertical", "left edge", tilts.iter().filter(|t| t.1.abs() >= TILTED_DEG).count()),
    ] {
        if tilted < ENOUGH {
            let n = more(tilted);
            missing.push(format!("{n} with its {edge} 20° to 40° nearer or farther (about its {axis} axis)"));
        }
    }
    Coverage { share: covered.iter().filter(|c| **c).count() as f64 / covered.len() as f64, missing }
}

fn more(seen: usize) -> &'static str {
    if seen == 0 { "two more" } else { "one more" }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pixel;
    use nalgebra::{Rotation3, Vector3};

    fn view(x: f64, y: f64, tilt: (f64, f64)) -> (Vec<Seen>, Pose<frame::Camera, frame::Board>) {
        let seen = (0..16).map(|k| (k, Pixel::new(x + 60.0 * (k % 4) as f64, y + 60.0 * (k / 4) as f64))).collect();
        let r = Rotation3::from_euler_angles(tilt.0, tilt.1, 0.0);
        (seen, Pose::new(r, Vector3::new(0.0, 0.0, 700.0)))
    }

    fn missing(views: &[(Vec<Seen>, Pose<frame::Camera, frame::Board>)]) -> Coverage {
        let views: Vec<_> = views.iter().map(|(s, p)| (s.as_slice(), *p)).collect();
        coverage((900, 900), &views)
    }

    #[test]
    fn a_corner_that_no_board_showed_is_named() {
        let everywhere_but_one = (0..8).flat_map(|part| {
            let at = (f64::from(part % 3) * 300.0 + 50.0, f64::from(part / 3) * 300.0 + 50.0);
            [view(at.0, at.1, (0.4, 0.0)), view(at.0, at.1, (0.0, -0.4))]
        });
        let mut views: Vec<_> = everywhere_but_one.collect();
        let got = missing(&views);
        assert_eq!(got.missing, ["two more at lower right, tilted"]);
        assert!(got.share < 0.9 && got.share > 0.3);
        views.push(view(650.0, 650.0, (0.4, 0.0)));
        assert_eq!(missing(&views).missing, ["one more at lower right, tilted"]);
        views.push(view(650.0, 650.0, (0.4, 0.0)));
        assert!(missing(&views).missing.is_empty());
    }

    #[test]
    fn frontal_boards_ask_for_tilt_about_the_axis_that_lacks_it() {
        let tilted = |tilt| missing(&[view(0.0, 0.0, tilt), view(50.0, 50.0, tilt)]).missing;
        let asks = |missing: &[String], axis: &str| missing.iter().any(|m| m.contains(axis));
        let frontal = tilted((0.05, -0.1));
        assert!(asks(&frontal, "horizontal") && asks(&frontal, "vertical"), "{frontal:?}");
        let nodded = tilted((0.5, 0.0));
        assert!(!asks(&nodded, "horizontal") && asks(&nodded, "vertical"), "{nodded:?}");
    }
}

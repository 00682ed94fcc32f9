//! Where the taught features are in the red image, and a first pose from that.
//! In:  the red image, the templates, the camera. Out: a pixel per feature with its score, and a pose good to a few mm.
//! Not here: depth; sub-pixel contours; the learned detector, which gives regions, too.

use crate::code::Code;
use crate::contour::{GradientField, Match, ShapePoint};
use crate::geometry::{Local, Point3, Pose, frame};
use crate::image::Image;
use crate::lent::List;
use crate::optics::{Lens, Pixel};
use crate::vehicle::{Anchor, PerFeature, Template};
use nalgebra::{Matrix2, Rotation3, SMatrix, SVector, Vector2, Vector3};

/// A feature's place in the image, to a few pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Region {
    /// Where the taught point is.
    pub(crate) pixel: Pixel,
    /// Mean cosine of the match, or how sure the detector was, 0..=1.
    pub(crate) score: f64,
    /// Whether the detector proposed it.
    pub(crate) by_detector: bool,
}

/// Vehicles stand this much nearer or farther than the taught one.
const SCALES: [f64; 5] = [0.90, 0.95, 1.0, 1.05, 1.10];
/// And are turned this much in the image, degrees.
const TURNS: [f64; 3] = [-3.0, 0.0, 3.0];
/// Below this mean cosine a feature is not there: on captures of the right body matches reach 0.8 and more, other
/// places 0.5.
const MIN_SCORE: f64 = 0.62;
/// A second match as good as this share of the best makes a feature ambiguous, unless the others say which it is.
const AMBIGUOUS: f64 = 0.85;
/// Matches nearer to each other are one, mm.
const APART_MM: f64 = 15.0;
/// Candidates kept per feature.
const KEPT: usize = 4;

/// Pixels of the full image per pixel of the search's field: 2.2 mm on the body, so that a gap is still a line.
pub(crate) fn search_factor(mm_per_pixel: f64) -> usize {
    (2.2 / mm_per_pixel).round().max(1.0) as usize
}

/// The field that shapes are taken from and searched in.
pub(crate) fn search_field(red: &Image<f32>, mm_per_pixel: f64) -> GradientField {
    let mut levels = List::of(red.pixels.iter().step_by(97).copied());
    let upper = levels.len() * 3 / 4;
    let body = *levels.select_nth_unstable_by(upper, f32::total_cmp).1;
    GradientField::new(red, search_factor(mm_per_pixel), (0.08 * body).max(2.0))
}

/// Searches every template. A feature that is not found has code 401, one that is found twice 402.
pub(crate) fn find(red: &Image<f32>, camera: &Lens, templates: &[Template]) -> PerFeature<Result<Region, Code>> {
    let Some(first) = templates.first() else { return PerFeature::new() };
    let taught = first.taught_pose();
    let depth = (taught * Point3::new(Vector3::from(first.point_mm))).xyz.z;
    let field = search_field(red, depth / camera.fx);
    let candidates: PerFeature<List<Match>> = templates
        .iter()
        .map(|t| {
            let mut found = field.search(&attitudes(t, camera, &taught), KEPT, APART_MM * camera.fx / depth);
            found.retain(|m| m.score >= MIN_SCORE);
            found
        })
        .collect();
    arrange(&candidates, camera, templates, &taught, 1.0)
}

/// The taught shape as it would look at each scale and turn, px about the taught point.
fn attitudes(
    template: &Template,
    camera: &Lens,
    taught: &Pose<frame::Camera, frame::Vehicle>,
) -> List<List<ShapePoint>> {
    let to_pixels = pixels_per_mm(template, camera, taught);
    let across = to_pixels.try_inverse().unwrap_or_else(Matrix2::identity).transpose(); // normals turn inversely
    let step = template.shape.len().div_ceil(160);
    let mut out = List::new();
    for scale in SCALES {
        for turn in TURNS {
            let turn = nalgebra::Rotation2::new(f64::to_radians(turn));
            let shape = template.shape.iter().step_by(step).map(|p| ShapePoint {
                offset: turn * (to_pixels * p.at()) * scale,
                direction: (turn * (across * p.normal())).normalize(),
            });
            out.push(List::of(shape));
        }
    }
    out
}

/// ∂pixel/∂(u, v) at the template's origin on a vehicle standing at `pose`, px/mm.
pub(crate) fn pixels_per_mm(
    template: &Template,
    camera: &Lens,
    pose: &Pose<frame::Camera, frame::Vehicle>,
) -> Matrix2<f64> {
    local_pixels_per_mm(&template.local(pose), camera)
}

/// ∂pixel/∂(u, v) at the origin of `local`, px/mm.
pub(crate) fn local_pixels_per_mm(local: &Local<frame::Camera>, camera: &Lens) -> Matrix2<f64> {
    let pixel = |u: f64, v: f64| {
        let p = local.point(&Vector3::new(u, v, 0.0));
        camera.project(&p.xyz).unwrap_or(Pixel::zeros())
    };
    Matrix2::from_columns(&[(pixel(1.0, 0.0) - pixel(-1.0, 0.0)) * 0.5, (pixel(0.0, 1.0) - pixel(0.0, -1.0)) * 0.5])
}

/// Picks one candidate per feature so that they lie to each other as the taught ones do, within `slack` times what the
/// search allows.
pub(super) fn arrange(
    candidates: &[List<Match>],
    camera: &Lens,
    templates: &[Template],
    taught: &Pose<frame::Camera, frame::Vehicle>,
    slack: f64,
) -> PerFeature<Result<Region, Code>> {
    let expected: PerFeature<Pixel> = templates
        .iter()
        .map(|t| camera.project(&(*taught * Point3::new(Vector3::from(t.point_mm))).xyz).unwrap_or(Pixel::zeros()))
        .collect();
    let fits = |i: usize, a: &Match, j: usize, b: &Match| {
        let (seen, known) = (b.at - a.at, expected[j] - expected[i]);
        let ratio = seen.norm() / known.norm();
        let turn = known.perp(&seen).atan2(known.dot(&seen));
        // the arch's place along itself is loose: it counts for little in the search
        let loose = [i, j].iter().any(|k| matches!(templates[*k].anchor, Anchor::ArchTop { .. }));
        let (stretch, angle) = if loose { (0.30, 0.35) } else { (0.15, 0.14) };
        (ratio - 1.0).abs() < slack * stretch && turn.abs() < slack * angle
    };
    // every choice of a candidate or none per feature; few candidates, so few choices
    let mut best: (f64, PerFeature<Option<Match>>) = (0.0, candidates.iter().map(|_| None).collect());
    let mut choice: PerFeature<usize> = candidates.iter().map(|_| 0).collect();
    loop {
        let picked: PerFeature<Option<Match>> = choice
            .iter()
            .zip(candidates)
            .map(|(&c, list)| c.checked_sub(1).and_then(|c| list.get(c).copied()))
            .collect();
        let consistent = (0..picked.len()).all(|i| {
            (0..i).all(|j| match (&picked[i], &picked[j]) {
                (Some(a), Some(b)) => fits(i, a, j, b),
                _ => true,
            })
        });
        let score: f64 = picked.iter().flatten().map(|m| m.score).sum();
        if consistent && score > best.0 {
            best = (score, picked);
        }
        let Some(next) = (0..choice.len()).find(|&k| choice[k] < candidates[k].len()) else { break };
        choice[next] += 1;
        choice[..next].fill(0);
    }
    let alone = best.1.iter().flatten().count() < 2;
    best.1
        .iter()
        .zip(candidates)
        .map(|(picked, list)| match picked {
            Some(m) if alone && list.iter().any(|o| o.at != m.at && o.score > AMBIGUOUS * m.score) => {
                Err(Code::Ambiguous)
            }
            Some(m) => Ok(Region { pixel: m.at, score: m.score, by_detector: false }),
            None => Err(Code::NotFound),
        })
        .collect()
}

/// Regions of one vehicle do not contradict each other by more than this (chi², of three or four of them).
pub(super) const CONSISTENT: f64 = 20.0;

/// The first pose. A region that contradicts the others is something else than the feature: it is given up.
pub(crate) fn first_pose(
    camera: &Lens,
    templates: &[Template],
    regions: &mut [Result<Region, Code>],
) -> Option<Pose<frame::Camera, frame::Vehicle>> {
    let (mut pose, chi2) = nearest_pose(camera, templates, regions)?;
    let found: PerFeature<usize> = (0..regions.len()).filter(|&k| regions[k].is_ok()).collect();
    if chi2 > CONSISTENT && found.len() > 2 {
        let without = |&k: &usize| {
            let mut rest: PerFeature<_> = regions.iter().copied().collect();
            rest[k] = Err(Code::NotFound);
            nearest_pose(camera, templates, &rest).map(|(pose, chi2)| (k, pose, chi2))
        };
        let best = found.iter().filter_map(without).min_by(|a, b| a.2.total_cmp(&b.2));
        if let Some((k, rest, _)) = best.filter(|b| b.2 < CONSISTENT) {
            regions[k] = Err(Code::NotFound);
            pose = rest;
        }
    }
    Some(pose)
}

/// The pose that best explains where the features were found, near the taught one: least squares on pixels, with
/// what a vehicle can do in the station as prior. Good to a few mm and degrees; depth does the rest. With its chi².
pub(super) fn nearest_pose(
    camera: &Lens,
    templates: &[Template],
    regions: &[Result<Region, Code>],
) -> Option<(Pose<frame::Camera, frame::Vehicle>, f64)> {
    let taught = templates.first()?.taught_pose();
    let found: PerFeature<(&Template, &Region)> =
        templates.iter().zip(regions).filter_map(|(t, r)| Some((t, r.as_ref().ok()?))).collect();
    if found.is_empty() {
        return None;
    }
    let pivot = found.iter().map(|(t, _)| Vector3::from(t.point_mm)).sum::<Vector3<f64>>() / found.len() as f64;
    let moved = |s: &SVector<f64, 6>| {
        let turn = Rotation3::new(Vector3::new(s[3], s[4], s[5]));
        let about =
            Pose::<frame::Vehicle, frame::Vehicle>::new(turn, pivot + Vector3::new(s[0], s[1], s[2]) - turn * pivot);
        taught * about
    };
    // x, y, z: mm; roll, pitch, yaw: rad
    let prior = SVector::<f64, 6>::from([120.0, 80.0, 80.0, 0.035, 0.035, 0.15]).map(|s: f64| 1.0 / (s * s));
    let residuals = |s: &SVector<f64, 6>| -> PerFeature<Vector2<f64>> {
        let pose = moved(s);
        found
            .iter()
            .map(|(t, r)| {
                let at = camera.project(&(pose * Point3::new(Vector3::from(t.point_mm))).xyz);
                let off = pixels_per_mm(t, camera, &pose).try_inverse().unwrap_or_else(Matrix2::zeros)
                    * (r.pixel - at.unwrap_or(r.pixel + Vector2::repeat(1e3)));
                // sigmas, mm: along an arch the match slides
                let along = if matches!(t.anchor, Anchor::ArchTop { .. }) { 20.0 } else { 2.0 };
                Vector2::new(off.x / along, off.y / 2.0)
            })
            .collect()
    };
    let mut state = SVector::<f64, 6>::zeros();
    for _ in 0..15 {
        let now = residuals(&state);
        let mut normal = SMatrix::<f64, 6, 6>::from_diagonal(&prior);
        let mut right = -prior.component_mul(&state);
        let columns: [PerFeature<_>; 6] = std::array::from_fn(|k| {
            let h = if k < 3 { 0.1 } else { 1e-4 };
            let mut step = state;
            step[k] += h;
            residuals(&step).iter().zip(&now).map(|(a, b)| (a - b) / h).collect()
        });
        for (i, r) in now.iter().enumerate() {
            for a in 0..6 {
                right[a] -= columns[a][i].dot(r);
                for b in 0..6 {
                    normal[(a, b)] += columns[a][i].dot(&columns[b][i]);
                }
            }
        }
        let step = normal.cholesky()?.solve(&right);
        state += step;
        if step.norm() < 1e-6 {
            break;
        }
    }
    let misfit: f64 = residuals(&state).iter().map(Vector2::norm_squared).sum();
    Some((moved(&state), misfit + state.component_mul(&state).dot(&prior)))
}

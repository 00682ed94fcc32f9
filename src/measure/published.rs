//! The method as published (Scientific Reports 2025, s41598-025-07269-y): the control that ours is held against.
//! In:  the regions, the red image, the fringes of a cycle. Out: a pose that no one should rely on.
//! Not here: regions, edges, ellipses, depth, registration; they are ours, so that what differs is the method alone.
//!
//! A feature is a pixel: its template laid onto the image by translation and scale, to whole pixels; of a cap, the centre
//! of the ellipse through its contour in the image. Its depth is what the phase map says at that pixel. The pose is the
//! rigid transform of these points, all weighted alike.

use super::cycle::{Run, about};
use super::depth::{Decoded, red_noise};
use super::edges::edge_rays;
use super::judge::{self, Judged, Refused};
use super::regions::Region;
use super::{FeatureResult, Measurement, Stage, TYPICAL_DISTANCE_MM, Verdict};
use crate::code::Code;
use crate::contour::{EllipseLimits, GradientField, ShapePoint, fit_ellipse};
use crate::fringe::{self, DepthMap, NoiseLaw, State};
use crate::geometry::{Pair, Point3, frame, register};
use crate::image::{Image, Window};
use crate::lent::List;
use crate::optics::{Lens, Pixel};
use crate::vehicle::{Anchor, ContourPoint, Feature, PerFeature, Template};
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

/// Vehicles stand this much nearer or farther than the taught one, in steps of what is half a pixel at a corner's rim.
const SCALES: std::ops::RangeInclusive<i32> = -10..=10;
const SCALE_STEP: f64 = 0.01;
/// A region's place is known to this, mm.
const REGION_MM: f64 = 25.0;
/// Points of a template that are matched.
const POINTS: usize = 160;
/// Matches nearer to each other are one, px.
const APART_PX: f64 = 6.0;
/// An edge is an edge of the image with this share of the body's grey level per px.
const LEAST_SLOPE: f64 = 0.08;
/// Edges this near the matched contour, mm, and of its direction, are the cap's.
const CAP_MM: f64 = 4.0;
const AGREEING: f64 = 0.8;
/// Share of the cap's turn that must be seen.
const COVERAGE: f64 = 0.7;
/// In a gap there is no depth: the nearest pixel's is read, no farther off than this, mm.
const NEAREST_MM: f64 = 10.0;
/// The body's depth differs by no more within that, mm.
const BODY_MM: f64 = 20.0;

/// A feature: its pixel, its point, how well its template matched.
type Seen = (Pixel, Point3<frame::Camera>, f64);

/// A template where it was found in the image.
struct Matched {
    at: Pixel,
    /// Its contour's points from there.
    contour: List<ShapePoint>,
    score: f64,
}

impl Run<'_, '_> {
    /// The measurement. `ended` is told when each stage has ended.
    pub(super) fn published(
        &mut self,
        decoded: Result<&mut Decoded, &mut fringe::Error>,
        ended: &mut dyn FnMut(Stage),
    ) -> Measurement {
        let mut seen = Vec::new();
        let outcome = self.usable().and_then(|()| {
            seen = self.seen(decoded, ended)?;
            self.rigid(&seen)
        });
        ended(Stage::Contour);
        let residuals: Vec<f64> = outcome.iter().flat_map(|j| &j.registration.residuals).map(Vector3::norm).collect();
        let mut out = self.report(outcome);
        if out.verdict != Verdict::NotMeasurable {
            // Nothing is propagated, and the residual tells little: where the points' errors shift or turn all of them
            // alike, they fit. What is not known is not stated, and what states no uncertainty is never ok.
            (out.verdict, out.code) = (Verdict::TooUncertain, Some(Code::Uncertain));
            (out.covariance, out.uncertainty_k2) = (None, None);
            out.detail = "The published method states no uncertainty; its pose is for comparison only.".into();
        }
        let mut residuals = residuals.into_iter();
        for (feature, seen) in out.features.iter_mut().zip(seen) {
            match seen {
                Ok((pixel, point, score)) => {
                    *feature = FeatureResult {
                        pixel: Some(pixel.into()),
                        camera_mm: Some(point.xyz.into()),
                        residual_mm: residuals.next(),
                        score: Some(score),
                        ..feature.clone()
                    }
                }
                Err(code) => feature.code = Some(code),
            }
        }
        out
    }

    /// Every feature of the model.
    fn seen(
        &self,
        decoded: Result<&mut Decoded, &mut fringe::Error>,
        ended: &mut dyn FnMut(Stage),
    ) -> Result<Vec<Result<Seen, Code>>, Refused> {
        let (c, m) = (self.cycle, self.cycle.measurer);
        let ambiguous = |e: &fringe::Error| Self::refuse(Code::PhaseAmbiguity, e.to_string());
        let decoded = decoded.map_err(|e| ambiguous(e))?;
        // of the flap, too, where ours looks for no depth
        decoded.everywhere(&c.fringes, c.capture).map_err(|e| ambiguous(&e))?;
        let map = DepthMap::new(&m.depth_rig, &c.rays, &decoded.coordinates);
        ended(Stage::Decode);
        let noise = red_noise(c.capture, &decoded.noise);
        let camera = &m.calibration.rig.camera;
        let found = |(template, region): (&Template, &Result<Region, Code>)| {
            let matched = matched(&c.red, camera, template, &(*region)?, c.light.body).ok_or(Code::NotFound)?;
            let pixel = match template.anchor {
                Anchor::Ellipse { .. } => cap(&c.red, camera, &matched, &noise)?,
                Anchor::Contour | Anchor::ArchTop { .. } => matched.at,
            };
            let z = depth_at(&map, &m.depth_rig.camera, &(pixel / m.every as f64)).ok_or(Code::CoverageLow)?;
            let ray = camera.ray(&pixel).ok_or(Code::OutOfVolume)?;
            Ok((pixel, Point3::new(ray * z), matched.score))
        };
        Ok(m.templates.par_iter().zip(&c.regions[..]).map(found).collect())
    }

    /// The rigid transform of what was seen.
    fn rigid(&mut self, seen: &[Result<Seen, Code>]) -> Result<Judged, Refused> {
        let features = &self.cycle.measurer.vehicle.features;
        let points: Vec<_> = features.iter().zip(seen).filter_map(|(f, s)| Some((f, s.as_ref().ok()?.1))).collect();
        // all weighted alike, which is Kabsch's solution
        let pair = |(f, measured): &(&Feature, Point3<frame::Camera>)| Pair {
            measured: *measured,
            nominal: f.position(),
            covariance: Matrix3::identity(),
        };
        let registration = register(&points.iter().map(pair).collect::<Vec<_>>())
            .map_err(|e| Self::refuse(Code::TooFewFeatures, e.to_string()))?;
        self.pose = Some(registration.a_from_b);
        let deviation = |i: usize, j: usize| {
            let nominal = (points[i].0.position() - points[j].0.position()).norm();
            ((points[i].1 - points[j].1).norm() - nominal).abs()
        };
        let deviations = (0..points.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        Ok(Judged {
            covariance: registration.covariance,
            residual_rms_mm: judge::rms(&registration.residuals),
            distance_deviation_mm: deviations.map(|(i, j)| deviation(i, j)).fold(0.0, f64::max),
            points_minus_dense_mm: None,
            gain: PerFeature::new(),
            registration,
        })
    }
}

/// The taught contour as it looked in the taught image: offsets from the taught point, px.
fn taught_shape(template: &Template, camera: &Lens) -> Option<Vec<ShapePoint>> {
    let local = template.local(&template.taught_pose());
    let surface = template.surface.polynomial()?;
    let pixel =
        |uv: Vector2<f64>| camera.project(&local.point(&uv.push(surface.height(&uv) - template.edge_depth_mm)).xyz);
    let anchor = camera.project(&local.point(&Vector3::from(template.at_mm)).xyz)?;
    let step = template.contour.len().div_ceil(POINTS);
    let point = |p: &ContourPoint| {
        let (at, bright) = (pixel(p.at())?, pixel(p.at() + p.normal() * 0.1)?);
        Some(ShapePoint { offset: at - anchor, direction: (bright - at).normalize() })
    };
    template.contour.iter().step_by(step).map(point).collect()
}

/// Where in `red` about `region` the template lies, to a pixel and a step of scale. `body` is the body's grey level.
fn matched(red: &Image<f32>, camera: &Lens, template: &Template, region: &Region, body: f64) -> Option<Matched> {
    let shape = taught_shape(template, camera)?;
    let reach = shape.iter().map(|p| p.offset.norm()).fold(0.0, f64::max);
    let largest = 1.0 + SCALE_STEP * f64::from(*SCALES.end());
    let half = largest * (reach + REGION_MM * camera.fx / TYPICAL_DISTANCE_MM);
    let (low, high) = (region.pixel.add_scalar(-half), region.pixel.add_scalar(half));
    let w = Window::clipped(low.x, low.y, high.x, high.y, red.width, red.height)?;
    let pixels = (w.y..w.y + w.height).flat_map(|y| &red.row(y)[w.x..w.x + w.width]).copied().collect();
    let field = GradientField::new(&Image { width: w.width, height: w.height, pixels }, 1, (LEAST_SLOPE * body) as f32);
    let at_scale = |step: i32| {
        let scale = 1.0 + SCALE_STEP * f64::from(step);
        let scaled = |p: &ShapePoint| ShapePoint { offset: p.offset * scale, ..*p };
        let contour = List::of(shape.iter().map(scaled));
        let best = *field.search(std::slice::from_ref(&contour), 1, APART_PX).first()?;
        Some(Matched { at: best.at + Pixel::new(w.x as f64, w.y as f64), contour, score: best.score })
    };
    SCALES.filter_map(at_scale).max_by(|a, b| a.score.total_cmp(&b.score))
}

/// The centre of the ellipse through the edges of the image along the matched contour.
fn cap(red: &Image<f32>, camera: &Lens, matched: &Matched, noise: &NoiseLaw) -> Result<Pixel, Code> {
    let near = CAP_MM * camera.fx / TYPICAL_DISTANCE_MM;
    let reach = matched.contour.iter().map(|p| p.offset.norm()).fold(0.0, f64::max) + near;
    let centre = camera.ray(&matched.at).ok_or(Code::OutOfVolume)?;
    let window = about(camera, &centre, reach / camera.fx).ok_or(Code::OutOfVolume)?;
    let on_cap = |at: &Pixel, normal: &Vector2<f64>| {
        matched.contour.iter().any(|p| (matched.at + p.offset - at).norm() < near && p.direction.dot(normal) > AGREEING)
    };
    let edges = edge_rays(red, &[window], noise, camera);
    let edges = edges.iter().flatten().map(|e| &e.edgel).filter(|e| on_cap(&e.position, &e.normal));
    let points: Vec<_> = edges.map(|e| (e.position, e.variance)).collect();
    let limits = EllipseLimits { coverage: COVERAGE, semi_axes: 0.0..=f64::INFINITY };
    Ok(fit_ellipse(&points, &limits).map_err(|_| Code::Ellipse)?.ellipse.centre)
}

/// Depth at a pixel of the map's images, mm, or the nearest there is. Features are on the body, and what else is seen about
/// them, through gaps and in the wheelhouse, lies far behind it.
fn depth_at(map: &DepthMap<'_>, camera: &Lens, pixel: &Pixel) -> Option<f64> {
    let reach = NEAREST_MM * camera.fx / TYPICAL_DISTANCE_MM;
    let w = map.rays.window;
    let (low, high) = (pixel.add_scalar(-reach), pixel.add_scalar(reach));
    let near = Window::clipped(low.x, low.y, high.x, high.y, w.x + w.width, w.y + w.height)?;
    let places = (near.y..near.y + near.height).flat_map(|y| (near.x..near.x + near.width).map(move |x| (x, y)));
    let valid = places.filter_map(|(x, y)| {
        let depth = map.at(x, y).filter(|d| d.state == State::Valid)?;
        let away = (Pixel::new(x as f64, y as f64) - pixel).norm();
        (away <= reach).then_some((away, f64::from(depth.z)))
    });
    let valid: Vec<(f64, f64)> = valid.collect();
    let mut all: Vec<f64> = valid.iter().map(|(_, z)| *z).collect();
    let k = all.len() / 10;
    let front = if all.is_empty() { return None } else { *all.select_nth_unstable_by(k, f64::total_cmp).1 };
    let plausible = valid.iter().filter(|(_, z)| (z - front).abs() < BODY_MM);
    plausible.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, z)| *z)
}

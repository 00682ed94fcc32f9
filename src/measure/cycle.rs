//! One vehicle: the red image first, then each fringe image as it comes, then the result.
//! In:  images and what the capture says of them. Out: a `Measurement`. No I/O, no clock: an observer is told
//! where stages end. No state from one vehicle to the next.

use super::ambient;
use super::body::{self, OnPlane, Panel, Patch, Samples, Shape, Site};
use super::depth::{BodyDepth, Decoded, red_noise, stated_red_noise};
use super::edges::{EdgeRay, edge_rays};
use super::judge::{self, Evidence, Judged, Refused};
use super::light::{Light, saturated_share};
use super::locate::{Located, locate};
use super::moved::Motion;
use super::regions::Region;
use super::workspace::Room;
use super::{Drawing, Measurement, Measurer, Method, TYPICAL_DISTANCE_MM, detected};
use crate::capture::{Capture, Fringes, TYPICAL_GAIN};
use crate::code::Code;
use crate::fringe::{self, Axis, EpipolarCell, NoiseLaw, Rays, State, epipolar_cells};
use crate::geometry::{Pair, Point3, Pose, Surface, frame, register};
use crate::image::{Image, Window};
use crate::lent::{Lent, List, side_by_side};
use crate::optics::{Lens, Pixel};
use crate::vehicle::{Class, PerFeature, Template};
use nalgebra::{Matrix3, Vector2, Vector3};

type CameraFromVehicle = Pose<frame::Camera, frame::Vehicle>;

/// The stages of a measurement, in order; the observer is told when each has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Images read and summed up.
    Read,
    /// Regions found in the red image.
    Detect,
    /// Fringes decoded to depth.
    Decode,
    /// The coarse surface of the body.
    Surface,
    /// Contours and patches of every pass.
    Contour,
    /// Pose, checks, verdict.
    Pose,
}

/// Regions are decoded this much wider than the widest patch and than the panel, mm: for the first pose's error.
pub(super) const MARGIN_MM: f64 = 10.0;
/// What of that a pose from depth may use up; the passes that follow move it no farther than the rest.
const MARGIN_USED_MM: f64 = 7.0;
/// Edges are found this much wider before there is depth, mm; and once more where that was too little.
const EDGE_MARGIN_MM: f64 = 5.0;
/// Passes over all features; the pose is still by then.
const MAX_PASSES: usize = 6;
/// Rotation (rad) and translation (mm) below which a pass is the last: the next would change a tenth of it.
const STILL: (f64, f64) = (1e-5, 2e-3);
/// How far from its expected place a contour is looked for: at first, and once the pose is good, mm.
const CAPTURE_MM: (f64, f64) = (5.0, 1.5);
/// Pixels are looked at anew for a patch where the pose has moved by more than this since they were, mm; else the patch's
/// cells follow it.
const PATCHED_MM: f64 = 0.5;
/// How far inside the panel's border depth is believed: while the pose is coarse, and after, mm.
pub(super) const EROSION_MM: (f64, f64) = (6.0, 1.5);
/// A body that has moved by this much, mm, and so many sigmas, is not measured.
const MOVED_MM: f64 = 0.015;
const MOVED_SIGMAS: f64 = 6.0;
/// Nor is one whose repeated image differs from the first by this many times its noise power: dark paint reaches 3.
const CHANGED: f64 = 5.0;
/// Least light on the body, as a share of white: ten of 255 levels, below which a gap's edge is a few steps of rounding.
const MIN_LIGHT: f64 = 0.04;
/// Blur (px, 1 sigma) beyond which a gap of a few pixels is no longer a line with two edges.
const MAX_BLUR_PX: f64 = 3.0;
/// Regions met with the coarse surface that fit the features worse (chi²) hold one that is none of them.
const CONTRADICTING: f64 = 30.0;
/// What paint and light may have moved edges by where the flap's opening was not seen, mm.
const UNKNOWN_GROWTH_MM: f64 = 0.08;
/// Share of a region's pixels that may be saturated in the red image.
const MAX_SATURATED: f64 = 0.25;

/// A measurement in progress.
pub struct Cycle<'a> {
    pub(super) measurer: &'a Measurer,
    pub(super) capture: &'a Capture,
    pub(super) red: Lent<Image<f32>>,
    /// Of the pixels that depth is looked for in.
    pub(super) rays: Rays,
    pub(super) fringes: Fringes,
    pub(super) red_saturated: PerFeature<f64>,
    pub(super) regions: PerFeature<Result<Region, Code>>,
    pub(super) first_pose: Option<CameraFromVehicle>,
    pub(super) light: Light,
    /// Where edges were looked for before there was depth, and the edges; nowhere where their noise was not known.
    early_edges: Option<(PerFeature<Window>, List<List<EdgeRay>>)>,
    pub(super) moved: bool,
    /// Of the detector.
    warning: Option<String>,
    /// Of all this: the last to be dropped.
    room: Room,
}

impl<'a> Cycle<'a> {
    /// Finds the regions in `red`, before any fringe image is there.
    pub(super) fn new(
        measurer: &'a Measurer,
        capture: &'a Capture,
        red: &Image<u16>,
        ambient: Option<&Image<u16>>,
    ) -> Self {
        let room = measurer.shared.workspace.room();
        room.clone().serve(|| Self::served(measurer, capture, red, ambient, room))
    }

    fn served(
        measurer: &'a Measurer,
        capture: &'a Capture,
        raw: &Image<u16>,
        ambient: Option<&Image<u16>>,
        room: Room,
    ) -> Self {
        let camera = &measurer.calibration.rig.camera;
        let red = ambient::without(raw, ambient, &capture.camera);
        let white = capture.camera.white_level();
        let detected::Regions { regions, pose: first_pose, warning } = detected::regions(measurer, raw, white, &red);
        let window = first_pose.and_then(|pose| depth_window(measurer, &pose)).unwrap_or(Window::whole(1, 1));
        let rays = Rays::new(&measurer.depth_rig.camera, window);
        let wanted = first_pose.map_or_else(List::new, |pose| wanted(measurer, &pose, &rays));
        let red_saturated = measurer
            .templates
            .iter()
            .map(|t| first_pose.map_or(0.0, |pose| saturated_share(raw, white, camera, &t.local(&pose).origin.xyz)))
            .collect();
        let light = Light::new(raw, &red, capture.camera.black_level);
        let early_edges = first_pose.and_then(|pose| {
            let noise = stated_red_noise(capture)?;
            let windows = contour_windows(measurer, &pose, EDGE_MARGIN_MM);
            let edges = edge_rays(&red, &windows, &noise, camera);
            Some((windows, edges))
        });
        Self {
            measurer,
            capture,
            red,
            rays,
            fringes: Fringes::as_they_come(capture, window, measurer.every, wanted),
            red_saturated,
            regions,
            first_pose,
            light,
            early_edges,
            moved: false,
            warning,
            room,
        }
    }

    /// Takes image `step` of fringe set `set`, in any order.
    pub fn add_fringe(&mut self, set: usize, step: u32, image: &Image<u16>) -> Result<(), fringe::Error> {
        self.room.serve(|| self.fringes.add(set, step, image))
    }

    /// Takes `repeat`, the first fringe image once more at the end: where it differs from `first` by more than noise
    /// the vehicle has moved, and is not measured.
    pub fn add_repeat(&mut self, first: &Image<u16>, repeat: &Image<u16>) {
        self.moved = self.differs(first, repeat);
    }

    fn differs(&self, first: &Image<u16>, repeat: &Image<u16>) -> bool {
        let gain = self.capture.fringes.first().and_then(|f| f.gain_dn_per_e).unwrap_or(TYPICAL_GAIN);
        let camera = &self.capture.camera;
        let noise = NoiseLaw::from_sensor(gain, camera.read_noise_e.unwrap_or(0.0), camera.black_level);
        let Some(motion) = Motion::between(first, repeat, self.fringes.in_image(first), camera.white_level(), &noise)
        else {
            return false;
        };
        let mm = motion.px * TYPICAL_DISTANCE_MM / self.measurer.calibration.rig.camera.fx;
        (mm > MOVED_MM && motion.sigmas > MOVED_SIGMAS) || motion.rest > CHANGED
    }

    /// The measurement. `ended` is told when each stage has ended.
    pub fn finish(mut self, ended: &mut dyn FnMut(Stage)) -> (Measurement, Drawing) {
        self.room.clone().serve(|| self.result(ended))
    }

    fn result(&mut self, ended: &mut dyn FnMut(Stage)) -> (Measurement, Drawing) {
        let mut decoded = Decoded::wanted(&mut self.fringes, self.capture);
        let mut run = Run {
            cycle: self,
            located: PerFeature::new(),
            pose: None,
            coverage: None,
            axis: Axis::Column,
            cells: List::new(),
        };
        let mut measurement = match self.measurer.method {
            Method::Points | Method::Dense => run.measurement(decoded.as_mut(), ended),
            Method::Published => run.published(decoded.as_mut(), ended),
        };
        ended(Stage::Pose);
        measurement.station = self.measurer.station();
        measurement.warning = self.warning.clone();
        (measurement, run.drawing())
    }
}

/// What a finished pass knows of each feature.
pub(super) struct Run<'c, 'a> {
    pub(super) cycle: &'c Cycle<'a>,
    pub(super) located: PerFeature<Result<Located, Code>>,
    pub(super) pose: Option<CameraFromVehicle>,
    pub(super) coverage: Option<f64>,
    /// Of the projector, that depth comes from.
    pub(super) axis: Axis,
    /// How far the fringes of the other axis lie off the epipolar lines; empty without.
    pub(super) cells: List<EpipolarCell>,
}

impl<'c> Run<'c, '_> {
    pub(super) fn refuse(code: Code, detail: impl Into<String>) -> Refused {
        Refused { code, detail: detail.into(), distance_deviation_mm: None }
    }

    fn measurement(
        &mut self,
        mut decoded: Result<&mut Decoded, &mut fringe::Error>,
        ended: &mut dyn FnMut(Stage),
    ) -> Measurement {
        let outcome = self.usable().and_then(|()| {
            let decoded = decoded.as_deref_mut().map_err(|e| &mut **e);
            self.pose(decoded, ended)
        });
        let outcome = match &decoded {
            Ok(decoded) => outcome.map_err(|refused| self.or_other_light(refused, &decoded.coordinates)),
            Err(_) => outcome,
        };
        let health = self.health();
        let outcome = match &health {
            Some(health) => outcome.and_then(|judged| self.with_health(judged, health)),
            None => outcome,
        };
        let mut measurement = self.report(outcome);
        measurement.calibration_health = health;
        measurement
    }

    /// Refuses images that nothing should be measured in.
    pub(super) fn usable(&self) -> Result<(), Refused> {
        let c = self.cycle;
        if c.moved {
            let detail = "The repeated fringe image differs from the first by more than noise.";
            return Err(Self::refuse(Code::Moved, detail));
        }
        let bright = c.light.body / (c.capture.camera.white_level() - c.capture.camera.black_level);
        if bright < MIN_LIGHT {
            let detail = format!(
                "The red image's brighter quarter lies {:.1} % of white above black, allowed at least {:.0} %.",
                100.0 * bright,
                100.0 * MIN_LIGHT
            );
            return Err(Self::refuse(Code::TooDark, detail));
        }
        Ok(())
    }

    /// Regions, depth, features, pose: each pass finds the features with the pose of the one before.
    fn pose(
        &mut self,
        decoded: Result<&mut Decoded, &mut fringe::Error>,
        ended: &mut dyn FnMut(Stage),
    ) -> Result<Judged, Refused> {
        let c = self.cycle;
        let (m, templates) = (c.measurer, &c.measurer.templates);
        self.located = c.regions.iter().map(|r| Err(r.err().unwrap_or(Code::TooFewFeatures))).collect();
        let found = c.regions.iter().filter(|r| r.is_ok()).count();
        let Some(first) = c.first_pose.filter(|_| found >= 2) else { return Err(self.too_few()) };
        let ambiguous = |e: &mut fringe::Error| Self::refuse(Code::PhaseAmbiguity, e.to_string());
        let decoded = decoded.map_err(ambiguous)?;
        let red_noise = red_noise(c.capture, &decoded.noise);
        ended(Stage::Decode);

        let far = sites(templates, &m.far, &first);
        let mut body = self.depth(decoded, &far)?;
        let mut pose = self.second_pose(&body.coarse).unwrap_or(first);
        if !within(&pose, &first, m, MARGIN_USED_MM) {
            // regions were decoded about another place: once more, everywhere
            drop(body);
            decoded.everywhere(&c.fringes, c.capture).map_err(|mut e| ambiguous(&mut e))?;
            body = self.depth(decoded, &far)?;
            pose = self.second_pose(&body.coarse).unwrap_or(first);
        }
        ended(Stage::Surface);
        self.on_body(&body, pose, &red_noise, ended)
    }

    /// The pose of the features on `body`, found from a `pose` near it.
    fn on_body(
        &mut self,
        body: &BodyDepth<'_>,
        mut pose: CameraFromVehicle,
        red_noise: &NoiseLaw,
        ended: &mut dyn FnMut(Stage),
    ) -> Result<Judged, Refused> {
        let c = self.cycle;
        let (m, rig, templates) = (c.measurer, &c.measurer.calibration.rig, &c.measurer.templates);
        let rays = self.edges(&contour_windows(m, &pose, 0.0), red_noise);
        let mut samples = self.samples(body, &pose);
        let mut sampled_at = pose;
        let mut patches: PerFeature<Result<Patch, Code>> = PerFeature::new();
        let mut patched_at = None;
        for pass in 0..MAX_PASSES {
            if !within(&pose, &sampled_at, m, MARGIN_MM) {
                (samples, sampled_at) = (self.samples(body, &pose), pose);
            }
            let capture = if pass == 0 { CAPTURE_MM.0 } else { CAPTURE_MM.1 };
            let sites = sites(templates, if pass == 0 { &m.far } else { &m.near }, &pose);
            let near = patched_at.is_some_and(|at| within(&pose, &at, m, PATCHED_MM));
            let mut found = side_by_side(templates.len(), |k| {
                if c.red_saturated[k] > MAX_SATURATED {
                    return (Err(Code::Saturated), Err(Code::Saturated));
                }
                // a region that was not found may still be where the others' pose expects it
                let shape = Shape::Taught(&m.surfaces[k], templates[k].surface.radius_mm);
                let patch = match patches.get(k) {
                    Some(Ok(patch)) if near => patch.moved(sites[k].local, &shape),
                    _ => samples[k].patch(&sites[k], &shape),
                };
                let located = patch.as_ref().map_err(|code| *code).and_then(|patch| {
                    locate(&templates[k], &m.surfaces[k], patch, &rays, capture, (rig, self.axis))
                        .map_err(|code| c.regions[k].err().unwrap_or(code))
                });
                (patch, located)
            });
            (patches, self.located) = found.drain(..).unzip();
            if pass > 0 && !near {
                patched_at = Some(pose);
            }
            self.coverage = Some(patches.iter().flatten().map(|patch| patch.coverage).fold(1.0, f64::min));
            // the flap's opening tells how much paint and light have done to all edges
            let opening = m.vehicle.features.iter().position(|f| f.class == Class::Point3);
            let growth = opening.and_then(|k| self.located[k].as_ref().ok()).map_or(UNKNOWN_GROWTH_MM, |l| l.growth_mm);
            self.located.iter_mut().flatten().for_each(|l| l.growth_mm = growth);
            let evidence = self.evidence();
            if evidence.len() < 3 {
                ended(Stage::Contour);
                return Err(self.too_few());
            }
            let next = judge::fit(&evidence, &pose).map_err(|e| Self::refuse(Code::TooFewFeatures, e.to_string()))?;
            let change = pose.inverse() * next.a_from_b;
            let shift = (change * next.at - next.at).norm();
            pose = next.a_from_b;
            if pass > 0 && change.r.scaled_axis().norm() < STILL.0 && shift < STILL.1 {
                break;
            }
        }
        self.pose = Some(pose);
        ended(Stage::Contour);
        let points = judge::judge(&self.evidence(), &pose, &m.vehicle)?;
        match m.method {
            Method::Dense => self.dense(&points, pose, &patches, &rays),
            _ => Ok(points),
        }
    }

    /// Depth of the body about the `far` sites, and what the fringes say of themselves and of the calibration.
    fn depth(&mut self, decoded: &mut Decoded, far: &[Site<'_>]) -> Result<BodyDepth<'c>, Refused> {
        let c = self.cycle;
        let m = c.measurer;
        let body = BodyDepth::new(&m.depth_rig, &c.rays, &mut decoded.coordinates, far);
        let coordinates = &decoded.coordinates;
        let Some(body) = body else {
            let wanted = c.fringes.wanted();
            let looked_at = coordinates.pixels.iter().zip(wanted).filter(|(_, wanted)| **wanted);
            let states = List::of(looked_at.map(|(c, _)| c.state));
            let usable = states.iter().filter(|s| **s == State::Valid).count();
            let code = body::why_no_depth(&states, usable);
            for located in self.located.iter_mut().filter(|l| matches!(l, Err(Code::TooFewFeatures))) {
                *located = Err(code);
            }
            return Err(Self::refuse(code, "Too little of the body has depth to find its surface."));
        };
        self.axis = coordinates.axis;
        if let Some(across) = decoded.across() {
            self.cells = epipolar_cells(&m.depth_rig, &body.map, across);
            self.cells.iter_mut().for_each(|cell| cell.pixel *= m.every as f64);
        }
        let refused = self.contradictory(coordinates, far).or_else(|| self.epipolar(far));
        if let Some(refused) = refused {
            self.located.clear(); // no feature is to blame
            return Err(refused);
        }
        Ok(body)
    }

    /// The edges in `windows`; those in two of them twice.
    fn edges(&self, windows: &[Window], noise: &NoiseLaw) -> List<EdgeRay> {
        let c = self.cycle;
        let holds = |(a, b): (&Window, &Window)| {
            a.x <= b.x && a.y <= b.y && a.x + a.width >= b.x + b.width && a.y + a.height >= b.y + b.height
        };
        let early = c.early_edges.as_ref().filter(|(early, _)| early.len() == windows.len());
        let Some((_, edges)) = early.filter(|(early, _)| early.iter().zip(windows).all(holds)) else {
            let edges = edge_rays(&c.red, windows, noise, &c.measurer.calibration.rig.camera);
            return List::of(edges.iter().flatten().copied());
        };
        let mut all = List::new();
        for (edges, w) in edges.iter().zip(windows) {
            let (from, to) = (Pixel::new(w.x as f64, w.y as f64), Pixel::new(w.width as f64, w.height as f64));
            let inside = |e: &&EdgeRay| {
                let p = e.edgel.position - from;
                p.x > 0.5 && p.y > 0.5 && p.x < to.x - 1.5 && p.y < to.y - 1.5
            };
            all.extend(edges.iter().filter(inside).copied());
        }
        all
    }

    /// The pixels about each feature of a vehicle that stands near `pose`.
    fn samples(&self, body: &BodyDepth<'_>, pose: &CameraFromVehicle) -> List<Samples> {
        let m = self.cycle.measurer;
        let sites = sites(&m.templates, &m.grown, pose);
        side_by_side(sites.len(), |k| {
            Samples::new(&body.map, &m.depth_rig.camera, &sites[k], m.reach_mm[k], &body.coarse)
        })
    }

    fn too_few(&self) -> Refused {
        // a region that was found, but not measured because the others were not, explains nothing
        let explains = |l: &Result<Located, Code>| l.as_ref().err().copied().filter(|c| *c != Code::TooFewFeatures);
        let why = |(t, l): (&Template, &Result<Located, Code>)| {
            explains(l).map(|code| format!("{}: {} {}", t.feature, code.number(), code.entry().name))
        };
        let reasons: Vec<String> = self.cycle.measurer.templates.iter().zip(&self.located).filter_map(why).collect();
        // with as many features as are needed each one's own code says more than "too few"
        let codes: Vec<Code> = self.located.iter().filter_map(explains).collect();
        let code = match codes.as_slice() {
            [one] => *one,
            [first, rest @ ..] if rest.iter().all(|c| c == first) => *first,
            _ => Code::TooFewFeatures,
        };
        let contours = codes.iter().all(|c| (401..=406).contains(&c.number()));
        if let Some(blur) = self.cycle.light.blur_px.filter(|blur| contours && *blur > MAX_BLUR_PX) {
            let detail = format!(
                "Its sharpest edges are blurred by {blur:.1} px, allowed {MAX_BLUR_PX} px. {}.",
                reasons.join(", ")
            );
            return Self::refuse(Code::OutOfFocus, detail);
        }
        let three = if code == Code::TooFewFeatures { "" } else { "Fewer than three features were measured: " };
        Self::refuse(code, format!("{three}{}.", reasons.join(", ")))
    }

    pub(super) fn evidence(&self) -> PerFeature<Evidence<'_>> {
        let m = self.cycle.measurer;
        m.vehicle
            .features
            .iter()
            .zip(&m.templates)
            .zip(&self.located)
            .filter_map(|((feature, template), l)| {
                Some(Evidence { feature, template, located: l.as_ref().ok()?, errors: &m.errors })
            })
            .collect()
    }

    /// The pose from the regions' rays and the coarse surface.
    fn second_pose(&self, coarse: &Surface<frame::Camera>) -> Option<CameraFromVehicle> {
        let c = self.cycle;
        let camera = &c.measurer.calibration.rig.camera;
        let pose = c.first_pose?;
        let mut pairs = PerFeature::new();
        for (template, region) in c.measurer.templates.iter().zip(&c.regions) {
            let Ok(region) = region else { continue };
            let axes = template.local(&pose).axes;
            let measured = coarse.local.point(&coarse.meet(&camera.ray(&region.pixel)?, 0.0)?);
            let along = if judge::slides(template) { 15.0f64 } else { 1.5 };
            let sigma = Matrix3::from_diagonal(&Vector3::new(along.powi(2), 2.0, 0.1));
            let nominal = Point3::new(Vector3::from(template.point_mm));
            let pair = Pair { measured, nominal, covariance: axes * sigma * axes.transpose() };
            pairs.extend([pair]);
        }
        let all = register(&pairs).ok()?;
        if all.chi2 <= CONTRADICTING {
            return Some(all.a_from_b);
        }
        // one region may be something beside its feature: the three that agree tell
        let without = |k: usize| {
            let rest = pairs.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, pair)| *pair);
            register(&rest.collect::<PerFeature<_>>()).ok()
        };
        let best = (0..pairs.len()).filter_map(without).min_by(|a, b| a.chi2.total_cmp(&b.chi2));
        Some(best.filter(|b| b.chi2 <= CONTRADICTING).unwrap_or(all).a_from_b)
    }
}

pub(super) fn sites<'m>(templates: &[Template], panels: &'m [Panel], pose: &CameraFromVehicle) -> PerFeature<Site<'m>> {
    templates.iter().zip(panels).map(|(t, panel)| Site { local: t.local(pose), panel }).collect()
}

pub(super) fn about(camera: &Lens, centre: &Vector3<f64>, half_mm: f64) -> Option<Window> {
    let p: Pixel = camera.project(centre)?;
    let half = half_mm * camera.fx / centre.z;
    Window::clipped(p.x - half, p.y - half, p.x + half, p.y + half, camera.width, camera.height)
}

/// How far from a feature depth is wanted, mm: masks less a margin begin that much farther out.
pub(super) fn reach(t: &Template) -> f64 {
    t.panel.hole_mm() + EROSION_MM.0 + body::REACH_MM + MARGIN_MM
}

/// What of the thinned images depth is looked for in.
fn depth_window(m: &Measurer, pose: &CameraFromVehicle) -> Option<Window> {
    let region = |(t, reach): (&Template, &f64)| about(&m.depth_rig.camera, &t.local(pose).origin.xyz, *reach);
    let regions = m.templates.iter().zip(&m.reach_mm).filter_map(region);
    regions.reduce(|a, b| {
        let (x, y) = (a.x.min(b.x), a.y.min(b.y));
        let right = (a.x + a.width).max(b.x + b.width);
        let bottom = (a.y + a.height).max(b.y + b.height);
        Window { x, y, width: right - x, height: bottom - y }
    })
}

/// Which pixels of the window are worth decoding: the panel about the features of a vehicle near `pose`, and those that
/// the calibration's health is told from.
fn wanted(m: &Measurer, pose: &CameraFromVehicle, rays: &Rays) -> List<bool> {
    let Window { width, height, .. } = rays.window;
    let mut wanted = List::of((0..width * height).map(|i| fringe::is_sampled(&rays.window, i % width, i / width)));
    for (site, reach) in sites(&m.templates, &m.grown, pose).iter().zip(&m.reach_mm) {
        body::panel_pixels(rays, &m.depth_rig.camera, site, *reach, |i, _, _| wanted[i] = true);
    }
    wanted
}

/// Whether every place about a feature of a vehicle at `pose` is, as the camera sees it, within `margin_mm` of where a
/// vehicle at `guess` has it.
fn within(pose: &CameraFromVehicle, guess: &CameraFromVehicle, m: &Measurer, margin_mm: f64) -> bool {
    m.templates.iter().zip(&m.reach_mm).all(|(t, reach)| {
        let (local, plane) = (t.local(pose), OnPlane::new(&t.local(guess)));
        (0..8).all(|k| {
            let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_4).sin_cos();
            let uv = Vector2::new(cos, sin) * *reach;
            let p = local.point(&uv.push(0.0)).xyz;
            p.z > 0.0 && (plane.meet(&(p.xy() / p.z)) - uv).norm() <= margin_mm
        })
    })
}

/// The regions to find edges in, `margin_mm` wider than a vehicle at `pose` needs.
pub(super) fn contour_windows(m: &Measurer, pose: &CameraFromVehicle, margin_mm: f64) -> PerFeature<Window> {
    let reach = |t: &Template| t.contour.iter().map(|p| p.at().norm()).fold(0.0, f64::max);
    let half = |t| reach(t) + 2.0 * CAPTURE_MM.0 + margin_mm;
    let camera = &m.calibration.rig.camera;
    m.templates.iter().filter_map(|t| about(camera, &t.local(pose).origin.xyz, half(t))).collect()
}

//! One vehicle standing before the station. In: a body, its paint, its pose, what is in the way. Out: per line of
//! sight, the light that comes back from each lamp. Not here: pixels; sensors; what the projector shows.

use super::body::{Body, Hit, Part, Plan};
use super::lamp::{Lamp, fresnel, room};
use super::paint::{COAT_ROUGHNESS, GAP_FLOOR, HEM_COAT, LINING, Paint, RUBBER};
use super::plan::Xz;
use super::pose::{Deviation, camera_from_vehicle};
use super::random::Random;
use super::setup::Setup;
use crate::geometry::{Pose, frame};
use nalgebra::{Rotation3, Vector3};

type V = Vector3<f64>;
type CameraFromVehicle = Pose<frame::Camera, frame::Vehicle>;

/// A thing before the body: a rectangle in the vehicle's x–z plane, mm, held off the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cover {
    /// Its centre, x and z.
    pub centre: [f64; 2],
    /// Half its sides.
    pub half: [f64; 2],
}

/// A cover is this far before the body, mm, and this bright.
const COVER_MM: f64 = 15.0;
const COVER: f64 = 0.3;

/// A vehicle that can be looked at.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Its body.
    pub body: Body,
    /// Its paint.
    pub paint: Paint,
    /// Where it stands.
    pub camera_from_vehicle: CameraFromVehicle,
    /// What hides a part of it.
    pub cover: Option<Cover>,
}

/// The light that comes back along one line of sight, cd/m².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Glow {
    /// Of the bars at full drive.
    pub(super) bars: [f64; 2],
    /// Of tubes and hall.
    pub(super) ambient: f64,
    /// Of the projector's white, and where in its picture that light comes from, px.
    pub(super) projector: f64,
    pub(super) column: f64,
    pub(super) row: f64,
}

/// A point to be lit.
struct Spot {
    part: Part,
    /// Camera frame.
    p: V,
    n: V,
    /// In the vehicle's x–z plane.
    plan: Xz,
    /// Above the undisturbed surface, mm.
    height: f64,
    /// Below its panel's own surface, where edges may be in the light's way.
    deep: bool,
    /// What of the hall it sees, 0..1.
    open: f64,
    /// Spread of slopes that the sample covers on a hem.
    roll: f64,
}

impl Scene {
    /// A vehicle of `body` and `paint` that stands `deviation` beside where it should.
    pub fn new(body: Body, paint: Paint, deviation: &Deviation) -> Self {
        let camera_from_vehicle = camera_from_vehicle(&body, deviation);
        Self { body, paint, camera_from_vehicle, cover: None }
    }

    /// The scene, ready for many lines of sight; the projector turned by `bumped` degrees about its vertical axis.
    pub(super) fn stage<'a>(&'a self, setup: &'a Setup, bumped: f64) -> Stage<'a> {
        let eye = self.camera_from_vehicle.inverse();
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), bumped.to_radians());
        let projector_from_camera =
            Pose::<frame::Projector, frame::Projector>::new(turn, V::zeros()) * setup.rig.projector_from_camera;
        let projector = projector_from_camera.inverse().t;
        let lit_from = std::iter::once(projector).chain(setup.bars.iter().chain(&setup.tubes).map(Lamp::middle));
        let lamps = lit_from.map(|p| eye.r * p + eye.t).collect();
        Stage { scene: self, setup, origin: eye.t, eye, projector_from_camera, projector, lamps }
    }
}

/// A scene seen by a setup.
pub(super) struct Stage<'a> {
    scene: &'a Scene,
    setup: &'a Setup,
    /// The camera in the vehicle frame.
    origin: V,
    eye: Pose<frame::Vehicle, frame::Camera>,
    projector_from_camera: Pose<frame::Projector, frame::Camera>,
    /// The projector's lens in the camera frame.
    projector: V,
    /// Middles of projector, bars and tubes in the vehicle frame.
    lamps: Vec<V>,
}

/// A line of sight on its way: where it crosses the undisturbed surface, seen from where it started.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// Length along the ray (camera z, mm).
    pub(super) depth: f64,
    point: V,
    slope: Xz,
    /// Sideways mm per mm outwards.
    lean: Xz,
    plan: Plan,
}

impl Stage<'_> {
    /// Where the ray through normalised (u, v) crosses the undisturbed surface, found from a depth near it.
    pub(super) fn cross(&self, u: f64, v: f64, near: f64) -> Crossing {
        let d = self.eye.r * V::new(u, v, 1.0);
        let (mut depth, mut slope, mut rise) = (near, [0.0; 2], 1.0);
        for _ in 0..8 {
            let p = self.origin + d * depth;
            let (y, s) = self.scene.body.surface([p.x, p.z]);
            slope = s;
            rise = d.y - s[0] * d.x - s[1] * d.z;
            let step = (y - p.y) / rise;
            depth += step;
            if step.abs() < 0.02 {
                // and its square next time
                break;
            }
        }
        let point = self.origin + d * depth;
        let lean = [d.x / rise, d.z / rise];
        Crossing { depth, point, slope, lean, plan: self.scene.body.plan([point.x, point.z]) }
    }

    /// How many samples a side a pixel needs that is `mm` wide there: one, unless an edge lies within its reach.
    pub(super) fn samples(&self, c: &Crossing, mm: f64) -> usize {
        let (body, most) = (&self.scene.body, self.setup.samples);
        // beyond its hem a panel is flat; one that stands out is met a little beside where it is looked for
        let reach = 0.8 * mm
            + body.hem.max(body.hole_hem).max(if c.plan.outside_arch().abs() < 6.0 { body.arch.hem } else { 0.0 })
            + 0.3;
        if c.plan.nearest() < reach {
            return most.min(if mm > 0.4 { 4 } else { 3 });
        }
        let arch = c.plan.outside_arch();
        if let Some(cover) = self.scene.cover {
            let beyond = self.cover_distance(c, &cover);
            if beyond.abs() < mm {
                return most;
            }
        }
        if arch < 0.0 {
            let (centre, radii) = body.tyre_edges();
            let deep = [0, 1].map(|i| [c.point.x, c.point.z][i] - c.lean[i] * 45.0 - centre[i]);
            let r = deep[0].hypot(deep[1]);
            if radii.iter().any(|edge| (r - edge).abs() < 3.0 + mm) {
                return 2;
            }
        }
        1
    }

    fn cover_distance(&self, c: &Crossing, cover: &Cover) -> f64 {
        let at = [c.point.x + c.lean[0] * COVER_MM, c.point.z + c.lean[1] * COVER_MM];
        (0..2).map(|i| (at[i] - cover.centre[i]).abs() - cover.half[i]).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The light that comes back along a line of sight; `mm` is the width of what this sample stands for.
    pub(super) fn look(&self, c: &Crossing, mm: f64) -> Glow {
        let body = &self.scene.body;
        let lean = c.lean;
        let at = |height: f64| [c.point.x + lean[0] * height, c.point.z + lean[1] * height];
        let tangent = |e: Xz| V::new(e[0], c.slope[0] * e[0] + c.slope[1] * e[1], e[1]).normalize();
        let flat = V::new(-c.slope[0], 1.0, -c.slope[1]).normalize();
        let spot = |part, height: f64, deep: bool, n: V, open: f64, roll: f64| {
            let plan = at(height);
            let p = V::new(
                plan[0],
                c.point.y + c.slope[0] * (plan[0] - c.point.x) + c.slope[1] * (plan[1] - c.point.z) + height,
                plan[1],
            );
            let camera = &self.scene.camera_from_vehicle;
            Spot { part, p: camera.r * p + camera.t, n: camera.r * n, plan, height, deep, open, roll }
        };
        if let Some(cover) = self.scene.cover
            && self.cover_distance(c, &cover) < 0.0
        {
            return self.lit(&spot(Part::Gap, COVER_MM, false, flat, 1.0, 0.0), COVER, None);
        }
        if let Some((part, flush)) = c.plan.flat() {
            return self.light(&spot(part, flush, false, flat, 1.0, 0.0));
        }
        match body.meet(&c.plan, lean) {
            Some(Hit { part, height, tilt: (cos, sin, towards), hem }) => {
                let n = if sin == 0.0 { flat } else { flat * cos + tangent(towards) * sin };
                // a slot shows the less of the hall the deeper in it a point lies
                let down = (-height).max(0.0) / (0.5 * body.gap[0]);
                let open = 1.0 / (1.0 + 3.0 * down * down);
                let roll = hem.map_or(0.0, |hem| (mm / (hem * cos.max(0.35))).min(1.0) / 12f64.sqrt());
                self.light(&spot(part, height, sin > 0.0 || part == Part::Gap, n, open, roll))
            }
            None => {
                let (part, height) = body.behind_arch(at(0.0), lean);
                let open = if part == Part::Tyre { 0.25 } else { 0.05 };
                self.light(&spot(part, height, true, flat, open, 0.0))
            }
        }
    }

    fn light(&self, spot: &Spot) -> Glow {
        match spot.part {
            Part::Tyre => self.lit(spot, RUBBER, None),
            Part::Wheelhouse => self.lit(spot, LINING, None),
            Part::Gap => self.lit(spot, GAP_FLOOR, None),
            _ => self.lit(spot, 1.0, Some(&self.scene.paint)),
        }
    }

    /// Light on a spot and what comes back of it: `grey` of it from what has no paint.
    fn lit(&self, spot: &Spot, grey: f64, paint: Option<&super::Paint>) -> Glow {
        let Spot { p, n, .. } = spot;
        let setup = self.setup;
        let view = -p.normalize();
        let facing = n.dot(&view).max(0.02);
        let mirror = n * (2.0 * n.dot(&view)) - view;
        let mottle = paint.map_or(0.0, |p| p.mottle);
        let mottle = if mottle > 0.0 { 1.0 + mottle * speckle(spot.plan) } else { 1.0 };
        let red = paint.map_or(grey, |p| p.red * mottle);
        let white = paint.map_or(grey, |p| p.white * mottle);
        let plan = if spot.deep { Some(self.scene.body.plan(spot.plan)) } else { None };
        let reaches = |lamp: usize| match &plan {
            Some(plan) => self.reaches(spot, plan, &self.lamps[lamp]),
            None => true,
        };
        let spread = |roughness: f64| (roughness * roughness + 2.0 * spot.roll * spot.roll).sqrt();
        let whole = if spot.roll > 0.0 { HEM_COAT } else { 1.0 };
        let coat = whole * fresnel(facing);
        // diffuse, mirrored in the coat, mirrored in the flakes
        let area = |lamp: &Lamp, luminance: f64, albedo: f64| {
            let mut back = albedo / std::f64::consts::PI * lamp.illuminance(p, n);
            if let Some(paint) = paint {
                back += coat * lamp.mirrored(p, &mirror, spread(COAT_ROUGHNESS));
                if let Some((share, roughness)) = paint.flakes {
                    back += share * mottle * lamp.mirrored(p, &mirror, spread(roughness));
                }
            }
            luminance * back
        };
        let mut glow = Glow::default();
        for k in 0..2 {
            if reaches(1 + k) {
                glow.bars[k] = area(&setup.bars[k], setup.bar_luminance, red);
            }
            if reaches(3 + k) {
                glow.ambient += area(&setup.tubes[k], setup.tube_luminance, white);
            }
        }
        let hall =
            paint.map_or(0.0, |p| fresnel(facing) * room(-mirror.y) + p.flakes.map_or(0.0, |f| f.0 * room(-n.y)));
        glow.ambient += spot.open * setup.room_luminance * (white * room(-0.67 * n.y) + hall);
        if setup.projector_candela == 0.0 {
            return glow;
        }
        let in_projector = self.projector_from_camera.r * p + self.projector_from_camera.t;
        if let Some(pixel) = setup.rig.projector.project(&in_projector)
            && reaches(0)
        {
            let to = self.projector - p;
            let far = to.norm();
            let to = to / far;
            let up = n.dot(&to);
            if up > 0.0 {
                let half = (to + view).normalize();
                let cos = n.dot(&half).clamp(0.0, 1.0);
                let glossy = |reflectance: f64, roughness: f64| {
                    let a2 = spread(roughness).powi(2);
                    let c2 = cos * cos;
                    let d = c2 * a2 + 1.0 - c2; // c⁴a²·(1 + tan²/a²)² = d²/a²
                    reflectance * a2 / (std::f64::consts::PI * d * d) / (4.0 * facing)
                };
                let mut back = white / std::f64::consts::PI * up;
                if let Some(paint) = paint {
                    back += glossy(whole * fresnel(half.dot(&view)), COAT_ROUGHNESS);
                    back += paint.flakes.map_or(0.0, |(share, roughness)| mottle * glossy(share, roughness));
                }
                let (x, y) = (in_projector.x / in_projector.z, in_projector.y / in_projector.z);
                // a flat screen is lit evenly, but for a quarter less at the corners
                let r2 = x * x + y * y;
                let vignetting = (1.0 + r2).powf(1.5) * (1.0 - 0.45 * r2);
                glow.projector = setup.projector_candela * vignetting * 1e6 / (far * far) * back;
                (glow.column, glow.row) = (pixel.x, pixel.y);
            }
        }
        glow
    }

    /// Whether light from `lamp` (vehicle frame) gets to a spot below the surface.
    fn reaches(&self, spot: &Spot, plan: &Plan, lamp: &V) -> bool {
        let body = &self.scene.body;
        let (y, slope) = body.surface(spot.plan);
        let to = lamp - V::new(spot.plan[0], y + spot.height, spot.plan[1]);
        let rise = to.y - slope[0] * to.x - slope[1] * to.z;
        if rise <= 0.0 {
            return false;
        }
        let lean = [to.x / rise, to.z / rise];
        match spot.part {
            Part::Tyre | Part::Wheelhouse => {
                let up = -spot.height;
                let through = [spot.plan[0] + lean[0] * up, spot.plan[1] + lean[1] * up];
                body.plan(through).outside_arch() < 0.0
            }
            _ => body.escapes(plan, spot.height, lean),
        }
    }
}

/// What differs from spot to spot: a number of mean 0 and standard deviation 1 for each 0.8 mm of the plan.
fn speckle(plan: Xz) -> f64 {
    let cell = plan.map(|v| (v / 0.8).floor() as i64 as u64);
    (Random::new(cell[0], &[cell[1]]).uniform() - 0.5) * 12f64.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point3;

    fn scene(paint: &str) -> Scene {
        let body = Body::named("suv-a").expect("listed");
        Scene::new(body, Paint::named(paint).expect("listed"), &Deviation::default())
    }

    /// What is seen of a point of the undisturbed surface.
    fn look(scene: &Scene, setup: &Setup, at: Xz) -> (Glow, V) {
        let p = V::new(at[0], scene.body.surface(at).0, at[1]);
        let p = (scene.camera_from_vehicle * Point3::new(p)).xyz;
        let stage = scene.stage(setup, 0.0);
        let crossing = stage.cross(p.x / p.z, p.y / p.z, 700.0);
        assert!((crossing.depth - p.z).abs() < 1e-3, "the ray ends at the point");
        (stage.look(&crossing, 0.5), p)
    }

    #[test]
    fn the_projectors_pixel_is_the_one_that_lights_the_point() {
        let (scene, setup) = (scene("white"), Setup::new(0.25, 8));
        for at in [[-2550.0, 760.0], [-2700.0, 950.0], [-2450.0, 900.0]] {
            let (glow, p) = look(&scene, &setup, at);
            let rig = &setup.rig;
            let pixel = rig.projector.project(&(rig.projector_from_camera * Point3::new(p)).xyz).expect("in front");
            assert!((glow.column - pixel.x).abs() < 1e-3 && (glow.row - pixel.y).abs() < 1e-3);
            assert!(glow.projector > 0.0);
        }
    }

    #[test]
    fn paint_gives_back_its_share_of_the_bars_light() {
        let (setup, at) = (Setup::new(0.25, 8), [-2620.0, 770.0]);
        let white = look(&scene("white"), &setup, at).0;
        let bars = white.bars[0] + white.bars[1];
        let expected = 0.72 / std::f64::consts::PI * setup.lux([1.0, 1.0]);
        assert!((bars / expected - 1.0).abs() < 0.1, "{bars} of {expected} cd/m²");
        let red = look(&scene("red"), &setup, at).0;
        assert!(
            red.bars[0] > 0.6 * white.bars[0] && red.projector < 0.3 * white.projector,
            "red is bright in red light"
        );
    }

    #[test]
    fn gaps_and_wheelhouse_are_dark_and_what_covers_the_body_is_before_it() {
        let (mut scene, setup) = (scene("white"), Setup::new(0.25, 8));
        let panel = look(&scene, &setup, [-2620.0, 770.0]).0.bars[0];
        let hole = scene.body.features()[2].at;
        let rim = [hole[0] + scene.body.flap_half()[0] - 1.7, hole[2]];
        for dark in [rim, [-2640.0, 690.0]] {
            assert!(look(&scene, &setup, dark).0.bars[0] < 0.06 * panel, "{dark:?}");
        }
        scene.cover = Some(Cover { centre: rim, half: [10.0, 10.0] });
        assert!(look(&scene, &setup, rim).0.bars[0] > 0.2 * panel);
    }
}

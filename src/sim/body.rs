//! A car's body side about its fuel flap: a parametric surface, cut into parts by gaps with rolled hems.
//! In:  parameters, and how one body differs from the drawing. Out: the surface's height, which part is where and how
//! far below it, and the nominal feature points. Vehicle frame, mm; the body's left side, so y points out of it.
//! Not here: paint, light, pose.

use super::plan::{Bend, Distance, Outline, Xz, dot, length, minus};
use super::random::Random;

/// Kinds of body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Two corners beside the arch: door and bumper meet the quarter panel.
    Suv,
    /// One corner: the bumper's line lies far behind.
    Sedan,
}

/// The wheel arch: a circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arch {
    /// Its centre, x and z, mm.
    pub centre: Xz,
    /// mm.
    pub radius: f64,
    /// Radius of its rolled flange, mm.
    pub hem: f64,
    /// How far the panel is flared out at the arch, mm, and how soon that fades, mm.
    pub flare: (f64, f64),
}

impl Arch {
    /// The point of the circle `dx` mm before (positive) or behind its top.
    fn at(&self, dx: f64) -> Xz {
        [self.centre[0] + dx, self.centre[1] + (self.radius * self.radius - dx * dx).sqrt()]
    }

    fn distance(&self, p: Xz) -> Distance {
        let d = minus(p, self.centre);
        let far = length(d).max(1e-9);
        Distance { mm: far - self.radius, gradient: d.map(|v| v / far) }
    }
}

/// How one body differs from the drawing, mm; the quarter panel, which carries the nominal points, does not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Build {
    /// Gaps wider than drawn: door, bumper.
    pub gap: [f64; 2],
    /// The flap's centre beside that of its hole, x and z.
    pub flap: [f64; 2],
    /// Parts standing out of the surface: door, bumper, flap.
    pub flush: [f64; 3],
}

/// How far doors, bumpers and flaps are off, at most, mm.
pub const BUILD_MM: f64 = 0.7;

impl Build {
    /// Drawn at random.
    pub fn random(random: &mut Random) -> Self {
        let mut off = || random.between(-BUILD_MM, BUILD_MM);
        Self { gap: [off(), off()], flap: [off(), off()], flush: [off(), off(), off()] }
    }
}

/// A vehicle model as drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// Its name.
    pub name: String,
    /// The job it is at a station.
    pub job: u16,
    /// Its kind.
    pub style: Style,
    /// Where the surface's polynomial has its origin, x and z, mm.
    pub(super) origin: Xz,
    /// Height y of the surface, mm, as polynomial in x and z about the origin, in units of 100 mm: 1, z, z², x, xz, x².
    pub(super) quadric: [f64; 6],
    /// Lines along which the surface bends, and by how much (slope).
    pub(super) creases: Vec<(Bend, f64)>,
    /// The wheel arch.
    pub(super) arch: Arch,
    /// The quarter panel's edge along the door, which lies on its right.
    pub(super) door: Bend,
    /// The same along the bumper, and whether it meets the arch in view.
    pub(super) bumper: Option<Bend>,
    /// Corners before and behind the arch's top, mm along x.
    pub(super) corners: [f64; 2],
    /// Radius of the panels' rounded corners, mm.
    pub(super) corner_radius: f64,
    /// Centre and outline of the flap's hole.
    pub(super) hole: (Xz, Outline),
    /// A small dark opening elsewhere in the panel: centre and outline.
    pub(super) opening: Option<(Xz, Outline)>,
    /// Widths of the gaps as drawn: door, bumper, flap, mm.
    pub(super) gap: [f64; 3],
    /// Depth of the gaps, mm.
    pub(super) depth: f64,
    /// Radius of the hems at gaps, mm, and of that at the flap's hole and at openings, which is drawn rather than folded.
    pub(super) hem: f64,
    pub(super) hole_hem: f64,
    /// How this one differs.
    pub build: Build,
}

/// What a line of sight meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Quarter,
    Door,
    Bumper,
    Flap,
    /// The floor of a gap or opening, and what is behind its hems.
    Gap,
    Tyre,
    Wheelhouse,
}

/// Parts with a surface of their own, in the order of [`Plan::edges`].
const PANELS: [Part; 4] = [Part::Quarter, Part::Door, Part::Bumper, Part::Flap];
/// The quarter panel's number among them.
const QUARTER: usize = 0;
/// A door's flange goes this much deeper than a gap, mm; beyond is the wheelhouse.
const FLANGE_MM: f64 = 12.0;
/// The tyre's face lies this far below the surface at the arch, mm, and the wheelhouse that far.
const TYRE_MM: f64 = 42.0;
const WHEELHOUSE_MM: f64 = 230.0;
/// The tyre's radius is smaller than the arch's by this, mm, and its sidewall has a step so much farther in.
const TYRE_GAP_MM: f64 = 52.0;
const SIDEWALL_MM: f64 = 16.0;

/// All edges as seen from one point of the plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    edges: [Option<Edge>; 4],
    arch: Distance,
}

impl Plan {
    /// Distance to the nearest edge of any panel, mm.
    pub(super) fn nearest(&self) -> f64 {
        self.edges.iter().flatten().map(|e| e.inside.mm.abs()).fold(f64::INFINITY, f64::min)
    }

    /// The panel that the point lies on, farther than its hem from every edge, and how far it stands out.
    pub(super) fn flat(&self) -> Option<(Part, f64)> {
        self.edges.iter().flatten().find(|e| e.inside.mm > e.hem).map(|e| (e.part, e.flush))
    }

    /// Distance outside (positive) the arch's circle, mm.
    pub(super) fn outside_arch(&self) -> f64 {
        self.arch.mm
    }
}

/// One panel as seen from a point of the plan: how far inside it the point is, and how its edge is rolled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    part: Part,
    inside: Distance,
    flush: f64,
    hem: f64,
}

impl Edge {
    /// Height of the panel over the undisturbed surface, mm, at `inside` mm within its edge; `None`: no panel there.
    fn height(&self, inside: f64) -> Option<f64> {
        let from_top = self.hem - inside;
        if from_top <= 0.0 {
            Some(self.flush)
        } else if inside >= 0.0 {
            Some(self.flush - self.hem + (self.hem * self.hem - from_top * from_top).sqrt())
        } else {
            None
        }
    }

    fn hit(&self, height: f64, inside: f64) -> Hit {
        let outwards = self.inside.gradient.map(|g| -g);
        if height < self.flush - self.hem {
            // a hem is folded back: behind it there is no painted wall
            return Hit { part: Part::Gap, height, tilt: (0.0, 1.0, outwards), hem: None };
        }
        let sin = ((self.hem - inside) / self.hem).clamp(0.0, 1.0);
        let hem = (sin > 0.0).then_some(self.hem);
        Hit { part: self.part, height, tilt: ((1.0 - sin * sin).sqrt(), sin, outwards), hem }
    }
}

/// Where a line of sight ends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) part: Part,
    /// mm above the undisturbed surface.
    pub(super) height: f64,
    /// Outward normal = cos·(that of the surface) + sin·(direction in the plan).
    pub(super) tilt: (f64, f64, Xz),
    /// Radius of the hem that is seen, mm; none: flat.
    pub(super) hem: Option<f64>,
}

impl Body {
    /// Height y of the undisturbed surface, mm, and its slopes along x and z.
    pub(super) fn surface(&self, p: Xz) -> (f64, Xz) {
        let [a, b] = minus(p, self.origin).map(|v| v / 100.0);
        let [c, cz, czz, cx, cxz, cxx] = self.quadric;
        let mut y = c + b * (cz + b * czz) + a * (cx + b * cxz + a * cxx);
        let mut slope = [(cx + b * cxz + 2.0 * a * cxx) / 100.0, (cz + 2.0 * b * czz + a * cxz) / 100.0];
        for (bend, by) in &self.creases {
            let d = bend.distance(p);
            let soft = length([d.mm, CREASE_MM]);
            y -= 0.5 * by * soft;
            slope = [0, 1].map(|i| slope[i] - 0.5 * by * d.mm / soft * d.gradient[i]);
        }
        let (flare, fade) = self.arch.flare;
        if flare != 0.0 {
            let d = self.arch.distance(p);
            let raised = flare * (-d.mm.max(-20.0) / fade).exp();
            y += raised;
            slope = [0, 1].map(|i| slope[i] - raised / fade * d.gradient[i]);
        }
        (y, slope)
    }

    /// The panels' edges as seen from a point of the plan.
    pub(super) fn plan(&self, p: Xz) -> Plan {
        let Build { gap, flap, flush } = self.build;
        let arch = self.arch.distance(p);
        let door = self.door.distance(p);
        let hole = self.hole.1.distance(minus(p, self.hole.0));
        let mut quarter = door.and(arch, self.corner_radius);
        // the flange at the arch is rolled wider than a gap's; in a corner one goes over into the other
        let mut gap_mm = door.mm;
        let bumper = self.bumper.as_ref().map(|bumper| bumper.distance(p));
        if let Some(bumper) = bumper {
            quarter = quarter.and(bumper, self.corner_radius);
            gap_mm = gap_mm.min(bumper.mm);
        }
        let hem = |gap_mm: f64| {
            let share = (0.5 + (gap_mm - arch.mm) / 6.0).clamp(0.0, 1.0);
            self.hem + share * (self.arch.hem - self.hem)
        };
        let mut quarter_hem = hem(gap_mm);
        for cut in [Some(hole), self.opening.map(|(at, outline)| outline.distance(minus(p, at)))].into_iter().flatten()
        {
            if cut.mm < quarter.mm {
                (quarter, quarter_hem) = (cut, self.hole_hem);
            }
        }
        let beside = |part, line: Distance, k: usize| {
            let gap_side = line.across(self.gap[k] + gap[k]);
            let inside = gap_side.and(arch, self.corner_radius);
            Edge { part, inside, flush: flush[k], hem: hem(gap_side.mm) }
        };
        let lid = self.hole.1.smaller(self.gap[2]).distance(minus(minus(p, self.hole.0), flap));
        let inside = Distance { mm: -lid.mm, gradient: lid.gradient.map(|g| -g) };
        let edges = [
            Some(Edge { part: PANELS[QUARTER], inside: quarter, flush: 0.0, hem: quarter_hem }),
            Some(beside(PANELS[1], door, 0)),
            bumper.map(|line| beside(PANELS[2], line, 1)),
            Some(Edge { part: PANELS[3], inside, flush: flush[2], hem: self.hem }),
        ];
        Plan { edges, arch }
    }

    /// What a line of sight meets that crosses the undisturbed surface where `plan` was taken and there goes sideways
    /// by `lean` (mm along x and z) per mm outwards. `None`: it goes on into the wheel arch.
    pub(super) fn meet(&self, plan: &Plan, lean: Xz) -> Option<Hit> {
        // each edge is straight as far as a line of sight gets within a gap
        let rate = plan.edges.map(|e| e.map_or(0.0, |e| dot(e.inside.gradient, lean)));
        let top = |height: f64| {
            let mut best: Option<(f64, usize, f64)> = None;
            for (k, edge) in plan.edges.iter().enumerate() {
                let Some(edge) = edge else { continue };
                let inside = edge.inside.mm + rate[k] * height;
                if let Some(h) = edge.height(inside)
                    && best.is_none_or(|b| h > b.0)
                {
                    best = Some((h, k, inside));
                }
            }
            best
        };
        let (mut above, mut height) = (BUILD_MM + STEP_MM, BUILD_MM + STEP_MM);
        let hems = -BUILD_MM - self.hem.max(self.hole_hem).max(self.arch.hem);
        while height > hems {
            if top(height).is_some_and(|found| found.0 >= height) {
                let (mut over, mut under) = (above, height);
                for _ in 0..8 {
                    let middle = 0.5 * (over + under);
                    if top(middle).is_some_and(|f| f.0 >= middle) { under = middle } else { over = middle }
                }
                let (_, k, inside) = top(under).expect("it was met here");
                return Some(plan.edges[k].expect("it was met").hit(under, inside));
            }
            above = height;
            height -= STEP_MM;
        }
        // below the hems there are walls, met where the line comes inside, and the floor
        let wall = (0..PANELS.len())
            .filter_map(|k| {
                let edge = plan.edges[k]?;
                let at = -edge.inside.mm / rate[k];
                (at < above && at > -self.depth - FLANGE_MM && rate[k] < 0.0).then_some((at, edge))
            })
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let floor = plan.arch.mm - dot(plan.arch.gradient, lean) * self.depth > 0.0;
        match wall {
            Some((at, edge)) if !floor || at > -self.depth => Some(edge.hit(at, 0.0)),
            _ if floor => Some(Hit { part: Part::Gap, height: -self.depth, tilt: (1.0, 0.0, [0.0; 2]), hem: None }),
            _ => None,
        }
    }

    /// Whether light that leaves a point `height` mm below the surface, in a gap, leaning by `lean` per mm outwards,
    /// gets past the panels' edges. `plan` is that of the point's own place.
    pub(super) fn escapes(&self, plan: &Plan, height: f64, lean: Xz) -> bool {
        plan.edges.iter().flatten().all(|edge| {
            let rate = dot(edge.inside.gradient, lean);
            // where most of a hem has been passed
            let up = edge.flush - 0.4 * edge.hem - height;
            up <= 0.0 || edge.inside.mm + rate * up < 0.15 * edge.hem
        })
    }

    /// The part and height below the arch that a line of sight meets which passed it at `p`, leaning by `lean`.
    pub(super) fn behind_arch(&self, p: Xz, lean: Xz) -> (Part, f64) {
        let at = |height: f64| minus([p[0] + lean[0] * height, p[1] + lean[1] * height], self.arch.centre);
        let tyre = self.arch.radius - TYRE_GAP_MM;
        for (height, within) in [(-TYRE_MM, tyre - SIDEWALL_MM), (-TYRE_MM - 9.0, tyre)] {
            if length(at(height)) < within {
                return (Part::Tyre, height);
            }
        }
        (Part::Wheelhouse, -WHEELHOUSE_MM)
    }

    /// Radii about the arch's centre where what is seen through it changes, mm.
    pub(super) fn tyre_edges(&self) -> (Xz, [f64; 2]) {
        let tyre = self.arch.radius - TYRE_GAP_MM;
        (self.arch.centre, [tyre, tyre - SIDEWALL_MM])
    }

    /// The nominal points: class 1 to 4 of the detector, name, x, y, z in mm. They lie where the drawing's sharp edges
    /// meet, on the undisturbed surface.
    pub fn features(&self) -> Vec<Feature> {
        let lifted = |p: Xz| [p[0], self.surface(p).0, p[1]];
        let mut out = Vec::new();
        let corner = |class, truth, dx: f64| Feature { class, truth, at: lifted(self.arch.at(dx)) };
        out.push(corner(1, "corner1_virtual", self.corners[0]));
        if self.bumper.is_some() {
            out.push(corner(2, "corner2_virtual", self.corners[1]));
        }
        out.push(Feature { class: 3, truth: "cap_centre", at: lifted(self.hole.0) });
        out.push(Feature { class: 4, truth: "arch_top", at: lifted(self.arch.at(0.0)) });
        out
    }

    /// One body of this model that differs from the drawing by `build`.
    pub fn built(self, build: Build) -> Self {
        Self { build, ..self }
    }

    /// Whether the flap is an ellipse.
    pub fn round_flap(&self) -> bool {
        matches!(self.hole.1, Outline::Ellipse(_))
    }

    /// Half the extent of the flap's hole along x and z, mm.
    pub fn flap_half(&self) -> [f64; 2] {
        self.hole.1.half()
    }

    /// Whether the drawing can be: flap and opening inside the quarter panel, with `room` mm about the flap.
    pub(super) fn sound(&self, room: f64) -> bool {
        let ring = |(centre, outline): (Xz, Outline), room: f64| {
            (0..48).all(|k| {
                let (sin, cos) = (f64::from(k) / 48.0 * std::f64::consts::TAU).sin_cos();
                let half = outline.half();
                let p = [centre[0] + (half[0] + room) * cos, centre[1] + (half[1] + room) * sin];
                let lines =
                    [Some(self.arch.distance(p)), Some(self.door.distance(p)), self.bumper.map(|b| b.distance(p))];
                lines.into_iter().flatten().all(|d| d.mm > 0.0)
            })
        };
        ring(self.hole, room) && self.opening.is_none_or(|o| ring(o, 8.0))
    }

    /// A parameter set: the corner's line through the arch, its bend `up` mm above it.
    pub(super) fn door_line(arch: &Arch, dx: f64, up: f64, slopes: [f64; 2], width: f64) -> Bend {
        let corner = arch.at(dx);
        Bend::new([corner[0], corner[1] + up], [0.0, 1.0], slopes[0], slopes[1], width).through(corner)
    }

    /// The bumper's line: from the arch at `angles[0]` degrees above the horizontal, after `far` mm at `angles[1]`.
    pub(super) fn bumper_line(arch: &Arch, dx: f64, far: f64, angles: [f64; 2], width: f64) -> Bend {
        let corner = arch.at(dx);
        let [steep, flat] = angles.map(f64::to_radians);
        let bend = [corner[0] - far * steep.cos(), corner[1] + far * steep.sin()];
        let (sin, cos) = (0.5 * (steep + flat)).sin_cos();
        let half = (0.5 * (steep - flat)).tan();
        Bend::new(bend, [cos, -sin], half, -half, width).through(corner)
    }
}

/// A nominal point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feature {
    /// Class of the detector, 1 to 4: corners, cap, arch top.
    pub class: u8,
    /// Its name in truth.json.
    pub truth: &'static str,
    /// mm, vehicle frame.
    pub at: [f64; 3],
}

/// Half the width over which a crease turns, mm.
const CREASE_MM: f64 = 9.0;
/// How finely a line of sight is followed into a gap, mm.
const STEP_MM: f64 = 0.2;

#[cfg(test)]
mod tests {
    use super::*;

    fn suv() -> Body {
        Body::named("suv-a").expect("listed")
    }

    /// The flap's rim at its foremost point, `out` mm outside the hole's edge.
    fn beside_hole(body: &Body, out: f64) -> Xz {
        [body.hole.0[0] + body.hole.1.half()[0] + out, body.hole.0[1]]
    }

    #[test]
    fn the_surfaces_slope_is_its_derivative() {
        for name in super::super::names() {
            let body = Body::named(name).expect("listed");
            for p in [[-2500.0, 720.0], [-2700.0, 900.0], [-2640.0, 760.0]] {
                for i in 0..2 {
                    let at = |h: f64| {
                        let mut q = p;
                        q[i] += h;
                        body.surface(q).0
                    };
                    let slope = (at(1e-3) - at(-1e-3)) / 2e-3;
                    assert!((slope - body.surface(p).1[i]).abs() < 1e-5, "{name} {p:?}");
                }
            }
        }
    }

    #[test]
    fn a_straight_look_meets_panel_hem_floor_and_lid_in_turn() {
        let build = Build { flush: [0.0, 0.0, 0.5], ..Build::default() };
        let body = suv().built(build);
        let meet = |out: f64| body.meet(&body.plan(beside_hole(&body, out)), [0.0, 0.0]).expect("no arch here");
        let panel = meet(5.0);
        assert!(panel.part == Part::Quarter && panel.height.abs() < 1e-9 && panel.tilt.1 == 0.0, "{panel:?}");
        let hem = meet(0.3 * body.hole_hem);
        let drop = body.hole_hem * (1.0 - (1.0 - 0.7f64 * 0.7).sqrt());
        assert!(hem.part == Part::Quarter && (hem.height + drop).abs() < 0.02, "{hem:?}");
        assert!((hem.tilt.1 - 0.7).abs() < 0.02 && hem.tilt.2[0] < -0.99, "it faces the hole: {hem:?}");
        let floor = meet(-0.5 * body.gap[2]);
        assert_eq!((floor.part, floor.height), (Part::Gap, -body.depth));
        let lid = meet(-body.gap[2] - 3.0);
        assert!(lid.part == Part::Flap && (lid.height - 0.5).abs() < 0.01, "{lid:?}");
    }

    #[test]
    fn a_leaning_look_sees_behind_the_near_hem_and_onto_the_far_one() {
        let body = suv();
        // outwards it leans forward by 0.3: inwards, backward, under the near edge of the flap
        let plan = body.plan(beside_hole(&body, -0.2));
        let met = body.meet(&plan, [0.3, 0.0]).expect("no arch here");
        assert_eq!(met.part, Part::Gap);
        let other = body.meet(&plan, [-0.3, 0.0]).expect("no arch here");
        assert_eq!(other.part, Part::Quarter, "inwards it leans forward, onto the hole's hem: {other:?}");
    }

    #[test]
    fn light_leaves_a_gap_only_past_its_edges() {
        let body = suv();
        let plan = body.plan(beside_hole(&body, -0.5 * body.gap[2]));
        assert!(body.escapes(&plan, -3.0, [0.0, 0.0]));
        assert!(!body.escapes(&plan, -3.0, [1.0, 0.0]) && !body.escapes(&plan, -3.0, [-1.0, 0.0]));
        assert!(body.escapes(&plan, -3.0, [0.0, 1.0]), "along the gap");
    }

    #[test]
    fn through_the_arch_are_tyre_and_wheelhouse() {
        let body = suv();
        let top = body.arch.at(0.0);
        assert!(body.meet(&body.plan([top[0], top[1] - 20.0]), [0.0, 0.0]).is_none());
        assert_eq!(body.behind_arch([top[0], top[1] - 20.0], [0.0, 0.0]).0, Part::Wheelhouse);
        assert_eq!(body.behind_arch([top[0], top[1] - 120.0], [0.0, 0.0]), (Part::Tyre, -TYRE_MM));
    }

    #[test]
    fn how_a_body_is_built_leaves_its_nominal_points() {
        let mut random = Random::new(3, &[]);
        let body = suv().built(Build::random(&mut random));
        assert_eq!(body.features(), suv().features());
        let Build { gap, flap, flush } = body.build;
        let all: Vec<f64> = gap.into_iter().chain(flap).chain(flush).collect();
        assert!(all.iter().all(|v| v.abs() <= BUILD_MM) && all.iter().any(|v| v.abs() > 0.1));
    }
}

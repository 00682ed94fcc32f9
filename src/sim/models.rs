//! Vehicle models: ten with names, and any number drawn at random.
//! In: a name, or a seed. Out: a [`Body`]. Not here: what its parameters mean.

use super::body::{Arch, Body, Build, Style};
use super::plan::{Bend, Outline};
use super::random::Random;
use Style::{Sedan, Suv};

/// A model's parameters, in the order of a drawing's dimensions.
struct Drawing {
    name: &'static str,
    style: Style,
    /// Arch: centre, radius, hem, flare.
    arch: ([f64; 2], f64, f64, (f64, f64)),
    /// Corners before and behind the arch's top.
    corners: [f64; 2],
    /// Door line: how far above its corner it bends, slopes below and above, width of the bend.
    door: (f64, [f64; 2], f64),
    /// Bumper line: how far from its corner it bends, degrees above the horizontal before and after, width of the bend.
    bumper: (f64, [f64; 2], f64),
    /// Flap's hole.
    hole: ([f64; 2], Outline),
    /// Surface.
    quadric: [f64; 6],
    /// Character line: how far above the arch's top, its rise over run, its change of slope.
    crease: Option<(f64, f64, f64)>,
    /// A small dark opening.
    opening: Option<([f64; 2], Outline)>,
    /// Gaps: door, bumper, flap; their depth; radius of the hems at gaps and at the hole; of corners.
    gap: [f64; 3],
    depth: f64,
    hems: [f64; 2],
    corner_radius: f64,
}

use Outline::{Ellipse, Rounded};

/// The first SUV and the first sedan are like those of the independent renderer's captures.
const DRAWINGS: [Drawing; 10] = [
    Drawing {
        name: "suv-a",
        style: Suv,
        arch: ([-2640.0, 345.0], 365.0, 1.8, (0.0, 40.0)),
        corners: [163.876, -140.707],
        door: (129.0, [-0.178, 0.207], 40.0),
        bumper: (61.6, [51.5, 28.3], 8.0),
        hole: ([-2618.0, 874.0], Ellipse([83.7, 78.2])),
        quadric: [873.9, -3.372, -2.635, 1.498, 0.199, -1.388],
        crease: None,
        opening: None,
        gap: [3.6, 3.6, 3.4],
        depth: 5.0,
        hems: [1.05, 1.95],
        corner_radius: 3.0,
    },
    Drawing {
        name: "suv-b",
        style: Suv,
        arch: ([-2655.0, 352.0], 372.0, 2.2, (1.2, 30.0)),
        corners: [152.0, -150.0],
        door: (110.0, [-0.12, 0.16], 50.0),
        bumper: (80.0, [47.0, 22.0], 12.0),
        hole: ([-2640.0, 892.0], Rounded([74.0, 70.0], 26.0)),
        quadric: [880.0, -2.4, -2.2, 1.1, 0.12, -1.0],
        crease: None,
        opening: None,
        gap: [3.8, 3.4, 3.2],
        depth: 4.8,
        hems: [1.0, 1.8],
        corner_radius: 3.5,
    },
    Drawing {
        name: "suv-c",
        style: Suv,
        arch: ([-2700.0, 360.0], 378.0, 1.8, (0.0, 40.0)),
        corners: [170.0, -132.0],
        door: (140.0, [-0.22, 0.12], 35.0),
        bumper: (70.0, [55.0, 32.0], 10.0),
        hole: ([-2690.0, 902.0], Ellipse([80.0, 80.0])),
        quadric: [868.0, -4.0, -3.1, 1.9, 0.25, -1.7],
        crease: Some((55.0, 0.05, 0.035)),
        opening: None,
        gap: [4.2, 3.8, 3.0],
        depth: 5.0,
        hems: [1.1, 2.0],
        corner_radius: 4.0,
    },
    Drawing {
        name: "suv-d",
        style: Suv,
        arch: ([-2610.0, 340.0], 360.0, 2.4, (2.0, 36.0)),
        corners: [158.0, -145.0],
        door: (95.0, [-0.05, 0.20], 60.0),
        bumper: (66.0, [44.0, 25.0], 9.0),
        hole: ([-2588.0, 872.0], Rounded([82.0, 66.0], 30.0)),
        quadric: [861.0, -3.0, -2.0, 1.3, 0.05, -1.2],
        crease: None,
        opening: Some(([-2706.0, 908.0], Ellipse([7.0, 7.0]))),
        gap: [3.4, 3.6, 2.8],
        depth: 4.2,
        hems: [1.0, 1.75],
        corner_radius: 3.0,
    },
    Drawing {
        name: "suv-e",
        style: Suv,
        arch: ([-2680.0, 358.0], 382.0, 2.0, (0.8, 45.0)),
        corners: [148.0, -138.0],
        door: (150.0, [-0.15, 0.05], 45.0),
        bumper: (58.0, [58.0, 35.0], 14.0),
        hole: ([-2676.0, 896.0], Ellipse([74.0, 70.0])),
        quadric: [890.0, -2.0, -2.9, 1.6, 0.15, -1.5],
        crease: Some((40.0, -0.04, 0.02)),
        opening: None,
        gap: [4.0, 4.0, 3.4],
        depth: 4.6,
        hems: [1.05, 1.9],
        corner_radius: 3.6,
    },
    Drawing {
        name: "suv-f",
        style: Suv,
        arch: ([-2630.0, 348.0], 355.0, 2.1, (0.0, 40.0)),
        corners: [160.0, -155.0],
        door: (120.0, [-0.25, 0.25], 30.0),
        bumper: (90.0, [50.0, 20.0], 10.0),
        hole: ([-2636.0, 858.0], Rounded([72.0, 72.0], 36.0)),
        quadric: [872.0, -3.6, -2.5, 1.2, 0.30, -1.1],
        crease: None,
        opening: None,
        gap: [3.6, 3.2, 3.0],
        depth: 4.4,
        hems: [1.05, 1.85],
        corner_radius: 2.6,
    },
    Drawing {
        name: "sedan-a",
        style: Sedan,
        arch: ([-2780.0, 318.0], 358.0, 2.0, (1.5, 34.0)),
        corners: [142.15, -400.0],
        door: (120.0, [-0.34, -0.02], 40.0),
        bumper: (0.0, [0.0, 0.0], 1.0),
        hole: ([-2858.0, 824.0], Ellipse([79.0, 77.5])),
        quadric: [850.6, -4.2, -3.2, 1.4, 0.2, -1.6],
        crease: None,
        opening: None,
        gap: [3.4, 3.4, 2.8],
        depth: 4.4,
        hems: [1.0, 1.7],
        corner_radius: 3.0,
    },
    Drawing {
        name: "sedan-b",
        style: Sedan,
        arch: ([-2740.0, 322.0], 346.0, 1.9, (0.0, 34.0)),
        corners: [150.0, -400.0],
        door: (105.0, [-0.28, 0.05], 45.0),
        bumper: (0.0, [0.0, 0.0], 1.0),
        hole: ([-2815.0, 818.0], Rounded([72.0, 68.0], 24.0)),
        quadric: [842.0, -3.8, -2.8, 1.2, 0.1, -1.3],
        crease: None,
        opening: None,
        gap: [3.6, 3.4, 3.0],
        depth: 4.6,
        hems: [1.05, 1.9],
        corner_radius: 3.2,
    },
    Drawing {
        name: "sedan-c",
        style: Sedan,
        arch: ([-2760.0, 315.0], 350.0, 2.2, (1.0, 40.0)),
        corners: [138.0, -400.0],
        door: (130.0, [-0.30, 0.10], 35.0),
        bumper: (0.0, [0.0, 0.0], 1.0),
        hole: ([-2820.0, 816.0], Ellipse([75.0, 75.0])),
        quadric: [855.0, -3.2, -3.4, 1.6, 0.22, -1.5],
        crease: Some((38.0, 0.03, 0.025)),
        opening: None,
        gap: [4.0, 3.4, 3.2],
        depth: 4.8,
        hems: [1.05, 1.85],
        corner_radius: 3.8,
    },
    Drawing {
        name: "sedan-d",
        style: Sedan,
        arch: ([-2800.0, 325.0], 362.0, 2.0, (0.6, 30.0)),
        corners: [155.0, -400.0],
        door: (115.0, [-0.38, -0.08], 50.0),
        bumper: (0.0, [0.0, 0.0], 1.0),
        hole: ([-2870.0, 838.0], Ellipse([82.0, 74.0])),
        quadric: [838.0, -4.6, -2.9, 1.5, 0.16, -1.4],
        crease: None,
        opening: Some(([-2716.0, 868.0], Rounded([10.0, 6.0], 4.0))),
        gap: [3.5, 3.4, 3.1],
        depth: 4.4,
        hems: [1.0, 1.8],
        corner_radius: 3.0,
    },
];

impl Drawing {
    fn body(&self, job: u16) -> Body {
        let (centre, radius, hem, flare) = self.arch;
        let arch = Arch { centre, radius, hem, flare };
        let top = centre[1] + radius;
        let (up, slopes, width) = self.door;
        let door = Body::door_line(&arch, self.corners[0], up, slopes, width);
        let (far, angles, bend) = self.bumper;
        let bumper = (self.style == Suv).then(|| Body::bumper_line(&arch, self.corners[1], far, angles, bend));
        let crease =
            |(above, rise, by): (f64, f64, f64)| (Bend::new([centre[0], top + above], [1.0, rise], 0.0, 0.0, 1.0), by);
        Body {
            name: self.name.into(),
            job,
            style: self.style,
            origin: [centre[0] + 20.0, top + 50.0],
            quadric: self.quadric,
            creases: self.crease.map(crease).into_iter().collect(),
            arch,
            door,
            bumper,
            corners: self.corners,
            corner_radius: self.corner_radius,
            hole: self.hole,
            opening: self.opening,
            gap: self.gap,
            depth: self.depth,
            hem: self.hems[0],
            hole_hem: self.hems[1],
            build: Build::default(),
        }
    }
}

/// The names of the ten models.
pub fn names() -> impl Iterator<Item = &'static str> {
    DRAWINGS.iter().map(|d| d.name)
}

impl Body {
    /// The model of that name, exactly as drawn.
    pub fn named(name: &str) -> Option<Self> {
        let k = DRAWINGS.iter().position(|d| d.name == name)?;
        Some(DRAWINGS[k].body(u16::try_from(k + 1).expect("ten")))
    }

    /// A model of random shape, as drawn.
    pub fn random(seed: u64) -> Self {
        let mut r = Random::new(seed, &[0x626f_6479]);
        // most draws are sound; where flap and lines are too near each other, the next one is tried
        loop {
            let body = draw(&mut r, seed);
            if body.sound(14.0) {
                return body;
            }
        }
    }
}

fn draw(r: &mut Random, seed: u64) -> Body {
    let style = if r.uniform() < 0.6 { Suv } else { Sedan };
    let suv = style == Suv;
    let centre = [r.between(-2800.0, -2600.0), r.between(315.0, 362.0)];
    let radius = r.between(345.0, 382.0);
    let flare = if r.uniform() < 0.5 { 0.0 } else { r.between(0.4, 2.0) };
    let half = [r.between(68.0, 84.0), r.between(66.0, 80.0)];
    let outline = match r.below(3) {
        0 => Ellipse(half),
        1 => Ellipse([half[0]; 2]),
        _ => Rounded(half, r.between(20.0, 36.0)),
    };
    let beside = if suv { r.between(-15.0, 30.0) } else { r.between(-85.0, -45.0) };
    let top = centre[1] + radius;
    let crease = (r.uniform() < 0.3).then(|| (r.between(35.0, 60.0), r.between(-0.05, 0.05), r.between(0.01, 0.035)));
    let drawing = Drawing {
        name: "random",
        style,
        arch: (centre, radius, r.between(1.7, 2.4), (flare, r.between(28.0, 45.0))),
        corners: [r.between(138.0, 172.0), r.between(-155.0, -130.0)],
        door: (
            r.between(90.0, 150.0),
            if suv {
                [r.between(-0.25, -0.05), r.between(0.05, 0.25)]
            } else {
                [r.between(-0.38, -0.2), r.between(-0.08, 0.1)]
            },
            r.between(30.0, 60.0),
        ),
        bumper: (r.between(55.0, 90.0), [r.between(44.0, 58.0), r.between(20.0, 35.0)], r.between(8.0, 14.0)),
        hole: ([centre[0] + beside, top + 70.0 + half[1] + r.between(8.0, 28.0)], outline),
        quadric: [
            r.between(835.0, 890.0),
            r.between(-4.6, -2.0),
            r.between(-3.4, -2.0),
            r.between(1.0, 1.9),
            r.between(0.0, 0.3),
            r.between(-1.7, -1.0),
        ],
        crease,
        opening: None,
        gap: [r.between(3.2, 4.4), r.between(3.2, 4.2), r.between(2.6, 3.4)],
        depth: r.between(4.0, 5.0),
        hems: [r.between(0.95, 1.15), r.between(1.6, 2.0)],
        corner_radius: r.between(2.5, 4.0),
    };
    let mut body = drawing.body(900 + u16::try_from(seed % 100).expect("less than a hundred"));
    body.name = format!("random-{seed}");
    body
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_is_sound_and_has_a_job_of_its_own() {
        for (k, name) in names().enumerate() {
            let body = Body::named(name).expect("listed");
            assert!(body.sound(10.0), "{name}");
            assert_eq!((usize::from(body.job), body.name.as_str()), (k + 1, name));
            assert_eq!(body.features().len(), if body.style == Suv { 4 } else { 3 });
        }
        assert!(Body::named("suv-z").is_none());
        assert_eq!(Body::random(5), Body::random(5));
        assert_ne!(Body::random(5), Body::random(6));
    }

    #[test]
    fn the_first_suv_has_the_nominal_points_of_the_captures_it_is_like() {
        let known = [
            [-2476.124, 873.856, 671.143],
            [-2780.707, 869.198, 681.788],
            [-2618.0, 866.670, 874.0],
            [-2640.0, 874.604, 710.0],
        ];
        for (f, known) in Body::named("suv-a").expect("listed").features().iter().zip(known) {
            let off = (0..3).map(|i| (f.at[i] - known[i]).abs()).fold(0.0, f64::max);
            assert!(off < 1.0, "{f:?}: {off} mm");
        }
    }
}

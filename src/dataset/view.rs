//! One labelled image, drawn at random: a vehicle in the station, or a hall without one.
//! In:  a seed and the image's number. Out: the image, its boxes, what it shows. Deterministic, whatever the threads.
//! Not here: files.
//!
//! Drawn wider than a station lets vehicles stand and lamps fall out: what is seen at the border of the usual is then
//! well inside of what was learned. Hard images are all near the border between yes and no: features that a thing or the
//! image's edge hides by about the share that is still labelled, and halls with outlines like a flap's.

use super::PER_BODY;
use super::boxes::{Labelled, boxed};
use super::things::Thing;
use crate::geometry::Point3;
use crate::image::Image;
use crate::optics::Pixel;
use crate::sim::{BARS_MM, Body, Build, Deviation, Dirt, Layers, Lit, PAINTS, Random, Scene, Setup, Take, expose};
use crate::vehicle::{Class, region_outline};
use nalgebra::Vector3;
use std::time::Duration;

/// What an image shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A vehicle near where it should stand.
    Vehicle,
    /// A vehicle far from there: its features are partly or all out of view.
    Elsewhere,
    /// A hall with nothing in it.
    Hall,
    /// A hall with things in it.
    Clutter,
    /// A board held before the camera.
    Board,
}

impl Kind {
    /// Its name in bodies.csv.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Elsewhere => "elsewhere",
            Self::Hall => "hall",
            Self::Clutter => "clutter",
            Self::Board => "board",
        }
    }
}

/// A labelled image.
#[derive(Clone, Debug)]
pub struct View {
    /// As the camera takes it with the bars on.
    pub image: Image<u8>,
    /// One per feature, also of those that do not count.
    pub boxes: Vec<Labelled>,
    /// What it shows.
    pub kind: Kind,
    /// The body's seed; none without a vehicle.
    pub body: Option<u64>,
    /// The paint's name; none without a vehicle.
    pub paint: Option<&'static str>,
}

/// Share of vehicles that stand far from where they should.
const ELSEWHERE: f64 = 0.03;

/// Of a hard image's feature that a thing hides so much can be seen.
const PARTLY: std::ops::Range<f64> = 0.45..0.95;
/// So many things are tried until one hides that much.
const TRIES: usize = 30;

const CLASSES: [Class; 4] = [Class::Point1, Class::Point2, Class::Point3, Class::Point4];

/// Image `number` of `seed`, through the lens of `setup`, whose lamps are moved; `empty` is the share without a vehicle,
/// `hard` that of hard images.
pub fn view(setup: &mut Setup, seed: u64, number: u64, empty: f64, hard: f64) -> View {
    let hard = Random::new(seed, &[0x6861_7264, number]).uniform() < hard;
    let mut random = Random::new(seed, &[0x6461_7461, number]);
    let kind = if random.uniform() < empty {
        [Kind::Hall, Kind::Clutter, Kind::Clutter, Kind::Board, Kind::Board][random.below(5)]
    } else if random.uniform() < ELSEWHERE {
        Kind::Elsewhere
    } else {
        Kind::Vehicle
    };
    let usual = random.uniform() < 0.4;
    setup.place_bars(if usual { BARS_MM } else { random.between(300.0, 1400.0) });
    setup.blur_px = if random.uniform() < 0.8 { random.between(0.3, 0.6) } else { random.between(0.6, 1.4) };
    match kind {
        Kind::Vehicle | Kind::Elsewhere => vehicle(setup, (seed, number), (kind, hard), &mut random),
        _ => hall(setup, (kind, hard), &mut random),
    }
}

fn vehicle(setup: &Setup, (seed, number): (u64, u64), (kind, hard): (Kind, bool), random: &mut Random) -> View {
    let body_seed = Random::new(seed, &[0x626f_6469, number / PER_BODY]).bits();
    let body = Body::random(body_seed).built(Build::random(random));
    let paint = PAINTS[random.below(PAINTS.len())];
    let mut stands = deviation(kind, random);
    // half of the hard images have something at the border, the others something with a thing before it
    let cut = hard && random.uniform() < 0.5;
    if cut {
        let far = random.between(120.0, 480.0);
        stands.along_mm = if random.uniform() < 0.5 { -far } else { far };
    }
    let scene = Scene::new(body, paint, &stands);
    let layers = Layers::new(&scene, setup, 0.0);
    let mut image = taken(setup, &layers, random);
    let size = (image.width, image.height);
    let mut covered = Image::filled(size.0, size.1, false);
    if random.uniform() < 0.35 {
        for _ in 0..=random.below(3) {
            Thing::in_the_way(random, size).paint(&mut image, &mut covered, random);
        }
    }
    let flap = scene.body.flap_outline();
    let features = scene.body.features();
    let of = |k: usize, hidden: &dyn Fn(&Pixel) -> bool| {
        let f = &features[k];
        let class = CLASSES[usize::from(f.class) - 1];
        let seen = |[along, up]: [f64; 2]| {
            let p = Vector3::from(scene.body.on_surface([f.at[0] + along, f.at[2] + up]));
            setup.rig.camera.project(&(scene.camera_from_vehicle * Point3::new(p)).xyz)
        };
        boxed(class, &region_outline(class, &flap), size, seen, hidden)
    };
    let whole = |v: f64, n: usize| (v.round().max(0.0) as usize).min(n - 1);
    if hard && !cut {
        let k = random.below(features.len());
        let target = of(k, &|_| false).filter(Labelled::counts);
        let things = (0..TRIES).filter_map(|_| target.map(|target| Thing::before(random, size, target.sides)));
        let partly = |thing: &Thing| of(k, &|p| thing.hides(p)).is_some_and(|b| PARTLY.contains(&b.visible));
        let found = things.into_iter().find(partly);
        if let Some(thing) = found {
            thing.paint(&mut image, &mut covered, random);
        }
    }
    let hidden = |p: &Pixel| covered.at(whole(p.x, size.0), whole(p.y, size.1));
    let boxes = (0..features.len()).filter_map(|k| of(k, &hidden)).collect();
    View { image, boxes, kind, body: Some(body_seed), paint: Some(paint.name) }
}

/// Most as vehicles roll into a station, at 650 to 850 mm; some beyond.
fn deviation(kind: Kind, random: &mut Random) -> Deviation {
    let wide = random.uniform() < 0.3;
    let mut within = |usual: f64, most: f64| {
        let by = if wide { most } else { usual };
        random.between(-by, by)
    };
    let mut d = Deviation {
        along_mm: within(50.0, 120.0),
        across_mm: within(100.0, 110.0),
        up_mm: within(20.0, 70.0),
        roll_deg: within(1.0, 3.0),
        pitch_deg: within(1.0, 3.0),
        yaw_deg: within(12.5, 16.0),
    };
    if kind == Kind::Elsewhere {
        let far = random.between(350.0, 900.0);
        d.along_mm = if random.uniform() < 0.5 { -far } else { far };
    }
    d
}

/// A hall with nothing, things or a board in it.
fn hall(setup: &Setup, (kind, hard): (Kind, bool), random: &mut Random) -> View {
    let mut image = taken(setup, &Layers::empty(setup), random);
    let size = (image.width, image.height);
    let mut covered = Image::filled(size.0, size.1, false);
    let things = match kind {
        Kind::Hall => 0,
        Kind::Clutter => 4 + random.below(25),
        _ => random.below(8),
    };
    for _ in 0..things {
        Thing::any(random, size).paint(&mut image, &mut covered, random);
    }
    if kind == Kind::Board {
        Thing::board(random, size).paint(&mut image, &mut covered, random);
    }
    if hard {
        for _ in 0..=random.below(3) {
            for thing in Thing::like_a_flap(random, size) {
                thing.paint(&mut image, &mut covered, random);
            }
        }
    }
    View { image, boxes: Vec::new(), kind, body: None, paint: None }
}

/// An image under lamps, dirt and exposure drawn at random.
fn taken(setup: &Setup, layers: &Layers, random: &mut Random) -> Image<u8> {
    let mut bar = || if random.uniform() < 0.07 { random.between(0.0, 0.2) } else { random.between(0.3, 1.0) };
    let bars = [bar(), bar()];
    let ambient = match random.below(10) {
        0..6 => random.between(0.0, 1.0),
        6..9 => random.between(1.0, 3.0),
        _ => random.between(3.0, 10.0),
    };
    let lit = Lit { bars, ambient, picture: None };
    let level = if random.uniform() < 0.9 { random.between(25.0, 150.0) } else { random.between(10.0, 230.0) };
    let gain = if random.uniform() < 0.7 { 1.0 } else { random.between(1.0, 4.0) };
    let electrons = level / (setup.sensor.dn_per_electron * gain);
    // no lamp is so dim that it takes a second
    let ms = (electrons / layers.brightness(&lit, 0.7).max(1e-3)).min(1000.0);
    let take = Take { exposure: Duration::from_secs_f64(1e-3 * ms), gain, seed: random.bits(), number: random.bits() };
    let dirt = (random.uniform() < 0.35).then(|| dirt(random));
    let mut raw = Image::filled(setup.sensor.width, setup.sensor.height, 0u16);
    expose(setup, layers, &lit, dirt.as_ref(), &take, &mut raw);
    let shift = setup.sensor.bits.saturating_sub(8);
    let pixels = raw.pixels.iter().map(|v| (v >> shift).min(255) as u8).collect();
    Image { width: raw.width, height: raw.height, pixels }
}

fn dirt(random: &mut Random) -> Dirt {
    let smudge = |random: &mut Random| {
        let at = [random.uniform(), 0.75 * random.uniform()];
        (at, 0.01 * 15.0f64.powf(random.uniform()), random.between(0.1, 0.7))
    };
    let n = 1 + random.below(5);
    Dirt { smudges: (0..n).map(|_| smudge(random)).collect(), veil: random.between(0.0, 0.15) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_images_show_a_vehicle_with_its_features_and_a_number_always_the_same_image() {
        let mut setup = Setup::new(0.125, 8).red_only();
        let mut of = |number| view(&mut setup, 3, number, 0.1, 0.0);
        let (mut vehicles, mut boxes, mut needed) = (0, 0, 0);
        for number in 0..40 {
            let v = of(number);
            if v.body.is_none() {
                assert!(v.boxes.is_empty());
                continue;
            }
            vehicles += 1;
            boxes += v.boxes.iter().filter(|b| b.counts()).count();
            needed += v.boxes.len();
            let inside = |b: &Labelled| b.sides[2] - b.sides[0] > 5.0 && b.sides[3] - b.sides[1] > 3.0;
            assert!(v.boxes.iter().filter(|b| b.counts()).all(inside), "{:?}", v.boxes);
        }
        assert!(vehicles >= 30 && boxes * 10 > needed * 8, "{boxes} of {needed} in {vehicles}");
        let (a, b) = (of(7), of(7));
        assert!(a.image == b.image && a.boxes == b.boxes, "drawn again it is the same");
        let (one, other) = (of(2), of(3));
        assert!(one.body.is_some() && one.body == other.body, "two images of one body");
    }

    #[test]
    fn hard_images_have_features_about_the_share_that_is_labelled() {
        let mut setup = Setup::new(0.125, 8).red_only();
        let mut partly = |hard| {
            let all: Vec<f64> =
                (0..60).flat_map(|n| view(&mut setup, 4, n, 0.0, hard).boxes).map(|b| b.visible).collect();
            all.iter().filter(|v| (0.4..0.95).contains(*v)).count()
        };
        let (usual, hard) = (partly(0.0), partly(1.0));
        assert!(hard > 20 && hard > 2 * usual, "{hard} of hard ones, {usual} else");
    }

    #[test]
    fn an_empty_hall_has_no_boxes() {
        let mut setup = Setup::new(0.125, 8).red_only();
        let all: Vec<View> = (0..20).map(|n| view(&mut setup, 1, n, 1.0, 0.5)).collect();
        assert!(all.iter().all(|v| v.boxes.is_empty() && v.body.is_none()));
        for kind in [Kind::Hall, Kind::Clutter, Kind::Board] {
            assert!(all.iter().any(|v| v.kind == kind), "{kind:?}");
        }
    }
}

//! Things that are no vehicle: before one, or in an empty hall. Painted onto the finished image, as a camera sees them.
//! In: an image, a stream of random numbers. Out: the image with things in it, and where they are. px, grey levels of 255.
//! Not here: light; they are as bright as they are drawn.

use crate::image::Image;
use crate::optics::Pixel;
use crate::sim::Random;

/// A flat thing: a rectangle with rounded corners, turned and sheared.
#[derive(Clone, Debug)]
pub(super) struct Thing {
    centre: [f64; 2],
    turn: f64,
    shear: f64,
    half: [f64; 2],
    round: f64,
    /// Only its border is there, so wide.
    hollow: Option<f64>,
    fill: Fill,
    level: f64,
    /// Grey levels per px, across and down.
    slope: [f64; 2],
    noise: f64,
}

/// What is on it.
#[derive(Clone, Copy, Debug)]
enum Fill {
    Plain,
    /// Fringes: period, contrast.
    Stripes(f64, f64),
    /// Squares and discs: pitch, level of the marks as a share; how large a disc is.
    Chess(f64, f64),
    Discs(f64, f64, f64),
}

impl Fill {
    /// Factor on the level at a place on the thing.
    fn at(self, [x, y]: [f64; 2]) -> f64 {
        match self {
            Self::Plain => 1.0,
            Self::Stripes(period, contrast) => 1.0 + contrast * (std::f64::consts::TAU * x / period).cos(),
            Self::Chess(pitch, mark) => {
                let dark = ((x / pitch).floor() + (y / pitch).floor()).rem_euclid(2.0) > 0.5;
                if dark { mark } else { 1.0 }
            }
            Self::Discs(pitch, mark, radius) => {
                let off = [x, y].map(|v| (v / pitch - 0.5).rem_euclid(1.0) - 0.5);
                if off[0].hypot(off[1]) < radius { mark } else { 1.0 }
            }
        }
    }
}

impl Thing {
    /// Something that may be in the way of `width` px of image: a hose, a sheet, a hand.
    pub(super) fn in_the_way(random: &mut Random, (width, height): (usize, usize)) -> Self {
        let mut thing = Self::any(random, (width, height));
        let w = width as f64;
        thing.half = match random.below(3) {
            0 => [random.between(0.3, 0.8) * w, random.between(0.006, 0.025) * w],
            1 => [random.between(0.02, 0.12) * w, random.between(0.02, 0.12) * w],
            _ => [random.between(0.05, 0.2) * w, random.between(0.01, 0.06) * w],
        };
        thing.round = random.between(0.1, 1.0) * thing.half[0].min(thing.half[1]);
        thing.hollow = None;
        thing.fill = if random.uniform() < 0.9 { Fill::Plain } else { Fill::Stripes(random.between(6.0, 60.0), 0.6) };
        thing
    }

    /// Something in the way of a part of a box: no smaller than half of it, and about its border.
    pub(super) fn before(random: &mut Random, size: (usize, usize), [left, top, right, bottom]: [f64; 4]) -> Self {
        let mut thing = Self::in_the_way(random, size);
        let half = [0.5 * (right - left), 0.5 * (bottom - top)];
        let larger = half[0].max(half[1]);
        thing.half = [random.between(0.3, 3.0) * larger, random.between(0.3, 1.5) * larger];
        thing.round = random.uniform() * thing.half[1].min(thing.half[0]);
        let beside = 1.5 * larger;
        thing.centre = [left + half[0], top + half[1]].map(|v| v + random.between(-beside, beside));
        thing
    }

    /// A closed narrow line like that about a flap, most on a plate hardly larger: no panel of a body is about it.
    pub(super) fn like_a_flap(random: &mut Random, size: (usize, usize)) -> Vec<Self> {
        let w = size.0 as f64;
        let mut line = Self::any(random, size);
        line.half = [0, 1].map(|_| random.between(0.03, 0.1) * w);
        line.round = random.between(0.1, 1.0) * line.half[0].min(line.half[1]);
        line.turn = if random.uniform() < 0.7 { random.between(-0.3, 0.3) } else { line.turn };
        (line.hollow, line.fill) = (Some(random.between(0.003, 0.02) * w), Fill::Plain);
        if random.uniform() < 0.4 {
            return vec![line];
        }
        let mut plate = line.clone();
        plate.half = line.half.map(|h| h * random.between(1.05, 2.0));
        (plate.hollow, plate.level) = (None, random.between(40.0, 230.0));
        line.level = plate.level * random.between(0.05, 0.7);
        vec![plate, line]
    }

    /// A part of a hall. Nothing like a flap's narrow gap or an arch's wide one: those would be labelled wrongly.
    pub(super) fn any(random: &mut Random, (width, height): (usize, usize)) -> Self {
        let (w, h) = (width as f64, height as f64);
        let size = |r: &mut Random| w * 0.015 * (20.0f64).powf(r.uniform());
        let half = [size(random), size(random)];
        let level = random.between(2.0, 230.0);
        let slope = [0, 1].map(|_| random.between(-0.3, 0.3) * level / w);
        let hollow = (random.uniform() < 0.2).then(|| random.between(0.01, 0.03) * w);
        let fill = match random.below(10) {
            0 => Fill::Stripes(random.between(5.0, 80.0), random.between(0.3, 1.0)),
            1 => Fill::Chess(random.between(8.0, 40.0), random.between(0.05, 0.6)),
            _ => Fill::Plain,
        };
        let smaller = half[0].min(half[1]);
        Self {
            centre: [random.uniform() * w, random.uniform() * h],
            turn: random.between(0.0, std::f64::consts::PI),
            shear: if random.uniform() < 0.5 { 0.0 } else { random.between(-0.5, 0.5) },
            half,
            // large things have sharp corners: a large dark disc would be an arch
            round: if smaller < 0.1 * w { smaller * random.uniform() } else { 2.0 },
            hollow,
            fill,
            level,
            slope,
            noise: random.between(0.5, 4.0),
        }
    }

    /// A calibration board, held before the camera.
    pub(super) fn board(random: &mut Random, size: (usize, usize)) -> Self {
        let w = size.0 as f64;
        let mut thing = Self::any(random, size);
        thing.half = [random.between(0.15, 0.45) * w, random.between(0.1, 0.35) * w];
        thing.centre = [0, 1].map(|i| [size.0, size.1][i] as f64 * random.between(0.25, 0.75));
        thing.turn = random.between(-0.4, 0.4);
        (thing.round, thing.hollow, thing.level) = (random.between(0.0, 6.0), None, random.between(50.0, 230.0));
        let pitch = thing.half[1] * random.between(0.12, 0.45);
        let mark = random.between(0.03, 0.6);
        thing.fill = match random.below(5) {
            0 | 1 => Fill::Chess(pitch, mark),
            2 | 3 => Fill::Discs(pitch, mark, random.between(0.15, 0.42)),
            _ => Fill::Stripes(pitch, random.between(0.3, 1.0)),
        };
        thing
    }

    /// Paints it; `covered` becomes true where it hides what was there.
    pub(super) fn paint(&self, image: &mut Image<u8>, covered: &mut Image<bool>, random: &mut Random) {
        let reach = (1.0 + self.shear.abs()) * self.half[0].hypot(self.half[1]) + 2.0;
        let range = |i: usize, n: usize| {
            let clip = |v: f64| v.clamp(0.0, n as f64) as usize;
            clip(self.centre[i] - reach)..clip(self.centre[i] + reach)
        };
        let columns = range(0, image.width);
        for y in range(1, image.height) {
            for x in columns.clone() {
                let d = [x as f64 - self.centre[0], y as f64 - self.centre[1]];
                let q = self.local(d);
                let mut out = self.distance(q);
                if let Some(wide) = self.hollow {
                    out = (out + 0.5 * wide).abs() - 0.5 * wide;
                }
                let cover = (0.5 - out).clamp(0.0, 1.0);
                if cover == 0.0 {
                    continue;
                }
                let level = (self.level + self.slope[0] * d[0] + self.slope[1] * d[1]) * self.fill.at(q);
                let noise = self.noise * 2.0 * (random.uniform() + random.uniform() + random.uniform() - 1.5);
                let pixel = &mut image.row_mut(y)[x];
                let mixed = f64::from(*pixel) + cover * (level + noise - f64::from(*pixel));
                *pixel = mixed.round().clamp(0.0, 255.0) as u8;
                covered.row_mut(y)[x] |= cover > 0.5;
            }
        }
    }

    /// Whether it covers most of the pixel there.
    pub(super) fn hides(&self, p: &Pixel) -> bool {
        self.distance(self.local([p.x - self.centre[0], p.y - self.centre[1]])) < 0.0
    }

    /// A place, from its centre in the image, on it.
    fn local(&self, d: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.turn.sin_cos();
        let q = [cos * d[0] + sin * d[1], cos * d[1] - sin * d[0]];
        [q[0] + self.shear * q[1], q[1]]
    }

    /// Signed distance to its outline, px; inside of it also where it is hollow.
    fn distance(&self, q: [f64; 2]) -> f64 {
        let d = [0, 1].map(|i| q[i].abs() - self.half[i] + self.round);
        d[0].max(0.0).hypot(d[1].max(0.0)) + d[0].max(d[1]).min(0.0) - self.round
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thing_hides_what_it_is_painted_on() {
        let mut random = Random::new(1, &[]);
        let mut thing = Thing::in_the_way(&mut random, (200, 100));
        (thing.centre, thing.half, thing.round, thing.turn, thing.shear) = ([100.0, 50.0], [30.0, 20.0], 5.0, 0.0, 0.0);
        (thing.level, thing.noise, thing.fill, thing.slope) = (90.0, 0.0, Fill::Plain, [0.0; 2]);
        let mut image = Image::filled(200, 100, 10u8);
        let mut covered = Image::filled(200, 100, false);
        thing.paint(&mut image, &mut covered, &mut random);
        assert_eq!((image.at(100, 50), image.at(125, 65), image.at(135, 50)), (90, 90, 10));
        let area = covered.pixels.iter().filter(|c| **c).count();
        assert!((2250..2310).contains(&area), "{area} px of 59·39 less its corners");
        assert!(covered.pixels.iter().zip(&image.pixels).all(|(c, v)| !c || *v > 49));
    }
}

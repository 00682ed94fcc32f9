//! A scene's light on the sensor, pixel by pixel: geometry once, then any number of images of it.
//! In:  a scene and a setup; then lamps' drives and the projector's picture. Out: electrons per pixel.
//! Not here: noise, grey levels, time.

use super::projector::Picture;
use super::scene::{Crossing, Glow, Scene, Stage};
use super::setup::{DISTANCE_MM, PROJECTOR_BLACK, SENSITIVITY, Setup};
use rayon::prelude::*;
use std::time::Duration;

/// What is lit when an image is exposed.
#[derive(Clone, Copy, Debug)]
pub struct Lit<'a> {
    /// Drives of the bars, 0..1.
    pub bars: [f64; 2],
    /// Tubes and hall, as a share of their usual light.
    pub ambient: f64,
    /// What the projector shows; none: its light is off.
    pub picture: Option<&'a Picture>,
}

/// Light of the projector that comes back through one pixel from one part of the scene.
#[derive(Clone, Copy, Debug)]
struct Beam {
    /// cd/m² at white.
    weight: f32,
    column: f32,
    row: f32,
}

/// What one row of pixels sees.
#[derive(Clone, Debug)]
struct Row {
    /// cd/m² of each bar at full drive, and of tubes and hall.
    bars: Vec<[f32; 2]>,
    ambient: Vec<f32>,
    /// The brightest beam of each pixel.
    beams: Vec<Beam>,
    /// Further beams of pixels across an edge: the pixel's column and the beam.
    further: Vec<(u32, Beam)>,
}

/// A scene's light on every pixel.
#[derive(Clone, Debug)]
pub struct Layers {
    rows: Vec<Row>,
    /// Noise beyond the sensor's, as a share of light.
    pub(super) glitter: f64,
}

/// Beams of one pixel nearer to each other in the projector's picture are one, px.
const ONE_BEAM_PX: f64 = 2.5;

impl Layers {
    /// Looks at `scene` through every pixel of `setup`, whose projector has been turned by `bumped` degrees about its
    /// vertical axis.
    pub fn new(scene: &Scene, setup: &Setup, bumped: f64) -> Self {
        let stage = scene.stage(setup, bumped);
        let lens = &setup.rig.camera;
        let rays = setup.rays();
        let rows = (0..lens.height).into_par_iter().map(|y| row(&stage, setup, &rays[y * lens.width..][..lens.width]));
        Self { rows: rows.collect(), glitter: scene.paint.glitter }
    }

    /// The hall without a vehicle: a dim wall far away, which bars and projector reach, too.
    pub fn empty(setup: &Setup) -> Self {
        let lens = &setup.rig.camera;
        let n = lens.width;
        let wall = (0.1 * setup.room_luminance) as f32;
        // what a grey wall at four times the usual distance sends back; the whole of it lies in the picture's middle
        let [bars, weight] = [0.5 * setup.lux([1.0, 1.0]), setup.projector_candela * 1e6 / DISTANCE_MM.powi(2)]
            .map(|lux| (0.3 * lux / (16.0 * std::f64::consts::PI)) as f32);
        let (column, row) = (setup.rig.projector.cx as f32, setup.rig.projector.cy as f32);
        let row = Row {
            bars: vec![[bars; 2]; n],
            ambient: vec![wall; n],
            beams: vec![Beam { weight, column, row }; n],
            further: Vec::new(),
        };
        Self { rows: vec![row; lens.height], glitter: 0.0 }
    }

    /// Electrons that `lit` gives in `exposure`, for every pixel of row `y`, before the lens blurs them.
    pub(super) fn electrons(&self, y: usize, lit: &Lit, exposure: Duration, out: &mut [f32]) {
        let row = &self.rows[y];
        let scale = (SENSITIVITY * exposure.as_secs_f64() * 1e3) as f32;
        let [left, right] = lit.bars.map(|b| b as f32);
        let ambient = lit.ambient as f32;
        for ((out, bars), a) in out.iter_mut().zip(&row.bars).zip(&row.ambient) {
            *out = scale * (left * bars[0] + right * bars[1] + ambient * a);
        }
        let Some(picture) = lit.picture else { return };
        let black = PROJECTOR_BLACK as f32;
        let light = |b: &Beam| scale * b.weight * (black + (1.0 - black) * picture.at(b.column, b.row));
        for (out, beam) in out.iter_mut().zip(&row.beams) {
            if beam.weight > 0.0 {
                *out += light(beam);
            }
        }
        for (x, beam) in &row.further {
            out[*x as usize] += light(beam);
        }
    }

    /// Electrons per ms that `share` of the pixels stay below.
    pub fn brightness(&self, lit: &Lit, share: f64) -> f64 {
        let mut all = Vec::new();
        for y in (0..self.rows.len()).step_by(5) {
            let mut row = vec![0.0; self.rows[y].bars.len()];
            self.electrons(y, lit, Duration::from_millis(1), &mut row);
            all.extend(row.into_iter().step_by(5));
        }
        let at = ((share * all.len() as f64) as usize).min(all.len() - 1);
        f64::from(*all.select_nth_unstable_by(at, f32::total_cmp).1)
    }

    /// Rows.
    pub(super) fn height(&self) -> usize {
        self.rows.len()
    }
}

fn row(stage: &Stage, setup: &Setup, rays: &[[f32; 2]]) -> Row {
    let lens = &setup.rig.camera;
    let n = rays.len();
    let dark = Beam { weight: 0.0, column: 0.0, row: 0.0 };
    let mut row = Row { bars: vec![[0.0; 2]; n], ambient: vec![0.0; n], beams: vec![dark; n], further: Vec::new() };
    let mut near = super::setup::DISTANCE_MM;
    for (x, ray) in rays.iter().enumerate() {
        let [u, v] = ray.map(f64::from);
        let crossing = stage.cross(u, v, near);
        near = crossing.depth;
        let mm = crossing.depth / lens.fx;
        // light falls off towards the corners, a quarter as fast as cos⁴ does: the lens is stopped down
        let vignetting = 1.0 / (1.0 + u * u + v * v).sqrt();
        let count = stage.samples(&crossing, mm);
        let pixel = if count == 1 {
            let glow = stage.look(&crossing, mm);
            let beam = beam_of(&glow, 1.0);
            row.beams[x] = Beam { weight: beam.weight * vignetting as f32, ..beam };
            glow
        } else {
            let (mean, beams) = several(stage, &crossing, [u, v], [1.0 / lens.fx, 1.0 / lens.fy], count, mm);
            let seen = |b: &Beam| Beam { weight: b.weight * vignetting as f32, ..*b };
            if let Some((first, rest)) = beams.split_first() {
                row.beams[x] = seen(first);
                row.further.extend(rest.iter().map(|b| (x as u32, seen(b))));
            }
            mean
        };
        row.bars[x] = pixel.bars.map(|b| (b * vignetting) as f32);
        row.ambient[x] = (pixel.ambient * vignetting) as f32;
    }
    row
}

/// The mean of `count`×`count` samples over one pixel, and the beams of the parts that it sees.
fn several(
    stage: &Stage,
    centre: &Crossing,
    [u, v]: [f64; 2],
    pixel: [f64; 2],
    count: usize,
    mm: f64,
) -> (Glow, Vec<Beam>) {
    let each = 1.0 / (count * count) as f64;
    let mut mean = Glow::default();
    let mut beams: Vec<Beam> = Vec::new();
    for i in 0..count {
        for j in 0..count {
            let off = |k: usize| (k as f64 + 0.5) / count as f64 - 0.5;
            let at = stage.cross(u + off(j) * pixel[0], v + off(i) * pixel[1], centre.depth);
            let glow = stage.look(&at, mm / count as f64);
            mean.bars = [0, 1].map(|k| mean.bars[k] + each * glow.bars[k]);
            mean.ambient += each * glow.ambient;
            let beam = beam_of(&glow, each);
            if beam.weight <= 0.0 {
                continue;
            }
            let same = |b: &&mut Beam| f64::from((b.column - beam.column).hypot(b.row - beam.row)) < ONE_BEAM_PX;
            match beams.iter_mut().find(same) {
                Some(b) => {
                    let share = beam.weight / (b.weight + beam.weight);
                    b.weight += beam.weight;
                    b.column += share * (beam.column - b.column);
                    b.row += share * (beam.row - b.row);
                }
                None => beams.push(beam),
            }
        }
    }
    (mean, beams)
}

fn beam_of(glow: &Glow, share: f64) -> Beam {
    Beam { weight: (share * glow.projector) as f32, column: glow.column as f32, row: glow.row as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Body, Deviation, Paint};

    #[test]
    fn light_adds_up_and_grows_with_time() {
        let setup = Setup::new(0.25, 8);
        let body = Body::named("suv-a").expect("listed");
        let scene = Scene::new(body, Paint::named("grey").expect("listed"), &Deviation::default());
        let layers = Layers::new(&scene, &setup, 0.0);
        let flat = Picture::new(&crate::Image::filled(1280, 800, 255), &setup, 760.0);
        let row = |bars, ambient, picture, ms| {
            let mut out = vec![0.0; setup.sensor.width];
            layers.electrons(300, &Lit { bars, ambient, picture }, Duration::from_millis(ms), &mut out);
            out
        };
        let all = row([0.5, 0.25], 1.0, Some(&flat), 4);
        let parts = [
            row([0.5, 0.0], 0.0, None, 4),
            row([0.0, 0.5], 0.0, None, 2),
            row([0.0; 2], 1.0, None, 4),
            row([0.0; 2], 0.0, Some(&flat), 4),
        ];
        for (x, all) in all.iter().enumerate() {
            let sum: f32 = parts.iter().map(|p| p[x]).sum();
            assert!((all - sum).abs() <= 1e-3 * sum, "{x}: {all} {sum}");
        }
        let dark = layers.brightness(&Lit { bars: [0.5; 2], ambient: 0.0, picture: None }, 0.01);
        let bright = layers.brightness(&Lit { bars: [1.0; 2], ambient: 0.0, picture: None }, 0.7);
        assert!((0.0..1.0).contains(&dark) && bright > 100.0, "the wheelhouse {dark}, the body {bright}");
        // some pixels of a row that crosses the flap's gap see two parts
        assert!(layers.rows.iter().any(|r| !r.further.is_empty()));
    }
}

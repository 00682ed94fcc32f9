//! Images of boards, for tests. In: a board, how it stands, light, lens, what hides it. Out: an image, and where its
//! points truly are. Not here: finding them.

use crate::calibrate::{Board, BoardKind};
use crate::image::Image;
use crate::optics::{Lens, Pixel};
use crate::testing::Noise;
use nalgebra::{Rotation3, Vector2, Vector3};
use rayon::prelude::*;

/// A board in front of a camera of 640 × 480 px with f = 700 px. Degrees.
#[derive(Clone, Debug)]
pub(super) struct Scene {
    pub(super) board: Board,
    /// In its own plane, clockwise on the screen.
    pub(super) turn: f64,
    /// Away from the image plane, about an axis in the image in direction `about`.
    pub(super) tilt: f64,
    pub(super) about: f64,
    /// Of a pitch in the middle of the board, untilted, px.
    pub(super) side: f64,
    /// Where the middle of the board is, px, but for the lens.
    pub(super) centre: Pixel,
    /// How much farther from the middle the image's corners are than without a lens, as a share (k1, scaled).
    pub(super) barrel: f64,
    /// Light falls to this share across the image, in this direction.
    pub(super) light: (f64, f64),
    /// And by this share towards the image's corners.
    pub(super) vignetting: f64,
    /// And to this share beyond a sharp line across the board.
    pub(super) shadow: Option<f64>,
    /// Grey levels of black, and from black to white.
    pub(super) grey: (f64, f64),
    /// Sigma, grey levels.
    pub(super) noise: f64,
    pub(super) seed: u64,
    /// Points under a grey spot of a fair size.
    pub(super) hidden: Vec<usize>,
}

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const FOCAL: f64 = 700.0;
/// Samples of a pixel that an edge crosses.
const SAMPLES: usize = 64;

impl Scene {
    /// A board of 30 px a pitch that faces the camera, in even light, with a little noise.
    pub(super) fn new(board: &str) -> Self {
        Self {
            board: board.parse().expect("a board"),
            turn: 0.0,
            tilt: 0.0,
            about: 20.0,
            side: 30.0,
            centre: Pixel::new(325.0, 235.0),
            barrel: 0.0,
            light: (1.0, 0.0),
            vignetting: 0.0,
            shadow: None,
            grey: (10.0, 180.0),
            noise: 1.0,
            seed: 1,
            hidden: Vec::new(),
        }
    }

    pub(super) fn lens(&self) -> Lens {
        let (cx, cy) = ((WIDTH as f64 - 1.0) / 2.0, (HEIGHT as f64 - 1.0) / 2.0);
        let corner = Vector2::new(cx, cy).norm_squared() / (FOCAL * FOCAL);
        let distortion = [self.barrel / corner, 0.0, 0.0, 0.0, 0.0];
        Lens { width: WIDTH, height: HEIGHT, fx: FOCAL, fy: FOCAL, cx, cy, distortion }
    }

    /// The board's origin, x and y in the camera's frame, mm.
    fn pose(&self) -> [Vector3<f64>; 3] {
        let axis = Vector3::new(self.about.to_radians().cos(), self.about.to_radians().sin(), 0.0);
        let tilt = Rotation3::new(axis * self.tilt.to_radians());
        let r = tilt * Rotation3::new(Vector3::z() * self.turn.to_radians());
        let lens = self.lens();
        let z = FOCAL * self.board.pitch / self.side;
        let middle = Vector3::new((self.centre.x - lens.cx) / FOCAL * z, (self.centre.y - lens.cy) / FOCAL * z, z);
        let half = |n: usize| 0.5 * (n as f64 - 1.0) * self.board.pitch;
        let (x, y) = (r * Vector3::x(), r * Vector3::y());
        [middle - x * half(self.board.columns) - y * half(self.board.rows), x, y]
    }

    /// Where the board's points are, px.
    pub(super) fn truth(&self) -> Vec<Pixel> {
        let ([origin, x, y], lens) = (self.pose(), self.lens());
        let pixel = |p: &Vector2<f64>| lens.project(&(origin + x * p.x + y * p.y)).expect("in front");
        self.board.points().iter().map(pixel).collect()
    }

    pub(super) fn image(&self) -> Image<f32> {
        let ([origin, x, y], lens) = (self.pose(), self.lens());
        let normal = x.cross(&y);
        let on_board = |k: usize| {
            // corners of pixels, one row and column more than pixels
            let pixel = Pixel::new((k % (WIDTH + 1)) as f64 - 0.5, (k / (WIDTH + 1)) as f64 - 0.5);
            let ray = lens.ray(&pixel).expect("the lens is mild");
            let d = ray * (normal.dot(&origin) / normal.dot(&ray)) - origin;
            Vector2::new(d.dot(&x), d.dot(&y))
        };
        let corners: Vec<Vector2<f64>> = (0..(WIDTH + 1) * (HEIGHT + 1)).into_par_iter().map(on_board).collect();
        let mut image = Image::filled(WIDTH, HEIGHT, 0.0);
        image.pixels.par_iter_mut().enumerate().for_each(|(i, pixel)| {
            let (left, top) = (i % WIDTH, i / WIDTH);
            let at = |u: f64, v: f64| {
                let k = top * (WIDTH + 1) + left;
                let (upper, lower) = ([corners[k], corners[k + 1]], [corners[k + WIDTH + 1], corners[k + WIDTH + 2]]);
                (1.0 - v) * ((1.0 - u) * upper[0] + u * upper[1]) + v * ((1.0 - u) * lower[0] + u * lower[1])
            };
            let few =
                [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 0.5)].map(|(u, v)| self.reflectance(&at(u, v)));
            // no two samples share a column or row of sub-pixels
            let place = |k: usize| (k as f64 + 0.5) / SAMPLES as f64;
            let sample = |k: usize| self.reflectance(&at(place(k), place(k * 19 % SAMPLES)));
            let even = few.iter().all(|r| *r == few[0]);
            let mean = if even { few[0] } else { (0..SAMPLES).map(sample).sum::<f64>() / SAMPLES as f64 };
            *pixel = (mean * self.light(left as f64, top as f64)) as f32;
        });
        blur(&mut image);
        let mut noise = Noise::new(self.seed);
        for pixel in &mut image.pixels {
            *pixel = (self.grey.0 + self.grey.1 * f64::from(*pixel) + self.noise * noise.gauss()) as f32;
        }
        image
    }

    fn light(&self, x: f64, y: f64) -> f64 {
        let (u, v) = (x / WIDTH as f64 - 0.5, y / HEIGHT as f64 - 0.5);
        let (sin, cos) = self.light.1.to_radians().sin_cos();
        let slope = 1.0 - (1.0 - self.light.0) * (0.5 + (u * cos + v * sin) / (cos.abs() + sin.abs()));
        let shadow = self.shadow.filter(|_| 0.3 * u + v > 0.013).unwrap_or(1.0);
        slope * (1.0 - self.vignetting * 2.0 * (u * u + v * v)) * shadow
    }

    /// At a point of the board's plane, mm: black 0.05, white 0.9, all around it 0.4.
    fn reflectance(&self, p: &Vector2<f64>) -> f64 {
        let pitch = self.board.pitch;
        let point = |k: usize| Vector2::new((k % self.board.columns) as f64, (k / self.board.columns) as f64) * pitch;
        if self.hidden.iter().any(|&k| (point(k) - p).norm() < 0.45 * pitch) {
            return 0.3;
        }
        let (u, v) = (p.x / pitch, p.y / pitch);
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        let within = |margin: f64| u > -margin && v > -margin && u < columns - 1.0 + margin && v < rows - 1.0 + margin;
        if !within(1.4) {
            return 0.4;
        }
        let near = |x: f64, y: f64, radius: f64| (u - x).hypot(v - y) < radius / pitch;
        let disc = |d: f64| within(0.5) && near(u.round(), v.round(), 0.5 * d);
        let dark = match self.board.kind {
            BoardKind::Chessboard => within(1.0) && (u.floor() + v.floor()).rem_euclid(2.0) == 0.0,
            BoardKind::Circles { diameter } => disc(diameter),
            BoardKind::Marked { diameter } => {
                disc(diameter) || [(0.5, 0.0), (0.0, 0.5), (0.5, 1.0)].iter().any(|m| near(m.0, m.1, 0.15 * diameter))
            }
        };
        if dark { 0.05 } else { 0.9 }
    }
}

/// By a Gaussian of 0.6 px.
fn blur(image: &mut Image<f32>) {
    let taps = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|x: f64| (-0.5 * (x / 0.6).powi(2)).exp() as f32);
    let sum: f32 = taps.iter().sum();
    for (step, n) in [(1, image.width), (image.width, image.height)] {
        let source = image.pixels.clone();
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let place = i / step % n;
            if place >= 2 && place + 2 < n {
                *pixel = taps.iter().enumerate().map(|(k, t)| t / sum * source[i + k * step - 2 * step]).sum();
            }
        }
    }
}

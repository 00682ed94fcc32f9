//! The station's hardware as built: where lenses and lamps are, how bright they are, what the sensor makes of light.
//! In: a scale. Out: the setup that scenes are lit and seen with. Camera frame: x right, y down, z out of the lens; mm.
//! Not here: vehicles; what devices do in time.
//!
//! Lenses, and how they stand to each other, are those of the independent renderer's station (formats.md §3); lamps
//! are placed where that station's are mirrored in the coat.

use super::lamp::Lamp;
use crate::geometry::{Pose, rotation_from_rows};
use crate::hal::Sensor;
use crate::optics::{Lens, Pixel, Rig};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::sync::OnceLock;
use std::time::Duration;

type V = Vector3<f64>;

/// A station.
#[derive(Debug)]
pub struct Setup {
    /// Camera and projector as they really are; what a calibration says of them may differ.
    pub rig: Rig,
    /// The camera's sensor at 8 or 10 bits.
    pub sensor: Sensor,
    /// Blur of the camera's lens, px, 1 sigma; a pixel's own width comes on top.
    pub blur_px: f64,
    /// Exponent of what the projector makes of a picture that is meant to be linear.
    pub gamma: f64,
    /// Blur of the projector's lens, projector px, 1 sigma, at `focus_mm` and per mm away from there.
    pub defocus: (f64, f64),
    /// Distance at which the projector is in focus, mm.
    pub focus_mm: f64,
    pub(super) bars: [Lamp; 2],
    pub(super) tubes: [Lamp; 2],
    /// Luminance of the bars at full drive, of the tubes, and of the hall, cd/m².
    pub(super) bar_luminance: f64,
    pub(super) tube_luminance: f64,
    pub(super) room_luminance: f64,
    /// Luminous intensity of the projector's lens for white, cd.
    pub(super) projector_candela: f64,
    /// Most samples a side of a pixel across an edge.
    pub(super) samples: usize,
    rays: OnceLock<Vec<[f32; 2]>>,
}

/// Where vehicles stand: the features' middle this far from the camera, mm.
pub const DISTANCE_MM: f64 = 750.0;
/// Light on the body from both bars at full drive, lx. The published method found its window at 144 to 248 lx.
const FULL_LUX: f64 = 330.0;
/// The bars stand this far to either side of the camera, mm: so far that no pose within the station's limits mirrors one
/// on a feature.
pub const BARS_MM: f64 = 1050.0;
/// Electrons per ms and cd/m²: white paint under 200 lx gives a mean grey in 2 ms. It is the same for either size of
/// pixel: the lens of the smaller image is stopped down.
pub(super) const SENSITIVITY: f64 = 32.0;
/// Light that the projector lets through where it shows black, as a share of white.
pub(super) const PROJECTOR_BLACK: f64 = 0.025;
/// One line of the sensor; exposures are whole lines.
pub const LINE: Duration = Duration::from_micros(15);
/// The longest exposure: nearly an image's time at 25/s.
pub const LONGEST: Duration = Duration::from_millis(39);
/// The sensor's gain goes up to this, in sixteenths.
pub const MAX_GAIN: f64 = 4.0;

impl Setup {
    /// The station with a camera image of 2592×1944 times `scale`, which is 1, 1/2 or 1/4, at 8 or 10 bits.
    pub fn new(scale: f64, bits: u8) -> Self {
        let full = Lens {
            width: 2592,
            height: 1944,
            fx: 2703.6,
            fy: 2702.1,
            cx: 1303.4,
            cy: 962.7,
            distortion: [-0.0853, 0.1042, 0.000_43, -0.000_31, -0.0215],
        };
        let camera = if scale == 1.0 { full } else { full.binned(1.0 / scale) };
        let projector =
            Lens { width: 1280, height: 800, fx: 1052.0, fy: 1053.2, cx: 633.7, cy: 391.4, distortion: [0.0; 5] };
        let rows = [
            [0.959513633718, 0.00715536991347, -0.281571282966],
            [-0.00991243979811, 0.999915851617, -0.00836858540476],
            [0.281487708874, 0.0108208301821, 0.959503819371],
        ];
        let r = rotation_from_rows(rows).expect("a rotation, by its making");
        let projector_from_camera = Pose::new(r, V::new(213.000087, -11.6672489, 77.8288401));
        let white_level = if bits == 8 { 255 } else { 1023 };
        let levels = f64::from(white_level) / 255.0;
        let sensor = Sensor {
            width: camera.width,
            height: camera.height,
            bits,
            black_level: 2.0 * levels,
            white_level,
            dn_per_electron: f64::from(white_level) / 8000.0,
            read_noise_e: 6.0,
            serial: "SIM".into(),
        };
        let target = V::new(0.0, 20.0, DISTANCE_MM);
        let tube = |centre, along| Lamp::new(centre, along, target, [620.0, 35.0]);
        let (bars, bar_luminance) = bars_at(BARS_MM);
        Self {
            rig: Rig { camera, projector, projector_from_camera },
            sensor,
            blur_px: 0.38,
            gamma: 1.02,
            defocus: (0.55, 0.004),
            focus_mm: 760.0,
            bars,
            tubes: [
                tube(V::new(760.0, -1900.0, -1200.0), V::new(1.0, 0.24, 0.0)),
                tube(V::new(-1600.0, -2120.0, -1200.0), V::new(1.0, -0.15, 0.0)),
            ],
            bar_luminance,
            tube_luminance: 1100.0,
            room_luminance: 8.0,
            projector_candela: 205.0,
            samples: 4,
            rays: OnceLock::new(),
        }
    }

    /// Moves the bars `mm` to either side of the camera, with more light the farther they are.
    pub fn place_bars(&mut self, mm: f64) {
        (self.bars, self.bar_luminance) = bars_at(mm);
    }

    /// For red images only, of which many are wanted: no projector, and edges sampled twice a side of a pixel instead of
    /// four times.
    pub fn red_only(self) -> Self {
        Self { projector_candela: 0.0, samples: 2, ..self }
    }

    /// Light from the bars on a body at the usual distance, facing the camera, lx.
    pub fn lux(&self, drive: [f64; 2]) -> f64 {
        let at = V::new(0.0, 20.0, DISTANCE_MM);
        let lit = |bar: &Lamp, drive: f64| drive * self.bar_luminance * bar.illuminance(&at, &-V::z());
        lit(&self.bars[0], drive[0]) + lit(&self.bars[1], drive[1])
    }

    /// Light of tubes and hall on a body at the usual distance, facing the camera, lx.
    pub fn hall_lux(&self) -> f64 {
        let at = V::new(0.0, 20.0, DISTANCE_MM);
        let tubes: f64 = self.tubes.iter().map(|t| self.tube_luminance * t.illuminance(&at, &-V::z())).sum();
        tubes + std::f64::consts::PI * self.room_luminance
    }

    /// Undistorted normalised coordinates of every pixel's centre, row by row. The lens is unfolded all over its image.
    pub(super) fn rays(&self) -> &[[f32; 2]] {
        self.rays.get_or_init(|| {
            let lens = &self.rig.camera;
            let mut rays = vec![[0.0; 2]; lens.width * lens.height];
            rays.par_chunks_mut(lens.width).enumerate().for_each(|(y, row)| {
                let mut near = lens.undistort(&Pixel::new(0.0, y as f64)).expect("a lens that does not fold");
                for (x, ray) in row.iter_mut().enumerate() {
                    near = lens.undistort_near(&Pixel::new(x as f64, y as f64), &near).expect("the neighbour's did");
                    *ray = [near.x as f32, near.y as f32];
                }
            });
            rays
        })
    }

    /// The exposure that the sensor takes where `wanted` is asked for: whole lines, within its range.
    pub fn exposure(&self, wanted: Duration) -> Duration {
        let lines = (wanted.as_nanos() + LINE.as_nanos() / 2) / LINE.as_nanos();
        let most = LONGEST.as_nanos() / LINE.as_nanos();
        LINE * u32::try_from(lines.clamp(1, most)).expect("a few thousand")
    }
}

/// Bars to either side, and the luminance that gives [`FULL_LUX`].
fn bars_at(mm: f64) -> ([Lamp; 2], f64) {
    let target = V::new(0.0, 20.0, DISTANCE_MM);
    let bars = [-mm, mm].map(|x| Lamp::new(V::new(x, 20.0, 0.0), V::y(), target, [350.0, 30.0]));
    let per_luminance: f64 = bars.iter().map(|b| b.illuminance(&target, &-V::z())).sum();
    (bars, FULL_LUX / per_luminance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_reach_the_published_window_and_exposures_are_whole_lines() {
        let setup = Setup::new(0.25, 8);
        assert!((setup.lux([1.0, 1.0]) - FULL_LUX).abs() < 1e-6);
        assert!((setup.lux([1.0, 0.0]) / FULL_LUX - 0.5).abs() < 0.01);
        assert!((144.0..248.0).contains(&setup.lux([0.6, 0.6])));
        assert!((20.0..500.0).contains(&setup.hall_lux()), "{} lx", setup.hall_lux());
        assert_eq!(setup.exposure(Duration::from_micros(100)), LINE * 7);
        assert_eq!(setup.exposure(Duration::ZERO), LINE);
        assert_eq!(setup.exposure(Duration::from_secs(1)), LONGEST);
    }

    #[test]
    fn every_pixel_has_its_ray() {
        let setup = Setup::new(0.25, 8);
        let lens = &setup.rig.camera;
        let (x, y) = (600, 30);
        let [u, v] = setup.rays()[y * lens.width + x].map(f64::from);
        let back = lens.project(&V::new(u, v, 1.0)).expect("in front");
        assert!((back - Pixel::new(x as f64, y as f64)).amax() < 1e-4);
    }
}

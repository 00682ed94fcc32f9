//! VERIFY: a board is put before the station's devices, and the calibration holds or is belied.

#[allow(dead_code, reason = "each test uses its part")]
#[path = "common/station.rs"]
mod bench;
#[allow(dead_code, reason = "each test uses its part")]
#[path = "common/board.rs"]
mod board;

use bench::{Bench, jobs};
use board::{Met, RAYS, meet_all, place};
use datum::Code;
use datum::calibrate::Board;
use datum::hal::{Camera, Error, Exposure, Projector, Sensor};
use datum::image::Image;
use datum::plc::{Order, OrderKind, Report, State};
use datum::sim::{Random, Script};
use datum::station::{ArtefactKeys, SimulationKeys, StationFile};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const PRINTED: &str = "chessboard:11x8:35";

/// What the projector holds and shows.
#[derive(Default)]
struct Shown {
    pictures: Vec<Image<u8>>,
    shown: Option<usize>,
    /// A board stands before the station: what each ray of light within a pixel meets.
    board: Option<Vec<Met>>,
}

/// The simulated projector, seen by whoever renders the board.
struct Watched<P>(P, Arc<Mutex<Shown>>);

impl<P: Projector> Projector for Watched<P> {
    fn check(&mut self) -> Result<(), Error> {
        self.0.check()
    }
    fn size(&self) -> (usize, usize) {
        self.0.size()
    }
    fn load(&mut self, pictures: &[Image<u8>]) -> Result<(), Error> {
        let mut shown = self.1.lock().expect("no panic");
        (shown.pictures, shown.shown) = (pictures.to_vec(), None);
        self.0.load(pictures)
    }
    fn show(&mut self, picture: Option<usize>) -> Result<(), Error> {
        self.1.lock().expect("no panic").shown = picture;
        self.0.show(picture)
    }
}

/// The simulated camera, which sees the board while there is one.
struct Facing<C> {
    camera: C,
    sees: Arc<Mutex<Shown>>,
    random: Random,
}

impl<C: Camera> Camera for Facing<C> {
    fn check(&mut self) -> Result<(), Error> {
        self.camera.check()
    }
    fn sensor(&self) -> &Sensor {
        self.camera.sensor()
    }
    fn set_exposure(&mut self, wanted: Duration) -> Result<Duration, Error> {
        self.camera.set_exposure(wanted)
    }
    fn set_gain(&mut self, wanted: f64) -> Result<f64, Error> {
        self.camera.set_gain(wanted)
    }
    fn grab(&mut self, timeout: Duration, image: &mut Image<u16>) -> Result<Exposure, Error> {
        let exposure = self.camera.grab(timeout, image)?;
        let Shown { pictures, shown, board: Some(rays) } = &*self.sees.lock().expect("no panic") else {
            return Ok(exposure);
        };
        let picture = shown.map(|k| &pictures[k]);
        let light = |lit: &Option<(f32, f32)>| {
            let (Some(picture), Some((x, y))) = (picture, *lit) else { return 0.02 };
            // between the centres of the projector's pixels
            let (x, y) = (x.clamp(0.0, picture.width as f32 - 1.001), y.clamp(0.0, picture.height as f32 - 1.001));
            let (i, j, s, t) = (x as usize, y as usize, x.fract(), y.fract());
            let at = |i: usize, j: usize| f32::from(picture.at(i.min(picture.width - 1), j.min(picture.height - 1)));
            let level = (1.0 - t) * ((1.0 - s) * at(i, j) + s * at(i + 1, j))
                + t * ((1.0 - s) * at(i, j + 1) + s * at(i + 1, j + 1));
            0.02 + f64::from(level) / 255.0
        };
        let electrons = 2e6 * exposure.time.as_secs_f64() * exposure.gain;
        for (pixel, rays) in image.pixels.iter_mut().zip(rays.chunks_exact(RAYS * RAYS)) {
            let mean =
                rays.iter().map(|(albedo, lit)| f64::from(*albedo) * light(lit)).sum::<f64>() / rays.len() as f64;
            let e = electrons * mean;
            let noise = (e + 36.0).sqrt() * gauss(&mut self.random);
            *pixel = (2.0 + 0.032 * (e + noise)).round().clamp(0.0, 255.0) as u16;
        }
        Ok(exposure)
    }
}

/// The sum of four uniform numbers of variance 1/12, scaled: Gaussian enough for sensor noise.
fn gauss(random: &mut Random) -> f64 {
    (0..4).map(|_| random.uniform() - 0.5).sum::<f64>() * 3f64.sqrt()
}

/// A station whose configuration says that `board` is its artefact, before which the printed one is put.
fn verified(board: &str) -> (Bench, Vec<Report>) {
    let sees = Arc::new(Mutex::new(Shown::default()));
    let artefact = ArtefactKeys {
        board: board.into(),
        position_mm: None,
        angles_deg: [0.0; 3],
        shift_mm: 1.0,
        tilt_deg: 0.1,
        scale_percent: 0.1,
        every_h: 0.0,
    };
    let config = StationFile {
        simulation: SimulationKeys { scale: 0.25, seed: 3 },
        artefact: Some(artefact),
        ..StationFile::default()
    };
    let mut rig = None;
    let mut bench = Bench::with(
        config,
        Script::default(),
        jobs(),
        |simulated, hardware| {
            rig = Some(simulated.calibration().rig);
            let (camera, projector) = (simulated.station.camera(), simulated.station.projector());
            hardware.camera = Box::new(Facing { camera, sees: Arc::clone(&sees), random: Random::new(8, &[]) });
            hardware.projector = Box::new(Watched(projector, Arc::clone(&sees)));
        },
        None,
    );
    assert_eq!(bench.status.state, State::Ready);
    let (printed, rig): (Board, _) = (PRINTED.parse().expect("a board"), rig.expect("it was built"));
    let pose = place(&printed, [10.0, -10.0, 760.0], [9.0, -7.0, 2.0]);
    sees.lock().expect("no panic").board = Some(meet_all(&rig, &printed, &pose));
    let told = bench.order(Order::Verify);
    assert!(!bench.lit());
    (bench, told)
}

#[test]
fn a_board_as_printed_verifies_the_calibration() {
    let (bench, told) = verified(PRINTED);
    assert!(told.contains(&Report::Done(OrderKind::Verify)), "{told:?}");
    let v = bench.status.verification.expect("it was measured");
    assert!(v.scale_error.abs() < 5e-4, "{v:?}");
    assert!(bench.status.counters.verify_ok == 1 && bench.status.calibration_valid);
}

#[test]
fn a_board_of_other_lengths_belies_it_until_a_good_one_is_shown() {
    let (bench, told) = verified("chessboard:11x8:35.2");
    let refused = Report::Refused { order: OrderKind::Verify, code: Code::VerifyScale, detail: 0 };
    assert!(told.contains(&refused), "{told:?}");
    // 35 where 35.2 should be
    let v = bench.status.verification.expect("it was measured");
    assert!((v.scale_error.abs() - 0.2 / 35.2).abs() < 5e-4, "{v:?}");
    assert!(bench.status.not_ready.calibration && !bench.status.calibration_valid);
    assert_eq!(bench.status.counters.verify_failed, 1);
}

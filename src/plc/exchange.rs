//! What passes between the PLC's side and the station's: orders one way, reports the other.
//! In: nothing. Out: plain values in the station's units; what is not known is `None`.
//! Not here: registers and bits, when an order may be given (the handshake), how it is carried out (the station).

use crate::code::Code;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// A vehicle identification number: 17 characters, or fewer.
pub type Vin = heapless::String<17>;

/// Orders that may wait for the station; a full queue is code 113. The handshake allows one at a time, and an abort and
/// stand-by beside it; the rest is slack for a station that is slow to look.
pub const ORDERS: usize = 8;

/// What the PLC wants done. Every order but [`Order::StandBy`] and [`Order::Own`] ends in one [`Report::Done`], [`Report::Refused`] or
/// [`Report::Finished`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Order {
    /// Measure the vehicle that stands there. Ends in [`Report::Finished`], or [`Report::Refused`] before it began.
    Measure(Trigger),
    /// Make this job the active one.
    LoadJob {
        /// 1 to 999.
        job: u16,
        /// 0: not checked.
        model_code: u16,
    },
    /// Measure the reference artefact.
    Verify,
    /// End what is going on; lights off.
    Abort,
    /// Forget a latched error; after a fault, test again.
    ClearError,
    /// Lights and projector off, and nothing is measured, until it is false again.
    StandBy(bool),
    /// A PLC has become the owner, or there is none any more: while there is one, the station begins no cycle by itself,
    /// unless it is configured to (`trigger = "presence"`).
    Own(bool),
}

/// Which kind of order a report answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "as in Order")]
pub enum OrderKind {
    Measure,
    LoadJob,
    Verify,
    Abort,
    ClearError,
}

/// One vehicle to be measured.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Trigger {
    /// The PLC's own number, not 0; 0: the station's own cycle (presence, free run).
    pub id: u32,
    /// The vehicle model; 0: the active one.
    pub job: u16,
    /// 0: not checked.
    pub model_code: u16,
    /// As the PLC wrote it.
    pub vin: Vin,
    /// Keep the raw images, whatever the verdict.
    pub keep_images: bool,
}

/// What the station tells, in the order in which it happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    /// How it is; replaces the one before.
    Status(Box<Status>),
    /// A cycle that the station began by itself.
    Began(Trigger),
    /// The last image is there, the lights are off: the vehicle may move.
    Acquired,
    /// A cycle's end: its result. Lights and projector are off.
    Finished(Box<Outcome>),
    /// An order that has no result was carried out.
    Done(OrderKind),
    /// An order was not carried out.
    Refused {
        /// Which.
        order: OrderKind,
        /// Why.
        code: Code,
        /// Feature number, channel …; 0 if there is nothing to tell.
        detail: u16,
    },
    /// Something went wrong that latches ERROR: its code and detail. A new one each time, even of the same code.
    Error(Code, u16),
}

/// What the station is doing; the numbers are those of the register STATE. "Wait for acknowledgement" is the handshake's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u16)]
#[expect(missing_docs, reason = "the names say it")]
pub enum State {
    #[default]
    Boot = 0,
    SelfTest = 1,
    WarmUp = 2,
    Ready = 3,
    Acquiring = 4,
    Processing = 5,
    WaitAck = 6,
    JobLoad = 7,
    Verify = 8,
    Service = 9,
    Fault = 10,
    Updating = 11,
}

/// Why the station cannot measure; each is a bit of NOT_READY_REASON. PLC heartbeat and pending acknowledgement are the
/// handshake's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub struct NotReady {
    pub not_warm: bool,
    pub calibration: bool,
    pub no_job: bool,
    pub camera: bool,
    pub projector: bool,
    pub light: bool,
    pub service: bool,
    pub storage: bool,
    pub temperature: bool,
    pub clock: bool,
}

/// How the station is, at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// What it is doing.
    pub state: State,
    /// Why it cannot measure; all false: it can.
    pub not_ready: NotReady,
    /// Something is amiss, but measuring goes on: storage full, verification due, calibration's health.
    pub warning: Option<Code>,
    /// The calibration is there and holds.
    pub calibration_valid: bool,
    /// Camera and projector are warm.
    pub warm: bool,
    /// The artefact should be measured.
    pub verify_due: bool,
    /// The devices are simulated.
    pub simulated: bool,
    /// A presence sensor is fitted: a trigger without a vehicle is refused with 116.
    pub presence_fitted: bool,
    /// Live.
    pub vehicle_present: bool,
    /// Live.
    pub bars_on: bool,
    /// Live.
    pub projector_on: bool,
    /// The vehicle model in use; 0: none.
    pub active_job: u16,
    /// CRC-32 of the released model; 0: none.
    pub job_fingerprint: u32,
    /// °C.
    pub camera_celsius: Option<f64>,
    /// °C.
    pub projector_celsius: Option<f64>,
    /// °C.
    pub computer_celsius: Option<f64>,
    /// Of the storage, 0 to 1.
    pub disk_free: Option<f64>,
    /// How long each bar has been on, hours: left, right.
    pub light_hours: [f64; 2],
    /// Since the artefact was last measured.
    pub verified_ago: Option<Duration>,
    /// What that said.
    pub verification: Option<Verification>,
    /// Since the beginning of the records.
    pub counters: Counters,
}

/// What the last measurement of the artefact said.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verification {
    /// Scale less 1.
    pub scale_error: f64,
    /// How far the artefact's frame seems shifted, mm.
    pub shift_mm: f64,
    /// And tilted, degrees.
    pub tilt_deg: f64,
}

/// What the station has done so far. Heartbeat losses and rejected triggers are the handshake's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub struct Counters {
    pub triggers: u32,
    pub results: u32,
    pub ok: u32,
    pub out_of_limits: u32,
    pub too_uncertain: u32,
    pub not_measurable: u32,
    pub aborted: u32,
    pub camera_reconnects: u32,
    pub verify_ok: u32,
    pub verify_failed: u32,
    pub boots: u32,
    pub uptime_s: u32,
    pub median_cycle_ms: u32,
    pub p95_cycle_ms: u32,
}

/// What a cycle came to; the numbers are those of RESULT_CODE.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum ResultCode {
    /// Measured, certain, inside the limits.
    Ok = 1,
    /// Measured, outside the station's limits.
    OutOfLimits = 2,
    /// Measured, too uncertain.
    TooUncertain = 3,
    /// Not measurable; there is no pose.
    NotMeasurable = 4,
    /// Ended by the PLC or by a fault; there is no pose.
    Aborted = 5,
}

/// A cycle's result. `None` reads as the register's invalid value.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// What it came to.
    pub result: ResultCode,
    /// Why, if it is not ok; and its detail.
    pub code: Option<Code>,
    /// Feature number …; 0 if there is nothing to tell.
    pub detail: u16,
    /// Echo.
    pub trigger: Trigger,
    /// The job that was measured.
    pub job: u16,
    /// There is one for the results ok, out of limits and too uncertain only.
    pub pose: Option<PoseOutcome>,
    /// Feature 1 to 4: corner 1, corner 2, cap, wheel arch; `None`: the model has none.
    pub features: [Option<FeatureOutcome>; 4],
    /// Largest deviation of a distance between features, mm.
    pub distance_deviation_mm: Option<f64>,
    /// Point pose against dense pose, mm.
    pub surface_vs_point_mm: Option<f64>,
    /// Valid pixels in the regions, 0 to 1.
    pub depth_coverage: Option<f64>,
    /// Epipolar residual, px.
    pub calibration_health_px: Option<f64>,
    /// Drives of the bars, 0 to 1: left, right.
    pub light: Option<[f64; 2]>,
    /// Mean grey of the ambient image in the regions, of 255.
    pub ambient: Option<f64>,
    /// °C.
    pub camera_celsius: Option<f64>,
    /// °C.
    pub projector_celsius: Option<f64>,
    /// From the order to the last image.
    pub acquisition: Option<Duration>,
    /// From the order to the result.
    pub total: Option<Duration>,
    /// Of the first exposure, since 1970.
    pub taken_at_ms: u64,
    /// Key of the stored record; 0: none.
    pub record: u64,
}

/// The vehicle's pose with its uncertainty, as the registers state it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseOutcome {
    /// The model's reference point, station frame, less its taught position while the station frame is the taught one; mm.
    pub position_mm: [f64; 3],
    /// Roll, pitch, yaw (ISO 8855), degrees.
    pub angles_deg: [f64; 3],
    /// k = 2, of the reference point.
    pub u_position_mm: [f64; 3],
    /// k = 2: roll, pitch, yaw.
    pub u_angles_deg: [f64; 3],
    /// k = 2, at the worst target; `None`: the model has no targets.
    pub u_target_mm: Option<f64>,
    /// Of the fit.
    pub residual_rms_mm: f64,
}

/// One feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureOutcome {
    /// Why it was not used; `None`: it was.
    pub code: Option<Code>,
    /// Station frame, mm.
    pub position_mm: Option<[f64; 3]>,
    /// mm.
    pub residual_mm: Option<f64>,
    /// 0 to 1.
    pub score: Option<f64>,
}

/// What does not change while the service runs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Of the appliance.
    pub serial: String,
    /// Of datum.
    pub version: String,
    /// CRC of the program.
    pub software_fingerprint: u16,
    /// Of the camera.
    pub camera_serial: String,
    /// Of the projector.
    pub projector_serial: String,
    /// CRC-32 of the calibration file; 0: none.
    pub calibration_fingerprint: u32,
    /// yyyymmdd; 0: not known.
    pub calibration_date: u32,
}

/// The station thread's sign of life.
#[derive(Debug, Default)]
pub struct Pulse(AtomicU64);

impl Pulse {
    /// The station is alive.
    pub fn beat(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// How often it has been; another number than before means that it lives.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

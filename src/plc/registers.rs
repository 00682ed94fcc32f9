//! The register table, declared once. In: the handshake. Out: names, addresses, types, sentences, and how each register
//! is read; the server's images, the pages and the tests all come from here.
//! Not here: when a value changes (the handshake), how requests are answered (the server).

use super::bits::{Bit, control, not_ready, sensors, status, when};
use super::exchange::{FeatureOutcome, Outcome, PoseOutcome, ResultCode};
use super::handshake::Handshake;
use super::words::{self, count, signed16, signed32};
use crate::code::Code;
use std::borrow::Cow;
use std::ops::Range;

/// Counts up only when a register moves.
pub const MAP_MAJOR: u16 = 1;
/// Counts up when a register is added.
pub const MAP_MINOR: u16 = 0;

/// Input registers that exist, in blocks; gaps inside a block read 0.
pub(super) const INPUT: [Range<u16>; 4] = [0..120, 200..240, 300..360, 400..440];
/// Holding registers from 0 on: the command block.
pub(super) const HOLDING: u16 = 64;
/// Holding registers that mirror input registers 0 to 119.
pub(super) const MIRROR: Range<u16> = 1000..1120;
/// Coils (the bits of CONTROL) and discrete inputs (those of STATUS).
pub(super) const BITS: u16 = 16;

pub(super) const CONTROL: u16 = 0;
pub(super) const PLC_HEARTBEAT: u16 = 1;
pub(super) const TRIGGER_ID: u16 = 2;
pub(super) const JOB_REQ: u16 = 4;
pub(super) const MODEL_CODE: u16 = 5;
pub(super) const COLOUR: u16 = 6;
pub(super) const OPTIONS: u16 = 7;
pub(super) const VIN: u16 = 8;
/// From here to the end of the command block all is reserved.
pub(super) const RESERVED: u16 = 17;
/// The block that RESULT_CRC16 covers.
pub(super) const CRC_BLOCK: Range<u16> = 12..109;
pub(super) const RESULT_CRC16: u16 = 118;

/// How a register is read, which is its type too. `None` reads as the type's invalid value. The number is the
/// register's place among the names of its row.
#[derive(Clone, Copy)]
pub(super) enum Read {
    U16(fn(&Handshake, usize) -> Option<u16>),
    I16(fn(&Handshake, usize) -> Option<i16>),
    U32(fn(&Handshake, usize) -> Option<u32>),
    I32(fn(&Handshake, usize) -> Option<i32>),
    U64(fn(&Handshake, usize) -> Option<u64>),
    F32(fn(&Handshake, usize) -> f32),
    /// So many words of ASCII.
    Text(u16, fn(&Handshake) -> Cow<'_, str>),
}

impl Read {
    /// Its words.
    pub(super) fn words(self) -> u16 {
        match self {
            Self::U16(_) | Self::I16(_) => 1,
            Self::U32(_) | Self::I32(_) | Self::F32(_) => 2,
            Self::U64(_) => 4,
            Self::Text(words, _) => words,
        }
    }

    /// Its type, as on the page.
    pub(super) fn type_name(self) -> String {
        match self {
            Self::U16(_) => "u16".into(),
            Self::I16(_) => "i16".into(),
            Self::U32(_) => "u32".into(),
            Self::I32(_) => "i32".into(),
            Self::U64(_) => "u64".into(),
            Self::F32(_) => "f32".into(),
            Self::Text(words, _) => format!("ASCII {}", 2 * words),
        }
    }

    /// What it reads, in words.
    pub(super) fn value(self, h: &Handshake, place: usize) -> Vec<u16> {
        let order = h.config.word_order;
        match self {
            Self::U16(f) => vec![f(h, place).unwrap_or(u16::MAX)],
            Self::I16(f) => vec![f(h, place).unwrap_or(i16::MIN).cast_unsigned()],
            Self::U32(f) => order.of_u32(f(h, place).unwrap_or(u32::MAX)).to_vec(),
            Self::I32(f) => order.of_u32(f(h, place).unwrap_or(i32::MIN).cast_unsigned()).to_vec(),
            Self::U64(f) => order.of_u64(f(h, place).unwrap_or(0)).to_vec(),
            Self::F32(f) => order.of_u32(f(h, place).to_bits()).to_vec(),
            Self::Text(words, f) => words::of_text(&f(h), usize::from(words)),
        }
    }
}

/// One row: registers of one type side by side.
pub(super) struct Row {
    /// Of the first.
    pub(super) address: u16,
    pub(super) names: &'static [&'static str],
    pub(super) read: Read,
    pub(super) doc: &'static str,
    /// Its bits, if it is made of bits.
    pub(super) bits: &'static [Bit],
}

impl Row {
    const fn new(address: u16, names: &'static [&'static str], read: Read, doc: &'static str) -> Self {
        Self { address, names, read, doc, bits: &[] }
    }

    const fn with(self, bits: &'static [Bit]) -> Self {
        Self { bits, ..self }
    }

    /// Address, name and place of each of its registers.
    pub(super) fn each(&self) -> impl Iterator<Item = (u16, &'static str, usize)> + '_ {
        let words = self.read.words();
        (self.address..).step_by(usize::from(words)).zip(self.names).enumerate().map(|(i, (a, n))| (a, *n, i))
    }

    /// The addresses it fills.
    #[cfg(test)]
    pub(super) fn span(&self) -> Range<u16> {
        self.address..self.address + self.read.words() * self.names.len() as u16
    }
}

use Read::{F32, I16, I32, Text, U16, U32, U64};

/// The command block: holding registers, PLC to appliance.
pub(super) const COMMAND: &[Row] = &[
    Row::new(CONTROL, &["CONTROL"], U16(|h, _| written(h, CONTROL)), "Commands; b8 to 15 are 0.").with(control::BITS),
    Row::new(
        PLC_HEARTBEAT,
        &["PLC_HEARTBEAT"],
        U16(|h, _| written(h, PLC_HEARTBEAT)),
        "Any change, at least every 3 s.",
    ),
    Row::new(TRIGGER_ID, &["TRIGGER_ID"], U32(|h, _| Some(h.trigger_id())), "Not 0, new for each vehicle."),
    Row::new(JOB_REQ, &["JOB_REQ"], U16(|h, _| written(h, JOB_REQ)), "1 to 999: the vehicle model; 0: the active one."),
    Row::new(MODEL_CODE, &["MODEL_CODE"], U16(|h, _| written(h, MODEL_CODE)), "Checked against the job; 0: no check."),
    Row::new(COLOUR, &["RESERVED_6"], U16(|h, _| written(h, COLOUR)), "Reserved, 0."),
    Row::new(
        OPTIONS,
        &["OPTIONS"],
        U16(|h, _| written(h, OPTIONS)),
        "b3: keep the raw images; the others are reserved, 0.",
    ),
    Row::new(VIN, &["VIN"], Text(9, |h| h.vin().to_string().into()), "17 characters and NUL."),
];

/// Status and result: input registers, appliance to PLC.
pub(super) const STATUS: &[Row] = &[
    Row::new(0, &["STATUS"], U16(|h, _| Some(h.status_bits())), "What is.").with(status::BITS),
    Row::new(
        1,
        &["DEVICE_HEARTBEAT"],
        U16(|h, _| Some(h.heartbeat)),
        "Counts up every 200 ms while the station lives.",
    ),
    Row::new(
        2,
        &["STATE"],
        U16(|h, _| Some(h.state() as u16)),
        "0 boot, 1 self-test, 2 warm-up, 3 ready, 4 acquiring, 5 processing, 6 wait-ack, 7 job-load, 8 verify, \
         9 service, 10 fault, 11 updating.",
    ),
    Row::new(3, &["NOT_READY_REASON"], U16(|h, _| Some(h.not_ready_reason())), "Why not ready.").with(not_ready::BITS),
    Row::new(4, &["ERROR_CODE"], U16(|h, _| Some(h.error.map_or(0, |e| e.0.number()))), "0: none; see the codes."),
    Row::new(5, &["ERROR_DETAIL"], U16(|h, _| Some(h.error.map_or(0, |e| e.1))), "Feature number, channel …"),
    Row::new(6, &["ERROR_SEQ"], U32(|h, _| Some(h.error_seq)), "Counts up: the same error twice is seen."),
    Row::new(8, &["ACTIVE_JOB"], U16(|h, _| Some(h.status.active_job)), "0: none."),
    Row::new(
        9,
        &["JOB_FINGERPRINT"],
        U32(|h, _| Some(h.status.job_fingerprint)),
        "CRC-32 of the released vehicle model.",
    ),
    Row::new(11, &["SW_FINGERPRINT"], U16(|h, _| Some(h.identity.software_fingerprint)), "CRC of the program."),
    Row::new(12, &["RESULT_SEQ_HEAD"], U16(|h, _| Some(h.result_seq)), "+1 per published result, skipping 0."),
    Row::new(13, &["TRIGGER_ID_ECHO"], U32(|h, _| Some(h.shown.id)), "Of the vehicle this result is of."),
    Row::new(
        15,
        &["RESULT_CODE"],
        U16(|h, _| Some(h.shown.outcome.as_ref().map_or(0, |o| o.result as u16))),
        "0 none, 1 ok, 2 out of the station's limits, 3 too uncertain, 4 not measurable, 5 aborted.",
    ),
    Row::new(
        16,
        &["FEATURE_MASK"],
        U16(|h, _| Some((0..4).map(|i| when(feature(h, i).is_some_and(|f| f.code.is_none()), 1 << i)).sum())),
        "Used in the fit: b0 corner 1, b1 corner 2, b2 cap, b3 wheel arch.",
    ),
    Row::new(
        17,
        &["X", "Y", "Z"],
        I32(|h, i| signed32(pose(h)?.position_mm[i], 1e-3)),
        "µm, the model's reference point in the station frame, less its taught position while station = \"taught\".",
    ),
    Row::new(23, &["ROLL", "PITCH", "YAW"], I32(|h, i| signed32(pose(h)?.angles_deg[i], 1e-6)), "µdeg, ISO 8855."),
    Row::new(
        29,
        &["U_X", "U_Y", "U_Z"],
        U16(|h, i| count(pose(h)?.u_position_mm[i], 1e-3)),
        "k = 2, µm at the reference point; 65534: larger.",
    ),
    Row::new(32, &["U_ROLL", "U_PITCH", "U_YAW"], U16(|h, i| count(pose(h)?.u_angles_deg[i], 1e-4)), "k = 2, 0.0001°."),
    Row::new(
        35,
        &["U_MAX_TARGET"],
        U16(|h, _| count(pose(h)?.u_target_mm?, 1e-3)),
        "k = 2, µm, the worst of the model's targets.",
    ),
    Row::new(36, &["RMS_RESIDUAL"], U16(|h, _| count(pose(h)?.residual_rms_mm, 1e-3)), "µm."),
    Row::new(
        37,
        &["MAX_DISTANCE_DEV"],
        U16(|h, _| count(outcome(h)?.distance_deviation_mm?, 1e-3)),
        "µm, measured against nominal distance between points.",
    ),
    Row::new(
        38,
        &["SURFACE_VS_POINT"],
        U16(|h, _| count(outcome(h)?.surface_vs_point_mm?, 1e-3)),
        "µm between the pose from points and that from surfaces.",
    ),
    Row::new(39, &["MIN_SCORE"], U16(|h, _| min_score(outcome(h)?)), "×1000, of the features used."),
    Row::new(
        40,
        &["DEPTH_COVERAGE"],
        U16(|h, _| count(outcome(h)?.depth_coverage?, 1e-3)),
        "‰ of valid pixels in the regions.",
    ),
    Row::new(
        41,
        &["CAL_HEALTH"],
        U16(|h, _| count(outcome(h)?.calibration_health_px?, 1e-3)),
        "0.001 px, epipolar residual.",
    ),
    Row::new(42, &["LIGHT_L", "LIGHT_R"], U16(|h, i| count(outcome(h)?.light?[i], 1e-3)), "‰ of drive."),
    Row::new(
        44,
        &["AMBIENT"],
        U16(|h, _| count(outcome(h)?.ambient?, 0.1)),
        "0.1 grey level (of 255) of the ambient image in the regions.",
    ),
    Row::new(
        45,
        &["T_CAMERA", "T_PROJECTOR"],
        I16(|h, i| outcome(h).and_then(|o| signed16([o.camera_celsius, o.projector_celsius][i]?, 0.1))),
        "0.1 °C.",
    ),
    Row::new(
        47,
        &["T_ACQ", "T_TOTAL"],
        U16(|h, i| outcome(h).and_then(|o| count([o.acquisition, o.total][i]?.as_secs_f64(), 1e-3))),
        "ms from the order to the last image, and to the result.",
    ),
    Row::new(49, &["VERIFY_AGE"], U16(|h, _| count(h.shown.verified_ago?.as_secs_f64(), 60.0)), "min."),
    Row::new(
        50,
        &[
            "FEATURE_1_X",
            "FEATURE_1_Y",
            "FEATURE_1_Z",
            "FEATURE_2_X",
            "FEATURE_2_Y",
            "FEATURE_2_Z",
            "FEATURE_3_X",
            "FEATURE_3_Y",
            "FEATURE_3_Z",
            "FEATURE_4_X",
            "FEATURE_4_Y",
            "FEATURE_4_Z",
        ],
        I32(|h, i| signed32(feature(h, i / 3)?.position_mm?[i % 3], 1e-3)),
        "µm, station frame.",
    ),
    Row::new(
        74,
        &["FEATURE_1_RESIDUAL", "FEATURE_2_RESIDUAL", "FEATURE_3_RESIDUAL", "FEATURE_4_RESIDUAL"],
        U16(|h, i| count(feature(h, i)?.residual_mm?, 1e-3)),
        "µm.",
    ),
    Row::new(
        78,
        &["FEATURE_1_SCORE", "FEATURE_2_SCORE", "FEATURE_3_SCORE", "FEATURE_4_SCORE"],
        U16(|h, i| count(feature(h, i)?.score?, 1e-3)),
        "×1000.",
    ),
    Row::new(
        82,
        &["FEATURE_1_STATUS", "FEATURE_2_STATUS", "FEATURE_3_STATUS", "FEATURE_4_STATUS"],
        U16(|h, i| Some(feature(h, i)?.code.map_or(0, Code::number))),
        "0: ok; else why it was not used; 65535: the model has none.",
    ),
    Row::new(86, &["VIN_ECHO"], Text(9, |h| h.shown.vin.as_str().into()), "17 characters and NUL."),
    Row::new(95, &["TIME_UTC_MS"], U64(|h, _| Some(outcome(h)?.taken_at_ms)), "ms since 1970 of the first exposure."),
    Row::new(99, &["RECORD_ID"], U64(|h, _| Some(outcome(h)?.record)), "Key of the stored record."),
    Row::new(103, &["RESERVED_103", "RESERVED_105", "RESERVED_107"], I32(|_, _| None), "Reserved, invalid."),
    Row::new(
        109,
        &["SENSORS"],
        U16(|h, _| {
            let s = &h.status;
            let (present, bars) = (when(s.vehicle_present, sensors::PRESENT), when(s.bars_on, sensors::BARS));
            Some(present | bars | when(s.projector_on, sensors::PROJECTOR))
        }),
        "Live, not frozen.",
    )
    .with(sensors::BITS),
    Row::new(
        RESULT_CRC16,
        &["RESULT_CRC16"],
        U16(|_, _| Some(0)),
        "CRC-16/MODBUS over registers 12 to 108 as read, each high byte first.",
    ),
    Row::new(119, &["RESULT_SEQ_TAIL"], U16(|h, _| Some(h.result_seq)), "Equals the head unless the read was torn."),
    Row::new(
        200,
        &[
            "TRIGGERS",
            "RESULTS",
            "OK",
            "OUT_OF_LIMITS",
            "TOO_UNCERTAIN",
            "NOT_MEASURABLE",
            "ABORTED",
            "REJECTED_TRIGGERS",
            "PLC_HEARTBEAT_LOSSES",
            "CAMERA_RECONNECTS",
            "VERIFY_OK",
            "VERIFY_FAILED",
            "BOOTS",
            "UPTIME_S",
            "MEDIAN_CYCLE_MS",
            "P95_CYCLE_MS",
        ],
        U32(|h, i| {
            let c = &h.status.counters;
            let before = [c.triggers, c.results, c.ok, c.out_of_limits, c.too_uncertain, c.not_measurable, c.aborted];
            let own = [h.rejected_triggers, h.heartbeat_losses];
            let after = [
                c.camera_reconnects,
                c.verify_ok,
                c.verify_failed,
                c.boots,
                c.uptime_s,
                c.median_cycle_ms,
                c.p95_cycle_ms,
            ];
            before.into_iter().chain(own).chain(after).nth(i)
        }),
        "Counters; rejected triggers and heartbeat losses since the service began, uptime in s, cycles in ms.",
    ),
    Row::new(300, &["MAGIC"], U16(|_, _| Some(0x5643)), "0x5643."),
    Row::new(301, &["MAP_MAJOR"], U16(|_, _| Some(MAP_MAJOR)), "Changes only when a register moves."),
    Row::new(302, &["MAP_MINOR"], U16(|_, _| Some(MAP_MINOR)), "Changes when a register is added."),
    Row::new(303, &["TEST_U16"], U16(|_, _| Some(0x1234)), "Test block: 0x1234."),
    Row::new(304, &["TEST_HEX"], I32(|_, _| Some(0x0102_0304)), "Test block: 0x01020304."),
    Row::new(306, &["TEST_NEGATIVE"], I32(|_, _| Some(-123_456)), "Test block: −123456."),
    Row::new(308, &["TEST_FLOAT"], F32(|_, _| 123.456), "Test block: 123.456."),
    Row::new(310, &["TEST_TEXT"], Text(2, |_| "ABCD".into()), "Test block: \"ABCD\"."),
    Row::new(312, &["SERIAL"], Text(8, |h| h.identity.serial.as_str().into()), "Of the appliance."),
    Row::new(320, &["SW_VERSION"], Text(8, |h| h.identity.version.as_str().into()), "Of datum."),
    Row::new(328, &["CAMERA_SERIAL"], Text(8, |h| h.identity.camera_serial.as_str().into()), "Of the camera."),
    Row::new(336, &["PROJECTOR_SERIAL"], Text(8, |h| h.identity.projector_serial.as_str().into()), "Of the projector."),
    Row::new(
        344,
        &["CAL_FINGERPRINT", "CAL_DATE"],
        U32(|h, i| Some([h.identity.calibration_fingerprint, h.identity.calibration_date][i])),
        "CRC-32 of the calibration file; its date, yyyymmdd.",
    ),
    Row::new(
        400,
        &["T_CPU", "T_CAMERA_LIVE", "T_PROJECTOR_LIVE"],
        I16(|h, i| {
            let s = &h.status;
            signed16([s.computer_celsius, s.camera_celsius, s.projector_celsius][i]?, 0.1)
        }),
        "0.1 °C, live.",
    ),
    Row::new(403, &["DISK_FREE"], U16(|h, _| count(h.status.disk_free?, 1e-3)), "‰."),
    Row::new(404, &["LIGHT_HOURS_L", "LIGHT_HOURS_R"], U16(|h, i| count(h.status.light_hours[i], 1.0)), "h."),
    Row::new(
        406,
        &["VERIFY_SCALE"],
        I16(|h, _| signed16(h.status.verification?.scale_error, 1e-5)),
        "Last verification: scale error, 0.001 %.",
    ),
    Row::new(
        407,
        &["VERIFY_SHIFT"],
        U16(|h, _| count(h.status.verification?.shift_mm, 1e-3)),
        "Last verification: shift, µm.",
    ),
    Row::new(
        408,
        &["VERIFY_TILT"],
        U16(|h, _| count(h.status.verification?.tilt_deg, 1e-3)),
        "Last verification: tilt, 0.001°.",
    ),
];

fn written(h: &Handshake, address: u16) -> Option<u16> {
    Some(h.holding[usize::from(address)])
}

fn outcome(h: &Handshake) -> Option<&Outcome> {
    h.shown.outcome.as_ref()
}

/// The pose, where there may be one.
fn pose(h: &Handshake) -> Option<&PoseOutcome> {
    use ResultCode::{Ok, OutOfLimits, TooUncertain};
    outcome(h).filter(|o| matches!(o.result, Ok | OutOfLimits | TooUncertain))?.pose.as_ref()
}

fn feature(h: &Handshake, number: usize) -> Option<&FeatureOutcome> {
    outcome(h)?.features[number].as_ref()
}

fn min_score(outcome: &Outcome) -> Option<u16> {
    let used = outcome.features.iter().flatten().filter(|f| f.code.is_none());
    count(used.filter_map(|f| f.score).reduce(f64::min)?, 1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plc::exchange::{Identity, Order, Report, State, Status, Trigger};
    use crate::plc::handshake::{Event, Settings, good};
    use crate::plc::snapshot::Snapshot;
    use crate::plc::words::WordOrder;
    use std::time::Duration;

    fn handshake(word_order: WordOrder) -> Handshake {
        let settings = Settings { heartbeat_timeout: Duration::from_secs(3), presence: false, word_order };
        let identity = Identity {
            serial: "SN-1".into(),
            version: "0.1.0".into(),
            software_fingerprint: 0xBEEF,
            calibration_fingerprint: 0x1234_5678,
            calibration_date: 20_261_124,
            ..Identity::default()
        };
        Handshake::new(settings, identity)
    }

    #[test]
    fn registers_lie_in_order_without_overlap_inside_their_blocks_with_a_name_and_a_sentence() {
        for (rows, blocks) in [(COMMAND, vec![(0, HOLDING)]), (STATUS, INPUT.map(|b| (b.start, b.end)).to_vec())] {
            assert!(rows.windows(2).all(|r| r[0].span().end <= r[1].address));
            for row in rows {
                let span = row.span();
                assert!(blocks.iter().any(|(start, end)| *start <= span.start && span.end <= *end), "{:?}", row.names);
                assert!(!row.names.is_empty() && row.doc.ends_with(['.', '…']), "{:?}", row.names);
            }
        }
        let mut names: Vec<_> = COMMAND.iter().chain(STATUS).flat_map(|r| r.names).collect();
        let all = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), all);
        assert_eq!(COMMAND.last().map(|r| r.span().end), Some(RESERVED));
    }

    #[test]
    fn the_status_and_result_block_has_no_holes_but_the_reserved_one() {
        let filled: Vec<u16> = STATUS.iter().flat_map(Row::span).filter(|a| *a < 120).collect();
        assert_eq!(filled, (0..110).chain(118..120).collect::<Vec<_>>());
    }

    #[test]
    fn every_register_fills_its_words() {
        let h = handshake(WordOrder::HighFirst);
        for row in COMMAND.iter().chain(STATUS) {
            for (_, name, place) in row.each() {
                assert_eq!(row.read.value(&h, place).len(), usize::from(row.read.words()), "{name}");
            }
        }
    }

    #[test]
    fn the_command_block_reads_as_it_was_written() {
        for order in [WordOrder::HighFirst, WordOrder::LowFirst] {
            let mut h = handshake(order);
            let mut words = vec![1, 2, 3, 4, 5, 6, 0, 8];
            words.extend(words::of_text("WBA00000000000005", 9));
            h.step(Duration::ZERO, Event::Write { client: 1, address: 0, words: &words });
            let read =
                COMMAND.iter().flat_map(|r| r.each().flat_map(|(_, _, i)| r.read.value(&h, i)).collect::<Vec<_>>());
            assert_eq!(read.collect::<Vec<_>>(), words);
        }
    }

    /// Input 0 to 119 of a good result of vehicle 0x00010005, written out by hand from the contract. Frozen: when this
    /// fails, fix the code.
    #[rustfmt::skip]
    const WIRE: [u16; 120] = [
        // STATUS: ack, acquired, valid, pass, owner, calibration, warm; heartbeat; state wait-ack; reason: ack pending
        0x1C3A, 0x0000, 0x0006, 0x0100,
        // no error, no detail, sequence 0; job 7, its fingerprint; the program's
        0x0000, 0x0000, 0x0000, 0x0000, 0x0007, 0xCAFE, 0xF00D, 0xBEEF,
        // head 1; id; code 1; mask: corners and cap
        0x0001, 0x0001, 0x0005, 0x0001, 0x0007,
        // 1.000, -2.500, 1000.001 mm
        0x0000, 0x03E8, 0xFFFF, 0xF63C, 0x000F, 0x4241,
        // 0.1, -0.2, 0.000003 degrees
        0x0001, 0x86A0, 0xFFFC, 0xF2C0, 0x0000, 0x0003,
        // 50, 60 µm, larger; 100, 200, 300 · 0.0001 degrees; no targets; 40 µm
        0x0032, 0x003C, 0xFFFE, 0x0064, 0x00C8, 0x012C, 0xFFFF, 0x0028,
        // 100 µm; none; 0.9; 987 ‰; 0.033 px; 500, 600 ‰; 12.3
        0x0064, 0xFFFF, 0x0384, 0x03DB, 0x0021, 0x01F4, 0x0258, 0x007B,
        // 31.3, -4.0 °C; 900, 1400 ms; verified 3 min ago
        0x0139, 0xFFD8, 0x0384, 0x0578, 0x0003,
        // features at 1, 10, 100 mm; -2 mm; 3.5 mm; and none
        0x0000, 0x03E8, 0xFFFF, 0xF830, 0x0000, 0x0DAC,
        0x0000, 0x2710, 0xFFFF, 0xF830, 0x0000, 0x0DAC,
        0x0001, 0x86A0, 0xFFFF, 0xF830, 0x0000, 0x0DAC,
        0x8000, 0x0000, 0x8000, 0x0000, 0x8000, 0x0000,
        // residuals 50 µm, scores 0.9, status ok; none
        0x0032, 0x0032, 0x0032, 0xFFFF, 0x0384, 0x0384, 0x0384, 0xFFFF, 0x0000, 0x0000, 0x0000, 0xFFFF,
        // "WBA00000000000005"
        0x5742, 0x4130, 0x3030, 0x3030, 0x3030, 0x3030, 0x3030, 0x3030, 0x3500,
        // time; record 42; reserved
        0x0000, 0x0193, 0x5A5A, 0x1234, 0x0000, 0x0000, 0x0000, 0x002A,
        0x8000, 0x0000, 0x8000, 0x0000, 0x8000, 0x0000,
        // vehicle present; reserved; CRC; tail 1
        0x0001, 0, 0, 0, 0, 0, 0, 0, 0, CRC, 0x0001,
    ];
    /// Computed bit by bit by another program.
    const CRC: u16 = 0xE9AC;

    #[test]
    fn the_wire_is_what_was_written_out_by_hand() {
        let mut h = handshake(WordOrder::HighFirst);
        let status = Status {
            state: State::Ready,
            calibration_valid: true,
            warm: true,
            vehicle_present: true,
            active_job: 7,
            job_fingerprint: 0xCAFE_F00D,
            verified_ago: Some(Duration::from_secs(170)),
            ..Status::default()
        };
        h.step(Duration::ZERO, Event::Report(Report::Status(Box::new(status))));
        let mut words = [0; 17];
        (words[0], words[2], words[3]) = (control::ENABLE, 1, 5);
        words[8..].copy_from_slice(&words::of_text("WBA00000000000005", 9));
        h.step(Duration::ZERO, Event::Write { client: 1, address: 0, words: &words });
        let control = [control::ENABLE | control::TRIGGER];
        let step = h.step(Duration::ZERO, Event::Write { client: 1, address: 0, words: &control });
        let [Order::Measure(trigger)] = &step.orders[..] else { panic!("{step:?}") };
        assert_eq!(*trigger, Trigger { id: 0x0001_0005, vin: trigger.vin.clone(), ..Trigger::default() });
        h.step(Duration::ZERO, Event::Report(Report::Finished(Box::new(good(trigger)))));
        let snapshot = Snapshot::new(&h);
        assert_eq!(snapshot.input(0, 120).expect("the block"), WIRE);
        assert_eq!(snapshot.holding(1000, 120).expect("its mirror"), WIRE);
    }

    #[test]
    fn the_test_block_shows_a_wrong_word_order() {
        let block = |order| Snapshot::new(&handshake(order)).input(300, 12).expect("the block").to_vec();
        assert_eq!(
            block(WordOrder::HighFirst),
            [0x5643, 1, 0, 0x1234, 0x0102, 0x0304, 0xFFFE, 0x1DC0, 0x42F6, 0xE979, 0x4142, 0x4344]
        );
        assert_eq!(
            block(WordOrder::LowFirst),
            [0x5643, 1, 0, 0x1234, 0x0304, 0x0102, 0x1DC0, 0xFFFE, 0xE979, 0x42F6, 0x4142, 0x4344]
        );
    }

    #[test]
    fn only_what_lies_within_a_block_can_be_read() {
        let s = Snapshot::new(&handshake(WordOrder::HighFirst));
        for (address, quantity, there) in [
            (0, 120, true),
            (0, 121, false),
            (119, 1, true),
            (120, 1, false),
            (199, 2, false),
            (200, 40, true),
            (240, 1, false),
            (300, 60, true),
            (400, 40, true),
            (439, 2, false),
            (440, 1, false),
            (65535, 2, false),
        ] {
            assert_eq!(s.input(address, quantity).is_ok(), there, "{address} {quantity}");
        }
        for (address, quantity, there) in [
            (0, 64, true),
            (63, 2, false),
            (64, 1, false),
            (999, 2, false),
            (1000, 120, true),
            (1119, 2, false),
            (65535, 1, false),
        ] {
            assert_eq!(s.holding(address, quantity).is_ok(), there, "{address} {quantity}");
        }
        assert!(s.coils(0, 16).is_ok() && s.coils(8, 9).is_err() && s.discrete_inputs(16, 1).is_err());
        assert_eq!(s.input(348, 12).expect("a gap"), [0; 12]);
    }
}

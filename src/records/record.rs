//! One record: what it holds, and its bytes.
//! In:  an [`Event`]. Out: a payload that later versions read, and back. Not here: framing, files, ids.
//!
//! A payload is its version, one byte, then postcard. The order of fields and variants below *is* version 1: what is
//! to change gets a version of its own, and version 1's structs stay to be read. A test holds frozen bytes.

use crate::plc::ResultCode;
use serde::{Deserialize, Serialize};

/// The version that is written.
const VERSION: u8 = 1;

/// A record, as read back.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Its key: not 0, greater than any before.
    pub id: u64,
    /// When it happened, ms since 1970; a vehicle: its first exposure.
    pub at_ms: u64,
    /// The program's version that wrote it.
    pub software: String,
    /// What happened.
    pub event: Event,
    /// The station's totals, this record included.
    pub totals: Totals,
}

/// What a record tells of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Event {
    /// A vehicle's result.
    Vehicle(Box<Vehicle>),
    /// The service began.
    Boot(Boot),
    /// The artefact was measured.
    Verification(Verification),
    /// Something went wrong outside of any vehicle's result.
    Alarm(Alarm),
}

/// A vehicle's result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vehicle {
    /// The PLC's own number; 0: the station's own cycle.
    pub trigger_id: u32,
    /// Vehicle identification number, as the PLC wrote it; may be empty.
    pub vin: String,
    /// The vehicle model.
    pub job: u16,
    /// CRC-32 of the released model; 0: none.
    pub job_fingerprint: u32,
    /// CRC-32 of the calibration file; 0: none.
    pub calibration_fingerprint: u32,
    /// What it came to.
    pub verdict: Verdict,
    /// Why, a number of the PLC's error table; 0: ok.
    pub code: u16,
    /// Feature number …; 0: nothing to tell.
    pub detail: u16,
    /// The same in a sentence; empty if ok.
    pub sentence: String,
    /// The object of `measure --json`, as text; none if measuring was not come to.
    pub measurement: Option<String>,
    /// How many captures were taken.
    pub captures: u8,
    /// Drives of the bars, 0 to 1: left, right.
    pub light: Option<[f64; 2]>,
    /// Mean grey of the ambient image in the regions, of 255.
    pub ambient: Option<f64>,
    /// °C.
    pub camera_celsius: Option<f64>,
    /// °C.
    pub projector_celsius: Option<f64>,
    /// From the order to the last image.
    pub acquisition_ms: Option<u32>,
    /// From the order to the result.
    pub total_ms: Option<u32>,
    /// The raw images were to be kept, as the capture named for this record's id. They may be gone from the ring since.
    pub images: bool,
}

/// The service began.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Boot {
    /// How the run before ended, or what is notable about this one; empty: nothing.
    pub sentence: String,
}

/// What measuring the artefact said.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verification {
    /// When, ms since 1970.
    pub at_ms: u64,
    /// It is as it should be.
    pub ok: bool,
    /// A number of the PLC's error table; 0: ok.
    pub code: u16,
    /// The same in a sentence.
    pub sentence: String,
    /// Scale less 1; this and the next are none if the artefact was not measured.
    pub scale_error: Option<f64>,
    /// How far the artefact's frame seems shifted, mm.
    pub shift_mm: Option<f64>,
    /// And tilted, degrees.
    pub tilt_deg: Option<f64>,
}

/// Something went wrong.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// A number of the PLC's error table.
    pub code: u16,
    /// Channel …; 0: nothing to tell.
    pub detail: u16,
    /// What happened.
    pub sentence: String,
}

/// What a vehicle came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Measured, certain, inside the limits.
    Ok,
    /// Measured, outside the station's limits.
    OutOfLimits,
    /// Measured, too uncertain.
    TooUncertain,
    /// Refused.
    NotMeasurable,
    /// Ended by the PLC or by a fault.
    Aborted,
}

impl Verdict {
    /// As in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::OutOfLimits => "out-of-limits",
            Self::TooUncertain => "too-uncertain",
            Self::NotMeasurable => "not-measurable",
            Self::Aborted => "aborted",
        }
    }
}

impl From<ResultCode> for Verdict {
    fn from(result: ResultCode) -> Self {
        match result {
            ResultCode::Ok => Self::Ok,
            ResultCode::OutOfLimits => Self::OutOfLimits,
            ResultCode::TooUncertain => Self::TooUncertain,
            ResultCode::NotMeasurable => Self::NotMeasurable,
            ResultCode::Aborted => Self::Aborted,
        }
    }
}

/// What the station has done since the beginning of its records, and what else must survive a restart. Every record
/// carries them, so that the last whole one is all a start has to read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the names say it, as in the PLC's counters")]
pub struct Totals {
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
    /// How long each bar has been on, s: left, right.
    pub light_s: [u64; 2],
    /// The last verification.
    pub verified: Option<Verification>,
}

impl Totals {
    /// Adds what was counted `since`.
    pub(super) fn add(&mut self, since: &Self) {
        for (n, more) in [
            (&mut self.triggers, since.triggers),
            (&mut self.results, since.results),
            (&mut self.ok, since.ok),
            (&mut self.out_of_limits, since.out_of_limits),
            (&mut self.too_uncertain, since.too_uncertain),
            (&mut self.not_measurable, since.not_measurable),
            (&mut self.aborted, since.aborted),
            (&mut self.camera_reconnects, since.camera_reconnects),
            (&mut self.verify_ok, since.verify_ok),
            (&mut self.verify_failed, since.verify_failed),
            (&mut self.boots, since.boots),
        ] {
            *n = n.wrapping_add(more);
        }
        for (s, more) in self.light_s.iter_mut().zip(since.light_s) {
            *s = s.wrapping_add(more);
        }
        if since.verified.is_some() {
            self.verified.clone_from(&since.verified);
        }
    }

    /// Counts `event` in. Triggers, reconnections and light are the station's to count.
    pub(super) fn count(&mut self, event: &Event) {
        let up = |n: &mut u32| *n = n.wrapping_add(1);
        match event {
            Event::Vehicle(v) => {
                up(&mut self.results);
                up(match v.verdict {
                    Verdict::Ok => &mut self.ok,
                    Verdict::OutOfLimits => &mut self.out_of_limits,
                    Verdict::TooUncertain => &mut self.too_uncertain,
                    Verdict::NotMeasurable => &mut self.not_measurable,
                    Verdict::Aborted => &mut self.aborted,
                });
            }
            Event::Boot(_) => up(&mut self.boots),
            Event::Verification(v) => {
                up(if v.ok { &mut self.verify_ok } else { &mut self.verify_failed });
                self.verified = Some(v.clone());
            }
            Event::Alarm(_) => {}
        }
    }
}

/// All of version 1's record but its id, which the frame has.
#[derive(Serialize)]
struct Written<'a> {
    at_ms: u64,
    software: &'a str,
    event: &'a Event,
    totals: &'a Totals,
}

#[derive(Deserialize)]
struct Read {
    at_ms: u64,
    software: String,
    event: Event,
    totals: Totals,
}

/// The payload of a record of this program.
pub(super) fn encode(at_ms: u64, event: &Event, totals: &Totals) -> Vec<u8> {
    let written = Written { at_ms, software: env!("CARGO_PKG_VERSION"), event, totals };
    postcard::to_extend(&written, vec![VERSION]).expect("plain data always serialises")
}

/// The record with this id; none if a later version wrote it.
pub(super) fn decode(id: u64, payload: &[u8]) -> Option<Record> {
    let (version, content) = payload.split_first()?;
    let (read, rest): (Read, _) = if *version == VERSION { postcard::take_from_bytes(content).ok()? } else { None? };
    let Read { at_ms, software, event, totals } = read;
    rest.is_empty().then_some(Record { id, at_ms, software, event, totals })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Written by version 0.1.0; every later version must read it as it is.
    const FROZEN: &str = "\
        01fb908280a13405302e312e30\
        00f0a2041157444154554d30303030303030303034320ceffdb6f50d0102dc04032354686520756e6365727461696e747920\
        69732061626f766520746865206c696d69742e010f7b2263617074757265223a2261227d0201000000000000e03f00000000\
        0000e43f00010000000000c044400001fe08018a0a01\
        ad02ac02a2020000000000000000a01fa11f0180bcd9f29e3400bf052b54686520766572696669636174696f6e206661696c\
        65643a206c656e67746873206172652077726f6e672e01fca9f1d24d62403f01000000000000d03f00";

    fn frozen() -> (Event, Totals) {
        let vehicle = Vehicle {
            trigger_id: 70_000,
            vin: "WDATUM00000000042".into(),
            job: 12,
            job_fingerprint: 0xDEAD_BEEF,
            calibration_fingerprint: 1,
            verdict: Verdict::TooUncertain,
            code: 604,
            detail: 3,
            sentence: "The uncertainty is above the limit.".into(),
            measurement: Some("{\"capture\":\"a\"}".into()),
            captures: 2,
            light: Some([0.5, 0.625]),
            ambient: None,
            camera_celsius: Some(41.5),
            projector_celsius: None,
            acquisition_ms: Some(1150),
            total_ms: Some(1290),
            images: true,
        };
        let verified = Verification {
            at_ms: 1_795_000_000_000,
            ok: false,
            code: 703,
            sentence: "The verification failed: lengths are wrong.".into(),
            scale_error: Some(0.0005),
            shift_mm: Some(0.25),
            tilt_deg: None,
        };
        let totals = Totals { triggers: 301, results: 300, ok: 290, light_s: [4000, 4001], ..Totals::default() };
        (Event::Vehicle(Box::new(vehicle)), Totals { verified: Some(verified), ..totals })
    }

    fn hex(bytes: &[u8]) -> String {
        bytes.iter().map(|b| format!("{b:02x}")).collect()
    }

    #[test]
    fn the_bytes_of_version_1_are_frozen() {
        let (event, totals) = frozen();
        let bytes: Vec<u8> = (0..FROZEN.len() / 2)
            .map(|k| u8::from_str_radix(&FROZEN[2 * k..2 * k + 2], 16).expect("hexadecimal"))
            .collect();
        let read = decode(7, &bytes).expect("version 1 is read for ever");
        let software = "0.1.0".to_owned();
        assert_eq!(
            read,
            Record { id: 7, at_ms: 1_795_564_800_123, software, event: event.clone(), totals: totals.clone() }
        );
        if env!("CARGO_PKG_VERSION") == "0.1.0" {
            assert_eq!(hex(&encode(1_795_564_800_123, &event, &totals)), FROZEN);
        }
    }

    #[test]
    fn the_kinds_of_records_have_numbers_that_stay() {
        let kinds = [
            frozen().0,
            Event::Boot(Boot::default()),
            Event::Verification(Verification::default()),
            Event::Alarm(Alarm::default()),
        ];
        for (n, event) in (0..).zip(&kinds) {
            let bytes = encode(0, event, &Totals::default());
            let at = 1 + 1 + 1 + env!("CARGO_PKG_VERSION").len(); // version, at_ms = 0, length and text of `software`
            assert_eq!((bytes[0], bytes[at]), (1, n), "{event:?}");
            assert_eq!(decode(1, &bytes).expect("just written").event, *event);
        }
    }

    #[test]
    fn what_a_later_version_wrote_is_no_record_here() {
        let (event, totals) = frozen();
        let bytes = encode(0, &event, &totals);
        assert!(decode(1, &[&[2], &bytes[1..]].concat()).is_none());
        assert!(decode(1, &[&bytes[..], &[0]].concat()).is_none(), "a field that this version does not know");
        assert!(decode(1, &bytes[..bytes.len() - 1]).is_none());
        assert!(decode(1, &[]).is_none());
    }
}

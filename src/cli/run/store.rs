//! The station's results in the records. In: what a cycle came to, its images. Out: records and kept captures.
//! Not here: how either is stored.

use crate::Calibration;
use crate::plc::{Counters, Outcome};
use crate::records::{
    Alarm, Boot, Captures, Event, Fault, Limits, Policy, Recorder, Reference, Totals, Vehicle, Verdict, Verification,
};
use crate::station::{Finished, Job, Note, RecordsKeys, Store, WriteImages};
use crate::{Code, document, time};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// What light.toml in the records holds: how long the bars have been lit.
#[derive(Clone, Copy, Debug, Default, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
struct Light {
    format: u32,
    left_h: f64,
    right_h: f64,
}

/// Journal and ring of one station.
pub(super) struct Kept {
    recorder: Recorder,
    captures: Captures,
    calibration: Calibration,
    calibration_fingerprint: u32,
    policy: Policy,
    /// The file of the hours of light.
    light: PathBuf,
    /// Of the job that was kept last: models seldom change.
    reference: Option<(u32, Arc<Reference>)>,
}

impl Kept {
    /// Opens the records in `folder` and notes that the station has begun. `Err(Fault::Held)`: another service runs. Any
    /// other fault of the storage is told, and tried anew with every record.
    pub(super) fn open(
        folder: &Path,
        keys: &RecordsKeys,
        calibration: &Calibration,
        calibration_fingerprint: u32,
    ) -> Result<Self, Fault> {
        let limits = Limits::of_mib(u32::try_from(keys.journal_mib).unwrap_or(u32::MAX));
        let (recorder, opened) = Recorder::new(folder, limits, Recorder::PATIENCE);
        match opened {
            Err(held @ Fault::Held { .. }) => return Err(held),
            Err(fault) => tracing::warn!("{fault}"),
            Ok(recovery) => recovery.damage.iter().for_each(|d| tracing::warn!("{}: {d:?}", folder.display())),
        }
        let captures = Captures::new(folder, keys.captures_mib << 20, Captures::FLOOR);
        let mut kept = Self {
            recorder,
            captures,
            calibration: calibration.clone(),
            calibration_fingerprint,
            policy: Policy { nth_good: keys.keep_every },
            light: folder.join("light.toml"),
            reference: None,
        };
        let _ = kept.event(Event::Boot(Boot::default())); // told by the next result
        Ok(kept)
    }

    /// What was counted since the beginning of the records.
    pub(super) fn counters(&self) -> Counters {
        let Totals { triggers, results, ok, out_of_limits, too_uncertain, not_measurable, aborted, .. } =
            self.recorder.totals();
        let Totals { camera_reconnects, verify_ok, verify_failed, boots, .. } = self.recorder.totals();
        Counters {
            triggers,
            results,
            ok,
            out_of_limits,
            too_uncertain,
            not_measurable,
            aborted,
            camera_reconnects,
            verify_ok,
            verify_failed,
            boots,
            ..Counters::default()
        }
    }

    /// How long the bars had been lit when that was last kept, hours; 0 where nobody knows.
    pub(super) fn hours(&self) -> [f64; 2] {
        let read: Result<Light, _> = document::read(&self.light);
        read.map_or([0.0; 2], |l| [l.left_h, l.right_h].map(|h| if h.is_finite() { h.max(0.0) } else { 0.0 }))
    }

    fn event(&mut self, event: Event) -> Result<u64, Code> {
        self.event_at(time::unix_ms(), event)
    }

    fn event_at(&mut self, at_ms: u64, event: Event) -> Result<u64, Code> {
        self.recorder.append(at_ms, event).map_err(|fault| {
            tracing::warn!(code = fault.code().number(), "{fault}");
            fault.code()
        })
    }
}

impl Store for Kept {
    fn keeps(&self, outcome: &Outcome) -> bool {
        self.policy.keeps(outcome.result.into(), outcome.trigger.keep_images, &self.recorder.totals())
    }

    fn append(&mut self, finished: &Finished, job: &Job, images: bool) -> Result<u64, Code> {
        let o = &finished.outcome;
        let ms = |d: Option<Duration>| d.map(|d| u32::try_from(d.as_millis()).unwrap_or(u32::MAX));
        self.recorder.count().triggers += 1;
        let vehicle = Vehicle {
            trigger_id: o.trigger.id,
            vin: o.trigger.vin.to_string(),
            job: o.job,
            job_fingerprint: job.fingerprint,
            calibration_fingerprint: self.calibration_fingerprint,
            verdict: Verdict::from(o.result),
            code: o.code.map_or(0, Code::number),
            detail: o.detail,
            sentence: finished.said.clone(),
            measurement: finished.measurement.as_ref().map(|m| serde_json::to_string(m).expect("string keys only")),
            captures: u8::try_from(finished.tries).unwrap_or(u8::MAX),
            light: o.light,
            ambient: o.ambient,
            camera_celsius: o.camera_celsius,
            projector_celsius: o.projector_celsius,
            acquisition_ms: ms(o.acquisition),
            total_ms: ms(o.total),
            images,
        };
        self.event_at(o.taken_at_ms, Event::Vehicle(Box::new(vehicle)))
    }

    fn keep(&mut self, key: u64, job: &Job, images: WriteImages) -> Result<(), Code> {
        let known = self.reference.as_ref().filter(|(fingerprint, _)| *fingerprint == job.fingerprint);
        let reference = known.map(|(_, r)| Arc::clone(r)).unwrap_or_else(|| {
            let new = Reference::new(self.calibration.clone(), job.vehicle.clone(), job.templates.clone());
            Arc::new(new)
        });
        self.reference = Some((job.fingerprint, Arc::clone(&reference)));
        let before = self.captures.ring().fault;
        let taken = self.captures.keep(key, move |folder| {
            images(folder)?;
            reference.write(folder)?;
            Ok(())
        });
        if !taken {
            tracing::warn!(record = key, "its images are not kept: those before are still being written");
        }
        // images are written beside the next cycle: what is wrong with them is told late
        before.map_or(Ok(()), |fault| Err(fault.code()))
    }

    fn note(&mut self, note: Note) {
        let event = match note {
            Note::Alarm(code) => {
                Event::Alarm(Alarm { code: code.number(), sentence: code.entry().sentence.into(), ..Alarm::default() })
            }
            Note::Verification(found, said) => Event::Verification(Verification {
                at_ms: time::unix_ms(),
                ok: said.is_ok(),
                code: said.as_ref().err().map_or(0, |(code, _)| code.number()),
                sentence: said.err().map_or_else(String::new, |(_, sentence)| sentence),
                scale_error: found.map(|v| v.scale_error),
                shift_mm: found.map(|v| v.shift_mm),
                tilt_deg: found.map(|v| v.tilt_deg),
            }),
        };
        let _ = self.event(event); // logged; told by the next result
    }

    fn free(&self) -> Option<f64> {
        self.recorder.space().map(|space| space.share())
    }

    fn keep_hours(&mut self, hours: [f64; 2]) {
        let content = Light { format: document::FORMAT, left_h: hours[0], right_h: hours[1] };
        if let Err(e) = document::write(&self.light, &content) {
            tracing::warn!("{e}");
        }
    }
}

//! The codes that say why there is no measurement, or what is the matter: one table, from which messages, the
//! PLC page and the log all come. In: nothing. Out: number, short name, sentence and what to do.

use std::fmt;

macro_rules! codes {
    ($($variant:ident = $number:literal, $name:literal, $sentence:literal, $remedy:literal;)*) => {
        /// A code of the PLC's error table; its number never changes.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u16)]
        pub enum Code {
            $(#[doc = $sentence] $variant = $number,)*
        }

        /// Every code, by number.
        pub const CODES: &[Entry] = &[$(Entry {
            code: Code::$variant, number: $number, name: $name, sentence: $sentence, remedy: $remedy,
        },)*];
    };
}

/// One row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The code.
    pub code: Code,
    /// Its number on the wire, in the log and on the page.
    pub number: u16,
    /// A few words.
    pub name: &'static str,
    /// What happened.
    pub sentence: &'static str,
    /// What to do.
    pub remedy: &'static str,
}

codes! {
    TwoCommands = 101, "two command bits", "More than one command bit was set at once.", "Set one command bit at a time; see the ladder example.";
    ReservedBits = 103, "reserved bits", "A reserved bit or register was written with something other than 0.", "Write 0 to reserved bits and registers.";
    TriggerId = 104, "trigger id", "TRIGGER_ID is 0 or that of an acknowledged result.", "Give every vehicle a new TRIGGER_ID that is not 0.";
    UnknownJob = 105, "unknown job", "No vehicle model has the requested job number.", "Check JOB_REQ; load the vehicle model onto the station.";
    ModelMismatch = 106, "model code", "MODEL_CODE is not that of the job.", "Check which vehicle is in the station and which job the PLC asked for.";
    TriggerWhileAckPending = 111, "acknowledgement pending", "A trigger or command came before the last result was acknowledged.", "Set RESULT_ACK after reading a result.";
    JobWhileBusy = 112, "job change while busy", "A job change came during a measurement.", "Wait until BUSY is 0.";
    TriggerWhileBusy = 113, "busy", "A command came while another was being carried out.", "Wait until READY is 1.";
    TriggerInService = 114, "service mode", "A trigger came in service mode.", "End service mode on the station.";
    TriggerInWarmUp = 115, "warm-up", "A trigger came before camera and projector were warm.", "Wait until WARM is 1.";
    NoVehicle = 116, "no vehicle", "The presence sensor sees no vehicle.", "Check the vehicle's position and the sensor.";
    AckTimeout = 121, "acknowledgement time-out", "A result was not acknowledged in 10 s; it stays valid.", "Check that the PLC sets RESULT_ACK.";
    CommandNotDropped = 122, "command bit not dropped", "A command bit stayed at 1 for 10 s after its completion.", "Check that the PLC drops command bits.";
    HeartbeatLost = 123, "PLC heartbeat lost", "PLC_HEARTBEAT stopped changing.", "Check the PLC's program and the network.";
    CameraLost = 201, "camera lost", "The camera does not answer.", "Check the camera's cable and power.";
    ImageMissing = 202, "image missing", "An image was missing or late.", "Check the trigger line and the camera's cable.";
    ProjectorSilent = 203, "projector", "The projector does not respond.", "Check the projector's cable and power.";
    Synchronisation = 204, "synchronisation", "Camera and projector were out of step.", "Check the trigger line; run `datum doctor`.";
    LightFault = 210, "light fault", "A red light bar does not light as it should.", "Check the bar's cable and supply.";
    OverTemperature = 211, "over-temperature", "Camera, projector or computer is too hot.", "Check fans and filters; let the station cool.";
    TooDark = 301, "too dark", "The image is too dark where features are expected.", "Check the light bars, the lens cover and the exposure.";
    Saturated = 302, "saturated", "Too many pixels are saturated where features are expected.", "Check for glare and for light from outside; lower the exposure.";
    Ambient = 303, "ambient light", "Light from outside is too strong or flickers.", "Shade the station; check lamps nearby.";
    Moved = 304, "vehicle moved", "The vehicle moved while images were taken.", "Hold the vehicle still until ACQ_DONE.";
    Dirty = 305, "lens dirty", "The lens or its cover seems dirty.", "Clean the cover.";
    OutOfFocus = 306, "out of focus", "The image is out of focus.", "Check the distance of the vehicle and the lens's lock.";
    NotFound = 401, "feature not found", "A feature was not found.", "Check that the right vehicle model is loaded and nothing covers the feature.";
    Ambiguous = 402, "ambiguous", "A feature was found at more than one place.", "Look at the overlay; teach the feature more distinctly.";
    ScoreLow = 403, "score low", "A feature's match is too poor.", "Check for damage, dirt and glare at the feature; teach anew if the body has changed.";
    ContourIncomplete = 404, "contour incomplete", "Too little of a feature's contour was seen.", "Check that the flap is closed, that nothing covers the gap and that the bars light it.";
    Ellipse = 405, "ellipse implausible", "The cap's contour is no plausible ellipse.", "Check the flap; look at the overlay.";
    ArchHidden = 406, "wheel arch hidden", "The top of the wheel arch was not seen.", "Check the vehicle's position and what hangs in the arch.";
    CoverageLow = 501, "depth coverage low", "Too little depth was measured around a feature.", "Check the projector and for glare at the feature.";
    NotSmooth = 502, "patch not smooth", "The surface around a feature is not smooth.", "Check for dents, tape or dirt near the feature.";
    PhaseAmbiguity = 503, "phase ambiguity", "The fringes around a feature cannot be told apart.", "Check for double reflections and light from outside.";
    OutOfVolume = 504, "out of the measuring volume", "A feature lies outside the measuring volume.", "Check the vehicle's position.";
    TooFewFeatures = 601, "too few features", "Fewer than three features were measured.", "See the features' own codes.";
    Distances = 602, "distances", "The distances between features are not nominal.", "Check that the right vehicle model is loaded; check the body and the calibration.";
    Residual = 603, "residual", "The features do not fit the nominal points.", "Check that the right vehicle model is loaded; look at the overlay.";
    Uncertain = 604, "too uncertain", "The uncertainty is above the limit.", "See the features' scores and the depth coverage.";
    OutOfLimits = 605, "out of limits", "The vehicle stands outside the station's limits.", "Park the vehicle again.";
    DenseDisagrees = 606, "dense pose disagrees", "The pose from points and the pose from surfaces disagree.", "Look at the overlay; check the vehicle model.";
    CalibrationExpired = 701, "calibration expired", "The calibration is too old.", "Calibrate or verify the station.";
    CalibrationHealth = 702, "calibration health", "Camera and projector no longer stand to each other as calibrated.", "Verify the station; calibrate it if that fails.";
    VerifyScale = 703, "verification: scale", "The verification failed: lengths are wrong.", "Calibrate the station.";
    VerifyDatum = 704, "verification: datum", "The verification failed: the artefact seems to stand elsewhere.", "Check the artefact's seat; survey the datum anew.";
    HeadSwapped = 705, "head swapped", "The measuring head was swapped and has not been verified.", "Verify the station.";
    NotReleased = 801, "not released", "The vehicle model has not been released.", "Check the model and run `datum release`.";
    Fingerprint = 802, "fingerprint mismatch", "The vehicle model or a template has changed since its release.", "Restore the released files, or check the model and run `datum release`.";
    OtherVersion = 803, "other version", "The vehicle model was written for another major version.", "Teach the model with this version.";
    StorageFull = 901, "storage full", "The storage is full; measuring goes on without records.", "Export and delete old records.";
    StorageFault = 902, "storage fault", "The storage cannot be written.", "Replace the storage.";
    ClockNotSet = 903, "clock not set", "The clock is not set.", "Check the time server or set the clock.";
    RolledBack = 904, "rolled back", "The station started with its previous software after a failed update.", "See the log; repeat the update.";
    Watchdog = 905, "watchdog reset", "The watchdog restarted the station.", "See the log; report it.";
    Security = 906, "security", "A connection or file was refused for security.", "See the log.";
}

impl Code {
    /// Its number on the wire.
    pub fn number(self) -> u16 {
        self as u16
    }

    /// Its row of the table.
    pub fn entry(self) -> &'static Entry {
        CODES.iter().find(|e| e.code == self).expect("the table and the enum are one list")
    }

    /// The code with this number.
    pub fn from_number(number: u16) -> Option<Self> {
        CODES.iter().find(|e| e.number == number).map(|e| e.code)
    }
}

/// "401 feature not found".
impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} {}", self.number(), self.entry().name)
    }
}

impl serde::Serialize for Code {
    fn serialize<S: serde::Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_u16(self.number())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_sorted_complete_and_says_what_to_do() {
        let frozen = [
            101, 103, 104, 105, 106, 111, 112, 113, 114, 115, 116, 121, 122, 123, 201, 202, 203, 204, 210, 211, 301,
            302, 303, 304, 305, 306, 401, 402, 403, 404, 405, 406, 501, 502, 503, 504, 601, 602, 603, 604, 605, 606,
            701, 702, 703, 704, 705, 801, 802, 803, 901, 902, 903, 904, 905, 906,
        ];
        assert_eq!(CODES.iter().map(|e| e.number).collect::<Vec<_>>(), frozen);
        for e in CODES {
            assert!(!e.name.is_empty() && e.sentence.ends_with('.') && e.remedy.ends_with('.'), "{e:?}");
            assert_eq!((e.code.number(), Code::from_number(e.number)), (e.number, Some(e.code)));
        }
        assert_eq!(Code::NotFound.to_string(), "401 feature not found");
        assert_eq!(Code::from_number(0), None);
    }
}

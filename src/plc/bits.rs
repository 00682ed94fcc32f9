//! The bits of CONTROL, STATUS, NOT_READY_REASON and SENSORS, each declared once. In: nothing.
//! Out: masks for the handshake, names and sentences for the pages.
//! Not here: when a bit rises or falls.

/// One bit of a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bit {
    /// As on the page.
    pub(super) name: &'static str,
    /// A sentence.
    pub(super) doc: &'static str,
}

macro_rules! bits {
    ($($module:ident: $($name:ident $doc:literal)*;)*) => {$(
        pub(super) mod $module {
            #[allow(clippy::upper_case_acronyms, non_camel_case_types, reason = "names as on the page")]
            enum Position { $($name),* }
            $(pub(in crate::plc) const $name: u16 = 1 << Position::$name as u16;)*
            /// From bit 0 on.
            pub(in crate::plc) const BITS: &[super::Bit] = &[$(super::Bit { name: stringify!($name), doc: $doc }),*];
        }
    )*};
}

bits! {
    control:
        ENABLE "Level: owns the command block. Falling: a running cycle completes, nothing new starts."
        TRIGGER "Measures the vehicle that stands there."
        RESULT_ACK "The result has been read."
        JOB_LOAD "Makes JOB_REQ the active job."
        CLEAR_ERROR "Clears ERROR; after a fault the station tests itself again."
        VERIFY "Measures the reference artefact."
        ABORT "Ends what is going on, lights off."
        STANDBY "Level: lights and projector off, nothing is measured.";
    status:
        READY "A TRIGGER will be taken."
        TRIGGER_ACK "TRIGGER was taken; falls after TRIGGER."
        BUSY "A command is being carried out."
        ACQ_DONE "The vehicle may move; falls when READY returns."
        RESULT_VALID "The result registers hold a result, frozen until RESULT_ACK."
        PASS "RESULT_CODE is 1."
        CMD_DONE "The command was carried out; falls after its bit."
        CMD_REJECTED "The command was refused: ERROR_CODE says why; falls after its bit."
        ERROR "Latched until CLEAR_ERROR: ERROR_CODE says why."
        WARNING "Something is amiss, measuring goes on."
        OWNER_OK "A connection owns the command block."
        CAL_VALID "The calibration is there and holds."
        WARM "Camera and projector are warm."
        PLC_HB_OK "There is an owner and its PLC_HEARTBEAT changes."
        VERIFY_DUE "The reference artefact should be measured."
        SIMULATED "The devices are simulated.";
    not_ready:
        NOT_WARM "Not warm."
        CALIBRATION "No valid calibration."
        NO_JOB "No active job."
        CAMERA "Camera."
        PROJECTOR "Projector."
        LIGHT "Light bars."
        SERVICE "Service mode or stand-by."
        PLC_HEARTBEAT "The PLC's heartbeat was lost in this cycle."
        ACK_PENDING "A result waits for RESULT_ACK, or RESULT_ACK has not been dropped."
        STORAGE "Storage."
        TEMPERATURE "Temperature."
        CLOCK "Clock.";
    sensors:
        PRESENT "A vehicle is present."
        BARS "The light bars are on."
        PROJECTOR "The projector is on.";
}

/// `mask` where `condition` holds, else 0.
pub(super) fn when(condition: bool, mask: u16) -> u16 {
    if condition { mask } else { 0 }
}

/// The commands of which only one may be set at a time.
pub(super) const COMMANDS: u16 =
    control::TRIGGER | control::JOB_LOAD | control::CLEAR_ERROR | control::VERIFY | control::ABORT;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_lie_where_the_contract_says() {
        assert_eq!((control::ENABLE, control::RESULT_ACK, control::STANDBY), (1, 4, 0x80));
        assert_eq!((status::READY, status::RESULT_VALID, status::SIMULATED), (1, 0x10, 0x8000));
        assert_eq!((not_ready::CLOCK, sensors::PROJECTOR), (1 << 11, 4));
        assert_eq!(
            [control::BITS.len(), status::BITS.len(), not_ready::BITS.len(), sensors::BITS.len()],
            [8, 16, 12, 3]
        );
    }
}

//! When an image was complete, on the station's clock. In: libcamera's time stamps. Out: the same on the monotonic clock. Pure.
//!
//! libcamera documents SensorTimestamp as the exposure's begin in the first row, on CLOCK_BOOTTIME. Its pipelines hand on
//! what the driver stamped its buffer with: CLOCK_MONOTONIC, and the frame's first or last byte, which both come after
//! the exposure of a global shutter. So a stamp is taken for when the image was complete: the exposure began before it by
//! the exposure's time and a whole readout at most, and an image is never taken for a newer one.

use super::super::arrivals::Stamp;
use std::time::Duration;

/// No image is as old as this when it comes.
const OLD: Duration = Duration::from_secs(10);

/// `stamp`: ns, of the one clock or the other; 0: none. `monotonic`, `boot`: both clocks now. They differ by how long the
/// computer has slept, which an appliance never does. Where it has, a stamp from the monotonic clock's future is of the
/// other, one that would be older than any image is not; in between the older reading holds.
pub(super) fn complete(stamp: u64, monotonic: Duration, boot: Duration) -> Stamp {
    if stamp == 0 {
        return Stamp::Unknown;
    }
    let at = Duration::from_nanos(stamp);
    let slept = boot.saturating_sub(monotonic);
    let awake = at.saturating_sub(slept);
    let of_boot = at > monotonic || slept < OLD;
    Stamp::End(if of_boot { awake } else { at })
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn at(stamp_ms: u64, slept_ms: u64) -> Stamp {
        complete(stamp_ms * 1_000_000, ms(100_000), ms(100_000 + slept_ms))
    }

    #[test]
    fn both_clocks_are_one_where_the_computer_never_slept() {
        assert_eq!(at(99_950, 0), Stamp::End(ms(99_950)));
        assert_eq!(at(0, 0), Stamp::Unknown);
    }

    #[test]
    fn a_stamp_of_the_boot_clock_is_less_the_sleep() {
        assert_eq!(at(3_699_950, 3_600_000), Stamp::End(ms(99_950)));
        assert_eq!(at(100_450, 500), Stamp::End(ms(99_950)));
    }

    #[test]
    fn a_stamp_of_the_monotonic_clock_is_told_apart_after_a_long_sleep() {
        assert_eq!(at(99_950, 3_600_000), Stamp::End(ms(99_950)));
    }

    #[test]
    fn where_both_could_be_the_older_one_holds() {
        assert_eq!(at(99_950, 500), Stamp::End(ms(99_450)));
    }
}

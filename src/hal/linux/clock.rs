//! The kernel's monotonic clock, on which V4L2 and GPIO stamp what they saw. In: nothing. Out: time since the boot.

use crate::hal::Clock;
use rustix::time::{ClockId, clock_gettime};
use std::time::Duration;

/// Now.
pub(super) fn monotonic() -> Duration {
    let t = clock_gettime(ClockId::Monotonic);
    // it starts at 0 and never goes back
    Duration::new(u64::try_from(t.tv_sec).unwrap_or(0), u32::try_from(t.tv_nsec).unwrap_or(0))
}

/// Now, with the time that the computer has slept.
#[cfg(feature = "libcamera")]
pub(super) fn boot() -> Duration {
    let t = clock_gettime(ClockId::Boottime);
    Duration::new(u64::try_from(t.tv_sec).unwrap_or(0), u32::try_from(t.tv_nsec).unwrap_or(0))
}

/// A station's clock for real devices.
#[derive(Clone, Copy, Debug, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now(&self) -> Duration {
        monotonic()
    }

    fn sleep(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
}

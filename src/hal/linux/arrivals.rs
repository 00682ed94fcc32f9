//! Which of the images that come is the one that was asked for. In: an image's number, time stamp and flags, when it was
//! asked for. Out: whether it is the one; counts of lost, doubled and broken images. Pure.
//!
//! An image belongs to what was shown when its exposure began: one that began before it was asked for shows the picture,
//! or the light, before. A doubt makes an image older, never newer. Where the camera is triggered, there is one image per
//! trigger, so its number must follow, too: the caller sees a gap in [`Arrivals::number`].

use std::time::Duration;

/// What an image's time stamp means (V4L2_BUF_FLAG_TIMESTAMP_MASK, V4L2_BUF_FLAG_TSTAMP_SRC_MASK).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stamp {
    /// The exposure's begin, on the monotonic clock.
    Begin(Duration),
    /// When the image was complete, on the monotonic clock.
    End(Duration),
    /// Of another clock, or of none.
    Unknown,
}

/// An image as it comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arrival {
    /// Wraps.
    pub(super) sequence: u32,
    pub(super) stamp: Stamp,
    /// The driver says that its content is damaged.
    pub(super) damaged: bool,
}

/// What an image must meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wanted {
    /// No exposure that began before.
    pub(super) asked_at: Duration,
    /// No stamp is later.
    pub(super) now: Duration,
    /// How long images are exposed.
    pub(super) exposure: Duration,
    /// From an exposure's end until its image is complete, at most. None where the camera is triggered: it exposes nothing
    /// else meanwhile, so an image that may belong to the trigger does.
    pub(super) readout: Duration,
}

/// What an image is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fate {
    /// It began then, after it was asked for.
    Wanted(Duration),
    /// Exposed too early.
    Older,
    /// The image before once more.
    Doubled,
    /// Damaged; whether it was exposed after it was asked for.
    Damaged(bool),
    /// Its time cannot be.
    Impossible,
}

/// The images of one stream.
#[derive(Clone, Debug, Default)]
pub(super) struct Arrivals {
    last: Option<(u32, Stamp)>,
    /// The exposures so far, lost ones among them.
    pub(super) number: u64,
    /// Images that were exposed and never came.
    pub(super) lost: u64,
    /// Images that came twice.
    pub(super) doubled: u64,
    /// Images that came damaged.
    pub(super) damaged: u64,
    /// Images whose stamps mean nothing and that may still be old.
    stale: usize,
}

impl Arrivals {
    /// An image is asked for while `held` buffers may hold, or be about to take, older ones.
    pub(super) fn ask(&mut self, held: usize) {
        self.stale = held + 1; // one more is being exposed
    }

    /// Another stream begins, or one goes on in which the driver had no buffer to fill: what it left out is not lost.
    pub(super) fn restart(&mut self) {
        self.last = None;
    }

    /// Takes note of an image; what it is.
    pub(super) fn judge(&mut self, a: &Arrival, wanted: &Wanted) -> Fate {
        if let Some((sequence, stamp)) = self.last {
            let step = a.sequence.wrapping_sub(sequence);
            if step == 0 || (a.stamp != Stamp::Unknown && a.stamp == stamp) {
                self.doubled += 1;
                return Fate::Doubled;
            }
            if step > u32::MAX / 2 {
                return Fate::Impossible; // backwards
            }
            self.number += u64::from(step);
            self.lost += u64::from(step - 1);
        } else {
            self.number += 1;
        }
        self.last = Some((a.sequence, a.stamp));
        let begun = match a.stamp {
            Stamp::Begin(at) => Some(at),
            Stamp::End(at) => Some(at.saturating_sub(wanted.exposure + wanted.readout)),
            Stamp::Unknown => None,
        };
        let fresh = match begun {
            Some(at) if at > wanted.now => return Fate::Impossible,
            Some(at) => at >= wanted.asked_at,
            None => {
                self.stale = self.stale.saturating_sub(1);
                self.stale == 0
            }
        };
        if a.damaged {
            self.damaged += 1;
            return Fate::Damaged(fresh);
        }
        if fresh { Fate::Wanted(begun.unwrap_or(wanted.asked_at)) } else { Fate::Older }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn wanted(asked_at: u64) -> Wanted {
        Wanted { asked_at: ms(asked_at), now: ms(10_000), exposure: ms(8), readout: ms(33) }
    }

    fn begun(sequence: u32, at: u64) -> Arrival {
        Arrival { sequence, stamp: Stamp::Begin(ms(at)), damaged: false }
    }

    #[test]
    fn an_image_belongs_to_the_picture_that_its_exposure_began_after() {
        let mut arrivals = Arrivals::default();
        assert_eq!(arrivals.judge(&begun(1, 99), &wanted(100)), Fate::Older);
        assert_eq!(arrivals.judge(&begun(2, 132), &wanted(100)), Fate::Wanted(ms(132)));
        // an end's stamp says less: what may have begun before did
        let end = |sequence, at| Arrival { sequence, stamp: Stamp::End(ms(at)), damaged: false };
        let mut arrivals = Arrivals::default();
        assert_eq!(arrivals.judge(&end(1, 140), &wanted(100)), Fate::Older);
        assert_eq!(arrivals.judge(&end(2, 141), &wanted(100)), Fate::Wanted(ms(100)));
    }

    #[test]
    fn an_image_that_is_complete_after_the_trigger_and_its_exposure_is_the_triggers() {
        let end = |sequence, at| Arrival { sequence, stamp: Stamp::End(ms(at)), damaged: false };
        let triggered = Wanted { readout: Duration::ZERO, ..wanted(100) };
        let mut arrivals = Arrivals::default();
        assert_eq!(arrivals.judge(&end(1, 107), &triggered), Fate::Older, "8 ms of exposure do not fit in");
        assert_eq!(arrivals.judge(&end(2, 112), &triggered), Fate::Wanted(ms(104)));
    }

    #[test]
    fn stamps_that_mean_nothing_count_from_what_was_underway() {
        let mut arrivals = Arrivals::default();
        arrivals.ask(4);
        let a = |sequence| Arrival { sequence, stamp: Stamp::Unknown, damaged: false };
        let fates: Vec<_> = (0..6).map(|k| arrivals.judge(&a(k), &wanted(100))).collect();
        assert_eq!(fates[..4], [Fate::Older; 4]);
        assert_eq!(fates[4..], [Fate::Wanted(ms(100)); 2]);
    }

    #[test]
    fn lost_doubled_and_damaged_images_are_counted_across_the_wrap() {
        let mut arrivals = Arrivals::default();
        arrivals.judge(&begun(u32::MAX - 1, 10), &wanted(0));
        arrivals.judge(&begun(u32::MAX, 20), &wanted(0));
        assert_eq!(arrivals.judge(&begun(1, 40), &wanted(0)), Fate::Wanted(ms(40)));
        assert_eq!((arrivals.lost, arrivals.number), (1, 4));
        assert_eq!(arrivals.judge(&begun(1, 40), &wanted(0)), Fate::Doubled);
        assert_eq!(arrivals.judge(&begun(2, 40), &wanted(0)), Fate::Doubled, "another number, the same moment");
        let damaged = Arrival { damaged: true, ..begun(2, 50) };
        assert_eq!(arrivals.judge(&damaged, &wanted(0)), Fate::Damaged(true));
        assert_eq!((arrivals.doubled, arrivals.damaged), (2, 1));
        // while nobody took images the driver had to leave some out
        arrivals.restart();
        arrivals.judge(&begun(60, 2000), &wanted(0));
        assert_eq!((arrivals.lost, arrivals.number), (1, 6));
    }

    #[test]
    fn what_cannot_be_is_never_taken() {
        let mut arrivals = Arrivals::default();
        assert_eq!(arrivals.judge(&begun(5, 10_001), &wanted(0)), Fate::Impossible, "from the future");
        assert_eq!(arrivals.judge(&begun(4, 9000), &wanted(0)), Fate::Impossible, "backwards");
        arrivals.restart();
        assert_eq!(arrivals.judge(&begun(0, 9000), &wanted(0)), Fate::Wanted(ms(9000)));
    }
}

//! Which of the images of a stream is the one that was asked for, exposed as it was asked for. In: what libcamera tells of
//! each image, and which settings its request carried. Out: what to do with it; how it was exposed. Pure.
//!
//! A request carries its settings to the sensor, which needs some images more until it follows; what was really taken comes
//! back with the image, where the camera tells. Which image belongs to what was shown is `arrivals`' business.

use super::super::arrivals::{Arrival, Arrivals, Fate, Wanted};
use std::time::Duration;

/// An image as it comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Came {
    pub(super) arrival: Arrival,
    /// The settings that its request carried, counted from the first ones on.
    pub(super) settings: u64,
    /// How it was exposed, where the camera tells.
    pub(super) exposure: Option<Duration>,
    /// With which gain, where it tells.
    pub(super) gain: Option<f64>,
}

/// What an image is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict {
    /// The one that was asked for: when its exposure began, how long it was, its gain.
    Take(Duration, Duration, f64),
    /// Exposed after it was asked for, but not as it was asked for; or damaged.
    Again { damaged: bool },
    /// Of before, or not worth a word.
    Pass,
}

/// The images of one stream.
#[derive(Clone, Debug, Default)]
pub(super) struct Follow {
    pub(super) arrivals: Arrivals,
    /// The settings asked for last, counted.
    settings: u64,
    exposure: Duration,
    gain: f64,
    /// Images of these settings to leave out yet.
    lagging: usize,
}

impl Follow {
    /// From here on images are to be exposed so; the first `lag` of them are not yet.
    pub(super) fn set(&mut self, exposure: Duration, gain: f64, lag: usize) {
        if (exposure, gain) != (self.exposure, self.gain) {
            (self.exposure, self.gain, self.lagging) = (exposure, gain, lag);
            self.settings += 1;
        }
    }

    /// The number that requests are to carry.
    pub(super) fn settings(&self) -> u64 {
        self.settings
    }

    /// Takes note of an image. `asked_at`: no exposure that began before; `readout`: see [`Wanted`].
    pub(super) fn judge(&mut self, came: &Came, asked_at: Duration, now: Duration, readout: Duration) -> Verdict {
        let exposure = came.exposure.unwrap_or(self.exposure);
        let fate = self.arrivals.judge(&came.arrival, &Wanted { asked_at, now, exposure, readout });
        let settled = came.settings == self.settings && self.lagging == 0;
        if came.settings == self.settings && !matches!(fate, Fate::Doubled | Fate::Impossible) {
            self.lagging = self.lagging.saturating_sub(1);
        }
        match fate {
            Fate::Wanted(at) if settled => Verdict::Take(at, exposure, came.gain.unwrap_or(self.gain)),
            Fate::Wanted(_) => Verdict::Again { damaged: false },
            Fate::Damaged(true) => Verdict::Again { damaged: true },
            _ => Verdict::Pass,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::arrivals::Stamp;
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// Complete at 33 ms times its number.
    fn came(sequence: u32, settings: u64) -> Came {
        let stamp = Stamp::End(ms(33 * u64::from(sequence)));
        Came { arrival: Arrival { sequence, stamp, damaged: false }, settings, exposure: None, gain: None }
    }

    fn judge(follow: &mut Follow, came: &Came, asked_at: u64) -> Verdict {
        follow.judge(came, ms(asked_at), ms(10_000), ms(33))
    }

    #[test]
    fn an_image_is_taken_from_when_it_must_have_begun_after_it_was_asked_for() {
        let mut follow = Follow::default();
        follow.set(ms(2), 1.0, 0);
        // one that was complete 35 ms later may have begun just then
        assert_eq!(judge(&mut follow, &came(4, 1), 100), Verdict::Pass);
        assert_eq!(judge(&mut follow, &came(5, 1), 100), Verdict::Take(ms(165 - 35), ms(2), 1.0));
    }

    #[test]
    fn requests_that_carry_former_settings_and_the_sensors_lag_are_waited_for() {
        let mut follow = Follow::default();
        follow.set(ms(2), 1.0, 0);
        assert_eq!(judge(&mut follow, &came(1, 1), 1), Verdict::Pass);
        assert!(matches!(judge(&mut follow, &came(2, 1), 0), Verdict::Take(..)));
        follow.set(ms(8), 1.0, 2);
        assert_eq!(follow.settings(), 2);
        let verdicts: Vec<_> = (3..9).map(|k| judge(&mut follow, &came(k, 1 + u64::from(k > 4)), 0)).collect();
        assert_eq!(verdicts[..4], [Verdict::Again { damaged: false }; 4], "two carried the former, two lag");
        assert!(matches!(verdicts[4], Verdict::Take(_, exposure, _) if exposure == ms(8)));
        assert!(matches!(verdicts[5], Verdict::Take(..)));
    }

    #[test]
    fn the_same_settings_once_more_change_nothing() {
        let mut follow = Follow::default();
        let numbers = [1.0, 1.0, 1.5].map(|gain| {
            follow.set(ms(2), gain, 2);
            follow.settings()
        });
        assert_eq!(numbers, [1, 1, 2]);
    }

    #[test]
    fn what_the_camera_tells_of_an_exposure_counts_for_more_than_what_was_asked_for() {
        let mut follow = Follow::default();
        follow.set(ms(2), 1.0, 0);
        let told = Came { exposure: Some(ms(30)), gain: Some(1.25), ..came(9, 1) };
        assert_eq!(judge(&mut follow, &told, 250), Verdict::Pass, "33 · 9 − 33 − 30 is before 250");
        let told = Came { exposure: Some(ms(30)), gain: Some(1.25), ..came(10, 1) };
        assert_eq!(judge(&mut follow, &told, 250), Verdict::Take(ms(330 - 63), ms(30), 1.25));
    }

    #[test]
    fn damaged_images_are_said_to_be_so_and_lost_ones_counted() {
        let mut follow = Follow::default();
        follow.set(ms(2), 1.0, 0);
        let mut broken = came(2, 1);
        broken.arrival.damaged = true;
        assert_eq!(judge(&mut follow, &broken, 0), Verdict::Again { damaged: true });
        assert!(matches!(judge(&mut follow, &came(5, 1), 0), Verdict::Take(..)));
        assert_eq!(judge(&mut follow, &came(5, 1), 0), Verdict::Pass, "doubled");
        let a = &follow.arrivals;
        assert_eq!((a.damaged, a.lost, a.doubled, a.number), (1, 2, 1, 4));
    }
}

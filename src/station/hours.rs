//! How long each bar has been lit, which says when it is due. In: drives, as they are set. Out: hours.
//! Not here: where the hours are kept.

use crate::hal::{Error, LightBars};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Hours of light, left and right; counted by whoever drives the bars, read by whoever asks.
#[derive(Clone, Debug, Default)]
pub struct Hours(Arc<Mutex<[f64; 2]>>);

impl Hours {
    /// Counting goes on from `before`.
    pub fn new(before: [f64; 2]) -> Self {
        Self(Arc::new(Mutex::new(before)))
    }

    /// So far.
    pub fn get(&self) -> [f64; 2] {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts how `bars` are driven from now on.
    pub fn count(&self, bars: &mut Box<dyn LightBars + Send>) {
        let bare = std::mem::replace(bars, Box::new(Nothing));
        *bars = Box::new(Counted { bars: bare, hours: self.clone(), lit: [false; 2], since: Instant::now() });
    }
}

/// Holds the place of bars while they change hands.
struct Nothing;

impl LightBars for Nothing {
    fn set(&mut self, _: [f64; 2]) -> Result<[f64; 2], Error> {
        Ok([0.0; 2])
    }
}

struct Counted {
    bars: Box<dyn LightBars + Send>,
    hours: Hours,
    lit: [bool; 2],
    since: Instant,
}

impl LightBars for Counted {
    fn set(&mut self, drive: [f64; 2]) -> Result<[f64; 2], Error> {
        let taken = self.bars.set(drive);
        let now = Instant::now();
        let hours = now.duration_since(self.since).as_secs_f64() / 3600.0;
        let mut all = self.hours.0.lock().unwrap_or_else(PoisonError::into_inner);
        for (sum, lit) in all.iter_mut().zip(self.lit) {
            *sum += if lit { hours } else { 0.0 };
        }
        (self.since, self.lit) = (now, taken.as_ref().map_or(self.lit, |t| t.map(|d| d > 0.0)));
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Any;

    impl LightBars for Any {
        fn set(&mut self, drive: [f64; 2]) -> Result<[f64; 2], Error> {
            Ok(drive)
        }
    }

    #[test]
    fn a_bar_ages_only_while_it_is_lit() {
        let hours = Hours::new([2.0, 3.0]);
        let mut bars: Box<dyn LightBars + Send> = Box::new(Any);
        hours.count(&mut bars);
        for drive in [[0.0, 0.0], [0.5, 0.0], [0.0, 0.0], [0.0, 0.0]] {
            bars.set(drive).expect("takes anything");
        }
        let [left, right] = hours.get();
        assert!(left > 2.0 && left < 2.1 && right == 3.0, "{left} {right}");
    }
}

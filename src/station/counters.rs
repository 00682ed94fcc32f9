//! How long cycles take. In: durations. Out: their median and 95th percentile, of the latest ones.

use std::collections::VecDeque;
use std::time::Duration;

/// So many are looked at.
const KEPT: usize = 1000;

/// The latest cycles' durations.
#[derive(Clone, Debug, Default)]
pub struct Durations(VecDeque<Duration>);

impl Durations {
    /// One more.
    pub fn add(&mut self, took: Duration) {
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back(took);
    }

    /// The duration that this share of the cycles does not exceed; 0 where there are none.
    pub fn quantile(&self, share: f64) -> Duration {
        let mut all: Vec<Duration> = self.0.iter().copied().collect();
        all.sort_unstable();
        let last = all.len().saturating_sub(1);
        all.get((share * last as f64).ceil() as usize).copied().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_of_the_latest_thousand() {
        let mut durations = Durations::default();
        assert_eq!(durations.quantile(0.5), Duration::ZERO);
        (0..3000).for_each(|ms| durations.add(Duration::from_millis(ms)));
        assert_eq!(durations.quantile(0.0), Duration::from_millis(2000));
        assert_eq!(durations.quantile(0.5), Duration::from_millis(2500));
        assert_eq!(durations.quantile(0.95), Duration::from_millis(2950));
    }
}

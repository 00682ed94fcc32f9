//! Random numbers that depend on a seed and a place only, so that threads cannot change them.
//! In: a seed and the numbers of a place (exposure, row). Out: a stream of its own for every place.
//! SplitMix64: Steele, Lea, Flood, OOPSLA 2014. Forty lines instead of three crates: what is needed is streams that can
//! be addressed, and normal numbers at a few ns.

use std::sync::LazyLock;

const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// The stream of `seed` at a place.
    pub fn new(seed: u64, place: &[u64]) -> Self {
        Self(place.iter().fold(mix(seed.wrapping_add(STEP)), |state, p| mix(state ^ mix(p.wrapping_add(STEP)))))
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(STEP);
        mix(self.0)
    }

    /// Uniform in 0..1.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `low..high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Normal, mean 0, standard deviation 1 (Box and Muller, 1958).
    pub fn normal(&mut self) -> f64 {
        let (u, v) = (1.0 - self.uniform(), self.uniform());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    /// One of `0..n`.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.uniform() * n as f64) as usize).min(n - 1)
    }
}

fn mix(z: u64) -> u64 {
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Normal numbers (mean 0, standard deviation 1) for every 16-bit number: four of them per draw. Their tails end at
/// 4.3, which of a hundred million samples a few hundred would exceed.
pub(super) static NORMAL: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..=u16::MAX).map(|i| normal_quantile((f64::from(i) + 0.5) / 65536.0) as f32).collect());

/// The inverse of the normal distribution's cumulative function, to 1.2e-9 relative.
/// P. J. Acklam, "An algorithm for computing the inverse normal cumulative distribution function", 2003.
fn normal_quantile(p: f64) -> f64 {
    const A: [f64; 6] = [
        -3.969683028665376e1,
        2.209460984245205e2,
        -2.759285104469687e2,
        1.383_577_518_672_69e2,
        -3.066479806614716e1,
        2.506628277459239e0,
    ];
    const B: [f64; 6] = [
        -5.447609879822406e1,
        1.615858368580409e2,
        -1.556989798598866e2,
        6.680131188771972e1,
        -1.328068155288572e1,
        1.0,
    ];
    const C: [f64; 6] = [
        -7.784894002430293e-3,
        -3.223964580411365e-1,
        -2.400758277161838e0,
        -2.549732539343734e0,
        4.374664141464968e0,
        2.938163982698783e0,
    ];
    const D: [f64; 5] = [7.784695709041462e-3, 3.224671290700398e-1, 2.445134137142996e0, 3.754408661907416e0, 1.0];
    let horner = |c: &[f64], x: f64| c.iter().fold(0.0, |sum, c| sum * x + c);
    let tail = |p: f64| {
        let q = (-2.0 * p.ln()).sqrt();
        horner(&C, q) / horner(&D, q)
    };
    match p {
        ..0.02425 => tail(p),
        0.97575.. => -tail(1.0 - p),
        _ => {
            let q = p - 0.5;
            q * horner(&A, q * q) / horner(&B, q * q)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::mean_std;

    #[test]
    fn the_table_is_normal() {
        let (mean, std) = mean_std(&NORMAL.iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
        assert!(mean.abs() < 1e-6 && (std - 1.0).abs() < 1e-4, "{mean} {std}");
        assert!((normal_quantile(0.975) - 1.959_963_985).abs() < 1e-8);
        assert!((normal_quantile(0.01) + 2.326_347_874).abs() < 1e-8);
    }

    #[test]
    fn places_have_streams_of_their_own() {
        let first = |seed, place: &[u64]| Random::new(seed, place).bits();
        let all = [first(1, &[]), first(2, &[]), first(1, &[0]), first(1, &[1]), first(1, &[0, 1]), first(1, &[1, 0])];
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| a != b), "{all:x?}");
        }
        let mut stream = Random::new(7, &[3]);
        let (mean, std) = mean_std(&(0..10_000).map(|_| stream.uniform()).collect::<Vec<_>>());
        assert!((mean - 0.5).abs() < 0.01 && (std - 12f64.sqrt().recip()).abs() < 0.005, "{mean} {std}");
        let (mean, std) = mean_std(&(0..10_000).map(|_| stream.normal()).collect::<Vec<_>>());
        assert!(mean.abs() < 0.03 && (std - 1.0).abs() < 0.02, "{mean} {std}");
    }
}

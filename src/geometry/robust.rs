//! Robust weights for least squares. In: residuals over their sigmas. Out: their scale and Tukey weights.
//! Not here: any model; each fit iterates its own.
//! Tukey's biweight with the MAD scale: Huber, Ronchetti, "Robust Statistics", Wiley 2009, §4.8 and §5.1.

use crate::lent::List;

/// Where Tukey's weight reaches zero, in sigmas: 95 % efficient on Gaussian noise.
const CUTOFF: f64 = 4.685;

/// The median (the upper one of two); NaN of nothing. Reorders `values`.
pub fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { f64::NAN } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Of a Gaussian: its standard deviation over the median of its magnitudes.
const SIGMA_PER_MEDIAN: f64 = 1.4826;

/// The standard deviation about zero of Gaussian `residuals`, whatever less than half of them do.
pub fn mad_sigma(residuals: impl Iterator<Item = f64>) -> f64 {
    SIGMA_PER_MEDIAN * median(&mut List::of(residuals.map(f64::abs)))
}

/// Tukey's biweight at `u` sigmas, 1 at 0 down to 0 from 4.685 on.
pub fn tukey(u: f64) -> f64 {
    (1.0 - (u / CUTOFF).powi(2)).max(0.0).powi(2)
}

/// Tukey weights of residuals (each over its own sigma), for all rounds of a fit.
///
/// With these weights `(Σ w·j·jᵀ/σ²)⁻¹` is the covariance of the fit to 2 % in sigma (too large) for Gaussian noise.
#[derive(Clone, Debug)]
pub struct Weights {
    /// One of each residual, 0..=1.
    pub weights: List<f64>,
    /// What they were taken at: the scale of the residuals' scatter, but never below the 1 that the stated sigmas promise.
    pub scale: f64,
    magnitudes: List<f64>,
}

impl Default for Weights {
    /// Of nothing.
    fn default() -> Self {
        Self { weights: List::new(), scale: 1.0, magnitudes: List::new() }
    }
}

impl Weights {
    /// The weights of `residuals`, in place of earlier ones.
    pub fn weigh(&mut self, residuals: impl Iterator<Item = f64>) {
        self.magnitudes.clear();
        self.magnitudes.extend(residuals.map(f64::abs));
        self.weights.clear();
        self.weights.extend_from_slice(&self.magnitudes);
        self.scale = (SIGMA_PER_MEDIAN * median(&mut self.magnitudes)).max(1.0);
        self.weights.iter_mut().for_each(|w| *w = tukey(*w / self.scale));
    }
}

/// Tukey weights of `residuals` (each over its own sigma), and the scale they were taken at.
pub fn weigh(residuals: &[f64]) -> (List<f64>, f64) {
    let mut weights = Weights::default();
    weights.weigh(residuals.iter().copied());
    (weights.weights, weights.scale)
}

/// Few points each, from which `start` fits its models; some such subsets are free of up to 30 % of outliers.
const SUBSET: usize = 9;
/// Subsets tried: the chance that none is free of 30 % of outliers is 1 in 60, of 20 % it is 1 in 1 million.
const SUBSETS: usize = 100;

/// Where iterated weights may start although outliers lie together and drag a fit to all points with them: of the
/// models that `fit` makes of few of `n` points, and of all, the one of least `loss`; of equal ones the first. The
/// subsets are the same every time. `loss` is told beyond what it need not count on, as [`truncated`] is. `None` if
/// `fit` never fits.
///
/// Torr, Zisserman, "MLESAC", Computer Vision and Image Understanding 78 (2000), there called MSAC.
pub fn start<M>(n: usize, fit: impl Fn(&[usize]) -> Option<M>, loss: impl Fn(&M, f64) -> f64) -> Option<M> {
    if n == 0 {
        return None;
    }
    let mut state = 1u64;
    let mut pick = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407); // Knuth's MMIX
        (state >> 33) as usize % n
    };
    let all = List::of(0..n);
    let mut best: Option<(M, f64)> = None;
    for round in 0..=SUBSETS {
        let few: [usize; SUBSET];
        let picked = if round == 0 {
            &all[..]
        } else {
            few = std::array::from_fn(|_| pick());
            &few[..]
        };
        let Some(model) = fit(picked) else { continue };
        let most = best.as_ref().map_or(f64::INFINITY, |(_, loss)| *loss);
        let loss = loss(&model, most);
        if loss < most {
            best = Some((model, loss));
        }
    }
    best.map(|(model, _)| model)
}

/// The sum of squared `residuals` (each over its own sigma), none counted above 5 squared; at least `most` as soon as it
/// reaches that.
pub fn truncated(residuals: impl Iterator<Item = f64>, most: f64) -> f64 {
    let mut sum = 0.0;
    for r in residuals {
        sum += (r * r).min(25.0);
        if sum >= most {
            break;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;

    #[test]
    fn the_scale_is_that_of_the_good_three_quarters() {
        let mut noise = Noise::new(1);
        let mut residuals: Vec<f64> = (0..4000).map(|_| 2.0 * noise.gauss()).collect();
        residuals[..1000].fill(80.0);
        let (weights, scale) = weigh(&residuals);
        assert!((2.4..3.0).contains(&scale), "{scale}"); // 2 · Φ⁻¹(5/6)/Φ⁻¹(3/4) = 2.87
        assert!(weights[..1000].iter().all(|w| *w == 0.0) && weights[1000..].iter().sum::<f64>() > 2600.0);
    }

    #[test]
    fn a_start_ignores_outliers_that_agree_with_each_other() {
        let values: Vec<f64> = (0..100).map(|k| if k < 30 { 50.0 } else { f64::from(k % 3) }).collect();
        let mean = |few: &[usize]| Some(few.iter().map(|k| values[*k]).sum::<f64>() / few.len() as f64);
        let loss = |m: &f64, most: f64| truncated(values.iter().map(|v| v - m), most);
        let got = start(100, mean, loss).expect("means exist");
        assert!((0.5..1.5).contains(&got), "{got}");
        assert_eq!(start(0, mean, loss), None, "of nothing");
    }

    #[test]
    fn stated_sigmas_are_never_shrunk() {
        assert_eq!(weigh(&[0.0, 0.1, -0.1]).1, 1.0);
        assert!(median(&mut []).is_nan());
    }
}

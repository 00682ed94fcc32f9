//! Gauge R&R by analysis of variance: how much of what is measured is the gauge.
//! In:  parts × operators × trials, crossed. Out: the parts of the variance, and what is made of them.
//! Source: AIAG, Measurement Systems Analysis, 4th edition (2010), chapter III, section B, and appendix A.
//! The interaction is pooled with the error where its mean square is no larger than the error's: it is none, then.

/// Standard deviations, in the unit of what was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gauge {
    /// From trial to trial: equipment variation.
    pub(super) repeatability: f64,
    /// From operator to operator: appraiser variation.
    pub(super) reproducibility: f64,
    /// Of operators with parts.
    pub(super) interaction: f64,
    /// From part to part.
    pub(super) parts: f64,
}

impl Gauge {
    /// Of `values[part][operator][trial]`; none where they are not crossed, or fewer than two of each.
    pub(super) fn new(values: &[Vec<Vec<f64>>]) -> Option<Self> {
        let (p, o) = (values.len(), values.first()?.len());
        let r = values.first()?.first()?.len();
        let crossed = values.iter().all(|v| v.len() == o && v.iter().all(|t| t.len() == r));
        if !crossed || p < 2 || o < 2 || r < 2 {
            return None;
        }
        let (pn, on, rn) = (p as f64, o as f64, r as f64);
        let total: f64 = values.iter().flatten().flatten().sum();
        let grand = total / (pn * on * rn);
        let of_cell = |i: usize, j: usize| values[i][j].iter().sum::<f64>() / rn;
        let of_part = |i: usize| (0..o).map(|j| of_cell(i, j)).sum::<f64>() / on;
        let of_operator = |j: usize| (0..p).map(|i| of_cell(i, j)).sum::<f64>() / pn;
        let square = |v: f64| (v - grand).powi(2);
        let parts = on * rn * (0..p).map(|i| square(of_part(i))).sum::<f64>();
        let operators = pn * rn * (0..o).map(|j| square(of_operator(j))).sum::<f64>();
        let cells = || (0..p).flat_map(|i| (0..o).map(move |j| (i, j)));
        let both =
            rn * cells().map(|(i, j)| (of_cell(i, j) - of_part(i) - of_operator(j) + grand).powi(2)).sum::<f64>();
        let error =
            cells().map(|(i, j)| values[i][j].iter().map(|v| (v - of_cell(i, j)).powi(2)).sum::<f64>()).sum::<f64>();
        let (of_both, of_error) = ((pn - 1.0) * (on - 1.0), pn * on * (rn - 1.0));
        let (part, operator) = (parts / (pn - 1.0), operators / (on - 1.0));
        let sigma = |variance: f64| variance.max(0.0).sqrt();
        let interacts = both / of_both > error / of_error;
        // what parts and operators are held against
        let within = if interacts { both / of_both } else { (both + error) / (of_both + of_error) };
        Some(Self {
            repeatability: sigma(if interacts { error / of_error } else { within }),
            reproducibility: sigma((operator - within) / (pn * rn)),
            interaction: if interacts { sigma((within - error / of_error) / rn) } else { 0.0 },
            parts: sigma((part - within) / (on * rn)),
        })
    }

    /// Of the gauge: repeatability and reproducibility.
    pub(super) fn rr(&self) -> f64 {
        self.repeatability.hypot(self.reproducibility).hypot(self.interaction)
    }

    /// %GRR: the gauge's share of the whole variation.
    pub(super) fn percent(&self) -> f64 {
        100.0 * self.rr() / self.rr().hypot(self.parts)
    }

    /// The same of a tolerance of this width.
    pub(super) fn percent_of(&self, tolerance: f64) -> f64 {
        100.0 * 6.0 * self.rr() / tolerance
    }

    /// ndc: how many kinds of parts it can tell apart.
    pub(super) fn categories(&self) -> f64 {
        (2f64.sqrt() * self.parts / self.rr()).floor()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The worked example of the source, figure III-B 6: by operator and trial, the ten parts.
    const PUBLISHED: [[[f64; 10]; 3]; 3] = [
        [
            [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36],
            [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25],
            [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31],
        ],
        [
            [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68],
            [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62],
            [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50],
        ],
        [
            [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49],
            [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77],
            [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16],
        ],
    ];

    fn crossed(of: impl Fn(usize, usize, usize) -> f64) -> Vec<Vec<Vec<f64>>> {
        (0..10).map(|i| (0..3).map(|j| (0..3).map(|k| of(i, j, k)).collect()).collect()).collect()
    }

    #[test]
    fn the_published_example_comes_out_as_published() {
        let g = Gauge::new(&crossed(|i, j, k| PUBLISHED[j][k][i])).expect("crossed");
        // table III-B 9: EV 0.199933, AV 0.226838, interaction 0, GRR 0.302373, PV 1.042327; 27.9 %, 4 categories
        let published = [(g.repeatability, 0.199933), (g.reproducibility, 0.226838), (g.parts, 1.042327)];
        for (ours, theirs) in published {
            assert!((ours - theirs).abs() < 1e-6, "{ours} for {theirs}");
        }
        // by the published parts themselves it is 0.3023717
        assert!((g.rr() - 0.199933f64.hypot(0.226838)).abs() < 1e-6 && (g.rr() - 0.302373).abs() < 2e-6, "{g:?}");
        assert!((g.percent() - 27.9).abs() < 0.05 && g.interaction == 0.0 && g.categories() == 4.0, "{g:?}");
        assert!((g.percent_of(6.0) - 30.2373).abs() < 1e-3);
    }

    #[test]
    fn operators_who_differ_from_part_to_part_interact() {
        // what an operator adds changes its sign from part to part; trials differ by ±0.1
        let of = |i: usize, j: usize, k: usize| {
            let sign = if (i + j).is_multiple_of(2) { 1.0 } else { -1.0 };
            10.0 * i as f64 + sign + 0.1 * (k as f64 - 1.0)
        };
        let g = Gauge::new(&crossed(of)).expect("crossed");
        assert!((g.repeatability - 0.1).abs() < 1e-9, "{g:?}");
        assert!(g.interaction > 0.9 && g.reproducibility == 0.0 && g.parts > 25.0, "{g:?}");
        assert!(Gauge::new(&[vec![vec![1.0, 2.0], vec![1.0]], vec![vec![1.0, 2.0], vec![1.0, 2.0]]]).is_none());
    }
}

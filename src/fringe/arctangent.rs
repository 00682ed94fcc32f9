//! The arctangent without a branch, so that many are taken side by side.
//! Abramowitz, Stegun, "Handbook of mathematical functions", 1964, 4.4.49: within 2e-8 rad on 0..=1.

use std::f32::consts::{FRAC_PI_2, PI};

const TERMS: [f32; 9] = [
    1.0,
    -0.333_331_45,
    0.199_935_51,
    -0.142_089,
    0.106_562_64,
    -0.075_289_64,
    0.042_909_614,
    -0.016_165_737,
    0.002_866_225_7,
];

/// The angle of (x, y), rad, -π..=π, within 4e-7; NaN at the origin.
#[inline(always)]
pub(super) fn arctangent(y: f32, x: f32) -> f32 {
    let (along, across) = (x.abs(), y.abs());
    let t = along.min(across) / along.max(across);
    let square = t * t;
    let eighth = t * TERMS.iter().rev().fold(0.0, |sum, term| sum * square + term);
    let quarter = if across > along { FRAC_PI_2 - eighth } else { eighth };
    let half = if x < 0.0 { PI - quarter } else { quarter };
    half.copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_libraries() {
        for k in 0..100_000 {
            let turn = f64::from(k) * 0.618;
            let (sin, cos) = turn.sin_cos();
            let (y, x) = (37.0 * sin as f32, 37.0 * cos as f32);
            let off = f64::from(arctangent(y, x)) - f64::from(y).atan2(f64::from(x));
            assert!(off.abs() < 4e-7, "{y} {x}: {off}");
        }
        let axes = [(0.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, -1.0)].map(|(y, x)| arctangent(y, x));
        assert_eq!(axes, [0.0, FRAC_PI_2, -FRAC_PI_2, PI]);
        assert!(arctangent(0.0, 0.0).is_nan());
    }
}

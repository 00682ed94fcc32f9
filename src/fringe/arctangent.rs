//! The arctangent without a branch, so that many are taken side by side.

use std::f32::consts::PI;

/// Twice the arctangent of t in -1..=1 is t times the sum of these with t², t⁴, ...: the polynomial whose largest error
/// is least, 5e-7 (by Remez's exchange).
const TERMS: [f32; 7] =
    [1.999_992_3, -0.666_347_4, 0.396_156_3, -0.264_666_86, 0.159_247_34, -0.067_208_44, 0.013_623_586];

/// Adds to `angles` the angle of (x, y), rad, -π..=π, within 1e-6, where `tangents` are y/(|x| + √(x² + y²)): of half the
/// angle that (|x|, y) has.
#[inline(always)]
pub(super) fn arctangents(tangents: &[f32], x: &[f32], angles: &mut [f32]) {
    let [a, b, c, d, e, f, g] = TERMS;
    for ((angle, t), x) in angles.iter_mut().zip(tangents).zip(x) {
        let t2 = t * t;
        let t4 = t2 * t2;
        // terms in pairs: one after the other each would wait for the one before
        let right = t * ((a + b * t2) + t4 * ((c + d * t2) + t4 * ((e + f * t2) + t4 * g)));
        *angle += if *x < 0.0 { PI.copysign(*t) - right } else { right };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_libraries() {
        let turns = (0..100_000).map(|k| f64::from(k) * 0.618).map(f64::sin_cos);
        let points = turns.map(|(sin, cos)| (37.0 * cos as f32, 37.0 * sin as f32));
        let axes = [(37.0, 0.0), (0.0, 37.0), (0.0, -37.0), (-37.0, 0.0), (-37.0, -0.0)];
        let (x, y): (Vec<f32>, Vec<f32>) = points.chain(axes).unzip();
        let tangents: Vec<f32> = x.iter().zip(&y).map(|(x, y)| y / (x.abs() + (x * x + y * y).sqrt())).collect();
        let mut angles = vec![0.0; x.len()];
        arctangents(&tangents, &x, &mut angles);
        let off = angles.iter().zip(x.iter().zip(&y)).map(|(angle, (x, y))| {
            let truth = f64::from(*y).atan2(f64::from(*x));
            (f64::from(*angle) - truth).abs()
        });
        let worst = off.fold(0.0, f64::max);
        assert!(worst < 1e-6, "{worst}");
    }
}

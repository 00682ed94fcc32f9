//! Area lamps and the room: the light that falls on a point, and what a clear coat mirrors of it.
//! In:  lamps in the camera's frame (mm), a point with its normal. Out: illuminance (lx), mirrored luminance (cd/m²).
//! Not here: paints' colours; the projector; what is in the way.

use super::paint::COAT;
use nalgebra::Vector3;

type V = Vector3<f64>;

/// A flat rectangular lamp that shines to one side.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lamp {
    centre: V,
    /// Unit vectors along its length and width, and towards where it shines.
    axes: [V; 3],
    /// Half length and width, mm.
    half: [f64; 2],
    /// Points along its length that stand for its area, and the area of each, mm².
    points: Vec<V>,
    area: f64,
}

/// The mirror lobe of a GGX surface (Walter et al., EGSR 2007) as three Gaussians of the half angle over the roughness:
/// weight and width of each; the density is met within a tenth where it is more than a thousandth of its peak.
const LOBE: [(f64, f64); 3] = [(0.5815, 0.6065), (0.3536, 1.478), (0.0648, 4.186)];

impl Lamp {
    /// A lamp of `half` length and width (mm) along `along`, facing `target`.
    pub(super) fn new(centre: V, along: V, target: V, half: [f64; 2]) -> Self {
        let along = along.normalize();
        let to = target - centre;
        let facing = (to - along * along.dot(&to)).normalize();
        let n = 6;
        let points =
            (0..n).map(|k| centre + along * half[0] * ((2.0 * f64::from(k) + 1.0) / f64::from(n) - 1.0)).collect();
        let area = 4.0 * half[0] * half[1] / f64::from(n);
        Self { centre, axes: [along, facing.cross(&along), facing], half, points, area }
    }

    /// Its middle.
    pub(super) fn middle(&self) -> V {
        self.centre
    }

    /// Illuminance, lx per cd/m² of the lamp, at `p` with normal `n`.
    pub(super) fn illuminance(&self, p: &V, n: &V) -> f64 {
        let mut sum = 0.0;
        for q in &self.points {
            let to = q - p;
            let (far2, up, out) = (to.norm_squared(), to.dot(n), -to.dot(&self.axes[2]));
            if up > 0.0 && out > 0.0 {
                sum += up * out / (far2 * far2);
            }
        }
        sum * self.area
    }

    /// Share of the mirror lobe about direction `r` from `p` that the lamp fills; `spread` is the lobe's roughness, as a
    /// spread of slopes.
    pub(super) fn mirrored(&self, p: &V, r: &V, spread: f64) -> f64 {
        let towards = -r.dot(&self.axes[2]);
        if towards <= 0.05 {
            return 0.0;
        }
        let to = self.centre - p;
        let far = -to.dot(&self.axes[2]) / towards;
        if far <= 0.0 {
            return 0.0;
        }
        let at = r * far - to;
        let place = [at.dot(&self.axes[0]), at.dot(&self.axes[1])];
        // a slope turns the mirrored ray twice as far
        let blur = 2.0 * spread * far;
        let beyond = (0..2).map(|i| (place[i].abs() - self.half[i]) / blur).fold(0.0, f64::max);
        if beyond > 4.0 * LOBE[2].1 {
            return 0.0;
        }
        LOBE.iter()
            .map(|(weight, width)| {
                let scale = 1.0 / (blur * width);
                let cover =
                    |i: usize| below((self.half[i] - place[i]) * scale) - below((-self.half[i] - place[i]) * scale);
                weight * cover(0) * cover(1)
            })
            .sum()
    }
}

/// The normal distribution below `x` standard deviations, to 2e-4: the logistic curve of Bowling et al., 2009.
fn below(x: f64) -> f64 {
    1.0 / (1.0 + (-x * (1.5976 + 0.070_56 * x * x)).clamp(-50.0, 50.0).exp())
}

/// Reflectance of the coat at this cosine of incidence (Schlick 1994).
pub(super) fn fresnel(cos: f64) -> f64 {
    COAT + (1.0 - COAT) * (1.0 - cos.clamp(0.0, 1.0)).powi(5)
}

/// The hall beyond the lamps: grey walls, a brighter ceiling. Luminance, as a share of its mean, in direction `r`
/// whose upward part is `up`.
pub(super) fn room(up: f64) -> f64 {
    1.0 + 0.35 * up
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamp() -> Lamp {
        Lamp::new(V::new(0.0, 0.0, 0.0), V::y(), V::new(0.0, 0.0, 1000.0), [300.0, 30.0])
    }

    #[test]
    fn a_far_lamp_lights_as_a_point_does() {
        let got = lamp().illuminance(&V::new(0.0, 0.0, 10_000.0), &-V::z());
        let expected = 600.0 * 60.0 / 1e8; // area over distance squared
        assert!((got / expected - 1.0).abs() < 1e-2, "{got} {expected}");
        assert_eq!(lamp().illuminance(&V::new(0.0, 0.0, -100.0), &V::z()), 0.0, "its back is dark");
    }

    #[test]
    fn a_mirror_shows_the_lamp_whole_inside_and_half_at_its_edge() {
        let p = V::new(0.0, 0.0, 1000.0);
        let towards = |x: f64, y: f64| (V::new(x, y, 0.0) - p).normalize();
        let seen = |x, y| lamp().mirrored(&p, &towards(x, y), 0.002);
        assert!(seen(0.0, 0.0) > 0.95);
        assert!((seen(30.0, 0.0) / seen(0.0, 0.0) - 0.5).abs() < 0.03);
        assert!(seen(120.0, 0.0) < 0.002 && seen(0.0, 420.0) < 0.002);
    }

    #[test]
    fn the_normal_distribution_is_approached() {
        for (x, p) in [(0.0, 0.5), (1.0, 0.841_345), (-2.0, 0.022_75), (8.0, 1.0)] {
            assert!((below(x) - p).abs() < 3e-4, "{x}");
        }
    }
}

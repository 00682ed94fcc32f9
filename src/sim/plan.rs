//! Outlines of a body's parts, seen from its side: curves and closed shapes in the vehicle's x–z plane, mm.
//! In:  a point. Out: its signed distance to the outline, exact at the outline and to first order beside it, with the
//! distance's gradient. Not here: depth; which part is which.

/// A point or direction in the vehicle's x–z plane, mm.
pub(super) type Xz = [f64; 2];

pub(super) fn dot(a: Xz, b: Xz) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Length, mm; `hypot` guards against overflow that millimetres do not have, at several times the price.
pub(super) fn length(a: Xz) -> f64 {
    dot(a, a).sqrt()
}

pub(super) fn minus(a: Xz, b: Xz) -> Xz {
    [a[0] - b[0], a[1] - b[1]]
}

/// A signed distance, mm, and its gradient, of length 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Distance {
    pub(super) mm: f64,
    pub(super) gradient: Xz,
}

impl Distance {
    /// That of the other side, `gap` farther away.
    pub(super) fn across(self, gap: f64) -> Self {
        Self { mm: -self.mm - gap, gradient: self.gradient.map(|g| -g) }
    }

    /// The distance to what is inside both, their corner rounded with radius about `radius`.
    pub(super) fn and(self, other: Self, radius: f64) -> Self {
        let (a, b) = (radius - self.mm, radius - other.mm);
        if a <= 0.0 || b <= 0.0 || radius <= 0.0 {
            return if self.mm < other.mm { self } else { other };
        }
        // √(a² + b²) is the distance where the two cross at a right angle, and grows otherwise by its gradient's length
        let far = length([a, b]);
        let slope = [0, 1].map(|i| (a * self.gradient[i] + b * other.gradient[i]) / far);
        let steep = length(slope).max(1e-6);
        Self { mm: (radius - far) / steep, gradient: slope.map(|s| s / steep) }
    }
}

/// A line with one smooth bend: in coordinates (u, v) about a point, `v = mean·u + half·(√(u² + width²) − width)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend {
    /// Where u = v = 0.
    at: Xz,
    /// Direction of u, of length 1; v is to its left.
    along: Xz,
    mean: f64,
    half: f64,
    width: f64,
}

impl Bend {
    /// The line whose bend lies about `at`, of slopes (v over u) `before` and `after` it, rounded over `width` mm.
    pub(super) fn new(at: Xz, along: Xz, before: f64, after: f64, width: f64) -> Self {
        let size = length(along);
        let along = along.map(|v| v / size);
        Self { at, along, mean: 0.5 * (before + after), half: 0.5 * (after - before), width }
    }

    /// The same, shifted across itself until it passes through `p`.
    pub(super) fn through(mut self, p: Xz) -> Self {
        let [u, v] = self.uv(p);
        let shift = v - self.v(u);
        self.at = [self.at[0] - shift * self.along[1], self.at[1] + shift * self.along[0]];
        self
    }

    /// Distance, positive on the left of the direction.
    pub(super) fn distance(&self, p: Xz) -> Distance {
        let [u, v] = self.uv(p);
        let slope = self.mean + self.half * u / length([u, self.width]);
        let size = length([slope, 1.0]);
        let (gu, gv) = (-slope / size, 1.0 / size);
        let [x, z] = self.along;
        Distance { mm: (v - self.v(u)) / size, gradient: [gu * x - gv * z, gu * z + gv * x] }
    }

    fn uv(&self, p: Xz) -> Xz {
        let d = minus(p, self.at);
        [dot(d, self.along), dot(d, [-self.along[1], self.along[0]])]
    }

    fn v(&self, u: f64) -> f64 {
        self.mean * u + self.half * (length([u, self.width]) - self.width)
    }
}

/// A closed outline about its own centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outline {
    /// Semi-axes along x and z, mm; a circle has equal ones.
    Ellipse([f64; 2]),
    /// Half the sides along x and z, and the corners' radius, mm.
    Rounded([f64; 2], f64),
}

impl Outline {
    /// Distance from `p` about the centre, positive outside.
    pub(super) fn distance(&self, p: Xz) -> Distance {
        match *self {
            Self::Ellipse([a, b]) => {
                let (unit, steep) = ([p[0] / a, p[1] / b], [p[0] / (a * a), p[1] / (b * b)]);
                let (k, slope) = (length(unit), length(steep).max(1e-9));
                Distance { mm: k * (k - 1.0) / slope, gradient: steep.map(|s| s / slope) }
            }
            Self::Rounded([a, b], r) => {
                let sign = p.map(f64::signum);
                let q = [p[0].abs() - a + r, p[1].abs() - b + r];
                if q[0] > 0.0 && q[1] > 0.0 {
                    let far = length(q);
                    Distance { mm: far - r, gradient: [sign[0] * q[0] / far, sign[1] * q[1] / far] }
                } else if q[0] > q[1] {
                    Distance { mm: q[0] - r, gradient: [sign[0], 0.0] }
                } else {
                    Distance { mm: q[1] - r, gradient: [0.0, sign[1]] }
                }
            }
        }
    }

    /// The same outline `by` mm smaller all round.
    pub(super) fn smaller(&self, by: f64) -> Self {
        match *self {
            Self::Ellipse(half) => Self::Ellipse(half.map(|h| h - by)),
            Self::Rounded(half, r) => Self::Rounded(half.map(|h| h - by), (r - by).max(1.0)),
        }
    }

    /// `n` points of it about the centre, in turn.
    pub(super) fn ring(&self, n: usize) -> Vec<Xz> {
        let on = |k: usize| {
            let (sin, cos) = (k as f64 / n as f64 * std::f64::consts::TAU).sin_cos();
            match *self {
                Self::Ellipse([a, b]) => [a * cos, b * sin],
                // each quarter of the turn goes round one corner
                Self::Rounded([a, b], r) => [(a - r).copysign(cos) + r * cos, (b - r).copysign(sin) + r * sin],
            }
        };
        (0..n).map(on).collect()
    }

    /// Half its extent along x and z, mm.
    pub(super) fn half(&self) -> [f64; 2] {
        match *self {
            Self::Ellipse(half) | Self::Rounded(half, _) => half,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The distance's gradient is its slope, of length 1 near the outline.
    fn is_a_distance(of: impl Fn(Xz) -> Distance, p: Xz) {
        let d = of(p);
        for i in 0..2 {
            let step = |h: f64| {
                let mut q = p;
                q[i] += h;
                of(q).mm
            };
            let slope = (step(1e-4) - step(-1e-4)) / 2e-4;
            assert!((slope - d.gradient[i]).abs() < 0.03, "{p:?}: {slope} for {:?}", d.gradient);
        }
        assert!((d.gradient[0].hypot(d.gradient[1]) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn distances_rise_by_one_mm_per_mm_near_their_outlines() {
        let bend = Bend::new([10.0, 20.0], [0.3, 0.9], -0.2, 0.3, 25.0).through([-30.0, 5.0]);
        assert!(bend.distance([-30.0, 5.0]).mm.abs() < 0.2, "shifted across itself");
        let ellipse = Outline::Ellipse([83.0, 78.0]);
        let box_ = Outline::Rounded([70.0, 60.0], 20.0);
        for k in 0..40 {
            let (sin, cos) = (f64::from(k) * 0.157).sin_cos();
            is_a_distance(|p| ellipse.distance(p), [84.0 * cos, 79.0 * sin]);
            let far = 58.0 / cos.abs().max(sin.abs()); // 2 mm inside the box, or at its corners
            is_a_distance(|p| box_.distance(p), [far * cos * 70.0 / 60.0, far * sin]);
            is_a_distance(|p| bend.distance(p), [bend.at[0] + 3.0 * cos, bend.at[1] + 3.0 * sin]);
        }
    }

    #[test]
    fn a_ring_lies_on_its_outline() {
        for outline in [Outline::Ellipse([83.0, 71.0]), Outline::Rounded([70.0, 60.0], 20.0)] {
            for p in outline.ring(50) {
                assert!(outline.distance(p).mm.abs() < 1e-9, "{outline:?} {p:?}");
            }
        }
    }

    #[test]
    fn a_rounded_corner_cuts_the_sharp_one_off_and_leaves_the_sides() {
        let side = |p: Xz| Distance { mm: p[0], gradient: [1.0, 0.0] };
        let top = |p: Xz| Distance { mm: 0.6 * p[0] + 0.8 * p[1], gradient: [0.6, 0.8] };
        let both = |p: Xz| side(p).and(top(p), 3.0);
        assert!(both([0.0, 0.0]).mm < -0.5, "the sharp corner is outside");
        assert_eq!(both([0.5, 40.0]).mm, 0.5);
        assert_eq!(both([40.0, -29.0]).mm, top([40.0, -29.0]).mm);
        is_a_distance(both, [1.0, 0.8]);
    }
}

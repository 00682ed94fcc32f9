//! Alignment of a measured contour to its template. In: measured edge points, the template, a first guess; mm, in
//! one metric plane. Out: the motion that lays the template onto the measurement, with covariance, or why there
//! is none. Not here: the coarse search, how the plane was found.
//!
//! Point-to-tangent distances to the nearest template point: Chen, Medioni, "Object modelling by registration of
//! multiple range images", Image and Vision Computing 10 (1992) 145. Tukey weights.

use super::buckets::Buckets;
use crate::geometry::robust::Weights;
use crate::lent::List;
use nalgebra::{Matrix3, Rotation2, SymmetricEigen, Vector2, Vector3};

/// A measured point of a contour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContourPoint {
    /// mm.
    pub position: Vector2<f64>,
    /// Across the edge, towards bright; unit length.
    pub normal: Vector2<f64>,
    /// Of the position along the normal, mm².
    pub variance: f64,
}

/// A point of a template.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemplatePoint {
    /// mm.
    pub position: Vector2<f64>,
    /// Across the edge, towards bright; unit length.
    pub normal: Vector2<f64>,
}

/// Where a template lies: `measured = R(theta)·template + shift`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// mm: where the template's origin lies.
    pub shift: Vector2<f64>,
    /// rad, from x towards y.
    pub theta: f64,
}

impl Motion {
    /// Where a point of the template lies.
    pub fn apply(&self, p: &Vector2<f64>) -> Vector2<f64> {
        Rotation2::new(self.theta) * p + self.shift
    }
}

/// How to align.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignmentOptions {
    /// Find the rotation too; otherwise it stays as guessed.
    pub rotate: bool,
    /// Distance (mm) within which a point may belong to the template: at first, and at last.
    pub capture: (f64, f64),
    /// Least ratio of the smallest to the largest eigenvalue of the information, 0..=1.
    pub stiffness: f64,
    /// Least share of the template that must be matched, 0..=1.
    pub share: f64,
}

impl Default for AlignmentOptions {
    /// Rotation too, 5 mm down to 1 mm, a fiftieth, half.
    fn default() -> Self {
        Self { rotate: true, capture: (5.0, 1.0), stiffness: 0.02, share: 0.5 }
    }
}

/// A template laid onto a measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// Where the template lies.
    pub motion: Motion,
    /// Of (shift x, shift y, theta), mm² and rad², from the stated variances alone; zero for a given rotation.
    pub covariance: Matrix3<f64>,
    /// The measured points that the alignment rests on, by index.
    pub used: List<usize>,
    /// Of each of them from the template, along its normal, mm.
    pub distances: List<f64>,
    /// Share of the template with such a point within the last capture distance, 0..=1.
    pub share: f64,
    /// Weighted root mean square of the distances, mm.
    pub rms: f64,
    /// Scatter of the distances over their stated sigmas, at least 1.
    pub scale: f64,
    /// Smallest over largest eigenvalue of the information about shift (and rotation, times the matched points'
    /// radius of gyration): 0 where the template slides, 1 where it is held alike in all directions.
    pub stiffness: f64,
}

/// Why a contour could not be aligned.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoAlignment {
    /// Fewer points near the template than 3 times the unknowns.
    #[error("{got} points near the template, at least {wanted} needed")]
    TooFewPoints {
        /// Points within the capture distance with an agreeing normal.
        got: usize,
        /// Needed.
        wanted: usize,
    },
    /// Too much of the template is not there.
    #[error("{:.0} % of the template matched, at least {:.0} % wanted", got * 100.0, wanted * 100.0)]
    Share {
        /// Share matched.
        got: f64,
        /// Share wanted.
        wanted: f64,
    },
    /// The template slides along what was measured.
    #[error(
        "the contour holds the template {got:.4} as firmly in its weakest direction as in its strongest, at least {wanted} wanted"
    )]
    Slides {
        /// Eigenvalue ratio.
        got: f64,
        /// Ratio wanted.
        wanted: f64,
    },
}

/// A step below which the motion is the last, mm: a hundredth of what the best contour is known to.
const STILL_MM: f64 = 1e-5;
/// Least cosine between the normals of a point and of the template point that it may belong to.
const AGREEING: f64 = 0.8;

/// Lays `template` onto `measured`, from `guess`.
///
/// The capture distance halves with each iteration down to the last. A quarter of outliers within it does not
/// matter. The template counts as straight between its points: with a spacing h on a radius ρ that costs h²/(24ρ)
/// towards the outside. The covariance takes the points' errors as independent.
pub fn align(
    template: &[TemplatePoint],
    measured: &[ContourPoint],
    guess: Motion,
    options: &AlignmentOptions,
) -> Result<Alignment, NoAlignment> {
    let (mut motion, mut capture) = (guess, options.capture.0);
    let places = Buckets::new(template.iter().map(|t| t.position), 0.25 * options.capture.1);
    let mut system = System::new(template, &places, measured, options.rotate);
    system.build(&motion, capture)?;
    for _ in 0..50 {
        let step = system.step();
        motion.shift += step.xy();
        motion.theta += step.z;
        let settled = capture <= options.capture.1;
        capture = (0.5 * capture).max(options.capture.1);
        system.build(&motion, capture)?;
        if settled && step.xy().norm() + (step.z * system.gyration).abs() < STILL_MM {
            break;
        }
    }
    let stiffness = system.stiffness();
    if stiffness < options.stiffness {
        return Err(NoAlignment::Slides { got: stiffness, wanted: options.stiffness });
    }
    let share = system.share(&motion, capture);
    if share < options.share {
        return Err(NoAlignment::Share { got: share, wanted: options.share });
    }
    let mut covariance =
        system.information.try_inverse().ok_or(NoAlignment::Slides { got: 0.0, wanted: options.stiffness })?;
    if !options.rotate {
        covariance[(2, 2)] = 0.0;
    }
    let squares: f64 = system.pairs.iter().map(|p| p.weight * p.distance * p.distance).sum();
    let weight: f64 = system.pairs.iter().map(|p| p.weight).sum();
    let used = || system.pairs.iter().filter(|p| p.weight > 0.0);
    Ok(Alignment {
        motion,
        covariance,
        used: List::of(used().map(|p| p.measured)),
        distances: List::of(used().map(|p| p.distance)),
        share,
        rms: (squares / weight).sqrt(),
        scale: system.weights.scale,
        stiffness,
    })
}

/// A measured point near the template.
struct Pair {
    measured: usize,
    /// From the tangent of its template point, mm; its sigma.
    distance: f64,
    sigma: f64,
    weight: f64,
    /// How it sees the unknowns.
    jacobian: Vector3<f64>,
    /// Its template point, turned.
    matched: Vector2<f64>,
}

/// The weighted normal equations at a motion; its lists are used again for the next.
struct System<'a> {
    template: &'a [TemplatePoint],
    /// The template's points.
    places: &'a Buckets,
    measured: &'a [ContourPoint],
    rotate: bool,
    /// The template, turned.
    arms: List<TemplatePoint>,
    /// By measured point: the nearest of the template when last looked, which few others can be nearer than.
    nearest: List<Option<usize>>,
    pairs: List<Pair>,
    weights: Weights,
    information: Matrix3<f64>,
    gradient: Vector3<f64>,
    /// Of the matched template points, from the template's origin, mm; their radius of gyration, mm.
    middle: Vector2<f64>,
    gyration: f64,
}

impl<'a> System<'a> {
    fn new(template: &'a [TemplatePoint], places: &'a Buckets, measured: &'a [ContourPoint], rotate: bool) -> Self {
        Self {
            template,
            places,
            measured,
            rotate,
            arms: List::new(),
            nearest: List::filled(None, measured.len()),
            pairs: List::new(),
            weights: Weights::default(),
            information: Matrix3::zeros(),
            gradient: Vector3::zeros(),
            middle: Vector2::zeros(),
            gyration: 0.0,
        }
    }

    fn build(&mut self, motion: &Motion, capture: f64) -> Result<(), NoAlignment> {
        let rotation = Rotation2::new(motion.theta);
        let turned = |t: &TemplatePoint| TemplatePoint { position: rotation * t.position, normal: rotation * t.normal };
        self.arms.clear();
        self.arms.extend(self.template.iter().map(turned));
        let (arms, places, rotate) = (&self.arms, self.places, self.rotate);
        let pair = |(i, (m, last)): (usize, (&ContourPoint, &mut Option<usize>))| {
            let p = m.position - motion.shift;
            let agrees = |k: &usize| arms[*k].normal.dot(&m.normal) > AGREEING;
            let radius = last.filter(agrees).map_or(capture, |k| (p - arms[k].position).norm().min(capture));
            let near = places.near(rotation.inverse_transform_vector(&p), radius).filter(agrees);
            let near = near.map(|k| ((p - arms[k].position).norm_squared(), k));
            // of equally near ones the first
            let nearest = near.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            *last = nearest.filter(|(d2, _)| *d2 <= capture * capture).map(|(_, k)| k);
            let k = (*last)?;
            let TemplatePoint { position: q, normal: n } = arms[k];
            let jacobian = Vector3::new(n.x, n.y, if rotate { q.perp(&n) } else { 0.0 });
            let (distance, sigma) = (n.dot(&(p - q)), m.variance.sqrt());
            Some(Pair { measured: i, distance, sigma, weight: 0.0, jacobian, matched: q })
        };
        self.pairs.clear();
        self.pairs.extend(self.measured.iter().zip(&mut *self.nearest).enumerate().filter_map(pair));
        let wanted = if rotate { 9 } else { 6 };
        if self.pairs.len() < wanted {
            return Err(NoAlignment::TooFewPoints { got: self.pairs.len(), wanted });
        }
        self.weights.weigh(self.pairs.iter().map(|p| p.distance / p.sigma));
        (self.information, self.gradient) = (Matrix3::zeros(), Vector3::zeros());
        for (pair, weight) in self.pairs.iter_mut().zip(&self.weights.weights) {
            pair.weight = *weight;
            let information = weight / (pair.sigma * pair.sigma);
            self.information += pair.jacobian * pair.jacobian.transpose() * information;
            self.gradient += pair.jacobian * (pair.distance * information);
        }
        if !rotate {
            self.information[(2, 2)] = 1.0;
        }
        let total: f64 = self.pairs.iter().map(|p| p.weight).sum();
        self.middle = self.pairs.iter().map(|p| p.matched * p.weight).sum::<Vector2<f64>>() / total;
        let square = |p: &Pair| (p.matched - self.middle).norm_squared() * p.weight;
        self.gyration = (self.pairs.iter().map(square).sum::<f64>() / total).sqrt();
        Ok(())
    }

    /// The information about the shift of the matched points' middle and their turn times the radius of gyration,
    /// all mm⁻², and the change of unknowns from there.
    fn balanced(&self) -> (SymmetricEigen<f64, nalgebra::Const<3>>, Matrix3<f64>) {
        let turn = if self.rotate { 1.0 / self.gyration } else { 0.0 };
        // shift of the origin = shift of the middle − turn × middle
        let to_origin = Matrix3::new(1.0, 0.0, self.middle.y * turn, 0.0, 1.0, -self.middle.x * turn, 0.0, 0.0, turn);
        (SymmetricEigen::new(to_origin.transpose() * self.information * to_origin), to_origin)
    }

    /// The Gauss–Newton step; none in directions that are a million times weaker than the strongest.
    fn step(&self) -> Vector3<f64> {
        let (eigen, to_origin) = self.balanced();
        let gradient = eigen.eigenvectors.transpose() * to_origin.transpose() * self.gradient;
        let limit = 1e-6 * eigen.eigenvalues.max();
        to_origin
            * eigen.eigenvectors
            * gradient.zip_map(&eigen.eigenvalues, |g, v| if v > limit { g / v } else { 0.0 })
    }

    fn stiffness(&self) -> f64 {
        let mut values: [f64; 3] = self.balanced().0.eigenvalues.into();
        values.sort_by(f64::total_cmp);
        values[if self.rotate { 0 } else { 1 }].max(0.0) / values[2]
    }

    fn share(&self, motion: &Motion, capture: f64) -> f64 {
        let used = self.pairs.iter().filter(|p| p.weight > 0.0);
        let rests = List::of(used.map(|p| self.measured[p.measured].position));
        let places = Buckets::new(rests.iter().copied(), capture);
        let seen = |t: &&TemplatePoint| {
            let q = motion.apply(&t.position);
            places.near(q, capture).any(|k| (rests[k] - q).norm_squared() <= capture * capture)
        };
        self.template.iter().filter(seen).count() as f64 / self.template.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;

    const SIGMA: f64 = 0.03;

    /// Points every `spacing` mm along legs (start, end) joined by arcs that turn right, as (position, normal).
    fn path(spacing: f64, legs: &[[[f64; 2]; 2]]) -> Vec<TemplatePoint> {
        let mut points = Vec::new();
        for (k, [a, b]) in legs.iter().enumerate() {
            let (a, b) = (Vector2::from(*a), Vector2::from(*b));
            let way = (b - a).normalize();
            let normal = Vector2::new(way.y, -way.x);
            let count = ((b - a).norm() / spacing) as usize;
            points.extend((0..count).map(|i| TemplatePoint { position: a + way * (spacing * i as f64), normal }));
            let Some([next, end]) = legs.get(k + 1) else { continue };
            let (next, end) = (Vector2::from(*next), Vector2::from(*end));
            let onward = (end - next).normalize();
            let radius = (next - b).norm() / (way - onward).norm(); // quarter turns
            let side = (next - b).dot(&normal).signum(); // of the arc's centre
            let centre = b + normal * (side * radius);
            let steps = (radius * 0.5 * std::f64::consts::PI / spacing) as usize;
            points.extend((0..steps).map(|i| {
                let turn = Rotation2::new(-side * 0.5 * std::f64::consts::PI * i as f64 / steps as f64);
                TemplatePoint { position: centre - turn * normal * (side * radius), normal: turn * normal }
            }));
        }
        points
    }

    fn corner(spacing: f64) -> Vec<TemplatePoint> {
        path(spacing, &[[[-6.0, 40.0], [-6.0, 6.0]], [[0.0, 0.0], [40.0, 0.0]]])
    }

    fn ring(spacing: f64) -> Vec<TemplatePoint> {
        let (w, h, r) = (60.0, 40.0, 15.0);
        path(
            spacing,
            &[
                [[-w, h + r], [w, h + r]],
                [[w + r, h], [w + r, -h]],
                [[w, -h - r], [-w, -h - r]],
                [[-w - r, -h], [-w - r, h]],
                [[-w, h + r], [-w + 1.0, h + r]],
            ],
        )
    }

    /// A shape as measured: moved, noisy, every fourth point 0.3 to 0.8 mm off if so wished.
    fn measure(shape: &[TemplatePoint], truth: &Motion, outliers: bool, noise: &mut Noise) -> Vec<ContourPoint> {
        let point = |(k, t): (usize, &TemplatePoint)| {
            let normal = Rotation2::new(truth.theta) * t.normal;
            let off = if outliers && k % 4 == 0 { 0.3 + 0.5 * noise.uniform() } else { 0.0 };
            let position = truth.apply(&t.position) + normal * (SIGMA * noise.gauss() + off);
            ContourPoint { position, normal, variance: SIGMA * SIGMA }
        };
        shape.iter().enumerate().map(point).collect()
    }

    const TRUTH: Motion = Motion { shift: Vector2::new(1.3, -0.9), theta: 0.03 };

    /// Root mean square error in sigmas per unknown, and in mm.
    fn errors(shape: fn(f64) -> Vec<TemplatePoint>, options: &AlignmentOptions, outliers: bool) -> (f64, f64) {
        let (mut noise, trials, template) = (Noise::new(21), 500, shape(0.5));
        let guess = if options.rotate { Motion::default() } else { Motion { theta: TRUTH.theta, ..Motion::default() } };
        let (mut in_sigmas, mut in_mm) = (0.0, 0.0);
        for _ in 0..trials {
            let got = align(&template, &measure(&shape(0.43), &TRUTH, outliers, &mut noise), guess, options);
            let got = got.expect("an alignment");
            assert!(got.share > 0.95 && got.rms < 1.5 * SIGMA, "{got:?}");
            let shift = got.motion.shift - TRUTH.shift;
            in_mm += shift.norm_squared() / 2.0;
            in_sigmas += if options.rotate {
                let error = shift.push(got.motion.theta - TRUTH.theta);
                (error.transpose() * got.covariance.try_inverse().expect("regular") * error)[0] / 3.0
            } else {
                let covariance = got.covariance.fixed_view::<2, 2>(0, 0).into_owned();
                assert!(got.covariance[(2, 2)] == 0.0 && got.motion.theta == TRUTH.theta);
                (shift.transpose() * covariance.try_inverse().expect("regular") * shift)[0] / 2.0
            };
        }
        ((in_sigmas / f64::from(trials)).sqrt(), (in_mm / f64::from(trials)).sqrt())
    }

    #[test]
    fn a_planted_motion_is_recovered_with_a_true_covariance() {
        let (free, given) = (AlignmentOptions::default(), AlignmentOptions { rotate: false, ..Default::default() });
        for (name, shape) in [("corner", corner as fn(f64) -> Vec<TemplatePoint>), ("ring", |h| ring(2.0 * h))] {
            for options in [&free, &given] {
                let (sigmas, mm) = errors(shape, options, false);
                eprintln!("{name}, rotate {}: {sigmas:.3} sigmas, {mm:.4} mm", options.rotate);
                assert!((0.9..1.1).contains(&sigmas) && mm < 0.012, "{name}: {sigmas} {mm}");
            }
        }
    }

    #[test]
    fn a_quarter_of_outliers_hardly_matters() {
        for shape in [corner as fn(f64) -> Vec<TemplatePoint>, |h| ring(2.0 * h)] {
            let (sigmas, mm) = errors(shape, &AlignmentOptions::default(), true);
            eprintln!("25 % off by 0.3 to 0.8 mm: {sigmas:.3} sigmas, {mm:.4} mm");
            assert!(sigmas < 1.3 && mm < 0.016, "{sigmas} {mm}");
        }
    }

    #[test]
    fn a_search_that_begins_where_it_last_ended_finds_what_a_first_one_finds() {
        let (template, mut noise, capture) = (corner(0.5), Noise::new(8), 5.0);
        let places = Buckets::new(template.iter().map(|t| t.position), 0.25);
        let measured = measure(&corner(0.43), &TRUTH, true, &mut noise);
        let mut again = System::new(&template, &places, &measured, true);
        again.build(&TRUTH, capture).expect("matched");
        for (x, y, theta) in [(3.4, -2.9, 0.0), (-1.2, 1.6, 0.05), (1.2, -0.8, 0.03)] {
            let motion = Motion { shift: Vector2::new(x, y), theta };
            let mut first = System::new(&template, &places, &measured, true);
            first.build(&motion, capture).expect("matched");
            again.build(&motion, capture).expect("matched");
            let pairs = |system: &System| -> Vec<_> {
                system.pairs.iter().map(|p| (p.measured, p.matched, p.distance)).collect()
            };
            assert!(first.pairs.len() > measured.len() / 2, "{} matched", first.pairs.len());
            assert_eq!(pairs(&again), pairs(&first), "moved to {x} {y} {theta}");
        }
    }

    #[test]
    fn a_straight_line_is_refused_and_so_is_too_little() {
        let mut noise = Noise::new(4);
        let line = |spacing| path(spacing, &[[[-40.0, 0.0], [40.0, 0.0]]]);
        for rotate in [true, false] {
            let options = AlignmentOptions { rotate, ..Default::default() };
            let refused = align(&line(0.25), &measure(&line(0.31), &TRUTH, false, &mut noise), TRUTH, &options);
            assert!(matches!(refused, Err(NoAlignment::Slides { got, .. }) if got < 1e-6), "{refused:?}");
        }
        let few = measure(&corner(12.0), &TRUTH, false, &mut noise);
        let options = AlignmentOptions::default();
        assert_eq!(
            align(&corner(0.25), &few, TRUTH, &options),
            Err(NoAlignment::TooFewPoints { got: few.len(), wanted: 9 })
        );
        let part: Vec<_> =
            measure(&ring(0.31), &TRUTH, false, &mut noise).into_iter().filter(|p| p.position.x > 30.0).collect();
        let refused = align(&ring(0.25), &part, TRUTH, &AlignmentOptions { share: 0.7, ..options });
        assert!(matches!(refused, Err(NoAlignment::Share { got, .. }) if (0.3..0.5).contains(&got)), "{refused:?}");
    }
}

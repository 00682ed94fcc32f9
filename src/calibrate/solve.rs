//! From sightings of a board to the lenses that saw it. In: where camera and projector see each point in each view. Out:
//! the lenses and their places with a covariance, residuals, what each view says of the others; or why not.
//! Not here: images, files.
//!
//! A point or a view that belies all the others is left out. Each view is predicted from the others (leave-one-out), since
//! the residual of a fit flatters it. A distortion term stays only if it explains more than chance (a likelihood ratio) and
//! does those predictions no harm: residuals are not independent (paper, print, lamp), so the first test alone keeps
//! terms that follow one board's bend.

use super::adjust::{Device, OF_DEVICE, Problem, SHARED, Seen, State};
use super::file::ParameterCovariance;
use super::guidance::{Coverage, coverage};
use super::triangulated::{BoardFit, triangulated};
use super::{Homography, start};
use crate::geometry::robust::{mad_sigma, median};
use crate::geometry::{Point3, Pose, frame};
use crate::optics::{Lens, Rig};
use nalgebra::{SMatrix, Vector2, Vector3};
use rayon::prelude::*;

/// One board as camera and projector see it.
#[derive(Clone, Debug)]
pub struct View {
    /// For messages and reports.
    pub name: String,
    /// Points seen by the camera, and by the projector.
    pub seen: [Vec<Seen>; 2],
}

/// A solved calibration.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Camera, and projector if one was calibrated.
    pub devices: Vec<Device>,
    /// Identity without a projector.
    pub projector_from_camera: Pose<frame::Projector, frame::Camera>,
    /// Of the shared parameters, in px, rad and mm: of each device fx, fy, cx, cy, k1, k2, p1, p2, k3, skew, then the left
    /// rotation vector and the translation between them.
    pub covariance: SMatrix<f64, SHARED, SHARED>,
    /// Reprojection errors of used points, px (root mean square of distances): camera, projector, both.
    pub rms_px: [f64; 3],
    /// In the order given.
    pub views: Vec<ViewReport>,
    /// Reprojection error in the camera of boards predicted by the others alone, px.
    pub leave_one_out_rms_px: Option<f64>,
}

impl Solution {
    /// The rig, if there is a projector.
    pub fn rig(&self) -> Option<Rig> {
        rig(&self.devices, &self.projector_from_camera)
    }

    /// Covariance of [`super::PARAMETERS`], without the skew.
    pub fn parameter_covariance(&self) -> ParameterCovariance {
        let at = |k: usize| k + usize::from(k >= 9) + usize::from(k >= 18); // each device's skew comes last
        ParameterCovariance::from_fn(|i, j| self.covariance[(at(i), at(j))])
    }

    /// Standard deviation of the camera's skew, px; 0 where it was not free.
    pub fn skew_sigma(&self) -> f64 {
        self.covariance[(SKEW, SKEW)].sqrt()
    }

    /// What the views show of the camera's field.
    pub fn coverage(&self) -> Coverage {
        let lens = &self.devices[0].lens;
        let used = self.views.iter().filter(|v| v.used);
        let views: Vec<_> = used.map(|v| (v.seen.as_slice(), v.camera_from_board)).collect();
        coverage((lens.width, lens.height), &views)
    }

    /// Mean distance of the boards' points along the camera's axis, mm.
    pub fn working_distance_mm(&self, board: &[Vector2<f64>]) -> f64 {
        let used = self.views.iter().filter(|v| v.used);
        let of = |v: &ViewReport| {
            let points = board.iter().map(|p| (v.camera_from_board * Point3::new(p.push(0.0))).xyz.z);
            points.sum::<f64>() / board.len() as f64
        };
        let all: Vec<f64> = used.map(of).collect();
        all.iter().sum::<f64>() / all.len() as f64
    }
}

/// What became of one view.
#[derive(Clone, Debug)]
pub struct ViewReport {
    /// As given.
    pub name: String,
    /// Whether it took part.
    pub used: bool,
    /// Points left out of it.
    pub rejected: usize,
    /// The camera's points that took part.
    pub seen: Vec<Seen>,
    /// Of camera and projector, px.
    pub rms_px: [f64; 2],
    /// Its board.
    pub camera_from_board: Pose<frame::Camera, frame::Board>,
    /// Its board triangulated by a calibration that it had no part in.
    pub held_out: Option<BoardFit>,
}

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unsolved {
    /// Too few boards.
    #[error("{got} usable views, at least {MIN_VIEWS} are needed: take more, each with the board tilted another way")]
    TooFewViews {
        /// Views with enough points.
        got: usize,
    },
    /// Boards that are parallel to the sensor, or to each other.
    #[error(
        "the views do not determine the focal length ({found}): take at least three more with the board tilted by \
         20° to 40° about its horizontal and about its vertical axis"
    )]
    Frontal {
        /// What is known of it, or of the tilts.
        found: String,
    },
    /// The adjustment did not converge.
    #[error("the adjustment does not converge: are all views of one board, and is --board right?")]
    Diverged,
    /// No projector can be found that lights the points.
    #[error("the projector cannot be located from {got} points: are column and row fringes of the same captures?")]
    NoProjector {
        /// Points with projector coordinates.
        got: usize,
    },
}

/// Fewer boards cannot be held against each other: with one left out, the rest must still fix the lens, with a check.
pub const MIN_VIEWS: usize = 4;
/// What remains when one is left out.
const MIN_OTHERS: usize = 3;
/// Boards that both devices must see: fewer leave the projector's lens to chance.
const MIN_LIT: usize = 3;
/// A board with fewer points tells too little of its own pose.
const MIN_POINTS: usize = 12;
/// Boards nearer to parallel than that, all of them, tell no focal length, degrees.
const MIN_ANGLE_DEG: f64 = 5.0;
/// Standard deviation of the focal length, as a share of it, beyond which a calibration is none.
const MAX_FOCAL_SIGMA: f64 = 0.01;
/// A point farther off than this many robust sigmas of its view or device is left out.
const OUTLIER_SIGMAS: f64 = 6.0;
/// A view that scatters so many times as much as the median view is left out.
const OUTLIER_VIEW: f64 = 3.0;
/// Residuals that are no reason to leave anything out, px: a printed board is not better than that. Of a point (as a
/// sigma) and of a view.
const HARMLESS: [f64; 2] = [0.02, 0.07];
/// What a point is off by in all views alike, 1 sigma, px: print, paper, the blur's shape, what fringes do at an edge. No
/// residual shows it, so no sigma is less. Ten rendered boards leave residuals of 0.01 px, and a baseline and lenses that
/// are off, together, by what residuals of 0.05 px would explain.
const SHARED_PX: f64 = 0.05;
/// How far a distortion term (k1, k2, p1, p2, k3) that was not kept may be from 0, 1 sigma: what lenses of machine vision
/// have. Where the views say more, that counts.
const PRESUMED: [f64; 5] = [0.1, 0.1, 0.001, 0.001, 0.1];
/// The same of a principal point left at the centre, as a share of the longer side: how sensors are mounted.
const PRESUMED_CENTRE: f64 = 0.02;
/// What a term must explain to stay: the chi² of one parameter, or of two, that chance exceeds once in 20 times.
const CHANCE: [f64; 2] = [3.84, 5.99];
/// A term that makes predictions of left-out views worse by this share does not stay, whatever it explains.
const HARMS: f64 = 0.005;

/// Parameter indices within a device.
const FOCAL: [usize; 2] = [0, 1];
const CENTRE: [usize; 2] = [2, 3];
const K1: usize = 4;
const K2: usize = 5;
const P: [usize; 2] = [6, 7];
const K3: usize = 8;
const SKEW: usize = 9;

/// Which terms beyond the pinhole are calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Terms {
    /// Of k1, k2, p1 and p2, k3 of each device those that earn their place.
    Chosen,
    /// k1, k2, p1, p2, k3 of each device.
    All,
    /// k1, k2, and skew if it earns its place: the model of Zhang's paper, for given correspondences.
    Zhang,
}

/// Calibrates the camera, and the projector if `sizes` has one, from `views` of `board`. `sizes`: width and height, px.
pub fn solve(
    board: &[Vector2<f64>],
    views: &[View],
    sizes: [Option<(usize, usize)>; 2],
    terms: Terms,
) -> Result<Solution, Unsolved> {
    let mut work = Work::start(board, views, sizes, terms)?;
    work.settle()?;
    match terms {
        Terms::All => {}
        Terms::Chosen => work.choose_terms()?,
        Terms::Zhang => work.drop_idle_skew()?,
    }
    let angle = work.widest_angle_deg();
    if angle < MIN_ANGLE_DEG {
        return Err(Unsolved::Frontal { found: format!("the boards lie within {angle:.1}° of each other") });
    }
    let held_out = work.held_out();
    let covariance = work.covariance(work.excess(&held_out).unwrap_or(1.0))?;
    for (d, name) in (0..work.state.devices.len()).zip(["camera", "projector"]) {
        let (fx, at) = (work.state.devices[d].lens.fx, d * OF_DEVICE);
        let sigma = covariance[(at, at)].sqrt() / fx;
        if sigma.is_nan() || sigma > MAX_FOCAL_SIGMA {
            return Err(Unsolved::Frontal { found: format!("the {name}'s: {fx:.0} px ± {:.1} %", 100.0 * sigma) });
        }
    }
    Ok(work.report(views, &held_out, covariance))
}

/// What the others say of one view.
struct HeldOut {
    residuals: [Vec<Vector2<f64>>; 2],
    fit: Option<BoardFit>,
    /// Of the others.
    state: State,
}

type ProjectorFromCamera = Pose<frame::Projector, frame::Camera>;

/// A calibration in progress.
#[derive(Clone)]
struct Work<'a> {
    terms: Terms,
    board: &'a [Vector2<f64>],
    /// What is still believed of each view.
    seen: Vec<[Vec<Seen>; 2]>,
    free: [bool; SHARED],
    sigma: [f64; 2],
    state: State,
}

impl<'a> Work<'a> {
    fn start(
        board: &'a [Vector2<f64>],
        views: &[View],
        sizes: [Option<(usize, usize)>; 2],
        terms: Terms,
    ) -> Result<Self, Unsolved> {
        let map = |v: &View| {
            let pairs: Vec<_> = v.seen[0].iter().map(|&(k, at)| (board[k], at)).collect();
            if pairs.len() >= MIN_POINTS { Homography::fit(&pairs) } else { None }
        };
        let maps: Vec<Option<Homography>> = views.iter().map(map).collect();
        let known: Vec<Homography> = maps.iter().flatten().copied().collect();
        if known.len() < MIN_VIEWS {
            return Err(Unsolved::TooFewViews { got: known.len() });
        }
        let size = sizes[0].expect("there is always a camera");
        let frontal = || Unsolved::Frontal { found: "the boards are parallel to each other".into() };
        let lens = start::camera(&known, size).ok_or_else(frontal)?;
        let away = Pose::new(nalgebra::Rotation3::identity(), Vector3::new(0.0, 0.0, 1.0));
        let poses: Vec<_> =
            maps.iter().map(|m| m.as_ref().and_then(|m| start::pose(&lens, m)).unwrap_or(away)).collect();
        let seen: Vec<[Vec<Seen>; 2]> = views
            .iter()
            .zip(&maps)
            .map(|(v, m)| if m.is_some() { [v.seen[0].clone(), Vec::new()] } else { Default::default() })
            .collect();
        let mut work = Self {
            terms,
            board,
            seen,
            free: std::array::from_fn(|k| FOCAL.contains(&k) || CENTRE.contains(&k)),
            sigma: [1.0; 2],
            state: State {
                devices: vec![Device { lens, skew: 0.0 }],
                projector_from_camera: Pose::identity(),
                camera_from_board: poses,
            },
        };
        let stages: [&[usize]; 3] = [&[], &[K1, K2], if terms == Terms::Zhang { &[SKEW] } else { &[P[0], P[1], K3] }];
        for stage in stages {
            stage.iter().for_each(|&t| work.free[t] = true);
            work.adjust()?;
        }
        let Some(size) = sizes[1] else { return Ok(work) };
        work.reject();
        work.adjust()?;
        for (mine, (v, m)) in work.seen.iter_mut().zip(views.iter().zip(&maps)) {
            if m.is_some() && v.seen[1].len() >= MIN_POINTS {
                mine[1].clone_from(&v.seen[1]);
            }
        }
        let (lens, place) = work.start_projector(size)?;
        work.state.devices.push(Device { lens, skew: 0.0 });
        work.state.projector_from_camera = place;
        work.free[2 * OF_DEVICE..].fill(true);
        for stage in [&[FOCAL, CENTRE].concat(), stages[1], stages[2]] {
            stage.iter().for_each(|&t| work.free[OF_DEVICE + t] = true);
            work.adjust()?;
        }
        Ok(work)
    }

    /// A projector that agrees with most views: of those from all, and from all but one, the one with the least median over
    /// the views of their rms. What a view's fringes say that is nowhere near it (an order that is wrong all over, rows and
    /// columns mixed up) is left out.
    fn start_projector(&mut self, size: (usize, usize)) -> Result<(Lens, ProjectorFromCamera), Unsolved> {
        let lit: Vec<usize> = (0..self.seen.len()).filter(|&v| !self.seen[v][1].is_empty()).collect();
        let got = lit.iter().map(|&v| self.seen[v][1].len()).sum();
        let without = |out: Option<usize>| {
            let seen = |v: usize| if out == Some(v) { &[][..] } else { self.seen[v][1].as_slice() };
            let seen: Vec<&[Seen]> = (0..self.seen.len()).map(seen).collect();
            let (lens, place) = start::projector(self.board, &self.state.camera_from_board, &seen, size)?;
            let off = |v: usize| {
                let pose = place * self.state.camera_from_board[v];
                let off = |&(k, at): &Seen| {
                    let p = pose * Point3::new(self.board[k].push(0.0));
                    lens.project(&p.xyz).map_or(Vector2::repeat(f64::INFINITY), |q| at - q)
                };
                rms(&self.seen[v][1].iter().map(off).collect::<Vec<_>>())
            };
            let off: Vec<f64> = lit.iter().map(|&v| off(v)).collect();
            Some((median(&mut off.clone()), off, lens, place))
        };
        let starts = std::iter::once(None).chain(lit.iter().map(|&v| Some(v))).filter_map(without);
        let best = starts.min_by(|a, b| a.0.total_cmp(&b.0)).ok_or(Unsolved::NoProjector { got })?;
        let (typical, off, lens, place) = best;
        let near = |off: f64| off <= 10.0 * typical + 5.0;
        if off.iter().filter(|o| near(**o)).count() < MIN_LIT {
            return Err(Unsolved::NoProjector { got });
        }
        for (&v, off) in lit.iter().zip(off) {
            if !near(off) {
                self.seen[v][1].clear();
            }
        }
        Ok((lens, place))
    }

    fn problem(&self) -> Problem<'_> {
        Problem { board: self.board, views: &self.seen, free: self.free, sigma: self.sigma }
    }

    fn adjust(&mut self) -> Result<(), Unsolved> {
        self.state = self.problem().adjust(self.state.clone()).ok_or(Unsolved::Diverged)?;
        Ok(())
    }

    /// Of the shared parameters. `excess`: see [`Self::excess`].
    fn covariance(&self, excess: f64) -> Result<SMatrix<f64, SHARED, SHARED>, Unsolved> {
        let mut presumed = [0.0; SHARED];
        for (d, device) in self.state.devices.iter().enumerate().filter(|_| self.terms == Terms::Chosen) {
            (K1..=K3).for_each(|k| presumed[d * OF_DEVICE + k] = PRESUMED[k - K1]);
            let side = device.lens.width.max(device.lens.height) as f64;
            CENTRE.iter().for_each(|k| presumed[d * OF_DEVICE + k] = PRESUMED_CENTRE * side);
        }
        let sigma = self.sigma.map(|s| (s * excess.max(1.0).sqrt()).max(SHARED_PX));
        Problem { sigma, ..self.problem() }.covariance(&self.state, &presumed).ok_or(Unsolved::Diverged)
    }

    /// Adjusts, weighs the devices by what they leave, leaves out what belies the rest, until neither changes anything.
    fn settle(&mut self) -> Result<(), Unsolved> {
        for _ in 0..10 {
            self.adjust()?;
            let before = self.sigma;
            self.weigh();
            let still = (0..self.state.devices.len()).all(|d| (self.sigma[d] / before[d] - 1.0).abs() < 1e-3);
            if !self.reject() && still {
                return self.adjust();
            }
            let left = self.seen.iter().filter(|s| !s[0].is_empty()).count();
            if left < MIN_VIEWS {
                return Err(Unsolved::TooFewViews { got: left });
            }
            let lit = self.seen.iter().filter(|s| !s[1].is_empty()).count();
            if self.state.devices.len() > 1 && lit < MIN_LIT {
                return Err(Unsolved::NoProjector { got: self.seen.iter().map(|s| s[1].len()).sum() });
            }
        }
        self.adjust()
    }

    /// The widest angle between two boards.
    fn widest_angle_deg(&self) -> f64 {
        let used = self.state.camera_from_board.iter().zip(&self.seen).filter(|(_, s)| !s[0].is_empty());
        let normals: Vec<Vector3<f64>> = used.map(|(pose, _)| pose.r.matrix().column(2).into_owned()).collect();
        let pairs = normals.iter().flat_map(|a| normals.iter().map(move |b| a.angle(b)));
        pairs.fold(0.0, f64::max).to_degrees()
    }

    fn residuals(&self) -> Vec<[Vec<Vector2<f64>>; 2]> {
        self.problem().residuals(&self.state).expect("an adjusted state projects every point")
    }

    /// Each device's sigma from its residuals, less the degrees of freedom that the fit took.
    fn weigh(&mut self) {
        let residuals = self.residuals();
        let count = |d: usize| residuals.iter().map(|r| r[d].len()).sum::<usize>() as f64;
        let views = self.seen.iter().filter(|s| !s[0].is_empty()).count();
        let parameters = self.free.iter().filter(|f| **f).count() + 6 * views;
        let all = 2.0 * (count(0) + count(1));
        let kept = (1.0 - parameters as f64 / all).max(0.1);
        for d in 0..self.state.devices.len() {
            let square: f64 = residuals.iter().flat_map(|r| &r[d]).map(|r| r.norm_squared()).sum();
            self.sigma[d] = (square / (2.0 * count(d) * kept)).sqrt().max(1e-9);
        }
    }

    /// Leaves out points and views that belie the rest; whether there were any.
    fn reject(&mut self) -> bool {
        let residuals = self.residuals();
        let before: usize = self.seen.iter().flatten().map(Vec::len).sum();
        for d in 0..self.state.devices.len() {
            let scatter = |r: &[Vec<Vector2<f64>>; 2]| mad_sigma(r[d].iter().flat_map(|r| [r.x, r.y]));
            let mut of_views: Vec<f64> = residuals.iter().filter(|r| !r[d].is_empty()).map(scatter).collect();
            let bad_view = (OUTLIER_VIEW * median(&mut of_views)).max(HARMLESS[1]);
            let sigma = mad_sigma(residuals.iter().flat_map(|r| r[d].iter().flat_map(|r| [r.x, r.y]))).max(HARMLESS[0]);
            for (seen, r) in self.seen.iter_mut().zip(&residuals) {
                let own = scatter(r);
                if own > bad_view {
                    // what spoils the camera's points spoils the board's pose
                    seen[d..].iter_mut().for_each(Vec::clear);
                    continue;
                }
                // a board that is printed or lit less well than the others is not made of outliers
                let mut good = r[d].iter().map(|r| r.norm() <= OUTLIER_SIGMAS * own.max(sigma));
                seen[d].retain(|_| good.next().expect("one residual per point"));
                if seen[d].len() < MIN_POINTS {
                    seen[d..].iter_mut().for_each(Vec::clear);
                }
            }
        }
        before != self.seen.iter().flatten().map(Vec::len).sum::<usize>()
    }

    /// Starts from a pinhole camera with its principal point at the centre and a pinhole projector, and frees what earns its
    /// place, the term that predicts best first: the camera's principal point, p1 and p2 together, radial terms in their
    /// order. (A projector's principal point is far off its centre by design.)
    fn choose_terms(&mut self) -> Result<(), Unsolved> {
        let devices = self.state.devices.len();
        let excess = self.excess(&self.held_out()).unwrap_or(1.0).max(1.0);
        for k in (0..devices).flat_map(|d| (K1..=K3).map(move |k| d * OF_DEVICE + k)).chain(CENTRE) {
            self.fix(k);
        }
        self.adjust()?; // the sigmas stay those of all terms: the scale by which every choice is judged
        let mut least = self.prediction_error();
        loop {
            let mut best: Option<(f64, Self)> = None;
            for term in self.next_terms() {
                let mut with = self.clone();
                term.iter().for_each(|&k| with.free[k] = true);
                // what cannot be determined has not earned its place
                if with.adjust().is_err() {
                    continue;
                }
                // p1, p2 and the principal point trade against boards' tilts: residuals that belong together fake them
                let doubt = if term.len() > 1 { excess } else { 1.0 };
                if self.misfit() - with.misfit() < doubt * CHANCE[term.len() - 1] {
                    continue;
                }
                let e = with.prediction_error();
                if e < best.as_ref().map_or(least * (1.0 + HARMS), |b| b.0) {
                    best = Some((e, with));
                }
            }
            let Some((e, with)) = best else { break };
            (least, *self) = (least.min(e), with);
        }
        self.settle()
    }

    /// Chi² of the residuals.
    fn misfit(&self) -> f64 {
        self.chi2(&self.residuals())
    }

    fn chi2(&self, residuals: &[[Vec<Vector2<f64>>; 2]]) -> f64 {
        let square = |d: usize| residuals.iter().flat_map(|r| &r[d]).map(|r| r.norm_squared()).sum::<f64>();
        (0..2).map(|d| square(d) / self.sigma[d].powi(2)).sum()
    }

    /// The terms that may be freed next, by their parameters.
    fn next_terms(&self) -> Vec<Vec<usize>> {
        let mut terms = Vec::new();
        for first in (0..self.state.devices.len()).map(|d| d * OF_DEVICE) {
            terms.extend([K1, K2, K3].into_iter().map(|k| first + k).find(|&k| !self.free[k]).map(|k| vec![k]));
            for pair in [CENTRE, P].map(|p| p.map(|k| first + k)) {
                terms.extend((!self.free[pair[0]]).then(|| pair.to_vec()));
            }
        }
        terms
    }

    fn drop_idle_skew(&mut self) -> Result<(), Unsolved> {
        let variance = self.covariance(1.0)?[(SKEW, SKEW)];
        if self.state.devices[0].skew.powi(2) < CHANCE[0] * variance {
            self.fix(SKEW);
            self.settle()?;
        }
        Ok(())
    }

    /// Fixes a distortion term or a skew at zero, the principal point at the centre.
    fn fix(&mut self, k: usize) {
        self.free[k] = false;
        let Device { lens, skew } = &mut self.state.devices[k / OF_DEVICE];
        match k % OF_DEVICE {
            2 => lens.cx = (lens.width as f64 - 1.0) / 2.0,
            3 => lens.cy = (lens.height as f64 - 1.0) / 2.0,
            SKEW => *skew = 0.0,
            term => lens.distortion[term - K1] = 0.0,
        }
    }

    /// Root mean square over all views of their residuals as predicted by the others, in sigmas of each device; of the fit
    /// itself where there are too few views to leave one out.
    fn prediction_error(&self) -> f64 {
        let held_out = self.held_out();
        if held_out.iter().zip(&self.seen).any(|(h, s)| h.is_none() && !s[0].is_empty()) {
            return f64::INFINITY; // it hangs on one view
        }
        let residuals: Vec<_> = if held_out.is_empty() {
            self.residuals()
        } else {
            held_out.into_iter().flatten().map(|h| h.residuals).collect()
        };
        let count: usize = residuals.iter().flatten().map(Vec::len).sum();
        (self.chi2(&residuals) / count as f64).sqrt()
    }

    fn report(
        &self,
        views: &[View],
        held_out: &[Option<HeldOut>],
        covariance: SMatrix<f64, SHARED, SHARED>,
    ) -> Solution {
        let state = &self.state;
        let residuals = self.residuals();
        let all = |d: usize| residuals.iter().flat_map(|r| &r[d]).copied().collect::<Vec<_>>();
        let [camera, projector] = [all(0), all(1)];
        let report = |(v, view): (usize, &View)| ViewReport {
            name: view.name.clone(),
            used: !self.seen[v][0].is_empty(),
            rejected: (0..state.devices.len()).map(|d| view.seen[d].len() - self.seen[v][d].len()).sum(),
            seen: self.seen[v][0].clone(),
            rms_px: [rms(&residuals[v][0]), rms(&residuals[v][1])],
            camera_from_board: state.camera_from_board[v],
            held_out: held_out.get(v).and_then(|h| h.as_ref()?.fit),
        };
        let out: Vec<Vector2<f64>> = held_out.iter().flatten().flat_map(|h| h.residuals[0].clone()).collect();
        Solution {
            devices: state.devices.clone(),
            projector_from_camera: state.projector_from_camera,
            covariance,
            rms_px: [rms(&camera), rms(&projector), rms(&[camera, projector].concat())],
            views: views.iter().enumerate().map(report).collect(),
            leave_one_out_rms_px: (!out.is_empty()).then(|| rms(&out)),
        }
    }

    /// How much more (in variance) the parameters scatter as one view after the other is left out than independent residuals
    /// would let them: a board's print, its bend and the light on it shift all points of a view together. The jackknife
    /// (Efron, Stein, Annals of Statistics 9 (1981) 586), in units of what it would show of independent residuals.
    fn excess(&self, held_out: &[Option<HeldOut>]) -> Option<f64> {
        let known = held_out.iter().enumerate().filter_map(|(v, h)| Some((v, &h.as_ref()?.state)));
        let (found, expected) = self.problem().linearised(&self.state)?.shifts(&known.collect::<Vec<_>>())?;
        (expected > 0.0).then(|| found / expected)
    }

    /// Each view by a calibration from the others: the residuals once its board's pose alone is fitted, and its board as
    /// camera and projector triangulate it. Empty where too few others are left; `None` where they determine nothing.
    fn held_out(&self) -> Vec<Option<HeldOut>> {
        let (problem, used) = (self.problem(), self.seen.iter().filter(|s| !s[0].is_empty()).count());
        let Some(all) = problem.linearised(&self.state).filter(|_| used > MIN_OTHERS) else { return Vec::new() };
        let without = |v: usize| -> Option<HeldOut> {
            if self.seen[v][0].is_empty() {
                return None;
            }
            let state = all.without(v)?;
            let alone = [self.seen[v].clone()];
            let one = State { camera_from_board: vec![state.camera_from_board[v]], ..state.clone() };
            let problem = Problem { views: &alone, free: [false; SHARED], ..self.problem() };
            let residuals = problem.residuals(&problem.adjust(one)?)?.remove(0);
            let fit = rig(&state.devices, &state.projector_from_camera)
                .and_then(|rig| triangulated(&rig, self.board, &self.seen[v][0], &self.seen[v][1]));
            Some(HeldOut { residuals, fit, state })
        };
        (0..self.seen.len()).into_par_iter().map(without).collect()
    }
}

fn rig(devices: &[Device], projector_from_camera: &Pose<frame::Projector, frame::Camera>) -> Option<Rig> {
    let [camera, projector] = devices else { return None };
    let (camera, projector) = (camera.lens.clone(), projector.lens.clone());
    Some(Rig { camera, projector, projector_from_camera: *projector_from_camera })
}

/// Root mean square length; 0 of nothing.
fn rms(residuals: &[Vector2<f64>]) -> f64 {
    (residuals.iter().map(|r| r.norm_squared()).sum::<f64>() / residuals.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::adjust::Device;
    use super::*;
    use crate::testing::Noise;
    use nalgebra::{Rotation3, SVector};

    const SIGMA: [f64; 2] = [0.05, 0.1];
    const SIZES: [Option<(usize, usize)>; 2] = [Some((1296, 972)), Some((1280, 800))];

    fn board() -> Vec<Vector2<f64>> {
        (0..88).map(|i| Vector2::new(f64::from(i % 11), f64::from(i / 11)) * 35.0).collect()
    }

    /// A camera with four distortion terms; a projector without any, its principal point below its picture.
    fn truth() -> State {
        let lens = |(width, height): (usize, usize), fx: f64, cx, cy, distortion| Device {
            lens: Lens { width, height, fx, fy: 0.9995 * fx, cx, cy, distortion },
            skew: 0.0,
        };
        let pose = |k: usize| {
            let tilt = |step: usize| 0.5 * (2.4 * ((k * step) as f64 + 0.5)).sin();
            let r = Rotation3::from_euler_angles(tilt(1), tilt(2), 0.3 * tilt(3));
            let middle = Vector3::new(60.0 * tilt(4), 40.0 * tilt(5), 750.0 + 100.0 * tilt(6));
            Pose::new(r, middle - r * Vector3::new(175.0, 122.5, 0.0))
        };
        State {
            devices: vec![
                lens((1296, 972), 1351.8, 651.4, 481.1, [-0.0853, 0.1042, 0.0008, -0.0006, 0.0]),
                lens((1280, 800), 1052.0, 633.7, 861.4, [0.0; 5]),
            ],
            projector_from_camera: Pose::new(
                Rotation3::from_euler_angles(0.02, -0.28, 0.01),
                Vector3::new(213.0, -11.7, 77.8),
            ),
            camera_from_board: (0..10).map(pose).collect(),
        }
    }

    /// What the devices see, off by noise; `bend` mm (1 sigma) bows each view's board by an amount of its own.
    fn views(noise: &mut Noise, bend: f64) -> Vec<View> {
        let state = truth();
        let view = |(v, pose): (usize, &Pose<frame::Camera, frame::Board>)| {
            let bow = bend * noise.gauss();
            let mut seen = [Vec::new(), Vec::new()];
            for (k, p) in board().iter().enumerate() {
                let z = bow * (1.0 - ((p.x - 175.0) / 175.0).powi(2));
                let at = *pose * Point3::new(p.push(z));
                let in_device = [at.xyz, (state.projector_from_camera * at).xyz];
                for d in 0..2 {
                    let pixel = state.devices[d].project(&in_device[d]).expect("in front");
                    seen[d].push((k, pixel + SIGMA[d] * Vector2::new(noise.gauss(), noise.gauss())));
                }
            }
            View { name: format!("view {v}"), seen }
        };
        state.camera_from_board.iter().enumerate().map(view).collect()
    }

    fn error(s: &Solution) -> SVector<f64, 24> {
        let t = truth();
        let mut e = SVector::<f64, 24>::zeros();
        for (d, (got, want)) in s.devices.iter().zip(&t.devices).enumerate() {
            let of = |d: &Device| {
                let l = &d.lens;
                [vec![l.fx, l.fy, l.cx, l.cy], l.distortion.to_vec()].concat()
            };
            for (k, (g, w)) in of(got).iter().zip(of(want)).enumerate() {
                e[9 * d + k] = g - w;
            }
        }
        let (a, b) = (&s.projector_from_camera, &t.projector_from_camera);
        e.fixed_rows_mut::<3>(18).copy_from(&(a.r * b.r.inverse()).scaled_axis());
        e.fixed_rows_mut::<3>(21).copy_from(&(a.t - b.t));
        e
    }

    #[test]
    fn the_stated_covariance_is_that_of_the_errors() {
        let mut noise = Noise::new(11);
        let (mut mean, runs) = (0.0, 10);
        for _ in 0..runs {
            let s = solve(&board(), &views(&mut noise, 0.0), SIZES, Terms::Chosen).expect("ten tilted views");
            let (e, v) = (error(&s), s.parameter_covariance());
            let over = v.diagonal().map(|v| 1.0 / v.sqrt());
            let unit = ParameterCovariance::from_fn(|i, j| v[(i, j)] * over[i] * over[j]);
            let z = e.component_mul(&over);
            mean += z.dot(&(unit.try_inverse().expect("regular") * z)) / (24.0 * f64::from(runs));
            assert!((s.rms_px[0] / (SIGMA[0] * 2f64.sqrt()) - 1.0).abs() < 0.05, "{:?}", s.rms_px);
            assert!((s.rms_px[1] / (SIGMA[1] * 2f64.sqrt()) - 1.0).abs() < 0.05, "{:?}", s.rms_px);
            let out = s.leave_one_out_rms_px.expect("ten views");
            assert!(out > s.rms_px[0] && out < 1.1 * s.rms_px[0], "{out} {:?}", s.rms_px);
        }
        // fixed terms that are truly zero make it smaller than 1, ten views' own scatter larger
        eprintln!("errors over sigma, squared, per parameter: {mean:.2}");
        assert!((0.4..1.6).contains(&mean), "{mean}");
    }

    #[test]
    fn terms_stay_where_they_earn_it() {
        let s = solve(&board(), &views(&mut Noise::new(3), 0.0), SIZES, Terms::Chosen).expect("ten tilted views");
        let kept = |d: usize| s.devices[d].lens.distortion.map(|k| k != 0.0);
        assert_eq!(kept(0), [true, true, true, true, false]);
        assert_eq!(kept(1)[1..], [false; 4]);
        assert_ne!(s.devices[0].lens.cx, 647.5); // four pixels off the centre are seen
    }

    #[test]
    fn boards_that_are_bent_each_their_own_way_make_the_sigmas_larger() {
        let of = |bend| {
            let s = solve(&board(), &views(&mut Noise::new(5), bend), SIZES, Terms::All).expect("ten tilted views");
            let z = (0..24).map(|k| error(&s)[k].abs() / s.parameter_covariance()[(k, k)].sqrt()).fold(0.0, f64::max);
            (s.parameter_covariance()[(0, 0)].sqrt(), s.rms_px[1], z)
        };
        let (flat, bent) = (of(0.0), of(0.4));
        eprintln!("sigma of f, rms px, largest error in sigmas: flat {flat:?}, bent {bent:?}");
        assert!(bent.0 / flat.0 > 1.5 * bent.1 / flat.1, "no more than the residuals grew");
        assert!(flat.2 < 4.0 && bent.2 < 4.0);
    }

    #[test]
    fn a_view_and_points_that_belie_the_rest_are_left_out() {
        let mut spoilt = views(&mut Noise::new(7), 0.0);
        for (k, at) in &mut spoilt[2].seen[0] {
            at.x += 3.0 * (*k as f64).sin();
        }
        spoilt[4].seen[0][17].1.y += 4.0;
        spoilt[5].seen[1][60].1.x += 20.0; // a fringe order
        let s = solve(&board(), &spoilt, SIZES, Terms::Chosen).expect("nine good views");
        let used: Vec<bool> = s.views.iter().map(|v| v.used).collect();
        assert_eq!(used, [true, true, false, true, true, true, true, true, true, true]);
        assert_eq!((s.views[4].rejected, s.views[5].rejected, s.views[6].rejected), (1, 1, 0));
        assert!((s.devices[0].lens.fx - 1351.8).abs() < 1.0, "{:?}", s.devices[0]);
    }

    #[test]
    fn fringes_of_one_view_that_were_mixed_up_are_left_out() {
        let mut mixed = views(&mut Noise::new(9), 0.0);
        mixed[3].seen[1].iter_mut().for_each(|s| s.1 = s.1.yx());
        let s = solve(&board(), &mixed, SIZES, Terms::Chosen).expect("nine good views");
        let rejected: Vec<usize> = s.views.iter().map(|v| v.rejected).collect();
        assert_eq!(rejected, [0, 0, 0, 88, 0, 0, 0, 0, 0, 0]);
        assert!((s.devices[1].lens.fx - 1052.0).abs() < 1.5, "{:?}", s.devices[1]);
    }

    #[test]
    fn too_few_and_frontal_boards_are_refused() {
        let all = views(&mut Noise::new(1), 0.0);
        assert_eq!(solve(&board(), &all[..3], SIZES, Terms::Chosen).err(), Some(Unsolved::TooFewViews { got: 3 }));
        let lens = &truth().devices[0];
        let frontal: Vec<View> = (0..5)
            .map(|v| {
                let at = |p: &Vector2<f64>| {
                    Vector3::new(p.x - 175.0 + 9.0 * f64::from(v), p.y - 120.0, 700.0 + 20.0 * f64::from(v))
                };
                let seen = board().iter().map(|p| lens.project(&at(p)).expect("in front")).enumerate().collect();
                View { name: v.to_string(), seen: [seen, Vec::new()] }
            })
            .collect();
        let e = solve(&board(), &frontal, [SIZES[0], None], Terms::Chosen).map(|_| ()).expect_err("all parallel");
        assert!(e.to_string().contains("tilted by"), "{e}");
        let scattered: Vec<View> = all
            .iter()
            .map(|v| View {
                seen: [v.seen[0].clone(), v.seen[1].iter().map(|s| (s.0, s.1.yx() * 0.0)).collect()],
                ..v.clone()
            })
            .collect();
        let e = solve(&board(), &scattered, SIZES, Terms::Chosen).map(|_| ()).expect_err("no projector");
        assert!(matches!(e, Unsolved::NoProjector { .. } | Unsolved::Diverged), "{e}");
    }
}

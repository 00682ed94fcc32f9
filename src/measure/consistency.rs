//! Whether the fringe images agree with each other and with the calibration.
//! In:  decoded coordinates, epipolar residuals, the judged pose. Out: the calibration's health; a refusal, or nothing.
//! Not here: whether features agree with the model.
//!
//! An unhealthy calibration alone is a warning, and what its error does to the pose becomes part of the uncertainty. Refused
//! are fringes far off the epipolar lines about a feature, and a pose that the rig's motion makes a wrong one.

use super::body::{self, Site};
use super::cycle::{Run, about};
use super::judge::{Judged, Refused};
use crate::calibrate::{Health, MAX_EPIPOLAR_PX, Turn};
use crate::code::Code;
use crate::fringe::{Coordinate, CoordinateMap, EpipolarCell, State};
use crate::geometry::robust;
use crate::lent::List;
use crate::vehicle::PerFeature;
use nalgebra::Matrix6;
use rayon::prelude::*;

/// Share of pixels of the panels whose fringe images may contradict each other.
const MAX_CONTRADICTORY: f64 = 0.3;
/// Share of the light about the features that fringes modulate where other light drowns them: it is 0.7 in the dark. Less is
/// noise: then no fringes are shown. There must be other light for that: so much of white.
const DROWNED: std::ops::Range<f64> = 0.05..0.15;
const BRIGHT: f64 = 0.2;
/// A rig that has moved may not take more than this of the 0.5 mm at the features' centroid and the 0.15° that make a pose a
/// wrong one.
const WRONG_MM: f64 = 0.4;
const WRONG_DEG: f64 = 0.12;

impl Run<'_, '_> {
    /// Fringe images of a still body under steady light are samples of a sine almost everywhere on the panel. Where
    /// they are not, what passes the checks by chance is wrong too.
    pub(super) fn contradictory(&self, coordinates: &CoordinateMap, sites: &[Site<'_>]) -> Option<Refused> {
        let camera = &self.cycle.measurer.depth_rig.camera;
        let count = |site: &Site<'_>| {
            let (mut usable, mut against) = (0usize, 0usize);
            body::panel_states(coordinates, &self.cycle.rays, camera, site, |state| {
                usable += usize::from(matches!(state, State::Valid | State::NotSine | State::WrongOrder));
                against += usize::from(matches!(state, State::NotSine | State::WrongOrder));
            });
            (usable, against)
        };
        let sum = |a: (usize, usize), b: (usize, usize)| (a.0 + b.0, a.1 + b.1);
        let (usable, against) = sites.par_iter().map(count).reduce(Default::default, sum);
        let share = against as f64 / usable.max(1) as f64;
        (share > MAX_CONTRADICTORY).then(|| {
            let detail = format!(
                "The fringe images contradict each other in {:.0} % of the panel's pixels, allowed {:.0} %: the light changed, the vehicle moved, or images were mixed up.",
                100.0 * share,
                100.0 * MAX_CONTRADICTORY
            );
            Self::refuse(Code::PhaseAmbiguity, detail)
        })
    }

    /// `refused`, or if that was for want of depth and there is little of the projector's light beside other light: that.
    pub(super) fn or_other_light(&self, refused: Refused, coordinates: &CoordinateMap) -> Refused {
        let of_depth = |code: Code| matches!(code, Code::CoverageLow | Code::NotSmooth | Code::PhaseAmbiguity);
        let mut of_features = self.located.iter().filter_map(|l| l.as_ref().err());
        let too_few = refused.code == Code::TooFewFeatures && of_features.any(|code| of_depth(*code));
        if !(of_depth(refused.code) || too_few) {
            return refused;
        }
        let (black, white) = (self.cycle.capture.camera.black_level, self.cycle.capture.camera.white_level());
        let looked_at = coordinates.pixels.iter().zip(self.cycle.fringes.wanted()).filter(|(_, wanted)| **wanted);
        let median = |of: &dyn Fn(&Coordinate) -> f64| {
            let all = looked_at.clone().map(|(c, _)| of(c)).filter(|v| v.is_finite());
            robust::median(&mut all.step_by(8).collect::<Vec<_>>())
        };
        let level = |c: &Coordinate| f64::from(c.level) - black;
        let share = median(&|c| f64::from(c.modulation) / level(c));
        if !(DROWNED.contains(&share) && median(&level) > BRIGHT * (white - black)) {
            return refused;
        }
        let detail = format!(
            "The fringes modulate {:.0} % of the light about the features, wanted {:.0} %: {}",
            100.0 * share,
            100.0 * DROWNED.end,
            refused.detail
        );
        Refused { code: Code::Ambient, detail, ..refused }
    }

    /// What the other axis' fringes say of the calibration about each feature.
    pub(super) fn epipolar(&self, sites: &[Site<'_>]) -> Option<Refused> {
        let m = self.cycle.measurer;
        let residual = |site: &Site<'_>| {
            let w = about(&m.calibration.rig.camera, &site.local.origin.xyz, body::REACH_MM)?;
            let inside = |c: &&EpipolarCell| {
                let (x, y) = (c.pixel.x - w.x as f64, c.pixel.y - w.y as f64);
                (0.0..w.width as f64).contains(&x) && (0.0..w.height as f64).contains(&y)
            };
            let mut off = List::of(self.cells.iter().filter(inside).map(|c| c.residual.abs()));
            Some(robust::median(&mut off))
        };
        let found = sites.iter().zip(&m.templates).filter_map(|(site, t)| Some((residual(site)?, &t.feature)));
        let (off, feature) = found.filter(|(off, _)| *off > MAX_EPIPOLAR_PX).max_by(|a, b| a.0.total_cmp(&b.0))?;
        let detail = format!(
            "About {feature} the fringes lie {off:.2} projector px off the epipolar line, allowed {MAX_EPIPOLAR_PX}."
        );
        Some(Self::refuse(Code::CalibrationHealth, detail))
    }

    /// What this vehicle says of the calibration, where there are fringes of both axes.
    pub(super) fn health(&self) -> Option<Health> {
        let m = self.cycle.measurer;
        let known = self.pose.map(|pose| self.evidence().iter().map(|e| e.known(&pose)).collect::<PerFeature<_>>());
        Health::new(&m.calibration, &m.errors, self.axis, &self.cells, &known.unwrap_or_default())
    }

    /// The pose with what a rig that has surely moved does to it: that counts as uncertainty, as it may have another
    /// cause, and where it alone would make the pose a wrong one there is none. A turn across the fringes moves points by
    /// 0.5 mm before the fringes are 0.02 px off, and a longer baseline moves them unseen by the fringes.
    pub(super) fn with_health(&self, mut judged: Judged, health: &Health) -> Result<Judged, Refused> {
        let rig = &self.cycle.measurer.calibration.rig;
        let evidence = self.evidence();
        let turned = health.turn.map(|turn| {
            let per_turn = judged.response(&evidence, |e| Turn::shift(rig, &e.located.response));
            (per_turn * turn.vector, per_turn * turn.covariance * per_turn.transpose())
        });
        let scaled = health.size.map(|size| {
            let motion = judged.response(&evidence, |e| e.located.point.xyz * size);
            (motion, Matrix6::zeros())
        });
        for (motion, covariance) in turned.into_iter().chain(scaled) {
            let (mm, deg) = (motion.fixed_rows::<3>(0).norm(), motion.fixed_rows::<3>(3).norm().to_degrees());
            if mm > WRONG_MM || deg > WRONG_DEG {
                let detail =
                    format!("The pose is wrong by {mm:.2} mm and {deg:.3}° at the features. {}.", health.detail);
                return Err(Self::refuse(Code::CalibrationHealth, detail));
            }
            judged.covariance += motion * motion.transpose() + covariance;
        }
        Ok(judged)
    }
}

//! Whether the fringe images agree with each other and with the calibration, over the panels that are measured.
//! In:  decoded coordinates, depth. Out: a refusal, or nothing. Not here: whether features agree with the model.

use super::body::{self, Site};
use super::cycle::{Run, about};
use super::judge::Refused;
use crate::code::Code;
use crate::fringe::{self, Axis, CoordinateMap, DepthMap, State};
use crate::geometry::Point3;

/// Share of pixels of the panels whose fringe images may contradict each other.
const MAX_CONTRADICTORY: f64 = 0.3;
/// Largest epipolar residual about a feature, projector px.
pub(super) const MAX_EPIPOLAR_PX: f64 = 0.15;

impl Run<'_, '_> {
    /// Fringe images of a still body under steady light are samples of a sine almost everywhere on the panel. Where
    /// they are not, what passes the checks by chance is wrong too.
    pub(super) fn contradictory(&self, coordinates: &CoordinateMap, sites: &[Site<'_>]) -> Option<Refused> {
        let rig = &self.cycle.measurer.calibration.rig;
        let (mut usable, mut against) = (0usize, 0usize);
        for site in sites {
            body::panel_states(coordinates, &rig.camera, site, |state| {
                usable += usize::from(matches!(state, State::Valid | State::NotSine | State::WrongOrder));
                against += usize::from(matches!(state, State::NotSine | State::WrongOrder));
            });
        }
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

    /// What the other axis' fringes say of the calibration: each point's row, given the depth that its column gave.
    pub(super) fn epipolar(
        &self,
        across: &fringe::PhaseMap,
        map: &DepthMap<'_>,
        sites: &[Site<'_>],
    ) -> Option<Refused> {
        let (m, projector) = (self.cycle.measurer, &self.cycle.capture.projector);
        let rig = &m.calibration.rig;
        let axis = across.set.axis;
        let pitch = across.set.pitch(if axis == Axis::Column { projector.width } else { projector.height });
        let window = across.window;
        let mut worst = (0.0, "");
        for (site, template) in sites.iter().zip(&m.templates) {
            let Some(about) = about(m, &site.local.origin.xyz, body::REACH_MM) else { continue };
            let mut sums = (0.0, 0.0, 0usize);
            for y in about.y.max(window.y)..(about.y + about.height).min(window.y + window.height) {
                for x in about.x.max(window.x)..(about.x + about.width).min(window.x + window.width) {
                    let i = (y - window.y) * window.width + x - window.x;
                    let (phase, depth) = (&across.pixels[i], &map.pixels[i]);
                    if phase.state != State::Valid || depth.state != State::Valid {
                        continue;
                    }
                    let point = Point3::new(map.rays.at(x, y) * f64::from(depth.z));
                    if let Some(expected) = fringe::projector_coordinate(rig, axis, &point) {
                        let off = f64::from(phase.phase) - (expected + 0.5) / pitch * std::f64::consts::TAU;
                        sums = (sums.0 + off.cos(), sums.1 + off.sin(), sums.2 + 1);
                    }
                }
            }
            // the mean direction needs no unwrapping
            let off: f64 = sums.1.atan2(sums.0) / std::f64::consts::TAU * pitch;
            if sums.2 > 100 && off.abs() > f64::abs(worst.0) {
                worst = (off, template.feature.as_str());
            }
        }
        (worst.0.abs() > MAX_EPIPOLAR_PX).then(|| {
            let detail = format!(
                "About {} the fringes lie {:+.2} projector px off the epipolar line, allowed {MAX_EPIPOLAR_PX}.",
                worst.1, worst.0
            );
            Self::refuse(Code::CalibrationHealth, detail)
        })
    }
}

//! Depth of a capture: its fringes decoded and triangulated.
//! In:  the sums of its fringe sets and what the capture says of them. Out: projector coordinates, a depth map, the coarse surface.
//! Not here: patches about features.

use super::body::{self, Site};
use crate::calibrate::MAX_EPIPOLAR_PX;
use crate::capture::{Capture, Fringes, TYPICAL_GAIN, coordinates};
use crate::fringe::{self, Axis, CoordinateMap, DepthMap, Limits, NoiseLaw, PhaseMap, Rays};
use crate::geometry::{Surface, frame};
use crate::lent::List;

/// Depth is looked at about this densely on the body at the design's distance, mm, and no denser, however fine the camera.
/// A patch's cells of 3 mm then hold a dozen samples each, and there are a thousand of them: its noise stays below 2 µm.
pub(super) const LATTICE_MM: f64 = 0.75;

/// The decoded fringes of a capture.
pub(super) struct Decoded {
    /// Along the columns, or the rows where only they are absolute.
    pub(super) coordinates: CoordinateMap,
    phases: List<PhaseMap>,
    /// Which of them are the finest along the other axis, if there are any that tell a row from the next.
    across: Option<usize>,
    /// The noise law of each set.
    pub(super) noise: List<NoiseLaw>,
}

impl Decoded {
    /// Everywhere in the window.
    pub(super) fn new(fringes: &Fringes, capture: &Capture) -> Result<Self, fringe::Error> {
        let noise = fringes.noise(capture);
        let phases = fringes.phases(&noise, &Limits::default())?;
        Self::of(phases, noise, capture)
    }

    /// Where it is wanted, most of it decoded as it came.
    pub(super) fn wanted(fringes: &mut Fringes, capture: &Capture) -> Result<Self, fringe::Error> {
        let noise = fringes.noise(capture);
        let phases = fringes.take_phases(&noise)?;
        Self::of(phases, noise, capture)
    }

    fn of(phases: List<PhaseMap>, noise: List<NoiseLaw>, capture: &Capture) -> Result<Self, fringe::Error> {
        let limits = Limits::default();
        let coordinates = match coordinates(capture, &phases, Axis::Column, &limits) {
            Err(e) => coordinates(capture, &phases, Axis::Row, &limits).map_err(|_| e)?,
            Ok(map) => map,
        };
        let others = phases.iter().enumerate().filter(|(_, p)| p.set.axis != coordinates.axis);
        let across = others.max_by_key(|(_, p)| p.set.count);
        let extent = if coordinates.axis == Axis::Column { capture.projector.height } else { capture.projector.width };
        // a pitch of a few pixels cannot tell which fringe it is
        let across = across.filter(|(_, p)| p.set.pitch(extent) > 8.0 * MAX_EPIPOLAR_PX).map(|(k, _)| k);
        Ok(Self { coordinates, phases, across, noise })
    }

    /// The same everywhere in the window, in the room of what it was.
    pub(super) fn everywhere(&mut self, fringes: &Fringes, capture: &Capture) -> Result<(), fringe::Error> {
        self.phases.clear();
        *self = Self::new(fringes, capture)?;
        Ok(())
    }

    pub(super) fn across(&self) -> Option<&PhaseMap> {
        self.across.map(|k| &self.phases[k])
    }
}

/// The noise law of the red image where it is stated.
pub(super) fn stated_red_noise(capture: &Capture) -> Option<NoiseLaw> {
    let (black, read) = (capture.camera.black_level, capture.camera.read_noise_e.unwrap_or(0.0));
    capture.images.red_gain_dn_per_e.map(|gain| NoiseLaw::from_sensor(gain, read, black))
}

/// The noise law of the red image: stated, or else that of the finest fringes.
pub(super) fn red_noise(capture: &Capture, fringes: &[NoiseLaw]) -> NoiseLaw {
    let (black, read) = (capture.camera.black_level, capture.camera.read_noise_e.unwrap_or(0.0));
    stated_red_noise(capture).or_else(|| fringes.last().copied()).unwrap_or(NoiseLaw::from_sensor(
        TYPICAL_GAIN,
        read,
        black,
    ))
}

/// Depth of a window: decoded, triangulated, and once a coarse surface is known, with the fringes ordered by it
/// where the coarse sets were saturated.
pub(super) struct BodyDepth<'a> {
    pub(super) map: DepthMap<'a>,
    pub(super) coarse: Surface<frame::Camera>,
}

impl<'a> BodyDepth<'a> {
    /// `None` where there is no such surface.
    pub(super) fn new(
        rig: &crate::optics::Rig,
        rays: &'a Rays,
        coordinates: &mut CoordinateMap,
        sites: &[Site<'_>],
    ) -> Option<Self> {
        let mut map = DepthMap::new(rig, rays, coordinates);
        let mut coarse = body::coarse(&map, &rig.camera, sites)?;
        let axis = coordinates.axis;
        let expected = |x: usize, y: usize| {
            let ray = rays.at(x, y);
            let met = coarse.local.point(&coarse.meet(&ray, 0.0)?);
            fringe::projector_coordinate(rig, axis, &met)
        };
        if coordinates.predict(&Limits::default(), expected) > 0 {
            drop(map);
            map = DepthMap::new(rig, rays, coordinates);
            coarse = body::coarse(&map, &rig.camera, sites)?;
        }
        Some(Self { map, coarse })
    }
}

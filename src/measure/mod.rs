//! From images to the vehicle's pose with its uncertainty, and from a clicked capture to a vehicle model.
//! In:  a capture, a calibration, a vehicle model. Out: a [`Measurement`]: a pose with covariance, or a code.
//! Not here: devices, the PLC, where images come from. Everything is pure; files are read by [`Measurer::new`] and
//! [`measure`] only.
//!
//! [`Cycle`] is one vehicle: red image → regions; fringe images → depth; `finish` → patches, contours, pose, verdict.

mod ambient;
mod body;
mod consistency;
mod corner;
mod cycle;
mod dense;
mod depth;
mod detected;
mod edges;
mod hem;
mod judge;
mod light;
mod locate;
mod moved;
mod panel;
mod patches;
mod regions;
mod report;
mod result;
mod teach;

pub use cycle::{Cycle, Stage};
pub use result::{
    Euler, FeatureResult, Measurement, Method, PoseMatrix, Station, TargetUncertainty, Timing, Uncertainty, Verdict,
    Xyz, json, table,
};
pub use teach::{Taught, TeachError, teach};

use crate::calibrate::{Calibration, ParameterCovariance, independent_errors};
use crate::capture::{self, Capture};
use crate::detect::Detector;
use crate::geometry::{Polynomial, Pose, frame};
use crate::image::Window;
use crate::optics::{Pixel, Rig};
use crate::vehicle::{Feature, PanelMask, Template, VehicleFile};
use std::sync::{Arc, Mutex};

/// The design's working distance, mm: for what must be sized in pixels before depth is known.
pub(crate) const TYPICAL_DISTANCE_MM: f64 = 750.0;

/// What a measurement saw, to be drawn onto the red image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// Where contours were looked for.
    pub regions: Vec<Window>,
    /// Points of the contours found, px, and their distance from the taught contour, mm.
    pub contours: Vec<(Pixel, f64)>,
}

/// Calibration and vehicle model, ready to measure: what belongs to start-up and not to a vehicle.
pub struct Measurer {
    calibration: Calibration,
    /// The independent errors of the calibration; zero where it states none.
    errors: Box<ParameterCovariance>,
    vehicle: VehicleFile,
    templates: Vec<Template>,
    /// The panels' shapes about the features.
    surfaces: Vec<Polynomial>,
    /// The panels' masks less a margin for a coarse pose, and for a good one.
    far_masks: Vec<PanelMask>,
    near_masks: Vec<PanelMask>,
    /// The panels' masks and a margin, for a pose that is not known yet.
    grown_masks: Vec<PanelMask>,
    /// Depth is looked at in every so many-th column and row of the images, by a rig whose camera has no others.
    every: usize,
    depth_rig: Rig,
    /// Proposes regions; none: they are searched for.
    detector: Option<Arc<Detector>>,
    method: Method,
    /// Buffers of vehicles that are done.
    spare: Mutex<Vec<cycle::Buffers>>,
}

impl Measurer {
    /// Reads the model's templates. Errors name the file and what is wrong with it.
    pub fn new(calibration: Calibration, vehicle: VehicleFile) -> Result<Self, crate::document::Error> {
        let templates = vehicle.templates()?;
        Ok(Self::with_templates(calibration, vehicle, templates))
    }

    /// With templates already at hand, one per feature in its order.
    pub(crate) fn with_templates(calibration: Calibration, vehicle: VehicleFile, templates: Vec<Template>) -> Self {
        let eroded = |mm: f64| templates.iter().map(|t| t.panel.eroded(mm)).collect();
        let (far_masks, near_masks) = (eroded(cycle::EROSION_MM.0), eroded(cycle::EROSION_MM.1));
        let grown_masks = templates.iter().map(|t| t.panel.grown(cycle::MARGIN_MM)).collect();
        let mut depth_rig = calibration.rig.clone();
        let pixels_per_mm = depth_rig.camera.fx / TYPICAL_DISTANCE_MM;
        let every = ((depth::LATTICE_MM * pixels_per_mm) as usize).max(1);
        depth_rig.camera = depth_rig.camera.thinned(every);
        let surfaces =
            templates.iter().map(|t| t.surface.polynomial().expect("checked when it was read or made")).collect();
        let errors = calibration.covariance.as_deref().map_or_else(ParameterCovariance::zeros, independent_errors);
        Self {
            calibration,
            errors: Box::new(errors),
            vehicle,
            templates,
            surfaces,
            far_masks,
            near_masks,
            grown_masks,
            every,
            depth_rig,
            detector: None,
            method: Method::Points,
            spare: Mutex::default(),
        }
    }

    /// The same with a detector that proposes the regions, or without one.
    pub fn with_detector(self, detector: Option<Arc<Detector>>) -> Self {
        Self { detector, ..self }
    }

    /// The same that measures by `method`.
    pub fn with_method(self, method: Method) -> Self {
        Self { method, ..self }
    }

    /// Fewer features that are located make no pose.
    fn least_features(&self) -> usize {
        if self.method == Method::Dense { 2 } else { 3 }
    }

    /// The camera and projector that it measures with.
    pub fn rig(&self) -> &Rig {
        &self.calibration.rig
    }

    /// The model's features, each with its template.
    pub fn features(&self) -> impl Iterator<Item = (&Feature, &Template)> {
        self.vehicle.features.iter().zip(&self.templates)
    }

    /// Begins a vehicle with its red image, whose size is the calibration's, and the one without bars and projector, if
    /// there is one. `capture` says what the images are.
    pub fn begin<'a>(
        &'a self,
        capture: &'a Capture,
        red: &crate::Image<u16>,
        ambient: Option<&crate::Image<u16>>,
    ) -> Cycle<'a> {
        Cycle::new(self, capture, red, ambient)
    }

    /// Buffers of an earlier vehicle, or empty ones. Images and maps of the size of regions are made once, not once per
    /// vehicle, and nothing of what they held is read.
    fn buffers(&self) -> cycle::Buffers {
        self.spare.lock().ok().and_then(|mut spare| spare.pop()).unwrap_or_default()
    }

    fn keep(&self, buffers: cycle::Buffers) {
        if let Ok(mut spare) = self.spare.lock() {
            spare.push(buffers);
        }
    }

    fn station(&self) -> Station {
        if self.calibration.station_from_camera.is_some() { Station::Surveyed } else { Station::Taught }
    }

    fn station_from_camera(&self) -> Pose<frame::Station, frame::Camera> {
        self.calibration.station_from_camera.unwrap_or_else(|| {
            let taught = self.templates[0].taught_pose().inverse();
            Pose::new(taught.r, taught.t)
        })
    }
}

/// Measures a stored capture: the fold of [`Cycle`] over its images. `ended` is told when each stage has ended.
/// Errors where an image cannot be read; what is merely not measurable is a `Measurement` with a code.
pub fn measure(
    measurer: &Measurer,
    capture: &Capture,
    ended: &mut dyn FnMut(Stage),
) -> Result<(Measurement, Drawing), capture::Error> {
    let red = capture.load(capture.red()?)?;
    let ambient = capture.images.ambient.as_ref().map(|file| capture.load(file)).transpose()?;
    ended(Stage::Read);
    let mut cycle = measurer.begin(capture, &red, ambient.as_ref());
    ended(Stage::Detect);
    let mut first = None;
    for (k, set) in capture.fringes.iter().enumerate() {
        for (step, path) in (0u32..).zip(&set.images) {
            let image = capture.load(path)?;
            cycle.add_fringe(k, step, &image).expect("sizes, sets and steps were checked when the capture was read");
            if capture.images.repeat.is_some() && first.is_none() {
                first = Some(image);
            }
        }
    }
    ended(Stage::Read);
    if let (Some(repeat), Some(first)) = (&capture.images.repeat, &first) {
        cycle.add_repeat(first, &capture.load(repeat)?);
    }
    Ok(cycle.finish(ended))
}

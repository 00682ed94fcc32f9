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
mod published;
mod regions;
mod report;
mod result;
mod teach;
mod workspace;

pub use cycle::{Cycle, Stage};
pub(crate) use judge::{EDGE_BIAS_MM, LIGHT_SHIFT_MM_PER_DEG, NORMAL_BIAS_MM, PAINT_SHIFT_MM};
pub(crate) use locate::ARCH_TURN_RAD;
pub use result::{
    Euler, FeatureResult, Measurement, Method, PoseMatrix, Station, TargetUncertainty, Timing, Uncertainty, Verdict,
    Xyz, json, table,
};
pub use teach::{Taught, TeachError, teach, teach_from};
pub use workspace::Workspace;

use crate::calibrate::{Calibration, ParameterCovariance, independent_errors};
use crate::capture::{self, Capture};
use crate::detect::Detector;
use crate::geometry::{Polynomial, Pose, frame};
use crate::image::{Image, Window};
use crate::lent::List;
use crate::optics::{Pixel, Rig};
use crate::vehicle::{Feature, PanelMask, Template, VehicleFile};
use body::Panel;
use std::path::Path;
use std::sync::Arc;

/// The design's working distance, mm: for what must be sized in pixels before depth is known.
pub(crate) const TYPICAL_DISTANCE_MM: f64 = 750.0;

/// What a measurement saw, to be drawn onto the red image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// Where contours were looked for.
    pub regions: List<Window>,
    /// Points of the contours found, px, and their distance from the taught contour, mm.
    pub contours: List<(Pixel, f64)>,
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
    /// The panels less a margin for a coarse pose, and for a good one.
    far: Vec<Panel>,
    near: Vec<Panel>,
    /// The panels and a margin, for a pose that is not known yet.
    grown: Vec<Panel>,
    /// How far from each feature depth is wanted, mm.
    reach_mm: Vec<f64>,
    /// Depth is looked at in every so many-th column and row of the images, by a rig whose camera has no others.
    every: usize,
    depth_rig: Rig,
    method: Method,
    shared: Shared,
}

/// What the measurers of all models share.
#[derive(Clone, Default)]
pub struct Shared {
    /// Proposes regions; none: they are searched for.
    pub detector: Option<Arc<Detector>>,
    /// Room.
    pub workspace: Workspace,
}

impl Measurer {
    /// Reads the model's templates. Errors name the file and what is wrong with it.
    pub fn new(calibration: Calibration, vehicle: VehicleFile) -> Result<Self, crate::document::Error> {
        let templates = vehicle.templates()?;
        Ok(Self::with_templates(calibration, vehicle, templates))
    }

    /// With templates already at hand, one per feature in its order.
    pub(crate) fn with_templates(calibration: Calibration, vehicle: VehicleFile, templates: Vec<Template>) -> Self {
        let panels =
            |of: &dyn Fn(&PanelMask) -> PanelMask| templates.iter().map(|t| Panel::new(of(&t.panel))).collect();
        let (far, near) = (panels(&|m| m.eroded(cycle::EROSION_MM.0)), panels(&|m| m.eroded(cycle::EROSION_MM.1)));
        let grown = panels(&|m| m.grown(cycle::MARGIN_MM));
        let reach_mm = templates.iter().map(cycle::reach).collect();
        let mut depth_rig = calibration.rig.clone();
        let pixels_per_mm = depth_rig.camera.fx / TYPICAL_DISTANCE_MM;
        let every = ((depth::LATTICE_MM * pixels_per_mm).round() as usize).max(1);
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
            far,
            near,
            grown,
            reach_mm,
            every,
            depth_rig,
            method: Method::Points,
            shared: Shared::default(),
        }
    }

    /// The same with a detector that proposes the regions, or without one; it shares nothing with others.
    pub fn with_detector(self, detector: Option<Arc<Detector>>) -> Self {
        self.sharing(&Shared { detector, ..Shared::default() })
    }

    /// The same, with what it shares with others.
    pub fn sharing(self, shared: &Shared) -> Self {
        Self { shared: shared.clone(), ..self }
    }

    /// The same that measures by `method`.
    pub fn with_method(self, method: Method) -> Self {
        Self { method, ..self }
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
    pub fn begin<'a>(&'a self, capture: &'a Capture, red: &Image<u16>, ambient: Option<&Image<u16>>) -> Cycle<'a> {
        Cycle::new(self, capture, red, ambient)
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
    measure_from(measurer, capture, &|file| capture.load(file), ended)
}

/// Gives the image that a capture's description names.
pub type Load<'a> = dyn Fn(&Path) -> Result<Image<u16>, capture::Error> + 'a;

/// As [`measure`], with images from elsewhere than the capture's folder.
pub fn measure_from(
    measurer: &Measurer,
    capture: &Capture,
    load: &Load<'_>,
    ended: &mut dyn FnMut(Stage),
) -> Result<(Measurement, Drawing), capture::Error> {
    let red = load(capture.red()?)?;
    let ambient = capture.images.ambient.as_ref().map(|file| load(file)).transpose()?;
    ended(Stage::Read);
    let mut cycle = measurer.begin(capture, &red, ambient.as_ref());
    ended(Stage::Detect);
    let mut first = None;
    for (k, set) in capture.fringes.iter().enumerate() {
        for (step, path) in (0u32..).zip(&set.images) {
            let image = load(path)?;
            cycle.add_fringe(k, step, &image).expect("sizes, sets and steps were checked when the capture was read");
            if capture.images.repeat.is_some() && first.is_none() {
                first = Some(image);
            }
        }
    }
    ended(Stage::Read);
    if let (Some(repeat), Some(first)) = (&capture.images.repeat, &first) {
        cycle.add_repeat(first, &load(repeat)?);
    }
    Ok(cycle.finish(ended))
}

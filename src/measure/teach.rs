//! Teaching: one good capture with clicked points becomes a vehicle model's templates.
//! In:  a capture, the calibration, the features file with its pixels. Out: the model with its templates.
//! Not here: files; moving the clicks. What was clicked is where the ray meets the fitted surface, and stays so.

use super::ambient;
use super::body::{self, Panel, Patch, Samples, Shape, Site};
use super::cycle::EROSION_MM;
use super::depth::{BodyDepth, Decoded, red_noise};
use super::edges::{self, EdgeRay};
use super::locate::{ARCH_WINDOW_MM, PanelEdge, on_panel};
use super::panel::panel_mask;
use super::regions::{search_factor, search_field};
use super::{Load, Measurement, Measurer, TYPICAL_DISTANCE_MM, measure_from};
use crate::calibrate::Calibration;
use crate::capture::{self, Capture, Fringes};
use crate::code::Code;
use crate::contour::{Chain, EllipseLimits, arch_top, fit_ellipse, join, link};
use crate::document::Check;
use crate::fringe::{self, Rays};
use crate::geometry::robust::median;
use crate::geometry::{Local, NoPose, Pair, Point3, Pose, Surface, frame, register};
use crate::image::{Image, Window};
use crate::optics::{Lens, Pixel};
use crate::vehicle::{
    Anchor, ContourPoint, Definition, Edge, Feature, Kind, PanelMask, TaughtSurface, Template, VehicleFile,
};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

type CameraFromVehicle = Pose<frame::Camera, frame::Vehicle>;

/// Half the side of the remembered mask, mm: the widest patch about the widest flap.
const MASK_MM: f64 = 200.0;
/// Contours are remembered this far from the point, mm.
const CORNER_MM: f64 = 40.0;
/// Which side an edge belongs to is looked up this far from it, mm.
const BRIGHT_SIDE_MM: f64 = 1.4;
/// Least 4πA/P² of a flap's contour: a square with rounded corners has 0.8 and more, a shut-line that passes by less.
const RING_ROUNDNESS: f64 = 0.5;
/// Flaps are looked for within this radius of the click, mm.
const FLAP_MM: f64 = 140.0;
/// The edges that are found lie this far down a rolled hem where the model does not say, mm: at a corner, on a flap's
/// opening, where a narrow gap hides more of the hem, and at a wheel arch, whose flange is rolled wider. Found on the
/// independent captures: with them a move by 100 mm keeps its length, and the sedan its place between two attitudes.
const CORNER_HEM_MM: f64 = 0.65;
const FLAP_HEM_MM: f64 = 1.5;
const ARCH_HEM_MM: f64 = 1.0;
/// What is not known of a surface beyond its noise, 1 sigma, mm: harmonics, and what no polynomial follows.
const HEIGHT_SIGMA_MM: f64 = 0.007;
/// Largest distance of an ellipse's contour from the ellipse, robust sigma, mm; beyond, the flap is an outline.
const ELLIPSE_SIGMA_MM: f64 = 0.25;

/// Why a model is not taught.
#[derive(Debug, thiserror::Error)]
pub enum TeachError {
    /// An image of the capture.
    #[error(transparent)]
    Capture(#[from] capture::Error),
    /// A value of the features file that the capture contradicts.
    #[error(transparent)]
    Value(#[from] crate::document::Error),
    /// The fringes give no depth.
    #[error("the capture's fringes give no depth")]
    Fringes(#[from] fringe::Error),
    /// The body's surface or panel was not found.
    #[error("{what}")]
    Body {
        /// What is missing and what to do.
        what: &'static str,
    },
    /// A feature could not be taught.
    #[error("feature {feature}: {} {}: {what}", code.number(), code.entry().name)]
    Feature {
        /// Its name.
        feature: String,
        /// The code that measuring would give.
        code: Code,
        /// What was found and what to do.
        what: String,
    },
    /// The features' points determine no pose.
    #[error("the features' points determine no pose")]
    Pose(#[from] NoPose),
    /// The freshly taught model does not measure its own capture.
    #[error("the taught model does not measure its own capture: {detail}")]
    SelfCheck {
        /// The refusal.
        detail: String,
    },
}

/// A taught model.
#[derive(Clone)]
pub struct Taught {
    /// The model; its features name their templates.
    pub model: VehicleFile,
    /// One template per feature, in their order.
    pub templates: Vec<Template>,
    /// The capture measured with the model: near the taught pose, with its residual and uncertainty.
    pub check: Measurement,
}

impl Taught {
    /// Writes the model to `file`, its templates beside it.
    pub fn write(&self, file: &std::path::Path) -> Result<(), crate::document::Error> {
        for (feature, template) in self.model.features.iter().zip(&self.templates) {
            let name = feature.template.as_ref().expect("teaching names every template");
            crate::document::write_bytes(&file.with_file_name(name), &template.to_bytes())?;
        }
        self.model.write(file) // last, so that the model never names a template that is not there
    }
}

/// A feature on its way: where its ray met the surface, and the surface.
struct Placed {
    local: Local<frame::Camera>,
    patch: Patch,
}

/// Teaches `features` on `capture`. `stem` begins the templates' file names.
pub fn teach(
    capture: &Capture,
    calibration: &Calibration,
    features: &VehicleFile,
    stem: &str,
) -> Result<Taught, TeachError> {
    teach_from(capture, &|file| capture.load(file), calibration, features, stem)
}

/// As [`teach`], with images from elsewhere than the capture's folder.
pub fn teach_from(
    capture: &Capture,
    load: &Load<'_>,
    calibration: &Calibration,
    features: &VehicleFile,
    stem: &str,
) -> Result<Taught, TeachError> {
    let camera = &calibration.rig.camera;
    let red = load(capture.red()?)?;
    let ambient = capture.images.ambient.as_ref().map(|a| load(a)).transpose()?;
    let raw = ambient::without(&red, ambient.as_ref(), &capture.camera);
    let mut fringes = Fringes::new(capture, Window::whole(red.width, red.height), None);
    for (k, set) in capture.fringes.iter().enumerate() {
        for (step, path) in (0u32..).zip(&set.images) {
            fringes.add(k, step, &load(path)?)?;
        }
    }
    let Decoded { mut coordinates, noise, .. } = Decoded::new(&fringes, capture)?;
    let rays = Rays::new(camera, fringes.window);
    let clicks = features.clicks()?;
    let whole = Window::whole(red.width, red.height);
    let [plain, level] = edges::Levels::new(&raw).without_glints(&raw, whole);
    // a rounded corner's panel begins some mm from the sharp corner that was clicked
    let reach = 8.0 * camera.fx / TYPICAL_DISTANCE_MM;
    let panel = panel_mask(&plain, &level, &clicks, reach).ok_or(TeachError::Body {
        what: "no bright panel lies beside two of the clicked points: check the clicks and the red image's light",
    })?;

    // Depth of the panel about the clicks, from a frame that only the camera knows.
    let flat: Vec<Local<frame::Camera>> = clicks
        .iter()
        .map(|p| {
            let ray =
                camera.ray(p).ok_or(TeachError::Body { what: "a click lies where the calibrated lens has no ray" })?;
            Ok(Local {
                origin: Point3::new(ray * TYPICAL_DISTANCE_MM),
                axes: Matrix3::from_columns(&[Vector3::x(), -Vector3::y(), -Vector3::z()]),
            })
        })
        .collect::<Result<_, TeachError>>()?;
    let masks: Vec<PanelMask> = flat.iter().map(|l| mask_about(camera, &panel, |uv| l.point(&uv.push(0.0)))).collect();
    let eroded: Vec<Panel> = masks.iter().map(|m| Panel::new(m.eroded(EROSION_MM.1))).collect();
    let sites: Vec<Site<'_>> = flat.iter().zip(&eroded).map(|(local, panel)| Site { local: *local, panel }).collect();
    let body = BodyDepth::new(&calibration.rig, &rays, &mut coordinates, &sites).ok_or(TeachError::Body {
        what: "too little of the panel about the clicked points has depth: check the projector and glare",
    })?;

    let mut points: Vec<Point3<frame::Camera>> = Vec::new();
    for (feature, click) in features.features.iter().zip(&clicks) {
        let met = camera.ray(click).and_then(|ray| body.coarse.meet(&ray, 0.0));
        let met =
            met.ok_or_else(|| refusal(feature, Code::CoverageLow, "the click's ray misses the body's surface"))?;
        points.push(body.coarse.local.point(&met));
    }
    let mut pose = pose_of(features, &points)?;
    let mut placed = Vec::new();
    for _ in 0..3 {
        placed = place(features, &clicks, &pose, &points, &body, camera, &panel)?;
        points = placed.iter().map(|p| p.local.origin).collect();
        pose = pose_of(features, &points)?;
    }
    // where a definition moves the point, the click only says about where it is
    let far = |f: &Feature, p: &Point3<frame::Camera>| match f.definition() {
        Definition::AsTaught => f.pixel_sigma * p.xyz.z / camera.fx,
        _ => CORNER_MM / 4.0,
    };
    check_distances(features, &points, far)?;
    check_side(features, &placed, &pose)?;

    let red_noise = red_noise(capture, &noise);
    let edge_rays = edges::edge_rays(&raw, &[whole], &red_noise, camera);
    let mut model = features.clone();
    let mut templates = Vec::new();
    for (k, feature) in features.features.iter().enumerate() {
        let scene = Scene { camera, panel: &panel, raw: &raw, edge_rays: &edge_rays[0], calibration };
        let template = scene.template(feature, &clicks[k], &placed[k], &pose)?;
        let written = &mut model.features[k];
        written.edge_depth_mm = Some(template.edge_depth_mm);
        written.template = Some(format!("{stem}.{}.datum", feature.name));
        templates.push(template);
    }
    model.release = None; // a new model has not been released
    // every template was made with the clicks' pose; where a definition moves a point, the pose moves with it
    if features.features.iter().any(|f| f.definition() != Definition::AsTaught) {
        let points: Vec<_> = templates.iter().map(|t| t.local(&pose).point(&Vector3::from(t.at_mm))).collect();
        let known: Vec<f64> = templates.iter().map(|t| t.covariance().trace().sqrt()).collect();
        let sigma =
            |f: &Feature, _: &_| features.features.iter().zip(&known).find(|(g, _)| *g == f).map_or(0.0, |(_, s)| *s);
        check_distances(features, &points, sigma)?;
        let moved = pose_of(features, &points)?;
        for t in &mut templates {
            t.rebase(&pose, &moved);
        }
    }
    let measurer = Measurer::with_templates(calibration.clone(), model.clone(), templates.clone());
    let (check, _) = measure_from(&measurer, capture, load, &mut |_| ())?;
    if check.camera_from_vehicle.is_none() {
        return Err(TeachError::SelfCheck { detail: check.detail });
    }
    Ok(Taught { model, templates, check })
}

fn refusal(feature: &Feature, code: Code, what: impl Into<String>) -> TeachError {
    TeachError::Feature { feature: feature.name.clone(), code, what: what.into() }
}

fn pose_of(features: &VehicleFile, points: &[Point3<frame::Camera>]) -> Result<CameraFromVehicle, NoPose> {
    let pair = |(f, p): (&Feature, &Point3<frame::Camera>)| Pair {
        measured: *p,
        nominal: f.position(),
        covariance: Matrix3::identity() * (f.pixel_sigma * 0.5 + f.position_sigma_mm + 0.01).powi(2),
    };
    Ok(register(&features.features.iter().zip(points).map(pair).collect::<Vec<_>>())?.a_from_b)
}

/// Local frames and patches about the points: w along the surface's normal, v up the vehicle, u level.
fn place(
    features: &VehicleFile,
    clicks: &[Pixel],
    pose: &CameraFromVehicle,
    points: &[Point3<frame::Camera>],
    body: &BodyDepth<'_>,
    camera: &Lens,
    panel: &Image<bool>,
) -> Result<Vec<Placed>, TeachError> {
    let up = pose.r * Vector3::z();
    let mut out = Vec::new();
    for ((feature, click), point) in features.features.iter().zip(clicks).zip(points) {
        let frame_at = |point: Point3<frame::Camera>, surface: &Surface<frame::Camera>| {
            let w = surface.normal(&surface.local.coordinates(point).xy());
            let w = if w.dot(&point.xyz) > 0.0 { -w } else { w }; // outward is towards the camera
            let u = up.cross(&w).normalize();
            Local { origin: point, axes: Matrix3::from_columns(&[u, w.cross(&u), w]) }
        };
        let patch_about = |local: Local<frame::Camera>| {
            let mask = mask_about(camera, panel, |uv| surface_point(&body.coarse, &local, uv)).eroded(EROSION_MM.1);
            let panel = Panel::new(mask);
            let site = Site { local, panel: &panel };
            let patch = Samples::new(&body.map, camera, &site, panel.hole_mm + body::REACH_MM, &body.coarse)
                .patch(&site, &Shape::Smooth(site.radii()[1]))
                .map_err(|code| {
                    refusal(
                        feature,
                        code,
                        "the surface about it cannot be measured: choose a capture without glare there",
                    )
                })?;
            Ok::<_, TeachError>((panel, patch))
        };
        let local = frame_at(*point, &body.coarse);
        let (about, patch) = patch_about(local)?;
        let ray = camera.ray(click).expect("checked above");
        let missed = || refusal(feature, Code::CoverageLow, "the click's ray misses the surface");
        let met = patch.surface.meet(&ray, 0.0).ok_or_else(missed)?;
        let lift = if matches!(feature.kind, Kind::Ellipse | Kind::Outline) {
            body::bridge(&body.map, camera, &Site { local, panel: &about }, &patch.surface, &met.xy()).unwrap_or(0.0)
        } else {
            0.0
        };
        let met = patch.surface.meet(&ray, -lift).ok_or_else(missed)?;
        // the frame that is remembered has its origin in the point and its w along the normal there
        let local = frame_at(patch.surface.local.point(&met), &patch.surface);
        let (_, patch) = patch_about(local)?;
        out.push(Placed { local, patch });
    }
    Ok(out)
}

/// The point of `surface` over (u, v) of another local frame: along that frame's w.
fn surface_point(
    surface: &Surface<frame::Camera>,
    local: &Local<frame::Camera>,
    uv: Vector2<f64>,
) -> Point3<frame::Camera> {
    let (mut w, axis) = (0.0, Vector3::from(local.axes.column(2)));
    for _ in 0..3 {
        let c = surface.local.coordinates(local.point(&uv.push(w)));
        let off = surface.polynomial.height(&c.xy()) - c.z;
        w += off * surface.local.axes.column(2).dot(&axis);
    }
    local.point(&uv.push(w))
}

/// The panel as seen about a local frame.
fn mask_about(camera: &Lens, panel: &Image<bool>, point: impl Fn(Vector2<f64>) -> Point3<frame::Camera>) -> PanelMask {
    PanelMask::new(1.0, MASK_MM as u32, |uv| {
        camera.project(&point(uv).xyz).is_some_and(|p| {
            let (x, y) = (p.x.round(), p.y.round());
            x >= 0.0
                && y >= 0.0
                && x < panel.width as f64
                && y < panel.height as f64
                && panel.at(x as usize, y as usize)
        })
    })
}

/// Nominal against clicked distances: units, sides and mixed-up features show here.
/// `sigma_mm` says how well each point is known.
fn check_distances(
    features: &VehicleFile,
    points: &[Point3<frame::Camera>],
    sigma_mm: impl Fn(&Feature, &Point3<frame::Camera>) -> f64,
) -> Result<(), TeachError> {
    for (i, a) in features.features.iter().enumerate() {
        for (j, b) in features.features.iter().enumerate().take(i) {
            let nominal = (a.position() - b.position()).norm();
            let clicked = (points[i] - points[j]).norm();
            let sigma = (sigma_mm(a, &points[i]).powi(2)
                + sigma_mm(b, &points[j]).powi(2)
                + a.position_sigma_mm.powi(2)
                + b.position_sigma_mm.powi(2))
            .sqrt();
            let allowed = features.limits.distance_mm + 4.0 * sigma;
            if (clicked - nominal).abs() > allowed {
                let ratio = nominal / clicked;
                let hint = match ratio {
                    r if (r * 25.4 - 1.0).abs() < 0.05 => "; are the positions in inches?",
                    r if (r * 10.0 - 1.0).abs() < 0.05 => "; are the positions in centimetres?",
                    r if (r * 1000.0 - 1.0).abs() < 0.05 => "; are the positions in metres?",
                    _ => "; check the clicks, the positions and the calibration",
                };
                let value = format!("{:?}, {nominal:.3} mm from {}", a.position_mm, b.name);
                let wanted = format!("the clicks' {clicked:.3} mm ± {allowed:.3} mm{hint}");
                Check(&features.file).that(false, format!("feature[{i}].position_mm"), value, wanted)?;
            }
        }
    }
    Ok(())
}

/// The panel must face away from the vehicle's middle: where it does not, left and right are mixed up.
fn check_side(features: &VehicleFile, placed: &[Placed], pose: &CameraFromVehicle) -> Result<(), TeachError> {
    for (i, (feature, placed)) in features.features.iter().zip(placed).enumerate() {
        let outward = pose.r.inverse() * Vector3::from(placed.local.axes.column(2));
        let y = feature.position_mm[1];
        if outward.y * y < 0.0 {
            let wanted =
                "a point of the side that faces the camera; these are mirrored: is the sign of y wrong (y is left)?";
            Check(&features.file).that(
                false,
                format!("feature[{i}].position_mm"),
                format!("{:?}", feature.position_mm),
                wanted,
            )?;
        }
    }
    Ok(())
}

/// What templates are made from.
struct Scene<'a> {
    camera: &'a Lens,
    panel: &'a Image<bool>,
    raw: &'a Image<f32>,
    edge_rays: &'a [EdgeRay],
    calibration: &'a Calibration,
}

impl Scene<'_> {
    fn template(
        &self,
        feature: &Feature,
        click: &Pixel,
        placed: &Placed,
        pose: &CameraFromVehicle,
    ) -> Result<Template, TeachError> {
        let depth = feature.edge_depth_mm.unwrap_or(match feature.kind {
            Kind::Corner => CORNER_HEM_MM,
            Kind::Ellipse | Kind::Outline => FLAP_HEM_MM,
            Kind::ArchTop => ARCH_HEM_MM,
        });
        let reach = match feature.kind {
            Kind::Corner => CORNER_MM,
            Kind::Ellipse | Kind::Outline => FLAP_MM,
            Kind::ArchTop => 1.1 * ARCH_WINDOW_MM,
        };
        let mut edges = on_panel(self.edge_rays, &placed.patch, depth, reach);
        let own = |e: &PanelEdge| {
            let edgel = &self.edge_rays[e.ray].edgel;
            let wanted = feature.edge == Edge::Opening || !matches!(feature.kind, Kind::Ellipse | Kind::Outline);
            // up the bright side: beyond the edge's blur and most of its hem, before anything else
            let up = (BRIGHT_SIDE_MM * self.camera.fx / TYPICAL_DISTANCE_MM).max(2.5);
            self.on_panel(&(edgel.position + up * edgel.normal)) == wanted
        };
        edges.retain(own);
        let to_vehicle = pose.inverse();
        let axes = to_vehicle.r * placed.local.axes;
        let mut anchor = Anchor::Contour;
        let chosen: Vec<&PanelEdge> = match feature.kind {
            Kind::Corner => edges.iter().collect(),
            Kind::Ellipse | Kind::Outline => self.ring(feature, &edges)?,
            Kind::ArchTop => {
                edges.iter().filter(|e| e.point.normal.y > 0.5 && e.point.position.y.abs() < 0.5 * reach).collect()
            }
        };
        if chosen.len() < 20 {
            return Err(refusal(
                feature,
                Code::ContourIncomplete,
                format!(
                    "{} edge points of the panel near the click, at least 20 needed: check the click and the light",
                    chosen.len()
                ),
            ));
        }
        match feature.kind {
            Kind::Ellipse => {
                let points: Vec<_> = chosen.iter().map(|e| (e.point.position, e.point.variance)).collect();
                let limits = EllipseLimits { coverage: 0.8, semi_axes: 10.0..=FLAP_MM };
                let fit = fit_ellipse(&points, &limits).map_err(|e| refusal(feature, Code::Ellipse, e.to_string()))?;
                let off =
                    fit.scale * median(&mut points.iter().map(|(_, variance)| variance.sqrt()).collect::<Vec<_>>());
                if off > ELLIPSE_SIGMA_MM {
                    return Err(refusal(
                        feature,
                        Code::Ellipse,
                        format!(
                            "its contour is {off:.2} mm (robust sigma) off an ellipse, allowed {ELLIPSE_SIGMA_MM}; use kind = \"outline\""
                        ),
                    ));
                }
                let (major, minor) = fit.ellipse.semi_axes();
                anchor = Anchor::Ellipse { centre_mm: fit.ellipse.centre.into(), semi_axes_mm: [major, minor] };
            }
            Kind::ArchTop => {
                let up = (axes[(2, 1)], axes[(2, 2)]);
                let points: Vec<_> = chosen
                    .iter()
                    .map(|e| {
                        (
                            e.point.position.x,
                            e.point.position.y * up.0 + e.w * up.1,
                            e.point.variance / e.point.normal.y.powi(2),
                        )
                    })
                    .collect();
                let mut centre = 0.0;
                let mut top = None;
                for _ in 0..3 {
                    let found = arch_top(&points, centre, ARCH_WINDOW_MM)
                        .map_err(|e| refusal(feature, Code::ArchHidden, e.to_string()))?;
                    centre = found.along;
                    top = Some(found);
                }
                let top = top.expect("the loop runs");
                anchor = Anchor::ArchTop { u_mm: top.along, height_mm: top.height };
            }
            Kind::Corner | Kind::Outline => {}
        }
        let step = (chosen.len() / 600).max(1);
        let contour =
            chosen.iter().step_by(step).map(|e| ContourPoint::new(e.point.position, e.point.normal)).collect();

        let field = search_field(self.raw, placed.local.origin.xyz.z / self.camera.fx);
        let px_per_mm = self.camera.fx / placed.local.origin.xyz.z;
        let extent = if feature.kind == Kind::Corner {
            CORNER_MM
        } else {
            chosen.iter().map(|e| e.point.position.norm()).fold(0.0, f64::max) + 4.0
        };
        let shape: Vec<ContourPoint> = field
            .points(click, extent * px_per_mm)
            .iter()
            .filter_map(|p| {
                let at = placed.patch.surface.meet(&self.camera.ray(&(click + p.offset))?, depth)?;
                let bright = placed.patch.surface.meet(&self.camera.ray(&(click + p.offset + p.direction))?, depth)?;
                Some(ContourPoint::new(at.xy(), (bright - at).xy().normalize()))
            })
            .filter(|p| chosen.iter().any(|e| (e.point.position - p.at()).norm() < 5.0))
            .collect();
        if shape.len() < 10 {
            return Err(refusal(
                feature,
                Code::ContourIncomplete,
                "too few strong edges about the click to find it again: check the click and the light",
            ));
        }
        let jacobian = super::regions::local_pixels_per_mm(&placed.local, self.camera);
        let mm_per_px =
            jacobian.try_inverse().ok_or_else(|| refusal(feature, Code::NotSmooth, "the surface is seen edge-on"))?;
        let click_covariance: Matrix2<f64> = mm_per_px * mm_per_px.transpose() * feature.pixel_sigma.powi(2);
        let row = |k: usize| [axes[(0, k)], axes[(1, k)], axes[(2, k)]];
        let m = pose.r.matrix();
        let mut template = Template {
            feature: feature.name.clone(),
            calibration: self.calibration.id.clone().unwrap_or_default(),
            taught_rotation: std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)])),
            taught_translation_mm: pose.t.into(),
            point_mm: (to_vehicle * placed.local.origin).xyz.into(),
            at_mm: [0.0; 3],
            axes: [row(0), row(1), row(2)],
            edge_depth_mm: depth,
            contour,
            anchor,
            shape,
            shape_pixel_mm: search_factor(1.0 / px_per_mm) as f64 / px_per_mm,
            panel: mask_about(self.camera, self.panel, |uv| placed.patch.surface.point(&uv)),
            surface: {
                let (scale_mm, coefficients) = placed.patch.surface.polynomial.coefficients();
                TaughtSurface { radius_mm: placed.patch.surface.radius_mm, scale_mm, coefficients }
            },
            covariance_mm2: std::array::from_fn(|i| std::array::from_fn(|j| click_covariance[(i, j)])),
            height_sigma_mm: placed.patch.surface.sigma_mm(&Vector2::zeros()).hypot(HEIGHT_SIGMA_MM),
        };
        if feature.definition() != Definition::AsTaught {
            super::corner::redefine(&mut template, feature.definition())
                .map_err(|what| refusal(feature, Code::ContourIncomplete, what))?;
        }
        Ok(template)
    }

    fn on_panel(&self, p: &Pixel) -> bool {
        let (x, y) = (p.x.round(), p.y.round());
        x >= 0.0
            && y >= 0.0
            && x < self.panel.width as f64
            && y < self.panel.height as f64
            && self.panel.at(x as usize, y as usize)
    }

    /// The closed contour about the click: the smallest that goes all around it with its bright side out (the
    /// opening) or in (the flap).
    fn ring<'e>(&self, feature: &Feature, edges: &'e [PanelEdge]) -> Result<Vec<&'e PanelEdge>, TeachError> {
        let outwards = if feature.edge == Edge::Opening { 1.0 } else { -1.0 };
        let facing: Vec<&PanelEdge> =
            edges.iter().filter(|e| e.point.normal.dot(&e.point.position.normalize()) * outwards > 0.5).collect();
        let edgels: Vec<_> = facing.iter().map(|e| self.edge_rays[e.ray].edgel).collect();
        let chains = join(link(&edgels, 2.5), 12.0);
        let position = |e: &crate::contour::Edgel| {
            facing.iter().find(|f| self.edge_rays[f.ray].edgel.position == e.position).copied()
        };
        let mut rings: Vec<Vec<&PanelEdge>> = chains
            .iter()
            .filter(|c| c.roundness() > RING_ROUNDNESS)
            .map(|c: &Chain| c.edgels.iter().filter_map(position).collect::<Vec<_>>())
            .filter(|ring: &Vec<&PanelEdge>| all_around(ring))
            .collect();
        rings.sort_by(|a, b| size(a).total_cmp(&size(b)));
        let found = rings.into_iter().next();
        found.ok_or_else(|| {
            refusal(
                feature,
                Code::ContourIncomplete,
                "no closed contour goes around the click: is the flap closed, and its gap dark all around?",
            )
        })
    }
}

fn size(ring: &[&PanelEdge]) -> f64 {
    ring.iter().map(|e| e.point.position.norm()).sum::<f64>() / ring.len() as f64
}

/// Seen in at least 32 of 36 directions.
fn all_around(ring: &[&PanelEdge]) -> bool {
    let mut seen = [false; 36];
    for e in ring {
        let turn =
            e.point.position.y.atan2(e.point.position.x).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
        seen[((turn * 36.0) as usize).min(35)] = true;
    }
    seen.iter().filter(|s| **s).count() >= 32
}

//! One feature in 3D: its edges on the panel's surface, laid onto the taught contour.
//! In:  the template, a pose near the truth, the patch, edge rays. Out: the taught point in camera coordinates with
//! its covariance, or a code. Not here: which edges exist, the surface, the pose that all features make.
//!
//! Rotation is the pose's, not the contour's: a corner a few cm long knows it worse than features half a metre
//! apart. Edges are met with the surface moved inwards by the depth of the rolled hem.

use super::body::Patch;
use super::edges::EdgeRay;
use super::hem;
use crate::calibrate::{PointJacobian, Sensitivity};
use crate::code::Code;
use crate::contour::{
    Alignment, AlignmentOptions, ContourPoint, EllipseLimits, Motion, NoAlignment, TemplatePoint, align, arch_top,
    fit_ellipse,
};
use crate::fringe::Axis;
use crate::geometry::{Point3, Polynomial, frame};
use crate::lent::List;
use crate::optics::Rig;
use crate::vehicle::{Anchor, Template};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// A feature's point and how well it is known.
#[derive(Clone, Debug)]
pub(crate) struct Located {
    /// The taught point, camera frame, mm.
    pub(crate) point: Point3<frame::Camera>,
    /// Its covariance from noise, camera axes, mm².
    pub(crate) noise: Matrix3<f64>,
    /// How it follows the calibrated parameters, camera axes, mm per unit.
    pub(crate) response: PointJacobian,
    /// Outward normal of the panel there, camera axes.
    pub(crate) normal: Vector3<f64>,
    /// What it would be if the panel stood to the pose as it was taught.
    pub(crate) taught_normal: Vector3<f64>,
    /// Share of the contour that was seen, 0..=1.
    pub(crate) share: f64,
    /// How far its contour has grown; for all features that of the flap's opening counts, mm.
    pub(crate) growth_mm: f64,
    /// Where the contour's points lie in the image, and how far off the template, mm: for the overlay.
    pub(crate) contour: List<(crate::optics::Pixel, f64)>,
}

/// An edge on the panel, in local coordinates.
pub(crate) struct PanelEdge {
    pub(crate) point: ContourPoint,
    /// Local w of the edge, mm.
    pub(crate) w: f64,
    /// Index among the edge rays.
    pub(crate) ray: usize,
}

/// How far an edge on a rolled hem moves with paint and light, 1 sigma, mm: several times its noise, so without it
/// the stretch of a contour that happens to be sharpest would carry the fit.
const EDGE_SHIFT_MM: f64 = 0.02;
/// Where a hem turns out of sight is where its edge is, whatever the paint: half the contrast is passed sooner on a
/// paint that darkens sooner as it turns away, by up to 0.15 mm on silver against white. The level at which a profile
/// ends would be hidden by blur and by what lies in the gap; edges are moved on by this share of their softness, as if
/// the profile ran straight on to a quarter of the contrast. More would follow the blur.
const SILHOUETTE: f64 = 0.25;
/// A hem that turns away from a panel stays bright for longer where the light comes from beyond it: a radius r fades to half
/// where it has turned by 60°, and per radian that the light slants its edge moves by r·cos 60°. Across upright edges
/// (local u) and across level ones (v), which see both bars alike. Found on the independent captures: along over 12.5° of
/// yaw, where it was 0.09 mm at the features' centroid; up over what stands higher or leans, 0.03 mm there, and on the
/// simulated station over ±50 mm and ±3°, where it is the same.
const HEM_LIGHT_MM: Vector2<f64> = Vector2::new(0.35, 0.62);

/// Where light falls in from at `p`, camera frame: the bars stand at the camera's height, equally far to both sides and
/// equally bright. Their light slants the more the lower `p` lies. Along it does not: nearer to the one, its light falls in
/// more from across, but there is more of it.
fn light_at(p: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(0.0, -p.y / p.z, -1.0)
}

/// Least share of a contour that must be seen.
const MIN_SHARE: f64 = 0.55;
/// An ellipse must be seen all around and have the taught size.
const ELLIPSE_COVERAGE: f64 = 0.7;
const ELLIPSE_SIZE_MM: f64 = 1.0;
/// The pose's turn about the panel's normal while a feature is located, 1 sigma, rad: an arch's top slides along by
/// its radius times that, and must not be what the turn is then taken from.
pub(crate) const ARCH_TURN_RAD: f64 = 1e-3;
/// An arch is looked at this far to both sides of its top, mm.
pub(crate) const ARCH_WINDOW_MM: f64 = 80.0;

/// The edges whose rays meet the patch, moved in by `depth_mm`, within `reach_mm` of the local origin.
pub(crate) fn on_panel(rays: &[EdgeRay], patch: &Patch, depth_mm: f64, reach_mm: f64) -> List<PanelEdge> {
    let local = &patch.surface.local;
    let normal: Vector3<f64> = local.axes.column(2).into();
    let height = normal.dot(&local.origin.xyz);
    let light: Vector3<f64> = local.axes.transpose() * light_at(&local.origin.xyz);
    let hem_shift = (light.xy() / light.z).component_mul(&HEM_LIGHT_MM);
    let near = |ray: &Vector3<f64>| {
        local.coordinates(Point3::new(ray * (height / normal.dot(ray)))).xy().norm() <= 1.1 * reach_mm
    };
    let edge = |(k, e): (usize, &EdgeRay)| {
        let at = patch.surface.meet(&e.ray, depth_mm)?;
        let bright = patch.surface.meet(&e.bright, depth_mm)?;
        let step = (bright - at).xy();
        let variance = e.edgel.variance * step.norm_squared() + EDGE_SHIFT_MM.powi(2);
        let normal = step.normalize();
        let moved_on = step * (SILHOUETTE * e.softness_px) + normal * normal.dot(&hem_shift);
        let position = at.xy() - moved_on;
        Some(PanelEdge { point: ContourPoint { position, normal, variance }, w: at.z, ray: k })
    };
    let edges = rays.iter().enumerate().filter(|(_, e)| near(&e.ray)).filter_map(edge);
    List::of(edges.filter(|e| e.point.position.norm() <= reach_mm))
}

/// Locates the taught point, looking for the contour within `capture_mm` of where the pose expects it. Depth came from
/// the projector's `axis`.
pub(crate) fn locate(
    template: &Template,
    taught_surface: &Polynomial,
    patch: &Patch,
    rays: &[EdgeRay],
    capture_mm: f64,
    (rig, axis): (&Rig, Axis),
) -> Result<Located, Code> {
    let shape = List::of(template.contour.iter().map(|p| TemplatePoint { position: p.at(), normal: p.normal() }));
    let reach = shape.iter().map(|p| p.position.norm()).fold(0.0, f64::max) + capture_mm;
    let edges = on_panel(rays, patch, template.edge_depth_mm, reach);
    let points = List::of(edges.iter().map(|e| e.point));
    let options = AlignmentOptions {
        rotate: false,
        capture: (capture_mm, capture_mm.min(1.0)),
        share: MIN_SHARE,
        stiffness: if matches!(template.anchor, Anchor::ArchTop { .. }) { 0.0 } else { 0.02 },
    };
    let aligned = align(&shape, &points, Motion::default(), &options).map_err(|e| refusal(e, &template.anchor))?;
    let (at, covariance) = match template.anchor {
        Anchor::Contour => (aligned.motion.shift, in_plane(&aligned)),
        Anchor::Ellipse { semi_axes_mm, .. } => {
            let on_curve = List::of(aligned.used.iter().map(|&k| (points[k].position, points[k].variance)));
            let [major, minor] = semi_axes_mm;
            let limits = EllipseLimits {
                coverage: ELLIPSE_COVERAGE,
                semi_axes: minor - ELLIPSE_SIZE_MM..=major + ELLIPSE_SIZE_MM,
            };
            fit_ellipse(&on_curve, &limits).map_err(|_| Code::Ellipse)?;
            // its centre is carried by the taught ellipse as a whole: one that may change its axes follows the
            // hem's shading, which differs with paint above and below by several tenths of a mm
            (aligned.motion.shift, in_plane(&aligned))
        }
        Anchor::ArchTop { u_mm, height_mm } => arch(template, patch, &edges, &aligned, u_mm, height_mm)?,
    };
    let surface = &patch.surface;
    let mut noise = Matrix3::zeros();
    noise.fixed_view_mut::<2, 2>(0, 0).copy_from(&covariance);
    noise[(2, 2)] = surface.sigma_mm(&at).powi(2);
    let axes = surface.local.axes;
    // the taught point need not lie on the polynomial: a flap's centre is bridged over the hole
    let taught = Vector3::from(template.at_mm);
    let at = at + taught.xy();
    let lift = taught_surface.height(&taught.xy()) - taught.z;
    let w = surface.polynomial.height(&at) - lift;
    let point = surface.local.point(&at.push(w));
    Ok(Located {
        point,
        response: Sensitivity::new(rig, axis, &point).ok_or(Code::OutOfVolume)?.point,
        noise: axes * noise * axes.transpose(),
        normal: surface.normal(&at),
        taught_normal: {
            let slope = taught_surface.slope(&taught.xy());
            (surface.local.axes * Vector3::new(-slope.x, -slope.y, 1.0)).normalize()
        },
        share: aligned.share,
        growth_mm: hem::growth_mm(aligned.used.iter().zip(&aligned.distances).map(|(&k, d)| (*d, points[k].normal))),
        contour: List::of(
            aligned.used.iter().zip(&aligned.distances).map(|(&k, d)| (rays[edges[k].ray].edgel.position, *d)),
        ),
    })
}

fn in_plane(aligned: &Alignment) -> Matrix2<f64> {
    aligned.covariance.fixed_view::<2, 2>(0, 0) * aligned.scale.powi(2)
}

/// The arch's highest point along the vehicle's z, which the local frame knows: u is level by construction.
fn arch(
    template: &Template,
    patch: &Patch,
    edges: &[PanelEdge],
    aligned: &Alignment,
    u_mm: f64,
    height_mm: f64,
) -> Result<(Vector2<f64>, Matrix2<f64>), Code> {
    let [_, up_v, up_w] = template.axes.map(|axis| axis[2]);
    let height = |uv: &Vector2<f64>, w: f64| uv.y * up_v + w * up_w;
    let points = List::of(aligned.used.iter().map(|&k| {
        let e = &edges[k];
        (e.point.position.x, height(&e.point.position, e.w), e.point.variance / e.point.normal.y.powi(2))
    }));
    let top = arch_top(&points, aligned.motion.shift.x + u_mm, ARCH_WINDOW_MM).map_err(|_| Code::ArchHidden)?;
    let (u, h) = (top.along - u_mm, top.height - height_mm);
    let mut at = Vector2::new(u, h / up_v);
    for _ in 0..5 {
        at.y = (h - patch.surface.polynomial.height(&at) * up_w) / up_v;
    }
    let mut covariance = top.covariance * top.scale.powi(2);
    covariance[(0, 0)] += (top.radius * ARCH_TURN_RAD).powi(2);
    Ok((at, covariance))
}

fn refusal(e: NoAlignment, anchor: &Anchor) -> Code {
    match (e, anchor) {
        (_, Anchor::ArchTop { .. }) => Code::ArchHidden,
        (NoAlignment::TooFewPoints { .. } | NoAlignment::Share { .. }, _) => Code::ContourIncomplete,
        (NoAlignment::Slides { .. }, _) => Code::ScoreLow,
    }
}

//! What teaching remembers of a feature: its contour, its panel, its coarse shape, all in millimetres on the body.
//! In:  what `teach` saw. Out: a small binary file beside the vehicle file, and back, checked.
//! Metric, so it survives a new calibration or camera. Not here: how it is made or used.

use crate::geometry::{Local, Point3, Polynomial, Pose, frame, rotation_from_rows};
use crc::{CRC_32_ISO_HDLC, Crc};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// First bytes of a template file; the last one is the major version.
const MAGIC: [u8; 8] = *b"datumtp\x04";

/// One taught feature. Local coordinates: u, v along the panel, w outward, origin where it was clicked, mm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Template {
    /// The feature's name in the vehicle file.
    pub feature: String,
    /// Id of the calibration at teaching; empty where it had none.
    pub calibration: String,
    /// Rotation (rows) of the taught `camera_from_vehicle`.
    pub taught_rotation: [[f64; 3]; 3],
    /// Translation of the taught `camera_from_vehicle`, mm.
    pub taught_translation_mm: [f64; 3],
    /// The origin, where it was clicked, in the taught vehicle's frame, mm.
    pub point_mm: [f64; 3],
    /// The taught point in local coordinates, mm: the origin, unless a definition moved it.
    pub at_mm: [f64; 3],
    /// Rows: the local axes u, v, w in the vehicle frame.
    pub axes: [[f64; 3]; 3],
    /// How far below the surface the visible edge was taken to lie, mm.
    pub edge_depth_mm: f64,
    /// The panel's edges about the point.
    pub contour: Vec<ContourPoint>,
    /// What carries the point.
    pub anchor: Anchor,
    /// Coarse edges for the search: both sides of a gap.
    pub shape: Vec<ContourPoint>,
    /// Size of a pixel of the field that `shape` was taken from, mm.
    pub shape_pixel_mm: f64,
    /// Which of the surroundings is the panel that carries the features.
    pub panel: PanelMask,
    /// The panel's shape about the point.
    pub surface: TaughtSurface,
    /// Covariance of the taught point along (u, v), mm²: the click, or the edges it was tied to.
    pub covariance_mm2: [[f64; 2]; 2],
    /// Standard deviation of the taught point along w, mm: of the surface it was put on.
    pub height_sigma_mm: f64,
}

/// A point of a contour in local coordinates, with the unit normal towards bright.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContourPoint {
    /// Along u, mm.
    pub u: f32,
    /// Along v, mm.
    pub v: f32,
    /// Normal along u.
    pub nu: f32,
    /// Normal along v.
    pub nv: f32,
}

impl ContourPoint {
    /// From position (mm) and normal.
    pub fn new(at: Vector2<f64>, normal: Vector2<f64>) -> Self {
        Self { u: at.x as f32, v: at.y as f32, nu: normal.x as f32, nv: normal.y as f32 }
    }

    /// Position, mm.
    pub fn at(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.u), f64::from(self.v))
    }

    /// Unit normal.
    pub fn normal(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.nu), f64::from(self.nv))
    }
}

/// What in the contour carries the taught point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Anchor {
    /// The contour as a whole.
    Contour,
    /// The centre of the ellipse fitted to the contour.
    Ellipse {
        /// Its centre in local coordinates, mm.
        centre_mm: [f64; 2],
        /// Semi-axes, major first, mm.
        semi_axes_mm: [f64; 2],
    },
    /// The highest point of the contour along the vehicle's z.
    ArchTop {
        /// Along u, mm.
        u_mm: f64,
        /// Height over the taught point along the vehicle's z, mm.
        height_mm: f64,
    },
}

/// Height over the local plane as a polynomial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaughtSurface {
    /// It holds this far from the point, mm.
    pub radius_mm: f64,
    /// u and v are in units of this, mm.
    pub scale_mm: f64,
    /// By rising degree, mm.
    pub coefficients: Vec<f64>,
}

impl TaughtSurface {
    /// As a polynomial; `None` where the numbers make none.
    pub fn polynomial(&self) -> Option<Polynomial> {
        Polynomial::from_coefficients(self.scale_mm, &self.coefficients)
    }
}

/// A square grid over the local plane; a bit is set where the panel is seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PanelMask {
    /// Side of a cell, mm.
    pub cell_mm: f64,
    /// The grid covers −half..=half cells about the origin.
    pub half: u32,
    /// One bit a cell, row by row (v, then u).
    pub bits: Vec<u8>,
}

impl PanelMask {
    /// The mask of the cells whose centre `is_panel` says yes to.
    pub fn new(cell_mm: f64, half: u32, is_panel: impl Fn(Vector2<f64>) -> bool) -> Self {
        let side = 2 * half as usize + 1;
        let mut bits = vec![0; (side * side).div_ceil(8)];
        for k in 0..side * side {
            let centre = Vector2::new((k % side) as f64 - f64::from(half), (k / side) as f64 - f64::from(half));
            if is_panel(centre * cell_mm) {
                bits[k / 8] |= 1 << (k % 8);
            }
        }
        Self { cell_mm, half, bits }
    }

    /// Whether (u, v) mm lies on the panel; outside the grid it does not.
    pub fn contains(&self, uv: &Vector2<f64>) -> bool {
        let (half, side) = (f64::from(self.half), self.side());
        // rounded by cutting off, as a call of `round` per pixel is what some processors have instead
        let (i, j) = (uv.x / self.cell_mm + half + 0.5, uv.y / self.cell_mm + half + 0.5);
        if !(0.0..side as f64).contains(&i) || !(0.0..side as f64).contains(&j) {
            return false;
        }
        self.bit(j as usize * side + i as usize)
    }

    /// How far from the origin the panel begins, mm: the median over all directions that meet it. 0 at a corner,
    /// the opening's radius at a flap.
    pub fn hole_mm(&self) -> f64 {
        let reach = f64::from(self.half) * self.cell_mm;
        let mut first: Vec<f64> = (0..72)
            .filter_map(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 72.0).sin_cos();
                let steps = (0..).map(|i| f64::from(i) * self.cell_mm).take_while(|r| *r <= reach);
                steps.into_iter().find(|r| self.contains(&Vector2::new(r * cos, r * sin)))
            })
            .collect();
        if first.is_empty() { 0.0 } else { crate::geometry::robust::median(&mut first) }
    }

    /// The mask with all that is within `mm` of it along u and v; less at the grid's border.
    pub fn grown(&self, mm: f64) -> Self {
        let steps = (mm / self.cell_mm).ceil() as u32;
        let along = |mask: &Self, v: bool| {
            let away = mask.away(true, v);
            mask.of_cells(|k| away[k] <= steps)
        };
        along(&along(self, false), true)
    }

    /// The mask less all that is within `mm` of what is not panel; the grid's border does not count.
    pub fn eroded(&self, mm: f64) -> Self {
        let (side, square) = (self.side(), (mm / self.cell_mm).powi(2));
        let steps = (mm / self.cell_mm).ceil() as usize;
        let away = self.away(false, false);
        self.of_cells(|k| {
            let (i, j) = (k % side, k / side);
            let mut rows = j.saturating_sub(steps)..(j + steps + 1).min(side);
            rows.all(|row| f64::from(away[row * side + i]).powi(2) + row.abs_diff(j).pow(2) as f64 > square)
        })
    }

    fn side(&self) -> usize {
        2 * self.half as usize + 1
    }

    fn bit(&self, k: usize) -> bool {
        self.bits.get(k / 8).is_some_and(|b| b >> (k % 8) & 1 == 1)
    }

    /// A mask of the same cells, of which each is as `is_panel` says by its number.
    fn of_cells(&self, is_panel: impl Fn(usize) -> bool) -> Self {
        let cells = self.side() * self.side();
        let mut bits = vec![0; cells.div_ceil(8)];
        (0..cells).filter(|k| is_panel(*k)).for_each(|k| bits[k / 8] |= 1 << (k % 8));
        Self { bits, ..*self }
    }

    /// How many cells away, along u or along v, the nearest is that is `wanted`; more than the grid has where there is none.
    fn away(&self, wanted: bool, along_v: bool) -> Vec<u32> {
        let side = self.side();
        let mut away = vec![2 * side as u32; side * side];
        for line in 0..side {
            let place = |n: usize| if along_v { n * side + line } else { line * side + n };
            let mut pass = |n: usize, before: u32| {
                let k = place(n);
                away[k] = if self.bit(k) == wanted { 0 } else { away[k].min(before + 1) };
                away[k]
            };
            (0..side).fold(2 * side as u32, |before, n| pass(n, before));
            (0..side).rev().fold(2 * side as u32, |before, n| pass(n, before));
        }
        away
    }
}

/// Why a template file is not used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TemplateError {
    /// Not one of ours.
    #[error("is no datum template")]
    NotATemplate,
    /// Written by another major version of datum.
    #[error("is a template of major version {found}; this datum reads {}: teach again", MAGIC[7])]
    Version {
        /// Its major version.
        found: u8,
    },
    /// Cut off or changed.
    #[error("is damaged: its CRC-32 is not that of its content; restore it or teach again")]
    Damaged,
    /// Numbers that no teaching writes.
    #[error("is damaged: {what}; restore it or teach again")]
    Implausible {
        /// What is wrong.
        what: &'static str,
    },
}

impl Template {
    /// The file's bytes: magic, postcard, CRC-32 of the postcard.
    pub fn to_bytes(&self) -> Vec<u8> {
        let content = postcard::to_stdvec(self).expect("plain data in memory always serialise");
        let crc = Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(&content);
        [&MAGIC[..], &content, &crc.to_le_bytes()].concat()
    }

    /// A template from a file's bytes, checked.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TemplateError> {
        let Some((magic, rest)) = bytes.split_first_chunk::<8>() else { return Err(TemplateError::NotATemplate) };
        if magic[..7] != MAGIC[..7] {
            return Err(TemplateError::NotATemplate);
        }
        if magic[7] != MAGIC[7] {
            return Err(TemplateError::Version { found: magic[7] });
        }
        let (content, crc) = rest.split_last_chunk::<4>().ok_or(TemplateError::Damaged)?;
        if Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(content) != u32::from_le_bytes(*crc) {
            return Err(TemplateError::Damaged);
        }
        let template: Self = postcard::from_bytes(content).map_err(|_| TemplateError::Damaged)?;
        template.check()?;
        Ok(template)
    }

    fn check(&self) -> Result<(), TemplateError> {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        let implausible = |what| Err(TemplateError::Implausible { what });
        let side = 2 * u64::from(self.panel.half) + 1;
        if rotation_from_rows(self.taught_rotation).is_none() || rotation_from_rows(self.axes).is_none() {
            return implausible("a rotation is no rotation");
        }
        if !positive(self.panel.cell_mm)
            || self.panel.half > 1000
            || self.panel.bits.len() as u64 != (side * side).div_ceil(8)
        {
            return implausible("the panel's mask has the wrong size");
        }
        let finite = |p: &ContourPoint| [p.u, p.v, p.nu, p.nv].iter().all(|v| v.is_finite());
        if self.contour.len() < 10 || self.shape.len() < 10 || !self.contour.iter().chain(&self.shape).all(finite) {
            return implausible("its contour is empty or not finite");
        }
        if !positive(self.shape_pixel_mm)
            || !self.edge_depth_mm.is_finite()
            || !self.at_mm.iter().all(|v| v.is_finite())
            || !self.height_sigma_mm.is_finite()
            || !self.covariance().iter().all(|v| v.is_finite())
        {
            return implausible("a number is not finite");
        }
        if self.surface.polynomial().is_none() || !positive(self.surface.radius_mm) {
            return implausible("its surface is none");
        }
        Ok(())
    }

    /// The taught `camera_from_vehicle`.
    pub fn taught_pose(&self) -> Pose<frame::Camera, frame::Vehicle> {
        let r = rotation_from_rows(self.taught_rotation).expect("checked when read");
        Pose::new(r, Vector3::from(self.taught_translation_mm))
    }

    /// The local frame on a vehicle that stands at `camera_from_vehicle`, in camera coordinates.
    pub fn local(&self, camera_from_vehicle: &Pose<frame::Camera, frame::Vehicle>) -> Local<frame::Camera> {
        let origin = *camera_from_vehicle * Point3::new(Vector3::from(self.point_mm));
        let rows = Matrix3::from_fn(|i, j| self.axes[i][j]);
        Local { origin, axes: camera_from_vehicle.r.matrix() * rows.transpose() }
    }

    /// Re-expresses a template made with the vehicle at `from` for the vehicle at `to`: the body did not move,
    /// its frame did.
    pub(crate) fn rebase(
        &mut self,
        from: &Pose<frame::Camera, frame::Vehicle>,
        to: &Pose<frame::Camera, frame::Vehicle>,
    ) {
        let change = to.inverse() * *from;
        self.point_mm = (change * Point3::new(Vector3::from(self.point_mm))).xyz.into();
        self.axes = self.axes.map(|axis| (change.r * Vector3::from(axis)).into());
        let m = to.r.matrix();
        self.taught_rotation = std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]));
        self.taught_translation_mm = to.t.into();
    }

    /// Covariance of the taught point along (u, v, w), mm².
    pub fn covariance(&self) -> Matrix3<f64> {
        let mut out = Matrix3::zeros();
        out.fixed_view_mut::<2, 2>(0, 0).copy_from(&Matrix2::from_fn(|i, j| self.covariance_mm2[i][j]));
        out[(2, 2)] = self.height_sigma_mm.powi(2);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn template() -> Template {
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let ring: Vec<_> = (0..40)
            .map(|k| Vector2::new(f64::from(k).cos(), f64::from(k).sin()))
            .map(|n| ContourPoint::new(n * 75.0, n))
            .collect();
        Template {
            feature: "cap".into(),
            calibration: String::new(),
            taught_rotation: identity,
            taught_translation_mm: [0.0, 0.0, 800.0],
            point_mm: [-2600.0, 870.0, 740.0],
            at_mm: [0.0; 3],
            axes: identity,
            edge_depth_mm: 0.6,
            contour: ring.clone(),
            anchor: Anchor::Ellipse { centre_mm: [0.0, 0.0], semi_axes_mm: [75.0, 75.0] },
            shape: ring,
            shape_pixel_mm: 2.0,
            panel: PanelMask::new(1.0, 90, |c| c.norm() > 77.0),
            surface: TaughtSurface {
                radius_mm: 90.0,
                scale_mm: 90.0,
                coefficients: vec![0.0, 0.0, 0.0, -1.0, 0.0, -2.0],
            },
            covariance_mm2: [[0.01, 0.0], [0.0, 0.01]],
            height_sigma_mm: 0.01,
        }
    }

    #[test]
    fn a_template_survives_its_file_and_a_flipped_bit_does_not() {
        let bytes = template().to_bytes();
        assert_eq!(Template::from_bytes(&bytes), Ok(template()));
        for k in [8, bytes.len() / 2, bytes.len() - 1] {
            let mut bad = bytes.clone();
            bad[k] ^= 4;
            assert_eq!(Template::from_bytes(&bad), Err(TemplateError::Damaged));
        }
        assert_eq!(Template::from_bytes(&bytes[..20]), Err(TemplateError::Damaged));
        assert_eq!(Template::from_bytes(b"PNG"), Err(TemplateError::NotATemplate));
        let mut newer = bytes;
        newer[7] = 5;
        assert_eq!(Template::from_bytes(&newer), Err(TemplateError::Version { found: 5 }));
    }

    #[test]
    fn masks_erode_and_grow_as_looking_at_every_cell_around_says() {
        let mut noise = crate::testing::Noise::new(5);
        let mut mask = PanelMask::new(0.5, 20, |_| true);
        (0..41 * 41).filter(|_| noise.uniform() < 0.02).for_each(|k| mask.bits[k / 8] &= !(1 << (k % 8)));
        let near = |c: &Vector2<f64>, reach: f64, square: bool, panel: bool| {
            let cells =
                (-20..=20).flat_map(|j| (-20..=20).map(move |i| Vector2::new(f64::from(i), f64::from(j)) * 0.5));
            cells
                .filter(|p| if square { (p - c).amax() <= reach } else { (p - c).norm() <= reach })
                .any(|p| mask.contains(&p) == panel)
        };
        for mm in [0.5, 1.2, 3.0] {
            assert_eq!(mask.eroded(mm), PanelMask::new(0.5, 20, |c| !near(&c, mm, false, false)), "{mm}");
            let holes = PanelMask::new(0.5, 20, |c| !mask.contains(&c));
            let grown = PanelMask::new(0.5, 20, |c| near(&c, (mm / 0.5).ceil() * 0.5, true, false));
            assert_eq!(holes.grown(mm), grown, "{mm}");
        }
    }

    #[test]
    fn erosion_keeps_away_from_the_hole_and_ignores_the_border() {
        let mask = template().panel;
        let eroded = mask.eroded(5.0);
        assert!(mask.contains(&Vector2::new(79.0, 0.0)) && !eroded.contains(&Vector2::new(79.0, 0.0)));
        assert!(eroded.contains(&Vector2::new(84.0, 0.0)) && eroded.contains(&Vector2::new(90.0, 90.0)));
        assert!(!mask.contains(&Vector2::new(0.0, 0.0)) && !mask.contains(&Vector2::new(200.0, 0.0)));
    }
}

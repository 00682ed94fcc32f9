//! Where a vehicle's panel is seen beside its features: for whoever must know how it is lit.
//! In: the first pose of a cycle, the taught panels. Out: pixels. Not here: what their levels mean.

use super::Cycle;
use nalgebra::Vector3;

/// Points of the panel this far about a feature, beyond the hole of a flap, mm.
const ABOUT_MM: f64 = 30.0;
/// From one point to the next, mm.
const STEP_MM: f64 = 3.0;

impl Cycle<'_> {
    /// Pixels of the taught panel about each feature, in the order of the features, as places in an image's rows; empty
    /// where the features were not found in the red image, or the panel is out of the image.
    pub fn panel_pixels(&self) -> Vec<Vec<usize>> {
        let m = self.measurer;
        let camera = &m.calibration.rig.camera;
        let Some(pose) = self.first_pose else { return vec![Vec::new(); m.templates.len()] };
        let of = |(template, panel): (&crate::vehicle::Template, &super::body::Panel)| {
            let local = template.local(&pose);
            let reach = ABOUT_MM + panel.hole_mm;
            let n = (reach / STEP_MM) as i32;
            let places = (-n..=n).flat_map(|i| (-n..=n).map(move |j| (f64::from(i) * STEP_MM, f64::from(j) * STEP_MM)));
            let pixel = |(u, v): (f64, f64)| {
                let at = Vector3::new(u, v, 0.0);
                if at.norm() > reach || !panel.mask.contains(&at.xy()) {
                    return None;
                }
                let p = camera.project(&local.point(&at).xyz)?;
                let (x, y) = (p.x.round(), p.y.round());
                let inside = x >= 0.0 && y >= 0.0 && x < camera.width as f64 && y < camera.height as f64;
                inside.then(|| y as usize * camera.width + x as usize)
            };
            places.filter_map(pixel).collect()
        };
        m.templates.iter().zip(&m.far).map(of).collect()
    }
}

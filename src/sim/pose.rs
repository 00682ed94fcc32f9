//! Where vehicles stand. In: a body, and how far it is off. Out: its pose. Vehicle frame, mm and degrees.
//! Not here: movement in time.

use super::body::Body;
use super::random::Random;
use super::setup::DISTANCE_MM;
use crate::geometry::{EulerDeg, Pose, frame};
use nalgebra::{Rotation3, Vector3};

/// How a vehicle stands beside where it should: a motion about the features' centroid.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Deviation {
    /// Forward, mm.
    pub along_mm: f64,
    /// To the left, which is towards the camera, mm.
    pub across_mm: f64,
    /// mm.
    pub up_mm: f64,
    /// About x, degrees.
    pub roll_deg: f64,
    /// About y, degrees.
    pub pitch_deg: f64,
    /// About z, degrees.
    pub yaw_deg: f64,
}

impl Deviation {
    /// That of a vehicle of `body` which stands at `pose`.
    pub fn of(body: &Body, pose: &Pose<frame::Camera, frame::Vehicle>) -> Self {
        let (should, centroid) = should(body);
        let motion: Pose<frame::Vehicle, frame::Vehicle> = should.inverse() * *pose;
        let shift = motion.t - centroid + motion.r * centroid;
        let e = EulerDeg::from_rotation(&motion.r);
        Self {
            along_mm: shift.x,
            across_mm: shift.y,
            up_mm: shift.z,
            roll_deg: e.roll,
            pitch_deg: e.pitch,
            yaw_deg: e.yaw,
        }
    }

    /// Drawn as vehicles roll into a station: ±12.5° about the vertical, ±50 mm along and across, ±20 mm up, ±1°.
    pub fn random(random: &mut Random) -> Self {
        Self {
            along_mm: random.between(-50.0, 50.0),
            across_mm: random.between(-50.0, 50.0),
            up_mm: random.between(-20.0, 20.0),
            roll_deg: random.between(-1.0, 1.0),
            pitch_deg: random.between(-1.0, 1.0),
            yaw_deg: random.between(-12.5, 12.5),
        }
    }
}

/// Where a vehicle of this body stands that is `deviation` off.
pub fn camera_from_vehicle(body: &Body, deviation: &Deviation) -> Pose<frame::Camera, frame::Vehicle> {
    let (should, centroid) = should(body);
    let d = deviation;
    let turn = EulerDeg { roll: d.roll_deg, pitch: d.pitch_deg, yaw: d.yaw_deg }.to_rotation();
    let shift = Vector3::new(d.along_mm, d.across_mm, d.up_mm);
    should * Pose::<frame::Vehicle, frame::Vehicle>::new(turn, centroid - turn * centroid + shift)
}

/// Where a vehicle of this body should stand, and its features' centroid.
fn should(body: &Body) -> (Pose<frame::Camera, frame::Vehicle>, Vector3<f64>) {
    let features: Vec<Vector3<f64>> = body.features().iter().map(|f| Vector3::from(f.at)).collect();
    let centroid = features.iter().sum::<Vector3<f64>>() / features.len() as f64;
    // the camera looks at the middle of what must be in the image, and a little low
    let flap = features.iter().map(|f| f.z).fold(f64::NEG_INFINITY, f64::max) + body.flap_half()[1];
    let lowest = features.iter().map(|f| f.z).fold(f64::INFINITY, f64::min);
    let left = features.iter().map(|f| f.x).fold(f64::NEG_INFINITY, f64::max);
    let right = features.iter().map(|f| f.x).fold(f64::INFINITY, f64::min);
    let aim = Vector3::new(0.5 * (left + right), centroid.y, 0.5 * (0.5 * (flap + lowest) + centroid.z));
    // camera x is the vehicle's −x, y its −z, z its −y; its mount is a little askew
    let axes = nalgebra::Matrix3::new(-1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, -1.0, 0.0);
    let mount = Rotation3::from_euler_angles(0.0061, -0.0049, 0.0079);
    let r = mount * Rotation3::from_matrix_unchecked(axes);
    (Pose::new(r, Vector3::new(0.0, 0.0, DISTANCE_MM) - r * aim), centroid)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point3;

    #[test]
    fn a_vehicle_turns_about_the_middle_of_its_features_and_nears_the_camera_to_its_left() {
        let body = Body::named("suv-a").expect("listed");
        let features = body.features();
        let middle = features.iter().map(|f| Vector3::from(f.at)).sum::<Vector3<f64>>() / features.len() as f64;
        let seen = |d: &Deviation| (camera_from_vehicle(&body, d) * Point3::new(middle)).xyz;
        let still = seen(&Deviation::default());
        assert!((still.z - DISTANCE_MM).abs() < 3.0, "{still}");
        assert!((seen(&Deviation { yaw_deg: 12.5, roll_deg: -1.0, ..Deviation::default() }) - still).norm() < 1e-9);
        let nearer = seen(&Deviation { across_mm: 50.0, ..Deviation::default() });
        assert!((nearer.z - still.z + 50.0).abs() < 0.1, "{nearer}");
        let d = Deviation::random(&mut Random::new(9, &[]));
        let back = Deviation::of(&body, &camera_from_vehicle(&body, &d));
        assert!((back.yaw_deg - d.yaw_deg).abs() < 1e-9 && (back.up_mm - d.up_mm).abs() < 1e-9, "{back:?} for {d:?}");
    }
}

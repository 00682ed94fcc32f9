//! ISO 8855 angles: R = Rz(yaw)·Ry(pitch)·Rx(roll). Only for people and PLCs; kernels keep rotations.

use nalgebra::Rotation3;

/// Roll, pitch, yaw in degrees; roll and yaw in (−180, 180], pitch in [−90, 90].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EulerDeg {
    /// About x, forward.
    pub roll: f64,
    /// About y, left.
    pub pitch: f64,
    /// About z, up.
    pub yaw: f64,
}

impl EulerDeg {
    /// Angles of `r`. At pitch ±90° only yaw ∓ roll is determined: roll is then 0.
    pub fn from_rotation(r: &Rotation3<f64>) -> Self {
        let m = r.matrix();
        let cos_pitch = m[(0, 0)].hypot(m[(1, 0)]);
        let pitch = (-m[(2, 0)]).atan2(cos_pitch);
        let (roll, yaw) = if cos_pitch > 1e-7 {
            (m[(2, 1)].atan2(m[(2, 2)]), m[(1, 0)].atan2(m[(0, 0)]))
        } else {
            (0.0, (-m[(0, 1)]).atan2(m[(1, 1)]))
        };
        Self { roll: half_open(roll), pitch: pitch.to_degrees(), yaw: half_open(yaw) }
    }

    /// The rotation Rz(yaw)·Ry(pitch)·Rx(roll).
    pub fn to_rotation(self) -> Rotation3<f64> {
        Rotation3::from_euler_angles(self.roll.to_radians(), self.pitch.to_radians(), self.yaw.to_radians())
    }
}

/// Degrees in (−180, 180]: `atan2` gives −180 for a negative zero.
fn half_open(radians: f64) -> f64 {
    let degrees = radians.to_degrees();
    if degrees <= -180.0 { 180.0 } else { degrees }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_round_trip_also_near_the_gimbal() {
        arbtest::arbtest(|u| {
            let mut between = |lo: f64, hi: f64| Ok(lo + (hi - lo) * f64::from(u.arbitrary::<u16>()?) / 65535.0);
            let pitch = if between(0.0, 1.0)? < 0.3 { 90.0 - 1e-7 * between(0.0, 1.0)? } else { between(-90.0, 90.0)? };
            let e = EulerDeg { roll: between(-180.0, 180.0)?, pitch, yaw: between(-180.0, 180.0)? };
            let r = e.to_rotation();
            let back = EulerDeg::from_rotation(&r);
            // near the gimbal the angles trade against each other; the rotation is what counts
            assert!((back.to_rotation().matrix() - r.matrix()).amax() < 1e-6, "{e:?} -> {back:?}");
            assert!(back.roll > -180.0 && back.roll <= 180.0 && back.yaw > -180.0 && back.yaw <= 180.0);
            Ok(())
        });
    }

    #[test]
    fn yaw_is_positive_to_the_left() {
        let nose = EulerDeg { roll: 0.0, pitch: 0.0, yaw: 90.0 }.to_rotation() * nalgebra::Vector3::x();
        assert!((nose - nalgebra::Vector3::y()).norm() < 1e-12);
    }
}

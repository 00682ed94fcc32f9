//! What libcamera is told: which camera, which exposure, gain and interval. In: wishes, and what a camera says of itself.
//! Out: values that its controls take. Pure.

use crate::hal::Error;
use std::ops::RangeInclusive;
use std::time::Duration;

/// A camera as libcamera lists it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Listed {
    /// Where it is attached; the same after every start.
    pub(super) id: String,
    /// Its sensor, or its name.
    pub(super) model: Option<String>,
}

/// The place of the camera that is called so, by its id or its model.
pub(super) fn pick(device: &str, wanted: &str, listed: &[Listed]) -> Result<usize, Error> {
    if let Some(at) = listed.iter().position(|c| c.id == wanted) {
        return Ok(at);
    }
    let of_model: Vec<_> = (0..listed.len()).filter(|k| listed[*k].model.as_deref() == Some(wanted)).collect();
    match of_model[..] {
        [at] => Ok(at),
        [] => {
            let told = |c: &Listed| c.model.as_ref().map_or_else(|| c.id.clone(), |m| format!("{m} ({})", c.id));
            let there = listed.iter().map(told).collect();
            Err(Error::Absent { device: device.into(), what: "libcamera camera", wanted: wanted.into(), there })
        }
        _ => {
            let offered = of_model.iter().map(|k| listed[*k].id.clone()).collect();
            Err(Error::NotOffered {
                device: device.into(),
                what: "a single camera of model",
                wanted: wanted.into(),
                offered,
            })
        }
    }
}

/// The exposure to ask for, µs; `range`: the control's, if the camera has one.
pub(super) fn exposure_us(wanted: Duration, range: Option<RangeInclusive<i32>>) -> i32 {
    let us = i32::try_from((wanted.as_nanos() + 500) / 1000).unwrap_or(i32::MAX);
    let (least, most) = range.map_or((1, i32::MAX), RangeInclusive::into_inner);
    us.min(most).max(least).max(1) // 0 would mean: automatic
}

/// The gain to ask for; libcamera's is at least 1.
pub(super) fn gain(wanted: f64, range: Option<RangeInclusive<f32>>) -> f32 {
    let (least, most) = range.map_or((1.0, f32::MAX), RangeInclusive::into_inner);
    (wanted as f32).min(most).max(least).max(1.0)
}

/// The shortest and the longest interval between images, µs: that of `rate`, and room for an exposure beyond half of it,
/// which no camera exceeds unless the exposure needs it.
pub(super) fn intervals_us(rate: f64, exposure_us: i32) -> [i64; 2] {
    let interval = (1e6 / rate).round() as i64;
    [interval, interval.max(2 * i64::from(exposure_us))]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(id: &str, model: &str) -> Listed {
        Listed { id: id.into(), model: (!model.is_empty()).then(|| model.into()) }
    }

    #[test]
    fn a_camera_is_found_by_its_id_or_its_model() {
        let there = [listed("/base/i2c/imx296@1a", "imx296"), listed("/base/i2c/ov9281@60", "ov9281"), listed("x", "")];
        let pick = |wanted| pick("camera", wanted, &there);
        assert_eq!(pick("/base/i2c/ov9281@60").expect("by id"), 1);
        assert_eq!(pick("imx296").expect("by model"), 0);
        let says = "camera: no libcamera camera \"imx477\", there: imx296 (/base/i2c/imx296@1a), ov9281 \
                    (/base/i2c/ov9281@60), x";
        assert_eq!(pick("imx477").expect_err("absent").to_string(), says);
    }

    #[test]
    fn of_two_cameras_of_a_model_none_is_guessed() {
        let there = [listed("a", "imx296"), listed("b", "imx296")];
        let says = "camera: a single camera of model imx296 is not offered, offered: a, b";
        assert_eq!(pick("camera", "imx296", &there).expect_err("two").to_string(), says);
        assert_eq!(pick("camera", "b", &there).expect("by id"), 1);
    }

    #[test]
    fn an_exposure_is_whole_microseconds_within_the_range_and_never_automatic() {
        let us = |nanos, range| exposure_us(Duration::from_nanos(nanos), range);
        assert_eq!(us(2_000_499, None), 2000);
        assert_eq!(us(2_000_500, None), 2001);
        assert_eq!(us(0, None), 1);
        assert_eq!(us(0, Some(0..=30_000)), 1);
        assert_eq!(us(1_000, Some(29..=30_000)), 29);
        assert_eq!(us(50_000_000, Some(29..=30_000)), 30_000);
        assert_eq!(exposure_us(Duration::from_secs(1 << 40), None), i32::MAX);
    }

    #[test]
    fn a_gain_is_at_least_one_and_within_the_range() {
        assert_eq!(gain(2.5, None), 2.5);
        assert_eq!(gain(0.5, None), 1.0);
        assert_eq!(gain(40.0, Some(1.0..=16.0)), 16.0);
        assert_eq!(gain(1.0, Some(1.5..=16.0)), 1.5);
        assert_eq!(gain(1.0, Some(0.0..=16.0)), 1.0);
    }

    #[test]
    fn the_interval_is_that_of_the_rate_unless_an_exposure_needs_more() {
        assert_eq!(intervals_us(30.0, 5000), [33_333, 33_333]);
        assert_eq!(intervals_us(30.0, 25_000), [33_333, 50_000]);
        assert_eq!(intervals_us(1000.0, 5000), [1000, 10_000]);
    }
}

//! The self-test: whether the camera answers, whether projector and each bar light anything.
//! In: devices. Out: nothing, or the code of the first that does not work. Leaves the lights off.
//! Not here: whether what they do is good enough to measure by.

use super::acquire::SHOWN;
use super::hardware::Hardware;
use super::light::means;
use crate::capture::pictures;
use crate::code::Code;
use crate::fringe::Axis;
use crate::hal::Pool;
use crate::image::Image;
use std::time::Duration;

/// Row fringes, of which a board needs some beside the usual sets.
pub const ROWS: [(Axis, u32, u32); 3] = [(Axis::Row, 1, 4), (Axis::Row, 8, 4), (Axis::Row, 40, 4)];
/// Long enough to see the light on a wall some metres away; the other one is for a bright body nearby.
const EXPOSURES: [Duration; 2] = [Duration::from_millis(20), Duration::from_millis(2)];
/// An answer: so much brighter in the mean, as a share of white: one of 255 grey levels.
const ANSWER: f64 = 0.004;
/// And so many times what the hall's own light changed meanwhile.
const OVER_CHANGE: f64 = 3.0;
const TIMEOUT: Duration = Duration::from_millis(500);

/// Tries everything; the cycle's pictures are loaded. `alive` is called before each image: slow cameras take their time.
pub(super) fn test(hardware: &mut Hardware, pool: &Pool, alive: &dyn Fn()) -> Result<(), Code> {
    let tested = try_all(hardware, pool, alive);
    let dark = hardware.dark();
    tested.and(dark)
}

/// Loads the cycle's pictures and nothing else.
pub(super) fn load(hardware: &mut Hardware) -> Result<(), Code> {
    let (width, height) = hardware.projector.size();
    hardware.projector.load(&cycle_pictures(width, height)).map_err(|_| Code::ProjectorSilent)
}

/// The cycle's pictures, the even grey last.
pub(super) fn cycle_pictures(width: usize, height: usize) -> Vec<Image<u8>> {
    pictures(&SHOWN, width, height).expect("the usual sets can be shown")
}

/// What a projector that stores its pictures is to hold, in this order: black, the even grey, the fringes of a cycle in
/// their order, and the row fringes that boards need beside them.
pub fn stored_pictures(width: usize, height: usize) -> Vec<Image<u8>> {
    let mut fringes = cycle_pictures(width, height);
    let grey = fringes.pop().expect("the last");
    let mut rows = pictures(&ROWS, width, height).expect("they are coarser");
    rows.pop(); // the same grey
    let mut stored = vec![Image::filled(width, height, 0), grey];
    stored.extend(fringes);
    stored.extend(rows);
    stored
}

fn try_all(hardware: &mut Hardware, pool: &Pool, alive: &dyn Fn()) -> Result<(), Code> {
    let sensor = hardware.camera.sensor().clone();
    let one_image = || pool.take().or_else(|| Pool::new(&sensor, 1).take()).expect("a new pool has one");
    let mut images: [_; 5] = std::array::from_fn(|_| one_image());
    let lost = |_| Code::CameraLost;
    let grey = SHOWN.iter().map(|s| s.2 as usize).sum();
    hardware.camera.set_gain(1.0).map_err(lost)?;
    for (k, exposure) in EXPOSURES.into_iter().enumerate() {
        hardware.camera.set_exposure(exposure).map_err(lost)?;
        let lit = [None, Some([1.0, 0.0]), Some([0.0, 1.0]), None, Some([0.0; 2])];
        for (n, (drive, image)) in lit.into_iter().zip(&mut images).enumerate() {
            hardware.bars.set(drive.unwrap_or_default()).map_err(|_| Code::LightFault)?;
            let picture = (n == 4).then_some(grey);
            hardware.projector.show(picture).map_err(|_| Code::ProjectorSilent)?;
            alive();
            grab(hardware, image)?;
        }
        let [before, left, right, after, projected] = &images;
        let all = (0..before.pixels.len()).step_by(37);
        let seen = means([before, left, right, after, projected].map(|i| -> &Image<u16> { i }), all, &sensor);
        match seen {
            Some(seen) => return judge(seen),
            None if k + 1 < EXPOSURES.len() => {}
            None => return Err(Code::Ambient),
        }
    }
    Ok(())
}

/// An image that does not come is asked for once more.
fn grab(hardware: &mut Hardware, image: &mut Image<u16>) -> Result<(), Code> {
    let camera = &mut hardware.camera;
    camera.grab(TIMEOUT, image).or_else(|_| camera.grab(TIMEOUT, image)).map(|_| ()).map_err(|_| Code::CameraLost)
}

fn judge([before, left, right, after, projected]: [f64; 5]) -> Result<(), Code> {
    let least = ANSWER.max(OVER_CHANGE * (after - before).abs());
    let rest = 0.5 * (before + after);
    if left - rest < least || right - rest < least {
        return Err(Code::LightFault);
    }
    if projected - rest < least {
        return Err(Code::ProjectorSilent);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_projector_that_stores_its_pictures_holds_those_of_cycle_capture_and_verification() {
        let stored = stored_pictures(128, 80);
        let sets = SHOWN.iter().chain(&crate::capture::SETS).chain(&super::super::verify::SETS).chain(&ROWS);
        for &(axis, count, steps) in sets {
            for picture in pictures(&[(axis, count, steps)], 128, 80).expect("usual") {
                assert!(stored.contains(&picture), "{axis:?} {count} {steps}");
            }
        }
        assert!(stored[0].pixels.iter().all(|v| *v == 0));
    }

    #[test]
    fn each_bar_and_the_projector_must_answer() {
        assert_eq!(judge([0.01, 0.05, 0.05, 0.01, 0.1]), Ok(()));
        assert_eq!(judge([0.01, 0.01, 0.05, 0.01, 0.1]), Err(Code::LightFault));
        assert_eq!(judge([0.01, 0.05, 0.01, 0.01, 0.1]), Err(Code::LightFault));
        assert_eq!(judge([0.01, 0.05, 0.05, 0.01, 0.01]), Err(Code::ProjectorSilent));
        assert_eq!(judge([0.01, 0.05, 0.05, 0.05, 0.1]), Err(Code::LightFault), "the hall changed by as much");
    }
}

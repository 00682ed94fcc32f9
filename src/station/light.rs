//! What images say about the light: how the bars answer, what comes from outside, whether the projector follows.
//! In:  images under known light, pixels of the body. Out: shares, and the code of what is wrong.
//! Not here: setting anything.

use crate::code::Code;
use crate::hal::Sensor;
use crate::image::Image;

/// A bar whose share of the bars' light on the body is less than this does not light as it should. Where vehicles turn by
/// 12.5° a good bar's share is 0.35 and more.
const WEAK: f64 = 0.2;
/// Light of both bars, as a share of white, below which nothing can be said.
const MIN_LIGHT: f64 = 0.01;
/// Light of the projector's even grey, as a share of white: below the first it is dark, as far as means over the body tell;
/// below the second the hall drowns it.
const DARK: f64 = 0.004;
const MIN_PROJECTED: f64 = 0.025;
/// The hall's light may change between two images by this share of the red image's.
const STEADY: f64 = 0.06;
/// A dark picture may leave this share of the even grey's light; projectors leave some 5 %.
const LEFT_ON: f64 = 0.3;

/// Why nothing can be measured in this light; the detail names the bar (1 left, 2 right).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Wrong {
    pub(super) code: Code,
    pub(super) detail: u16,
    pub(super) said: String,
}

fn wrong(code: Code, detail: u16, said: String) -> Wrong {
    Wrong { code, detail, said }
}

/// Means of `images` above black, as shares of white, over those of `pixels` that are saturated in none: they add up as
/// light does. `None` where nearly all are.
pub(super) fn means<const N: usize>(
    images: [&Image<u16>; N],
    pixels: impl Iterator<Item = usize>,
    sensor: &Sensor,
) -> Option<[f64; N]> {
    let (mut sums, mut n, mut all) = ([0u64; N], 0u64, 0u64);
    for at in pixels {
        all += 1;
        let levels = images.map(|i| i.pixels[at]);
        if levels.iter().all(|v| *v < sensor.white_level) {
            n += 1;
            sums.iter_mut().zip(levels).for_each(|(s, v)| *s += u64::from(v));
        }
    }
    let span = f64::from(sensor.white_level) - sensor.black_level;
    (20 * n > all).then(|| sums.map(|s| (s as f64 / n as f64 - sensor.black_level) / span))
}

/// The median above black of the pixels, as a share of white.
pub(super) fn median(image: &Image<u16>, pixels: &[usize], sensor: &Sensor) -> Option<f64> {
    let mut levels: Vec<u16> = pixels.iter().map(|at| image.pixels[*at]).collect();
    let middle = levels.len() / 2;
    let found = (!levels.is_empty()).then(|| f64::from(*levels.select_nth_unstable(middle).1))?;
    Some((found - sensor.black_level) / (f64::from(sensor.white_level) - sensor.black_level))
}

/// What three images of one exposure say: both bars on, the left one alone, none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bars {
    /// Light of both, as a share of white.
    pub(super) both: f64,
    /// The left one's share of it.
    pub(super) left: f64,
    /// Light from elsewhere, as a share of white.
    pub(super) ambient: f64,
}

impl Bars {
    pub(super) fn new([both, left, none]: [f64; 3]) -> Self {
        let on = both - none;
        Self { both: on, left: (left - none) / on, ambient: none }
    }

    /// Light from outside as a share of the red image's own.
    pub(super) fn ambient_share(&self) -> f64 {
        self.ambient.max(0.0) / self.both.max(1e-6)
    }

    /// 210 for a bar that does not light as it is driven: one that is dead, or that gives the same whatever is asked for.
    pub(super) fn check(&self, ambient_limit: f64) -> Result<(), Wrong> {
        if self.both < MIN_LIGHT {
            let said = format!("The bars' light is {:.1} % of white on the body.", 100.0 * self.both);
            let code = if self.ambient_share() > ambient_limit { Code::Ambient } else { Code::LightFault };
            return Err(wrong(code, 0, said));
        }
        for (bar, name, share) in [(1, "left", self.left), (2, "right", 1.0 - self.left)] {
            if share < WEAK {
                let said = format!(
                    "Of both bars' light on the body the {name} one gives {:.0} % where it is turned on, allowed at \
                     least {:.0} %.",
                    100.0 * share,
                    100.0 * WEAK
                );
                return Err(wrong(Code::LightFault, bar, said));
            }
        }
        if self.ambient_share() > ambient_limit {
            let said = format!(
                "Light from outside is {:.0} % of the bars', allowed {:.0} %.",
                100.0 * self.ambient_share(),
                100.0 * ambient_limit
            );
            return Err(wrong(Code::Ambient, 0, said));
        }
        Ok(())
    }

    /// Drives with which both bars give the same, as bright together as `drive`; none above 1.
    pub(super) fn balanced(&self, drive: [f64; 2]) -> [f64; 2] {
        let of = [self.left / drive[0], (1.0 - self.left) / drive[1]]; // per drive
        let each = [0.5 / of[0], 0.5 / of[1]];
        let most = each[0].max(each[1]).max(1.0);
        each.map(|d| d / most)
    }
}

/// What the projector's even grey and its darkness say, both of one exposure, as shares of white; `ambient`: what is to be
/// expected of the hall in that exposure, `red`: the red image's light in that exposure.
pub(super) fn check_projector([grey, dark]: [f64; 2], ambient: f64, red: f64) -> Result<(), Wrong> {
    if dark - ambient > LEFT_ON * grey.max(dark) && dark - ambient > MIN_PROJECTED {
        let said = format!(
            "Where the projector should be dark there is light of {:.0} % of white, where it should be grey {:.0} %.",
            100.0 * (dark - ambient),
            100.0 * (grey - ambient)
        );
        return Err(wrong(Code::Synchronisation, 0, said));
    }
    if grey - dark < MIN_PROJECTED {
        let said = format!("The projector's grey is {:.1} % of white brighter than its dark.", 100.0 * (grey - dark));
        let code = if grey - dark < DARK { Code::ProjectorSilent } else { Code::Ambient };
        return Err(wrong(code, 0, said));
    }
    if (dark - ambient).abs() > STEADY * red {
        let said = format!(
            "Light from outside changed by {:.1} % of the red image's, allowed {:.0} %.",
            100.0 * (dark - ambient).abs() / red,
            100.0 * STEADY
        );
        return Err(wrong(Code::Ambient, 0, said));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both on, left on, none on, for what each gives as it is asked.
    fn seen(left: [f64; 2], right: [f64; 2], ambient: f64) -> Bars {
        Bars::new([left[1] + right[1] + ambient, left[1] + right[0] + ambient, left[0] + right[0] + ambient])
    }

    #[test]
    fn a_bar_that_is_dead_or_stuck_is_a_light_fault() {
        let code = |bars: Bars| bars.check(0.5).map_err(|w| (w.code, w.detail));
        assert_eq!(code(seen([0.0, 0.2], [0.0, 0.2], 0.02)), Ok(()));
        assert_eq!(code(seen([0.0, 0.25], [0.0, 0.15], 0.0)), Ok(()), "turned by 10°");
        assert_eq!(code(seen([0.0, 0.0], [0.0, 0.4], 0.02)), Err((Code::LightFault, 1)), "left dead");
        assert_eq!(code(seen([0.0, 0.4], [0.0, 0.0], 0.02)), Err((Code::LightFault, 2)), "right dead");
        assert_eq!(code(seen([0.3, 0.3], [0.0, 0.2], 0.02)), Err((Code::LightFault, 1)), "left stuck");
        assert_eq!(code(seen([0.0, 0.2], [0.2, 0.2], 0.02)), Err((Code::LightFault, 2)), "right stuck");
        assert_eq!(code(seen([0.0; 2], [0.0; 2], 0.0)), Err((Code::LightFault, 0)), "both dead");
        assert_eq!(code(seen([0.0, 0.2], [0.0, 0.2], 0.3)), Err((Code::Ambient, 0)));
    }

    #[test]
    fn balance_makes_both_give_the_same_and_drives_none_above_1() {
        let bars = seen([0.0, 0.24], [0.0, 0.16], 0.0);
        let [left, right] = bars.balanced([0.6, 0.6]);
        assert!((left * 0.24 - right * 0.16).abs() < 1e-9 && (left * 0.24 + right * 0.16 - 0.24).abs() < 1e-9);
        let [left, right] = bars.balanced([1.0, 1.0]);
        assert!(right == 1.0 && (left - 2.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn a_projector_is_silent_behind_or_in_order_and_the_hall_steady() {
        let code = |images, ambient| check_projector(images, ambient, 0.4).map_err(|w| w.code);
        assert_eq!(code([0.36, 0.02], 0.01), Ok(()));
        assert_eq!(code([0.02, 0.02], 0.02), Err(Code::ProjectorSilent));
        assert_eq!(code([0.361, 0.36], 0.36), Err(Code::ProjectorSilent));
        assert_eq!(code([0.36, 0.34], 0.34), Err(Code::Ambient), "drowned");
        assert_eq!(code([0.02, 0.36], 0.02), Err(Code::Synchronisation), "a picture behind");
        assert_eq!(code([0.36, 0.36], 0.02), Err(Code::Synchronisation), "stuck at grey");
        assert_eq!(code([0.36, 0.10], 0.02), Err(Code::Ambient), "brighter by now");
    }
}

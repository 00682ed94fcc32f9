//! The faults of the world, on cue. In: a script. Out: which fault acts on an image or at a time.
//! Not here: what a fault does to a device.

use super::body::Body;
use super::scene::Cover;
use super::sensor::Dirt;
use std::time::Duration;

/// What can be wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// The camera loses the image: the next one comes instead, and its number tells.
    ImageDropped,
    /// The camera delivers the image before once more, under its old number.
    ImageDoubled,
    /// The image comes so much later.
    ImageLate(Duration),
    /// The image breaks off half-way.
    ImageHalf,
    /// The camera does not answer.
    CameraGone,
    /// The projector takes requests and stays dark.
    ProjectorSilent,
    /// The projector shows what was asked for the time before.
    ProjectorBehind,
    /// A bar (0 left, 1 right) takes its drive and stays dark.
    BarDead(usize),
    /// A bar stays at this drive, whatever is asked for.
    BarStuck(usize, f64),
    /// The hall is lit by this factor.
    Ambient(f64),
    /// The hall's light flickers at 100 Hz by this share of its mean.
    Flicker(f64),
    /// The vehicle rocks: roll amplitude in degrees, at 1.7 Hz.
    Rocking(f64),
    /// Another body stands there than was announced.
    WrongVehicle(Box<Body>),
    /// A region is hidden.
    Covered(Cover),
    /// The camera's lens is dirty.
    DirtyLens(Dirt),
    /// The projector has been pushed: it is turned about its vertical axis by this much, degrees.
    Bumped(f64),
}

/// When a fault acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum When {
    /// Always.
    Always,
    /// From one time to another.
    Between(Duration, Duration),
    /// On the exposure of this number, counted from 1.
    Image(u64),
}

/// A line of the script.
#[derive(Clone, Debug, PartialEq)]
pub struct Cue {
    /// When.
    pub when: When,
    /// What.
    pub fault: Fault,
}

/// What is to go wrong, and when.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script(pub Vec<Cue>);

impl Script {
    /// The faults that act at `now`, of exposure `image` if one is meant.
    pub(super) fn at(&self, now: Duration, image: Option<u64>) -> impl Iterator<Item = &Fault> {
        let acts = move |cue: &&Cue| match cue.when {
            When::Always => true,
            When::Between(from, until) => (from..until).contains(&now),
            When::Image(number) => image == Some(number),
        };
        self.0.iter().filter(acts).map(|cue| &cue.fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cue_acts_in_its_time_or_on_its_image() {
        let ms = Duration::from_millis;
        let script = Script(vec![
            Cue { when: When::Between(ms(10), ms(20)), fault: Fault::CameraGone },
            Cue { when: When::Image(3), fault: Fault::ImageHalf },
            Cue { when: When::Always, fault: Fault::Ambient(2.0) },
        ]);
        let at = |now, image| script.at(ms(now), image).cloned().collect::<Vec<_>>();
        assert_eq!(at(9, None), [Fault::Ambient(2.0)]);
        assert_eq!(at(10, Some(3)), [Fault::CameraGone, Fault::ImageHalf, Fault::Ambient(2.0)]);
        assert_eq!(at(20, Some(4)), [Fault::Ambient(2.0)]);
    }
}

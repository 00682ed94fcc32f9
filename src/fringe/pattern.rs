//! Fringe patterns: what the projector shows.
//! In: a pattern set and a step. Out: the ideal image, and what a phase means in projector pixels.

use super::Error;
use crate::Image;
use std::f64::consts::TAU;

/// The projector coordinate along which a pattern varies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// Fringes vary with the projector's column.
    Column,
    /// Fringes vary with the projector's row.
    Row,
}

/// One set of phase-shifted fringe images of one frequency: step k of N shows, at projector coordinate c,
/// `A + B·cos(2π·count·(c + ½)/extent + 2π·k/N)`, with `extent` the projector's width (rows: height).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatternSet {
    /// Along which the fringes vary.
    pub axis: Axis,
    /// Fringes over the whole projector image.
    pub count: u32,
    /// Images N, each shifted by 2π/N; 3..=16.
    pub steps: u32,
    /// Grey levels per electron of the camera in this set; `None`: estimate the noise from the images.
    pub gain_dn_per_e: Option<f64>,
    /// Exposure; sets equal but for it form a high-dynamic-range stack.
    pub exposure_ms: Option<f64>,
}

impl PatternSet {
    /// A set of `steps` images of `count` fringes; gain and exposure unknown.
    /// Errors where no phase can follow: no fringe, or steps outside 3..=16.
    pub fn new(axis: Axis, count: u32, steps: u32) -> Result<Self, Error> {
        let set = Self { axis, count, steps, gain_dn_per_e: None, exposure_ms: None };
        set.check().map(|()| set)
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        match self {
            Self { count: 0, .. } => Err(Error::NoFringe),
            Self { steps: 3..=16, .. } => Ok(()),
            Self { steps, .. } => Err(Error::Steps { steps: *steps }),
        }
    }

    /// The shift of `step`, rad.
    pub fn shift(&self, step: u32) -> f64 {
        TAU * f64::from(step) / f64::from(self.steps)
    }

    /// Length of one fringe, projector px, on a projector of `extent` px along the axis.
    pub fn pitch(&self, extent: usize) -> f64 {
        extent as f64 / f64::from(self.count)
    }

    /// Image `step` for a `width` × `height` projector that is linear from 0 to 255.
    pub fn render(&self, step: u32, width: usize, height: usize) -> Image<u8> {
        let extent = if self.axis == Axis::Column { width } else { height };
        let profile: Vec<u8> = (0..extent)
            .map(|c| TAU * (c as f64 + 0.5) / self.pitch(extent) + self.shift(step))
            .map(|phase| (127.5 + 127.5 * phase.cos()).round() as u8)
            .collect();
        let mut image = Image::filled(width, height, 0);
        for y in 0..height {
            match self.axis {
                Axis::Column => image.row_mut(y).copy_from_slice(&profile),
                Axis::Row => image.row_mut(y).fill(profile[y]),
            }
        }
        image
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rendered_pattern_starts_half_a_pixel_into_its_cosine() {
        let set = PatternSet::new(Axis::Column, 2, 4).expect("legal");
        // 8 px, 2 fringes: phases π/4, 3π/4, 5π/4, 7π/4, twice.
        assert_eq!(set.render(0, 8, 2).row(1), [218, 37, 37, 218, 218, 37, 37, 218]);
        assert_eq!(set.render(1, 8, 2).row(0), [37, 37, 218, 218, 37, 37, 218, 218]); // a quarter further on
        let rows = PatternSet { axis: Axis::Row, ..set }.render(0, 2, 8);
        assert_eq!([rows.at(0, 0), rows.at(1, 1), rows.at(0, 3)], [218, 37, 218]);
    }

    #[test]
    fn two_steps_or_no_fringe_make_no_set() {
        let error = PatternSet::new(Axis::Row, 64, 2).expect_err("two steps, three unknowns");
        assert_eq!(error.to_string(), "a fringe set of 2 steps: allowed 3..=16");
        assert!(PatternSet::new(Axis::Row, 64, 17).is_err() && PatternSet::new(Axis::Row, 0, 4).is_err());
    }
}

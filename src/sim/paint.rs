//! Paints: what a body reflects of red light and of the projector's, below a clear coat that mirrors.
//! In: a name. Out: reflectances and the widths of two lobes. Not here: lamps, geometry.

/// A paint under its clear coat.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paint {
    /// What people call it.
    pub name: &'static str,
    /// Diffuse reflectance in the bars' red light, 0..1.
    pub red: f64,
    /// The same in the light of projector and room.
    pub white: f64,
    /// Metal flakes below the coat: their reflectance at normal incidence, and the spread of their slopes as seen from
    /// outside, where the coat's refraction widens it by half.
    pub flakes: Option<(f64, f64)>,
    /// How much the diffuse reflectance differs from spot to spot (flakes, orange peel), as a share, 1 sigma.
    pub mottle: f64,
    /// Noise beyond the sensor's, from one image to the next, as a share of the light: a projector's dither and a lamp's
    /// flicker on a surface that glitters. Chosen so that phase noise over the sensor's law is what independent
    /// captures show: 1.05 on white, 1.65 on black.
    pub glitter: f64,
}

/// The clear coat's reflectance at normal incidence.
pub(super) const COAT: f64 = 0.04;
/// Spread of its slopes: the width, about 0.7°, of the projector's image in independent captures.
pub(super) const COAT_ROUGHNESS: f64 = 0.012;

/// The coat runs thin over a hem and mirrors less there: so much that glints on black paint are as strong as in
/// independent captures (1.2 to 1.5 times the panel, seen through the lens).
pub(super) const HEM_COAT: f64 = 0.6;

/// All paints.
pub const PAINTS: [Paint; 6] = [
    Paint { name: "white", red: 0.72, white: 0.72, flakes: None, mottle: 0.003, glitter: 0.005 },
    Paint { name: "silver", red: 0.26, white: 0.26, flakes: Some((0.20, 0.45)), mottle: 0.015, glitter: 0.008 },
    Paint { name: "grey", red: 0.13, white: 0.13, flakes: Some((0.05, 0.42)), mottle: 0.012, glitter: 0.012 },
    Paint { name: "red", red: 0.52, white: 0.16, flakes: None, mottle: 0.006, glitter: 0.010 },
    Paint { name: "blue", red: 0.035, white: 0.06, flakes: Some((0.008, 0.40)), mottle: 0.012, glitter: 0.020 },
    Paint { name: "black", red: 0.036, white: 0.036, flakes: None, mottle: 0.003, glitter: 0.0225 },
];

impl Paint {
    /// The paint of that name.
    pub fn named(name: &str) -> Option<Self> {
        PAINTS.into_iter().find(|p| p.name == name)
    }
}

/// Rubber, and the wheelhouse's lining.
pub(super) const RUBBER: f64 = 0.055;
pub(super) const LINING: f64 = 0.012;
/// What lies in a gap: primer and seals in the shade.
pub(super) const GAP_FLOOR: f64 = 0.01;

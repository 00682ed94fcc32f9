//! Where things are drawn onto a body that are not part of it, such as boxes about its features.
//! In: a body, a place beside it. Out: points of its surface, the flap's outline; vehicle frame, mm.
//! Not here: how large such boxes are.

use super::Body;

/// Points of an outline: so many that their hull is the outline's to 0.1 mm.
const POINTS: usize = 64;

impl Body {
    /// The point of the undisturbed surface at x and z.
    pub fn on_surface(&self, [x, z]: [f64; 2]) -> [f64; 3] {
        [x, self.surface([x, z]).0, z]
    }

    /// The outline of the flap's hole, along x and z from its centre, in turn.
    pub fn flap_outline(&self) -> Vec<[f64; 2]> {
        self.hole.1.ring(POINTS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_lie_on_the_surface_and_outlines_have_the_flaps_extent() {
        let body = Body::named("suv-b").expect("listed");
        for f in body.features() {
            assert_eq!(body.on_surface([f.at[0], f.at[2]]), f.at);
        }
        let half = body.flap_half();
        for (i, half) in half.into_iter().enumerate() {
            let far = body.flap_outline().iter().map(|p| p[i].abs()).fold(0.0, f64::max);
            assert!((far - half).abs() < 0.1, "{far} {half}");
        }
    }
}

//! What a detector's box of a feature is about: an outline on the panel.
//! In:  a class, the flap's outline. Out: the outline that the box encloses, mm on the panel from the feature.
//! Not here: where features are; how a box looks in an image.

use super::{Class, Template};
use crate::lent::List;

/// Half the side of the square about a corner, mm.
const CORNER_MM: f64 = 45.0;
/// Half the sides of the box about an arch's top, along and up, mm.
const ARCH_MM: [f64; 2] = [60.0, 30.0];
/// A flap's box is larger than the flap by this factor.
const FLAP: f64 = 1.1;

/// The outline of a feature's box, in turn about its middle; `flap` is that of the flap.
/// Points are so far apart that each sector of it has about the same area.
pub fn region_outline(class: Class, flap: &[[f64; 2]]) -> List<[f64; 2]> {
    match class {
        Class::Point1 | Class::Point2 => rectangle([CORNER_MM; 2]),
        Class::Point4 => rectangle(ARCH_MM),
        Class::Point3 => {
            let least = |i: usize| flap.iter().map(|p| p[i]).fold(f64::INFINITY, f64::min);
            let most = |i: usize| flap.iter().map(|p| p[i]).fold(f64::NEG_INFINITY, f64::max);
            let middle = [0, 1].map(|i| 0.5 * (least(i) + most(i)));
            List::of(flap.iter().map(|p| [0, 1].map(|i| middle[i] + FLAP * (p[i] - middle[i]))))
        }
    }
}

impl Template {
    /// The outline of this feature's box in local coordinates.
    pub fn box_outline(&self, class: Class) -> List<[f64; 2]> {
        if class == Class::Point3 {
            return region_outline(class, &List::of(self.contour.iter().map(|p| p.at().into())));
        }
        // about the taught point, which may lie beside the origin
        let [u, v, _] = self.at_mm;
        List::of(region_outline(class, &[]).iter().map(|p| [p[0] + u, p[1] + v]))
    }
}

/// As many points on each side, corners included.
fn rectangle([a, b]: [f64; 2]) -> List<[f64; 2]> {
    const SIDE: usize = 16;
    let corners = [[a, b], [-a, b], [-a, -b], [a, -b]];
    let side = |k: usize| {
        let (from, to) = (corners[k], corners[(k + 1) % 4]);
        (0..SIDE).map(move |i| {
            let t = i as f64 / SIDE as f64;
            [0, 1].map(|j| from[j] + t * (to[j] - from[j]))
        })
    };
    List::of((0..4).flat_map(side))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outlines_have_the_size_of_their_class_about_the_feature() {
        let flap = [[10.0, 0.0], [40.0, 0.0], [40.0, 20.0], [10.0, 20.0]];
        for (class, known) in [
            (Class::Point1, [-45.0, -45.0, 45.0, 45.0]),
            (Class::Point2, [-45.0, -45.0, 45.0, 45.0]),
            (Class::Point3, [8.5, -1.0, 41.5, 21.0]),
            (Class::Point4, [-60.0, -30.0, 60.0, 30.0]),
        ] {
            let ring = region_outline(class, &flap);
            let least = |i: usize| ring.iter().map(|p| p[i]).fold(f64::INFINITY, f64::min);
            let most = |i: usize| ring.iter().map(|p| p[i]).fold(f64::NEG_INFINITY, f64::max);
            let sides = [least(0), least(1), most(0), most(1)];
            assert!(sides.iter().zip(known).all(|(a, b)| (a - b).abs() < 1e-9), "{class:?}: {sides:?}");
        }
    }
}

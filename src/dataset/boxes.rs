//! What a detector is to find of a feature: the box about an outline on the panel.
//! In:  the outline, how the panel is seen, what is hidden. Out: the box in the image, and how much of it can be seen.
//! Not here: where features are, and what their outlines.

use crate::optics::Pixel;
use crate::vehicle::Class;

/// Boxes are labelled of which at least this share can be seen: in the image, and nothing before it.
pub const VISIBLE: f64 = 0.7;

/// A box of a class, px: left, top, right, bottom, inside the image that begins at −0.5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Labelled {
    /// Its class, from 0: point1 to point4.
    pub class: usize,
    /// Share of it that can be seen.
    pub visible: f64,
    /// Its sides.
    pub sides: [f64; 4],
}

impl Labelled {
    /// Whether enough of it can be seen for a detector to find it.
    pub fn counts(&self) -> bool {
        self.visible >= VISIBLE
    }

    /// YOLO's line: class, then centre and size as shares of the image's.
    pub fn line(&self, (width, height): (usize, usize)) -> String {
        let [left, top, right, bottom] = self.sides;
        let (w, h) = (width as f64, height as f64);
        let (x, y) = ((0.5 * (left + right) + 0.5) / w, (0.5 * (top + bottom) + 0.5) / h);
        format!("{} {x:.6} {y:.6} {:.6} {:.6}\n", self.class, (right - left) / w, (bottom - top) / h)
    }
}

/// The upright box about `outline` as `seen` in an image, clipped to it; none where some of it lies behind the camera.
/// Of it `visible` is in the image and not `hidden`.
pub fn boxed(
    class: Class,
    outline: &[[f64; 2]],
    (width, height): (usize, usize),
    seen: impl Fn([f64; 2]) -> Option<Pixel>,
    hidden: impl Fn(&Pixel) -> bool,
) -> Option<Labelled> {
    let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
    let inside = |p: &Pixel| p.x >= -0.5 && p.y >= -0.5 && p.x <= right && p.y <= bottom;
    let n = outline.len() as f64;
    let middle = [0, 1].map(|i| outline.iter().map(|p| p[i]).sum::<f64>() / n);
    // rings of equal area
    const RINGS: usize = 12;
    let mut visible = 0;
    for ring in 0..RINGS {
        let share = ((ring as f64 + 0.5) / RINGS as f64).sqrt();
        for p in outline {
            let at = seen([0, 1].map(|i| middle[i] + share * (p[i] - middle[i])));
            visible += usize::from(at.is_some_and(|at| inside(&at) && !hidden(&at)));
        }
    }
    let visible = visible as f64 / (RINGS * outline.len()) as f64;
    let mut sides = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for p in outline {
        let p = seen(*p)?;
        sides = [sides[0].min(p.x), sides[1].min(p.y), sides[2].max(p.x), sides[3].max(p.y)];
    }
    let [left, top, r, b] = sides;
    Some(Labelled {
        class: class.index(),
        visible,
        sides: [left.max(-0.5), top.max(-0.5), r.min(right), b.min(bottom)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::region_outline;

    /// One px a mm, the feature at `at`.
    fn at(x: f64, y: f64, class: Class, hidden: impl Fn(&Pixel) -> bool) -> Option<Labelled> {
        let flap = [[20.0, 10.0], [-20.0, 10.0], [-20.0, -10.0], [20.0, -10.0]];
        boxed(class, &region_outline(class, &flap), (200, 100), |p| Some(Pixel::new(x + p[0], y - p[1])), hidden)
    }

    #[test]
    fn boxes_have_the_size_of_their_class() {
        let size = |class| at(100.0, 50.0, class, |_| false).expect("in view").sides;
        assert_eq!(size(Class::Point2), [55.0, 5.0, 145.0, 95.0]);
        assert_eq!(size(Class::Point4), [40.0, 20.0, 160.0, 80.0]);
        let flap = size(Class::Point3);
        let known = [78.0, 39.0, 122.0, 61.0];
        assert!(flap.iter().zip(known).all(|(a, b)| (a - b).abs() < 1e-9), "{flap:?}");
        let line = at(99.5, 49.5, Class::Point4, |_| false).expect("in view").line((200, 100));
        assert_eq!(line, "3 0.500000 0.500000 0.600000 0.600000\n");
    }

    #[test]
    fn what_is_mostly_hidden_or_out_of_view_does_not_count_and_boxes_end_at_the_border() {
        let in_view = at(35.0, 50.0, Class::Point1, |_| false).expect("before the camera");
        assert_eq!(in_view.sides, [-0.5, 5.0, 80.0, 95.0]);
        let share = |known: f64, b: Option<Labelled>| {
            let b = b.expect("before the camera");
            assert!((b.visible - known).abs() < 0.05, "{} for {known}", b.visible);
            b.counts()
        };
        assert!(share(0.9, Some(in_view)));
        assert!(!share(0.6, at(8.5, 50.0, Class::Point1, |_| false)));
        assert!(share(0.75, at(100.0, 50.0, Class::Point4, |p| p.x < 70.0)));
        assert!(!share(0.625, at(100.0, 50.0, Class::Point4, |p| p.x < 85.0)));
        assert!(!share(0.0, at(-300.0, 50.0, Class::Point4, |_| false)));
    }
}

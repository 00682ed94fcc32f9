//! Of several boxes of one class about one thing the best stays.
//! In: boxes, the best first. Out: those that no better one of their class overlaps by much. Not here: thresholds.

use super::decode::Found;

/// Boxes of one class are about one thing where they share this part of their union.
const SHARED: f32 = 0.5;

/// Class-aware non-maximum suppression, in the order given.
pub(super) fn suppress(found: Vec<Found>) -> Vec<Found> {
    let mut kept: Vec<Found> = Vec::new();
    for f in found {
        if kept.iter().all(|k| k.class != f.class || shared(&k.sides, &f.sides) < SHARED) {
            kept.push(f);
        }
    }
    kept
}

/// Intersection over union.
fn shared(a: &[f32; 4], b: &[f32; 4]) -> f32 {
    let side = |i: usize| (a[i + 2].min(b[i + 2]) - a[i].max(b[i])).max(0.0);
    let area = |s: &[f32; 4]| (s[2] - s[0]).max(0.0) * (s[3] - s[1]).max(0.0);
    let both = side(0) * side(1);
    both / (area(a) + area(b) - both).max(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_of_a_class_stays_and_other_classes_and_places_with_it() {
        let of = |class, score, x: f32| Found { class, score, sides: [x, 0.0, x + 10.0, 10.0] };
        assert!((shared(&of(0, 0.0, 0.0).sides, &of(0, 0.0, 5.0).sides) - 1.0 / 3.0).abs() < 1e-6);
        let kept = suppress(vec![of(0, 0.9, 0.0), of(1, 0.8, 0.0), of(0, 0.7, 2.0), of(0, 0.6, 6.0), of(1, 0.5, 1.0)]);
        assert_eq!(kept.iter().map(|f| f.score).collect::<Vec<_>>(), [0.9, 0.8, 0.6]);
        assert!(suppress(Vec::new()).is_empty());
    }
}

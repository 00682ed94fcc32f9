//! What a network's output says: boxes above a threshold.
//! In:  the raw output of the usual head or of its logits. Out: boxes in the input's pixels, the first from 0 to 1.
//! Not here: which of several boxes about one thing stays.
//!
//! Distances of a box's sides from its cell are the means of distributions over bins (distribution focal loss): Li et al.,
//! NeurIPS 2020.

/// Classes: point1 to point4.
pub(super) const CLASSES: usize = 4;
/// Bins of a side's distance, in strides from 0.
const BINS: usize = 16;
/// Cells are as wide as one of these, px.
const STRIDES: [usize; 5] = [4, 8, 16, 32, 64];
/// No more boxes are looked at: an image holds one of each class.
const MOST: usize = 300;

/// A box that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Found {
    /// From 0.
    pub(super) class: usize,
    /// 0..=1.
    pub(super) score: f32,
    /// Left, top, right, bottom.
    pub(super) sides: [f32; 4],
}

/// What a network's output means.
#[derive(Clone, Debug)]
pub(super) enum Head {
    /// Four rows of boxes (centre and size), then the classes' scores; so many cells.
    Boxes(usize),
    /// Four sides' bins, then the classes, all as logits; each cell's middle and stride, px.
    Logits(Vec<[f32; 3]>),
}

impl Head {
    /// Of an input of that width and height with so many cells; none where strides, each twice the last, do not give them.
    pub(super) fn logits(cells: usize, (width, height): (usize, usize)) -> Option<Self> {
        let count = |strides: &[usize]| strides.iter().map(|s| (width / s) * (height / s)).sum::<usize>();
        let strides = (0..STRIDES.len())
            .flat_map(|i| (i + 1..=STRIDES.len()).map(move |j| &STRIDES[i..j]))
            .find(|strides| count(strides) == cells)?;
        let mut all = Vec::with_capacity(cells);
        for &stride in strides {
            for y in 0..height / stride {
                for x in 0..width / stride {
                    let middle = |k: usize| (k as f32 + 0.5) * stride as f32;
                    all.push([middle(x), middle(y), stride as f32]);
                }
            }
        }
        Some(Self::Logits(all))
    }

    pub(super) fn is_logits(&self) -> bool {
        matches!(self, Self::Logits(_))
    }

    fn cells(&self) -> usize {
        match self {
            Self::Boxes(cells) => *cells,
            Self::Logits(cells) => cells.len(),
        }
    }

    /// Numbers in an output.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Boxes(cells) => (4 + CLASSES) * cells,
            Self::Logits(cells) => (4 * BINS + CLASSES) * cells.len(),
        }
    }

    /// The boxes of at least `threshold`, the best first; one per cell, of its best class. `raw` has [`Self::len`] numbers.
    pub(super) fn decode(&self, raw: &[f32], threshold: f32) -> Vec<Found> {
        let n = self.cells();
        let (places, classes) = raw.split_at(raw.len() - CLASSES * n);
        let (least, score): (f32, fn(f32) -> f32) = match self {
            Self::Boxes(_) => (threshold, |v| v),
            Self::Logits(_) => ((threshold / (1.0 - threshold)).ln(), sigmoid),
        };
        let best = |cell: usize| {
            let of = |class: usize| classes[class * n + cell];
            (0..CLASSES).map(|class| (class, of(class))).max_by(|a, b| a.1.total_cmp(&b.1))
        };
        let mut above: Vec<(usize, usize, f32)> = (0..n)
            .filter_map(|cell| best(cell).map(|(class, value)| (cell, class, value)))
            .filter(|(_, _, value)| *value >= least)
            .collect();
        above.sort_by(|a, b| b.2.total_cmp(&a.2));
        above.truncate(MOST);
        let found = |(cell, class, value)| Found { class, score: score(value), sides: self.sides(places, cell) };
        above.into_iter().map(found).collect()
    }

    /// All of `raw` as a whole network gives it; none if it has not the right length.
    pub(super) fn decode_all(&self, raw: &[f32]) -> Option<Vec<f32>> {
        let n = self.cells();
        if raw.len() != self.len() {
            return None;
        }
        if let Self::Boxes(_) = self {
            return Some(raw.to_vec());
        }
        let mut out = vec![0.0; (4 + CLASSES) * n];
        let (places, classes) = raw.split_at(4 * BINS * n);
        for cell in 0..n {
            let [left, top, right, bottom] = self.sides(places, cell);
            let values = [0.5 * (left + right), 0.5 * (top + bottom), right - left, bottom - top];
            values.into_iter().enumerate().for_each(|(row, v)| out[row * n + cell] = v);
        }
        for (out, v) in out[4 * n..].iter_mut().zip(classes) {
            *out = sigmoid(*v);
        }
        Some(out)
    }

    /// Whether `raw`, decoded, is what the whole network gave: boxes to 0.02 px, scores to 2e-4.
    pub(super) fn agrees(&self, raw: &[f32], known: &[f32]) -> bool {
        let Some(decoded) = self.decode_all(raw) else { return false };
        let boxes = 4 * self.cells();
        let near = |(k, (a, b)): (usize, (&f32, &f32))| (a - b).abs() < if k < boxes { 0.02 } else { 2e-4 };
        decoded.len() == known.len() && decoded.iter().zip(known).enumerate().all(near)
    }

    /// Left, top, right, bottom of a cell's box.
    fn sides(&self, places: &[f32], cell: usize) -> [f32; 4] {
        let n = self.cells();
        match self {
            Self::Boxes(_) => {
                let [x, y, w, h] = std::array::from_fn(|row| places[row * n + cell]);
                [x - 0.5 * w, y - 0.5 * h, x + 0.5 * w, y + 0.5 * h]
            }
            Self::Logits(cells) => {
                let [x, y, stride] = cells[cell];
                let [left, top, right, bottom] = std::array::from_fn(|side| {
                    let logits: [f32; BINS] = std::array::from_fn(|bin| places[(side * BINS + bin) * n + cell]);
                    stride * mean_bin(&logits)
                });
                [x - left, y - top, x + right, y + bottom]
            }
        }
    }
}

/// The mean of the distribution whose logits these are.
fn mean_bin(logits: &[f32; BINS]) -> f32 {
    let most = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (mut sum, mut mean) = (0.0, 0.0);
    for (bin, v) in logits.iter().enumerate() {
        let weight = (v - most).exp();
        sum += weight;
        mean += weight * bin as f32;
    }
    mean / sum
}

fn sigmoid(v: f32) -> f32 {
    1.0 / (1.0 + (-v).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strides_follow_from_the_number_of_cells() {
        let Some(Head::Logits(cells)) = Head::logits(84, (64, 64)) else { panic!("8, 16, 32") };
        assert_eq!((cells[0], cells[9]), ([4.0, 4.0, 8.0], [12.0, 12.0, 8.0]));
        assert_eq!((cells[64], cells[83]), ([8.0, 8.0, 16.0], [48.0, 48.0, 32.0]));
        assert!(Head::logits(80, (64, 64)).is_some_and(|h| h.cells() == 80), "8 and 16");
        assert!(Head::logits(86, (64, 64)).is_none());
    }

    #[test]
    fn logits_become_the_boxes_they_stand_for() {
        let head = Head::logits(84, (64, 64)).expect("8, 16, 32");
        let n = 84;
        let mut raw = vec![0.0; head.len()];
        raw[4 * BINS * n..].fill(-20.0);
        // one sure bin for three sides of a cell of stride 16, two equal ones for the fourth
        let cell = 64 + 5; // column 1, row 1
        for (side, bin) in [(0, 1), (1, 2), (2, 3), (3, 4)] {
            raw[(side * BINS + bin) * n + cell] = 60.0;
        }
        raw[(3 * BINS + 5) * n + cell] = 60.0;
        raw[(4 * BINS + 2) * n + cell] = 3.0f32.ln(); // a score of 3/4
        raw[(4 * BINS) * n + cell] = 0.9;
        raw[(4 * BINS + 1) * n + 7] = -1.0;
        let found = head.decode(&raw, 0.5);
        assert_eq!((found.len(), found[0].class), (1, 2), "{found:?}");
        assert!((found[0].score - 0.75).abs() < 1e-6);
        let known = [24.0 - 16.0, 24.0 - 32.0, 24.0 + 48.0, 24.0 + 72.0];
        assert!(found[0].sides.iter().zip(known).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
        assert_eq!(head.decode(&raw, 0.2).len(), 2, "the next one has a score of 0.27");
        // decoded as a whole it is what the usual head would give
        let whole = Head::Boxes(n).decode(&head.decode_all(&raw).expect("its length"), 0.5);
        assert_eq!((whole.len(), whole[0].class), (1, 2));
        assert!(whole[0].sides.iter().zip(known).all(|(a, b)| (a - b).abs() < 1e-3), "{whole:?}");
        assert!(head.decode_all(&raw[1..]).is_none());
    }
}

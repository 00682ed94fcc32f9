//! Points by place: which of many lie near another. In: points in a plane. Out: indices. Not here: what they are.

use crate::lent::List;
use nalgebra::Vector2;

/// Points in square cells, row by row.
pub(crate) struct Buckets {
    corner: Vector2<f64>,
    cell: f64,
    columns: usize,
    rows: usize,
    /// Where the indices of each cell begin; one more than there are cells.
    start: List<u32>,
    indices: List<u32>,
}

impl Buckets {
    /// Of `points`, in cells of `cell` or as much larger as keeps them few.
    pub(crate) fn new(points: impl Iterator<Item = Vector2<f64>> + Clone, cell: f64) -> Self {
        let low = points.clone().fold(Vector2::repeat(f64::INFINITY), |a, p| a.inf(&p));
        let high = points.clone().fold(Vector2::repeat(f64::NEG_INFINITY), |a, p| a.sup(&p));
        let extent = (high - low).map(|v| if v > 0.0 { v } else { 0.0 });
        let n = points.clone().count();
        let cell = cell.max((extent.x * extent.y / (16.0 * n as f64 + 4e4)).sqrt()).max(extent.max() / 1e4);
        let (columns, rows) = ((extent.x / cell) as usize + 1, (extent.y / cell) as usize + 1);
        let (start, indices) = (List::filled(0, columns * rows + 1), List::filled(0, n));
        let mut new = Self { corner: low, cell, columns, rows, start, indices };
        for p in points.clone() {
            let k = new.cell_of(&p);
            new.start[k + 1] += 1;
        }
        for k in 1..new.start.len() {
            new.start[k] += new.start[k - 1];
        }
        let mut next = List::of(new.start.iter().copied());
        for (i, p) in (0..).zip(points) {
            let k = new.cell_of(&p);
            new.indices[next[k] as usize] = i;
            next[k] += 1;
        }
        new
    }

    fn cell_of(&self, p: &Vector2<f64>) -> usize {
        let at = (p - self.corner) / self.cell;
        (at.y as usize).min(self.rows - 1) * self.columns + (at.x as usize).min(self.columns - 1)
    }

    /// All points within `radius` of `p`, and some that are farther away.
    pub(crate) fn near(&self, p: Vector2<f64>, radius: f64) -> impl Iterator<Item = usize> {
        let radius = radius * (1.0 + 1e-9) + 1e-9;
        let range = |at: f64, n: usize| {
            let (first, last) = ((at - radius) / self.cell, (at + radius) / self.cell);
            if last >= 0.0 { first.max(0.0) as usize..(last as usize + 1).min(n) } else { 0..0 }
        };
        let at = p - self.corner;
        let (columns, rows) = (range(at.x, self.columns), range(at.y, self.rows));
        rows.filter(move |_| columns.start < columns.end).flat_map(move |row| {
            let [from, to] =
                [columns.start, columns.end].map(|column| self.start[row * self.columns + column] as usize);
            self.indices[from..to].iter().map(|i| *i as usize)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;

    #[test]
    fn no_point_within_the_radius_is_missed() {
        let mut noise = Noise::new(3);
        let points: Vec<_> = (0..500).map(|_| Vector2::new(noise.gauss() * 30.0, noise.gauss() * 8.0)).collect();
        for (cell, radius) in [(1.0, 1.0), (1.0, 5.0), (0.01, 2.5), (300.0, 1.0)] {
            let buckets = Buckets::new(points.iter().copied(), cell);
            let mut few = 0;
            for _ in 0..200 {
                let p = Vector2::new(noise.gauss() * 50.0, noise.gauss() * 15.0);
                let mut near: Vec<usize> = buckets.near(p, radius).collect();
                few += near.len();
                near.retain(|&i| (points[i] - p).norm() <= radius);
                near.sort_unstable();
                let all: Vec<usize> = (0..points.len()).filter(|&i| (points[i] - p).norm() <= radius).collect();
                assert_eq!(near, all);
            }
            assert!(cell > 100.0 || few < 200 * 100, "{few} of 100000 looked at");
        }
        assert_eq!(Buckets::new(std::iter::empty(), 1.0).near(Vector2::zeros(), 9.0).count(), 0);
        assert_eq!(Buckets::new(std::iter::once(Vector2::zeros()), 1.0).near(Vector2::zeros(), 9.0).count(), 1);
    }
}

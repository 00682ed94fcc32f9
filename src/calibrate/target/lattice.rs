//! Points that stand in rows and columns, counted from one of them. In: what the counting found. Out: the extent, what
//! stands next, the order of a board's points. Not here: how neighbours are told.

use crate::optics::Pixel;
use std::collections::BTreeMap;

/// Column and row of a point, from any origin; rows turn clockwise on the screen from columns, as y does from x.
pub(super) type Cell = (i32, i32);

/// A number of columns or rows as a difference of cells.
pub(super) fn steps(n: usize) -> i32 {
    i32::try_from(n).expect("a lattice has no more points than an image pixels")
}

/// Points by cell, as indices of a list of the caller's.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Lattice {
    pub(super) cells: BTreeMap<Cell, usize>,
}

/// A line on the outside belongs to the board if at least this share of it is there.
const OUTER_SHARE: f64 = 1.0 / 3.0;

impl Lattice {
    /// Lowest column and row, and how many of both; of nothing, 0.
    pub(super) fn extent(&self) -> (Cell, (usize, usize)) {
        let range = |of: fn(&Cell) -> i32| {
            let low = self.cells.keys().map(of).min().unwrap_or(0);
            let high = self.cells.keys().map(of).max().unwrap_or(low - 1);
            (low, (high - low + 1) as usize)
        };
        let ((left, columns), (top, rows)) = (range(|c| c.0), range(|c| c.1));
        ((left, top), (columns, rows))
    }

    /// Drops outer lines of which little is there: what happened to stand where the grid would go on.
    pub(super) fn trim(&mut self) {
        while !self.cells.is_empty() {
            let ((left, top), (columns, rows)) = self.extent();
            let (right, bottom) = (left + steps(columns) - 1, top + steps(rows) - 1);
            let on = |c: &Cell, (axis, place): (usize, i32)| [c.0, c.1][axis] == place;
            let share = |(line, length): ((usize, i32), usize)| {
                let there = self.cells.keys().filter(|c| on(c, line)).count();
                (line, there as f64 / length as f64)
            };
            let lines = [((0, left), rows), ((0, right), rows), ((1, top), columns), ((1, bottom), columns)].map(share);
            let thinnest = lines.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((line, _)) = thinnest.filter(|(_, share)| *share < OUTER_SHARE) else { return };
            self.cells.retain(|c, _| !on(c, line));
        }
    }

    /// The ways to lay a right-handed board of `columns` × `rows` on all of the lattice, each as quarter turns (x along
    /// +column, +row, −column, −row) and the cell of every point of the board; none unless the size is the same.
    pub(super) fn orders(&self, columns: usize, rows: usize) -> Vec<(i32, Vec<Cell>)> {
        let ((left, top), size) = self.extent();
        let (right, bottom) = (left + steps(size.0) - 1, top + steps(size.1) - 1);
        let fits = |turns: &i32| if turns % 2 == 0 { size == (columns, rows) } else { size == (rows, columns) };
        let cells = |turns: i32| {
            let cell = |i: i32, j: i32| match turns {
                0 => (left + i, top + j),
                1 => (right - j, top + i),
                2 => (right - i, bottom - j),
                _ => (left + j, bottom - i),
            };
            (0..columns * rows).map(|k| cell(steps(k % columns), steps(k / columns))).collect()
        };
        (0..4).filter(fits).map(|turns| (turns, cells(turns))).collect()
    }
}

/// Where the point of `cell` should be by its neighbours: amid those on both sides, else beyond those on one.
pub(super) fn predict(cell: Cell, at: impl Fn(Cell) -> Option<Pixel>) -> Option<Pixel> {
    let near = |du: i32, dv: i32| at((cell.0 + du, cell.1 + dv));
    let mean = |found: &[Pixel]| (!found.is_empty()).then(|| found.iter().sum::<Pixel>() / found.len() as f64);
    let ways = [(1, 0), (0, 1), (-1, 0), (0, -1)];
    let amid = |&(u, v): &(i32, i32)| Some(0.5 * (near(u, v)? + near(-u, -v)?));
    let beyond = |&(u, v): &(i32, i32)| Some(2.0 * near(u, v)? - near(2 * u, 2 * v)?);
    let beside = |&(u, v): &(i32, i32)| Some(near(u, v)? + near(-v, u)? - near(u - v, u + v)?);
    let farther = |&(u, v): &(i32, i32)| Some(3.0 * near(2 * u, 2 * v)? - 2.0 * near(3 * u, 3 * v)?);
    let all = |f: &dyn Fn(&(i32, i32)) -> Option<Pixel>| mean(&ways.iter().filter_map(f).collect::<Vec<_>>());
    all(&amid).or_else(|| all(&beyond)).or_else(|| all(&beside)).or_else(|| all(&farther))
}

/// The step from a point to the next along +column (`way` (1, 0)) or +row ((0, 1)): the shorter of those on either side.
pub(super) fn side(cell: Cell, way: (i32, i32), at: impl Fn(Cell) -> Option<Pixel>) -> Option<Pixel> {
    let here = at(cell)?;
    let after = at((cell.0 + way.0, cell.1 + way.1)).map(|p| p - here);
    let before = at((cell.0 - way.0, cell.1 - way.1)).map(|p| here - p);
    match (after, before) {
        (Some(a), Some(b)) => {
            let mean = 0.5 * (a + b);
            Some(mean * (a.norm().min(b.norm()) / mean.norm()))
        }
        (a, b) => a.or(b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells of `columns` × `rows` from (−1, 2), numbered row by row.
    fn full(columns: i32, rows: i32) -> Lattice {
        let cell = |k: i32| ((k % columns - 1, k / columns + 2), k as usize);
        Lattice { cells: (0..columns * rows).map(cell).collect() }
    }

    #[test]
    fn thin_outer_lines_are_dropped_and_holes_are_kept() {
        let mut lattice = full(6, 4);
        lattice.cells.remove(&(1, 3));
        lattice.cells.insert((5, 3), 99); // one of four: less than a third
        lattice.cells.insert((2, 1), 98);
        lattice.cells.insert((3, 1), 97); // and two of seven, but of six a third
        lattice.trim();
        assert_eq!(lattice.extent(), ((-1, 1), (6, 5)));
        lattice.cells.remove(&(3, 1));
        lattice.trim();
        assert_eq!((lattice.extent(), lattice.cells.len()), (((-1, 2), (6, 4)), 23));
        let mut nothing = Lattice::default();
        nothing.trim();
        assert_eq!(nothing.extent().1, (0, 0));
    }

    #[test]
    fn a_board_lies_in_right_handed_ways_only() {
        for (columns, rows, ways) in [(3, 2, 2), (2, 3, 2), (3, 3, 0), (4, 2, 0)] {
            let orders = full(3, 2).orders(columns, rows);
            assert_eq!(orders.len(), ways, "{columns}×{rows}");
            for (turns, cells) in orders {
                let step = |k: usize| (cells[k].0 - cells[0].0, cells[k].1 - cells[0].1);
                let (x, y) = (step(1), step(columns));
                assert_eq!((x.0 * y.1 - x.1 * y.0, turns % 2), (1, i32::from(columns == 2)));
            }
        }
        assert_eq!(full(3, 3).orders(3, 3).len(), 4);
    }

    #[test]
    fn neighbours_on_both_sides_predict_before_those_on_one() {
        let bent = |c: Cell| Pixel::new(f64::from(c.0).powi(2), f64::from(10 * c.1));
        let among = |cells: &'static [Cell]| move |c: Cell| cells.contains(&c).then(|| bent(c));
        let p = |cells| predict((0, 0), among(cells));
        assert_eq!(p(&[(-1, 0), (1, 0), (0, 1), (0, 2)]), Some(Pixel::new(1.0, 0.0)));
        assert_eq!(p(&[(0, 1), (0, 2)]), Some(Pixel::new(0.0, 0.0)));
        assert_eq!(p(&[(1, 0), (0, 1), (1, 1)]), Some(Pixel::new(0.0, 0.0)));
        assert_eq!(p(&[(0, -2), (0, -3)]), Some(Pixel::new(0.0, 0.0)));
        assert_eq!(p(&[(1, 0), (0, 1)]), None);
    }
}

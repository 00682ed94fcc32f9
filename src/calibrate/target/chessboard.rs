//! A chessboard in an image. In: a grey image, the board. Out: its corners in order, or why not.
//! Not here: what a corner looks like, its last tenth of a pixel.
//!
//! Corners are joined to their neighbours along their edges, and those to theirs: as Geiger and others, "Automatic
//! camera and range sensor calibration using a single shot", ICRA 2012, let boards grow, but by the edges' directions
//! and the change of colour from corner to corner, so that no size needs to be known. From coarse to fine: large boards
//! are found where the image is small.

use super::corners::{Corner, corners};
use super::halved::{doubled, halved};
use super::lattice::{Cell, Lattice, predict, side, steps};
use super::saddle::{Saddle, fit, settle};
use super::{Mark, NotFound, Seen, Sighting};
use crate::calibrate::Board;
use crate::image::Image;
use crate::optics::Pixel;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};

/// A neighbour is so near to the edge's direction: cosine.
const AHEAD: f64 = 0.95;
/// And its edge so parallel to ours: cosine.
const PARALLEL: f64 = 0.9;
/// And its contrast so alike: across a shadow's edge it jumps.
const CONTRAST: f64 = 10.0;
/// And its place so near to what the others predict, in sides of a square.
const STRAY: f64 = 0.3;
/// The fit's window, ± of a square's side: the next edges, blurred, stay outside.
const ARM: f64 = 0.4;
/// Nor more than so many pixels: beyond, lenses bend edges, and time is lost.
const LONGEST_ARM: f64 = 15.0;
/// So many are enough to see whether a grid goes on.
const BEYOND_ARM: f64 = 7.0;

/// The board's corners in `image`; of several boards, the one that shows largest.
pub(super) fn find(image: &Image<f32>, board: &Board) -> Result<Sighting, NotFound> {
    let levels = halved(image);
    let mut seen = Seen::default();
    for level in (0..levels.len()).rev() {
        let corners = corners(&levels[level]);
        for lattice in lattices(&corners, board.columns * board.rows / 3) {
            let Some(cells) = ordered(&lattice, &corners, board) else {
                seen.grid(&lattice);
                continue;
            };
            let at = |c: &Cell| lattice.cells.get(c).map(|&k| corners[k].at);
            let start = down(cells.iter().map(at).collect(), &levels[..level]);
            let mut grid = Grid { image, cells: BTreeMap::new(), bright: 1.0 };
            match grid.refined(start, board) {
                Some(marks) => {
                    if let Some(sighting) = seen.judge(marks, board) {
                        return Ok(sighting);
                    }
                }
                None => seen.grid(&grid.lattice()),
            }
        }
    }
    Err(seen.not_found(board))
}

/// Corners joined to lattices of at least `least` points, the largest in the image first.
fn lattices(corners: &[Corner], least: usize) -> Vec<Lattice> {
    let links = links(corners);
    let mut used = vec![false; corners.len()];
    let mut found = Vec::new();
    for seed in (0..corners.len()).filter(|&i| amid_four(corners, &links, i)) {
        if used[seed] {
            continue;
        }
        let mut lattice = joined(corners, &links, seed, &mut used);
        if lattice.cells.len() >= least.max(4) {
            grow(&mut lattice, corners);
            lattice.trim();
            found.push(lattice);
        }
    }
    let area = |l: &Lattice| {
        let [low, high] = [f64::min, f64::max].map(|f| {
            let at = l.cells.values().map(|&k| corners[k].at);
            at.reduce(|a, b| a.zip_map(&b, f)).unwrap_or_default()
        });
        (high - low).product()
    };
    found.sort_by(|a, b| area(b).total_cmp(&area(a)));
    found
}

/// Along an edge's line (0, 1) forwards and backwards.
const WAYS: [(usize, f64); 4] = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)];

fn way(line: usize, sign: f64) -> usize {
    2 * line + usize::from(sign < 0.0)
}

/// Per corner and way the nearest corner ahead that can be its neighbour, where each is the other's.
fn links(corners: &[Corner]) -> Vec<[Option<usize>; 4]> {
    let mut by_row: Vec<usize> = (0..corners.len()).collect();
    by_row.sort_by(|&a, &b| corners[a].at.y.total_cmp(&corners[b].at.y));
    let mut place = vec![0; corners.len()];
    by_row.iter().enumerate().for_each(|(p, &i)| place[i] = p);
    let nearest = |i: usize| {
        let here = &corners[i];
        let mut best = [(f64::INFINITY, None); 4];
        let mut consider = |j: usize| {
            let there = &corners[j];
            let d = there.at - here.at;
            let distance = d.norm();
            for (k, (line, sign)) in WAYS.into_iter().enumerate() {
                if distance < best[k].0
                    && sign * here.axes[line].dot(&d) > AHEAD * distance
                    && here.axes[line].dot(&there.axes[1 - line]).abs() > PARALLEL
                    && here.contrast < CONTRAST * there.contrast
                    && there.contrast < CONTRAST * here.contrast
                {
                    best[k] = (distance, Some(j));
                }
            }
            best.iter().map(|b| b.0).fold(0.0, f64::max)
        };
        let mut farthest = f64::INFINITY;
        let (mut up, mut down) = (place[i], place[i] + 1);
        loop {
            let above = up.checked_sub(1).map(|p| by_row[p]).filter(|&j| here.at.y - corners[j].at.y < farthest);
            let below = by_row.get(down).copied().filter(|&j| corners[j].at.y - here.at.y < farthest);
            if let Some(j) = above {
                farthest = consider(j);
                up -= 1;
            }
            if let Some(j) = below {
                farthest = consider(j);
                down += 1;
            }
            if above.is_none() && below.is_none() {
                return best.map(|b| b.1);
            }
        }
    };
    let nearest: Vec<[Option<usize>; 4]> = (0..corners.len()).into_par_iter().map(nearest).collect();
    let mutual = |i: usize, k: usize| {
        let (line, sign) = WAYS[k];
        nearest[i][k].filter(|&j| {
            let back = -sign * corners[i].axes[line].dot(&corners[j].axes[1 - line]);
            nearest[j][way(1 - line, back)] == Some(i)
        })
    };
    (0..corners.len()).map(|i| std::array::from_fn(|k| mutual(i, k))).collect()
}

/// Whether corner `i` stands in the middle of four others.
fn amid_four(corners: &[Corner], links: &[[Option<usize>; 4]], i: usize) -> bool {
    let [Some(a), Some(b), Some(c), Some(d)] = links[i].map(|l| l.map(|k| corners[k].at)) else { return false };
    [(a, b), (c, d)].iter().all(|(p, q)| (0.5 * (p + q) - corners[i].at).norm() < STRAY * 0.5 * (p - q).norm())
}

/// All that is linked to `seed` and stands where its neighbours predict. Its first axis is the columns' direction, so that at cells of even sum the square
/// between +column and +row is bright.
fn joined(corners: &[Corner], links: &[[Option<usize>; 4]], seed: usize, used: &mut [bool]) -> Lattice {
    let mut lattice = Lattice { cells: BTreeMap::from([((0, 0), seed)]) };
    used[seed] = true;
    // corner, cell, and which of its lines and which way of it are +column and +row
    let mut queue = VecDeque::from([(seed, (0, 0), [(0, 1.0), (1, 1.0)])]);
    while let Some((i, cell, frame)) = queue.pop_front() {
        for (along, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
            let (line, positive): (usize, f64) = frame[along];
            let Some(j) = links[i][way(line, positive * f64::from(sign))] else { continue };
            let next: Cell = if along == 0 { (cell.0 + sign, cell.1) } else { (cell.0, cell.1 + sign) };
            let at = |c: Cell| lattice.cells.get(&c).map(|&k| corners[k].at);
            let (from, to) = (corners[i].at, corners[j].at);
            let strays = |p: Pixel| (to - p).norm() > STRAY * (to - from).norm().min((p - from).norm());
            if used[j] || at(next).is_some() || predict(next, at).is_some_and(strays) {
                continue;
            }
            used[j] = true;
            lattice.cells.insert(next, j);
            let same = |(line, positive): (usize, f64)| {
                let d = positive * corners[i].axes[line].dot(&corners[j].axes[1 - line]);
                (1 - line, d.signum())
            };
            queue.push_back((j, next, frame.map(same)));
        }
    }
    lattice
}

/// Adds corners that stand where the lattice goes on, in the colours it would have there.
fn grow(lattice: &mut Lattice, corners: &[Corner]) {
    let mut used: Vec<bool> = vec![false; corners.len()];
    lattice.cells.values().for_each(|&k| used[k] = true);
    loop {
        let at = |c: Cell| lattice.cells.get(&c).map(|&k| corners[k].at);
        let around = |c: &Cell| [-2, -1, 1, 2].map(|d| [(c.0 + d, c.1), (c.0, c.1 + d)]).concat();
        let mut empty: Vec<Cell> = lattice.cells.keys().flat_map(around).collect();
        empty.sort_unstable();
        empty.dedup();
        empty.retain(|c| !lattice.cells.contains_key(c));
        let found = empty.iter().find_map(|&cell| {
            let p = predict(cell, at)?;
            let near = |du: i32, dv: i32| Some((at((cell.0 + du, cell.1 + dv))? - p).norm());
            let sides = [(1, 0), (-1, 0), (0, 1), (0, -1), (2, 0), (-2, 0), (0, 2), (0, -2)];
            let side = sides.into_iter().filter_map(|(u, v)| near(u, v)).fold(f64::INFINITY, f64::min);
            let distance = |k: &usize| (corners[*k].at - p).norm();
            let k = (0..corners.len()).filter(|&k| !used[k]).min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
            let parallel = parallel_to_lattice(&corners[k], cell, &p, at);
            (distance(&k) < 0.2 * side && parallel).then_some((cell, k))
        });
        let Some((cell, k)) = found else { return };
        used[k] = true;
        lattice.cells.insert(cell, k);
    }
}

/// Whether a corner's edges are those of a neighbouring cell of the lattice, colours exchanged as they must be.
fn parallel_to_lattice(corner: &Corner, cell: Cell, p: &Pixel, at: impl Fn(Cell) -> Option<Pixel>) -> bool {
    let along = |u: i32, v: i32, line: usize| {
        let step = (1..=2).find_map(|n| {
            at((cell.0 + n * u, cell.1 + n * v)).or_else(|| at((cell.0 - n * u, cell.1 - n * v))).map(|q| q - p)
        });
        step.is_none_or(|d| corner.axes[line].dot(&d).abs() > 0.8 * d.norm())
    };
    let odd = (cell.0 + cell.1).rem_euclid(2) as usize;
    along(1, 0, odd) && along(0, 1, 1 - odd)
}

/// The cells of the board's points in their order; `None` unless the lattice has the board's size.
fn ordered(lattice: &Lattice, corners: &[Corner], board: &Board) -> Option<Vec<Cell>> {
    let mut orders = lattice.orders(board.columns, board.rows);
    // a quarter turn puts a square of the other colour between +x and +y
    let dark = |(turns, cells): &(i32, Vec<Cell>)| (cells[0].0 + cells[0].1 + *turns).rem_euclid(2) == 1;
    if orders.iter().any(dark) {
        orders.retain(dark);
    }
    let at = |c: Cell| lattice.cells.get(&c).map(|&k| corners[k].at);
    let from_top_left =
        |cells: &[Cell]| at(cells[0]).or_else(|| predict(cells[0], at)).map_or(f64::INFINITY, |p| p.norm());
    let nearest = orders.into_iter().min_by(|a, b| from_top_left(&a.1).total_cmp(&from_top_left(&b.1)));
    nearest.map(|(_, cells)| cells)
}

/// Points of a coarse level carried to the finest, on each level to the saddle that is there.
fn down(mut points: Vec<Option<Pixel>>, finer: &[Cow<'_, Image<f32>>]) -> Vec<Option<Pixel>> {
    for level in finer.iter().rev() {
        for p in points.iter_mut().flatten() {
            let below = doubled(p);
            *p = settle(level, &below).unwrap_or(below);
        }
    }
    points
}

/// A board's corners in the full image.
struct Grid<'a> {
    image: &'a Image<f32>,
    /// By the board's own columns and rows; for a moment some beyond.
    cells: BTreeMap<Cell, Saddle>,
    /// 1 where at even cells the square between +column and +row is bright, −1 where it is dark.
    bright: f64,
}

impl Grid<'_> {
    fn at(&self, cell: Cell) -> Option<Pixel> {
        self.cells.get(&cell).map(|s| s.at)
    }

    /// The corner at `p`, which stands for `cell`, by the steps to its neighbours; no arm longer than
    /// `longest`.
    fn fit(&self, cell: Cell, p: Pixel, longest: f64, at: impl Fn(Cell) -> Option<Pixel>) -> Option<Saddle> {
        let at = |c: Cell| if c == cell { Some(p) } else { at(c).or_else(|| predict(c, &at)) };
        let arm = |way| side(cell, way, at).map(|s| (ARM * s).cap_magnitude(longest));
        fit(self.image, &p, [arm((1, 0))?, arm((0, 1))?])
    }

    /// Whether the colours about `cell` are as they take turns on the board.
    fn coloured(&self, cell: &Cell, saddle: &Saddle) -> bool {
        saddle.contrast * turn(cell) * self.bright > 0.0
    }

    /// Fits those of `cells` that are missing where their neighbours predict them; no arm longer than `longest`.
    /// How many there are then.
    fn complete(&mut self, cells: &[Cell], longest: f64) -> usize {
        let fitted = |&cell: &Cell| {
            let p = predict(cell, |c| self.at(c)).filter(|_| !self.cells.contains_key(&cell))?;
            let saddle = self.fit(cell, p, longest, |c| self.at(c))?;
            self.coloured(&cell, &saddle).then_some((cell, saddle))
        };
        let found: Vec<(Cell, Saddle)> = cells.par_iter().filter_map(fitted).collect();
        self.cells.extend(found);
        cells.iter().filter(|c| self.cells.contains_key(c)).count()
    }

    /// Fits every corner: first those that were seen, then those that their neighbours predict. `None` if the grid goes
    /// on beyond the board; it then holds what lies there as well.
    fn refined(&mut self, start: Vec<Option<Pixel>>, board: &Board) -> Option<Vec<Option<Mark>>> {
        let (columns, rows) = (steps(board.columns), steps(board.rows));
        let cells: Vec<Cell> = (0..columns * rows).map(|k| (k % columns, k / columns)).collect();
        let seen: BTreeMap<Cell, Pixel> = cells.iter().zip(start).filter_map(|(c, p)| Some((*c, p?))).collect();
        let fitted = |(c, p): (&Cell, &Pixel)| Some((*c, self.fit(*c, *p, LONGEST_ARM, |c| seen.get(&c).copied())?));
        self.cells = seen.par_iter().filter_map(fitted).collect();
        self.bright = self.cells.iter().map(|(c, s)| s.contrast.signum() * turn(c)).sum::<f64>().signum();
        let other: Vec<Cell> = self.cells.iter().filter(|(c, s)| !self.coloured(c, s)).map(|(c, _)| *c).collect();
        other.iter().for_each(|c| {
            self.cells.remove(c);
        });
        self.complete(&cells, LONGEST_ARM);
        self.complete(&cells, LONGEST_ARM); // once more from those just found
        let mark = |c: &Cell| self.cells.get(c).map(|s| Mark { at: s.at, sigma: s.sigma, edge: Vec::new() });
        let marks = cells.iter().map(mark).collect();
        let column = |u: i32| (0..rows).map(|v| (u, v)).collect::<Vec<Cell>>();
        let row = |v: i32| (0..columns).map(|u| (u, v)).collect::<Vec<Cell>>();
        let beyond = [column(-1), column(columns), row(-1), row(rows)];
        let goes_on = beyond.iter().filter(|line| 2 * self.complete(line, BEYOND_ARM) >= line.len()).count();
        (goes_on == 0).then_some(marks)
    }

    /// What was found, as points without a place.
    fn lattice(&self) -> Lattice {
        let mut lattice = Lattice { cells: self.cells.keys().map(|c| (*c, 0)).collect() };
        lattice.trim();
        lattice
    }
}

/// Colours take turns: 1 at even cells, −1 at odd ones.
fn turn(cell: &Cell) -> f64 {
    if (cell.0 + cell.1) % 2 == 0 { 1.0 } else { -1.0 }
}

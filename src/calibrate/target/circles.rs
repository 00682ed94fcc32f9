//! A board of dark discs in an image. In: a grey image, the board. Out: the discs' centres in order, with their edges,
//! or why not. Not here: where the image of a centre is.
//!
//! A disc's image is nearly an ellipse that says how the board is seen there, but for a turn: its neighbours are a pitch
//! away in four directions square to each other, measured with that ellipse as the unit. So the grid grows from any
//! disc without regard to tilt. From coarse to fine, as with chessboards.

use super::disc::centres;
use super::halved::{doubled, halved};
use super::lattice::{Cell, Lattice, predict, steps};
use super::{Mark, NotFound, Seen, Sighting};
use crate::calibrate::{Board, BoardKind, Homography};
use crate::contour::{Chain, EdgeFilter, Edgel, Ellipse, EllipseLimits, cross_level, find_edges, fit_ellipse, link};
use crate::image::{Image, Window};
use crate::optics::Pixel;
use nalgebra::Vector2;
use std::collections::{BTreeMap, VecDeque};

/// Least length of a disc's edge on the level where it is found, px.
const SHORTEST: f64 = 15.0;
/// `4π·area/perimeter²` of an ellipse seen under 65° is 0.75.
const ROUNDNESS: f64 = 0.65;
/// A neighbour is so near to its place, in pitches.
const STRAY: f64 = 0.25;
/// And its area so alike.
const AREA: f64 = 2.0;
/// Neighbouring edgels are not farther apart, px.
const REACH: f64 = 2.0;
/// An edge's level is looked for so far on both sides, px, and not beyond this share of the smaller semi-axis.
const EDGE_REACH: (f64, f64) = (5.0, 0.6);
/// A mark is so dark, between the ground (0) and a disc (1): a small one is blurred.
const MARK_DARKNESS: f64 = 0.4;

/// A disc's image.
#[derive(Clone, Debug, PartialEq)]
struct Disc {
    ellipse: Ellipse,
    edge: Vec<Pixel>,
}

/// The board's discs in `image`; of several boards, the one that shows largest.
pub(super) fn find(image: &Image<f32>, board: &Board) -> Result<Sighting, NotFound> {
    let levels = halved(image);
    let mut seen = Seen::default();
    let Some(grey) = Grey::of(image) else { return Err(seen.not_found(board)) };
    for level in (0..levels.len()).rev() {
        let discs = discs(&levels[level], Window::whole(levels[level].width, levels[level].height), &grey);
        for lattice in lattices(&discs, board) {
            let orders = lattice.orders(board.columns, board.rows);
            let ellipse = |k: &usize| (0..level).fold(discs[*k].ellipse, |e, _| twice(&e));
            let ellipses = lattice.cells.iter().map(|(c, k)| (*c, ellipse(k))).collect();
            let grid = Grid { image, grey: &grey, ellipses };
            let whole = grid.with_beyond(&lattice);
            if orders.is_empty() || whole.extent() != lattice.extent() {
                seen.grid(&whole);
                continue;
            }
            match grid.ordered(orders.into_iter().map(|o| o.1).collect(), board) {
                Ok(cells) => {
                    if let Some(sighting) = seen.judge(grid.marks(&cells, board), board) {
                        return Ok(sighting);
                    }
                }
                Err(marks) => seen.marks = seen.marks.max(Some(marks)),
            }
        }
    }
    Err(seen.not_found(board))
}

/// The edge (raw px) of the smallest dark disc in `image` about pixel `near`.
pub(super) fn about(image: &Image<f32>, near: &Pixel) -> Option<Vec<Pixel>> {
    let grey = Grey::of(image)?;
    let mut all = discs(image, Window::whole(image.width, image.height), &grey);
    all.retain(|d| d.ellipse.shape.try_inverse().is_some_and(|s| (s * (near - d.ellipse.centre)).norm() <= 1.0));
    let area = |d: &Disc| d.ellipse.shape.determinant();
    all.into_iter().min_by(|a, b| area(a).total_cmp(&area(b))).map(|d| d.edge)
}

/// The same ellipse one level up.
fn twice(e: &Ellipse) -> Ellipse {
    Ellipse { centre: doubled(&e.centre), shape: 2.0 * e.shape }
}

/// Grey levels of an image, as far as edges need to know them.
struct Grey {
    range: f64,
    variance: f64,
}

impl Grey {
    /// `None` of an even image.
    fn of(image: &Image<f32>) -> Option<Self> {
        let (mut values, mut bends): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
        for y in (0..image.height).step_by(7) {
            for w in image.row(y).windows(3).step_by(5) {
                let [a, b, c] = [w[0], w[1], w[2]].map(f64::from);
                values.push(b);
                bends.push((a - 2.0 * b + c).abs());
            }
        }
        values.sort_unstable_by(f64::total_cmp);
        bends.sort_unstable_by(f64::total_cmp);
        let at = |v: &[f64], share: f64| v.get((share * v.len() as f64) as usize).copied();
        let range = at(&values, 0.995)? - at(&values, 0.005)?;
        // of Gaussian noise the median of |a − 2b + c| is 0.6745·√6 sigma; most pixels are on even ground
        let sigma = (at(&bends, 0.5)? / (0.6745 * 6.0f64.sqrt())).max(1e-3 * range);
        (range > 0.0).then_some(Self { range, variance: sigma * sigma })
    }

    fn filter(&self) -> EdgeFilter {
        EdgeFilter { start: (6.0, 0.02 * self.range), keep: (3.0, 0.01 * self.range), ..EdgeFilter::default() }
    }
}

/// The dark discs that lie wholly in `window`.
fn discs(image: &Image<f32>, window: Window, grey: &Grey) -> Vec<Disc> {
    let edgels = find_edges(image, window, &grey.filter(), |_| grey.variance);
    link(&edgels, REACH).iter().filter_map(disc).collect()
}

/// The disc that a chain runs round.
fn disc(chain: &Chain) -> Option<Disc> {
    let (first, last) = chain.edgels.first().zip(chain.edgels.last())?;
    let closed = chain.closed || (first.position - last.position).norm() < 2.0 * REACH;
    if !(closed && chain.length() > SHORTEST && chain.roundness() > ROUNDNESS) {
        return None;
    }
    let points: Vec<_> = chain.edgels.iter().map(|e| (e.position, 0.01)).collect();
    let limits = EllipseLimits { coverage: 0.8, semi_axes: 1.0..=1e5 };
    let fit = fit_ellipse(&points, &limits).ok()?;
    let outwards = |e: &Edgel| e.normal.dot(&(e.position - fit.ellipse.centre)) > 0.0;
    let dark = 10 * chain.edgels.iter().filter(|e| outwards(e)).count() > 9 * chain.edgels.len();
    let round = fit.weight > 0.6 * points.len() as f64 && 0.1 * fit.scale < 0.3 + 0.03 * fit.ellipse.semi_axes().1;
    let edge = chain.edgels.iter().map(|e| e.position).collect();
    (dark && round).then_some(Disc { ellipse: fit.ellipse, edge })
}

/// Discs that stand in a grid, the largest in the image first.
fn lattices(discs: &[Disc], board: &Board) -> Vec<Lattice> {
    let radius = board.diameter().map_or(f64::NAN, |d| 0.5 * d);
    let pitch = board.pitch / radius;
    let mut used = vec![false; discs.len()];
    let mut found = Vec::new();
    for seed in 0..discs.len() {
        if !used[seed] {
            let mut lattice = grown(discs, pitch, seed, &mut used);
            lattice.trim();
            found.push(lattice);
        }
    }
    found.retain(|l| 3 * l.cells.len() >= board.columns * board.rows);
    let area = |l: &Lattice| l.cells.values().map(|&k| discs[k].ellipse.shape.determinant()).sum::<f64>();
    found.sort_by(|a, b| area(b).total_cmp(&area(a)));
    found
}

/// A quarter turn clockwise on the screen, `n` times.
fn turned(v: Vector2<f64>, n: i32) -> Vector2<f64> {
    match n.rem_euclid(4) {
        0 => v,
        1 => Vector2::new(-v.y, v.x),
        2 => -v,
        _ => Vector2::new(v.y, -v.x),
    }
}

/// The grid about `seed`; `pitch` in radii.
fn grown(discs: &[Disc], pitch: f64, seed: usize, used: &mut [bool]) -> Lattice {
    let mut lattice = Lattice { cells: BTreeMap::from([((0, 0), seed)]) };
    used[seed] = true;
    // from `i` to `j`, in pitches, turned as the ellipse of `i` is not
    let between = |i: usize, j: usize| {
        let inverse = discs[i].ellipse.shape.try_inverse().unwrap_or_default();
        inverse * (discs[j].ellipse.centre - discs[i].ellipse.centre) / pitch
    };
    let alike = |i: usize, j: usize| {
        let ratio = discs[i].ellipse.shape.determinant() / discs[j].ellipse.shape.determinant();
        (1.0 / AREA..AREA).contains(&ratio)
    };
    let near = |j: &usize| (between(seed, *j).norm() - 1.0).abs();
    let others = (0..discs.len()).filter(|&j| j != seed && !used[j] && alike(seed, j));
    let Some(first) = others.min_by(|a, b| near(a).total_cmp(&near(b))).filter(|j| near(j) < STRAY) else {
        return lattice;
    };
    // disc, cell, and the direction of +column with its ellipse as the unit
    let mut queue = VecDeque::from([(seed, (0, 0), between(seed, first).normalize())]);
    while let Some((i, cell, along)) = queue.pop_front() {
        for (turn, (u, v)) in (0..).zip([(1, 0), (0, 1), (-1, 0), (0, -1)]) {
            let next: Cell = (cell.0 + u, cell.1 + v);
            let at = |c: Cell| lattice.cells.get(&c).map(|&k| discs[k].ellipse.centre);
            if at(next).is_some() {
                continue;
            }
            let stray = |j: &usize| (between(i, *j) - turned(along, turn)).norm();
            let others = (0..discs.len()).filter(|&j| !used[j] && alike(i, j));
            let Some(j) = others.min_by(|a, b| stray(a).total_cmp(&stray(b))).filter(|j| stray(j) < STRAY) else {
                continue;
            };
            let there = discs[j].ellipse.centre;
            let step = (there - discs[i].ellipse.centre).norm();
            if predict(next, at).is_some_and(|p| (p - there).norm() > STRAY * step) {
                continue;
            }
            used[j] = true;
            lattice.cells.insert(next, j);
            queue.push_back((j, next, turned(between(j, i).normalize(), -turn - 2)));
        }
    }
    lattice
}

/// A lattice of discs in the full image.
struct Grid<'a> {
    image: &'a Image<f32>,
    grey: &'a Grey,
    ellipses: BTreeMap<Cell, Ellipse>,
}

impl Grid<'_> {
    fn at(&self, cell: Cell) -> Option<Pixel> {
        self.ellipses.get(&cell).map(|e| e.centre)
    }

    /// The ellipse that is, or by its neighbours should be, at `cell`.
    fn expected(&self, cell: Cell) -> Option<Ellipse> {
        let near = |e: &&Cell| (e.0 - cell.0).abs() + (e.1 - cell.1).abs();
        let nearest = self.ellipses.keys().min_by_key(near)?;
        let centre = self.at(cell).or_else(|| predict(cell, |c| self.at(c)))?;
        Some(Ellipse { centre, shape: self.ellipses[nearest].shape })
    }

    /// The edge of the disc at `cell` in the full image.
    fn edge(&self, cell: Cell) -> Option<Vec<Pixel>> {
        let ellipse = self.expected(cell)?;
        let (major, minor) = ellipse.semi_axes();
        let (low, high) = (ellipse.centre.add_scalar(-1.2 * major - 8.0), ellipse.centre.add_scalar(1.2 * major + 8.0));
        let window = Window::clipped(low.x, low.y, high.x, high.y, self.image.width, self.image.height)?;
        let mut edgels = find_edges(self.image, window, &self.grey.filter(), |_| self.grey.variance);
        let reach = EDGE_REACH.0.min(EDGE_REACH.1 * minor);
        let sharp = cross_level(self.image, &edgels, reach, |_| f64::INFINITY, |_| self.grey.variance);
        // tiny discs have no ground within reach that is not another's
        if 2 * sharp.len() > edgels.len() {
            edgels = sharp;
        }
        let alike = |d: &Disc| {
            let ratio = d.ellipse.shape.determinant() / ellipse.shape.determinant();
            (1.0 / AREA..AREA).contains(&ratio) && (d.ellipse.centre - ellipse.centre).norm() < 0.5 * minor
        };
        link(&edgels, REACH).iter().filter_map(disc).find(alike).map(|d| d.edge)
    }

    /// `lattice` and the lines beyond it where most discs are there as well.
    fn with_beyond(&self, lattice: &Lattice) -> Lattice {
        let ((left, top), (columns, rows)) = lattice.extent();
        let (right, bottom) = (left + steps(columns), top + steps(rows));
        let column = |u: i32| (top..bottom).map(|v| (u, v)).collect::<Vec<Cell>>();
        let row = |v: i32| (left..right).map(|u| (u, v)).collect::<Vec<Cell>>();
        let mut whole = lattice.clone();
        for line in [column(left - 1), column(right), row(top - 1), row(bottom)] {
            let there: Vec<Cell> = line.iter().copied().filter(|&c| self.edge(c).is_some()).collect();
            if 2 * there.len() >= line.len() {
                whole.cells.extend(there.into_iter().map(|c| (c, 0)));
            }
        }
        whole
    }

    /// That of `orders` in which the board lies: by its marks, or the one whose first disc is nearest the top left.
    /// If no one order has all three marks, the most that one has.
    fn ordered(&self, mut orders: Vec<Vec<Cell>>, board: &Board) -> Result<Vec<Cell>, usize> {
        let from_top_left = |cells: &[Cell]| self.expected(cells[0]).map_or(f64::INFINITY, |e| e.centre.norm());
        orders.sort_by(|a, b| from_top_left(a).total_cmp(&from_top_left(b)));
        if matches!(board.kind, BoardKind::Marked { .. }) {
            let seen: Vec<usize> = orders.iter().map(|cells| self.marks_seen(cells, board.columns)).collect();
            let most = seen.iter().copied().max().unwrap_or(0);
            if most < 3 {
                return Err(most);
            }
            orders.retain(|cells| self.marks_seen(cells, board.columns) == most);
        }
        Ok(orders.swap_remove(0))
    }

    /// How many of the three marks stand where they should if the board lies as `cells` say.
    fn marks_seen(&self, cells: &[Cell], columns: usize) -> usize {
        let corner = (0..9).filter_map(|k| {
            let (i, j) = (k % 3, k / 3);
            Some((Vector2::new(i as f64, j as f64), self.expected(*cells.get(j * columns + i)?)?.centre))
        });
        let Some(view) = Homography::fit(&corner.collect::<Vec<_>>()) else { return 0 };
        let grey = |x: f64, y: f64| {
            let p = view.apply(&Vector2::new(x, y)).map(f64::round);
            let inside = p.x >= 1.0 && p.y >= 1.0 && p.x + 2.0 < self.image.width as f64;
            if !inside || p.y + 2.0 >= self.image.height as f64 {
                return f64::NAN;
            }
            let rows =
                (p.y as usize - 1..=p.y as usize + 1).map(|y| &self.image.row(y)[p.x as usize - 1..=p.x as usize + 1]);
            rows.flatten().map(|v| f64::from(*v)).sum::<f64>() / 9.0
        };
        // each mark is between two discs, with ground across
        let marks = [((0.5, 0.0), (0.0, 0.3)), ((0.0, 0.5), (0.3, 0.0)), ((0.5, 1.0), (0.0, 0.3))];
        let seen = |((x, y), (dx, dy)): &((f64, f64), (f64, f64))| {
            let ground = grey(x + dx, y + dy).max(grey(x - dx, y - dy));
            let disc = 0.5 * (grey(x - dy / 0.6, y - dx / 0.6) + grey(x + dy / 0.6, y + dx / 0.6));
            ground - grey(*x, *y) > MARK_DARKNESS * (ground - disc) && ground > disc
        };
        marks.iter().filter(|m| seen(m)).count()
    }

    /// The discs of `cells`, point by point of the board.
    fn marks(&self, cells: &[Cell], board: &Board) -> Vec<Option<Mark>> {
        let edges: Vec<Vec<Pixel>> = cells.iter().map(|&c| self.edge(c).unwrap_or_default()).collect();
        let Some(centres) = centres(board, &edges, 1.0) else { return vec![None; cells.len()] };
        let mark =
            |(edge, centre): (Vec<Pixel>, Option<(Pixel, f64)>)| centre.map(|(at, sigma)| Mark { at, sigma, edge });
        edges.into_iter().zip(centres).map(mark).collect()
    }
}

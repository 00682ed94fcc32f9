//! Chains of edgels. In: edgels in any order. Out: chains along the edges, bright side always on the same hand,
//! and the measures by which a wanted contour is told from others. Not here: what is wanted.

use super::Edgel;
use nalgebra::Vector2;
use std::collections::HashMap;
use std::f64::consts::PI;

/// Edgels in their order along an edge: walking along them, bright is at `normal`, a quarter turn (from +y
/// towards +x) from the way ahead.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// In order.
    pub edgels: Vec<Edgel>,
    /// The last one leads back to the first.
    pub closed: bool,
}

impl Chain {
    /// Length along the edge, px; with the closing piece if closed.
    pub fn length(&self) -> f64 {
        self.sides().map(|(a, b)| (b.position - a.position).norm()).sum()
    }

    /// `4π·area/perimeter²` of the chain closed by a straight line: 1 for a circle, less for all else; 0 of nothing.
    pub fn roundness(&self) -> f64 {
        let Some((first, last)) = self.edgels.first().zip(self.edgels.last()) else { return 0.0 };
        let gap = if self.closed { 0.0 } else { (first.position - last.position).norm() };
        let area: f64 =
            self.sides().map(|(a, b)| (a.position - first.position).perp(&(b.position - first.position))).sum();
        let perimeter = self.length() + gap;
        if perimeter > 0.0 { 2.0 * PI * area.abs() / (perimeter * perimeter) } else { 0.0 }
    }

    fn sides(&self) -> impl Iterator<Item = (&Edgel, &Edgel)> {
        let closing = self.edgels.last().zip(self.edgels.first()).filter(|_| self.closed);
        self.edgels.windows(2).map(|w| (&w[0], &w[1])).chain(closing)
    }
}

/// The way ahead at an edgel.
fn ahead(e: &Edgel) -> Vector2<f64> {
    Vector2::new(-e.normal.y, e.normal.x)
}

/// Links edgels to chains: each to the nearest one ahead within `reach` px whose normal agrees to 45°, where
/// that one's nearest behind is this. Single edgels are chains too.
pub fn link(edgels: &[Edgel], reach: f64) -> Vec<Chain> {
    let cell = |e: &Edgel| ((e.position.x / reach).floor() as i64, (e.position.y / reach).floor() as i64);
    let mut cells: HashMap<(i64, i64), Vec<usize>> = HashMap::new();
    for (i, e) in edgels.iter().enumerate() {
        cells.entry(cell(e)).or_default().push(i);
    }
    let nearest = |i: usize, way: f64| {
        let e = &edgels[i];
        let (x, y) = cell(e);
        let around = (0..9).filter_map(|k| cells.get(&(x + k % 3 - 1, y + k / 3 - 1))).flatten();
        let costs = around.filter_map(|&j| {
            let d = edgels[j].position - e.position;
            let (along, aside) = (way * d.dot(&ahead(e)), d.dot(&e.normal).abs());
            let near = j != i && d.norm() <= reach && along > 0.0 && aside < 0.2 + 0.7 * along;
            (near && e.normal.dot(&edgels[j].normal) > 0.7).then_some((j, along + 2.0 * aside))
        });
        costs.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(j, _)| j)
    };
    let next: Vec<_> = (0..edgels.len()).map(|i| nearest(i, 1.0)).collect();
    let previous: Vec<_> = (0..edgels.len()).map(|i| nearest(i, -1.0)).collect();
    let next: Vec<_> = (0..edgels.len()).map(|i| next[i].filter(|&j| previous[j] == Some(i))).collect();
    let previous: Vec<_> = (0..edgels.len()).map(|i| previous[i].filter(|&j| next[j] == Some(i))).collect();

    let mut used = vec![false; edgels.len()];
    let starts = (0..edgels.len()).filter(|&i| previous[i].is_none()).chain(0..edgels.len()); // then the rings
    let mut chains = Vec::new();
    for start in starts {
        let mut chain = Chain { edgels: Vec::new(), closed: previous[start].is_some() };
        let mut at = Some(start);
        while let Some(i) = at.filter(|&i| !used[i]) {
            used[i] = true;
            chain.edgels.push(edgels[i]);
            at = next[i];
        }
        if !chain.edgels.is_empty() {
            chains.push(chain);
        }
    }
    chains
}

/// Joins chains whose ends lie within `gap` px and point at each other (within 37°), nearest ends first; a chain
/// longer than three gaps whose own ends do so becomes closed.
pub fn join(mut chains: Vec<Chain>, gap: f64) -> Vec<Chain> {
    let distance = |a: &Chain, b: &Chain| {
        let (end, begin) = (a.edgels.last()?, b.edgels.first()?);
        let d = begin.position - end.position;
        let straight = ahead(end).dot(&d) >= 0.8 * d.norm() && ahead(begin).dot(&d) >= 0.8 * d.norm();
        (d.norm() <= gap && straight && !a.closed && !b.closed).then_some(d.norm())
    };
    loop {
        let pairs = (0..chains.len()).flat_map(|i| (0..chains.len()).map(move |j| (i, j)));
        let near = pairs.filter(|&(i, j)| i != j || chains[i].length() > 3.0 * gap);
        let costs = near.filter_map(|(i, j)| Some((i, j, distance(&chains[i], &chains[j])?)));
        let Some((i, j, _)) = costs.min_by(|a, b| a.2.total_cmp(&b.2)) else { return chains };
        if i == j {
            chains[i].closed = true;
        } else {
            let tail = std::mem::take(&mut chains[j].edgels);
            chains[i].edgels.extend(tail);
            chains.remove(j);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contour::{EdgeFilter, cross_level, find_edges};
    use crate::image::{Image, Window};
    use crate::optics::Pixel;
    use crate::testing::Noise;

    /// Edgels every px along a ring of radius 40 px, bright outside, in a scattered order, where `kept` says so (rad).
    fn ring(kept: impl Fn(f64) -> bool) -> Vec<Edgel> {
        let angles = (0..251).map(|k| f64::from(k * 97 % 251) * std::f64::consts::TAU / 251.0).filter(|a| kept(*a));
        let edgels = angles.map(|a| {
            let normal = Vector2::new(a.cos(), a.sin());
            Edgel {
                position: Pixel::new(60.0, 50.0) + 40.0 * normal,
                normal,
                strength: 30.0,
                variance: 1e-3,
                softness: 0.0,
            }
        });
        edgels.collect()
    }

    #[test]
    fn a_ring_is_one_closed_round_chain() {
        let chains = link(&ring(|_| true), 2.0);
        assert!(chains.len() == 1 && chains[0].closed && chains[0].edgels.len() == 251);
        assert!((chains[0].length() - 80.0 * PI).abs() < 0.1 && (chains[0].roundness() - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_broken_ring_is_joined_and_closed() {
        let chains = link(&ring(|a| (a - 1.0).abs() > 0.05 && (a - 3.0).abs() > 0.05 && (a - 5.0).abs() > 0.05), 2.0);
        assert_eq!(chains.len(), 3);
        assert!(chains.iter().all(|c| !c.closed && c.roundness() < 0.8));
        assert_eq!(join(chains.clone(), 3.0), chains);
        let joined = join(chains, 6.0);
        assert!(joined.len() == 1 && joined[0].closed && (joined[0].roundness() - 1.0).abs() < 1e-2);
    }

    #[test]
    fn a_noisy_ring_shaped_gap_is_two_closed_chains() {
        let (mut noise, mut image) = (Noise::new(2), Image::filled(120, 120, 0.0));
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let r = ((i % 120) as f64 - 59.3).hypot((i / 120) as f64 - 60.8);
            let dark = 1.0 / (1.0 + (2.0 * ((r - 42.0).abs() - 2.5)).exp()); // a gap of 5 px with soft edges
            *pixel = (100.0 - 80.0 * dark + 1.5 * noise.gauss()) as f32;
        }
        let found = find_edges(&image, Window::whole(120, 120), &EdgeFilter::default(), |_| 2.25);
        let mut chains = join(link(&cross_level(&image, &found, 6.0, |_| 100.0, |_| 2.25), 2.0), 4.0);
        chains.retain(|c| c.length() > 40.0);
        chains.sort_by(|a, b| a.length().total_cmp(&b.length()));
        eprintln!("{:?}", chains.iter().map(|c| (c.length(), c.closed, c.roundness())).collect::<Vec<_>>());
        assert!(chains.len() == 2 && chains.iter().all(|c| c.closed && c.roundness() > 0.95));
        for (chain, radius) in chains.iter().zip([39.5, 44.5]) {
            assert!((chain.length() / (2.0 * PI * radius) - 1.0).abs() < 0.02, "{}", chain.length());
        }
    }

    #[test]
    fn the_two_edges_of_a_gap_stay_apart() {
        let line = |x: f64, n: f64| {
            (0..30).map(move |y| Edgel {
                position: Pixel::new(x, f64::from(y)),
                normal: Vector2::new(n, 0.0),
                strength: 30.0,
                variance: 1e-3,
                softness: 0.0,
            })
        };
        let chains = join(link(&line(10.0, -1.0).chain(line(11.5, 1.0)).collect::<Vec<_>>(), 2.0), 5.0);
        assert!(chains.len() == 2 && chains.iter().all(|c| c.edgels.len() == 30 && !c.closed));
    }
}

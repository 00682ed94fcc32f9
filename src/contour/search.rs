//! Coarse shape search: where in an image a known contour lies, by the directions of the gradient.
//! In:  a coarse gradient field, and the contour's points with their directions in a few hypothetical attitudes.
//! Out: the best places with their scores, 0..=1. Not here: sub-pixel alignment, which contour is plausible where.
//! Score: mean over the points of the cosine between expected and nearest gradient (Steger, "Similarity measures for
//! occlusion, clutter, and illumination invariant object recognition", DAGM 2001); candidates by orientation bits
//! spread over their neighbourhood (Hinterstoisser et al., PAMI 34 (2012) 876).

use crate::image::Image;
use crate::lent::{Lent, List, side_by_side};
use crate::optics::Pixel;
use nalgebra::Vector2;

/// One point of a contour: where it lies from the contour's anchor, and the direction towards bright.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapePoint {
    /// Offset from the anchor, px of the full image.
    pub offset: Vector2<f64>,
    /// Unit vector towards bright.
    pub direction: Vector2<f64>,
}

/// A place where a shape matches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Of the anchor, px of the full image; good to about half a pixel of the field.
    pub at: Pixel,
    /// Mean cosine, 0..=1.
    pub score: f64,
}

/// Gradient directions of an image reduced by a whole factor.
#[derive(Debug)]
pub struct GradientField {
    factor: usize,
    width: usize,
    height: usize,
    /// Unit vectors towards bright; zero where the gradient is weak.
    direction: List<Vector2<f32>>,
    /// Which of eight directions occur within `SPREAD` pixels.
    nearby: List<u8>,
}

const SPREAD: usize = 2;
const CANDIDATES: usize = 12;

impl GradientField {
    /// Averages `factor` × `factor` pixels and takes gradients above `threshold` (grey levels per reduced pixel).
    pub fn new(image: &Image<f32>, factor: usize, threshold: f32) -> Self {
        let reduced = reduce(image, factor);
        let (width, height) = (reduced.width, reduced.height);
        let mut direction = List::filled(Vector2::zeros(), width * height);
        for y in 1..height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                let g = Vector2::new(
                    reduced.at(x + 1, y) - reduced.at(x - 1, y),
                    reduced.at(x, y + 1) - reduced.at(x, y - 1),
                ) * 0.5;
                let norm = g.norm();
                if norm > threshold {
                    direction[y * width + x] = g / norm;
                }
            }
        }
        let mut nearby = List::filled(0u8, width * height);
        for y in 0..height {
            for x in 0..width {
                let d = direction[y * width + x];
                if d != Vector2::zeros() {
                    let bits = bits(d.map(f64::from), true);
                    for row in y.saturating_sub(SPREAD)..=(y + SPREAD).min(height - 1) {
                        for bit in &mut nearby
                            [row * width + x.saturating_sub(SPREAD)..=row * width + (x + SPREAD).min(width - 1)]
                        {
                            *bit |= bits;
                        }
                    }
                }
            }
        }
        Self { factor, width, height, direction, nearby }
    }

    /// The points of strong gradient within `radius` px (of the full image) of `at`: offset and direction.
    pub fn points(&self, at: &Pixel, radius: f64) -> Vec<ShapePoint> {
        let mut points = Vec::new();
        for y in 0..self.height {
            for x in 0..self.width {
                let d = self.direction[y * self.width + x];
                let offset = self.full(x as f64, y as f64) - at;
                if d != Vector2::zeros() && offset.norm() <= radius {
                    points.push(ShapePoint { offset, direction: d.map(f64::from) });
                }
            }
        }
        points
    }

    /// The `keep` best matches of any of the `attitudes` of one shape, best first, at least `apart` px from
    /// each other. Points outside the image count as not found.
    pub fn search(&self, attitudes: &[List<ShapePoint>], keep: usize, apart: f64) -> List<Match> {
        let of_each = side_by_side(attitudes.len(), |k| self.candidates(&attitudes[k]));
        let mut candidates = List::new();
        for (k, found) in of_each.iter().enumerate() {
            candidates.extend(found.iter().map(|&(n, x, y)| (n, x, y, k)));
        }
        candidates.sort_unstable_by_key(|&(n, x, y, k)| (std::cmp::Reverse(n), y, x, k));
        let apart_cells = apart / self.factor as f64;
        let mut seeds: List<(usize, usize)> = List::new();
        for &(_, x, y, _) in &candidates {
            let far = |s: &(usize, usize)| (s.0 as f64 - x as f64).hypot(s.1 as f64 - y as f64) > 0.5 * apart_cells;
            if seeds.iter().all(far) {
                seeds.push((x, y));
                if seeds.len() == CANDIDATES {
                    break;
                }
            }
        }
        let refined = side_by_side(seeds.len(), |k| self.refine(attitudes, seeds[k].0, seeds[k].1));
        let mut matches = List::of(refined.iter().flatten().copied());
        matches.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut best: List<Match> = List::new();
        for m in &matches {
            if best.len() < keep && best.iter().all(|b| (b.at - m.at).norm() > apart) {
                best.push(*m);
            }
        }
        best
    }

    /// Per pixel of every other row: how many of the shape's points find their direction nearby, where at least
    /// half do.
    fn candidates(&self, shape: &[ShapePoint]) -> List<(u32, usize, usize)> {
        let points = List::of(shape.iter().map(|p| {
            let o = p.offset / self.factor as f64;
            (o.x.round() as isize, o.y.round() as isize, bits(p.direction, false))
        }));
        let mut counts = List::filled(0u16, self.width);
        let mut found = List::new();
        for y in (0..self.height).step_by(2) {
            counts.fill(0);
            for &(dx, dy, bit) in &points {
                let Some(row) = y.checked_add_signed(dy).filter(|row| *row < self.height) else { continue };
                let shift = dx.unsigned_abs().min(self.width);
                let row = &self.nearby[row * self.width..(row + 1) * self.width];
                // where x and x + dx are both inside
                let (counts, row) = if dx >= 0 {
                    (&mut counts[..self.width - shift], &row[shift..])
                } else {
                    (&mut counts[shift..], &row[..self.width - shift])
                };
                for (count, near) in counts.iter_mut().zip(row) {
                    *count += u16::from(near & bit != 0);
                }
            }
            let half = points.len() / 2;
            let strong = counts.iter().enumerate().filter(|(_, n)| usize::from(**n) > half);
            found.extend(strong.map(|(x, n)| (u32::from(*n), x, y)));
        }
        found
    }

    fn refine(&self, attitudes: &[List<ShapePoint>], x: usize, y: usize) -> Option<Match> {
        let reach = 3i32;
        let mut best: Option<Match> = None;
        for shape in attitudes {
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let (x, y) = (x as f64 + f64::from(dx), y as f64 + f64::from(dy));
                    let least = best.map_or(f64::NEG_INFINITY, |b| b.score);
                    if let Some(score) = self.score(shape, x, y, least) {
                        best = Some(Match { at: self.full(x, y), score });
                    }
                }
            }
        }
        best
    }

    /// Mean cosine of the shape anchored at reduced pixel (x, y), each point to the best of its 3 × 3 neighbours; `None`
    /// if it is not above `least`, which most places are told by before all points are.
    fn score(&self, shape: &[ShapePoint], x: f64, y: f64, least: f64) -> Option<f64> {
        let (mut sum, n) = (0.0, shape.len() as f64);
        for (k, p) in shape.iter().enumerate() {
            // no cosine is above 1; rounding apart
            if (k % 16 == 0) && sum + (shape.len() - k) as f64 * (1.0 + 1e-6) <= least * n {
                return None;
            }
            sum += self.best_cosine(&p.direction, Vector2::new(x, y) + p.offset / self.factor as f64);
        }
        Some(sum / n).filter(|score| *score > least)
    }

    /// The largest cosine, at least 0, of `direction` with those of the 3 × 3 pixels about `c`.
    fn best_cosine(&self, direction: &Vector2<f64>, c: Vector2<f64>) -> f64 {
        let (left, top) = (c.x.round() - 1.0, c.y.round() - 1.0);
        let range = |first: f64, n: usize| {
            let end = (first + 3.0).min(n as f64);
            if end > 0.0 { first.max(0.0) as usize..end as usize } else { 0..0 }
        };
        let (columns, rows) = (range(left, self.width), range(top, self.height));
        let mut best = 0f64;
        for row in rows.filter(|_| columns.start < columns.end) {
            for d in &self.direction[row * self.width..][columns.clone()] {
                best = best.max(d.map(f64::from).dot(direction));
            }
        }
        best
    }

    fn full(&self, x: f64, y: f64) -> Pixel {
        Pixel::new(x + 0.5, y + 0.5) * self.factor as f64 - Pixel::new(0.5, 0.5)
    }
}

/// The bit of a direction among eight of 45°; `generous` adds the nearest neighbour's.
fn bits(d: Vector2<f64>, generous: bool) -> u8 {
    let turn = d.y.atan2(d.x).rem_euclid(std::f64::consts::TAU) / std::f64::consts::FRAC_PI_4;
    let bin = turn.floor();
    let bit = |b: f64| 1u8 << (b.rem_euclid(8.0) as u32);
    let neighbour = if turn - bin < 0.5 { bin - 1.0 } else { bin + 1.0 };
    if generous { bit(bin) | bit(neighbour) } else { bit(bin) }
}

/// The mean of each `factor` × `factor` block; what does not fill a block is left out.
fn reduce(image: &Image<f32>, factor: usize) -> Lent<Image<f32>> {
    let (width, height) = (image.width / factor, image.height / factor);
    let mut out = Image::lent(width, height, 0.0);
    let scale = 1.0 / (factor * factor) as f32;
    for y in 0..height {
        let row = out.row_mut(y);
        for source in y * factor..(y + 1) * factor {
            for (out, block) in row.iter_mut().zip(image.row(source).chunks_exact(factor)) {
                *out += block.iter().sum::<f32>() * scale;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bright plate with an L-shaped dark gap cornered at (cx, cy), blurred by nothing but its own sampling.
    fn plate(cx: f64, cy: f64) -> Image<f32> {
        let mut image = Image::filled(400, 300, 120.0);
        for y in 0..300 {
            for x in 0..400 {
                let (u, v) = (x as f64 - cx, y as f64 - cy);
                let gap = (u.abs() < 2.5 && v < 2.5) || (v.abs() < 2.5 && u > -2.5);
                if gap {
                    image.pixels[y * 400 + x] = 10.0;
                }
            }
        }
        image
    }

    #[test]
    fn a_corner_is_found_again_where_it_moved_and_not_where_it_is_not() {
        let taught = GradientField::new(&plate(150.0, 180.0), 4, 8.0);
        let shape = taught.points(&Pixel::new(150.0, 180.0), 60.0);
        assert!(shape.len() > 40);
        let moved = GradientField::new(&plate(251.0, 133.0), 4, 8.0);
        let found = moved.search(&[List::of(shape.clone())], 3, 30.0);
        assert!(found[0].score > 0.9 && (found[0].at - Pixel::new(251.0, 133.0)).norm() < 4.0, "{found:?}");
        assert!(found.get(1).is_none_or(|second| second.score < 0.7), "{found:?}");
        let blank = GradientField::new(&Image::filled(400, 300, 120.0), 4, 8.0);
        assert!(blank.search(&[List::of(shape)], 3, 30.0).is_empty());
    }

    #[test]
    fn a_bright_line_is_not_taken_for_a_gap() {
        let mut inverted = plate(150.0, 180.0);
        inverted.pixels.iter_mut().for_each(|v| *v = 130.0 - *v);
        let shape = GradientField::new(&plate(150.0, 180.0), 4, 8.0).points(&Pixel::new(150.0, 180.0), 60.0);
        let found = GradientField::new(&inverted, 4, 8.0).search(&[List::of(shape)], 1, 30.0);
        assert!(found.first().is_none_or(|m| m.score < 0.75), "{found:?}");
    }
}

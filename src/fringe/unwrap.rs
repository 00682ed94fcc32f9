//! Absolute phase: which fringe each wrapped phase belongs to.
//! In: phase maps of one window, coarse to fine along one axis. Out: per pixel the projector coordinate that lights it.
//! Hierarchical temporal unwrapping; Zuo et al., "Temporal phase unwrapping algorithms for fringe projection
//! profilometry: a comparative review", Optics and Lasers in Engineering 85 (2016) 84.

use super::{Axis, Error, Limits, MAX_SETS, Phase, PhaseMap, Phases, State};
use crate::image::Window;
use crate::lent::List;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Pixels whose orders are found side by side: what they need fits into the nearest cache.
const BLOCK: usize = 256;

/// A wrong order goes unnoticed once the error passes 1 − `Limits::order_residual` fringes: so many sigmas away.
const ORDER_SIGMAS: f64 = 4.0;
/// Phases of two exposures differ by noise, about once in 10⁵ pixels by more than this many sigmas, and by what harmonics
/// (rms) do to steps of which some are saturated.
const CONTRADICTING_SIGMAS: f64 = 4.5;
const HARMONIC_SIGMAS: f64 = 3.0;

/// Neighbours so many rows and columns away help to tell which fringe it is.
const STEADY: isize = 2;

/// One pixel's projector coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coordinate {
    /// Projector column or row, px, integers are pixel centres, −0.5..extent − 0.5; if unordered, as if it were in the
    /// first fringe; else NaN unless valid.
    pub value: f64,
    /// Its variance, px²; NaN unless valid or unordered.
    pub variance: f32,
    /// Mean level of the finest set, DN.
    pub level: f32,
    /// Modulation of the finest set, DN.
    pub modulation: f32,
    /// A step of the finest set was saturated.
    pub saturated: bool,
    /// What the coordinate is worth.
    pub state: State,
}

/// Projector coordinates of one window, row by row.
#[derive(Clone, Debug)]
pub struct CoordinateMap {
    /// Column or row.
    pub axis: Axis,
    /// Length of one fringe of the finest set, projector px.
    pub pitch: f64,
    /// Where in the image.
    pub window: Window,
    /// `window.width * window.height` coordinates.
    pub pixels: List<Coordinate>,
    /// The projector's px along the axis.
    pub extent: usize,
}

/// Projector coordinates along `axis` from `maps`: the sets of one window in any order; those of the other axis are
/// left alone. `extent`: the projector's px along the axis. Of sets of equal count, a stack of exposures, each pixel takes
/// all unsaturated steps for what they are worth. A pixel whose sets disagree by `limits.order_residual`, or are too noisy to
/// agree, is invalid, unless noise explains it and its coarse phase agrees once its neighbours' are averaged into it.
/// Errors where no set has the axis, or none of them has count 1. Panics if the windows differ, or if there are more than
/// [`MAX_SETS`] sets.
pub fn unwrap(maps: &[PhaseMap], axis: Axis, extent: usize, limits: &Limits) -> Result<CoordinateMap, Error> {
    let mut sets: heapless::Vec<&PhaseMap, MAX_SETS> = maps.iter().filter(|m| m.set.axis == axis).collect();
    sets.sort_by_key(|m| m.set.count);
    let (Some(first), Some(last)) = (sets.first(), sets.last()) else { return Err(Error::NoSet { axis }) };
    if first.set.count != 1 {
        return Err(Error::Ambiguous { axis, lowest: first.set.count });
    }
    assert!(sets.iter().all(|m| m.window == first.window), "phase maps of different windows");
    let levels: heapless::Vec<&[&PhaseMap], MAX_SETS> = sets.chunk_by(|a, b| a.set.count == b.set.count).collect();
    let mut map =
        CoordinateMap { axis, pitch: last.set.pitch(extent), window: first.window, pixels: List::new(), extent };
    let mut pixels = List::stale(Coordinate::NONE, first.pixels.len());
    let (single, scale) = (levels.len() == sets.len(), map.pitch / TAU);
    pixels.par_chunks_mut(BLOCK).with_min_len(8).enumerate().for_each(|(block, out)| {
        let begin = block * BLOCK;
        let turns = if single { turns(&sets, begin, limits) } else { [f32::NAN; BLOCK] };
        let Phases { phase, variance, level, modulation, saturated, state } = &last.pixels;
        let [phase, variance, level, modulation] =
            [phase, variance, level, modulation].map(|list| &list[begin..][..out.len()]);
        let (saturated, state) = (&saturated[begin..][..out.len()], &state[begin..][..out.len()]);
        for (i, out) in out.iter_mut().enumerate() {
            out.set(f64::from(phase[i]) + TAU * f64::from(turns[i]), variance[i], scale);
            (out.level, out.modulation) = (level[i], modulation[i]);
            (out.saturated, out.state) = (saturated[i], state[i]);
        }
        let apart = |i: usize| turns[i].is_nan() && (state[i] == State::Valid || !single);
        for (i, out) in out.iter_mut().enumerate().filter(|(i, _)| apart(*i)) {
            *out = coordinate(&levels, begin + i, &map, limits);
        }
    });
    map.pixels = pixels;
    Ok(map)
}

/// The whole turns of the finest of `sets`, one per level, at the pixels from `begin` on; NaN unless all are valid there
/// and agree. As [`coordinate`] finds them, but without a branch, as vector units like it, and in single precision: of a
/// thousand fringes it leaves 1e-4 turns.
fn turns(sets: &[&PhaseMap], begin: usize, limits: &Limits) -> [f32; BLOCK] {
    let (most, noise) = (limits.order_residual as f32, most_variance(limits.order_residual) as f32);
    let per_turn = (1.0 / TAU) as f32;
    let mut all = [f32::NAN; BLOCK];
    let n = BLOCK.min(sets[0].pixels.len() - begin);
    let turns = &mut all[..n];
    for (turns, phase) in turns.iter_mut().zip(&sets[0].pixels.phase[begin..]) {
        *turns = if *phase < 0.0 { 1.0 } else { 0.0 * phase }; // NaN stays
    }
    for pair in sets.windows(2) {
        let (coarse, fine) = (&pair[0].pixels, &pair[1].pixels);
        let (coarse_phase, coarse_variance) = (&coarse.phase[begin..][..n], &coarse.variance[begin..][..n]);
        let (phase, variance) = (&fine.phase[begin..][..n], &fine.variance[begin..][..n]);
        let count = pair[1].set.count as f32;
        let ratio = count / pair[0].set.count as f32;
        for i in 0..n {
            let own = phase[i] * per_turn;
            let apart = (turns[i] + coarse_phase[i] * per_turn) * ratio - own;
            let whole = (apart + ROUNDS_SINGLE) - ROUNDS_SINGLE;
            let agrees = ((apart - whole).abs() < most) & (coarse_variance[i] * (ratio * ratio) + variance[i] < noise);
            let below = if whole + own < 0.0 { count } else { 0.0 };
            let beyond = if (whole - count) + own >= 0.0 { count } else { 0.0 };
            turns[i] = if agrees { whole + below - beyond } else { f32::NAN };
        }
    }
    all
}

fn coordinate(levels: &[&[&PhaseMap]], i: usize, map: &CoordinateMap, limits: &Limits) -> Coordinate {
    let finest = best(levels[levels.len() - 1], i, limits);
    let Phase { level, modulation, saturated, state, .. } = finest;
    let mut out = Coordinate { level, modulation, saturated, state, ..Coordinate::NONE };
    if finest.state != State::Valid {
        return out;
    }
    let mut phase = 0.0; // absolute, of a set of count 0: it knows nothing, and every phase agrees with it
    let mut variance = 0.0;
    let mut count = 0.0;
    for (k, level) in levels.iter().enumerate() {
        let p = best(level, i, limits);
        if p.state != State::Valid {
            if p.state == State::Saturated {
                out.set(f64::from(finest.phase), finest.variance, map.pitch / TAU);
                out.state = State::Unordered;
            } else {
                out.state = p.state;
            }
            return out;
        }
        let (wrapped, own) = (f64::from(p.phase), f64::from(p.variance));
        let finer = f64::from(level[0].set.count);
        if count == 0.0 {
            phase = within_turns(wrapped, TAU);
        } else {
            let ratio = finer / count;
            let order = |coarse: f64, variance: f64| {
                in_order(wrapped, coarse * ratio, variance * ratio * ratio + own, limits.order_residual)
            };
            let by_neighbours = || {
                let off = (phase * ratio - wrapped) / TAU;
                let noise = ORDER_SIGMAS * (variance * ratio * ratio + own).sqrt() / TAU;
                let (steadier, variance) =
                    steadied(levels[k - 1], i, map.window, limits).filter(|_| (off - off.round()).abs() < noise)?;
                order(phase + steadier, variance)
            };
            let Some(ordered) = order(phase, variance).or_else(by_neighbours) else {
                out.state = State::WrongOrder;
                return out;
            };
            phase = within_turns(ordered, TAU * finer); // past the last fringe the cosine starts again
        }
        (variance, count) = (own, finer);
    }
    out.set(phase, variance as f32, map.pitch / TAU);
    out
}

/// What the neighbours of pixel `i` add to its phase in the sets of one count, rad, so that it becomes their mean, and the
/// variance of that: where there is more of other light than of the projector's, one pixel alone cannot tell the next set's
/// fringes apart. A body hardly bends within so few pixels, and neighbours count in pairs across the pixel, so that a slope
/// leaves the mean alone. `None` without any pair.
fn steadied(sets: &[&PhaseMap], i: usize, window: Window, limits: &Limits) -> Option<(f64, f64)> {
    let at = best(sets, i, limits);
    let (x, y) = (i % window.width, i / window.width);
    let neighbour = |dx: isize, dy: isize| {
        let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
        let inside = x < window.width && y < window.height;
        let phase = best(sets, if inside { y * window.width + x } else { return None }, limits);
        let turn = f64::from(phase.phase - at.phase);
        (phase.state == State::Valid).then(|| (turn - TAU * (turn / TAU).round(), f64::from(phase.variance)))
    };
    let (mut n, mut sum, mut variance) = (1.0, 0.0, f64::from(at.variance));
    let half = (0..=STEADY).flat_map(|dy| (-STEADY..=STEADY).map(move |dx| (dx, dy))).filter(|d| d.1 > 0 || d.0 > 0);
    for (a, b) in half.filter_map(|(dx, dy)| Some((neighbour(dx, dy)?, neighbour(-dx, -dy)?))) {
        (n, sum, variance) = (n + 2.0, sum + a.0 + b.0, variance + a.1 + b.1);
    }
    (n > 1.0).then(|| (sum / n, variance / (n * n)))
}

/// The phase of `sets`, all of one count: the mean of the valid ones weighted by their variances, so that of a stack of
/// exposures each pixel takes every step that was not saturated for what it is worth; if none is valid a saturated one.
/// Valid ones that contradict each other are no sine: light changed or the object moved from one set to the other.
fn best(sets: &[&PhaseMap], i: usize, limits: &Limits) -> Phase {
    if let [one] = sets {
        return one.pixels.at(i);
    }
    let rank = |p: &Phase| match p.state {
        State::Valid => p.variance,
        State::Saturated => f32::MAX,
        _ => f32::INFINITY,
    };
    let phases = || sets.iter().map(|m| m.pixels.at(i));
    let mut out = phases().min_by(|a, b| rank(a).total_cmp(&rank(b))).expect("a level has a set");
    if out.state != State::Valid {
        return out;
    }
    let (mut weight, mut off) = (0.0, 0.0);
    for p in phases().filter(|p| p.state == State::Valid) {
        let (own, turn) = (f64::from(p.variance), f64::from(p.phase - out.phase));
        let apart = turn - TAU * (turn / TAU).round();
        let sigma = (own + f64::from(out.variance)).sqrt();
        if apart.abs() > CONTRADICTING_SIGMAS * sigma + HARMONIC_SIGMAS * limits.harmonics {
            return Phase { phase: f32::NAN, variance: f32::NAN, state: State::NotSine, ..out };
        }
        (weight, off) = (weight + 1.0 / own, off + apart / own);
    }
    let turn = f64::from(out.phase) + off / weight;
    out.phase = (turn - TAU * (turn / TAU).round()) as f32;
    out.variance = (1.0 / weight) as f32;
    out
}

/// `wrapped` plus the whole turns that bring it nearest `expected` (rad); `None` unless they agree to `most` turns, and
/// `variance` (rad², of their difference) lets them.
fn in_order(wrapped: f64, expected: f64, variance: f64, most: f64) -> Option<f64> {
    let turns = (expected - wrapped) / TAU;
    let whole = (turns + ROUNDS) - ROUNDS; // a call of `round` per pixel is what some processors have instead
    (variance < most_variance(most) && (turns - whole).abs() < most).then_some(wrapped + TAU * whole)
}

/// So much variance (rad²) that a wrong order could be taken for one `most` turns off.
fn most_variance(most: f64) -> f64 {
    ((1.0 - most) * TAU / ORDER_SIGMAS).powi(2)
}

/// A number so large that whole ones are all that lies beside it: added and taken off again it rounds.
const ROUNDS: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²
const ROUNDS_SINGLE: f32 = 12_582_912.0; // 1.5 · 2²³

/// `phase`, at most one `period` off, brought to 0..period.
fn within_turns(phase: f64, period: f64) -> f64 {
    if phase < 0.0 {
        phase + period
    } else if phase >= period {
        phase - period
    } else {
        phase
    }
}

impl Coordinate {
    /// Of a pixel that nothing is known of.
    const NONE: Self = Self {
        value: f64::NAN,
        variance: f32::NAN,
        level: f32::NAN,
        modulation: f32::NAN,
        saturated: false,
        state: State::Weak,
    };

    /// As `phase`, absolute, and `variance` state it; `scale`: px per rad.
    fn set(&mut self, phase: f64, variance: f32, scale: f64) {
        self.value = phase * scale - 0.5;
        self.variance = variance * (scale * scale) as f32;
        self.state = State::Valid;
    }
}

impl CoordinateMap {
    /// Orders the fringes of pixels whose coarse sets were saturated, and only those, by what `expected` says of the
    /// projector coordinate (px) at image pixel (x, y), from a coarse surface of the body. Elsewhere the coarse sets
    /// have spoken: what they refused would alias onto that surface. Where `expected` is `None`, off the projector's
    /// image or `limits.order_residual` from the phase, the pixel stays invalid. Gives back how many became valid.
    pub fn predict(&mut self, limits: &Limits, expected: impl Fn(usize, usize) -> Option<f64> + Sync) -> usize {
        let (window, pitch, extent, most) = (self.window, self.pitch, self.extent, limits.order_residual);
        let order = |(i, pixel): (usize, &mut Coordinate)| {
            if pixel.state != State::Unordered {
                return 0;
            }
            let (x, y) = (window.x + i % window.width, window.y + i / window.width);
            let inside = |c: &f64| (-0.5..extent as f64 - 0.5).contains(c);
            let Some(expected) = expected(x, y).filter(inside) else { return 0 };
            let to_phase = |c: f64| (c + 0.5) / pitch * TAU;
            let variance = f64::from(pixel.variance) * (TAU / pitch).powi(2);
            let phase = in_order(to_phase(pixel.value), to_phase(expected), variance, most);
            let Some(value) = phase.map(|p| p / TAU * pitch - 0.5).filter(inside) else { return 0 };
            (pixel.value, pixel.state) = (value, State::Valid);
            1
        };
        self.pixels.par_iter_mut().enumerate().with_min_len(1024).map(order).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fringe::PatternSet;

    const EXTENT: usize = 1280;
    const LIMITS: Limits = Limits::DEFAULT;

    /// Phase maps in which pixel i is lit by `at(i)`.
    fn maps(counts: &[u32], at: impl Fn(usize) -> f64) -> Vec<PhaseMap> {
        let window = Window { x: 3, y: 5, width: EXTENT, height: 1 };
        let map = |&count: &u32| {
            let set = PatternSet::new(Axis::Column, count, 4).expect("legal");
            let phase = |i| {
                let turns = (at(i) + 0.5) / set.pitch(EXTENT);
                let phase = (TAU * (turns - turns.round())) as f32;
                Phase { phase, variance: 1e-4, level: 80.0, modulation: 60.0, saturated: false, state: State::Valid }
            };
            PhaseMap { set, window, pixels: (0..EXTENT).map(phase).collect() }
        };
        counts.iter().map(map).collect()
    }

    fn spoil(map: &mut PhaseMap, i: usize, state: State) {
        let saturated = state == State::Saturated;
        map.pixels.change(i, |p| *p = Phase { phase: f32::NAN, variance: f32::NAN, saturated, state, ..*p });
    }

    #[test]
    fn a_phase_is_brought_to_the_nearest_of_its_turns() {
        for k in -4000..4000 {
            let (wrapped, expected) = (0.001 * f64::from(k % 3141), 0.0937 * f64::from(k));
            let got = in_order(wrapped, expected, 1e-6, 0.5).expect("any");
            assert_eq!(got, wrapped + TAU * ((expected - wrapped) / TAU).round(), "{wrapped} {expected}");
            let (phase, period) = (0.003 * f64::from(k), 12.5);
            assert!((within_turns(phase, period) - phase.rem_euclid(period)).abs() < 1e-12, "{phase}");
        }
    }

    /// Of coarse phases so noisy that every fourth pixel's are a quarter fringe of the next set off, or more.
    #[test]
    fn a_pixel_too_noisy_to_tell_its_fringe_is_told_by_its_neighbours() {
        let at = |i: usize| 20.0 + 1.7 * (i % 40) as f64 + 0.3 * (i / 40) as f64;
        let window = Window::whole(40, 32);
        let mut noise = crate::testing::Noise::new(8);
        let mut noisy = maps(&[1, 8, 64], at);
        for map in &mut noisy {
            for i in 0..map.pixels.len() {
                let off = 0.15 * noise.gauss() as f32;
                map.pixels.change(i, |p| (p.phase, p.variance) = (p.phase + off, 0.15 * 0.15));
            }
        }
        noisy.iter_mut().for_each(|map| map.window = window);
        let right = |c: &(usize, &Coordinate)| c.1.state == State::Valid && (c.1.value - at(c.0)).abs() < 3.0;
        let told = |maps: &[PhaseMap]| {
            let map = unwrap(maps, Axis::Column, EXTENT, &LIMITS).expect("count 1 is there");
            let valid = map.pixels.iter().filter(|c| c.state == State::Valid).count();
            (map.pixels.iter().enumerate().filter(right).count(), valid)
        };
        let (right, valid) = told(&noisy);
        assert!(right > 1250 && valid - right < 5, "{right} right of {valid}, of 1280");
        // the same phases, said to be sure: then it is no noise, and they are refused
        for map in &mut noisy {
            (0..map.pixels.len()).for_each(|i| map.pixels.change(i, |p| p.variance = 1e-4));
        }
        let (right, valid) = told(&noisy);
        assert!(valid < 1000, "{right} right of {valid}, of 1280");
    }

    #[test]
    fn ratios_of_eight_unwrap_exactly_in_any_order_of_the_sets() {
        let at = |i: usize| i as f64 + 0.31;
        let map = unwrap(&maps(&[64, 1, 8], at), Axis::Column, EXTENT, &LIMITS).expect("count 1 is there");
        for (i, c) in map.pixels.iter().enumerate().take(EXTENT - 1) {
            assert!((c.value - at(i)).abs() < 1e-5, "{i}: {c:?}"); // f32 phases of 20 px fringes
            let law = 1e-4 * (20.0 / TAU).powi(2);
            assert!((f64::from(c.variance) / law - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn orders_found_side_by_side_are_those_found_one_by_one() {
        let mut random = crate::testing::Noise::new(4);
        let mut maps = maps(&[1, 8, 64], |i| i as f64 - 0.45);
        for (map, sigma) in maps.iter_mut().zip([0.03, 0.05, 0.05]) {
            let mut noise = || (sigma * random.gauss()) as f32;
            let turn = std::f32::consts::TAU;
            let moved = |p: f32| p - turn * (p / turn).round();
            (0..EXTENT).for_each(|i| map.pixels.change(i, |p| p.phase = moved(p.phase + noise())));
            // every 60th is invalid, by many pixels of other states or too noisy
            let states = [State::Weak, State::Saturated, State::NotSine];
            (0..EXTENT).step_by(60).zip(states.into_iter().cycle()).for_each(|(i, state)| spoil(map, i, state));
            (30..EXTENT).step_by(60).for_each(|i| map.pixels.change(i, |p| p.variance = 0.03));
        }
        let map = unwrap(&maps, Axis::Column, EXTENT, &LIMITS).expect("count 1 is there");
        let sets: Vec<&PhaseMap> = maps.iter().collect();
        let levels: Vec<&[&PhaseMap]> = sets.chunks(1).collect();
        let mut valid = 0;
        for (i, got) in map.pixels.iter().enumerate() {
            let alone = coordinate(&levels, i, &map, &LIMITS);
            assert_eq!((got.state, got.variance.to_bits()), (alone.state, alone.variance.to_bits()), "{i}");
            assert!(
                (got.value - alone.value).abs() < 1e-12 * EXTENT as f64 || alone.value.is_nan(),
                "{got:?} {alone:?}"
            );
            valid += usize::from(got.state == State::Valid);
        }
        assert!((900..1260).contains(&valid), "{valid}");
    }

    #[test]
    fn a_phase_noisy_about_the_first_column_stays_there() {
        let mut maps = maps(&[1, 8], |i| i as f64 - 0.4);
        maps[0].pixels.change(0, |p| p.phase = -0.002); // just before the start: the cosine's last fringe
        let c = unwrap(&maps, Axis::Column, EXTENT, &LIMITS).expect("count 1 is there").pixels[0];
        assert!((c.value + 0.4).abs() < 1e-3, "{c:?}");
    }

    #[test]
    fn a_planted_jump_of_over_a_quarter_fringe_is_invalid_and_a_smaller_one_changes_nothing() {
        let at = |i: usize| i as f64;
        for (jump, valid) in [(0.20, true), (-0.20, true), (0.30, false), (-0.45, false)] {
            let mut maps = maps(&[1, 8, 64], at);
            maps[1].pixels.change(600, |p| p.phase += (jump * TAU / 8.0) as f32); // in fringes of the finest set
            let map = unwrap(&maps, Axis::Column, EXTENT, &LIMITS).expect("count 1 is there");
            let c = map.pixels[600];
            assert_eq!(c.state == State::Valid, valid, "{jump}: {c:?}");
            assert!(if valid { (c.value - 600.0).abs() < 1e-5 } else { c.value.is_nan() });
            assert!((map.pixels[601].value - 601.0).abs() < 1e-5);
        }
    }

    #[test]
    fn sets_too_noisy_to_tell_the_order_are_invalid_unless_neighbours_help() {
        let mut maps = maps(&[1, 8], |i| i as f64);
        maps[0].pixels.change(600, |p| p.variance = 0.03); // 0.17 rad times 8: 3.4 sigma to a wrong order
        maps[0].pixels.change(601, |p| p.variance = 0.02);
        maps[0].pixels.change(900, |p| p.variance = 0.03);
        // of each pair across pixel 600 one
        spoil(&mut maps[0], 598, State::Weak);
        spoil(&mut maps[0], 599, State::Weak);
        let map = unwrap(&maps, Axis::Column, EXTENT, &LIMITS).expect("count 1 is there");
        assert_eq!(map.pixels[600].state, State::WrongOrder);
        assert_eq!(map.pixels[601].state, State::Valid);
        assert!(map.pixels[900].state == State::Valid && (map.pixels[900].value - 900.0).abs() < 1e-4);
    }

    #[test]
    fn of_equal_counts_each_phase_counts_for_what_it_is_worth_and_an_invalid_one_never() {
        let mut stack = maps(&[1, 8, 8], |i| i as f64);
        let shift = |p: &mut Phase, by: f32| (p.phase, p.variance) = (p.phase + by, 4e-4);
        stack[1].pixels.change(600, |p| shift(p, 0.1));
        spoil(&mut stack[2], 700, State::Saturated);
        stack[1].pixels.change(800, |p| shift(p, 0.3));
        let map = unwrap(&stack, Axis::Column, EXTENT, &LIMITS).expect("count 1 is there");
        let px = |rad: f64| rad * 160.0 / TAU;
        let c = map.pixels[600];
        assert!((c.value - 600.0 - px(0.1 * 1.0 / 5.0)).abs() < 1e-3, "{c:?}");
        assert!((f64::from(c.variance) / (0.8e-4 * px(1.0).powi(2)) - 1.0).abs() < 1e-3, "{c:?}");
        assert!((map.pixels[700].value - 700.0).abs() < 1e-4, "{:?}", map.pixels[700]);
        assert_eq!(map.pixels[800].state, State::NotSine, "two exposures that differ by 13 sigmas");
    }

    #[test]
    fn phases_of_a_stack_on_both_sides_of_the_turn_meet_there() {
        let mut stack = maps(&[1, 8, 8], |i| i as f64);
        let at = 80; // half a fringe: the phase is π
        for (map, phase) in stack[1..].iter_mut().zip([3.12, -3.12]) {
            map.pixels.change(at, |p| p.phase = phase);
        }
        let c = unwrap(&stack, Axis::Column, EXTENT, &LIMITS).expect("count 1 is there").pixels[at];
        assert!((c.value + 0.5 - 80.0).abs() < 1e-3, "{c:?}");
    }

    #[test]
    fn without_count_one_an_axis_is_ambiguous_and_disturbs_no_other() {
        let mut all = maps(&[1, 8], |i| i as f64);
        let mut rows = maps(&[40], |i| i as f64);
        rows[0].set.axis = Axis::Row;
        all.append(&mut rows);
        assert!(unwrap(&all, Axis::Column, EXTENT, &LIMITS).is_ok());
        let error = unwrap(&all, Axis::Row, 800, &LIMITS).expect_err("40 fringes");
        assert_eq!(
            error.to_string(),
            "absolute phase along Row is ambiguous: the coarsest set has 40 fringes, 1 is needed"
        );
        assert_eq!(unwrap(&all[..2], Axis::Row, 800, &LIMITS).map(|_| ()), Err(Error::NoSet { axis: Axis::Row }));
    }

    #[test]
    fn a_prediction_orders_fringes_where_coarse_sets_are_saturated_and_nowhere_else() {
        let mut maps = maps(&[1, 8, 64], |i| i as f64);
        spoil(&mut maps[0], 100, State::Saturated);
        spoil(&mut maps[1], 200, State::Saturated);
        spoil(&mut maps[1], 300, State::Weak);
        maps[1].pixels.change(400, |p| p.phase += 0.3);
        spoil(&mut maps[2], 500, State::Saturated);
        spoil(&mut maps[1], 600, State::Saturated);
        let mut map = unwrap(&maps, Axis::Column, EXTENT, &LIMITS).expect("count 1 is there");
        let invalid = [100, 200, 300, 400, 500, 600];
        let states = invalid.map(|i| map.pixels[i].state);
        let unordered = [State::Unordered, State::Unordered, State::Weak, State::WrongOrder, State::Saturated];
        assert_eq!(states, [unordered.as_slice(), &[State::Unordered]].concat()[..]);
        // A surface 4 px off everywhere (a fringe is 20), 8 px at pixel 600; image pixels start at x = 3.
        let became = map.predict(&LIMITS, |x, y| (y == 5).then_some(x as f64 - 3.0 + if x == 603 { 8.0 } else { 4.0 }));
        assert_eq!(became, 2);
        assert!((map.pixels[100].value - 100.0).abs() < 1e-5 && (map.pixels[200].value - 200.0).abs() < 1e-5);
        assert!(invalid[2..].iter().all(|&i| map.pixels[i].state != State::Valid));
    }
}

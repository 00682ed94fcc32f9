//! Whether anything moved between the first fringe image and the same one at the end. In: both images, where to look,
//! their noise. Out: by how much, with its uncertainty. Not here: what follows from it.
//!
//! Noise alone does not tell: dark paint glitters by more than the sensor's law. A motion of the body shifts the image
//! along its own gradient, all over the window: that is fitted, beside a change of brightness.
//! Horn, Schunck, "Determining optical flow", Artificial Intelligence 17 (1981) 185: the constraint; here of one motion.

use crate::fringe::NoiseLaw;
use crate::image::{Image, Window};
use nalgebra::{Matrix4, Vector4};

/// What one image says against another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    /// Length of the shift, px.
    pub(super) px: f64,
    /// The same over its standard deviation.
    pub(super) sigmas: f64,
    /// What is left, over the noise law: mean square. Far beyond 1 something else has changed.
    pub(super) rest: f64,
}

impl Motion {
    /// From `first` to `repeat` inside `window`, where neither is saturated; `None` where there is nothing to see.
    pub(super) fn between(
        first: &Image<u16>,
        repeat: &Image<u16>,
        window: Window,
        white: f64,
        noise: &NoiseLaw,
    ) -> Option<Self> {
        let (mut normal, mut right, mut squares, mut n) = (Matrix4::<f64>::zeros(), Vector4::zeros(), 0.0, 0.0);
        let sum = |x: usize, y: usize| f64::from(first.at(x, y)) + f64::from(repeat.at(x, y));
        let (right_edge, bottom) = (window.x + window.width, window.y + window.height);
        for y in window.y.max(1)..bottom.min(first.height - 1) {
            for x in window.x.max(1)..right_edge.min(first.width - 1) {
                let (a, b) = (f64::from(first.at(x, y)), f64::from(repeat.at(x, y)));
                if a >= white || b >= white {
                    continue;
                }
                // the mean image's gradient at the neighbours: its noise is not that of the difference here
                let (gx, gy) = (sum(x + 1, y) - sum(x - 1, y), sum(x, y + 1) - sum(x, y - 1));
                let weight = 1.0 / (2.0 * noise.variance(0.5 * (a + b)));
                let row = Vector4::new(-0.25 * gx, -0.25 * gy, 0.5 * (a + b), 1.0);
                normal.syger(weight, &row, &row, 1.0);
                right += row * (weight * (b - a));
                squares += weight * (b - a).powi(2);
                n += 1.0;
            }
        }
        normal.fill_upper_triangle_with_lower_triangle();
        let factor = normal.cholesky()?;
        let found = factor.solve(&right);
        let rest = (squares - found.dot(&right)) / n;
        let shift = found.xy();
        let spread = factor.inverse().fixed_view::<2, 2>(0, 0).into_owned() * rest.max(1.0);
        let sigmas = shift.dot(&(spread.try_inverse()? * shift)).sqrt();
        Some(Self { px: shift.norm(), sigmas, rest })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;

    /// A body with a few gaps and fringes on it, moved by `shift` px, in light `bright`, noisier than the law by `glitter`.
    fn image(shift: f64, bright: f64, glitter: f64, noise: &mut Noise) -> Image<u16> {
        let mut out = Image::filled(200, 120, 0u16);
        for y in 0..120 {
            for x in 0..200 {
                let at = x as f64 - shift;
                let gap = 1.0 - 0.9 * (-(at - 60.0).powi(2) / 4.0).exp() - 0.9 * (-(at - 140.0).powi(2) / 4.0).exp();
                let level = 2.0 + bright * gap * (60.0 + 30.0 * (at / 60.0).sin());
                out.row_mut(y)[x] = (level + glitter * (0.04 * level + 0.04).sqrt() * noise.gauss()).round() as u16;
            }
        }
        out
    }

    #[test]
    fn a_hundredth_of_a_pixel_is_seen_and_neither_glitter_nor_light_is_taken_for_it() {
        let mut noise = Noise::new(3);
        let law = NoiseLaw::from_sensor(0.04, 1.0, 2.0);
        let window = Window::whole(200, 120);
        let mut between = |shift: f64, bright: f64, glitter: f64| {
            let first = image(0.0, 1.0, glitter, &mut noise);
            Motion::between(&first, &image(shift, bright, glitter, &mut noise), window, 255.0, &law).expect("seen")
        };
        let still = between(0.0, 1.0, 1.0);
        assert!(still.sigmas < 4.0 && (0.8..1.3).contains(&still.rest), "{still:?}");
        let glitters = between(0.0, 1.03, 1.7);
        assert!(glitters.sigmas < 4.0 && (2.0..4.0).contains(&glitters.rest), "{glitters:?}");
        let moved = between(0.1, 0.98, 1.7);
        assert!((moved.px - 0.1).abs() < 0.03 && moved.sigmas > 5.0, "{moved:?}");
    }
}

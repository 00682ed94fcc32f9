//! One lens: pinhole + Brown–Conrady.
//! Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971); coefficient order as OpenCV's.

use nalgebra::{Matrix2, Vector2, Vector3};

/// A position in an image, px: integers are pixel centres, x right, y down.
pub type Pixel = Vector2<f64>;

/// Intrinsics and distortion of a camera or projector.
#[derive(Clone, Debug, PartialEq)]
pub struct Lens {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Principal point, px.
    pub cx: f64,
    /// Principal point, px.
    pub cy: f64,
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
}

impl Lens {
    /// Without distortion, of an image of so many pixels: where nothing is known of a lens.
    pub fn pinhole(width: usize, height: usize) -> Self {
        let [cx, cy] = [width, height].map(|n| 0.5 * (n as f64 - 1.0));
        let f = width as f64;
        Self { width, height, fx: f, fy: f, cx, cy, distortion: [0.0; 5] }
    }

    /// The raw pixel where a point of the lens's frame (mm) appears; `None` at or behind the lens.
    pub fn project(&self, p: &Vector3<f64>) -> Option<Pixel> {
        (p.z > 0.0).then(|| self.pixel_of(&self.distort(&Vector2::new(p.x / p.z, p.y / p.z)).0))
    }

    /// Distorted normalised coordinates, and the Jacobian of the distortion, at normalised `n` = (x/z, y/z).
    pub fn distort(&self, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)); // d radial / d r² · 2: times x gives ∂/∂x
        let d = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let cross = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let j = Matrix2::new(
            radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (d, j)
    }

    /// The undistorted normalised coordinates seen at raw `pixel`, by Newton's method to 1e-12 (1e-9 px and
    /// better). `None` where the distortion model folds over and has no inverse near the pixel.
    pub fn undistort(&self, pixel: &Pixel) -> Option<Vector2<f64>> {
        self.undistort_near(pixel, &self.normalised(pixel))
    }

    /// As [`Self::undistort`], from a start near the answer (a neighbour's): fewer steps, the same result.
    pub fn undistort_near(&self, pixel: &Pixel, start: &Vector2<f64>) -> Option<Vector2<f64>> {
        let target = self.normalised(pixel);
        let mut n = *start;
        for _ in 0..50 {
            let (d, j) = self.distort(&n);
            if j.determinant() <= 0.0 {
                return None;
            }
            let step = j.try_inverse()? * (target - d);
            n += step;
            // what is left after a step of Newton's is some tenths of its square
            if step.amax() < 1e-7 {
                return Some(n);
            }
        }
        None
    }

    /// The ray seen at raw `pixel`: direction with z = 1, from the optical centre.
    pub fn ray(&self, pixel: &Pixel) -> Option<Vector3<f64>> {
        self.undistort(pixel).map(|n| Vector3::new(n.x, n.y, 1.0))
    }

    /// The same lens on a sensor whose pixels are larger by `factor` (binning): pixel centres at integers stay so.
    pub fn binned(&self, factor: f64) -> Self {
        Self {
            width: (self.width as f64 / factor).round() as usize,
            height: (self.height as f64 / factor).round() as usize,
            fx: self.fx / factor,
            fy: self.fy / factor,
            cx: (self.cx + 0.5) / factor - 0.5,
            cy: (self.cy + 0.5) / factor - 0.5,
            distortion: self.distortion,
        }
    }

    /// The same lens on an image of which only every `every`-th column and row is looked at, from the first on.
    pub fn thinned(&self, every: usize) -> Self {
        let n = every as f64;
        Self {
            width: self.width.div_ceil(every),
            height: self.height.div_ceil(every),
            fx: self.fx / n,
            fy: self.fy / n,
            cx: self.cx / n,
            cy: self.cy / n,
            distortion: self.distortion,
        }
    }

    pub(crate) fn normalised(&self, pixel: &Pixel) -> Vector2<f64> {
        Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy)
    }

    fn pixel_of(&self, d: &Vector2<f64>) -> Pixel {
        Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Lens {
        Lens {
            width: 1296,
            height: 972,
            fx: 1351.8,
            fy: 1351.05,
            cx: 651.45,
            cy: 481.1,
            distortion: [-0.0853, 0.1042, 0.00043, -0.00031, -0.0215],
        }
    }

    #[test]
    fn undistortion_undoes_projection_everywhere_in_the_image() {
        let l = lens();
        for y in (0..=9).map(|i| f64::from(i) * 108.0 - 0.5) {
            for x in (0..=9).map(|i| f64::from(i) * 144.0 - 0.5) {
                let ray = l.ray(&Pixel::new(x, y)).expect("inside the image");
                let back = l.project(&(ray * 700.0)).expect("in front");
                assert!((back - Pixel::new(x, y)).amax() < 1e-9, "{x} {y} {back}");
            }
        }
    }

    #[test]
    fn the_jacobian_of_the_distortion_is_its_derivative() {
        let l = Lens { distortion: [-0.3, 0.2, 0.01, -0.02, 0.05], ..lens() };
        let (n, h) = (Vector2::new(0.31, -0.22), 1e-6);
        let j = l.distort(&n).1;
        for k in 0..2 {
            let mut step = Vector2::zeros();
            step[k] = h;
            let slope = (l.distort(&(n + step)).0 - l.distort(&(n - step)).0) / (2.0 * h);
            assert!((slope - j.column(k)).amax() < 1e-9);
        }
    }

    #[test]
    fn a_thinned_image_has_the_rays_of_the_pixels_that_are_left() {
        let (whole, third) = (lens(), lens().thinned(3));
        assert_eq!((third.width, third.height), (432, 324));
        for (x, y) in [(0.0, 0.0), (200.0, 101.0), (431.0, 323.0)] {
            let rays = (third.ray(&Pixel::new(x, y)), whole.ray(&Pixel::new(3.0 * x, 3.0 * y)));
            assert!((rays.0.expect("inside") - rays.1.expect("inside")).amax() < 1e-12);
        }
    }

    #[test]
    fn a_folded_distortion_has_no_inverse() {
        let l = Lens { distortion: [-3.0, 0.0, 0.0, 0.0, 0.0], ..lens() };
        assert_eq!(l.undistort(&Pixel::new(1295.0, 971.0)), None);
    }
}

//! Edges of dark gaps and what is fitted to them. In: a grey image and its noise; later, points of a contour in
//! any plane. Out: sub-pixel edges, chains of them, ellipses, alignments and arch tops, each with its covariance.
//! Not here: lenses, depth, the third dimension: callers carry points from the image into a metric plane.

mod arch;
mod buckets;
mod edges;
mod ellipse;
mod link;
mod outline;
mod search;

pub use arch::{ArchTop, NoArchTop, arch_top};
pub(crate) use buckets::Buckets;
pub(crate) use edges::step;
pub use edges::{EdgeFilter, Edgel, cross_level, find_edges};
pub use ellipse::{Ellipse, EllipseFit, EllipseLimits, NoEllipse, fit_ellipse};
pub use link::{Chain, join, link};
pub use outline::{Alignment, AlignmentOptions, ContourPoint, Motion, NoAlignment, TemplatePoint, align};
pub use search::{GradientField, Match, ShapePoint};

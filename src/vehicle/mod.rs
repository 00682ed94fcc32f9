//! Vehicle models. In: their file and templates. Out: the checked model and its fingerprint.
//! Not here: how templates are made; measuring.

mod model;
mod region;
mod template;

pub(crate) use model::PerFeature;
pub use model::{
    Body, Class, Definition, Edge, Feature, Kind, Limits, MAX_FEATURES, Release, Target, VehicleFile, fingerprint,
};
pub use region::region_outline;
pub use template::{Anchor, ContourPoint, PanelMask, TaughtSurface, Template, TemplateError};

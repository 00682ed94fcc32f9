//! What an experiment found: plain data that any report is made of.
//! Not here: how it looks.

use crate::Image;
use crate::measure::{Drawing, Measurement};
use serde::{Serialize, Serializer};

/// What an experiment found.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcome {
    /// What was simulated or looked at, in a sentence or two.
    pub setting: String,
    /// The figures that count.
    pub figures: Vec<Figure>,
    /// What they come from.
    pub tables: Vec<Table>,
    /// What is worth saying beside: what was refused, where a figure misses its target and why.
    pub remarks: Vec<String>,
    /// Curves.
    pub plots: Vec<Plot>,
    /// Pictures.
    #[serde(skip)]
    pub pictures: Vec<Seen>,
}

impl Outcome {
    /// Whether every figure that has a target reaches it.
    pub fn passed(&self) -> bool {
        self.figures.iter().all(|f| f.passed() != Some(false))
    }
}

/// One figure beside the published one and its target.
#[derive(Clone, Debug)]
pub struct Figure {
    /// What it is.
    pub name: String,
    /// Ours; none: it could not be had, and misses any target.
    pub value: Option<f64>,
    /// Its unit.
    pub unit: &'static str,
    /// How many digits after the point are worth printing.
    pub digits: usize,
    /// What was published.
    pub published: Option<String>,
    /// What it must be.
    pub must: Option<Must>,
}

impl Figure {
    /// A figure with nothing beside it.
    pub fn new(name: impl Into<String>, value: impl Into<Option<f64>>, unit: &'static str, digits: usize) -> Self {
        Self { name: name.into(), value: value.into(), unit, digits, published: None, must: None }
    }

    /// With the published one.
    pub fn published(self, text: impl Into<String>) -> Self {
        Self { published: Some(text.into()), ..self }
    }

    /// With its target.
    pub fn must(self, must: Must) -> Self {
        Self { must: Some(must), ..self }
    }

    /// Whether it reaches its target; none: it has none.
    pub fn passed(&self) -> Option<bool> {
        let must = self.must?;
        Some(self.value.is_some_and(|v| match must {
            Must::AtMost(most) => v <= most,
            Must::AtLeast(least) => v >= least,
            Must::Within(low, high) => (low..=high).contains(&v),
        }))
    }
}

impl Serialize for Figure {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let must = self.must.map(|m| m.to_string());
        let finite = self.value.filter(|v| v.is_finite());
        serde_json::json!({
            "name": self.name, "value": finite, "unit": self.unit, "published": self.published, "must": must,
            "pass": self.passed(),
        })
        .serialize(s)
    }
}

/// A target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Must {
    /// No more than this.
    AtMost(f64),
    /// No less than this.
    AtLeast(f64),
    /// From one to the other.
    Within(f64, f64),
}

impl std::fmt::Display for Must {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::AtMost(v) => write!(f, "≤ {v}"),
            Self::AtLeast(v) => write!(f, "≥ {v}"),
            Self::Within(a, b) => write!(f, "{a} to {b}"),
        }
    }
}

/// A table.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// What it shows.
    pub title: String,
    /// Its columns, with their units.
    pub columns: Vec<String>,
    /// Its rows, as long as there are columns.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// Without rows yet.
    pub fn new(title: impl Into<String>, columns: &[&str]) -> Self {
        Self { title: title.into(), columns: columns.iter().map(|c| (*c).into()).collect(), rows: Vec::new() }
    }

    /// One row more.
    pub fn row(&mut self, cells: Vec<Cell>) {
        debug_assert_eq!(cells.len(), self.columns.len(), "{}", self.title);
        self.rows.push(cells);
    }
}

/// A table's cell.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A number and how many digits after the point are worth printing; none: not known.
    Number(Option<f64>, usize),
}

impl Cell {
    /// Words.
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// A number.
    pub fn number(value: impl Into<Option<f64>>, digits: usize) -> Self {
        Self::Number(value.into(), digits)
    }

    /// A count.
    pub fn count(n: usize) -> Self {
        Self::Number(Some(n as f64), 0)
    }
}

impl std::fmt::Display for Cell {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            // + 0.0: no minus before a zero
            Self::Number(Some(v), digits) if v.is_finite() => {
                let scale = 10f64.powi(i32::try_from(*digits).unwrap_or(0));
                write!(f, "{:.digits$}", (v * scale).round() / scale + 0.0)
            }
            Self::Number(..) => f.write_str("–"),
        }
    }
}

impl Serialize for Cell {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Text(text) => s.serialize_str(text),
            Self::Number(v, _) => v.filter(|v| v.is_finite()).serialize(s),
        }
    }
}

/// Curves over one axis.
#[derive(Clone, Debug, Serialize)]
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// What lies along x, with its unit.
    pub x: String,
    /// What lies along y, with its unit.
    pub y: String,
    /// The curves.
    pub series: Vec<Series>,
    /// Levels to draw across, a target for one.
    pub levels: Vec<f64>,
}

/// One curve or cloud.
#[derive(Clone, Debug, Serialize)]
pub struct Series {
    /// Its name.
    pub name: String,
    /// x and y, each finite.
    pub points: Vec<(f64, f64)>,
    /// Whether its points are joined.
    pub joined: bool,
}

/// A capture with what was seen in it, to be drawn.
#[derive(Clone, Debug)]
pub struct Seen {
    /// What it shows.
    pub caption: String,
    /// The red image.
    pub red: Image<u16>,
    /// Its level of white.
    pub white: f64,
    /// What came of it.
    pub measurement: Measurement,
    /// What was seen.
    pub drawing: Drawing,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_that_could_not_be_had_misses_its_target() {
        let of = |value: Option<f64>, must| Figure::new("f", value, "mm", 2).must(must).passed();
        assert_eq!(of(Some(0.1), Must::AtMost(0.1)), Some(true));
        assert_eq!(of(Some(0.9), Must::AtLeast(0.95)), Some(false));
        assert_eq!(of(Some(1.2), Must::Within(0.9, 1.15)), Some(false));
        assert_eq!(of(None, Must::AtMost(1.0)), Some(false));
        assert_eq!(of(Some(f64::NAN), Must::AtMost(1.0)), Some(false));
        assert_eq!(Figure::new("f", 1.0, "mm", 2).passed(), None);
    }

    #[test]
    fn what_is_not_known_is_null_and_never_0() {
        let f = serde_json::to_value(Figure::new("f", f64::NAN, "mm", 2).must(Must::AtMost(1.0))).expect("plain");
        assert!(f["value"].is_null() && f["pass"] == false && f["must"] == "≤ 1", "{f}");
        let cells = [Cell::number(None, 1), Cell::number(-0.0001, 2), Cell::count(3), Cell::text("x")];
        assert_eq!(cells.clone().map(|c| c.to_string()), ["–", "0.00", "3", "x"]);
        assert_eq!(serde_json::to_string(&cells).expect("plain"), "[null,-0.0001,3.0,\"x\"]");
    }
}

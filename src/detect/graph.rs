//! A network's file made ready to run: read, checked, cut where its usual head begins.
//! In:  an ONNX file of the YOLOv8 family. Out: a graph to run on one image, and what its output means.
//! Not here: images; what outputs are worth.
//!
//! The usual head ends in a softmax over the bins of every side of every cell, which is a quarter to a half of the time
//! though hardly a cell holds anything. It is cut off where it is found, and done for those cells only. Whether what was
//! cut off is what it seems is not read off the graph but tried: both must give the same on one input.

use super::decode::{CLASSES, Head};
use crate::document::{Check, Error};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto, ValueInfoProto, tensor_shape_proto::dimension, type_proto};
use tract_onnx::prelude::*;

/// Sides of inputs are multiples of this, and no longer than that.
const STRIDE: usize = 32;
const MAX_SIDE: usize = 2592;

type Plan = Arc<TypedRunnableModel>;

/// A network ready to run.
pub(super) struct Graph {
    model: Plan,
    /// Channels, height, width.
    pub(super) input: [usize; 3],
    /// What its outputs are.
    pub(super) head: Head,
}

impl Graph {
    /// From what is in `file`. Errors name it, what is wrong and what is allowed.
    pub(super) fn from_bytes(bytes: &[u8], file: &Path) -> Result<Self, Error> {
        // tract's reader indexes by names that a file may lack
        let read = std::panic::catch_unwind(|| Self::build(bytes, file));
        read.unwrap_or_else(|_| Err(content(file, "no ONNX network that can be read")))
    }

    fn build(bytes: &[u8], file: &Path) -> Result<Self, Error> {
        let proto = tract_onnx::onnx().proto_model_for_read(&mut std::io::Cursor::new(bytes));
        let mut proto = proto.map_err(|_| content(file, "no ONNX file"))?;
        let Some(graph) = proto.graph.as_ref().filter(|g| !g.node.is_empty()) else {
            return Err(content(file, "no ONNX file"));
        };
        let input = input_shape(graph, Check(file))?;
        let outputs = graph.output.len();
        Check(file).that(outputs == 1, "number of outputs", outputs, "1, the boxes with their scores")?;
        let logits = logits(graph);
        let whole = runnable(&proto, input).map_err(|e| failed(file, e))?;
        let shape = output_shapes(&whole).map_err(|e| failed(file, e))?;
        let shown = shape[0].iter().map(ToString::to_string).collect::<Vec<_>>().join("×");
        let allowed = format!("1×{}×cells: {CLASSES} classes, point1 to point4", 4 + CLASSES);
        let good = matches!(shape[0][..], [1, rows, cells] if rows == 4 + CLASSES && cells > 0);
        Check(file).that(good, "output", shown, allowed)?;
        let cells = shape[0][2];
        let whole = Self { model: whole, input, head: Head::Boxes(cells) };

        let known = whole.try_out().map_err(|e| failed(file, e))?;
        let head = logits.as_ref().and_then(|_| Head::logits(cells, (input[2], input[1])));
        let mut tried = known.clone();
        let mut graph = whole;
        if let (Some(names), Some(head)) = (logits, head) {
            if let Some(graph) = proto.graph.as_mut() {
                graph.output = names.into_iter().map(|name| ValueInfoProto { name, ..Default::default() }).collect();
                graph.value_info.clear();
            }
            let cut = runnable(&proto, input).map(|model| Self { model, input, head });
            if let Some((cut, raw)) = cut.ok().and_then(|cut| cut.try_out().ok().map(|raw| (cut, raw))) {
                if cut.head.agrees(&raw, &known) {
                    graph = cut;
                }
                tried = raw;
            }
        }
        // tract's sigmoid makes numbers of what is none: logits tell
        if !tried.iter().chain(&known).all(|v| v.is_finite()) {
            return Err(content(file, "a network whose output is not finite"));
        }
        Ok(graph)
    }

    /// Runs on a plane of 0..=1, which all channels get. The outputs, one after the other.
    pub(super) fn run(&self, plane: &[f32]) -> TractResult<Vec<f32>> {
        let [channels, height, width] = self.input;
        let input = Tensor::from_shape(&[1, channels, height, width], &plane.repeat(channels))?;
        let outputs = self.model.run(tvec!(input.into()))?;
        let mut all = Vec::new();
        for output in &outputs {
            all.extend_from_slice(output.try_as_plain_ram()?.as_slice::<f32>()?);
        }
        Ok(all)
    }

    /// Whether the usual head was found and cut off.
    pub(super) fn is_cut(&self) -> bool {
        self.head.is_logits()
    }

    /// What it makes of an input in which every value is another one.
    fn try_out(&self) -> TractResult<Vec<f32>> {
        let [_, height, width] = self.input;
        let value = |k: usize| (k as f32 * 0.618_034).fract();
        self.run(&(0..height * width).map(value).collect::<Vec<_>>())
    }
}

fn content(file: &Path, found: impl Into<String>) -> Error {
    let allowed = "an ONNX network of the YOLOv8 family".into();
    Error::Value { file: file.into(), key: "content".into(), value: found.into(), allowed }
}

fn failed(file: &Path, e: TractError) -> Error {
    content(file, format!("a network that cannot be run ({e:#})"))
}

fn runnable(proto: &ModelProto, [channels, height, width]: [usize; 3]) -> TractResult<Plan> {
    let model = tract_onnx::onnx().with_ignore_output_shapes(true).model_for_proto_model(proto)?;
    let fact = InferenceFact::dt_shape(f32::datum_type(), tvec!(1, channels, height, width));
    model.with_input_fact(0, fact)?.into_optimized()?.into_runnable()
}

/// Shapes of the outputs, all of them of f32.
fn output_shapes(model: &Plan) -> TractResult<Vec<Vec<usize>>> {
    let outlets = model.model().output_outlets()?.to_vec();
    let shape = |outlet| -> TractResult<Vec<usize>> {
        let fact = model.model().outlet_fact(outlet)?;
        let dims: Option<Vec<usize>> = fact.shape.as_concrete().map(<[usize]>::to_vec);
        Ok(dims.filter(|_| fact.datum_type == f32::datum_type()).unwrap_or_default())
    };
    outlets.into_iter().map(shape).collect()
}

/// Channels, height and width of the only input.
fn input_shape(graph: &GraphProto, check: Check) -> Result<[usize; 3], Error> {
    let constant = |name: &String| graph.initializer.iter().any(|t| t.name == *name);
    let inputs: Vec<&ValueInfoProto> = graph.input.iter().filter(|i| !constant(&i.name)).collect();
    check.that(inputs.len() == 1, "number of inputs", inputs.len(), "1, the image")?;
    let tensor = inputs[0].r#type.as_ref().and_then(|t| t.value.as_ref());
    let dims: Vec<Option<usize>> = match tensor {
        Some(type_proto::Value::TensorType(t)) => {
            t.shape.iter().flat_map(|s| &s.dim).map(|d| number(&d.value)).collect()
        }
        None => Vec::new(),
    };
    let side = |n: usize| n.is_multiple_of(STRIDE) && (STRIDE..=MAX_SIDE).contains(&n);
    let shape = match dims[..] {
        [Some(1) | None, Some(c @ (1 | 3)), Some(h), Some(w)] if side(h) && side(w) => Some([c, h, w]),
        _ => None,
    };
    let shown = dims.iter().map(|d| d.map_or("?".into(), |d| d.to_string())).collect::<Vec<_>>().join("×");
    let allowed =
        format!("1×channels×height×width: 1 or 3 channels, sides of {STRIDE} to {MAX_SIDE} in steps of {STRIDE}");
    check.that(shape.is_some(), "input", shown, allowed)?;
    Ok(shape.unwrap_or_default())
}

fn number(value: &Option<dimension::Value>) -> Option<usize> {
    match value {
        Some(dimension::Value::DimValue(n)) => usize::try_from(*n).ok(),
        _ => None,
    }
}

/// Names of the head's logits: one value with bins and classes, or one with each.
fn logits(graph: &GraphProto) -> Option<Vec<String>> {
    let makers: HashMap<&str, &NodeProto> =
        graph.node.iter().flat_map(|n| n.output.iter().map(move |o| (o.as_str(), n))).collect();
    let maker = |name: &str| makers.get(name).copied();
    let end = maker(&graph.output[0].name)?;
    // boxes as one value, or middles and sizes as two
    let (scores, boxes) = end.input.split_last()?;
    let sigmoid = maker(scores)?;
    if end.op_type != "Concat" || sigmoid.op_type != "Sigmoid" {
        return None;
    }
    // the softmax is the last one on any way to the boxes
    let (mut open, mut seen) = (boxes.iter().map(String::as_str).collect::<Vec<_>>(), Vec::new());
    let softmax = loop {
        let name = open.pop()?;
        let Some(node) = maker(name).filter(|_| !seen.contains(&name)) else { continue };
        seen.push(name);
        if node.op_type == "Softmax" {
            break node;
        }
        open.extend(node.input.iter().map(String::as_str));
    };
    let mut bins = softmax.input.first()?;
    while let Some(node) = maker(bins).filter(|n| ["Reshape", "Transpose"].contains(&n.op_type.as_str())) {
        bins = node.input.first()?;
    }
    let classes = sigmoid.input.first()?;
    let whole = |name: &str| {
        maker(name).filter(|n| ["Split", "Slice"].contains(&n.op_type.as_str())).and_then(|n| n.input.first())
    };
    match (whole(bins), whole(classes)) {
        (Some(a), Some(b)) if a == b => Some(vec![a.clone()]),
        _ => Some(vec![bins.clone(), classes.clone()]),
    }
}

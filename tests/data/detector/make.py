"""Writes the tests' networks: of YOLOv8's usual shape, a few kB each, weights set by hand. `pip install onnx`, then
`python3 make.py` in this folder.

A cell of stride 8 is point1 where the image's mean over it is above 0.7, and its box ends one stride from its middle on
all four sides (two below). Nothing else is ever found.
"""
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

BINS = 16
BOX_LOGITS = 4 * BINS


class Net:
    def __init__(self):
        self.nodes, self.constants = [], []

    def constant(self, name, value):
        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def node(self, op, inputs, outputs, **attributes):
        self.nodes.append(helper.make_node(op, inputs, outputs, name=outputs[0] + "_n", **attributes))
        return outputs[0]


def write(name, size=(64, 64), channels=1, classes=4, bias=None, apart=False, twist=False, shape=None, light=False):
    """`light`: dark images give no numbers; `apart`: bins and classes are never one value, nor are middles and sizes; `twist`: the head is not the usual one, though it looks so."""
    net, (height, width) = Net(), size
    rows = BOX_LOGITS + classes
    scales, anchors, strides = [], [], []
    for stride in (8, 16, 32):
        pooled = net.node("AveragePool", ["images"], [f"pool{stride}"], kernel_shape=[stride] * 2, strides=[stride] * 2)
        weight = np.zeros((rows, channels, 1, 1), np.float32)
        offset = np.zeros(rows, np.float32)
        for side in range(4):
            offset[side * BINS + (2 if side == 3 else 1)] = 20.0
        offset[BOX_LOGITS:] = -10.0
        if stride == 8:
            weight[BOX_LOGITS] = 40.0 / channels
            offset[BOX_LOGITS] = -28.0
        if bias is not None:
            offset[-1] = bias
        conv = net.node("Conv", [pooled, net.constant(f"w{stride}", weight), net.constant(f"b{stride}", offset)], [f"p{stride}"])
        flat = net.constant(f"flat{stride}", np.array([1, rows, -1], np.int64))
        scales.append(net.node("Reshape", [conv, flat], [f"r{stride}"]))
        y, x = np.mgrid[0:height // stride, 0:width // stride].astype(np.float32) + 0.5
        anchors.append(np.stack([x.ravel(), y.ravel()]))
        strides.append(np.full(x.size, stride, np.float32))
    anchor, stride = np.concatenate(anchors, 1), np.concatenate(strides)
    cells = stride.size
    if light:
        net.node("GlobalAveragePool", ["images"], ["mean1"])
        net.node("Sub", ["mean1", net.constant("dark", np.float32(0.48))], ["above"])
        net.node("Sqrt", ["above"], ["root"])
        net.node("Mul", ["root", net.constant("tiny", np.float32(1e-20))], ["nothing"])
        net.node("Reshape", ["nothing", net.constant("flat", np.array([1, 1, 1], np.int64))], ["nothing3"])
        scales = [net.node("Add", [s, "nothing3"], [s + "n"]) for s in scales]
    net.node("Concat", scales, ["logits"], axis=2)
    if apart:
        for out, lo, hi in (("bins0", 0, BOX_LOGITS), ("cls0", BOX_LOGITS, rows)):
            ends = [net.constant(f"{out}_{k}", np.array([v], np.int64)) for k, v in (("lo", lo), ("hi", hi), ("ax", 1))]
            net.node("Slice", ["logits", *ends], [out + "s"])
        net.node("Neg", ["bins0s"], ["bins1"])
        net.node("Neg", ["bins1"], ["bins"])
        net.node("Neg", ["cls0s"], ["cls1"])
        net.node("Neg", ["cls1"], ["cls"])
    else:
        split = net.constant("split", np.array([BOX_LOGITS, classes], np.int64))
        net.node("Split", ["logits", split], ["bins", "cls"], axis=1)
    net.node("Reshape", ["bins", net.constant("four", np.array([1, 4, BINS, cells], np.int64))], ["bins4"])
    net.node("Transpose", ["bins4"], ["binst"], perm=[0, 2, 1, 3])
    net.node("Softmax", ["binst"], ["weights"], axis=1)
    mean = np.arange(BINS, dtype=np.float32).reshape(1, BINS, 1, 1) * (1.5 if twist else 1.0)
    net.node("Conv", ["weights", net.constant("mean", mean)], ["sides4"])
    net.node("Reshape", ["sides4", net.constant("sides", np.array([1, 4, cells], np.int64))], ["sides3"])
    for out, lo, hi in (("lt", 0, 2), ("rb", 2, 4)):
        ends = [net.constant(f"{out}_{k}", np.array([v], np.int64)) for k, v in (("lo", lo), ("hi", hi), ("ax", 1))]
        net.node("Slice", ["sides3", *ends], [out])
    net.constant("anchors", anchor[None])
    net.node("Sub", ["anchors", "lt"], ["first"])
    net.node("Add", ["anchors", "rb"], ["last"])
    net.node("Add", ["first", "last"], ["sum"])
    net.node("Div", ["sum", net.constant("two", np.float32(2.0))], ["middle"])
    net.node("Sub", ["last", "first"], ["extent"])
    net.constant("strides", stride[None, None])
    net.node("Sigmoid", ["cls"], ["scores"])
    if apart:
        boxes = [net.node("Mul", [part, "strides"], [part + "px"]) for part in ("middle", "extent")]
    else:
        net.node("Concat", ["middle", "extent"], ["cells"], axis=1)
        boxes = [net.node("Mul", ["cells", "strides"], ["boxes"])]
    net.node("Concat", [*boxes, "scores"], ["output0"], axis=1)
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, shape or [1, channels, height, width])
    out = helper.make_tensor_value_info("output0", TensorProto.FLOAT, [1, 4 + classes, cells])
    graph = helper.make_graph(net.nodes, name, [image], [out], net.constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    onnx.checker.check_model(model)
    onnx.save(model, f"{name}.onnx")


write("usual")
write("apart", apart=True)
write("twisted", twist=True)
write("colour-wide", size=(64, 96), channels=3)
write("three-classes", classes=3)
write("odd-size", size=(64, 72), shape=[1, 1, 64, 72])
write("any-size", shape=[1, 1, "height", "width"])
write("not-finite", bias=float("nan"))
write("only-in-light", light=True)

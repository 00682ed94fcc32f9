"""The detector: a small network of the YOLOv8 family, grey in, anchor-free, boxes as distributions.

In:  (batch, 1, height, width), grey / 255; width and height multiples of 32.
Out: in training, logits (batch, 4 * BINS + classes, cells), and the same in `Exported`, with the boxes decoded after it.
     A cell is one place of one of the three grids (strides 8, 16, 32), grids in that order, each row by row.
     Channels: BINS logits each for the distances left, top, right, bottom from the cell's centre, in strides;
     then one logit per class.
Not here: what the logits should be (loss.py), images (data.py).
Methods: C2f, decoupled anchor-free head: Jocher, Chaurasia, Qiu, YOLOv8 (2023), as described, code our own;
SPPF: He et al., "Spatial pyramid pooling", ECCV 2014; boxes as distributions: Li et al., "Generalized focal loss",
NeurIPS 2020; the neck: Liu et al., "Path aggregation network", CVPR 2018.
"""

import copy
import math

import torch
from torch import nn

STRIDES = (8, 16, 32)
BINS = 16
"""Bins of a distance's distribution: 0 to 15 strides."""

SIZES = {
    # multiples of 16 suit processors; channels at strides 2, 4, 8, 16, 32; bottlenecks there; hidden channels of the head
    "femto": ((16, 16, 32, 48, 64), (0, 0, 1, 1, 1), 32),
    "pico": ((16, 32, 32, 64, 128), (0, 1, 1, 2, 1), 32),
    "nano": ((16, 32, 64, 96, 128), (0, 1, 2, 2, 1), 48),
}


class Conv(nn.Module):
    """Convolution, batch normalisation, SiLU."""

    def __init__(self, cin, cout, kernel=1, stride=1):
        super().__init__()
        self.conv = nn.Conv2d(cin, cout, kernel, stride, kernel // 2, bias=False)
        self.norm = nn.BatchNorm2d(cout, eps=1e-3, momentum=0.03)
        self.act = nn.SiLU(inplace=True)

    def forward(self, x):
        return self.act(self.norm(self.conv(x)))

    def fused(self):
        """The same function with the normalisation folded into the convolution's weights."""
        conv, norm = self.conv, self.norm
        scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
        out = nn.Conv2d(conv.in_channels, conv.out_channels, conv.kernel_size, conv.stride, conv.padding)
        out.weight.data = conv.weight.detach() * scale.detach()[:, None, None, None]
        out.bias.data = (norm.bias - norm.running_mean * scale).detach()
        return nn.Sequential(out, self.act)


class Bottleneck(nn.Module):
    def __init__(self, c, shortcut):
        super().__init__()
        self.body = nn.Sequential(Conv(c, c, 3), Conv(c, c, 3))
        self.shortcut = shortcut

    def forward(self, x):
        return x + self.body(x) if self.shortcut else self.body(x)


class C2f(nn.Module):
    """Half of the channels pass a chain of bottlenecks; every stage of the chain goes into the result."""

    def __init__(self, cin, cout, n, shortcut):
        super().__init__()
        c = cout // 2
        self.half = c
        self.enter = Conv(cin, 2 * c)
        self.chain = nn.ModuleList(Bottleneck(c, shortcut) for _ in range(n))
        self.leave = Conv((2 + n) * c, cout)

    def forward(self, x):
        stages = list(self.enter(x).split(self.half, 1))
        for bottleneck in self.chain:
            stages.append(bottleneck(stages[-1]))
        return self.leave(torch.cat(stages, 1))


class Sppf(nn.Module):
    """Maxima over 5, 9 and 13 cells beside the cell itself."""

    def __init__(self, c):
        super().__init__()
        self.enter = Conv(c, c // 2)
        self.pool = nn.MaxPool2d(5, 1, 2)
        self.leave = Conv(2 * c, c)

    def forward(self, x):
        pools = [self.enter(x)]
        for _ in range(3):
            pools.append(self.pool(pools[-1]))
        return self.leave(torch.cat(pools, 1))


class Network(nn.Module):
    """`size`: a key of SIZES; `classes`: how many."""

    def __init__(self, size="pico", classes=4):
        super().__init__()
        self.size, self.classes = size, classes
        (c2, c4, c8, c16, c32), (_, n4, n8, n16, n32), hidden = SIZES[size]
        self.to4 = nn.Sequential(Conv(1, c2, 3, 2), Conv(c2, c4, 3, 2), C2f(c4, c4, n4, True))
        self.to8 = nn.Sequential(Conv(c4, c8, 3, 2), C2f(c8, c8, n8, True))
        self.to16 = nn.Sequential(Conv(c8, c16, 3, 2), C2f(c16, c16, n16, True))
        self.to32 = nn.Sequential(Conv(c16, c32, 3, 2), C2f(c32, c32, n32, True), Sppf(c32))
        self.larger = nn.Upsample(scale_factor=2, mode="nearest")
        self.down16 = C2f(c32 + c16, c16, 1, False)
        self.down8 = C2f(c16 + c8, c8, 1, False)
        self.shrink8 = Conv(c8, c8, 3, 2)
        self.up16 = C2f(c8 + c16, c16, 1, False)
        self.shrink16 = Conv(c16, c16, 3, 2)
        self.up32 = C2f(c16 + c32, c32, 1, False)
        branch = lambda c, out: nn.Sequential(Conv(c, hidden, 3), Conv(hidden, hidden, 3), nn.Conv2d(hidden, out, 1))
        self.boxes = nn.ModuleList(branch(c, 4 * BINS) for c in (c8, c16, c32))
        self.scores = nn.ModuleList(branch(c, classes) for c in (c8, c16, c32))
        for boxes, scores, stride in zip(self.boxes, self.scores, STRIDES):
            nn.init.constant_(boxes[-1].bias, 1.0)
            # a start at the share of cells that hold a region: about five of a 320 x 256 grid
            nn.init.constant_(scores[-1].bias, math.log(5 / classes / (320 * 256 / stride**2)))

    def levels(self, x):
        """The logits of each grid, as images."""
        p8 = self.to8(self.to4(x))
        p16 = self.to16(p8)
        p32 = self.to32(p16)
        n16 = self.down16(torch.cat([self.larger(p32), p16], 1))
        n8 = self.down8(torch.cat([self.larger(n16), p8], 1))
        n16 = self.up16(torch.cat([self.shrink8(n8), n16], 1))
        n32 = self.up32(torch.cat([self.shrink16(n16), p32], 1))
        return [torch.cat([b(n), s(n)], 1) for b, s, n in zip(self.boxes, self.scores, (n8, n16, n32))]

    def forward(self, x):
        return torch.cat([level.flatten(2) for level in self.levels(x)], 2)


def cells(width, height, device=None):
    """Centres (2, cells) in input pixels, and strides (1, cells)."""
    centres, strides = [], []
    for s in STRIDES:
        y, x = torch.meshgrid(torch.arange(height // s), torch.arange(width // s), indexing="ij")
        centres.append((torch.stack([x, y]).flatten(1) + 0.5) * s)
        strides.append(torch.full((1, x.numel()), float(s)))
    return torch.cat(centres, 1).to(device), torch.cat(strides, 1).to(device)


def distances(box_logits):
    """Means of the four distributions: (batch, 4 * BINS, cells) to (batch, 4, cells), in strides."""
    p = box_logits.unflatten(1, (4, BINS)).softmax(2)
    return (p * torch.arange(BINS, dtype=p.dtype, device=p.device)[:, None]).sum(2)


class Exported(nn.Module):
    """The network as it is used: (1, 4 + classes, cells), x, y, w, h in input pixels and scores 0 to 1."""

    def __init__(self, network, width, height):
        super().__init__()
        self.network = fuse(network)
        self.counts = [(width // s) * (height // s) for s in STRIDES]
        centres, strides = cells(width, height)
        self.register_buffer("centres", centres[None])
        self.register_buffer("strides", strides[None])
        self.register_buffer("bins", torch.arange(BINS, dtype=torch.float32)[None, None, :, None])

    def forward(self, x):
        # sizes as plain numbers: nothing in the graph computes a shape
        channels, n = 4 * BINS + self.network.classes, self.centres.shape[2]
        flat = [level.reshape(1, channels, k) for level, k in zip(self.network.levels(x), self.counts)]
        logits = torch.cat(flat, 2)
        boxes, scores = logits[:, : 4 * BINS], logits[:, 4 * BINS :]
        d = (boxes.reshape(1, 4, BINS, n).softmax(2) * self.bins).sum(2)
        near, far = d[:, :2], d[:, 2:]
        centre = self.centres + 0.5 * (far - near) * self.strides
        return torch.cat([centre, (near + far) * self.strides, scores.sigmoid()], 1)


def fuse(network):
    """A copy for inference, its normalisations folded away."""
    network = copy.deepcopy(network).eval()
    for module in list(network.modules()):
        for name, child in list(module.named_children()):
            if isinstance(child, Conv):
                setattr(module, name, child.fused())
    return network


def export(network, width, height, path):
    """Writes the ONNX: static shape, opset 17, input `images`, output `output`; the node that joins the three grids'
    logits to one (1, 4 * BINS + classes, cells) and the tensor that it gives are both named `logits`, so that a reader
    can cut the graph there."""
    import onnx

    model = Exported(network, width, height).eval()
    names = {"input_names": ["images"], "output_names": ["output"]}
    torch.onnx.export(model, (torch.zeros(1, 1, height, width),), path, opset_version=17, dynamo=False, **names)
    proto = onnx.load(path)
    shaped = onnx.shape_inference.infer_shapes(proto)
    shape = {v.name: [d.dim_value for d in v.type.tensor_type.shape.dim] for v in shaped.graph.value_info}
    wanted = [1, 4 * BINS + network.classes, sum(model.counts)]
    (join,) = [k for k in proto.graph.node if k.op_type == "Concat" and shape.get(k.output[0]) == wanted]
    old = join.output[0]
    join.name = "logits"
    for node in proto.graph.node:
        node.output[:] = ["logits" if o == old else o for o in node.output]
        node.input[:] = ["logits" if i == old else i for i in node.input]
    onnx.checker.check_model(proto, full_check=True)
    onnx.save(proto, path)

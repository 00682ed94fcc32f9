"""What the network should say, and how far it is off.

In:  logits (batch, 4 * BINS + classes, cells); regions (batch, most, 5): class (-1: none), x0, y0, x1, y1 in input px.
Out: the loss, and its three parts for the record.
Methods: cells are assigned by how well they already do (Feng et al., "TOOD: task-aligned one-stage object detection",
ICCV 2021); boxes by complete IoU (Zheng et al., "Distance-IoU loss", AAAI 2020) and distribution focal loss (Li et al.,
"Generalized focal loss", NeurIPS 2020); scores by binary cross-entropy against the assignment's quality.
"""

import math

import torch
import torch.nn.functional as F

from network import BINS, distances

ALPHA, BETA, BEST = 0.5, 6.0, 10
"""Assignment: powers of score and IoU in a cell's alignment; cells per region."""
BOX, SCORE, DISTRIBUTION = 7.5, 0.5, 1.5
"""Weights of the loss's parts, as YOLOv8 has them."""


def iou(a, b, complete=False):
    """IoU of boxes (…, 4) as corners; `complete`: less the penalties for distance and aspect."""
    overlap = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0).prod(-1)
    size_a, size_b = (a[..., 2:] - a[..., :2]).clamp(min=1e-6), (b[..., 2:] - b[..., :2]).clamp(min=1e-6)
    plain = overlap / (size_a.prod(-1) + size_b.prod(-1) - overlap)
    if not complete:
        return plain
    hull = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    apart = (a[..., :2] + a[..., 2:] - b[..., :2] - b[..., 2:]).square().sum(-1) / 4
    turn = torch.atan(size_a[..., 0] / size_a[..., 1]) - torch.atan(size_b[..., 0] / size_b[..., 1])
    v = (2 / math.pi * turn).square()
    with torch.no_grad():
        weight = v / (1 - plain + v + 1e-9)
    return plain - apart / (hull.square().sum(-1) + 1e-9) - weight * v


@torch.no_grad()
def assign(scores, boxes, centres, regions):
    """Which region each cell answers for, and how well it should say so.

    `scores` (batch, cells, classes) 0 to 1; `boxes` (batch, cells, 4) corners, `centres` (cells, 2), px.
    Returns `region` (batch, cells), an index or -1, and `quality` (batch, cells), 0 where there is none.
    A region is given the BEST cells of highest alignment `score^ALPHA * iou^BETA` among those whose centre it holds;
    a cell that several regions want answers for that of highest IoU. `quality` is the alignment, scaled so that a
    region's best cell has the region's best IoU.
    """
    there = regions[..., 0] >= 0
    corners = regions[:, :, None, 1:]
    inside = torch.cat([centres - corners[..., :2], corners[..., 2:] - centres], -1).amin(-1) > 0
    inside &= there[..., None]
    kind = regions[..., 0].clamp(min=0).long()
    score = scores.transpose(1, 2).gather(1, kind[..., None].expand(-1, -1, scores.shape[1]))
    overlap = iou(corners, boxes[:, None]).clamp(min=0) * inside
    alignment = score.pow(ALPHA) * overlap.pow(BETA)
    # cells inside a region come before those outside even where no box overlaps it yet
    rank = alignment + inside * 1e-12
    best = rank.topk(min(BEST, rank.shape[2]), 2).indices
    wanted = torch.zeros_like(inside).scatter_(2, best, True) & inside
    held = torch.where(wanted, overlap + 1e-12, 0).max(1)
    region = torch.where(held.values > 0, held.indices, -1)
    wanted &= region[:, None] == torch.arange(regions.shape[1], device=region.device)[None, :, None]
    alignment, overlap = alignment * wanted, overlap * wanted
    top = overlap.amax(2, keepdim=True) / (alignment.amax(2, keepdim=True) + 1e-9)
    return region, (alignment * top).amax(1)


def distribution_loss(logits, target):
    """Cross-entropy of (…, BINS) logits against the two bins about `target` (…), weighted by nearness."""
    low = target.floor()
    share = target - low
    log_p = logits.log_softmax(-1)
    at = lambda k: -log_p.gather(-1, k.long()[..., None])[..., 0]
    return at(low) * (1 - share) + at(low + 1) * share


def loss(logits, regions, centres, strides):
    """`centres` (2, cells), `strides` (1, cells), as network.cells gives them."""
    logits = logits.float()
    box_logits, score_logits = logits[:, : 4 * BINS], logits[:, 4 * BINS :].transpose(1, 2)
    d = distances(box_logits) * strides
    boxes = torch.cat([centres - d[:, :2], centres + d[:, 2:]], 1).transpose(1, 2)
    region, quality = assign(score_logits.detach().sigmoid(), boxes.detach(), centres.T, regions)
    held = region >= 0
    mine = regions.gather(1, region.clamp(min=0)[..., None].expand(-1, -1, 5))
    target = torch.zeros_like(score_logits)
    target.scatter_(2, mine[..., :1].clamp(min=0).long(), (quality * held)[..., None])
    total = target.sum().clamp(min=1)
    score_part = F.binary_cross_entropy_with_logits(score_logits, target, reduction="sum") / total
    weight = quality[held]
    box_part = ((1 - iou(boxes[held], mine[held][:, 1:], complete=True)) * weight).sum() / total
    stride, centre = strides[0].expand_as(region)[held], centres.T.expand(len(logits), -1, -1)[held]
    corners = mine[held][:, 1:]
    wanted = torch.cat([centre - corners[:, :2], corners[:, 2:] - centre], 1) / stride[:, None]
    spread = box_logits.transpose(1, 2)[held].unflatten(1, (4, BINS))
    off = distribution_loss(spread, wanted.clamp(0, BINS - 1.01)).mean(1)
    distribution_part = (off * weight).sum() / total
    parts = BOX * box_part, SCORE * score_part, DISTRIBUTION * distribution_part
    # per batch, not per image: the size of the step must not depend on how many images hold a vehicle
    return sum(parts), [p.item() for p in parts]

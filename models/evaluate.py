"""How good a detector is: `python models/evaluate.py --data DIR --onnx models/detector.onnx`.

In:  an ONNX with the usual head (1, 4 + classes, cells), run by ONNX Runtime on one thread, and one part of the data,
     letterboxed as the appliance does (areas averaged, padded with 114, / 255).
Out: precision and recall at the working threshold, average precision at IoU 0.5 and 0.5 to 0.95 (101 points, as COCO's),
     how many vehicles have every labelled region, and the regions found where no vehicle is.
A found region is right if an unclaimed one of its class overlaps it with IoU >= 0.5.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from data import CLASSES, Set, shares

THRESHOLD = 0.5
"""Score from which a region counts: where precision and recall together were best on `val`."""
SAME = 0.5
"""IoU from which two boxes of a class are one region."""
FLOOR = 0.005
"""Lowest score that average precision looks at."""
LEVELS = np.arange(0.5, 0.96, 0.05)


def overlap(a, b):
    """IoU (n, m) of boxes as corners."""
    wh = np.minimum(a[:, None, 2:], b[None, :, 2:]) - np.maximum(a[:, None, :2], b[None, :, :2])
    both = wh.clip(min=0).prod(2)
    size = lambda x: (x[:, 2:] - x[:, :2]).clip(min=0).prod(1)
    return both / (size(a)[:, None] + size(b)[None] - both + 1e-9)


def found(output, floor=FLOOR):
    """(4 + classes, cells) to (n, 6) class, x0, y0, x1, y1, score: best first, one per place and class."""
    kind, score = output[4:].argmax(0), output[4:].max(0)
    take = np.flatnonzero(score >= floor)
    take = take[np.argsort(-score[take], kind="stable")]
    centre, half = output[:2, take].T, output[2:4, take].T / 2
    rows = np.concatenate([kind[take, None], centre - half, centre + half, score[take, None]], 1)
    out = []
    for k in range(len(output) - 4):
        left = rows[rows[:, 0] == k]
        while len(left):
            out.append(left[0])
            left = left[1:][overlap(left[:1, 1:5], left[1:, 1:5])[0] < SAME]
    out = np.array(out).reshape(-1, 6)
    return out[np.argsort(-out[:, 5], kind="stable")]


def claims(rows, truth):
    """For each found region and level of IoU whether it is right (n, levels): best first, a truth is claimed once."""
    right = np.zeros((len(rows), len(LEVELS)), bool)
    for level, least in enumerate(LEVELS):
        free = np.ones(len(truth), bool)
        for i, row in enumerate(rows):
            iou = overlap(row[None, 1:5], truth[:, 1:])[0] * free * (truth[:, 0] == row[0])
            if len(iou) and iou.max() >= least:
                right[i, level], free[iou.argmax()] = True, False
    return right


def average_precision(right, wanted):
    """Area under precision over recall, of claims sorted best first."""
    hits = right.cumsum()
    precision = hits / np.arange(1, len(hits) + 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    at = np.searchsorted(hits / wanted, np.linspace(0, 1, 101))
    return np.append(precision, 0)[np.minimum(at, len(precision))].mean()


def report(outputs, wanted, threshold=THRESHOLD, bodies=None):
    """Figures over all images: `outputs` of the network, `wanted` (n, 5) class and corners for each.
    `bodies`: for each the classes that its vehicle has with the share of each that can be seen, none without a vehicle;
    left away, those that are labelled. A region that is there but hidden by more than the labels allow is counted as
    wrong when found, and also by itself."""
    rows, right, counts = [], [], np.zeros(len(CLASSES), int)
    complete = vehicles = empty = false_on_empty = images_false = 0
    highest = 0.0
    hidden = []
    for output, truth, there in zip(outputs, wanted, bodies or [dict.fromkeys(t[:, 0].astype(int), 1.0) for t in wanted]):
        mine = found(output)
        ok = claims(mine, truth)
        rows.append(mine)
        right.append(ok)
        counts += np.bincount(truth[:, 0].astype(int), minlength=len(CLASSES))
        above = mine[:, 5] >= threshold
        unlabelled = there.keys() - set(truth[:, 0].astype(int))
        hidden += [there[int(row[0])] for row in mine[above] if int(row[0]) in unlabelled]
        if len(truth):
            vehicles += 1
            complete += int(ok[above, 0].sum() == len(truth))
        if not there:
            empty += 1
            false_on_empty += int(above.sum())
            images_false += int(above.any())
            highest = max(highest, mine[:, 5].max(initial=0.0))
    rows, right = np.concatenate(rows), np.concatenate(right)
    order = np.argsort(-rows[:, 5], kind="stable")
    rows, right = rows[order], right[order]
    ap = np.array([
        [average_precision(right[rows[:, 0] == k, level], counts[k]) for level in range(len(LEVELS))]
        for k in range(len(CLASSES)) if counts[k]
    ]).reshape(-1, len(LEVELS))
    above = rows[:, 5] >= threshold
    hits = int(right[above, 0].sum())
    names = [c for c, n in zip(CLASSES, counts) if n]
    per_class = {}
    for k, name in enumerate(CLASSES):
        if counts[k]:
            mine = above & (rows[:, 0] == k)
            h = int(right[mine, 0].sum())
            i = names.index(name)
            per_class[name] = {
                "regions": int(counts[k]), "precision": h / max(1, int(mine.sum())), "recall": h / int(counts[k]),
                "ap50": float(ap[i, 0]), "ap50_95": float(ap[i].mean()),
            }
    return {
        "threshold": threshold, "images": len(wanted), "regions": int(counts.sum()),
        "precision": hits / max(1, int(above.sum())), "recall": hits / max(1, int(counts.sum())),
        "wrong": int(above.sum()) - hits, "wrong_hidden": sorted(hidden),
        "map50": float(ap[:, 0].mean()) if len(ap) else None, "map50_95": float(ap.mean()) if len(ap) else None,
        "vehicles": vehicles, "complete": complete / max(1, vehicles),
        "without": empty, "false_on_without": false_on_empty, "images_with_false": images_false,
        "highest_on_without": float(highest), "classes": per_class,
    }


def truths(data):
    return [r[r[:, 0] >= 0].numpy() for r in data.regions]


def session(path):
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--data", required=True)
    p.add_argument("--part", default="test", choices=("train", "val", "test", "all"))
    p.add_argument("--onnx", default="models/detector.onnx")
    p.add_argument("--threshold", type=float, nargs="+", default=[THRESHOLD])
    p.add_argument("--json", help="write the figures there as well")
    a = p.parse_args()
    net = session(a.onnx)
    (inp,) = net.get_inputs()
    _, channels, h, w = inp.shape
    outputs, wanted, there = [], [], []
    for part in ("train", "val", "test") if a.part == "all" else (a.part,):
        data = Set(a.data, part, (w, h))
        for i in range(len(data)):
            x = np.repeat(data.batch([i])[0].numpy(), channels, 1)
            outputs.append(net.run(None, {inp.name: x})[0][0])
        wanted += truths(data)
        seen = shares(a.data)
        there += [seen[name] if seen else dict.fromkeys(t[:, 0].astype(int), 1.0) for name, t in zip(data.names, truths(data))]
    for threshold in a.threshold:
        figures = report(outputs, wanted, threshold, there)
        show(figures)
    if a.json:
        with open(a.json, "w") as f:
            json.dump(figures, f, indent=1)


def show(r):
    print(f"threshold {r['threshold']:.2f}: {r['images']} images, {r['regions']} regions", end="")
    if r["regions"]:
        print(f": precision {r['precision']:.4f} recall {r['recall']:.4f} mAP@0.5 {r['map50']:.4f} "
              f"mAP@0.5:0.95 {r['map50_95']:.4f}; wrong {r['wrong']}, there but hidden {len(r['wrong_hidden'])}", end="")
        if r["wrong_hidden"]:
            share = r["wrong_hidden"]
            print(f", to be seen of them {share[0]:.2f} to {share[-1]:.2f}, median {share[len(share) // 2]:.2f}", end="")
    print()
    print(f"  every region of the vehicle: {r['complete']:.4f} of {r['vehicles']} vehicles; without a vehicle: "
          f"{r['false_on_without']} regions in {r['images_with_false']} of {r['without']} images, "
          f"highest score {r['highest_on_without']:.3f}")
    for name, c in r["classes"].items():
        print(f"  {name}: {c['regions']} precision {c['precision']:.4f} recall {c['recall']:.4f} "
              f"AP@0.5 {c['ap50']:.4f} AP@0.5:0.95 {c['ap50_95']:.4f}")


if __name__ == "__main__":
    main()

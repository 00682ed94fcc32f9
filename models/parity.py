"""The appliance's detector against ONNX Runtime: `python models/parity.py --data DIR`.

In:  100 test images of DIR, enlarged to the camera's 2592 x 1944 by repeating pixels; the same ONNX for both, one thread each.
Out: how far boxes (px of the full image) and scores are apart; times: letterbox, network and decoding from the full image,
     and the network with its decoding alone beside ONNX Runtime's; the most memory that the detector's process held, an image
     of 10 MiB with it.
     Exit status 1 if a bound is missed.
Times are the thread's time on the processor, which other work on the machine disturbs less than that on the wall.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from data import Letterbox, read_grey
from evaluate import THRESHOLD, found, overlap, session

FULL = (2592, 1944)
BOUNDS = {"box px": 0.5, "score": 1e-3, "unmatched": 0, "ratio": 2.5, "ms from the full image": 60, "memory MiB": 80}


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--data", required=True)
    p.add_argument("--onnx", default="models/detector.onnx")
    p.add_argument("--images", type=int, default=100)
    p.add_argument("--threshold", type=float, default=THRESHOLD)
    p.add_argument("--detect", nargs="+", default=["cargo", "run", "--release", "--locked", "--example", "detect", "--"])
    a = p.parse_args()
    files = sorted((Path(a.data) / "test" / "images").glob("*.png"))[: a.images]
    if not files:
        raise SystemExit(f"{a.data}/test/images: no *.png there")
    net = session(a.onnx)
    (inp,) = net.get_inputs()
    _, channels, h, w = inp.shape
    fit = Letterbox(FULL, (w, h))
    with tempfile.TemporaryDirectory() as folder:
        full, small = [], []
        for k, f in enumerate(files):
            grey = read_grey(f)
            if FULL[0] % grey.shape[1] or FULL[1] % grey.shape[0]:
                raise SystemExit(f"{f}: {grey.shape[1]} x {grey.shape[0]}, allowed: a whole part of {FULL[0]} x {FULL[1]}")
            large = grey.repeat(FULL[1] // grey.shape[0], 0).repeat(FULL[0] // grey.shape[1], 1)
            full.append(fit.image(large) / 255)
            small.append(np.rint(full[-1] * 255).astype(np.uint8))
            Image.fromarray(large).save(f"{folder}/full-{k:03}.png", compress_level=1)
            Image.fromarray(small[-1]).save(f"{folder}/small-{k:03}.png")
        run = lambda plane: net.run(None, {inp.name: np.repeat(plane[None, None].astype(np.float32), channels, 1)})[0][0]
        ours, memory = detect(a, sorted(Path(folder).glob("full-*")))
        alone, _ = detect(a, sorted(Path(folder).glob("small-*")))
        theirs, times = [run(x) for x in full], []
        for grey in small:
            x = grey / 255
            began = time.thread_time()
            run(x)
            times.append(1e3 * (time.thread_time() - began))
    gap = {"box px": 0.0, "score": 0.0, "unmatched": 0}
    boxes = 0
    for mine, output in zip(ours, theirs):
        rows = found(output, a.threshold)
        to_image = lambda v, k: (v - fit.offset[k]) * FULL[k] / fit.inner[k] - 0.5
        rows[:, 1:5] = np.stack([to_image(rows[:, 1 + k], k % 2) for k in range(4)], 1)
        got = np.array([[b["class"], *b["sides"], b["score"]] for b in mine["boxes"]]).reshape(-1, 6)
        boxes += len(rows)
        for left, right in ((rows, got), (got, rows)):
            for row in left:
                same = right[right[:, 0] == row[0]]
                shared = overlap(row[None, 1:5], same[:, 1:5])[0]
                if not len(same) or shared.max() < 0.5:
                    # where the score is the threshold's but for the arithmetic, either may be right
                    gap["unmatched"] += int(row[5] > a.threshold + BOUNDS["score"])
                    continue
                other = same[shared.argmax()]
                gap["box px"] = max(gap["box px"], np.abs(row[1:5] - other[1:5]).max())
                gap["score"] = max(gap["score"], abs(row[5] - other[5]))
    median = lambda found: float(np.median([f["cpu_ms"] for f in found]))
    reached = gap | {
        "ratio": median(alone) / float(np.median(times)), "ms from the full image": median(ours), "memory MiB": memory,
    }
    print(f"{len(files)} images, {boxes} boxes above {a.threshold}; network and decoding {median(alone):.2f} ms, "
          f"ONNX Runtime {float(np.median(times)):.2f} ms")
    for key, value in reached.items():
        print(f"{key}: {value:.4g}, at most {BOUNDS[key]}{'' if value <= BOUNDS[key] else '  MISSED'}")
    sys.exit(any(value > BOUNDS[key] for key, value in reached.items()))


def detect(a, images):
    """What examples/detect.rs prints for `images`, and its peak memory, MiB."""
    done = subprocess.run([*a.detect, a.onnx, str(a.threshold), *map(str, images)], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    print(done.stderr.strip().splitlines()[-1])
    memory = float(re.search(r"VmHWM:\s*(\d+) kB", done.stderr).group(1)) / 1024
    return [json.loads(line) for line in done.stdout.splitlines()], memory


if __name__ == "__main__":
    main()

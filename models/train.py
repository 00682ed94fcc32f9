"""From data to a detector: `python models/train.py --data DIR --out DIR`.

Seeded, written down after every epoch, and taken up again by the same command: order and variation of the images are
those of (seed, epoch), so that a run that was cut goes on to the same weights.
Out: OUT/last.pt (everything to go on), OUT/weights.pt (the averaged weights alone), OUT/log.csv, OUT/curves.png and
OUT/detector.onnx. The test part is never looked at: evaluate.py does that.
"""

import argparse
import copy
import csv
import math
import os
import time
from pathlib import Path

import torch

from data import CLASSES, Set, varied
from evaluate import report, show, truths
from loss import loss
from network import SIZES, Exported, Network, cells, export

MEMORY = 1000
"""Steps over which the averaged weights remember."""
WARM = 300
"""Steps in which the learning rate rises; a tenth of all where those are few."""
FIXED = ("more", "size", "width", "height", "batch", "rate", "seed", "plain", "start")
"""What a run that goes on must have in common with the one that was cut."""


def arguments():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--data", required=True)
    p.add_argument("--more", nargs="+", default=[], help="folders of which the training parts are learned as well")
    p.add_argument("--out", required=True)
    p.add_argument("--size", default="pico", choices=SIZES)
    p.add_argument("--width", type=int, default=320)
    p.add_argument("--height", type=int, default=256)
    p.add_argument("--epochs", type=int, default=20)
    p.add_argument("--batch", type=int, default=16)
    p.add_argument("--rate", type=float, default=2e-3, help="highest learning rate")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--plain", type=float, default=0.15, help="last part of the epochs without rotation and crop")
    p.add_argument("--start", help="weights.pt of another training: fine-tunes")
    p.add_argument("--threads", type=int, default=1)
    p.add_argument("--full", action="store_true", help="32-bit arithmetic also where bfloat16 is fast")
    p.add_argument("--checks", type=int, default=12, help="how many times to look at the validation part")
    return p


def bfloat16_is_fast():
    if torch.cuda.is_available():
        return torch.cuda.is_bf16_supported()
    try:
        return "avx512_bf16" in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False


def rate_at(step, steps, highest):
    """Rises over WARM steps, then falls as half a cosine to a hundredth."""
    warm = min(WARM, steps // 10)
    if step < warm:
        return highest * (step + 1) / warm
    return highest * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * (step - warm) / (steps - warm))))


def average(mean, network, step):
    """Moves the averaged weights towards the present ones, faster at the beginning."""
    keep = min(1 - 1 / MEMORY, (1 + step) / (10 + step))
    with torch.no_grad():
        for m, v in zip(mean.state_dict().values(), network.state_dict().values()):
            if m.is_floating_point():
                m.lerp_(v, 1 - keep)
            else:
                m.copy_(v)


def outputs(network, data, device):
    """The exported network's output for every image, normalisations folded as in the export."""
    model = Exported(network.cpu(), *data.room).eval().to(device)
    out = []
    with torch.no_grad():
        for i in range(len(data)):
            out.append(model(data.batch([i])[0].to(device))[0].cpu().numpy())
    network.to(device)
    return out


def save(path, what):
    """In one piece: a power cut leaves the old file or the new one."""
    torch.save(what, f"{path}.new")
    os.replace(f"{path}.new", path)


def train(a):
    torch.set_num_threads(a.threads)
    torch.manual_seed(a.seed)
    torch.use_deterministic_algorithms(True, warn_only=True)
    # nothing here reads memory before writing it; filling it would cost a quarter of the time
    torch.utils.deterministic.fill_uninitialized_memory = False
    device = "cuda" if torch.cuda.is_available() else "cpu"
    half = not a.full and bfloat16_is_fast()
    if a.width % 32 or a.height % 32:
        raise SystemExit(f"input {a.width} x {a.height}: both must be multiples of 32")
    out = Path(a.out)
    out.mkdir(parents=True, exist_ok=True)
    room = (a.width, a.height)
    parts = {part: Set(a.data, part, room, out / "cache") for part in ("train", "val")}
    data = parts["train"]
    for folder in a.more:
        data.add(Set(folder, "train", room, out / "cache"))
    if len(data) < a.batch:
        raise SystemExit(f"{a.data}/train: {len(data)} images, fewer than one batch of {a.batch}")
    network = Network(a.size, len(CLASSES))
    if a.start:
        given = torch.load(a.start, weights_only=True)
        if given["size"] != a.size:
            raise SystemExit(f"{a.start}: weights of size {given['size']}, asked for {a.size}")
        network.load_state_dict(given["weights"])
    network.to(device, memory_format=torch.channels_last)
    mean = copy.deepcopy(network).eval()
    for v in mean.parameters():
        v.requires_grad_(False)
    # no decay on what shifts and scales
    heavy = [v for v in network.parameters() if v.ndim > 1]
    light = [v for v in network.parameters() if v.ndim <= 1]
    optimizer = torch.optim.AdamW([{"params": heavy, "weight_decay": 0.02}, {"params": light, "weight_decay": 0.0}])
    epoch, log = 0, []
    fixed = {k: getattr(a, k) for k in FIXED}
    if (out / "last.pt").exists():
        last = torch.load(out / "last.pt", weights_only=True, map_location=device)
        for k, v in fixed.items():
            if last["fixed"].get(k) != v:
                raise SystemExit(f"{out}/last.pt: was trained with --{k} {last['fixed'].get(k)}, asked for {v}")
        network.load_state_dict(last["network"])
        mean.load_state_dict(last["mean"])
        optimizer.load_state_dict(last["optimizer"])
        epoch, log = last["epoch"], last["log"]
        print(f"goes on after epoch {epoch}", flush=True)
    each = len(data) // a.batch
    steps = each * a.epochs
    centres, strides = cells(*room, device)
    count = sum(v.numel() for v in network.parameters())
    print(f"{a.size}, {count} parameters, {a.width} x {a.height}, {len(data)} images, {a.epochs} epochs of {each} steps, "
          f"{device}, {'bfloat16' if half else 'float32'}", flush=True)
    while epoch < a.epochs:
        began = time.monotonic()
        random = torch.Generator().manual_seed(a.seed * 100_003 + epoch)
        order = torch.randperm(len(data), generator=random)
        turns = epoch < a.epochs * (1 - a.plain)
        network.train()
        sums = torch.zeros(3, dtype=torch.float64)
        for k in range(each):
            index, step = order[k * a.batch : (k + 1) * a.batch], epoch * each + k
            x, regions = varied(
                data.images[index], data.inner[index], data.regions[index], data.visible[index], random, turns
            )
            x = x.to(device).contiguous(memory_format=torch.channels_last)
            with torch.autocast(device, torch.bfloat16, enabled=half):
                logits = network(x)
            total, parts_now = loss(logits, regions.to(device), centres, strides)
            for group in optimizer.param_groups:
                group["lr"] = rate_at(step, steps, a.rate)
            optimizer.zero_grad()
            total.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
            optimizer.step()
            average(mean, network, step)
            sums += torch.tensor(parts_now, dtype=torch.float64)
            if not math.isfinite(sums.sum()):
                raise SystemExit(f"epoch {epoch + 1}, step {k}: the loss is {parts_now}; take a lower --rate")
        epoch += 1
        row = {"epoch": epoch, "rate": optimizer.param_groups[0]["lr"], "seconds": round(time.monotonic() - began, 1)}
        row |= dict(zip(("box", "score", "distribution"), (round(v, 5) for v in (sums / each).tolist())))
        if epoch * a.checks // a.epochs > (epoch - 1) * a.checks // a.epochs:
            r = report(outputs(mean, parts["val"], device), truths(parts["val"]))
            row |= {k: round(r[k], 5) for k in ("precision", "recall", "map50", "map50_95", "complete", "false_on_without")}
        log.append(row)
        print(" ".join(f"{k} {v:.5g}" for k, v in row.items()), flush=True)
        save(out / "last.pt", {
            "network": network.state_dict(), "mean": mean.state_dict(), "optimizer": optimizer.state_dict(),
            "epoch": epoch, "log": log, "fixed": fixed,
        })
    weights = {k: v.half().cpu() if v.is_floating_point() else v.cpu() for k, v in mean.state_dict().items()}
    save(out / "weights.pt", {"size": a.size, "weights": weights})
    write_log(out, log)
    export(mean.cpu(), *room, str(out / "detector.onnx"))
    show(report(outputs(mean, parts["val"], "cpu"), truths(parts["val"])))
    return mean


def write_log(out, log):
    keys = list(dict.fromkeys(k for row in log for k in row))
    with open(out / "log.csv", "w", newline="") as f:
        table = csv.DictWriter(f, keys)
        table.writeheader()
        table.writerows(log)
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 4))
    for key in ("box", "score", "distribution"):
        left.plot([r["epoch"] for r in log], [r[key] for r in log], label=key)
    left.set(xlabel="epoch", ylabel="loss, training part", yscale="log")
    seen = [r for r in log if "map50" in r]
    for key in ("precision", "recall", "map50", "map50_95", "complete"):
        right.plot([r["epoch"] for r in seen], [r[key] for r in seen], ".-", label=key)
    right.set(xlabel="epoch", ylabel="validation part, averaged weights", ylim=(0, 1.02))
    for axis in (left, right):
        axis.legend()
        axis.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(out / "curves.png", dpi=80)
    pyplot.close(figure)


if __name__ == "__main__":
    train(arguments().parse_args())

"""The training's own tests: `python models/check.py`, 20 s. Each holds a fast path against a slow, plain one."""

import math
import tempfile
from pathlib import Path

import numpy as np
import torch

import data
import evaluate
import loss
import network
import train


def a_letterbox_averages_areas():
    """Against pixels cut so small that each piece lies in one pixel of both."""
    random = np.random.default_rng(1)
    for size, room in (((50, 37), (32, 32)), ((31, 60), (64, 32)), ((20, 20), (64, 32))):
        grey = random.integers(0, 256, size[::-1]).astype(np.float64)
        fit = data.Letterbox(size, room)
        (x0, y0), (w, h) = fit.offset, fit.inner
        pieces = np.repeat(np.repeat(grey, h, 0), w, 1).reshape(h, size[1], w, size[0])
        got = fit.image(grey)
        assert np.abs(got[y0 : y0 + h, x0 : x0 + w] - pieces.mean((1, 3))).max() < 1e-3
        got[y0 : y0 + h, x0 : x0 + w] = data.PAD
        assert (got == data.PAD).all(), "the rest is padding"


def regions_turn_with_the_image():
    """A white square is found again where its region went, at every angle and crop."""
    random = torch.Generator().manual_seed(2)
    images = torch.zeros(64, 96, 128, dtype=torch.uint8)
    regions = torch.full((64, 1, 5), -1.0)
    for i in range(64):
        x, y = (torch.rand(2, generator=random) * torch.tensor([50.0, 30.0])).int() + 30
        images[i, y : y + 16, x : x + 12] = 250
        regions[i, 0] = torch.tensor([0.0, x, y, x + 12, y + 16])
    inner = torch.tensor([0, 4, 128, 92]).expand(64, 4)
    got, where = data.varied(images, inner, regions, torch.ones(64, 1), random)
    seen = 0
    for image, (kind, *box) in zip(got[:, 0], where[:, 0].tolist()):
        if kind < 0:
            continue
        # smoothed against the noise; brighter than the padding
        smooth = torch.nn.functional.avg_pool2d(image[None], 3, 1, 1)[0]
        at = torch.nonzero(smooth > 0.8 * smooth.max()).flip(1) + 0.5
        low, high, box = at.amin(0), at.amax(0), torch.tensor(box).reshape(2, 2)
        assert (at.mean(0) - box.mean(0)).abs().max() < 0.7, (at.mean(0), box)
        assert (torch.stack([low, high]) - box).abs().max() < 4.5, (low, high, box)
        seen += 1
    assert seen > 40, seen


def what_was_partly_hidden_counts_no_more_once_it_is_cut():
    """A region that reaches a fifth of its width over the edge of the window: 0.8 of what could be seen of it is left."""
    inner, window = torch.tensor([[0, 0, 100, 100]] * 3), torch.tensor([0.8] * 3)
    regions = torch.tensor([[[1.0, 6, 40, 26, 60]]] * 3)
    back, offset = torch.eye(2).expand(3, 2, 2) / 0.8, torch.tensor([[10.0, 10]] * 3)
    got = data.turned(regions, torch.tensor([[1.0], [0.9], [0.8]]), back, offset, torch.zeros(3), window, inner)
    assert got[:, 0, 0].tolist() == [1, 1, -1], got
    assert torch.allclose(got[0, 0, 1:], torch.tensor([0, 37.5, 20, 62.5]))


def sets_join():
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for name, n in (("few", 2), ("more", 3)):
            draw(folder / name, "train", n, 5)
        (folder / "more" / "bodies.csv").write_text("image,needed,visible\n00000,,\n00001,0 2 3,0.9 1.000 0.75\n00002,0 2 3,1 1 1\n")
        both = data.Set(folder / "few", "train", (160, 128))
        both.add(data.Set(folder / "more", "train", (160, 128)))
        assert len(both) == 5 and both.images.shape == (5, 128, 160) and both.regions.shape == (5, 3, 5)
        assert torch.equal(both.visible[3], torch.tensor([0.9, 1, 0.75])) and both.visible[[1, 2, 4]].eq(1).all()


def assignment_is_that_of_loops():
    random = torch.Generator().manual_seed(3)
    rand = lambda *n: torch.rand(*n, generator=random)
    centres, _ = network.cells(64, 64)
    centres = centres.T
    for _ in range(20):
        b, n, m, k = 2, len(centres), 3, 4
        corner = rand(b, m, 2) * 40
        regions = torch.cat([torch.randint(-1, k, (b, m, 1), generator=random).float(), corner, corner + 8 + rand(b, m, 2) * 30], 2)
        scores, near = rand(b, n, k), rand(b, n, 2) * 20
        boxes = torch.cat([centres - near, centres + rand(b, n, 2) * 20], 2)
        region, quality = loss.assign(scores, boxes, centres, regions)
        for i in range(b):
            want = {}
            for j, (kind, x0, y0, x1, y1) in enumerate(regions[i].tolist()):
                if kind < 0:
                    continue
                ranked = []
                for c, (x, y) in enumerate(centres.tolist()):
                    if x0 < x < x1 and y0 < y < y1:
                        bx = boxes[i, c].tolist()
                        both = max(0, min(x1, bx[2]) - max(x0, bx[0])) * max(0, min(y1, bx[3]) - max(y0, bx[1]))
                        overlap = both / ((x1 - x0) * (y1 - y0) + (bx[2] - bx[0]) * (bx[3] - bx[1]) - both)
                        ranked.append((scores[i, c, int(kind)].item() ** 0.5 * overlap**6, overlap, c))
                for alignment, overlap, c in sorted(ranked, reverse=True)[: loss.BEST]:
                    if c not in want or want[c][1] < overlap:
                        want[c] = (alignment, overlap, j)
            for c in range(n):
                assert region[i, c].item() == (want[c][2] if c in want else -1)
            for c, (alignment, _, j) in want.items():
                mine = [v for v in want.values() if v[2] == j]
                wanted = alignment * max(v[1] for v in mine) / (max(v[0] for v in mine) + 1e-9)
                assert abs(quality[i, c].item() - wanted) < 1e-4


def a_distribution_is_two_bins():
    random = torch.Generator().manual_seed(4)
    logits = torch.randn(50, network.BINS, generator=random)
    target = torch.rand(50, generator=random) * 14.9
    got = loss.distribution_loss(logits, target)
    for row, t, g in zip(logits.tolist(), target.tolist(), got.tolist()):
        norm = math.log(sum(map(math.exp, row)))
        low = int(t)
        assert abs(g - ((norm - row[low]) * (low + 1 - t) + (norm - row[low + 1]) * (t - low))) < 1e-4
    mean = network.distances(logits[None, : 4].reshape(1, 4 * network.BINS, 1))[0, :, 0]
    for row, m in zip(logits[:4].tolist(), mean.tolist()):
        e = [math.exp(v) for v in row]
        assert abs(m - sum(k * v for k, v in enumerate(e)) / sum(e)) < 1e-4


def complete_iou_of_known_boxes():
    a, b = torch.tensor([0.0, 0, 2, 2]), torch.tensor([1.0, 0, 3, 2])
    assert abs(loss.iou(a, b).item() - 1 / 3) < 1e-6
    # as broad as high, both: no penalty but the centres' distance 1 over the hull's diagonal 13
    assert abs(loss.iou(a, b, complete=True).item() - (1 / 3 - 1 / 13)) < 1e-6


def average_precision_of_a_known_list():
    # right, wrong, right of two: precision 1 up to recall 0.5, then 2/3
    got = evaluate.average_precision(np.array([True, False, True]), 2)
    assert abs(got - (51 * 1 + 50 * 2 / 3) / 101) < 1e-9
    assert evaluate.average_precision(np.array([], bool), 3) == 0


def draw(folder, part, n, seed):
    """Panels with an arch, a flap and a corner, as plain as can be: for tests of the machinery, not of a detector."""
    from PIL import Image, ImageDraw

    random = np.random.default_rng(seed)
    for kind in ("images", "labels"):
        (folder / part / kind).mkdir(parents=True)
    for i in range(n):
        image = Image.new("L", (324, 243), int(random.integers(120, 230)))
        lines = []
        if i % 4:
            pen, dark = ImageDraw.Draw(image), int(random.integers(5, 40))
            x, y, r = random.integers(130, 190), random.integers(150, 170), random.integers(90, 120)
            pen.ellipse((x - r, y, x + r, y + 2 * r), fill=dark)
            fx, fy, fw, fh = x + random.integers(-20, 20), y - 70, random.integers(25, 35), random.integers(22, 30)
            pen.rounded_rectangle((fx - fw, fy - fh, fx + fw, fy + fh), 12, outline=dark, width=2)
            angle = math.radians(random.integers(125, 140))
            cx, cy = x + r * math.cos(angle), y + r - r * math.sin(angle)
            pen.line((cx, cy, cx + 10, 0), fill=dark, width=2)
            for k, bx, by, w, h in ((0, cx, cy, 44, 44), (2, fx, fy, 2.2 * fw, 2.2 * fh), (3, x, y, 60, 30)):
                lines.append(f"{k} {bx / 324:.6f} {by / 243:.6f} {w / 324:.6f} {h / 243:.6f}\n")
        image.save(folder / part / "images" / f"{i:05}.png")
        (folder / part / "labels" / f"{i:05}.txt").write_text("".join(lines))


def a_training_that_was_cut_goes_on_to_the_same_weights_and_onnx_agrees():
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for seed, (part, n) in enumerate((("train", 24), ("val", 8))):
            draw(folder / "data", part, n, seed)
        run = lambda out, *more: train.train(train.arguments().parse_args([
            "--data", str(folder / "data"), "--out", str(folder / out), "--size", "femto", "--width", "160",
            "--height", "128", "--batch", "8", "--epochs", "3", "--checks", "1", *more]))
        whole = run("whole").state_dict()
        # cut after the second epoch: what was written then is all that is left
        saved, kept = train.save, []

        def cut(path, what):
            saved(path, what)
            if what.get("epoch") == 2:
                raise KeyboardInterrupt

        train.save = cut
        try:
            run("cut")
            raise AssertionError("was not cut")
        except KeyboardInterrupt:
            pass
        finally:
            train.save = saved
        again = run("cut").state_dict()
        for key, value in whole.items():
            assert torch.equal(value, again[key]), key
        onnx_agrees(folder / "whole" / "detector.onnx", whole)


def onnx_agrees(path, weights):
    import onnx

    model = network.Network("femto")
    model.load_state_dict(weights)
    model.eval()
    x = torch.rand(1, 1, 128, 160)
    (out,) = evaluate.session(path).run(None, {"images": x.numpy()})
    with torch.no_grad():
        logits = model(x)
        d, (centres, strides) = network.distances(logits[:, : 4 * network.BINS]), network.cells(160, 128)
        near, far = centres - d[:, :2] * strides, centres + d[:, 2:] * strides
        plain = torch.cat([(near + far) / 2, far - near, logits[:, 4 * network.BINS :].sigmoid()], 1)
    assert out.shape == (1, 8, 420) and np.abs(out - plain.numpy()).max() < 2e-3, np.abs(out - plain.numpy()).max()
    cut = onnx.load(path)
    (node,) = [n for n in cut.graph.node if n.name == "logits"]
    assert node.output[0] == "logits"
    # cut there, it gives what the network says
    cut.graph.output.append(onnx.helper.make_tensor_value_info("logits", onnx.TensorProto.FLOAT, [1, 68, 420]))
    onnx.save(cut, f"{path}.cut")
    got = evaluate.session(f"{path}.cut").run(["logits"], {"images": x.numpy()})[0]
    assert np.abs(got - logits.numpy()).max() < 1e-3


if __name__ == "__main__":
    torch.set_num_threads(1)
    for check in (
        a_letterbox_averages_areas,
        regions_turn_with_the_image,
        what_was_partly_hidden_counts_no_more_once_it_is_cut,
        sets_join,
        assignment_is_that_of_loops,
        a_distribution_is_two_bins,
        complete_iou_of_known_boxes,
        average_precision_of_a_known_list,
        a_training_that_was_cut_goes_on_to_the_same_weights_and_onnx_agrees,
    ):
        check()
        print("ok", check.__name__.replace("_", " "), flush=True)

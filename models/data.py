"""Images and regions: read, letterboxed once, kept small, varied on the fly.

In:  DIR/{train,val,test}/images/*.png (grey) and labels/*.txt (YOLO: class cx cy w h, in parts of width and height;
     an empty or missing file: no region). The split is by body and already made; nothing here crosses it.
Out: `Set`: images (n, height, width) uint8 as the network gets them, and regions (n, most, 5): class (-1: none),
     x0, y0, x1, y1 in input pixels.
`varied` does the published augmentations: rotation by -10 to 10 degrees in steps of 5, brightness by -30 to 30 % in
steps of 10, Gaussian noise of sigma 10 to 30, crops by 5 to 20 %. No mirroring: classes have a side.
"""

import csv
import math
import zlib
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

CLASSES = ("point1", "point2", "point3", "point4")
PAD = 114
VISIBLE = 0.7
"""A region counts while at least this part of it can be seen: is in the image, and nothing before it."""


class Letterbox:
    """How an image of `size` (w, h) comes to lie in an input of `room` (w, h): `scale`, then `offset` px."""

    def __init__(self, size, room):
        self.size, self.room = size, room
        self.scale = min(room[0] / size[0], room[1] / size[1])
        # halves go up, as they do in the appliance
        self.inner = tuple(max(1, min(r, math.floor(s * self.scale + 0.5))) for s, r in zip(size, room))
        self.offset = tuple((r - i) // 2 for r, i in zip(room, self.inner))
        self.across, self.down = (averaging(s, i) for s, i in zip(size, self.inner))

    def image(self, grey):
        """(h, w) grey levels to the (room h, room w) input in grey levels, float32: areas averaged, the rest PAD."""
        out = np.full(self.room[::-1], PAD, np.float32)
        (x, y), (w, h) = self.offset, self.inner
        out[y : y + h, x : x + w] = self.down @ grey.astype(np.float32) @ self.across.T
        return out

    def boxes(self, relative):
        """(n, 4) cx, cy, w, h in parts of the image to corners in input pixels."""
        inner, offset = np.array(self.inner, np.float32), np.array(self.offset, np.float32)
        centre, half = relative[:, :2] * inner + offset, relative[:, 2:] * inner / 2
        return np.concatenate([centre - half, centre + half], 1)


def averaging(n, m):
    """The (m, n) matrix that averages n pixels to m, each by the part of it that lies in the new one."""
    edge = np.arange(m + 1) * (n / m)
    pixel = np.arange(n)
    part = np.minimum(edge[1:, None], pixel + 1) - np.maximum(edge[:-1, None], pixel)
    return (part.clip(min=0) * (m / n)).astype(np.float32)


def read_grey(path):
    from PIL import Image

    return np.asarray(Image.open(path).convert("L"))


def read_regions(path):
    """(n, 5) class, cx, cy, w, h; refuses what is no such line."""
    rows = []
    for number, line in enumerate(path.read_text().splitlines() if path.exists() else [], 1):
        fields = line.split()
        if not fields:
            continue
        try:
            values = [float(f) for f in fields]
            sound = len(values) == 5 and values[0] in range(len(CLASSES)) and all(map(math.isfinite, values))
        except ValueError:
            sound = False
        if not sound:
            raise SystemExit(f"{path}:{number}: {line!r} is not `class cx cy w h` with a class of 0 to {len(CLASSES) - 1}")
        rows.append(values)
    return np.array(rows, np.float32).reshape(-1, 5)


def shares(folder):
    """{image: {class: share of it that can be seen}}, all classes that its vehicle has; {} without a bodies.csv."""
    path = Path(folder) / "bodies.csv"
    if not path.exists():
        return {}
    with open(path, newline="") as f:
        return {r["image"]: dict(zip(map(int, r["needed"].split()), map(float, r["visible"].split()))) for r in csv.DictReader(f)}


class Set:
    """One part of the data. `cache`: a folder for the letterboxed images, so that the next run starts at once."""

    def __init__(self, folder, part, room, cache=None):
        files = sorted((Path(folder) / part / "images").glob("*.png"))
        if not files:
            raise SystemExit(f"{folder}/{part}/images: no *.png there")
        self.names, self.room = [f.stem for f in files], room
        labels = [Path(folder) / part / "labels" / f"{f.stem}.txt" for f in files]
        seen = shares(folder)
        # the cache belongs to these very files
        stamp = "".join(f"{f} {f.stat().st_mtime_ns}" for f in [*files, *(p for p in labels if p.exists())])
        kept = cache and Path(cache) / f"{part}-{room[0]}x{room[1]}-{zlib.crc32(stamp.encode()):08x}.npz"
        if kept and kept.exists():
            with np.load(kept) as z:
                images, inner, regions = z["images"], z["inner"], z["regions"]
        else:
            images, inner, regions = read(files, labels, room)
            if kept:
                kept.parent.mkdir(parents=True, exist_ok=True)
                np.savez(kept, images=images, inner=inner, regions=regions)
        self.images, self.inner, self.regions = map(torch.from_numpy, (images, inner, regions))
        share = [[seen.get(name, {}).get(int(k), 1.0) for k in of] for name, of in zip(self.names, regions[..., 0])]
        self.visible = torch.tensor(share)

    def add(self, other):
        """Takes in the images of another set."""
        most = max(self.regions.shape[1], other.regions.shape[1])
        pad = lambda t, value: torch.cat([t, t.new_full((len(t), most - t.shape[1], *t.shape[2:]), value)], 1)
        self.names = self.names + other.names
        self.images, self.inner = torch.cat([self.images, other.images]), torch.cat([self.inner, other.inner])
        self.regions = torch.cat([pad(self.regions, -1.0), pad(other.regions, -1.0)])
        self.visible = torch.cat([pad(self.visible, 1.0), pad(other.visible, 1.0)])

    def __len__(self):
        return len(self.images)

    def batch(self, index):
        """Input (n, 1, h, w) 0 to 1, and regions."""
        return self.images[index][:, None].float() / 255, self.regions[index]


def read(files, labels, room):
    boxes, images, inner = [], [], []
    fit = None
    for image, label in zip(files, labels):
        grey = read_grey(image)
        if fit is None or fit.size != grey.shape[::-1]:
            fit = Letterbox(grey.shape[::-1], room)
        images.append(np.rint(fit.image(grey)).astype(np.uint8))
        inner.append([*fit.offset, *(o + i for o, i in zip(fit.offset, fit.inner))])
        rows = read_regions(label)
        boxes.append(np.concatenate([rows[:, :1], fit.boxes(rows[:, 1:])], 1))
    regions = np.full((len(files), max(1, *map(len, boxes)), 5), -1, np.float32)
    for out, rows in zip(regions, boxes):
        out[: len(rows)] = rows
    return np.stack(images), np.array(inner, np.int64), regions


def varied(images, inner, regions, visible, random, turns=True):
    """A batch as it might have been: `images` (n, h, w) uint8 to (n, 1, h, w) 0 to 1, regions with them: those of which
    enough can still be seen.

    `turns`: rotate (half of the images) and crop (half); brightness (three quarters) and noise (a third) always.
    A crop is a window of 80 to 95 % of width and height, enlarged. Noise is that of a pixel of the full image: averaging
    to the input's size has already made it smaller, by about half.
    """
    n, h, w = images.shape
    uniform = lambda lo, hi: lo + (hi - lo) * torch.rand(n, generator=random)
    often = lambda p: torch.rand(n, generator=random) < p
    steps = lambda lo, hi: torch.randint(lo, hi + 1, (n,), generator=random).float()
    angle = torch.where(often(0.5), steps(-2, 2) * 5, 0).deg2rad()
    window = torch.where(often(0.5), uniform(0.8, 0.95), 1)
    slide = torch.stack([uniform(-0.5, 0.5), uniform(-0.5, 0.5)], 1)
    gain = torch.where(often(0.75), 1 + steps(-3, 3) * 0.1, 1)
    sigma = torch.where(often(1 / 3), uniform(10, 30) * 0.5, 0)
    # about PAD, so that what comes in from outside is padding
    x = images[:, None].float() - PAD
    if turns:
        near, far = inner[:, :2].float(), inner[:, 2:].float()
        centre, size = (near + far) / 2, far - near
        shift = slide * (1 - window[:, None]) * size
        cos, sin = angle.cos() * window, angle.sin() * window
        # the source of an output place p: centre + shift + R (p - centre) * window
        spin = torch.stack([torch.stack([cos, -sin], 1), torch.stack([sin, cos], 1)], 1)
        half = torch.tensor([w, h]) / 2
        offset = centre + shift - (spin @ centre[..., None])[..., 0]
        moved = ((spin @ half.expand(n, 2)[..., None])[..., 0] + offset - half) / half
        theta = torch.cat([spin * half[None, None, :] / half[None, :, None], moved[..., None]], 2)
        still = (angle == 0) & (window == 1)
        grid = F.affine_grid(theta[~still], x[~still].shape, align_corners=False)
        x[~still] = F.grid_sample(x[~still], grid, "bilinear", "zeros", align_corners=False)
        regions = turned(regions, visible, torch.linalg.inv(spin), offset, angle, window, inner)
    x = (x + PAD) * gain[:, None, None, None]
    x = x + torch.randn(x.shape, generator=random) * sigma[:, None, None, None]
    px, py = torch.arange(w), torch.arange(h)[:, None]
    near, far = inner[:, :2, None, None], inner[:, 2:, None, None]
    within = (px >= near[:, 0]) & (px < far[:, 0]) & (py >= near[:, 1]) & (py < far[:, 1])
    return torch.where(within[:, None], x.clamp(0, 255), PAD) / 255, regions


def turned(regions, visible, back, offset, angle, window, inner):
    """The regions' upright boxes after the images were turned: `p = back (source - offset)`. What was hidden of a region
    is taken as spread evenly over it."""
    kind, corners = regions[..., :1], regions[..., 1:]
    middle = (corners[..., :2] + corners[..., 2:]) / 2 - offset[:, None]
    middle = (back[:, None] @ middle[..., None])[..., 0]
    half = (corners[..., 2:] - corners[..., :2]) / 2 / window[:, None, None]
    # a flap has round corners: taken as half of its smaller side; the others are rectangles
    r = torch.where(kind == 2, 0.5 * half.amin(-1, keepdim=True), 0)
    cos, sin = angle.cos().abs()[:, None, None], angle.sin().abs()[:, None, None]
    core = half - r
    half = core * cos + core.flip(-1) * sin + r
    box = torch.cat([middle - half, middle + half], -1)
    near, far = inner[:, None, :2].float(), inner[:, None, 2:].float()
    seen = torch.cat([torch.maximum(box[..., :2], near), torch.minimum(box[..., 2:], far)], -1)
    area = lambda b: (b[..., 2:] - b[..., :2]).clamp(min=0).prod(-1, keepdim=True)
    keep = (kind >= 0) & (visible[..., None] * area(seen) >= VISIBLE * area(box))
    return torch.cat([torch.where(keep, kind, -1), seen], -1)

#!/usr/bin/env python3
"""Edges in four regions of 400 x 400 px by OpenCV, as JSON: {row: {"threads": median ms}}. Usage: peer.py REGIONS (raw, 8 bits)
find_4_regions: Canny, then the maximum of the gradient along its direction to sub-pixel by a parabola, all edge pixels at
once. edges_4_regions: and where the mean of five profiles across, cubic and smoothed, passes half its contrast; as ours but
without slope, softness and variance."""
import json, sys, time
import cv2
import numpy as np

HALF, ZERO, STEP, SPACING = 19, 16, 0.5, 0.7
KERNEL = np.exp(-0.5 * (np.arange(-3, 4) * STEP / 0.6) ** 2)[None].astype(np.float32)


def found(region):
    y, x = np.nonzero(cv2.Canny(region, 20, 60))
    smooth = cv2.GaussianBlur(region, (0, 0), 0.7, dst=None, borderType=cv2.BORDER_REPLICATE)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    strength = cv2.magnitude(gx, gy)
    here = strength[y, x]
    nx, ny = gx[y, x] / np.maximum(here, 1e-6), gy[y, x] / np.maximum(here, 1e-6)
    at = lambda s: cv2.remap(strength, (x + s * nx)[:, None].astype(np.float32), (y + s * ny)[:, None].astype(np.float32), cv2.INTER_LINEAR)[:, 0]
    before, after = at(-1.0), at(1.0)
    step = np.clip(0.5 * (after - before) / np.maximum(2 * here - before - after, 1e-6), -1, 1)
    return np.c_[x + step * nx, y + step * ny].astype(np.float32), np.c_[nx, ny]


def refined(region):
    place, normal = found(region)
    along = (np.arange(-HALF, HALF + 1) * STEP).astype(np.float32)[None, :, None]
    beside = (np.arange(-2, 3) * SPACING).astype(np.float32)[None, None, :]
    at = lambda k, sign: (place[:, k, None, None] + normal[:, k, None, None] * along + sign * normal[:, 1 - k, None, None] * beside).reshape(len(place), -1)
    samples = cv2.remap(region.astype(np.float32), at(0, -1), at(1, 1), cv2.INTER_CUBIC)
    profile = samples.reshape(len(place), -1, 5).mean(2)
    profile = cv2.filter2D(profile, -1, KERNEL / KERNEL.sum())[:, 3:-3]
    dark, bright = profile[:, : ZERO + 1].min(1), profile[:, ZERO:].max(1)
    level = (dark + bright)[:, None] / 2
    below = 2 * ZERO - 1 - np.argmax((profile[:, :-1] < level)[:, ::-1], axis=1)
    low, high = (profile[np.arange(len(place)), below + k] for k in (0, 1))
    step = (below - ZERO + (level[:, 0] - low) / np.maximum(high - low, 1e-6)) * STEP
    return place + step[:, None] * normal, normal


regions = np.fromfile(sys.argv[1], np.uint8).reshape(4, 400, 400)
out = {}
for row, edges in (("find_4_regions", found), ("edges_4_regions", refined)):
    out[row] = {}
    for threads in (1, 2):
        cv2.setNumThreads(threads)
        times = []
        for _ in range(60):
            begun = time.perf_counter()
            places = [edges(r)[0] for r in regions]
            times.append(time.perf_counter() - begun)
        out[row][str(threads)] = float(np.median(times) * 1e3)
    out[row]["edges"] = int(sum(len(p) for p in places))
print(json.dumps(out))

"""Augmentation: geometry (crop, aspect, rotation, flip), light (shadows, tone, colour), and camera (gray, blur, noise, JPEG).

In: image `[H, W, 3]` u8 RGB, label `[H, W]` u8, and a generator. Out: the same at the training size. The network meets colour 4:3
cameras, gray wide ones squashed to 4:3, deep shade and a simulator; each step below stands for one of these differences.
"""

import cv2
import numpy as np

from network import IGNORE

# Where the horizon lies in the training sets, as a share of the image's height (by eye; their cameras look level).
HORIZON = 0.45
# Standard normal noise, drawn once: slices at random offsets are far cheaper than fresh draws.
NOISE = np.random.default_rng(0).standard_normal(2_000_000).astype(np.float32)


def crop_affine(shape, size, rng):
    """`[2, 3]` f64, source from output: a crop with its aspect ratio, its height in the image, a rotation and a flip.

    Half of the crops keep about 4:3; the others reach 3.4, a wide camera squashed to the network's input.
    """
    height, width = shape
    out_width, out_height = size
    is_wide = rng.random() < 0.5
    aspect = np.exp(rng.uniform(np.log(1.6), np.log(3.4))) if is_wide else rng.uniform(1.1, 1.6)
    scale = 1.0 - 0.5 * rng.random() ** 1.5
    crop_width = scale * min(width, height * aspect)
    crop_height = crop_width / aspect
    room_x, room_y = width - crop_width, height - crop_height
    left = rng.uniform(0, room_x)
    top = np.clip(HORIZON * height - rng.uniform(0.05, 0.65) * crop_height, 0, room_y)
    angle = np.radians(rng.normal(0.0, 1.5))
    step_x, step_y = crop_width / out_width, crop_height / out_height
    if rng.random() < 0.5:
        left, step_x = left + crop_width, -step_x
    linear = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ np.diag([step_x, step_y])
    centre = np.array([left + step_x * out_width / 2, top + step_y * out_height / 2])
    offset = centre - linear @ np.array([out_width / 2, out_height / 2])
    # Pixel centres lie at half-integers in this frame and at integers in OpenCV's.
    offset += linear @ np.array([0.5, 0.5]) - 0.5
    return np.column_stack([linear, offset])


def warp(image, label, size, rng):
    matrix = crop_affine(label.shape, size, rng)
    flags = cv2.WARP_INVERSE_MAP
    shrinks = abs(matrix[0, 0]) > 1.5 or abs(matrix[1, 1]) > 1.5
    source = cv2.blur(image, (3, 3)) if shrinks else image
    smooth = cv2.INTER_CUBIC if rng.random() < 0.3 else cv2.INTER_LINEAR
    image = cv2.warpAffine(source, matrix, size, flags=flags | smooth, borderMode=cv2.BORDER_REPLICATE)
    label = cv2.warpAffine(
        label, matrix, size, flags=flags | cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=IGNORE
    )
    return image, label


def cast_shadows(size, rng):
    """Gain `[H, W]` f32 of one to four soft polygons, most of them low in the image, where the road is."""
    width, height = size[0] // 2, size[1] // 2
    gain = np.ones((height, width), np.float32)
    for _ in range(rng.integers(1, 5)):
        corners = rng.integers(3, 8)
        angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
        radius = rng.uniform(0.3, 1.0, corners)
        reach = np.array([width * rng.uniform(0.1, 0.9), height * rng.uniform(0.04, 0.5)])
        centre = np.array([rng.uniform(0, width), height * rng.beta(2.0, 1.3)])
        points = centre + np.column_stack([np.cos(angles), np.sin(angles)]) * radius[:, None] * reach
        mask = np.zeros((height, width), np.float32)
        cv2.fillPoly(mask, [points.astype(np.int32)], 1.0)
        mask = cv2.GaussianBlur(mask, (0, 0), np.exp(rng.uniform(np.log(0.4), np.log(8.0))))
        gain *= 1.0 - mask * rng.uniform(0.2, 0.88)
    return cv2.resize(gain, size, interpolation=cv2.INTER_LINEAR)


def dapple(size, rng):
    """Gain `[H, W]` f32 of light through leaves: three octaves of smooth noise, thresholded softly."""
    noise = np.zeros(size[::-1], np.float32)
    rows, columns = rng.integers(4, 16, 2)
    for octave in (1, 2, 4):
        grid = rng.standard_normal((rows * octave, columns * octave)).astype(np.float32) / np.sqrt(octave)
        noise += cv2.resize(grid, size, interpolation=cv2.INTER_CUBIC)
    lit = 1.0 / (1.0 + np.exp(-rng.uniform(2.0, 10.0) * (noise + rng.uniform(-0.5, 0.8))))
    return 1.0 - (1.0 - lit) * rng.uniform(0.2, 0.65)


def vignette(size, rng):
    """Gain `[H, W]` f32: a linear fall across the image and a quadratic one from its centre."""
    y, x = np.meshgrid(np.linspace(-1, 1, size[1]), np.linspace(-1, 1, size[0]), indexing="ij")
    gain = 1.0 + rng.uniform(-0.3, 0.3) * x + rng.uniform(-0.3, 0.3) * y - rng.uniform(0.0, 0.3) * (x * x + y * y)
    return gain.astype(np.float32)


def light(image, rng):
    """Shadows and uneven light, `[H, W, 3]` u8 to u8."""
    size = image.shape[1::-1]
    gain = None
    for chance, effect in ((0.6, cast_shadows), (0.15, dapple), (0.2, vignette)):
        if rng.random() < chance:
            made = effect(size, rng)
            gain = made if gain is None else gain * made
    if gain is None:
        return image
    return cv2.multiply(image, cv2.merge([gain] * 3), dtype=cv2.CV_8U)


def tone_table(mean, rng):
    """`[256]` f32: a gamma towards a random mean brightness, then contrast and offset, and now and then a bend in the curve.

    `mean` is the image's own, 0..1: aiming at a level keeps dark images from turning black and bright ones white.
    """
    x = np.linspace(0, 1, 256, dtype=np.float32)
    level = rng.uniform(0.2, 0.62)
    gamma = np.log(level) / np.log(np.clip(mean, 0.05, 0.95))
    y = x ** np.clip(gamma, 0.4, 2.2)
    if rng.random() < 0.3:
        bend = rng.uniform(-0.8, 0.8)
        y = y + bend * y * (1 - y) * (1 - 2 * y)
    contrast = np.exp(rng.normal(0.0, 0.25))
    y = (y - level) * contrast + level + rng.normal(0.0, 0.04)
    if rng.random() < 0.15:
        y = y * rng.uniform(1.0, 1.5)
    return y * 255


def colour(image, rng):
    """Gray for half of the images, jittered colour for the others; then the tone curve."""
    table = tone_table(image[::4, ::4].mean() / 255, rng)
    if rng.random() < 0.5:
        weights = rng.dirichlet([3.0, 5.0, 2.0])
        gray = cv2.transform(image, weights[None, :])
        gray = cv2.LUT(gray, table.clip(0, 255).astype(np.uint8))
        return cv2.merge([gray] * 3)
    saturation = rng.uniform(0.3, 1.6)
    luma = np.array([0.299, 0.587, 0.114])
    mix = saturation * np.eye(3) + (1 - saturation) * np.tile(luma, (3, 1))
    if rng.random() < 0.5:
        turn = rng.normal(0.0, 0.06, (3, 3))
        mix = mix + turn - np.diag(turn.sum(axis=1))
    image = cv2.transform(image, mix)
    gains = np.exp(rng.normal(0.0, 0.08, 3)).astype(np.float32)
    tables = (table[:, None] * gains).clip(0, 255).astype(np.uint8)
    return cv2.LUT(image, tables[None])


def camera(image, rng):
    """Blur or loss of resolution, noise, and JPEG artefacts, `[H, W, 3]` u8 to u8."""
    height, width = image.shape[:2]
    draw = rng.random()
    if draw < 0.25:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.6))
    elif draw < 0.35:
        shrink = rng.uniform(0.4, 0.9)
        small = cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        image = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    elif draw < 0.5:
        soft = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.7, 2.0))
        amount = rng.uniform(0.3, 1.2)
        image = cv2.addWeighted(image, 1 + amount, soft, -amount, 0)
    if rng.random() < 0.4:
        start = rng.integers(NOISE.size - image.size)
        noise = NOISE[start : start + image.size].reshape(image.shape)
        is_gray = bool((image[::16, ::16, 0] == image[::16, ::16, 1]).all())
        noise = cv2.merge([noise[..., 0]] * 3) if is_gray else noise
        image = cv2.add(image, noise * np.float32(rng.uniform(1.0, 12.0)), dtype=cv2.CV_8U)
    if rng.random() < 0.2:
        _, code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(20, 80))])
        image = cv2.imdecode(code, cv2.IMREAD_COLOR)
    return image


def augment(image, label, size, rng):
    """One augmented sample of `size` = (width, height)."""
    image, label = warp(image, label, size, rng)
    image = light(image, rng)
    image = colour(image, rng)
    return camera(image, rng), label

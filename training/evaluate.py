"""Measures the exported network's road class: precision, recall, F1 and IoU over pooled pixels, p(road) > 0.5.

Sets: CamVid val and IDD-Lite val, in colour and as gray; and the hand-labelled gray KITTI frames (never trained on),
squashed whole and as two overlapping tiles. Probabilities are resized to the label's size; void pixels are left out.
"""

import argparse
import tomllib
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from data import CAMVID_CLASSES, camvid_pairs, data_root, idd_pairs, read_label, read_rgb
from network import IGNORE

# Share of a tile that its neighbour also covers.
TILE_OVERLAP = 0.2


class Network:
    """The ONNX network and its manifest: `[H, W, 3]` u8 RGB of any size in, p(road) `[H, W]` f32 at that size out."""

    def __init__(self, manifest):
        with open(manifest, "rb") as file:
            self.manifest = tomllib.load(file)
        settings = onnxruntime.SessionOptions()
        settings.intra_op_num_threads = 1
        path = str(Path(manifest).with_name(self.manifest["file"]))
        self.session = onnxruntime.InferenceSession(path, settings, providers=["CPUExecutionProvider"])

    def probabilities(self, image):
        """`[7, 360, 480]` f32."""
        source = self.manifest["input"]
        size = (source["width"], source["height"])
        shrinks = image.shape[1] > size[0]
        resized = cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        pixels = (resized - np.float32(source["mean"])) * np.float32(source["scale"])
        (out,) = self.session.run(["probabilities"], {"image": pixels.transpose(2, 0, 1)[None]})
        return out[0]

    def road(self, image):
        names, road = self.manifest["classes"]["names"], self.manifest["classes"]["road"]
        summed = sum(self.probabilities(image)[names.index(name)] for name in road)
        return cv2.resize(summed, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)


def tiled_road(network, image):
    """p(road) of a wide image from its left and right part, averaged where they overlap."""
    width = image.shape[1]
    tile = int(np.ceil(width / (2.0 - TILE_OVERLAP)))
    total = np.zeros(image.shape[:2], np.float32)
    count = np.zeros(width, np.float32)
    for left in (0, width - tile):
        total[:, left : left + tile] += network.road(np.ascontiguousarray(image[:, left : left + tile]))
        count[left : left + tile] += 1
    return total / count


def to_gray(image):
    return cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)


def counts(probability, label, road_id):
    """True positives, false positives, false negatives over the labelled pixels."""
    predicted, road = probability > 0.5, label == road_id
    known = label != IGNORE
    return np.array([(predicted & road & known).sum(), (predicted & ~road & known).sum(), (~predicted & road & known).sum()])


def sets():
    """(name, pairs, id of road, map of stored ids or None, transform of the image, road function) of every measurement."""
    camvid, idd = camvid_pairs("val"), idd_pairs("val")
    kitti_root = data_root() / "kitti_odom03"
    kitti = [(kitti_root / "images" / label.name, label) for label in sorted((kitti_root / "labels").glob("*.png"))]
    whole = Network.road
    yield "CamVid val, colour", camvid, 0, CAMVID_CLASSES, None, whole
    yield "CamVid val, gray", camvid, 0, CAMVID_CLASSES, to_gray, whole
    yield "IDD-Lite val, colour", idd, 0, None, None, whole
    yield "IDD-Lite val, gray", idd, 0, None, to_gray, whole
    yield "KITTI 03, whole", kitti, 1, None, None, whole
    yield "KITTI 03, two tiles", kitti, 1, None, None, tiled_road


def overlay(image, probability, label, road_id):
    """Found road green, missed red, wrongly called road blue; void as it is."""
    predicted, road, known = probability > 0.5, label == road_id, label != IGNORE
    painted = image.copy()
    for mask, tint in ((predicted & road, (0, 255, 0)), (~predicted & road, (255, 0, 0)), (predicted & ~road, (0, 0, 255))):
        mask = mask & known
        painted[mask] = (painted[mask] * 0.6 + np.array(tint) * 0.4).astype(np.uint8)
    return painted


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).resolve().parents[1] / "models" / "road.toml"
    parser.add_argument("manifest", type=Path, nargs="?", default=default)
    parser.add_argument("--every", type=int, default=1, help="use every n-th frame of CamVid and IDD-Lite")
    parser.add_argument("--overlays", type=Path, help="folder for pictures of all KITTI and a few other frames")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    network = Network(options.manifest)
    if options.overlays is not None:
        options.overlays.mkdir(parents=True, exist_ok=True)

    print(f"{'set':22} frames  precision  recall     F1    IoU")
    for name, pairs, road_id, classes, transform, road in sets():
        is_kitti = name.startswith("KITTI")
        pairs = pairs if is_kitti else pairs[:: options.every]
        total = np.zeros(3, np.int64)
        for index, (image_path, label_path) in enumerate(pairs):
            image, label = read_rgb(image_path), read_label(label_path)
            label = label if classes is None else classes[label]
            image = image if transform is None else transform(image)
            probability = road(network, image)
            total += counts(probability, label, road_id)
            if options.overlays is not None and (is_kitti or index % 25 == 0):
                picture = overlay(image, probability, label, road_id)
                file_name = f"{name.replace(', ', '_').replace(' ', '_')}_{image_path.stem}.png"
                cv2.imwrite(str(options.overlays / file_name), picture[..., ::-1])
        hit, extra, missed = total
        precision, recall = hit / max(1, hit + extra), hit / max(1, hit + missed)
        f1, iou = 2 * hit / max(1, 2 * hit + extra + missed), hit / max(1, hit + extra + missed)
        print(f"{name:22} {len(pairs):6} {precision:10.4f} {recall:7.4f} {f1:6.4f} {iou:6.4f}", flush=True)


if __name__ == "__main__":
    main()

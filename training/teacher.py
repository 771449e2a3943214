"""Road probabilities of the OpenVINO network `road-segmentation-adas-0001` on IDD-Lite's training frames, one 8-bit PNG a frame.

IDD-Lite calls dirt shoulders and forecourts drivable; the other sets do not. `data.py` leaves such pixels out where this network, which
knows marked roads, sees none (see `contested`). Needs the package `openvino`; the network lies in the data folder.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import openvino

from data import data_root, idd_pairs, read_rgb, teacher_path

# The network's input, and its outputs that are driven on: 1 road, 3 marking (0 is background, 2 kerb).
WIDTH_PX, HEIGHT_PX = 896, 512
ROAD, MARKING = 1, 3


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the probabilities")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    model = data_root() / "omz_road_segmentation_adas_0001" / "FP32" / "road-segmentation-adas-0001.xml"
    network = openvino.Core().compile_model(model, "CPU", {"INFERENCE_NUM_THREADS": 1})
    for image_path, _ in idd_pairs("train"):
        image = read_rgb(image_path)
        # It takes BGR, 0..255.
        pixels = cv2.resize(image[..., ::-1], (WIDTH_PX, HEIGHT_PX)).transpose(2, 0, 1)[None].astype(np.float32)
        classes = network(pixels)[0][0]
        road = cv2.resize(classes[ROAD] + classes[MARKING], image.shape[1::-1])
        cv2.imwrite(str(teacher_path(out, image_path)), np.round(road * 255).clip(0, 255).astype(np.uint8))


if __name__ == "__main__":
    main()

"""Exports a checkpoint's averaged weights as ONNX, with the manifest beside it.

Out: `road.onnx`, input `image` `[1, 3, 360, 480]` f32, output `probabilities` `[1, 7, 360, 480]` f32 (softmax over classes), opset 16,
static shapes, batch normalisation folded into the convolutions; and `road.toml`, which holds the file's SHA-256.
Both are written under temporary names and renamed. With `--check`, ONNX Runtime must agree with PyTorch.
"""

import argparse
import hashlib
import time
from pathlib import Path

import onnx
import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torch.onnx.symbolic_helper import parse_args

from network import CLASSES, HEIGHT_PX, MEAN, SCALE, WIDTH_PX, RoadNetwork

OPSET = 16
# Largest difference of a probability between PyTorch and ONNX Runtime: f32 rounding, not a wrong operator.
TOLERANCE = 1e-4
TIMED_RUNS = 50

MANIFEST = """\
name = "road"
file = "road.onnx"
sha256 = "{sha256}"

[input]
name = "image"
width = {width}
height = {height}
order = "rgb"
# input = (pixel - mean) * scale, pixels 0..255
mean = {mean}
scale = {scale}

[output]
name = "probabilities"
width = {width}
height = {height}

[classes]
names = {names}
road = ["road"]
vehicle = ["vehicle"]
"""


def fold(module):
    """Folds each batch normalisation into the convolution before it, and drops the dilation of 1x1 kernels, in place."""
    for child in module.children():
        fold(child)
    if isinstance(module, nn.Sequential) and len(module) > 1 and isinstance(module[1], nn.BatchNorm2d):
        module[0] = fuse_conv_bn_eval(module[0], module[1])
        module[1] = nn.Identity()
    for child in module.children():
        if isinstance(child, nn.Conv2d) and child.kernel_size == (1, 1):
            child.dilation = (1, 1)


def load_network(checkpoint):
    """The averaged network of a checkpoint, in evaluation mode."""
    network = RoadNetwork()
    network.load_state_dict(torch.load(checkpoint, map_location="cpu")["average"])
    return network.eval()


def toml_list(values):
    return "[" + ", ".join(f'"{value}"' if isinstance(value, str) else f"{value:.9g}" for value in values) + "]"


@parse_args("v", "is", "i", "none")
def static_resize(graph, image, size, align_corners, _scales):
    """ONNX's Resize with a constant output size, in place of the shape arithmetic that PyTorch exports."""
    if align_corners:
        raise ValueError("the network resizes by half-pixel centres")
    sizes = graph.op("Constant", value_t=torch.tensor(image.type().sizes()[:2] + size))
    absent = graph.op("Constant", value_t=torch.tensor([], dtype=torch.float32))
    mode = {"coordinate_transformation_mode_s": "half_pixel", "mode_s": "linear"}
    return graph.op("Resize", image, absent, absent, sizes, **mode)


def write_onnx(network, path):
    torch.onnx.register_custom_op_symbolic("::upsample_bilinear2d", static_resize, OPSET)
    image = torch.zeros(1, 3, HEIGHT_PX, WIDTH_PX)
    torch.onnx.export(
        network,
        image,
        str(path),
        opset_version=OPSET,
        input_names=["image"],
        output_names=["probabilities"],
    )
    onnx.checker.check_model(onnx.load(str(path)), full_check=True)


def check(network, path):
    """Compares with PyTorch on seeded noise and times one thread. Raises if they differ."""
    import onnxruntime

    torch.manual_seed(0)
    image = torch.randn(1, 3, HEIGHT_PX, WIDTH_PX)
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), settings, providers=["CPUExecutionProvider"])
    (ours,) = session.run(["probabilities"], {"image": image.numpy()})
    with torch.no_grad():
        theirs = network(image).numpy()
    difference = float(abs(ours - theirs).max())
    if difference > TOLERANCE:
        raise ValueError(f"ONNX Runtime differs from PyTorch by {difference}")
    times_ms = []
    for _ in range(TIMED_RUNS):
        started = time.process_time()
        session.run(["probabilities"], {"image": image.numpy()})
        times_ms.append((time.process_time() - started) * 1e3)
    median_ms = sorted(times_ms)[TIMED_RUNS // 2]
    print(f"largest difference {difference:.1e}; one thread: median {median_ms:.1f} ms, least {min(times_ms):.1f} ms of CPU")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "models")
    parser.add_argument("--check", action="store_true", help="compare with ONNX Runtime and time it")
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)

    reference = load_network(options.checkpoint)
    folded = load_network(options.checkpoint)
    fold(folded)
    temporary = options.out / "road.onnx.tmp"
    write_onnx(folded, temporary)
    if options.check:
        check(reference, temporary)
    sha256 = hashlib.sha256(temporary.read_bytes()).hexdigest()
    manifest = options.out / "road.toml.tmp"
    manifest.write_text(
        MANIFEST.format(
            sha256=sha256,
            width=WIDTH_PX,
            height=HEIGHT_PX,
            mean=toml_list(MEAN),
            scale=toml_list(SCALE),
            names=toml_list(CLASSES),
        )
    )
    temporary.replace(options.out / "road.onnx")
    manifest.replace(options.out / "road.toml")
    print(f"{options.out / 'road.onnx'}: {sha256}")


if __name__ == "__main__":
    main()

"""The road network: Fast-SCNN with a quarter-resolution skip in its head.

In: `[N, 3, H, W]` f32, normalised RGB. Out: probabilities `[N, 7, H, W]` f32; while training, logits of that shape
and auxiliary logits `[N, 7, H / 8, W / 8]` instead.
Cost: about 0.7 GMAC at 480x360. Only plain operators, so that small inference engines can run the export.
Sources: Poudel et al., "Fast-SCNN: Fast Semantic Segmentation Network", 2019; the skip is that of DeepLabv3+ (Chen et al., 2018).
"""

import torch
from torch import nn
from torch.nn import functional as F

CLASSES = ("road", "non_drivable", "living", "vehicle", "roadside_object", "far_object", "sky")
# A label's value where nothing is known; no loss, no figure counts it.
IGNORE = 255
WIDTH_PX, HEIGHT_PX = 480, 360
# One mean and one scale for all channels: a gray camera enters as R = G = B and must stay neutral.
MEAN = (118.0, 118.0, 118.0)
SCALE = (1 / 60.0, 1 / 60.0, 1 / 60.0)
# Pyramid grids (rows, columns). All divide the 12x15 map that a 480x360 input gives, so the pools have fixed kernels when exported.
POOL_GRIDS = ((1, 1), (2, 3), (3, 5), (6, 5))
# Logits beyond it are probabilities of 0 or 1 already; its exponential, and seven times that, are far inside f32.
LOGIT_BOUND = 30.0
# A dilation means nothing to a 1x1 kernel, but with one PyTorch 1.13 takes the oneDNN path on a single thread (8 times faster than
# its fallback over a generic BLAS). `export.py` writes the kernels without it.
POINTWISE_DILATION = 2


def conv(inputs, outputs, kernel=1, stride=1, groups=1, relu=True):
    """Convolution, batch normalisation and, unless the layer is linear, ReLU."""
    dilation = POINTWISE_DILATION if kernel == 1 else 1
    layers = [
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, dilation, groups, bias=False),
        nn.BatchNorm2d(outputs),
    ]
    return nn.Sequential(*layers, nn.ReLU(inplace=True)) if relu else nn.Sequential(*layers)


def separable(inputs, outputs, stride=1):
    """Depthwise 3x3, then pointwise."""
    return nn.Sequential(conv(inputs, inputs, 3, stride, groups=inputs), conv(inputs, outputs))


def classifier(inputs):
    """Pointwise convolution to the classes' logits."""
    return nn.Conv2d(inputs, len(CLASSES), 1, dilation=POINTWISE_DILATION)


def spatial(x):
    """(H, W) of a map as plain integers, so that the export holds constants."""
    return tuple(int(side) for side in x.shape[2:])


def resize(x, size):
    return F.interpolate(x, size=size, mode="bilinear", align_corners=False)


class Bottleneck(nn.Module):
    """Inverted residual: expand, depthwise 3x3, project."""

    def __init__(self, inputs, outputs, stride, expansion=6):
        super().__init__()
        inner = inputs * expansion
        self.layers = nn.Sequential(
            conv(inputs, inner), conv(inner, inner, 3, stride, groups=inner), conv(inner, outputs, relu=False)
        )
        self.keeps_shape = stride == 1 and inputs == outputs

    def forward(self, x):
        return x + self.layers(x) if self.keeps_shape else self.layers(x)


class Pyramid(nn.Module):
    """Pyramid pooling: averages over the grids of `POOL_GRIDS`, joined with their input."""

    def __init__(self, channels):
        super().__init__()
        inner = channels // len(POOL_GRIDS)
        self.branches = nn.ModuleList(conv(channels, inner) for _ in POOL_GRIDS)
        self.join = conv(channels + inner * len(POOL_GRIDS), channels)

    def forward(self, x):
        size = spatial(x)
        pooled = [
            resize(branch(F.adaptive_avg_pool2d(x, grid)), size) for branch, grid in zip(self.branches, POOL_GRIDS)
        ]
        return self.join(torch.cat([x, *pooled], dim=1))


class RoadNetwork(nn.Module):
    """Fast-SCNN's three stages (learning to downsample, global features, fusion), then the head with the skip."""

    def __init__(self):
        super().__init__()
        self.at_half = conv(3, 32, 3, 2)
        self.at_quarter = separable(32, 48, 2)
        self.detail = separable(48, 48)
        self.at_eighth = separable(48, 64, 2)
        stages = []
        inputs = 64
        for outputs, stride, repeats in ((64, 2, 3), (96, 2, 3), (128, 1, 3)):
            for index in range(repeats):
                stages.append(Bottleneck(inputs, outputs, stride if index == 0 else 1))
                inputs = outputs
        self.context = nn.Sequential(*stages, Pyramid(128))
        self.fuse_context = nn.Sequential(conv(128, 128, 3, groups=128), conv(128, 128, relu=False))
        self.fuse_eighth = conv(64, 128, relu=False)
        self.coarse = nn.Sequential(separable(128, 128), separable(128, 128))
        self.head_coarse = conv(128, 48, relu=False)
        self.head_detail = conv(48, 48, relu=False)
        self.head = nn.Sequential(separable(48, 48), separable(48, 48), classifier(48))
        self.auxiliary = classifier(128)

    def quarter_logits(self, image):
        """Logits at 1/4 resolution, and the auxiliary ones at 1/8."""
        quarter = self.at_quarter(self.at_half(image))
        detail = quarter + self.detail(quarter)
        eighth = self.at_eighth(detail)
        context = resize(self.context(eighth), spatial(eighth))
        coarse = self.coarse(F.relu(self.fuse_context(context) + self.fuse_eighth(eighth)))
        joined = F.relu(resize(self.head_coarse(coarse), spatial(detail)) + self.head_detail(detail))
        return self.head(joined), self.auxiliary(coarse)

    def forward(self, image):
        logits, auxiliary = self.quarter_logits(image)
        if self.training:
            return resize(logits, spatial(image)), auxiliary
        # The softmax written out: ONNX Runtime transposes for one over channels (3 ms instead of 20), and a bound on the logits, which
        # merges into the last convolution, keeps the exponentials finite without a maximum over classes.
        exponentials = resize(logits.clamp(-LOGIT_BOUND, LOGIT_BOUND), spatial(image)).exp()
        return exponentials / exponentials.sum(dim=1, keepdim=True)

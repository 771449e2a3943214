"""The training loss: cross-entropy (classes and road edges weighted), a soft Dice on road, and an auxiliary head.

In: logits `[N, 7, H, W]` f32, auxiliary logits `[N, 7, h, w]` f32, label `[N, H, W]` i64, edge `[N, H, W]` f32. Out: a scalar.
"""

import torch
from torch.nn import functional as F

from network import IGNORE

# road, non-drivable (the caller's), living, vehicle, roadside object, far object, sky.
CLASS_WEIGHTS = (1.0, None, 1.5, 1.2, 1.2, 0.8, 0.6)
EDGE_WEIGHT = 2.0
DICE_WEIGHT = 0.5
AUXILIARY_WEIGHT = 0.4
SMOOTHING = 0.02


def cross_entropy(log_p, label, class_weights, pixel_weight):
    """Weighted mean over the labelled pixels, with label smoothing."""
    known = label != IGNORE
    target = torch.where(known, label, torch.zeros_like(label))
    weight = class_weights[target] * pixel_weight * known
    picked = log_p.gather(1, target.unsqueeze(1)).squeeze(1)
    loss = (1.0 - SMOOTHING) * picked + SMOOTHING * log_p.mean(dim=1)
    return -(loss * weight).sum() / weight.sum().clamp(min=1.0)


def road_dice(log_p, label):
    """One minus the soft Dice coefficient of road, over the labelled pixels of the batch."""
    known = (label != IGNORE).float()
    road = (label == 0).float()
    p = log_p[:, 0].exp() * known
    return 1.0 - 2.0 * (p * road).sum() / (p.sum() + road.sum()).clamp(min=1.0)


def road_loss(logits, auxiliary, label, edge, beside_weight):
    """The sum of all terms; `beside_weight` is the weight of the non-drivable class."""
    class_weights = torch.tensor([beside_weight if weight is None else weight for weight in CLASS_WEIGHTS])
    log_p = F.log_softmax(logits, dim=1)
    fine = cross_entropy(log_p, label, class_weights, 1.0 + EDGE_WEIGHT * edge) + DICE_WEIGHT * road_dice(log_p, label)
    small = F.interpolate(label[:, None].float(), size=auxiliary.shape[2:], mode="nearest")[:, 0].long()
    return fine + AUXILIARY_WEIGHT * cross_entropy(F.log_softmax(auxiliary, dim=1), small, class_weights, 1.0)

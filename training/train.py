"""Trains the road network; writes checkpoints that a later phase, or an interrupted run, resumes from.

A phase runs from the checkpoint's step to `--until`, its learning rate falling along a cosine from `--lr` to `--lr-end`.
The schedule counts steps, not time, so a run repeats on any machine. See README.md for the phases of the shipped network.
"""

import argparse
import math
import os
import time
from pathlib import Path

import cv2
import torch
from torch.utils.data import DataLoader

from data import RoadSamples, training_sources
from loss import road_loss
from network import MEAN, SCALE, RoadNetwork

WARM_UP_STEPS = 200
EMA_DECAY = 0.998
WEIGHT_DECAY = 0.01
LOADER_NICENESS = 5


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the checkpoints")
    parser.add_argument("--resume", type=Path, help="checkpoint to continue from")
    parser.add_argument("--until", type=int, required=True, help="step at which this phase ends")
    parser.add_argument("--lr", type=float, required=True, help="learning rate at the start of the phase")
    parser.add_argument("--lr-end", type=float, required=True, help="learning rate at its end")
    parser.add_argument("--size", type=int, nargs=2, default=(480, 360), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--camvid-share", type=float, default=0.38)
    parser.add_argument("--simulated", type=Path, help="folder of simulated frames")
    parser.add_argument("--simulated-share", type=float, default=0.18)
    parser.add_argument("--teacher", type=Path, help="folder written by teacher.py")
    # Pavement and verge are rare and look like road: at 1.5 most pavement of CamVid val was called road. A high weight learns the
    # difference but moves the boundary into the road, so the last phase lowers it.
    parser.add_argument("--beside-weight", type=float, default=4.0, help="weight of the non-drivable class in the loss")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--checkpoint-s", type=float, default=300.0, help="seconds between checkpoints")
    return parser.parse_args()


def start_loader(_worker):
    os.nice(LOADER_NICENESS)
    cv2.setNumThreads(1)


def learning_rate(step, first, options):
    """Cosine within the phase; a linear warm-up at the very first steps."""
    done = (step - first) / max(1, options.until - first)
    cosine = options.lr_end + (options.lr - options.lr_end) * 0.5 * (1 + math.cos(math.pi * done))
    return cosine * min(1.0, (step + 1) / WARM_UP_STEPS)


def update_average(average, network, step):
    """Exponential moving average of weights and of the running statistics; short-sighted while young."""
    decay = min(EMA_DECAY, (1 + step) / (10 + step))
    for name, value in network.state_dict().items():
        if value.dtype.is_floating_point:
            average[name].lerp_(value, 1 - decay)
        else:
            average[name].copy_(value)


def save(path, network, average, optimiser, step):
    """Writes a temporary file, then renames it: a reader never sees half a checkpoint."""
    temporary = path.with_suffix(".tmp")
    state = {"network": network.state_dict(), "average": average, "optimiser": optimiser.state_dict(), "step": step}
    torch.save(state, temporary)
    temporary.replace(path)


def main():
    options = arguments()
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    options.out.mkdir(parents=True, exist_ok=True)

    network = RoadNetwork().train().to(memory_format=torch.channels_last)
    decayed = [p for p in network.parameters() if p.ndim > 1]
    free = [p for p in network.parameters() if p.ndim <= 1]
    optimiser = torch.optim.AdamW([{"params": decayed, "weight_decay": WEIGHT_DECAY}, {"params": free, "weight_decay": 0.0}])
    average = {name: value.clone() for name, value in network.state_dict().items()}
    first = 0
    if options.resume is not None:
        state = torch.load(options.resume, map_location="cpu")
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        average, first = state["average"], state["step"]

    sources = training_sources(options.camvid_share, options.simulated, options.simulated_share, options.teacher)
    print("sources:", {source.name: len(source.images) for source in sources}, "first step:", first, flush=True)
    count = (options.until - first) * options.batch
    samples = RoadSamples(sources, tuple(options.size), first * options.batch, count, options.seed)
    loader = DataLoader(samples, options.batch, num_workers=1, prefetch_factor=8, worker_init_fn=start_loader)
    mean, scale = torch.tensor(MEAN).view(1, 3, 1, 1), torch.tensor(SCALE).view(1, 3, 1, 1)

    started = saved = time.monotonic()
    running_loss = 0.0
    for step, (image, label, edge) in enumerate(loader, start=first):
        for group in optimiser.param_groups:
            group["lr"] = learning_rate(step, first, options)
        pixels = (image.permute(0, 3, 1, 2).float() - mean) * scale
        loss = road_loss(*network(pixels), label.long(), edge.float(), options.beside_weight)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        update_average(average, network, step)

        running_loss += loss.item()
        if (step + 1) % 50 == 0:
            rate_ms = (time.monotonic() - started) / (step + 1 - first) / options.batch * 1e3
            lr = optimiser.param_groups[0]["lr"]
            print(f"step {step + 1} loss {running_loss / 50:.4f} lr {lr:.2e} {rate_ms:.1f} ms an image", flush=True)
            running_loss = 0.0
        if time.monotonic() - saved > options.checkpoint_s or step + 1 == options.until:
            saved = time.monotonic()
            save(options.out / "last.pt", network, average, optimiser, step + 1)


if __name__ == "__main__":
    main()

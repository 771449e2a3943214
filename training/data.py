"""Training images: CamVid, IDD-Lite and simulated frames, decoded once into memory, and drawn by fixed shares.

Out: image `[H, W, 3]` u8 RGB, label `[H, W]` u8 (a class of `network.CLASSES`, or `IGNORE`), road edge `[H, W]` u8 (1 near the
road's boundary). Every sample depends on the seed and its index alone, so a resumed run continues the same stream.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from torch.utils.data import Dataset

from augment import augment
from network import CLASSES, IGNORE

ROAD, NON_DRIVABLE = CLASSES.index("road"), CLASSES.index("non_drivable")
# Share of an image's pixels beside the road from which it counts as full of them.
BESIDE_FULL = 0.05
# CamVid's ids (sky building pole road pavement tree sign fence car pedestrian cyclist void) as classes of the network.
CAMVID_CLASSES = np.array([6, 5, 4, 0, 1, 5, 4, 4, 3, 2, 2, IGNORE], np.uint8)
# The teacher has a say where it finds this share of the road; it denies road below this probability (of 255).
TEACHER_FOUND = 0.6
TEACHER_DENIES = 64
# The drive that holds CamVid's `val`: its frames in `train` lie seconds from it, so none is trained on.
CAMVID_HELD_OUT = "0016E5"
# Half-width, pixels, of the band along the road's boundary that weighs more in the loss.
EDGE_PX = 4


@dataclass
class Source:
    """One data set in memory, with the share of samples drawn from it."""

    name: str
    share: float
    images: list
    labels: list
    chances: np.ndarray


def data_root():
    """The data folder: `FREESPACE_DATA`, or `../shared/data` beside the repository."""
    fallback = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("FREESPACE_DATA", fallback))


def read_rgb(path):
    """`[H, W, 3]` u8 RGB; a gray file gives R = G = B."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise FileNotFoundError(path)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_label(path):
    """`[H, W]` u8, as stored."""
    label = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if label is None:
        raise FileNotFoundError(path)
    return label


def camvid_pairs(split):
    """(image, label) paths of CamVid's `train`, without the held-out drive, or `val`."""
    folder = data_root() / "camvid"
    images = sorted(path for path in (folder / split).iterdir() if path.suffix in (".jpg", ".png"))
    if split == "train":
        images = [path for path in images if not path.name.startswith(CAMVID_HELD_OUT)]
    return [(path, folder / f"{split}annot" / f"{path.stem}.png") for path in images]


def idd_pairs(split):
    """(image, label) paths of IDD-Lite's `train` or `val`."""
    folder = data_root() / "idd_lite"
    labels = sorted((folder / "gtFine" / split).glob("*/*_label.png"))
    pairs = []
    for label in labels:
        stem = label.name[: -len("_label.png")]
        (image,) = (folder / "leftImg8bit" / split / label.parent.name).glob(f"{stem}_image.*")
        pairs.append((image, label))
    return pairs


def teacher_path(folder, image_path):
    """Where `teacher.py` keeps its probabilities for a frame of IDD-Lite."""
    return Path(folder) / f"{image_path.parent.name}_{image_path.stem}.png"


def contested(label, teacher):
    """Mask of drivable pixels that the teacher denies, in a frame where it finds most of the road otherwise.

    Where it finds little, as on dirt roads, it has no say.
    """
    road = label == ROAD
    found = teacher > 127
    has_say = (road & found).sum() > TEACHER_FOUND * road.sum()
    return road & (teacher < TEACHER_DENIES) & has_say


def simulated_pairs(folder):
    """(image, label) paths of a folder of `NNNNNN.png` with `NNNNNN_label.png`, in the network's classes."""
    labels = sorted(Path(folder).glob("*_label.png"))
    return [(label.with_name(label.name.replace("_label", "")), label) for label in labels]


def load(name, share, pairs, classes=None):
    """Reads all `pairs`; `classes` maps stored ids to the network's."""
    labels = [read_label(label) for _, label in pairs]
    if classes is not None:
        labels = [classes[label] for label in labels]
    # Pavement and verge border the road and look like it, and are rare: frames with them come up to three times as often.
    beside = np.array([(label == NON_DRIVABLE).mean() for label in labels])
    chances = 1.0 + 2.0 * np.minimum(beside / BESIDE_FULL, 1.0)
    return Source(name, share, [read_rgb(image) for image, _ in pairs], labels, chances / chances.sum())


def training_sources(camvid_share, simulated_folder=None, simulated_share=0.0, teacher_folder=None):
    """The sources of a training run; shares sum to one, IDD-Lite takes what is left."""
    sources = [load("camvid", camvid_share, camvid_pairs("train"), CAMVID_CLASSES)]
    if simulated_folder is not None:
        sources.append(load("simulated", simulated_share, simulated_pairs(simulated_folder)))
    rest = 1.0 - sum(source.share for source in sources)
    idd = load("idd", rest, idd_pairs("train"))
    if teacher_folder is not None:
        for (image_path, _), label in zip(idd_pairs("train"), idd.labels):
            label[contested(label, read_label(teacher_path(teacher_folder, image_path)))] = IGNORE
    return [*sources, idd]


def road_edge(label):
    """1 within `EDGE_PX` of a change between road and anything labelled, else 0."""
    kernel = np.ones((2 * EDGE_PX + 1, 2 * EDGE_PX + 1), np.uint8)
    near_road = cv2.dilate((label == ROAD).astype(np.uint8), kernel)
    near_rest = cv2.dilate(((label != ROAD) & (label != IGNORE)).astype(np.uint8), kernel)
    return near_road & near_rest


class RoadSamples(Dataset):
    """`count` augmented samples, the first being number `first` of the stream of `seed`."""

    def __init__(self, sources, size, first, count, seed):
        self.sources, self.size, self.first, self.count, self.seed = sources, size, first, count, seed

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        rng = np.random.default_rng([self.seed, self.first + index])
        source = self.sources[rng.choice(len(self.sources), p=[source.share for source in self.sources])]
        chosen = rng.choice(len(source.images), p=source.chances)
        image, label = augment(source.images[chosen], source.labels[chosen], self.size, rng)
        return image, label, road_edge(label)

"""Reads what the module sent on CAN the way a user's tools would: cantools for the signals, an own check of the E2E protection.

In: a log of `candump -L` and the DBC file. Out: one summary line; exit code 1 on any failure.
Each frame of the module must be protected, decode to values that the DBC allows, and encode to the same bytes again; then frames
that were damaged on purpose, always the same ones, must every one be refused.

Usage: can_frames.py LOG [--dbc config/freespace.dbc] [--bus vcan0] [--lost N] [--corrupted 1000]
"""

import argparse
import random
import re
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cantools

import e2e

DBC = Path(__file__).resolve().parents[2] / "config" / "freespace.dbc"
# (seconds) interface identifier#data, or identifier##flags data for CAN FD.
LINE = re.compile(r"^\((?P<time>\d+\.\d+)\) (?P<bus>\S+) (?P<id>[0-9A-Fa-f]+)#(?:#[0-9A-Fa-f])?(?P<data>[0-9A-Fa-f]*)(?: [TR])?$")
# A receiver meets a burst as the check sum reads it. CRC-8 finds each of up to 8 bits, CRC-16 of up to 16.
BURST_BITS = {"11A": 8, "5": 16}


@dataclass(frozen=True)
class Frame:
    line: int
    identifier: int
    data: bytes


def read_log(path: str, bus: str | None, identifiers: set[int]) -> list[Frame]:
    frames = []
    try:
        lines = Path(path).read_text().splitlines()
    except OSError as error:
        raise SystemExit(f"can_frames: {path}: {error.strerror}") from error
    for number, text in enumerate(lines, 1):
        match = LINE.match(text.strip())
        if not match:
            if "#R" in text or not text.strip():
                continue
            raise SystemExit(f"can_frames: {path}:{number}: not a line of candump -L: {text!r}")
        # Eight digits are an extended identifier; the module's are standard ones.
        if len(match["id"]) != 3 or int(match["id"], 16) not in identifiers or (bus and match["bus"] != bus):
            continue
        frames.append(Frame(number, int(match["id"], 16), bytes.fromhex(match["data"])))
    return frames


def largest_or_smallest(signal, raw: int) -> bool:
    """Whether a raw value is the one that the DBC's comment calls invalid."""
    return raw == (-(1 << (signal.length - 1)) if signal.is_signed else (1 << signal.length) - 1)


def signal_problem(signal, value, raw: int) -> str | None:
    if largest_or_smallest(signal, raw):
        return None
    if signal.choices and raw not in signal.choices:
        return f"{signal.name}: {raw} has no name"
    low, high = signal.minimum, signal.maximum
    tolerance = abs(signal.scale) / 2
    if (low is not None and value < low - tolerance) or (high is not None and value > high + tolerance):
        return f"{signal.name}: {value} is not in {low} to {high}"
    return None


CELLS = "FREESPACE_GRID_CELLS"


def decode_problem(message, data: bytes) -> str | None:
    """What cantools finds wrong with a frame."""
    try:
        values = message.decode(data, decode_choices=False)
        raws = message.decode(data, decode_choices=False, scaling=False)
        again = message.encode(raws, scaling=False, strict=False)
    except (cantools.Error, ValueError) as error:
        return f"{message.name}: {error}"
    for signal in message.signals:
        if signal.name in raws and (problem := signal_problem(signal, values[signal.name], raws[signal.name])):
            return f"{message.name}.{problem}"
    # What follows the signals of the frames of cells is a table, which no DBC describes.
    end = data_end(message) if message.name == CELLS else len(data)
    return None if again[:end] == data[:end] else f"{message.name}: bits outside every signal are set"


def data_end(message) -> int:
    """Bytes that the signals, little-endian, reach into."""
    return -(-max(signal.start + signal.length for signal in message.signals) // 8)


class Check:
    """One pass over a log."""

    def __init__(self, database) -> None:
        self.messages = {message.frame_id: message for message in database.messages}
        self.receivers = {i: e2e.Receiver(i, m.length) for i, m in self.messages.items()}
        self.problems: list[str] = []
        self.seen: Counter[str] = Counter()
        self.lost = 0

    def frame(self, frame: Frame) -> None:
        message, receiver = self.messages[frame.identifier], self.receivers[frame.identifier]
        self.seen[message.name] += 1
        problem = receiver.refusal(frame.data)
        if problem:
            problem = f"{message.name}: E2E: {problem}"
        else:
            self.lost += receiver.lost_before(frame.data)
            problem = decode_problem(message, frame.data)
        if problem:
            self.problems.append(f"line {frame.line}: {problem}")


def flip(data: bytes, profile: e2e.Profile, bits: list[int]) -> bytes:
    """Flips bits, counted in the order in which the check sum reads the frame: its own bytes last."""
    order = [*range(profile.crc_bytes, len(data)), *range(profile.crc_bytes)]
    damaged = bytearray(data)
    for bit in bits:
        damaged[order[bit // 8]] ^= 0x80 >> (bit % 8)
    return bytes(damaged)


def damage(frame: Frame, others: list[int], chance: random.Random) -> tuple[str, Frame]:
    """A damaged copy, and how it was damaged."""
    profile, size = e2e.profile_of(len(frame.data)), 8 * len(frame.data)
    kind = chance.choice(("bit", "burst", "identifier", "repeated"))
    if kind == "bit":
        return kind, Frame(frame.line, frame.identifier, flip(frame.data, profile, [chance.randrange(size)]))
    if kind == "burst":
        # Not across the end of what the check sum covers: its own bytes may lie in another order there.
        covered = size - 8 * profile.crc_bytes
        length = chance.randint(2, BURST_BITS[profile.name])
        first = chance.randrange(covered - length + 1)
        inner = [bit for bit in range(first + 1, first + length - 1) if chance.random() < 0.5]
        return kind, Frame(frame.line, frame.identifier, flip(frame.data, profile, [first, *inner, first + length - 1]))
    if kind == "identifier" and others:
        return kind, Frame(frame.line, chance.choice(others), frame.data)
    return "repeated", frame


def refused(frame: Frame, original: Frame, check: Check) -> bool:
    """Whether a receiver that has just taken the undamaged original refuses the frame."""
    message = check.messages[frame.identifier]
    receiver = e2e.Receiver(frame.identifier, message.length)
    receiver.last = receiver.profile.counter(original.data) if frame == original else None
    return receiver.refusal(frame.data) is not None


def corrupt(frames: list[Frame], count: int, check: Check) -> Counter[str]:
    chance = random.Random(20_260_101)
    lengths = {i: m.length for i, m in check.messages.items()}
    kinds: Counter[str] = Counter()
    for _ in range(count):
        frame = chance.choice(frames)
        others = [i for i, length in lengths.items() if i != frame.identifier and length == lengths[frame.identifier]]
        kind, damaged = damage(frame, others, chance)
        kinds[kind] += 1
        if not refused(damaged, frame, check):
            check.problems.append(f"line {frame.line}: {kind}: {damaged.identifier:03X}#{damaged.data.hex()} was not refused")
    return kinds


def main() -> int:
    arguments = argparse.ArgumentParser(description="Checks what the module sent on CAN.")
    arguments.add_argument("log", help="a log of candump -L")
    arguments.add_argument("--dbc", default=str(DBC))
    arguments.add_argument("--bus", help="frames of this interface alone")
    arguments.add_argument("--lost", type=int, default=0, help="frames that may be missing, by their counters")
    arguments.add_argument("--corrupted", type=int, default=1000, help="damaged frames to try")
    options = arguments.parse_args()
    e2e.self_test()
    check = Check(cantools.database.load_file(options.dbc))
    frames = read_log(options.log, options.bus, set(check.messages))
    for frame in frames:
        check.frame(frame)
    missing = [m.name for m in check.messages.values() if len(m.senders) and not check.seen[m.name] and m.length <= 8]
    check.problems += [f"{name}: never seen" for name in missing]
    if check.lost > options.lost:
        check.problems.append(f"{check.lost} frames are missing, by their counters")
    sound = not check.problems
    kinds = corrupt(frames, options.corrupted, check) if frames and sound else Counter()
    for problem in check.problems[:20]:
        print(f"can_frames: {problem}", file=sys.stderr)
    tried = ", ".join(f"{kinds[kind]} {kind}" for kind in sorted(kinds)) or "none tried"
    verdict = "FAILED" if check.problems else "ok"
    print(
        f"can_frames: {verdict}: {len(frames)} frames of {len(check.seen)} messages, {check.lost} lost, "
        f"{sum(kinds.values())} damaged ({tried}), {len(check.problems)} problems"
    )
    return 1 if check.problems else 0


if __name__ == "__main__":
    sys.exit(main())

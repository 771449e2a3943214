"""AUTOSAR end-to-end protection, receiver's side, written from the protocol specification (PRS_E2EProtocol), not from the module.

In: an identifier and the bytes of a frame. Out: the counter, or why the frame is refused.
Profile 11A (classic frames): byte 0 is a CRC-8 (polynomial 0x1D, start and final value 0) over the data id, low byte first, and
bytes 1 to the last; the low nibble of byte 1 counts 0 to 14. Profile 5 (CAN FD): bytes 0 and 1 are a CRC-16/IBM-3740, low byte
first, over bytes 2 to the last and the data id, low byte first; byte 2 counts 0 to 255.
"""

from dataclasses import dataclass
from typing import Callable

from crccheck.crc import Crc8Base, Crc16Base

DATA_ID_BASE = 0x4600


class Crc8E2e(Crc8Base):
    _poly, _initvalue, _xor_output = 0x1D, 0x00, 0x00
    _check_result = 0x37


class Crc16E2e(Crc16Base):
    _poly, _initvalue, _xor_output = 0x1021, 0xFFFF, 0x0000
    _check_result = 0x29B1


@dataclass(frozen=True)
class Profile:
    """Where a profile keeps its check sum and counter, and in which order the check sum reads the frame."""

    name: str
    crc_bytes: int
    counters: int
    counter: Callable[[bytes], int]
    sum_of: Callable[[int, bytes], int]

    def checks_out(self, data_id: int, data: bytes) -> bool:
        return int.from_bytes(data[: self.crc_bytes], "little") == self.sum_of(data_id, data)


P11A = Profile("11A", 1, 15, lambda d: d[1] & 0x0F, lambda i, d: Crc8E2e.calc(i.to_bytes(2, "little") + d[1:]))
P05 = Profile("5", 2, 256, lambda d: d[2], lambda i, d: Crc16E2e.calc(d[2:] + i.to_bytes(2, "little")))

# The examples that the specification prints: data id, frame without its check sum, check sum.
EXAMPLES = (
    (P11A, 0x123, bytes(8), 0xCC),
    (P11A, 0x123, bytes([0, 1, 0, 0, 0, 0, 0, 0]), 0x91),
    (P05, 0x1234, bytes(8), 0xCA1C),
)


def self_test() -> None:
    """Raises where this file does not do what the specification's examples say."""
    for profile, data_id, data, expected in EXAMPLES:
        found = profile.sum_of(data_id, data)
        if found != expected:
            raise AssertionError(f"profile {profile.name}: {found:#x} instead of {expected:#x}")


def profile_of(length: int) -> Profile:
    """Classic frames carry profile 11A, CAN FD frames profile 5."""
    return P11A if length <= 8 else P05


class Receiver:
    """The state machine of one data id: what a user's receiver would say of each frame."""

    def __init__(self, identifier: int, length: int) -> None:
        self.identifier, self.length = identifier, length
        self.profile = profile_of(length)
        self.last: int | None = None

    def refusal(self, data: bytes) -> str | None:
        """Why the frame is refused; nothing is remembered of it."""
        if len(data) != self.length:
            return "length"
        if not self.profile.checks_out(DATA_ID_BASE + self.identifier, data):
            return "check sum"
        counter = self.profile.counter(data)
        if counter >= self.profile.counters:
            return "counter"
        return "repeated" if counter == self.last else None

    def lost_before(self, data: bytes) -> int:
        """Takes a good frame; returns how many counters were skipped before it."""
        counter = self.profile.counter(data)
        skipped = 0 if self.last is None else (counter - self.last - 1) % self.profile.counters
        self.last = counter
        return skipped

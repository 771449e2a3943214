"""The free-space message in shared memory, and its reader. Made by `cargo run -p freespace-reader --example write_bindings`.

The reader loads libfreespace_reader.so, built by `cargo build --release -p freespace-reader`: from FREESPACE_READER_LIBRARY, or
where the system finds libraries. The package iceoryx2 reads the same messages without it: reader/examples/read_iceoryx2.py.
Unknown is not free: a cell may be driven on where its occupancy is 0 to FREE_AT_MOST, nowhere else.
"""

import ctypes
import os
import time

MAGIC = 1162170950
VERSION = 1
BYTES = 720320
MAX_CELLS = 240000
SECTORS = 32
UNKNOWN = -1
FREE_AT_MOST = 35
LEVEL_FULL = 0
LEVEL_NO_REFINEMENT = 1
LEVEL_NO_FRESH_NETWORK = 2
LEVEL_NO_FRESH_MAP = 3
LEVEL_MOVED = 4
LEVEL_INVALID = 5
# Where the service's files lie, and the version of iceoryx2 that lays them out.
FOLDER = "/dev/shm/freespace"
PREFIX = "freespace_"
ICEORYX2 = "0.10.0"
OK = 0
NOTHING = 1
NO_MODULE = -1
BAD_NAME = -2
TOO_MANY_READERS = -3
WRONG_LAYOUT = -4
NOT_PERMITTED = -5
FAILED = -6
BAD_ARGUMENT = -7
CODES = {
    OK: "it worked",
    NOTHING: "no message came in time, or a signal came",
    NO_MODULE: "nobody publishes under this name: start the module, or correct the name",
    BAD_NAME: "this is no name of a service",
    TOO_MANY_READERS: "no room for another reader: raise max_readers in [shared_memory]",
    WRONG_LAYOUT: "the module publishes another layout: build both from one version",
    NOT_PERMITTED: "the shared memory may not be opened: run as the module's user",
    FAILED: "the shared memory failed: look at the room in /dev/shm, open the reader anew",
    BAD_ARGUMENT: "a pointer is null, or a name is no text",
}
LEVELS = ["full", "no_refinement", "no_fresh_network", "no_fresh_map", "moved", "invalid"]
FAULTS = {
    0x00000001: "image_black",
    0x00000002: "image_overexposed",
    0x00000004: "image_frozen",
    0x00000008: "image_blocked",
    0x00000010: "camera_silent",
    0x00000020: "wheels_silent",
    0x00000040: "wheels_slip",
    0x00000080: "tracking_lost",
    0x00000100: "network_late",
    0x00000200: "network_failed",
    0x00000400: "map_late",
    0x00000800: "cut_stopped",
    0x00001000: "plane_held",
    0x00002000: "scale_held",
    0x00004000: "deadline_missed",
    0x00008000: "clock_offset",
    0x00010000: "handover_dropped",
    0x00020000: "can_send_failed",
    0x00040000: "stage_panicked",
    0x00080000: "shutting_down",
    0x00100000: "rights_lacking",
    0x00200000: "grid_stale",
    0x00400000: "key_frame_missing",
    0x00800000: "sharing_failed",
}


class Message(ctypes.Structure):
    """The message; each field with its offset."""

    _fields_ = [
        # 0: `FREE`, 0x45455246.
        ("magic", ctypes.c_uint32),
        # 4: Layout version, 1; a reader refuses others.
        ("version", ctypes.c_uint16),
        # 6: Bytes before the cells: the offset of `occupancy`.
        ("header_bytes", ctypes.c_uint16),
        # 8: Size of the message.
        ("total_bytes", ctypes.c_uint32),
        # 12: Faults, one bit each.
        ("faults", ctypes.c_uint32),
        # 16: Counts the module's messages, from 0 at its start; a gap is a message that this reader missed.
        ("sequence", ctypes.c_uint64),
        # 24: Capture stamp of the key frame, microseconds; CLOCK_MONOTONIC for a live camera.
        ("capture_micros", ctypes.c_uint64),
        # 32: When the message was published, on the same clock.
        ("publish_micros", ctypes.c_uint64),
        # 40: When it had to be, on the same clock.
        ("deadline_micros", ctypes.c_uint64),
        # 48: Time from capture to deadline.
        ("budget_micros", ctypes.c_uint32),
        # 52: Time from capture to publication.
        ("used_micros", ctypes.c_uint32),
        # 56: Quality: 0 full, 1 no refinement, 2 no fresh network, 3 no fresh map, 4 moved, 5 invalid: do not use.
        ("level", ctypes.c_uint8),
        # 57: Source of the metric scale: 0 unknown, 1 wheels, 2 camera height, 3 held.
        ("scale", ctypes.c_uint8),
        # 58: Source of the pose: 0 dead reckoning, 1 good, 2 standstill, 3 weak.
        ("tracking", ctypes.c_uint8),
        # 59: What held the answer back: 0 nothing, 1 frame, 2 track, 3 map, 4 priors, 5 segmentation, 6 crf, 7 grid, 8 emit, 9 camera.
        ("blame", ctypes.c_uint8),
        # 60: Landmarks on the road plane; 0 where the plane was held.
        ("plane_inliers", ctypes.c_uint32),
        # 64: Vehicle origin in the world, metres.
        ("position_m", ctypes.c_double * 3),
        # 88: Vehicle orientation in the world, quaternion x y z w.
        ("orientation", ctypes.c_double * 4),
        # 120: Speed along the vehicle's x axis, m/s.
        ("speed_mps", ctypes.c_float),
        # 124: Yaw rate, rad/s, positive left.
        ("yaw_rate_radps", ctypes.c_float),
        # 128: Unit normal of the road plane in camera space.
        ("plane_normal", ctypes.c_float * 3),
        # 140: Height of the camera over the road plane, metres.
        ("plane_offset_m", ctypes.c_float),
        # 144: Robust spread of the landmarks about the plane, metres.
        ("plane_sigma_m", ctypes.c_float),
        # 148: Rows of the grid; row 0 is nearest, rows go ahead.
        ("rows", ctypes.c_uint32),
        # 152: Columns of the grid; column 0 is the right edge, columns go left.
        ("columns", ctypes.c_uint32),
        # 156: Edge of a cell, metres.
        ("cell_m", ctypes.c_float),
        # 160: Bearing of the right edge of sector 0, radians, positive left.
        ("sector_first_rad", ctypes.c_float),
        # 164: Width of a sector, radians.
        ("sector_rad", ctypes.c_float),
        # 168: Sectors of the boundary.
        ("sectors", ctypes.c_uint32),
        # 172: Free distance in each sector from the vehicle's origin, metres; what is unknown is not free.
        ("free_m", ctypes.c_float * 32),
        # 300: Corner of the grid (near, right) in the vehicle: metres ahead of the rear axle.
        ("origin_x_m", ctypes.c_float),
        # 304: The same corner: metres left of the centre line.
        ("origin_y_m", ctypes.c_float),
        # 308: 0.
        ("reserved", ctypes.c_uint32),
        # 312: CLOCK_MONOTONIC when the publisher handed it over to be shared; with `used_micros` it gives the age on any clock.
        ("handed_over_micros", ctypes.c_uint64),
        # 320: Row by row: -1 unknown, 0 free to 100 occupied; a car may drive on 0 to 35. Unknown is not free.
        ("occupancy", ctypes.c_int8 * 240000),
        # 240320: Why each cell is so: 0 unseen, 1 plane, 2 box, 3 network, 4 previous key frame.
        ("reason", ctypes.c_uint8 * 240000),
        # 480320: Time since each cell was last seen, 0.1 s; 255 is 25.5 s or more, or never.
        ("age", ctypes.c_uint8 * 240000),
    ]

    @staticmethod
    def type_name():
        """Its name in the service."""
        return "freespace_message_1"

    def is_layout_known(self):
        """Whether it is a message of this layout; nothing of another one may be read."""
        has_sizes = self.total_bytes == BYTES and self.header_bytes == Message.occupancy.offset and self.sectors == SECTORS
        return self.magic == MAGIC and self.version == VERSION and has_sizes and self.rows * self.columns <= MAX_CELLS

    def age_micros(self):
        """Microseconds from its capture until now."""
        now = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        return max(0, now - self.handed_over_micros) + self.used_micros

    def free_ahead_m(self, half_rad=0.05):
        """Free distance straight ahead of the rear axle, metres: the least of the sectors within half_rad of it.

        0 where the message is not to be used, or says nothing of one of them.
        """
        if self.level >= LEVEL_INVALID or not self.sector_rad > 0.0:
            return 0.0
        rights = [self.sector_first_rad + k * self.sector_rad for k in range(SECTORS)]
        ahead = [free for right, free in zip(rights, self.free_m) if right < half_rad and right + self.sector_rad > -half_rad]
        least = min(ahead, default=0.0) if all(free >= 0.0 for free in ahead) else 0.0
        return least if least < float("inf") else 0.0


assert ctypes.sizeof(Message) == BYTES


class ReaderError(Exception):
    """Why messages cannot be read; `code` is one of the codes above."""

    def __init__(self, code):
        super().__init__(CODES.get(code, f"code {code}"))
        self.code = code


def _library():
    path = os.environ.get("FREESPACE_READER_LIBRARY", "libfreespace_reader.so")
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        fix = "build it with `cargo build --release -p freespace-reader`, and give its path in FREESPACE_READER_LIBRARY"
        raise OSError(f"{error}: {fix}") from None
    message = ctypes.POINTER(Message)
    library.freespace_reader_open.argtypes = [ctypes.c_char_p, ctypes.POINTER(ctypes.c_void_p)]
    library.freespace_reader_next.argtypes = [ctypes.c_void_p, ctypes.c_uint64, ctypes.POINTER(message)]
    library.freespace_reader_close.argtypes = [ctypes.c_void_p]
    library.freespace_reader_close.restype = None
    return library


class Reader:
    """Reads the messages of one module; for one thread at a time."""

    def __init__(self, name="freespace/grid"):
        self._library = _library()
        self._reader = ctypes.c_void_p()
        code = self._library.freespace_reader_open(name.encode(), ctypes.byref(self._reader))
        if code != OK:
            raise ReaderError(code)

    def next(self, timeout_s=1.0):
        """The newest message not had yet, or None. It is read in place, and good until the next call."""
        message = ctypes.POINTER(Message)()
        timeout_micros = max(0, int(timeout_s * 1e6))
        code = self._library.freespace_reader_next(self._reader, timeout_micros, ctypes.byref(message))
        if code == NOTHING:
            return None
        if code != OK:
            raise ReaderError(code)
        return message.contents

    def close(self):
        """Closes the reader."""
        self._library.freespace_reader_close(self._reader)
        self._reader = ctypes.c_void_p()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

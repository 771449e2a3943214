/* The free-space message in shared memory, and its reader. Made by `cargo run -p freespace-reader --example write_bindings`.
 *
 * Link with libfreespace_reader.a (and -lpthread -ldl -lm) or libfreespace_reader.so, built by
 * `cargo build --release -p freespace-reader`. Numbers have the machine's own byte order; there is no padding.
 *
 * UNKNOWN IS NOT FREE: a cell may be driven on where its occupancy is 0 to FREESPACE_FREE_AT_MOST, and nowhere else. A message
 * of level FREESPACE_LEVEL_INVALID says nothing of the road; a message that does not come says nothing either: look at its age.
 */
#ifndef FREESPACE_H
#define FREESPACE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FREESPACE_MAGIC (1162170950)
#define FREESPACE_VERSION (1)
#define FREESPACE_BYTES (720320)
#define FREESPACE_MAX_CELLS (240000)
#define FREESPACE_SECTORS (32)
#define FREESPACE_UNKNOWN (-1)
#define FREESPACE_FREE_AT_MOST (35)
#define FREESPACE_LEVEL_FULL (0)
#define FREESPACE_LEVEL_NO_REFINEMENT (1)
#define FREESPACE_LEVEL_NO_FRESH_NETWORK (2)
#define FREESPACE_LEVEL_NO_FRESH_MAP (3)
#define FREESPACE_LEVEL_MOVED (4)
#define FREESPACE_LEVEL_INVALID (5)

/* Faults, the bits of `faults`. */
#define FREESPACE_FAULT_IMAGE_BLACK (0x00000001u)
#define FREESPACE_FAULT_IMAGE_OVEREXPOSED (0x00000002u)
#define FREESPACE_FAULT_IMAGE_FROZEN (0x00000004u)
#define FREESPACE_FAULT_IMAGE_BLOCKED (0x00000008u)
#define FREESPACE_FAULT_CAMERA_SILENT (0x00000010u)
#define FREESPACE_FAULT_WHEELS_SILENT (0x00000020u)
#define FREESPACE_FAULT_WHEELS_SLIP (0x00000040u)
#define FREESPACE_FAULT_TRACKING_LOST (0x00000080u)
#define FREESPACE_FAULT_NETWORK_LATE (0x00000100u)
#define FREESPACE_FAULT_NETWORK_FAILED (0x00000200u)
#define FREESPACE_FAULT_MAP_LATE (0x00000400u)
#define FREESPACE_FAULT_CUT_STOPPED (0x00000800u)
#define FREESPACE_FAULT_PLANE_HELD (0x00001000u)
#define FREESPACE_FAULT_SCALE_HELD (0x00002000u)
#define FREESPACE_FAULT_DEADLINE_MISSED (0x00004000u)
#define FREESPACE_FAULT_CLOCK_OFFSET (0x00008000u)
#define FREESPACE_FAULT_HANDOVER_DROPPED (0x00010000u)
#define FREESPACE_FAULT_CAN_SEND_FAILED (0x00020000u)
#define FREESPACE_FAULT_STAGE_PANICKED (0x00040000u)
#define FREESPACE_FAULT_SHUTTING_DOWN (0x00080000u)
#define FREESPACE_FAULT_RIGHTS_LACKING (0x00100000u)
#define FREESPACE_FAULT_GRID_STALE (0x00200000u)
#define FREESPACE_FAULT_KEY_FRAME_MISSING (0x00400000u)
#define FREESPACE_FAULT_SHARING_FAILED (0x00800000u)

/* What the functions return. */
#define FREESPACE_OK (0) /* it worked */
#define FREESPACE_NOTHING (1) /* no message came in time, or a signal came */
#define FREESPACE_NO_MODULE (-1) /* nobody publishes under this name: start the module, or correct the name */
#define FREESPACE_BAD_NAME (-2) /* this is no name of a service */
#define FREESPACE_TOO_MANY_READERS (-3) /* no room for another reader: raise max_readers in [shared_memory] */
#define FREESPACE_WRONG_LAYOUT (-4) /* the module publishes another layout: build both from one version */
#define FREESPACE_NOT_PERMITTED (-5) /* the shared memory may not be opened: run as the module's user */
#define FREESPACE_FAILED (-6) /* the shared memory failed: look at the room in /dev/shm, open the reader anew */
#define FREESPACE_BAD_ARGUMENT (-7) /* a pointer is null, or a name is no text */

/* What a code says, and its fix. */
static inline const char *freespace_text(int code)
{
    switch (code) {
    case FREESPACE_OK: return "it worked";
    case FREESPACE_NOTHING: return "no message came in time, or a signal came";
    case FREESPACE_NO_MODULE: return "nobody publishes under this name: start the module, or correct the name";
    case FREESPACE_BAD_NAME: return "this is no name of a service";
    case FREESPACE_TOO_MANY_READERS: return "no room for another reader: raise max_readers in [shared_memory]";
    case FREESPACE_WRONG_LAYOUT: return "the module publishes another layout: build both from one version";
    case FREESPACE_NOT_PERMITTED: return "the shared memory may not be opened: run as the module's user";
    case FREESPACE_FAILED: return "the shared memory failed: look at the room in /dev/shm, open the reader anew";
    case FREESPACE_BAD_ARGUMENT: return "a pointer is null, or a name is no text";
    default: return "unknown code";
    }
}

/* The message; each field with its offset. */
typedef struct freespace_message {
    /*      0: `FREE`, 0x45455246. */
    uint32_t magic;
    /*      4: Layout version, 1; a reader refuses others. */
    uint16_t version;
    /*      6: Bytes before the cells: the offset of `occupancy`. */
    uint16_t header_bytes;
    /*      8: Size of the message. */
    uint32_t total_bytes;
    /*     12: Faults, one bit each. */
    uint32_t faults;
    /*     16: Counts the module's messages, from 0 at its start; a gap is a message that this reader missed. */
    uint64_t sequence;
    /*     24: Capture stamp of the key frame, microseconds; CLOCK_MONOTONIC for a live camera. */
    uint64_t capture_micros;
    /*     32: When the message was published, on the same clock. */
    uint64_t publish_micros;
    /*     40: When it had to be, on the same clock. */
    uint64_t deadline_micros;
    /*     48: Time from capture to deadline. */
    uint32_t budget_micros;
    /*     52: Time from capture to publication. */
    uint32_t used_micros;
    /*     56: Quality: 0 full, 1 no refinement, 2 no fresh network, 3 no fresh map, 4 moved, 5 invalid: do not use. */
    uint8_t level;
    /*     57: Source of the metric scale: 0 unknown, 1 wheels, 2 camera height, 3 held. */
    uint8_t scale;
    /*     58: Source of the pose: 0 dead reckoning, 1 good, 2 standstill, 3 weak. */
    uint8_t tracking;
    /*     59: What held the answer back: 0 nothing, 1 frame, 2 track, 3 map, 4 priors, 5 segmentation, 6 crf, 7 grid, 8 emit, 9 camera. */
    uint8_t blame;
    /*     60: Landmarks on the road plane; 0 where the plane was held. */
    uint32_t plane_inliers;
    /*     64: Vehicle origin in the world, metres. */
    double position_m[3];
    /*     88: Vehicle orientation in the world, quaternion x y z w. */
    double orientation[4];
    /*    120: Speed along the vehicle's x axis, m/s. */
    float speed_mps;
    /*    124: Yaw rate, rad/s, positive left. */
    float yaw_rate_radps;
    /*    128: Unit normal of the road plane in camera space. */
    float plane_normal[3];
    /*    140: Height of the camera over the road plane, metres. */
    float plane_offset_m;
    /*    144: Robust spread of the landmarks about the plane, metres. */
    float plane_sigma_m;
    /*    148: Rows of the grid; row 0 is nearest, rows go ahead. */
    uint32_t rows;
    /*    152: Columns of the grid; column 0 is the right edge, columns go left. */
    uint32_t columns;
    /*    156: Edge of a cell, metres. */
    float cell_m;
    /*    160: Bearing of the right edge of sector 0, radians, positive left. */
    float sector_first_rad;
    /*    164: Width of a sector, radians. */
    float sector_rad;
    /*    168: Sectors of the boundary. */
    uint32_t sectors;
    /*    172: Free distance in each sector from the vehicle's origin, metres; what is unknown is not free. */
    float free_m[32];
    /*    300: Corner of the grid (near, right) in the vehicle: metres ahead of the rear axle. */
    float origin_x_m;
    /*    304: The same corner: metres left of the centre line. */
    float origin_y_m;
    /*    308: 0. */
    uint32_t reserved;
    /*    312: CLOCK_MONOTONIC when the publisher handed it over to be shared; with `used_micros` it gives the age on any clock. */
    uint64_t handed_over_micros;
    /*    320: Row by row: -1 unknown, 0 free to 100 occupied; a car may drive on 0 to 35. Unknown is not free. */
    int8_t occupancy[240000];
    /* 240320: Why each cell is so: 0 unseen, 1 plane, 2 box, 3 network, 4 previous key frame. */
    uint8_t reason[240000];
    /* 480320: Time since each cell was last seen, 0.1 s; 255 is 25.5 s or more, or never. */
    uint8_t age[240000];
} freespace_message;

/* A reader, for one thread at a time. */
typedef struct freespace_reader freespace_reader;

/* Opens a reader; a null name is "freespace/grid". FREESPACE_NO_MODULE is worth another try a second later. */
int freespace_reader_open(const char *name, freespace_reader **reader);

/* Waits for the newest message that this reader has not had. It is read in place, and good until the next call with this
 * reader. A reader outlives the module: where that is started anew, its messages go on, with a sequence from 0. */
int freespace_reader_next(freespace_reader *reader, uint64_t timeout_micros, const freespace_message **message);

/* Closes a reader. */
void freespace_reader_close(freespace_reader *reader);

/* Microseconds from the capture of a message until now. */
uint64_t freespace_age_micros(const freespace_message *message);

/* Free distance straight ahead of the rear axle, metres: the least of the sectors within half_rad of it. 0 where the message
 * is not to be used. */
float freespace_free_ahead_m(const freespace_message *message, float half_rad);

#ifdef __cplusplus
}
#endif

#endif

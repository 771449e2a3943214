//! The layout for other languages, written from the Rust type: `include/freespace.h` and `include/freespace.py`.
//!
//! In: [`FIELDS`], the faults and the codes. Out: two texts, the same on every machine. They are committed;
//! `cargo run -p freespace-reader --example write_bindings` writes them anew, and a test fails where that was forgotten.

use core::fmt::Write as _;

use freespace::budget::{MAX_CELLS, SECTORS};
use freespace::emit::{Element, FIELDS, Field, SHARED_BYTES, SHARED_VERSION};
use freespace::grid::Grid;
use freespace::health::{Faults, QualityLevel};

use crate::c::CODES;
use crate::service::{FOLDER, ICEORYX2, PAYLOAD_NAME, PREFIX};

const C_BEGIN: &str = r#"/* The free-space message in shared memory, and its reader. Made by `cargo run -p freespace-reader --example write_bindings`.
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

"#;

const C_END: &str = r#"
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
"#;

const PYTHON_BEGIN: &str = r#""""The free-space message in shared memory, and its reader. Made by `cargo run -p freespace-reader --example write_bindings`.

The reader loads libfreespace_reader.so, built by `cargo build --release -p freespace-reader`: from FREESPACE_READER_LIBRARY, or
where the system finds libraries. The package iceoryx2 reads the same messages without it: reader/examples/read_iceoryx2.py.
Unknown is not free: a cell may be driven on where its occupancy is 0 to FREE_AT_MOST, nowhere else.
"""

import ctypes
import os
import time

"#;

const PYTHON_END: &str = r#"
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
"#;

const fn c_type(element: Element) -> &'static str {
    match element {
        Element::I8 => "int8_t",
        Element::U8 => "uint8_t",
        Element::U16 => "uint16_t",
        Element::U32 => "uint32_t",
        Element::U64 => "uint64_t",
        Element::F32 => "float",
        Element::F64 => "double",
    }
}

const fn python_type(element: Element) -> &'static str {
    match element {
        Element::I8 => "ctypes.c_int8",
        Element::U8 => "ctypes.c_uint8",
        Element::U16 => "ctypes.c_uint16",
        Element::U32 => "ctypes.c_uint32",
        Element::U64 => "ctypes.c_uint64",
        Element::F32 => "ctypes.c_float",
        Element::F64 => "ctypes.c_double",
    }
}

/// Numbers that both languages name, with their prefix-free names.
fn constants() -> Vec<(&'static str, i64)> {
    let number = |value: usize| i64::try_from(value).unwrap_or(i64::MAX);
    vec![
        ("MAGIC", 0x4545_5246),
        ("VERSION", i64::from(SHARED_VERSION)),
        ("BYTES", number(SHARED_BYTES)),
        ("MAX_CELLS", number(MAX_CELLS)),
        ("SECTORS", number(SECTORS)),
        ("UNKNOWN", -1),
        ("FREE_AT_MOST", i64::from(Grid::FREE_AT_MOST)),
        ("LEVEL_FULL", 0),
        ("LEVEL_NO_REFINEMENT", 1),
        ("LEVEL_NO_FRESH_NETWORK", 2),
        ("LEVEL_NO_FRESH_MAP", 3),
        ("LEVEL_MOVED", 4),
        ("LEVEL_INVALID", 5),
    ]
}

fn c_member(field: &Field) -> String {
    let count = field.count.map_or(String::new(), |count| format!("[{count}]"));
    let name = field.name;
    let member = format!("{} {name}{count};", c_type(field.element));
    format!("    /* {:>6}: {} */\n    {member}\n", field.offset, field.doc)
}

/// `include/freespace.h`: C11 and C++11.
#[must_use]
pub fn c_header() -> String {
    let mut text = C_BEGIN.to_owned();
    // A `String` takes all that is written to it, here and below.
    for (name, value) in constants() {
        let _ = writeln!(text, "#define FREESPACE_{name} ({value})");
    }
    text.push_str("\n/* Faults, the bits of `faults`. */\n");
    for (fault, name) in Faults::NAMED {
        let _ = writeln!(
            text,
            "#define FREESPACE_FAULT_{} (0x{:08x}u)",
            name.to_uppercase(),
            fault.0
        );
    }
    text.push_str("\n/* What the functions return. */\n");
    for (name, code, says) in CODES {
        let _ = writeln!(text, "#define FREESPACE_{name} ({code}) /* {says} */");
    }
    text.push_str("\n/* What a code says, and its fix. */\nstatic inline const char *freespace_text(int code)\n{\n    switch (code) {\n");
    for (name, _, says) in CODES {
        let _ = writeln!(text, "    case FREESPACE_{name}: return \"{says}\";");
    }
    text.push_str("    default: return \"unknown code\";\n    }\n}\n");
    text.push_str("\n/* The message; each field with its offset. */\ntypedef struct freespace_message {\n");
    for field in FIELDS {
        text.push_str(&c_member(field));
    }
    text.push_str("} freespace_message;\n");
    text.push_str(C_END);
    text
}

/// `include/freespace.py`: Python 3.8 and later, nothing to install.
#[must_use]
pub fn python_module() -> String {
    let mut text = PYTHON_BEGIN.to_owned();
    for (name, value) in constants() {
        let _ = writeln!(text, "{name} = {value}");
    }
    let _ = writeln!(
        text,
        "# Where the service's files lie, and the version of iceoryx2 that lays them out."
    );
    let _ = writeln!(
        text,
        "FOLDER = \"{FOLDER}\"\nPREFIX = \"{PREFIX}\"\nICEORYX2 = \"{ICEORYX2}\""
    );
    for (name, code, _) in CODES {
        let _ = writeln!(text, "{name} = {code}");
    }
    text.push_str("CODES = {\n");
    for (name, _, says) in CODES {
        let _ = writeln!(text, "    {name}: \"{says}\",");
    }
    let levels: Vec<&str> = (0..=QualityLevel::Invalid as u8)
        .filter_map(QualityLevel::from_wire)
        .map(QualityLevel::name)
        .collect();
    let _ = writeln!(text, "}}\nLEVELS = {levels:?}");
    text.push_str("FAULTS = {\n");
    for (fault, name) in Faults::NAMED {
        let _ = writeln!(text, "    0x{:08X}: \"{name}\",", fault.0);
    }
    text.push_str("}\n\n\nclass Message(ctypes.Structure):\n    \"\"\"The message; each field with its offset.\"\"\"\n\n");
    text.push_str("    _fields_ = [\n");
    for field in FIELDS {
        let count = field.count.map_or(String::new(), |count| format!(" * {count}"));
        let element = python_type(field.element);
        let _ = writeln!(
            text,
            "        # {}: {}\n        (\"{}\", {element}{count}),",
            field.offset, field.doc, field.name
        );
    }
    text.push_str("    ]\n\n");
    let _ = writeln!(text, "    @staticmethod\n    def type_name():");
    let _ = writeln!(text, "        \"\"\"Its name in the service.\"\"\"");
    let _ = writeln!(text, "        return \"{PAYLOAD_NAME}\"");
    text.push_str(PYTHON_END);
    text
}

/// A C translation unit that compiles where the header's struct has the layout of the Rust type.
#[must_use]
pub fn c_layout_check() -> String {
    let mut text =
        "#include \"freespace.h\"\n#ifdef __cplusplus\n#define CHECK(x) static_assert(x, #x)\n#else\n\
                    #define CHECK(x) _Static_assert(x, #x)\n#endif\n"
            .to_owned();
    let _ = writeln!(text, "CHECK(sizeof(freespace_message) == {SHARED_BYTES});");
    for field in FIELDS {
        let (name, offset) = (field.name, field.offset);
        let bytes = c_type(field.element);
        let count = field.count.unwrap_or(1);
        let _ = writeln!(text, "CHECK(offsetof(freespace_message, {name}) == {offset});");
        let _ = writeln!(
            text,
            "CHECK(sizeof(((freespace_message *)0)->{name}) == {count} * sizeof({bytes}));"
        );
    }
    text
}

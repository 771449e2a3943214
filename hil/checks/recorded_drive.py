"""Reads a recorded drive the way a user's tools would: the `mcap` package, Foxglove's schemas from the file itself.

In: a file of `--mcap`. Out: one summary line; exit code 1 on any failure.
Every message must decode by the schema that the file gives for it, every picture must have as many bytes as its size says, every
grid as many cells, every landmark a place; stamps and log times must agree; with --whole the file must have its index and be
read by it.

Usage: recorded_drive.py FILE.mcap [--whole]
"""

import argparse
import json
import math
import struct
import sys
from collections import Counter

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

BYTES_PER_PIXEL = {"mono8": 1, "rgb8": 3, "yuyv": 2, "nv12": 1.5}
OWN = {"freespace.WheelReading", "freespace.Frame", "freespace.KeyFrame", "freespace.CanFrames", "freespace.KeyFrameWanted"}


def nanos(stamp) -> int:
    return stamp.seconds * 1_000_000_000 + stamp.nanos


def check_image(image, log_time: int) -> None:
    expected = BYTES_PER_PIXEL[image.encoding] * image.width * image.height
    assert len(image.data) == expected, f"{len(image.data)} bytes of {expected}"
    assert nanos(image.timestamp) == log_time, "stamp and log time differ"


def check_grid(grid) -> None:
    assert len(grid.data) % grid.row_stride == 0 and grid.row_stride == grid.column_count * grid.cell_stride
    assert [field.name for field in grid.fields] == ["occupancy"]
    cells = [byte - 256 if byte > 127 else byte for byte in grid.data]
    assert all(-1 <= cell <= 100 for cell in cells), "a cell outside -1..100"


def check_cloud(cloud) -> None:
    assert cloud.data and len(cloud.data) % cloud.point_stride == 0, f"{len(cloud.data)} bytes by {cloud.point_stride}"
    assert [field.name for field in cloud.fields][:3] == ["x", "y", "z"] and cloud.frame_id == "world"
    for (x, y, z) in (struct.unpack_from("<3f", cloud.data, at) for at in range(0, len(cloud.data), cloud.point_stride)):
        assert all(map(math.isfinite, (x, y, z))), "a landmark that is nowhere"


def check_own(schema, data: bytes) -> None:
    # Nothing may be in a message of which its schema does not speak.
    strict = {**json.loads(schema.data), "additionalProperties": False}
    fault = best_match(Draft202012Validator(strict).iter_errors(json.loads(data)))
    assert fault is None, f"{schema.name}: {fault.json_path}: {fault.message}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    parser.add_argument("--whole", action="store_true", help="the recording was ended in order")
    arguments = parser.parse_args()
    factory, decoders, counts = DecoderFactory(), {}, Counter()
    with open(arguments.file, "rb") as stream:
        if arguments.whole:
            reader = make_reader(stream)
            summary = reader.get_summary()
            assert summary is not None and summary.chunk_indexes, "the file has no index"
            names = {attachment.name for attachment in reader.iter_attachments()}
            assert {"drive.json", "config.toml"} <= names, f"attachments: {names}"
        else:
            reader = NonSeekingReader(stream)
        for schema, channel, message in reader.iter_messages(log_time_order=arguments.whole):
            counts[channel.topic] += 1
            if channel.message_encoding == "json":
                assert schema.name in OWN, schema.name
                check_own(schema, message.data)
                continue
            if schema.id not in decoders:
                decoders[schema.id] = factory.decoder_for("protobuf", schema)
            decoded = decoders[schema.id](message.data)
            if schema.name == "foxglove.RawImage":
                check_image(decoded, message.log_time)
            elif schema.name == "foxglove.Grid":
                check_grid(decoded)
            elif schema.name == "foxglove.PointCloud":
                check_cloud(decoded)
    for topic in ("/camera/image", "/camera/calibration", "/tf"):
        assert counts[topic], f"no message of {topic}"
    print(", ".join(f"{topic} {count}" for topic, count in sorted(counts.items())))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except AssertionError as fault:
        sys.exit(f"recorded_drive: {fault}")

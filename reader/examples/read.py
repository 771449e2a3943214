"""Prints what the module publishes.

    cargo build --release -p freespace-reader
    FREESPACE_READER_LIBRARY=target/release/libfreespace_reader.so PYTHONPATH=include python3 reader/examples/read.py [NAME [MESSAGES]]
"""

import argparse
import sys
import time

import freespace


def open_reader(name):
    while True:
        try:
            return freespace.Reader(name)
        except freespace.ReaderError as error:
            if error.code != freespace.NO_MODULE:
                sys.exit(f"{name}: {error}")
        print(f"waiting for a module that publishes {name}", file=sys.stderr)
        time.sleep(1.0)


def show(message):
    cells = message.rows * message.columns
    unknown = message.occupancy[:cells].count(freespace.UNKNOWN)
    print(
        f"{message.sequence:6} {freespace.LEVELS[message.level]:<16} age {message.age_micros() * 1e-3:6.1f} ms, "
        f"free ahead {message.free_ahead_m():5.1f} m, {unknown} of {cells} cells unknown (not free)",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description="Prints what the module publishes.")
    parser.add_argument("name", nargs="?", default="freespace/grid", help="`name` of the module's [shared_memory]")
    parser.add_argument("messages", nargs="?", type=int, help="end after so many")
    arguments = parser.parse_args()
    messages = arguments.messages
    with open_reader(arguments.name) as reader:
        while messages != 0:
            message = reader.next(timeout_s=1.0)
            if message is None:
                print("no message for 1 s: nothing is known to be free")
                continue
            show(message)
            messages = messages and messages - 1


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)

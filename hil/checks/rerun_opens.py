"""Opens a recorded drive with Rerun, as far as that goes without a screen.

In: a file of `--mcap`. Out: one line a topic: its rows, and what Rerun shows them as; exit code 1 on any failure.
The file must pass Rerun's own check, and pictures, lens, poses and landmarks must be shown as such, not as unknown messages.
Rerun has no view of `foxglove.Grid`: the grid is there as a table.

Usage: rerun_opens.py FILE.mcap
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

SHOWN_AS = {
    "/camera/image": "Image:buffer",
    "/camera/calibration": "Pinhole:image_from_camera",
    "/tf": "Transform3D:translation",
    "/freespace/landmarks": "Points3D:positions",
    "/freespace/grid": "foxglove.Grid:message",
    "/freespace/key_frame": "McapMessage:data",
}
CHUNK = re.compile(r"Chunk\(.*\) with (\d+) rows .* - (/\S+) - data columns: \[(.*)\]")


def rerun(home: str, *arguments: str) -> str:
    beside = Path(sys.executable).with_name("rerun")
    program = beside if beside.exists() else shutil.which("rerun")
    assert program, "there is no program `rerun`: pip install rerun-sdk"
    # In a home of its own every session is the first one, in which Rerun reports nothing to its makers.
    environment = {**os.environ, "HOME": home, "XDG_CONFIG_HOME": home, "XDG_CACHE_HOME": home}
    done = subprocess.run([program, *arguments], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"rerun {' '.join(arguments)}: {done.stdout}{done.stderr}"
    return done.stdout


def main() -> int:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory() as home:
        rerun(home, "mcap", "check", sys.argv[1])
        converted = str(Path(home, "drive.rrd"))
        rerun(home, "mcap", "convert", sys.argv[1], "-o", converted)
        rerun(home, "rrd", "verify", converted)
        printed = rerun(home, "rrd", "print", converted)
    rows = defaultdict(int)
    for count, topic, columns in CHUNK.findall(printed):
        if SHOWN_AS.get(topic) in columns.split():
            rows[topic] += int(count)
    for topic, column in SHOWN_AS.items():
        assert rows[topic], f"{topic} is not shown as {column}"
        print(f"{topic} {rows[topic]} as {column}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except AssertionError as fault:
        sys.exit(f"rerun_opens: {fault}")

#!/bin/sh
# Puts ONNX Runtime's library at .runtime/libonnxruntime.so, where the program looks for it.
# It is taken from the Python package of that name; nothing is installed. Does nothing where the library is there already.
set -eu

version=1.31.1
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
folder=$root/.runtime
library=$folder/libonnxruntime.so
versioned=$library.$version

fail() {
    echo "fetch-onnxruntime: $1" >&2
    exit 1
}

if [ -f "$versioned" ] && [ "$(readlink "$library")" = "libonnxruntime.so.$version" ]; then
    echo "ONNX Runtime $version is there already: $library"
    exit 0
fi

python=$(command -v python3 || command -v python) ||
    fail "python3 is needed to fetch the library: install python3 and pip, or set ORT_DYLIB_PATH to a libonnxruntime.so of version $version or later"
"$python" -m pip --version >/dev/null 2>&1 ||
    fail "pip is needed to fetch the library: install it (Debian: apt install python3-pip), or set ORT_DYLIB_PATH to a libonnxruntime.so of version $version or later"

case $(uname -s)-$(uname -m) in
Linux-x86_64) platform=x86_64 ;;
Linux-aarch64) platform=aarch64 ;;
*) fail "no package for $(uname -s) on $(uname -m): set ORT_DYLIB_PATH to the library" ;;
esac

mkdir -p "$folder"
scratch=$(mktemp -d "$folder/fetch.XXXXXX")
trap 'rm -rf "$scratch"' EXIT
trap 'exit 1' HUP INT TERM

# The wheel's own Python version does not matter: only the library inside is used.
"$python" -m pip download --quiet --no-deps --only-binary :all: --dest "$scratch" \
    --implementation cp --python-version 3.11 \
    --platform "manylinux_2_27_$platform" --platform "manylinux_2_28_$platform" \
    "onnxruntime==$version" ||
    fail "pip could not download onnxruntime $version: check the network, or set ORT_DYLIB_PATH to the library"

"$python" - "$scratch" <<'PYTHON' || fail "the package holds no capi/libonnxruntime.so"
import glob, re, shutil, sys, zipfile

scratch = sys.argv[1]
with zipfile.ZipFile(glob.glob(scratch + "/onnxruntime-*.whl")[0]) as wheel:
    names = [name for name in wheel.namelist() if re.search(r"/capi/libonnxruntime\.so\.[0-9.]+$", name)]
    with wheel.open(names[0]) as source, open(scratch + "/library", "wb") as target:
        shutil.copyfileobj(source, target)
PYTHON

# Renamed last, so that an interrupted run leaves no half library.
chmod 644 "$scratch/library"
mv "$scratch/library" "$versioned"
ln -sf "libonnxruntime.so.$version" "$library"
echo "ONNX Runtime $version: $library"

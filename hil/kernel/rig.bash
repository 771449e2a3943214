# shellcheck shell=bash
# What all scripts of this folder share: messages, the cache folder, a recipe's key, missing commands.
# Sourced, never run. A thing that cannot be had ends the script with 77, which test runners read as "skipped".

# The repository may lie anywhere: every path starts from this file.
rig_folder=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd -P)
rig_name=$(basename "$0")
# Files of a build belong to whoever runs it, and no locale changes what a tool prints.
export LC_ALL=C.UTF-8
umask 022
# A command that fails inside $(...) ends that too.
shopt -s inherit_errexit

fail() {
    echo "$rig_name: $1" >&2
    exit "${2:-1}"
}

skip() {
    echo "SKIPPED: $rig_name: $1" >&2
    exit 77
}

say() {
    echo "$rig_name: $1" >&2
}

# Prints the folder that holds what was built; makes it where it is missing.
cache_folder() {
    local folder=${FREESPACE_RIG_CACHE:-$(dirname "$(dirname "$rig_folder")")/target/rig}
    mkdir -p "$folder" 2>/dev/null || skip "cannot make the cache folder $folder: set FREESPACE_RIG_CACHE to one that can be written"
    (cd "$folder" && pwd -P)
}

# recipe_key FILE...: a short hash of the files a kernel is made from, so that a changed recipe is built anew.
recipe_key() {
    (cd "$rig_folder" && cat -- "$@" && echo "${FREESPACE_RIG_SUITE:-}") | sha256sum | cut -c1-12
}

# The folders of the two kernels: the scripts that build and those that run must agree on them.
uml_cache() {
    local cache
    cache=$(cache_folder)
    echo "$cache/uml-$(recipe_key build-uml uml.config packages.bash)"
}

rt_cache() {
    local cache
    cache=$(cache_folder)
    echo "$cache/rt-$(recipe_key build-rt rt-init packages.bash)"
}

require_root() {
    [ "$(id -u)" = 0 ] || skip "root is needed ($1): run it with sudo"
}

# require_commands COMMAND:PACKAGE...: installs by name what is missing, or says what to install.
require_commands() {
    local pair missing=()
    for pair in "$@"; do
        command -v "${pair%%:*}" >/dev/null || missing+=("${pair#*:}")
    done
    [ ${#missing[@]} -gt 0 ] || return 0
    { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; } || skip "missing: install ${missing[*]}"
    say "installing ${missing[*]}"
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}"; } </dev/null >&2 ||
        skip "missing, and apt-get could not install them: ${missing[*]}"
}

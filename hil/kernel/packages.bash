# shellcheck shell=bash
# A private view of Debian's packages: the machine's own sources, lists and installed packages stay as they are.
# Sourced after rig.bash by the scripts that build.

debian_keyring=/usr/share/keyrings/debian-archive-keyring.gpg
debian_release=bookworm
# Where the kernels come from: 6.12, the first release whose PREEMPT_RT needs no patch, for this and later releases of Debian.
kernel_suite=${FREESPACE_RIG_SUITE:-bookworm-backports}
apt_view=()

# The mirror that this machine uses already; a machine that is not Debian names one.
debian_mirror() {
    [ -z "${FREESPACE_DEBIAN_MIRROR:-}" ] || { echo "$FREESPACE_DEBIAN_MIRROR"; return; }
    # shellcheck disable=SC2016 # apt's own placeholder, not the shell's
    apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' | awk '/\/debian\/$/ && !seen++'
}

# open_packages FOLDER: from here on `packages` is apt-get in the private view kept in FOLDER.
open_packages() {
    local folder=$1 mirror suite
    command -v apt-get >/dev/null || skip "apt-get is missing: the kernels are built from Debian packages"
    [ -f "$debian_keyring" ] || skip "$debian_keyring is missing: install debian-archive-keyring"
    mirror=$(debian_mirror)
    [ -n "$mirror" ] || skip "this machine's apt knows no Debian mirror: set FREESPACE_DEBIAN_MIRROR to one"
    mkdir -p "$folder"/{lists/partial,cache/archives/partial,sources}
    for suite in "$debian_release" "$kernel_suite"; do
        printf 'Types: deb\nURIs: %s\nSuites: %s\nComponents: main\nSigned-By: %s\n' \
            "$mirror" "$suite" "$debian_keyring" >"$folder/sources/$suite.sources"
    done
    apt_view=(
        -o Dir::Etc::sourcelist=/dev/null -o Dir::Etc::sourceparts="$folder/sources"
        -o Dir::State::lists="$folder/lists" -o Dir::Cache="$folder/cache"
        -o APT::Default-Release="$kernel_suite" -o APT::Sandbox::User=root
        -o Acquire::Languages=none -o Acquire::IndexTargets::deb::DEP-11::DefaultEnabled=false
    )
    apt-get "${apt_view[@]}" update -qq >&2 || skip "apt-get cannot reach $mirror"
}

# fetch_packages FOLDER PACKAGE...: their archives, newest version of the suite, into FOLDER.
fetch_packages() {
    local folder=$1
    shift
    mkdir -p "$folder"
    (cd "$folder" && apt-get "${apt_view[@]}" -qq download "$@") >&2 || skip "apt-get could not download $*"
}

# Prints the first dependency of package $1 that matches the expression $2.
dependency() {
    apt-cache "${apt_view[@]}" depends "$1" | sed -n 's/^ *|\{0,1\}Depends: //p' | awk -v name="$2" '$0 ~ name && !seen++'
}

# begin_build TARGET: where TARGET is there already, ends the script; else sets `scratch`, on the same disk as TARGET.
# What a killed run left behind is cleared first, which the lock makes safe.
begin_build() {
    local target=$1 kind
    kind=$(basename "${target%-*}")
    exec 9>"$(dirname "$target")/.$kind.lock"
    flock 9
    [ ! -d "$target" ] || { echo "$target"; exit 0; }
    rm -rf "$(dirname "$target")/.$kind.building".*
    scratch=$(mktemp -d "$(dirname "$target")/.$kind.building.XXXXXX")
    trap end_build EXIT
    trap 'exit 129' HUP
    trap 'exit 130' INT
    trap 'exit 143' TERM
}

# The log lies in what is deleted, so that its end has to be shown before.
end_build() {
    local status=$?
    [ "$status" = 0 ] || [ "$status" = 77 ] || [ ! -f "$scratch/log" ] || tail -n 20 "$scratch/log" >&2
    rm -rf "$scratch"
}

# finish_build FOLDER TARGET: a rename is whole or not at all.
finish_build() {
    chmod 755 "$1"
    mv -T "$1" "$2"
    echo "$2"
}

# shellcheck shell=bash
# shellcheck disable=SC2034,SC2154 # set in rig.bash, and used by run-uml and run-rt
# The host's side of a run, the same for both kernels: options, the control folder, the exit code.
# Sourced after rig.bash. The control folder is the one thing that host and guest both write; the guest sees it as /rig.

memory_mb=1024
limit_s=300
loopbacks=0
loopback_options=
vivid_options='n_devs=1 node_types=0x1 vid_cap_nr=0'
kernel_arguments=
kept_log=
buses=()
setup=()
shown=()
extra_options=
command_line=()

common_usage() {
    cat >&2 <<USAGE
usage: $rig_name [options] -- COMMAND [ARGUMENT...]
  -w DIR      a folder that the command may write; all else is read-only below a layer that is thrown away
  -r DIR      a folder to show read-only although the guest has its own /tmp, /run and /dev/shm
  -b NAME     a virtual CAN bus, up, CAN FD allowed
  -c COUNT    cameras fed by a program (v4l2loopback): /dev/video10, 11 ...
  -o OPTIONS  more options of v4l2loopback
  -v OPTIONS  options of vivid, the simulated camera at /dev/video0 ($vivid_options)
  -p COMMAND  a shell command to run first; the run ends where it fails
  -m MB       memory of the guest ($memory_mb)
  -t SECONDS  time limit ($limit_s); a run beyond it exits 124
  -a WORDS    more kernel arguments
  -L FILE     keep the kernel's log
$1
  -w, -r, -b and -p may be repeated. Environment, working folder, output and exit code pass through.
USAGE
    exit 64
}

# Sets the variables above; an option it does not know goes to own_option LETTER VALUE.
parse_options() {
    local letter
    while getopts "w:r:b:c:o:v:p:m:t:a:L:$extra_options" letter; do
        case $letter in
        w) show rw "$OPTARG" ;;
        r) show ro "$OPTARG" ;;
        b) buses+=("$OPTARG") ;;
        c) loopbacks=$OPTARG ;;
        o) loopback_options=$OPTARG ;;
        v) vivid_options=$OPTARG ;;
        p) setup+=("$OPTARG") ;;
        m) memory_mb=$OPTARG ;;
        t) limit_s=$OPTARG ;;
        a) kernel_arguments=$OPTARG ;;
        L) kept_log=$OPTARG ;;
        *) own_option "$letter" "${OPTARG:-}" ;;
        esac
    done
    shift $((OPTIND - 1))
    [ $# -gt 0 ] || usage
    [[ $loopbacks$memory_mb$limit_s =~ ^[0-9]+$ ]] || fail "-c, -m and -t take whole numbers" 64
    command_line=("$@")
}

show() {
    local folder
    folder=$(cd "$2" 2>/dev/null && pwd -P) || fail "no such folder: $2" 64
    # A mount option ends at a comma.
    case $folder in *,*) fail "a shown folder must not have a comma in its name: $folder" 64 ;; esac
    shown+=("$1 $folder")
}

# The guest has its own /tmp, /run and /dev/shm: a working folder there has to be shown, unless it is already.
show_working_folder() {
    local here entry
    here=$(pwd -P)
    case $here/ in /tmp/* | /run/* | /dev/*) ;; *) return 0 ;; esac
    for entry in "${shown[@]}"; do
        case $here/ in "${entry#* }"/*) return 0 ;; esac
    done
    show ro "$here"
}

# make_control: `control`, with all that the guest reads.
make_control() {
    show_working_folder
    control=$(mktemp -d "${TMPDIR:-/tmp}/rig.XXXXXX")
    trap 'rm -rf "$control"' EXIT
    cp "$rig_folder/session" "$control/session"
    [ ${#shown[@]} -eq 0 ] || printf '%s\n' "${shown[@]}" >"$control/shown"
    : >"$control/log"
    write_setup >"$control/setup"
    write_command >"$control/command"
}

write_setup() {
    local bus
    for bus in "${buses[@]}"; do
        # 72 is the size of a CAN FD frame as the kernel counts it; 16 would be classic CAN alone.
        printf 'ip link add %q type vcan && ip link set %q mtu 72 up\n' "$bus" "$bus"
    done
    [ ${#setup[@]} -eq 0 ] || printf '%s\n' "${setup[@]}"
}

write_command() {
    local name
    while read -r name; do
        case $name in SHLVL | OLDPWD | PWD | _ | TMPDIR) ;; *) printf 'export %s=%q\n' "$name" "${!name}" ;; esac
    done < <(compgen -e)
    printf 'cd %q || exit 126\nexec' "$(pwd -P)"
    printf ' %q' "${command_line[@]}"
    echo
}

# Options of the v4l2loopback module. Eight buffers: a reader that holds four must not make the writer skip.
loopback_arguments() {
    local numbers
    numbers=$(seq -s , 10 $((9 + loopbacks)))
    echo "devices=$loopbacks video_nr=$numbers max_buffers=8 $loopback_options"
}

# run_guest COMMAND...: the kernel, ended with this script or at the time limit, however this script ends.
run_guest() {
    local guest_pid status=0
    setpriv --pdeathsig TERM timeout -k 5 "$limit_s" "$@" </dev/null &
    guest_pid=$!
    trap 'kill "$guest_pid" 2>/dev/null || true; exit 143' HUP INT TERM
    wait "$guest_pid" || status=$?
    return "$status"
}

# end_run STATUS: exits as the command did. A guest without an exit code is an error, never a pass.
end_run() {
    [ -z "$kept_log" ] || cp "$control/log" "$kept_log"
    [ ! -s "$control/status" ] || exit "$(cat "$control/status")"
    tail -n 12 "$control/log" >&2
    case $1 in
    124 | 137) fail "ended at the time limit of $limit_s s; above is the end of the kernel's log" 124 ;;
    *) fail "the guest ended ($1) without an exit code; above is the end of the kernel's log" 125 ;;
    esac
}

"""Prints what the module publishes, read with the package iceoryx2: nothing to build.

    pip install iceoryx2==0.10.0
    PYTHONPATH=include python3 reader/examples/read_iceoryx2.py [NAME [MESSAGES]]

The package has the version that the module is built with: its files in /dev/shm are laid out by version. `freespace.Reader`
needs no package, and wakes a little faster.
"""

import argparse
import importlib.metadata
import sys
import time

import freespace
import iceoryx2

NOT_OPENED = (
    iceoryx2.EventOpenError,
    iceoryx2.PublishSubscribeOpenError,
    iceoryx2.ListenerCreateError,
    iceoryx2.SubscriberCreateError,
)
# What such an error says, and what it means here.
MEANINGS = {
    "DoesNotExist": freespace.NO_MODULE,
    "IsMarkedForDestruction": freespace.NO_MODULE,
    "HangsInCreation": freespace.NO_MODULE,
    "InsufficientPermissions": freespace.NOT_PERMITTED,
    "ExceedsMaxNumberOfNodes": freespace.TOO_MANY_READERS,
    "ExceedsMaxSupportedListeners": freespace.TOO_MANY_READERS,
    "ExceedsMaxSupportedSubscribers": freespace.TOO_MANY_READERS,
    "IncompatibleTypes": freespace.WRONG_LAYOUT,
    "VersionMismatch": freespace.WRONG_LAYOUT,
}


def check_version():
    found = importlib.metadata.version("iceoryx2")
    if found.split(".")[:2] != freespace.ICEORYX2.split(".")[:2]:
        # It would look for other files, and find none for ever.
        sys.exit(f"iceoryx2 {found} is installed, the module is built with {freespace.ICEORYX2}: install that one")


def make_node():
    config = iceoryx2.config.default()
    config.global_cfg.root_path = iceoryx2.Path.new(freespace.FOLDER)
    config.global_cfg.prefix = iceoryx2.FileName.new(freespace.PREFIX)
    # The module alone clears away what dead readers left: one that is killed over it would leave it for ever.
    config.global_cfg.node.cleanup_dead_nodes_on_creation = False
    config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
    config.global_cfg.service.cleanup_dead_nodes_on_open = False
    # Disabled: Ctrl-C is Python's.
    disabled = iceoryx2.SignalHandlingMode.Disabled
    return iceoryx2.NodeBuilder.new().config(config).signal_handling_mode(disabled).create(iceoryx2.ServiceType.Ipc)


def open_ports(node, name):
    """What wakes, and what receives; the first one first, so that no message slips between the two."""
    try:
        service = node.service_builder(iceoryx2.ServiceName.new(name))
    except iceoryx2.SemanticStringError:
        sys.exit(f"{name!r} is no name of a service: give the `name` of the module's [shared_memory]")
    listener = service.event().open().listener_builder().create()
    messages = service.publish_subscribe(freespace.Message).open()
    return listener, messages.subscriber_builder().buffer_size(1).history_request(1).create()


def wait_for_module(node, name):
    while True:
        try:
            return open_ports(node, name)
        except NOT_OPENED as error:
            code = MEANINGS.get(str(error), freespace.FAILED)
            if code != freespace.NO_MODULE:
                sys.exit(f"{name}: {freespace.CODES[code]} ({error})")
        print(f"{name}: {freespace.CODES[freespace.NO_MODULE]}; waiting", file=sys.stderr)
        time.sleep(1.0)


def next_sample(listener, subscriber, timeout_s):
    """The newest message not had yet, or None. It is read in place, and good for as long as the sample is kept."""
    until = time.monotonic() + timeout_s
    while (sample := subscriber.receive()) is None:
        left = until - time.monotonic()
        if left <= 0.0:
            return None
        try:
            listener.timed_wait(iceoryx2.Duration.from_secs_f64(left))
        except iceoryx2.ListenerWaitError as error:
            # A signal is Python's to handle, which it does now.
            if str(error) != "InterruptSignal":
                raise
    return sample


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
    check_version()
    node = make_node()
    listener, subscriber = wait_for_module(node, arguments.name)
    messages = arguments.messages
    while messages != 0:
        sample = next_sample(listener, subscriber, timeout_s=1.0)
        if sample is None:
            print("no message for 1 s: nothing is known to be free")
            continue
        message = sample.payload().contents
        if not message.is_layout_known():
            sys.exit("the module publishes another layout: take freespace.py of its version")
        show(message)
        messages = messages and messages - 1


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)

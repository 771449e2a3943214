//! Clears away what processes left that were killed: places in services, files, memory.
//!
//! The library does it for a node that it finds dead, but waits for ever where memory of such a node has no size yet, and it
//! does not find what a process left that was killed while it came or went: half a node, whose monitor is without its details, or
//! memory of a port without a tag (a port's tag is made before its memory: old memory without one has no owner). In: the
//! folders where nodes, sockets and memory lie. Invariant: what is younger than `IN_THE_MAKING` may be in the making, and stays;
//! nothing of another user or another program is touched. Cost: listings, a few system calls a node; not for a thread with a
//! deadline. Source: iceoryx2 0.10, `node/mod.rs`, `port/port_lifetime_tag.rs`; iceoryx2-cal 0.10,
//! `dynamic_storage/posix_shared_memory.rs` (`MappingSizeIsZero`); iceoryx2-bb-posix 0.10, `process_state.rs`
//! (`INIT_PERMISSION`).

use std::collections::HashSet;
use std::fs::{self, DirEntry};
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::time::{Duration, SystemTime};

use freespace_reader::service::{FOLDER, Ipc, MEMORY, NODES, PREFIX};
use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeState, NodeView as _};
use iceoryx2::prelude::CallbackProgression;

/// A node `ID` has files `PREFIX ID.node_monitor...`, and a folder `ID`.
const MONITOR: &str = ".node_monitor";
/// The monitor is finished when this one is.
const MONITOR_CONTEXT: &str = ".node_monitor_context";
const DETAILS: &str = "node.details";
/// In a node's folder: a port's tag, `PREFIX ID.port_tag`.
const TAG: &str = ".port_tag";
/// Memory of ports, `PREFIX TYPE_ID[_ID].KIND`: of listeners, of publisher and subscriber, of publishers.
const KINDS: [&str; 3] = ["event_mgmt", "connection", "data"];
/// A listener's socket, `PREFIX ID.event`.
const SOCKET: &str = ".event";
/// Mode of a monitor that is not finished.
const IN_THE_MAKING_MODE: u32 = 0o200;

/// What is not whole after this time never will be: it takes milliseconds, on a machine that has time for it.
const IN_THE_MAKING: Duration = Duration::from_secs(60);
/// The same for memory that has no size: it gets one with the next system call.
const WITHOUT_SIZE: Duration = Duration::from_secs(1);

/// Clears away everything that dead processes left; what cannot be cleared away stays for the next time.
pub(crate) fn clear_away(config: &Config) {
    let (folder, nodes, memory) = (Path::new(FOLDER), Path::new(NODES), Path::new(MEMORY));
    sweep_memory_without_size(memory, WITHOUT_SIZE, |_| true);
    let _ = Node::<Ipc>::list(config, |node| {
        if let NodeState::Dead(node) = node {
            // Its memory is nobody's any more, however young.
            let ports = tags(&nodes.join(node.id().value().to_string()));
            sweep_memory_without_size(memory, Duration::ZERO, |of| {
                of.iter().any(|port| ports.contains(port))
            });
            let _ = node.try_remove_stale_resources();
        }
        CallbackProgression::Continue
    });
    sweep_nodes(nodes, IN_THE_MAKING);
    sweep_memory(folder, nodes, memory, IN_THE_MAKING);
}

/// Removes memory that has no size and is of such ports, or of none; how much that was.
fn sweep_memory_without_size(
    memory: &Path,
    older_than: Duration,
    is_wanted: impl Fn(&[String]) -> bool,
) -> usize {
    (listing(memory))
        .filter(|entry| {
            let name = entry.file_name();
            let name = name.to_str().unwrap_or_default();
            name.starts_with(PREFIX) && is_wanted(&ports_of(name).unwrap_or_default())
        })
        .filter(|entry| {
            entry
                .metadata()
                .is_ok_and(|metadata| metadata.is_file() && metadata.len() == 0)
        })
        .filter(|entry| is_own(entry) && is_old(entry, older_than))
        .filter(|entry| fs::remove_file(entry.path()).is_ok())
        .count()
}

/// Removes halves of nodes; how many files and folders that were.
fn sweep_nodes(nodes: &Path, older_than: Duration) -> usize {
    (listing(nodes))
        .filter(|entry| is_half_a_node(nodes, entry) && is_old(entry, older_than))
        .filter(|entry| remove(entry).is_ok())
        .count()
}

/// Removes memory of ports that no node has, from `memory`, and their sockets, from `folder`; how many ports that were.
fn sweep_memory(folder: &Path, nodes: &Path, memory: &Path, older_than: Duration) -> usize {
    let tags: HashSet<String> = listing(nodes).flat_map(|node| tags(&node.path())).collect();
    (listing(memory))
        .filter_map(|entry| Some((ports_of(entry.file_name().to_str()?)?, entry)))
        .filter(|(ports, _)| !ports.iter().any(|port| tags.contains(port)))
        .filter(|(_, entry)| is_own(entry) && is_old(entry, older_than))
        .filter(|(ports, entry)| {
            for port in ports {
                // Listeners alone have one, and not to the end.
                let _ = fs::remove_file(folder.join(format!("{PREFIX}{port}{SOCKET}")));
            }
            fs::remove_file(entry.path()).is_ok()
        })
        .count()
}

/// The ports that a node has.
fn tags(node: &Path) -> HashSet<String> {
    (listing(node))
        .filter_map(|entry| {
            let name = entry.file_name();
            let id = name.to_str()?.strip_prefix(PREFIX)?.strip_suffix(TAG)?;
            Some(id.to_owned())
        })
        .collect()
}

/// The ports whose memory this is.
fn ports_of(name: &str) -> Option<Vec<String>> {
    let (stem, kind) = name.strip_prefix(PREFIX)?.split_once('.')?;
    let (_type, ids) = stem.split_once('_')?;
    let ports: Vec<String> = ids.split('_').map(str::to_owned).collect();
    (KINDS.contains(&kind) && ports.iter().all(|port| is_id(port))).then_some(ports)
}

/// Of a folder that cannot be read, nothing.
fn listing(folder: &Path) -> impl Iterator<Item = DirEntry> + use<> {
    fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok)
}

fn is_id(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

fn is_own(entry: &DirEntry) -> bool {
    let own = rustix::process::geteuid().as_raw();
    entry.metadata().is_ok_and(|metadata| metadata.uid() == own)
}

fn is_old(entry: &DirEntry, older_than: Duration) -> bool {
    let changed = entry.metadata().and_then(|metadata| metadata.modified());
    let now = SystemTime::now();
    changed.is_ok_and(|changed| now.duration_since(changed).is_ok_and(|age| age >= older_than))
}

fn is_half_a_node(nodes: &Path, entry: &DirEntry) -> bool {
    let name = entry.file_name();
    let Some(id) = name.to_str().and_then(node_of) else {
        return false;
    };
    let part = |suffix: &str| nodes.join(format!("{PREFIX}{id}{suffix}"));
    let is_finished = fs::metadata(part(MONITOR_CONTEXT))
        .is_ok_and(|metadata| metadata.mode() & 0o777 != IN_THE_MAKING_MODE);
    let has_details = nodes.join(id).join(format!("{PREFIX}{DETAILS}")).exists();
    !(is_finished && part(MONITOR).exists() && has_details)
}

/// The node that an entry is of; none where it is no entry of a node.
fn node_of(name: &str) -> Option<&str> {
    let id = match name.strip_prefix(PREFIX) {
        Some(rest) => rest.split_once(MONITOR)?.0,
        None => name,
    };
    is_id(id).then_some(id)
}

fn remove(entry: &DirEntry) -> std::io::Result<()> {
    if entry.file_type()?.is_dir() {
        fs::remove_dir_all(entry.path())
    } else {
        fs::remove_file(entry.path())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    fn write(path: &Path, mode: u32) {
        fs::write(path, "").unwrap();
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    }

    fn file(name: &str) -> String {
        format!("{PREFIX}{name}")
    }

    /// A node with a monitor of this mode and such ports.
    fn make_node(nodes: &Path, id: u32, monitor: u32, ports: &[u32]) {
        for suffix in ["", "_context", "_owner_lock"] {
            write(&nodes.join(file(&format!("{id}.node_monitor{suffix}"))), monitor);
        }
        let own = nodes.join(id.to_string());
        fs::create_dir(&own).unwrap();
        write(&own.join(file("node.details")), 0o400);
        for port in ports {
            write(&own.join(file(&format!("{port}.port_tag"))), 0o400);
        }
    }

    fn count(folder: &Path) -> usize {
        listing(folder).count()
    }

    #[test]
    fn what_is_half_a_node_goes_once_it_is_old_and_all_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let nodes = folder.path();
        for living in [11, 12] {
            make_node(nodes, living, 0o600, &[7]);
        }
        let whole = count(nodes);
        // No monitor; its context alone; no details; a monitor that was never finished.
        fs::create_dir(nodes.join("21")).unwrap();
        write(&nodes.join("21").join(file("node.details")), 0o400);
        write(&nodes.join(file("22.node_monitor_context")), 0o600);
        fs::create_dir(nodes.join("23")).unwrap();
        write(&nodes.join(file("23.node_monitor")), 0o600);
        make_node(nodes, 24, 0o200, &[]);
        write(&nodes.join("notes"), 0o600);
        assert_eq!(sweep_nodes(nodes, Duration::from_secs(3600)), 0);
        assert_eq!(sweep_nodes(nodes, Duration::ZERO), 8);
        assert_eq!(sweep_nodes(nodes, Duration::ZERO), 0);
        assert_eq!(count(nodes), whole + 1);
        assert_eq!(sweep_nodes(&nodes.join("none"), Duration::ZERO), 0);
    }

    #[test]
    fn memory_without_a_size_goes_and_the_rest_stays() {
        let memory = tempfile::tempdir().unwrap();
        let stays = [file("b9fc_11_21.connection"), "other_1.connection".to_owned()];
        fs::write(memory.path().join(&stays[0]), "sized").unwrap();
        let goes = [file("b9fc_11_22.connection"), file("1124_5.dynamic")];
        for name in goes.iter().chain(&stays[1..]) {
            fs::write(memory.path().join(name), "").unwrap();
        }
        let hour = Duration::from_secs(3600);
        assert_eq!(sweep_memory_without_size(memory.path(), hour, |_| true), 0);
        let of_22 = |ports: &[String]| ports.contains(&"22".to_owned());
        assert_eq!(sweep_memory_without_size(memory.path(), Duration::ZERO, of_22), 1);
        assert_eq!(
            sweep_memory_without_size(memory.path(), Duration::ZERO, |_| true),
            1
        );
        assert_eq!(count(memory.path()), stays.len());
        assert!(stays.iter().all(|name| memory.path().join(name).exists()));
    }

    #[test]
    fn memory_of_ports_that_no_node_has_goes_once_it_is_old_and_all_else_stays() {
        let (folder, memory) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let nodes = folder.path().join("nodes");
        fs::create_dir(&nodes).unwrap();
        make_node(&nodes, 1, 0o600, &[11, 12, 13]);
        let stays = [
            file("33c1_11.event_mgmt"),
            // One of its two ends lives.
            file("b9fc_12_21.connection"),
            file("b9fc_21_12.connection"),
            file("0354_13.data"),
            // Not a port's.
            file("1124_21.dynamic"),
            file("9204_node.0_10_0.global_mgmt"),
            "other_33c1_21.event_mgmt".to_owned(),
        ];
        let goes = [
            file("33c1_21.event_mgmt"),
            file("33c1_22.event_mgmt"),
            file("b9fc_21_23.connection"),
            file("0354_24.data"),
        ];
        for name in stays.iter().chain(&goes) {
            write(&memory.path().join(name), 0o600);
        }
        for id in [11, 21] {
            write(&folder.path().join(file(&format!("{id}.event"))), 0o600);
        }
        let swept = |older_than| sweep_memory(folder.path(), &nodes, memory.path(), older_than);
        assert_eq!(swept(Duration::from_secs(3600)), 0);
        assert_eq!(swept(Duration::ZERO), goes.len());
        assert_eq!(swept(Duration::ZERO), 0);
        assert_eq!(count(memory.path()), stays.len());
        assert!(stays.iter().all(|name| memory.path().join(name).exists()));
        assert!(folder.path().join(file("11.event")).exists());
        assert!(!folder.path().join(file("21.event")).exists());
    }
}

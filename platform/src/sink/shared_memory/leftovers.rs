//! What a reader leaves that is killed while it becomes a node, or makes its listener: files that the library does not find again.
//!
//! The library finds a node by its monitor, and what it held by its details. A process that is killed while it makes them or
//! takes them away leaves one without the other. A listener's memory may be read once it is finished: one that is not can be
//! opened by nobody, ever. In: the folder of the nodes; where memory and sockets lie. Invariant: what is whole is left to the
//! library; what is younger than `older_than` may be in the making; nothing of another user is touched. Cost: a listing each; not
//! for a thread with a deadline. Source: iceoryx2-cal 0.10, `dynamic_storage/posix_shared_memory.rs` (`INIT_PERMISSIONS`).

use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::time::{Duration, SystemTime};

/// Files of a node are named `iox2_ID.node_monitor...`, its folder `ID`.
const PREFIX: &str = "iox2_";
const MONITOR: &str = ".node_monitor";
const DETAILS: &str = "iox2_node.details";
const LISTENER: &str = ".event_mgmt";
/// Mode of memory that is not finished.
const IN_THE_MAKING_MODE: u32 = 0o200;

/// Removes what belongs to no node; how many files and folders that were.
pub(super) fn sweep(nodes: &Path, older_than: Duration) -> usize {
    let Ok(listing) = fs::read_dir(nodes) else {
        return 0;
    };
    (listing.filter_map(Result::ok))
        .filter(|entry| is_orphan(nodes, entry) && is_old(entry, older_than))
        .filter(|entry| remove(entry).is_ok())
        .count()
}

/// Removes listeners that were never finished: their memory, in `memory`, and their sockets, in `folder`; how many they were.
pub(super) fn sweep_listeners(folder: &Path, memory: &Path, older_than: Duration) -> usize {
    let Ok(listing) = fs::read_dir(memory) else {
        return 0;
    };
    let own = rustix::process::geteuid().as_raw();
    let is_unfinished = |entry: &fs::DirEntry| {
        (entry.metadata())
            .is_ok_and(|metadata| metadata.mode() & 0o777 == IN_THE_MAKING_MODE && metadata.uid() == own)
    };
    (listing.filter_map(Result::ok))
        .filter_map(|entry| Some((listener_of(entry.file_name().to_str()?)?.to_owned(), entry)))
        .filter(|(_, entry)| is_unfinished(entry) && is_old(entry, older_than))
        .filter(|(id, entry)| {
            // It may have come so far, or not.
            let _ = fs::remove_file(folder.join(format!("{PREFIX}{id}.event")));
            fs::remove_file(entry.path()).is_ok()
        })
        .count()
}

/// The listener whose memory this is: `iox2_SERVICE_ID.event_mgmt`.
fn listener_of(name: &str) -> Option<&str> {
    let (_, id) = (name.strip_prefix(PREFIX)?.strip_suffix(LISTENER)?).rsplit_once('_')?;
    (!id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit())).then_some(id)
}

fn is_old(entry: &fs::DirEntry, older_than: Duration) -> bool {
    let changed = entry.metadata().and_then(|metadata| metadata.modified());
    let now = SystemTime::now();
    changed.is_ok_and(|changed| now.duration_since(changed).is_ok_and(|age| age >= older_than))
}

fn is_orphan(nodes: &Path, entry: &fs::DirEntry) -> bool {
    let name = entry.file_name();
    let Some(id) = name.to_str().and_then(node_of) else {
        return false;
    };
    let has_monitor = nodes.join(format!("{PREFIX}{id}{MONITOR}")).exists();
    !(has_monitor && nodes.join(id).join(DETAILS).exists())
}

/// The node that an entry is of; none where it is no entry of a node.
fn node_of(name: &str) -> Option<&str> {
    let id = match name.strip_prefix(PREFIX) {
        Some(rest) => rest.split_once(MONITOR)?.0,
        None => name,
    };
    (!id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit())).then_some(id)
}

fn remove(entry: &fs::DirEntry) -> std::io::Result<()> {
    if entry.file_type()?.is_dir() {
        fs::remove_dir_all(entry.path())
    } else {
        fs::remove_file(entry.path())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn what_is_half_a_node_goes_once_it_is_old_and_all_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let nodes = folder.path();
        for living in ["11", "12"] {
            fs::create_dir(nodes.join(living)).unwrap();
            fs::write(nodes.join(living).join(DETAILS), "").unwrap();
            for suffix in ["", "_context", "_owner_lock"] {
                fs::write(nodes.join(format!("iox2_{living}.node_monitor{suffix}")), "").unwrap();
            }
        }
        fs::create_dir(nodes.join("21")).unwrap();
        fs::write(nodes.join("21/iox2_node.details"), "").unwrap();
        fs::write(nodes.join("iox2_22.node_monitor_context"), "").unwrap();
        fs::create_dir(nodes.join("23")).unwrap();
        fs::write(nodes.join("iox2_23.node_monitor"), "").unwrap();
        fs::write(nodes.join("notes"), "").unwrap();
        assert_eq!(sweep(nodes, Duration::from_secs(3600)), 0);
        assert_eq!(sweep(nodes, Duration::ZERO), 4);
        assert_eq!(sweep(nodes, Duration::ZERO), 0);
        assert_eq!(fs::read_dir(nodes).unwrap().count(), 9);
        assert_eq!(sweep(&nodes.join("none"), Duration::ZERO), 0);
    }

    #[test]
    fn a_listener_that_was_never_finished_goes_once_it_is_old_and_all_else_stays() {
        use std::os::unix::fs::PermissionsExt as _;
        let (folder, memory) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        for (name, mode) in [
            ("iox2_33c1_11.event_mgmt", 0o600),
            ("iox2_33c1_21.event_mgmt", 0o200),
            // Killed before it had a socket.
            ("iox2_33c1_22.event_mgmt", 0o200),
            ("iox2_33c1_23.dynamic", 0o200),
            ("other_33c1_24.event_mgmt", 0o200),
        ] {
            let path = memory.path().join(name);
            fs::write(&path, "").unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        }
        for id in [11, 21, 24] {
            fs::write(folder.path().join(format!("iox2_{id}.event")), "").unwrap();
        }
        let swept = |older_than| sweep_listeners(folder.path(), memory.path(), older_than);
        assert_eq!(swept(Duration::from_secs(3600)), 0);
        assert_eq!(swept(Duration::ZERO), 2);
        assert_eq!(swept(Duration::ZERO), 0);
        assert_eq!(fs::read_dir(memory.path()).unwrap().count(), 3);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
        assert!(!folder.path().join("iox2_21.event").exists());
    }
}

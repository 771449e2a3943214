//! What a reader leaves that is killed while it becomes a node: files that the library does not find again.
//!
//! The library finds a node by its monitor, and what it held by its details. A process that is killed while it makes them or
//! takes them away leaves one without the other. In: the folder of the nodes. Invariant: a node that has both is left to the
//! library; what is younger than `older_than` may be in the making. Cost: one listing; not for a thread with a deadline.

use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};

/// Files of a node are named `iox2_ID.node_monitor...`, its folder `ID`.
const PREFIX: &str = "iox2_";
const MONITOR: &str = ".node_monitor";
const DETAILS: &str = "iox2_node.details";

/// Removes what belongs to no node; how many files and folders that were.
pub(super) fn sweep(nodes: &Path, older_than: Duration) -> usize {
    let Ok(listing) = fs::read_dir(nodes) else {
        return 0;
    };
    let now = SystemTime::now();
    let is_old = |entry: &fs::DirEntry| {
        let changed = entry.metadata().and_then(|metadata| metadata.modified());
        changed.is_ok_and(|changed| now.duration_since(changed).is_ok_and(|age| age >= older_than))
    };
    (listing.filter_map(Result::ok))
        .filter(|entry| is_orphan(nodes, entry) && is_old(entry))
        .filter(|entry| remove(entry).is_ok())
        .count()
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
}

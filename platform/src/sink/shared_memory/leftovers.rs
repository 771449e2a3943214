//! Clears away what processes left that were killed: places in services, files, memory.
//!
//! The library does it for a node that it finds dead. It does not find what a process left that was killed while it came or went:
//! a service or a monitor that was never finished, a monitor without details, memory of a port without a tag (a port's tag is made
//! before its memory, and goes after it). And where memory has no size yet it waits for ever, if it may open it (root may). In: the
//! folders where nodes, services, sockets and memory lie. Invariant: what may still be in the making stays; nothing of another user
//! or another program is touched; a folder that cannot be listed hides nothing: nothing is removed then. Cost: listings, a few
//! system calls a node; not for a thread with a deadline. Source: iceoryx2 0.10, `node/mod.rs`, `port/port_lifetime_tag.rs`;
//! iceoryx2-cal 0.10, `dynamic_storage/posix_shared_memory.rs` (`MappingSizeIsZero`), `static_storage/file.rs`;
//! iceoryx2-bb-posix 0.10, `process_state.rs`.

use std::collections::HashSet;
use std::fs::{self, DirEntry, Metadata};
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use freespace_reader::service::{self, FOLDER, Ipc, MEMORY, PREFIX};
use iceoryx2::node::{DeadNodeView, Node, NodeState, NodeView as _};
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
/// Memory of a service.
const SERVICE_MEMORY: &str = ".dynamic";
/// Memory of all processes, in which they count nodes.
const COMMON_MEMORY: &str = ".global_mgmt";
/// Mode of a monitor, and of memory, that is not finished.
const UNFINISHED_MODE: u32 = 0o200;
/// Mode of a service that is not finished.
const UNFINISHED_SERVICE_MODE: u32 = 0o600;

/// After this time what is not whole never will be: it takes milliseconds, on a machine that has time for it.
pub(super) const IN_THE_MAKING: Duration = Duration::from_secs(60);
/// The same at a start that finds no way in otherwise, and for memory that has no size: it gets one with the next system call.
pub(super) const JUST_MADE: Duration = Duration::from_secs(1);

/// Clears away what dead processes left, and what is unfinished for longer than `unfinished_after`.
pub(super) fn clear_away(unfinished_after: Duration) {
    // What cannot be cleared away, or looked at, now, may be later.
    let _ = Places::new(Path::new(FOLDER), Path::new(MEMORY)).clear_away(unfinished_after);
}

/// Where everything lies.
struct Places {
    folder: PathBuf,
    nodes: PathBuf,
    services: PathBuf,
    memory: PathBuf,
}

impl Places {
    fn new(folder: &Path, memory: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            nodes: folder.join("nodes"),
            services: folder.join("services"),
            memory: memory.to_owned(),
        }
    }

    fn clear_away(&self, unfinished_after: Duration) -> io::Result<()> {
        self.sweep_memory_without_size(JUST_MADE)?;
        self.sweep_services(unfinished_after)?;
        // The library would look into it.
        let may_look = !(listing(&self.memory)?.iter())
            .any(|found| found.name.ends_with(SERVICE_MEMORY) && found.metadata.len() == 0);
        if may_look {
            let _ = Node::<Ipc>::list(&service::config(), |node| {
                if let NodeState::Dead(node) = node {
                    let _ = self.clear_away_node(node);
                }
                CallbackProgression::Continue
            });
        }
        self.sweep_nodes(unfinished_after)?;
        self.sweep_memory(unfinished_after)
    }

    /// What the library finds of a dead node.
    fn clear_away_node(&self, node: DeadNodeView<Ipc>) -> io::Result<()> {
        let tags = tags(&self.nodes.join(node.id().value().to_string()))?;
        for found in listing(&self.memory)? {
            // It is nobody's any more, however young.
            if found.metadata.len() == 0 && found.ports().iter().any(|port| tags.contains(port)) {
                found.remove()?;
            }
        }
        node.try_remove_stale_resources().map_err(io::Error::other)
    }

    /// Memory without a size, but for that of ports with a tag: those may live, and are stopped where they stand.
    fn sweep_memory_without_size(&self, older_than: Duration) -> io::Result<()> {
        let tags = self.tags()?;
        for found in listing(&self.memory)? {
            let ports = found.ports();
            let is_memory = !ports.is_empty()
                || found.name.ends_with(SERVICE_MEMORY)
                || found.name.ends_with(COMMON_MEMORY);
            let has_tag = ports.iter().any(|port| tags.contains(port));
            let has_size = found.metadata.len() > 0;
            if is_memory && !has_tag && !has_size && found.is_older_than(older_than) {
                found.remove()?;
            }
        }
        Ok(())
    }

    /// Services, and what all of them share, that were never finished: nobody can open them, or make them anew.
    fn sweep_services(&self, older_than: Duration) -> io::Result<()> {
        let services = listing(&self.services)?.into_iter();
        let services = services.filter(|found| found.mode() == UNFINISHED_SERVICE_MODE);
        let common = listing(&self.memory)?.into_iter();
        let common =
            common.filter(|found| found.name.ends_with(COMMON_MEMORY) && found.mode() == UNFINISHED_MODE);
        for found in services.chain(common) {
            if found.is_older_than(older_than) {
                found.remove()?;
            }
        }
        Ok(())
    }

    /// Halves of nodes.
    fn sweep_nodes(&self, older_than: Duration) -> io::Result<()> {
        for found in listing(&self.nodes)? {
            if self.is_half_a_node(&found)? && found.is_older_than(older_than) {
                found.remove()?;
            }
        }
        Ok(())
    }

    fn is_half_a_node(&self, found: &Found) -> io::Result<bool> {
        let Some(id) = found.node() else {
            return Ok(false);
        };
        let part = |suffix: &str| self.nodes.join(format!("{PREFIX}{id}{suffix}"));
        let is_finished = match fs::metadata(part(MONITOR_CONTEXT)) {
            Err(error) if error.kind() == ErrorKind::NotFound => false,
            metadata => metadata?.mode() & 0o777 != UNFINISHED_MODE,
        };
        let details = self.nodes.join(id).join(format!("{PREFIX}{DETAILS}"));
        Ok(!(is_finished && part(MONITOR).try_exists()? && details.try_exists()?))
    }

    /// Memory of ports that no node has, and their sockets.
    fn sweep_memory(&self, older_than: Duration) -> io::Result<()> {
        let tags = self.tags()?;
        for found in listing(&self.memory)? {
            let ports = found.ports();
            let is_owned = ports.is_empty() || ports.iter().any(|port| tags.contains(port));
            if is_owned || !found.is_older_than(older_than) {
                continue;
            }
            for port in ports {
                // Listeners alone have one, and not to the end.
                let _ = fs::remove_file(self.folder.join(format!("{PREFIX}{port}{SOCKET}")));
            }
            found.remove()?;
        }
        Ok(())
    }

    /// The ports that nodes have.
    fn tags(&self) -> io::Result<HashSet<String>> {
        let mut all = HashSet::new();
        for node in listing(&self.nodes)? {
            if node.metadata.is_dir() {
                all.extend(tags(&node.path)?);
            }
        }
        Ok(all)
    }
}

/// The ports that a node has.
fn tags(node: &Path) -> io::Result<HashSet<String>> {
    let tag = |found: &Found| {
        let id = found.name.strip_prefix(PREFIX)?.strip_suffix(TAG)?;
        Some(id.to_owned())
    };
    Ok(listing(node)?.iter().filter_map(tag).collect())
}

/// An entry of this user's and this program's.
struct Found {
    name: String,
    path: PathBuf,
    metadata: Metadata,
}

impl Found {
    fn of(entry: &DirEntry) -> io::Result<Option<Self>> {
        let Ok(name) = entry.file_name().into_string() else {
            return Ok(None);
        };
        if !name.starts_with(PREFIX) && !is_id(&name) {
            return Ok(None);
        }
        let metadata = match entry.metadata() {
            // It has gone meanwhile.
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            metadata => metadata?,
        };
        let is_own = metadata.uid() == rustix::process::geteuid().as_raw();
        let is_ours = name.starts_with(PREFIX) || metadata.is_dir();
        Ok((is_own && is_ours).then(|| Self {
            name,
            path: entry.path(),
            metadata,
        }))
    }

    fn mode(&self) -> u32 {
        self.metadata.mode() & 0o777
    }

    fn is_older_than(&self, age: Duration) -> bool {
        let changed = self.metadata.modified().ok();
        let found = changed.and_then(|changed| SystemTime::now().duration_since(changed).ok());
        found.is_some_and(|found| found >= age)
    }

    /// The node that it is of.
    fn node(&self) -> Option<&str> {
        let id = match self.name.strip_prefix(PREFIX) {
            Some(rest) => rest.split_once(MONITOR)?.0,
            None => &self.name,
        };
        is_id(id).then_some(id)
    }

    /// The ports whose memory it is.
    fn ports(&self) -> Vec<String> {
        let ports = || {
            let (stem, kind) = self.name.strip_prefix(PREFIX)?.split_once('.')?;
            let (_type, ids) = stem.split_once('_')?;
            let is_of_ports = KINDS.contains(&kind) && ids.split('_').all(is_id);
            is_of_ports.then(|| ids.split('_').map(str::to_owned).collect())
        };
        ports().unwrap_or_default()
    }

    fn remove(&self) -> io::Result<()> {
        let removed = if self.metadata.is_dir() {
            fs::remove_dir_all(&self.path)
        } else {
            fs::remove_file(&self.path)
        };
        match removed {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
            removed => removed,
        }
    }
}

fn is_id(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// What is in a folder; nothing where there is none.
fn listing(folder: &Path) -> io::Result<Vec<Found>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    entries
        .map(|entry| Found::of(&entry?))
        .filter_map(Result::transpose)
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    /// A folder for everything but memory, and one for memory.
    struct Scene {
        _root: tempfile::TempDir,
        places: Places,
    }

    impl Scene {
        fn new() -> Self {
            let root = tempfile::tempdir().unwrap();
            let places = Places::new(&root.path().join("all"), &root.path().join("memory"));
            for folder in [&places.nodes, &places.services, &places.memory] {
                fs::create_dir_all(folder).unwrap();
            }
            Self { _root: root, places }
        }

        /// A node with a monitor of this mode and such ports.
        fn make_node(&self, id: u32, monitor: u32, ports: &[u32]) {
            let nodes = &self.places.nodes;
            for suffix in ["", "_context", "_owner_lock"] {
                write(
                    &nodes.join(file(&format!("{id}.node_monitor{suffix}"))),
                    monitor,
                    "",
                );
            }
            let own = nodes.join(id.to_string());
            fs::create_dir(&own).unwrap();
            write(&own.join(file("node.details")), 0o400, "details");
            for port in ports {
                write(&own.join(file(&format!("{port}.port_tag"))), 0o400, "");
            }
        }

        fn make_memory(&self, names: &[String], text: &str) {
            for name in names {
                write(&self.places.memory.join(name), 0o600, text);
            }
        }
    }

    fn write(path: &Path, mode: u32, text: &str) {
        fs::write(path, text).unwrap();
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    }

    fn file(name: &str) -> String {
        format!("{PREFIX}{name}")
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<_> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn what_is_half_a_node_goes_once_it_is_old_and_all_else_stays() {
        let scene = Scene::new();
        let nodes = &scene.places.nodes;
        for living in [11, 12] {
            scene.make_node(living, 0o600, &[7]);
        }
        write(&nodes.join("notes"), 0o600, "");
        let whole = names(nodes);
        // No monitor; its context alone; no details; a monitor that was never finished.
        fs::create_dir(nodes.join("21")).unwrap();
        write(&nodes.join("21").join(file("node.details")), 0o400, "");
        write(&nodes.join(file("22.node_monitor_context")), 0o600, "");
        fs::create_dir(nodes.join("23")).unwrap();
        write(&nodes.join(file("23.node_monitor")), 0o600, "");
        scene.make_node(24, 0o200, &[]);
        let all = names(nodes);
        scene.places.sweep_nodes(HOUR).unwrap();
        assert_eq!(names(nodes), all);
        scene.places.sweep_nodes(Duration::ZERO).unwrap();
        assert_eq!(names(nodes), whole);
    }

    #[test]
    fn memory_of_ports_that_no_node_has_goes_once_it_is_old_and_all_else_stays() {
        let scene = Scene::new();
        let Places { folder, memory, .. } = &scene.places;
        scene.make_node(1, 0o600, &[11, 12, 13]);
        let mut stays = [
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
        scene.make_memory(&stays, "x");
        scene.make_memory(&goes, "x");
        for id in [11, 21] {
            write(&folder.join(file(&format!("{id}.event"))), 0o600, "");
        }
        scene.places.sweep_memory(HOUR).unwrap();
        assert_eq!(names(memory).len(), stays.len() + goes.len());
        scene.places.sweep_memory(Duration::ZERO).unwrap();
        stays.sort();
        assert_eq!(names(memory), stays);
        assert!(folder.join(file("11.event")).exists());
        assert!(!folder.join(file("21.event")).exists());
    }

    #[test]
    fn memory_without_a_size_goes_where_no_port_can_be_making_it() {
        let scene = Scene::new();
        scene.make_node(1, 0o600, &[11]);
        let in_the_making = [file("b9fc_11_21.connection"), "other_1.connection".to_owned()];
        let goes = [file("b9fc_12_22.connection"), file("1124_5.dynamic")];
        scene.make_memory(&in_the_making, "");
        scene.make_memory(&goes, "");
        scene.make_memory(&[file("1124_6.dynamic")], "x");
        // Of no kind that the library makes.
        scene.make_memory(&[file("notes")], "");
        scene.places.sweep_memory_without_size(HOUR).unwrap();
        assert_eq!(names(&scene.places.memory).len(), 6);
        scene.places.sweep_memory_without_size(Duration::ZERO).unwrap();
        let mut stays = [&in_the_making[..], &[file("1124_6.dynamic"), file("notes")]].concat();
        stays.sort();
        assert_eq!(names(&scene.places.memory), stays);
    }

    #[test]
    fn a_service_that_was_never_finished_goes_once_it_is_old() {
        let scene = Scene::new();
        let Places { services, memory, .. } = &scene.places;
        write(&services.join(file("01.service")), 0o400, "x");
        write(&services.join(file("02.service")), 0o600, "");
        write(&memory.join(file("9204_node.0_10_0.global_mgmt")), 0o200, "x");
        scene.places.sweep_services(HOUR).unwrap();
        assert_eq!((names(services).len(), names(memory).len()), (2, 1));
        scene.places.sweep_services(Duration::ZERO).unwrap();
        assert_eq!(names(services), [file("01.service")]);
        assert!(names(memory).is_empty());
    }

    #[test]
    fn nothing_goes_where_a_folder_cannot_be_listed() {
        let scene = Scene::new();
        scene.make_memory(&[file("33c1_21.event_mgmt")], "x");
        fs::remove_dir_all(&scene.places.nodes).unwrap();
        // Whatever is no folder cannot be listed, by root either.
        write(&scene.places.nodes, 0o600, "");
        assert!(scene.places.sweep_memory(Duration::ZERO).is_err());
        assert_eq!(names(&scene.places.memory).len(), 1);
    }
}

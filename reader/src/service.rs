//! What writer and readers agree on: names, payload, and the node each of them is.
//!
//! The module alone decides how many readers there may be; a reader opens what is there. Source: iceoryx2 0.10.

use core::fmt::{self, Debug, Formatter};
use core::time::Duration;

use freespace::emit::SharedMessage;
use iceoryx2::prelude::*;

/// The technology: files in `/dev/shm`, no daemon.
pub type Ipc = ipc::Service;

/// Name of the service where the configuration gives none.
pub const DEFAULT_NAME: &str = "freespace/grid";

/// Messages that wait for a reader; the newest wins.
pub const READER_BUFFER: usize = 1;
/// Messages that a reader may hold at a time: the one it looks at, and the next.
pub const READER_HOLDS: usize = 2;
/// Messages that a new reader gets at once: the last one.
pub const HISTORY: usize = 1;
/// Messages that the module writes at a time.
pub const WRITER_HOLDS: usize = 1;

/// The event of a message.
pub const MESSAGE_EVENT: usize = 0;
/// The event of a message that is being made: it comes within [`SOON`], if it comes. Who waits for messages may stay awake.
pub const SOON_EVENT: usize = 1;
/// How soon.
pub const SOON: Duration = Duration::from_micros(300);

/// Slots of the module's segment: enough for the worst case, all of them made before the start.
#[must_use]
pub const fn slots(max_readers: usize) -> usize {
    max_readers * (READER_BUFFER + READER_HOLDS) + HISTORY + WRITER_HOLDS
}

/// The library's version: it lays out its files by it.
pub const ICEORYX2: &str = "0.10.0";

/// What the service calls the type of its messages.
pub const PAYLOAD_NAME: &str = "freespace_message_1";

/// A message, as the service names its type.
#[repr(transparent)]
pub struct Payload(pub SharedMessage);

// SAFETY: it is `#[repr(C)]` through and through, holds numbers alone, and its name changes with its layout.
unsafe impl ZeroCopySend for Payload {
    unsafe fn type_name() -> &'static str {
        PAYLOAD_NAME
    }
}

impl Debug for Payload {
    /// Its number alone: a grid is no line of a log.
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        write!(formatter, "message {}", self.0.sequence)
    }
}

/// Where everything lies that is no memory itself: the lists of nodes, services and sockets.
///
/// In `/dev/shm`, which a service manager that gives each unit a `/tmp` of its own leaves shared.
pub const FOLDER: &str = "/dev/shm/freespace";
/// Where memory lies.
pub const MEMORY: &str = "/dev/shm";
/// How every file's name begins: memory of other programs that use the library is another's.
pub const PREFIX: &str = "freespace_";

/// The library's settings for the service; no file of settings changes them.
///
/// Nothing is cleared away of what dead processes left: the module does that, where it is ready to. A process that is killed while
/// it clears away leaves what nobody clears away again, and readers are killed as they come and go.
#[must_use]
pub fn config() -> Config {
    let mut config = Config::default();
    if let Ok(folder) = Path::new(FOLDER.as_bytes()) {
        config.global.set_root_path(&folder);
    }
    if let Ok(prefix) = FileName::new(PREFIX.as_bytes()) {
        config.global.prefix = prefix;
    }
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    config
}

/// A node for one process's part in the service. It leaves the process's signals alone.
///
/// # Errors
/// `/dev/shm` or the folder of the services cannot be written to.
pub fn node() -> Result<Node<Ipc>, NodeCreationFailure> {
    NodeBuilder::new()
        .config(&config())
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create()
}

pub use iceoryx2::node::NodeCreationFailure;

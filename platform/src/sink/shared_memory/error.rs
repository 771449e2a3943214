//! Why nothing can be shared, each with its fix.

use freespace_reader::service::NodeCreationFailure;
use iceoryx2::port::notifier::NotifierCreateError;
use iceoryx2::port::publisher::PublisherCreateError;
use iceoryx2::service::builder::event::{EventOpenError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};

/// Why nothing can be shared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SharingError {
    /// The system gave no thread.
    #[error("the sharing thread could not be started: raise the limit of threads (ulimit -u)")]
    Thread,
    /// The name is none.
    #[error("`name` in [shared_memory] is no name of a service: write one such as \"freespace/grid\"")]
    Name,
    /// Another module publishes there.
    #[error(
        "another module publishes under this name: stop it, or give this one another `name` in [shared_memory]"
    )]
    Taken,
    /// Readers hold on to the service of an earlier module.
    #[error(
        "readers of an earlier run with another [shared_memory] or another version are connected: stop them, or start them anew"
    )]
    Held,
    /// Not ours to write to.
    #[error(
        "/dev/shm/freespace may not be written to: run as the user whom it belongs to, or remove it while no module runs"
    )]
    NotPermitted,
    /// There is no room, or the file system is not there.
    #[error(
        "no room in shared memory: mount -o remount,size=64m /dev/shm (docker: --shm-size=64m), or lower `max_readers`"
    )]
    NoRoom,
    /// The library failed.
    #[error("the shared-memory library failed: look at /dev/shm, then start again")]
    Library,
}

impl From<NodeCreationFailure> for SharingError {
    fn from(failure: NodeCreationFailure) -> Self {
        match failure {
            NodeCreationFailure::InsufficientPermissions => Self::NotPermitted,
            _ => Self::Library,
        }
    }
}

impl From<PublishSubscribeOpenOrCreateError> for SharingError {
    fn from(error: PublishSubscribeOpenOrCreateError) -> Self {
        use PublishSubscribeOpenError as Open;
        use PublishSubscribeOpenOrCreateError as Either;
        match error {
            Either::PublishSubscribeOpenError(Open::InsufficientPermissions) => Self::NotPermitted,
            Either::PublishSubscribeOpenError(
                Open::InternalFailure
                | Open::ServiceInCorruptedState
                | Open::HangsInCreation
                | Open::Interrupt,
            )
            | Either::SystemInFlux => Self::Library,
            Either::PublishSubscribeOpenError(_) => Self::Held,
            Either::PublishSubscribeCreateError(_) => Self::NoRoom,
        }
    }
}

impl From<EventOpenOrCreateError> for SharingError {
    fn from(error: EventOpenOrCreateError) -> Self {
        use EventOpenError as Open;
        use EventOpenOrCreateError as Either;
        match error {
            Either::EventOpenError(Open::InsufficientPermissions) => Self::NotPermitted,
            Either::EventOpenError(
                Open::InternalFailure
                | Open::ServiceInCorruptedState
                | Open::HangsInCreation
                | Open::Interrupt,
            )
            | Either::SystemInFlux => Self::Library,
            Either::EventOpenError(_) => Self::Held,
            Either::EventCreateError(_) => Self::NoRoom,
        }
    }
}

impl From<PublisherCreateError> for SharingError {
    fn from(error: PublisherCreateError) -> Self {
        match error {
            PublisherCreateError::ExceedsMaxSupportedPublishers => Self::Taken,
            PublisherCreateError::UnableToCreateDataSegment => Self::NoRoom,
            _ => Self::Library,
        }
    }
}

impl From<NotifierCreateError> for SharingError {
    fn from(error: NotifierCreateError) -> Self {
        match error {
            NotifierCreateError::ExceedsMaxSupportedNotifiers => Self::Taken,
            _ => Self::Library,
        }
    }
}

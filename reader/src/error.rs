//! Why the module's messages cannot be read, each with its fix.

use freespace::emit::SharedError;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::service::builder::event::EventOpenError;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;

use crate::service::NodeCreationFailure;

/// Why the module's messages cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReaderError {
    /// No service has this name, or its module was killed: wait for the module, or correct the name.
    #[error("nobody publishes under this name: start the module, or give the `name` of its [shared_memory]")]
    NoModule,
    /// Not a name that a service may have.
    #[error(
        "this is no name of a service: give the `name` of the module's [shared_memory], such as freespace/grid"
    )]
    BadName,
    /// There are as many readers as the module has room for.
    #[error("the module has no room for another reader: raise `max_readers` in its [shared_memory]")]
    TooManyReaders,
    /// Module and reader were built from different versions.
    #[error("the module publishes another layout: build reader and module from the same version")]
    WrongLayout,
    /// The module runs as another user.
    #[error("the shared memory may not be opened: run the reader as the module's user")]
    NotPermitted,
    /// The system failed; try again.
    #[error("the shared memory failed: look at the room in /dev/shm, then open the reader anew")]
    Failed,
}

impl From<NodeCreationFailure> for ReaderError {
    fn from(failure: NodeCreationFailure) -> Self {
        match failure {
            NodeCreationFailure::InsufficientPermissions => Self::NotPermitted,
            _ => Self::Failed,
        }
    }
}

impl From<PublishSubscribeOpenError> for ReaderError {
    fn from(error: PublishSubscribeOpenError) -> Self {
        use PublishSubscribeOpenError as Open;
        match error {
            // A module that has just started, or is just ending, is none yet or no more.
            Open::DoesNotExist | Open::IsMarkedForDestruction | Open::HangsInCreation => Self::NoModule,
            Open::InsufficientPermissions => Self::NotPermitted,
            Open::ExceedsMaxNumberOfNodes => Self::TooManyReaders,
            Open::IncompatibleTypes | Open::VersionMismatch => Self::WrongLayout,
            _ => Self::Failed,
        }
    }
}

impl From<EventOpenError> for ReaderError {
    fn from(error: EventOpenError) -> Self {
        use EventOpenError as Open;
        match error {
            Open::DoesNotExist | Open::IsMarkedForDestruction | Open::HangsInCreation => Self::NoModule,
            Open::InsufficientPermissions => Self::NotPermitted,
            Open::ExceedsMaxNumberOfNodes => Self::TooManyReaders,
            Open::VersionMismatch => Self::WrongLayout,
            _ => Self::Failed,
        }
    }
}

impl From<SubscriberCreateError> for ReaderError {
    fn from(error: SubscriberCreateError) -> Self {
        match error {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => Self::TooManyReaders,
            _ => Self::Failed,
        }
    }
}

impl From<SharedError> for ReaderError {
    fn from(_: SharedError) -> Self {
        Self::WrongLayout
    }
}

//! The monitor's side: one subscriber of views.

use freespace_reader::ReaderError;
use freespace_reader::service::{self, Ipc};
use iceoryx2::node::Node;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::service::service_name::ServiceName;

use super::{View, decode, service_name};

/// Reads views. It stays on the thread that opened it.
pub struct ViewReader {
    subscriber: Subscriber<Ipc, [u8], ()>,
    // Ports go before the node they belong to.
    _node: Node<Ipc>,
}

impl ViewReader {
    /// Opens the views beside the messages of `name`.
    ///
    /// # Errors
    /// See [`ReaderError`]; a module need not have views.
    pub fn open(name: &str) -> Result<Self, ReaderError> {
        let name = ServiceName::new(&service_name(name)).map_err(|_| ReaderError::BadName)?;
        let node = service::node()?;
        let views = node.service_builder(&name).publish_subscribe::<[u8]>().open()?;
        let subscriber = views.subscriber_builder().create()?;
        Ok(Self {
            subscriber,
            _node: node,
        })
    }

    /// The newest view that this reader has not had; none where there is none, or one of another version.
    ///
    /// # Errors
    /// The service failed: open the reader anew.
    pub fn newest(&self) -> Result<Option<View>, ReaderError> {
        let sample = self.subscriber.receive().map_err(|_| ReaderError::Failed)?;
        Ok(sample.and_then(|sample| decode(sample.payload())))
    }
}

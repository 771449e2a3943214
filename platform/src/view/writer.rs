//! The observer's side: one publisher of views.

use std::panic::{AssertUnwindSafe, catch_unwind};

use freespace::port::SinkMiss;
use freespace_reader::service::{self, Ipc};
use iceoryx2::node::Node;
use iceoryx2::port::backpressure_strategy::BackpressureStrategy;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::service::service_name::ServiceName;

use super::picture::{Painter, PictureSource};
use super::{MAX_READERS, MAX_VIEW_BYTES, ViewStatus, encode, service_name};
use crate::sink::shared_memory::{SPARE_NODES, SharingConfig, SharingError};

/// Publishes views. It stays on the thread that opened it.
pub struct ViewWriter {
    publisher: Publisher<Ipc, [u8], ()>,
    views: PortFactory<Ipc, [u8], ()>,
    // Ports go before the node they belong to.
    _node: Node<Ipc>,
    painter: Painter,
    bytes: Vec<u8>,
}

impl ViewWriter {
    /// Makes the service beside the one that `config` names, with all its room; the sink for that one comes first, and clears away
    /// what a module that died left of both.
    ///
    /// # Errors
    /// See [`SharingError`].
    pub fn open(config: &SharingConfig) -> Result<Self, SharingError> {
        let name = ServiceName::new(&service_name(&config.name)).map_err(|_| SharingError::Name)?;
        let node = service::node()?;
        let views = node
            .service_builder(&name)
            .publish_subscribe::<[u8]>()
            .max_publishers(1)
            .max_subscribers(MAX_READERS)
            .max_nodes(MAX_READERS + SPARE_NODES)
            .subscriber_max_buffer_size(1)
            .subscriber_max_borrowed_samples(1)
            // The next view comes with the next key frame, and has a picture then: nobody looked at the last one.
            .history_size(0)
            .enable_safe_overflow(true)
            .open_or_create()?;
        let publisher = views
            .publisher_builder()
            .initial_max_slice_len(MAX_VIEW_BYTES)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()?;
        Ok(Self {
            publisher,
            views,
            _node: node,
            painter: Painter::default(),
            bytes: Vec::with_capacity(MAX_VIEW_BYTES),
        })
    }

    /// Whether somebody looks.
    #[must_use]
    pub fn is_watched(&self) -> bool {
        self.views.dynamic_config().number_of_subscribers() > 0
    }

    /// Publishes a view; the picture is drawn only where somebody looks.
    ///
    /// # Errors
    /// [`SinkMiss`]: the library failed, and this view is lost.
    pub fn write(
        &mut self,
        status: &ViewStatus,
        picture: Option<&PictureSource<'_>>,
    ) -> Result<(), SinkMiss> {
        let is_watched = self.is_watched();
        // A reader looks again soon: a panic of the library costs a view, and must not end the drive.
        catch_unwind(AssertUnwindSafe(|| {
            let picture = picture.filter(|_| is_watched);
            let jpeg = picture.map_or(&[][..], |picture| self.painter.paint(picture));
            if !encode(status, jpeg, &mut self.bytes) {
                return Err(SinkMiss::Refused);
            }
            let sample = self.publisher.loan_slice_uninit(self.bytes.len());
            let sample = sample
                .map_err(|_| SinkMiss::Refused)?
                .write_from_slice(&self.bytes);
            sample.send().map(drop).map_err(|_| SinkMiss::Refused)
        }))
        .unwrap_or(Err(SinkMiss::Refused))
    }
}

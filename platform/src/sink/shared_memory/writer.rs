//! The module's side of the service: one publisher, and the event that wakes readers.
//!
//! It stays on the thread that opened it.

use core::ptr;
use std::thread;

use freespace::emit::FreeSpaceMessage;
use freespace::port::SinkMiss;
use freespace::space::Micros;
use freespace_reader::service::{
    self, HISTORY, Ipc, MESSAGE_EVENT, Payload, READER_BUFFER, READER_HOLDS, SOON_EVENT, WRITER_HOLDS,
};
use iceoryx2::node::Node;
use iceoryx2::port::backpressure_strategy::BackpressureStrategy;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::EventId;
use iceoryx2::service::service_name::ServiceName;

use super::leftovers::{self, IN_THE_MAKING, JUST_MADE};
use super::{SharingConfig, SharingError};

/// Processes that may open the service besides the readers: the module, and readers that died and were not cleared away yet; a
/// reader that dies and is started anew every 40 ms finds a place.
pub(crate) const SPARE_NODES: usize = 16;

pub(super) struct Writer {
    publisher: Publisher<Ipc, Payload, ()>,
    notifier: Notifier<Ipc>,
    // Ports go before the node they belong to.
    _node: Node<Ipc>,
}

impl Writer {
    /// Makes the service with all its slots. What a module that died left behind is cleared away first; what may have been in the
    /// making then, if there is no way in, at a second try.
    pub(super) fn open(config: &SharingConfig) -> Result<Self, SharingError> {
        leftovers::clear_away(IN_THE_MAKING);
        match Self::make(config) {
            Err(SharingError::Library | SharingError::Taken) => {
                thread::sleep(JUST_MADE);
                leftovers::clear_away(JUST_MADE);
                Self::make(config)
            }
            made => made,
        }
    }

    fn make(config: &SharingConfig) -> Result<Self, SharingError> {
        let name = ServiceName::new(&config.name).map_err(|_| SharingError::Name)?;
        let node = service::node()?;
        let events = node
            .service_builder(&name)
            .event()
            .max_notifiers(1)
            .max_listeners(config.max_readers)
            .max_nodes(config.max_readers + SPARE_NODES)
            .event_id_max_value(SOON_EVENT)
            .open_or_create()?;
        let notifier = events.notifier_builder().create()?;
        let messages = node
            .service_builder(&name)
            .publish_subscribe::<Payload>()
            .max_publishers(1)
            .max_subscribers(config.max_readers)
            .max_nodes(config.max_readers + SPARE_NODES)
            .subscriber_max_buffer_size(READER_BUFFER)
            .subscriber_max_borrowed_samples(READER_HOLDS)
            .history_size(HISTORY)
            .enable_safe_overflow(true)
            .open_or_create()?;
        let publisher = messages
            .publisher_builder()
            .max_loaned_samples(WRITER_HOLDS)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()?;
        Ok(Self {
            publisher,
            notifier,
            _node: node,
        })
    }

    /// Writes a message that was posted then into a free slot, hands it to every reader, and wakes them.
    pub(super) fn write(&self, message: &FreeSpaceMessage<'_>, posted: Micros) -> Result<(), SinkMiss> {
        let mut sample = self.publisher.loan_uninit().map_err(|_| SinkMiss::Refused)?;
        // SAFETY: the slot lies in a mapping of this process that was zeroed when it was made, and holds nothing but messages
        // since; every bit pattern is a message, so whatever lies there is one.
        let slot = unsafe { &mut *ptr::from_mut(sample.payload_mut()).cast::<Payload>() };
        slot.0.fill(message, posted);
        // SAFETY: as above.
        let sample = unsafe { sample.assume_init() };
        sample.send().map_err(|_| SinkMiss::Refused)?;
        // A reader that cannot be woken looks by itself, and the others were woken all the same.
        let _ = (self.notifier).notify_with_custom_event_id(EventId::new(MESSAGE_EVENT));
        Ok(())
    }

    /// Wakes the readers for a message that is being made.
    pub(super) fn announce(&self) {
        let _ = self
            .notifier
            .notify_with_custom_event_id(EventId::new(SOON_EVENT));
    }
}

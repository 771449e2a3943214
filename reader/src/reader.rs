//! A reader: opens the module's service, waits for its messages.

use core::ops::Deref;
use core::time::Duration;
use std::time::Instant;

use freespace::emit::SharedMessage;
use freespace::space::Micros;
use iceoryx2::node::{Node, NodeState};
use iceoryx2::port::listener::ListenerCreateError;
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::CallbackProgression;
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::service::service_name::ServiceName;

use crate::error::ReaderError;
use crate::service::{self, HISTORY, Ipc, Payload, READER_BUFFER, SOON, SOON_EVENT};

/// What a call waits at most: longer times may not be added to the clock.
const LONGEST_WAIT: Duration = Duration::from_secs(86_400);

/// A message in shared memory, held for as long as this lives; at most two may be held at a time.
pub struct Message(Sample<Ipc, Payload, ()>);

impl Deref for Message {
    type Target = SharedMessage;

    fn deref(&self) -> &SharedMessage {
        &self.0.payload().0
    }
}

/// Reads the messages of one module. It stays on the thread that opened it.
///
/// It outlives the module: where that is started anew, its messages go on.
pub struct Reader {
    subscriber: Subscriber<Ipc, Payload, ()>,
    listener: Listener<Ipc>,
    // Ports go before the node they belong to.
    _node: Node<Ipc>,
}

impl Reader {
    /// Opens the service of a module that runs; its last message is there at once.
    ///
    /// # Errors
    /// See [`ReaderError`]; [`ReaderError::NoModule`] is worth another try a second later.
    pub fn open(name: &str) -> Result<Self, ReaderError> {
        let name = ServiceName::new(name).map_err(|_| ReaderError::BadName)?;
        let node = service::node()?;
        let messages = node
            .service_builder(&name)
            .publish_subscribe::<Payload>()
            .open()?;
        if !is_served(&messages) {
            return Err(ReaderError::NoModule);
        }
        let events = node.service_builder(&name).event().open()?;
        // It listens first, so that no message slips between the two.
        let listener = (events.listener_builder().create()).map_err(|error| match error {
            ListenerCreateError::ExceedsMaxSupportedListeners => ReaderError::TooManyReaders,
            _ => ReaderError::Failed,
        })?;
        let subscriber = messages
            .subscriber_builder()
            .buffer_size(READER_BUFFER)
            .history_request(HISTORY)
            .create()?;
        Ok(Self {
            subscriber,
            listener,
            _node: node,
        })
    }

    /// The newest message that this reader has not had, waiting for it at most for `timeout`, and a day; none where none came,
    /// or a signal did.
    ///
    /// # Errors
    /// The service failed, or holds another layout: open the reader anew.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Message>, ReaderError> {
        let until = Instant::now() + timeout.min(LONGEST_WAIT);
        loop {
            if let Some(sample) = self.subscriber.receive().map_err(|_| ReaderError::Failed)? {
                sample.payload().0.check()?;
                return Ok(Some(Message(sample)));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            let mut is_soon = false;
            let waited =
                (self.listener).timed_wait(|event| is_soon |= event.id.as_value() == SOON_EVENT, left);
            match waited {
                Ok(_) if is_soon => self.stay_awake(until)?,
                Ok(_) => {}
                Err(ListenerWaitError::InterruptSignal) => return Ok(None),
                Err(_) => return Err(ReaderError::Failed),
            }
        }
    }

    /// Waits for the message that was announced: to sleep and be woken again would take longer.
    fn stay_awake(&self, until: Instant) -> Result<(), ReaderError> {
        let until = until.min(Instant::now() + SOON);
        while !self.subscriber.has_samples().map_err(|_| ReaderError::Failed)? && Instant::now() < until {
            core::hint::spin_loop();
        }
        Ok(())
    }
}

/// Whether a module that lives publishes here: the service of one that was killed stays until the next one takes it over.
fn is_served(messages: &PortFactory<Ipc, Payload, ()>) -> bool {
    let mut module = None;
    messages.dynamic_config().list_publishers(|publisher| {
        module = Some(publisher.node_id);
        CallbackProgression::Stop
    });
    let mut lives = false;
    let listed = messages.nodes(|node| {
        lives |= Some(*node.node_id()) == module && !matches!(node, NodeState::Dead(_));
        CallbackProgression::Continue
    });
    // What cannot be told is no reason against it.
    module.is_some() && (lives || listed.is_err())
}

/// `CLOCK_MONOTONIC` now, for [`SharedMessage::age_micros`].
#[must_use]
pub fn monotonic_now() -> Micros {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    let seconds = u64::try_from(now.tv_sec).unwrap_or(0);
    let nanos = u64::try_from(now.tv_nsec).unwrap_or(0);
    Micros(seconds * 1_000_000 + nanos / 1000)
}

//! Connections that are bounded, in number and in patience.
//!
//! In: a listener. Out: connections for the server, at most [`Limits::connections`] open at a time; more wait in the kernel's
//! queue. Invariant: a connection that has had no answer sent for [`Limits::patience`] is cut, whatever holds it up: nothing is
//! asked, a request's head comes in drops, or an answer is not taken. Cost: one timer a connection.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep, sleep};

/// What is let in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Connections open at a time: a browser opens six.
    pub(super) connections: usize,
    /// From an answer to the end of the next one; longer than the 15 s of a Prometheus that keeps its connection.
    pub(super) patience: Duration,
}

impl Limits {
    pub(super) const SHIPPED: Self = Self {
        connections: 64,
        patience: Duration::from_secs(20),
    };
}

/// A listener that lets in as many as there is room for.
pub(super) struct Bounded {
    listener: TcpListener,
    room: Arc<Semaphore>,
    patience: Duration,
}

impl Bounded {
    pub(super) fn new(listener: TcpListener, limits: Limits) -> Self {
        Self {
            listener,
            room: Arc::new(Semaphore::new(limits.connections)),
            patience: limits.patience,
        }
    }
}

impl axum::serve::Listener for Bounded {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        // Nobody closes it; were it closed, there would be no bound, and still a page.
        let place = Arc::clone(&self.room).acquire_owned().await.ok();
        let (stream, address) = axum::serve::Listener::accept(&mut self.listener).await;
        let connection = Connection {
            stream,
            patience: self.patience,
            until: Box::pin(sleep(self.patience)),
            has_written: false,
            _place: place,
        };
        (connection, address)
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// A connection whose place is free again when it is dropped.
pub(super) struct Connection {
    stream: TcpStream,
    patience: Duration,
    until: Pin<Box<Sleep>>,
    /// Since the last flush.
    has_written: bool,
    _place: Option<OwnedSemaphorePermit>,
}

impl Connection {
    /// What a poll came to; an error where it waits, and has waited too long.
    fn in_time<T>(&mut self, context: &mut Context<'_>, polled: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if polled.is_pending() && self.until.as_mut().poll(context).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        polled
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_read(context, buffer);
        self.in_time(context, polled)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.has_written |= matches!(polled, Poll::Ready(Ok(count)) if count > 0);
        self.in_time(context, polled)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write_vectored(context, bytes);
        self.has_written |= matches!(polled, Poll::Ready(Ok(count)) if count > 0);
        self.in_time(context, polled)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    /// The server flushes when all of an answer is written.
    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_flush(context);
        if polled.is_ready() && std::mem::take(&mut self.has_written) {
            let until = Instant::now() + self.patience;
            self.until.as_mut().reset(until);
        }
        polled
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.stream).poll_shutdown(context);
        self.in_time(context, polled)
    }
}

//! The web page: what the state is, over HTTP/1, read-only.
//!
//! In: GET and HEAD. Out: a page of three files that are part of the program, the snapshot as JSON, the cells as bytes, the
//! picture as JPEG, metrics. Invariant: nothing that comes in changes anything; other methods are refused, paths are names in
//! a table and never files; a page may load from this server alone (`Content-Security-Policy`); a server on the loopback
//! answers to the names of the loopback alone, so that no foreign page reads it through a name of its own. Cost: one thread,
//! [`MAX_REQUESTS`] requests at a time on a [bounded](connections) number of connections; more wait.

mod assets;
mod connections;
mod guard;
#[cfg(test)]
mod tests;

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;

use axum::Router;
use axum::body::Body;
use axum::extract::State as Handle;
use axum::http::{HeaderName, StatusCode, header};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tokio::sync::Notify;

use super::follow::{Shared, lock};
use super::metrics;
use super::snapshot::Snapshot;
use super::state::Now;
use connections::{Bounded, Limits};
use guard::Guard;

/// Requests answered at a time.
const MAX_REQUESTS: usize = 32;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Another process listens there, or the address is not this computer's, or the port not this user's.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The cause.
        source: io::Error,
    },
    /// The system gave no thread, or no way to wait for sockets.
    #[error("the server could not be started: {0}")]
    Start(io::Error),
}

/// A server on a thread of its own; it ends when this is dropped.
pub struct Server {
    address: SocketAddr,
    stop: Arc<Notify>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens, and answers from `state`.
    ///
    /// # Errors
    /// See [`ServeError`].
    pub fn start(address: SocketAddr, state: Shared) -> Result<Self, ServeError> {
        Self::start_with(address, state, Limits::SHIPPED)
    }

    fn start_with(address: SocketAddr, state: Shared, limits: Limits) -> Result<Self, ServeError> {
        let listening = |source| ServeError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(listening)?;
        listener.set_nonblocking(true).map_err(listening)?;
        let address = listener.local_addr().map_err(listening)?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(ServeError::Start)?;
        let stop = Arc::new(Notify::new());
        let stopped = Arc::clone(&stop);
        let app = router(state, Guard::for_address(address));
        let thread = std::thread::Builder::new()
            .name("web".to_owned())
            .spawn(move || runtime.block_on(serve(listener, limits, app, &stopped)))
            .map_err(ServeError::Start)?;
        Ok(Self {
            address,
            stop,
            thread: Some(thread),
        })
    }

    /// Where it listens.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.notify_one();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Serves until it is told to end; connections that are open then are cut.
async fn serve(listener: TcpListener, limits: Limits, app: Router, stop: &Notify) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
        return;
    };
    let listener = Bounded::new(listener, limits);
    let serving = std::pin::pin!(async { axum::serve(listener, app).await });
    let stopping = std::pin::pin!(stop.notified());
    first_of(serving, stopping).await;
}

/// Waits for the first of two.
async fn first_of(mut one: std::pin::Pin<&mut impl Future>, mut other: std::pin::Pin<&mut impl Future>) {
    std::future::poll_fn(|context| {
        let is_ready = one.as_mut().poll(context).is_ready() || other.as_mut().poll(context).is_ready();
        if is_ready {
            std::task::Poll::Ready(())
        } else {
            std::task::Poll::Pending
        }
    })
    .await;
}

fn router(state: Shared, guard: Guard) -> Router {
    let guard = Arc::new(guard);
    Router::new()
        .route("/", get(|| async { assets::PAGE }))
        .route("/monitor.css", get(|| async { assets::STYLE }))
        .route("/monitor.js", get(|| async { assets::SCRIPT }))
        .route("/draw.js", get(|| async { assets::DRAWING }))
        .route("/icon.svg", get(|| async { assets::ICON }))
        .route("/api/state", get(snapshot))
        .route("/api/grid", get(grid))
        .route("/api/picture", get(picture))
        .route("/metrics", get(metrics_text))
        .with_state(state)
        .layer(middleware::from_fn(move |request, next| {
            guard::pass(Arc::clone(&guard), request, next)
        }))
}

async fn snapshot(Handle(state): Handle<Shared>) -> Response {
    let snapshot = Snapshot::of(&lock(&state), Now::read());
    match serde_json::to_vec(&snapshot) {
        Ok(json) => ([(header::CONTENT_TYPE, "application/json")], json).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

const SEQUENCE: HeaderName = HeaderName::from_static("freespace-sequence");

/// Occupancy, then reason, then age: `rows x columns` bytes each, in the order of the message.
async fn grid(Handle(state): Handle<Shared>) -> Response {
    let (sequence, cells) = {
        let state = lock(&state);
        let Some(last) = &state.last else {
            return StatusCode::NOT_FOUND.into_response();
        };
        let occupancy = last.occupancy.iter().map(|cell| cell.to_ne_bytes()[0]);
        let cells: Vec<u8> = occupancy
            .chain(last.reason.iter().copied())
            .chain(last.age.iter().copied())
            .collect();
        (last.header.sequence, cells)
    };
    let sequence = sequence.to_string();
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream"),
        (SEQUENCE, &sequence),
    ];
    (headers, cells).into_response()
}

async fn picture(Handle(state): Handle<Shared>) -> Response {
    let (sequence, jpeg) = {
        let state = lock(&state);
        match (&state.view, state.picture_sequence) {
            (Some(view), Some(sequence)) if !view.picture.is_empty() => (sequence, view.picture.clone()),
            _ => return StatusCode::NOT_FOUND.into_response(),
        }
    };
    let sequence = sequence.to_string();
    let headers = [(header::CONTENT_TYPE, "image/jpeg"), (SEQUENCE, &sequence)];
    (headers, Body::from(jpeg)).into_response()
}

async fn metrics_text(Handle(state): Handle<Shared>) -> Response {
    let text = metrics::render(&lock(&state), Now::read());
    let kind = "text/plain; version=0.0.4; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

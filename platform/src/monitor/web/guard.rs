//! What every request passes: who may be asked for, how, how many at a time; and what every answer says of itself.

use std::net::SocketAddr;
use std::sync::Arc;

use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use tokio::sync::Semaphore;

use super::MAX_REQUESTS;

/// A page loads from this server alone, sends nothing anywhere, and stands in no other page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; \
     connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Sent with every answer, refusals too.
const HEADERS: [(HeaderName, &str); 6] = [
    (header::CONTENT_SECURITY_POLICY, POLICY),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        "same-origin",
    ),
    (
        HeaderName::from_static("cross-origin-opener-policy"),
        "same-origin",
    ),
];

/// Lets requests through.
pub(super) struct Guard {
    /// Whether a request must name the loopback.
    is_loopback: bool,
    room: Semaphore,
}

impl Guard {
    pub(super) fn for_address(address: SocketAddr) -> Self {
        Self {
            is_loopback: address.ip().is_loopback(),
            room: Semaphore::new(MAX_REQUESTS),
        }
    }

    fn refusal(&self, method: &Method, headers: &HeaderMap) -> Option<StatusCode> {
        if method != Method::GET && method != Method::HEAD {
            return Some(StatusCode::METHOD_NOT_ALLOWED);
        }
        if self.is_loopback && !headers.get(header::HOST).is_some_and(names_loopback) {
            return Some(StatusCode::MISDIRECTED_REQUEST);
        }
        None
    }
}

/// Whether a `Host` is a name of the loopback, with or without a port.
fn names_loopback(host: &HeaderValue) -> bool {
    let Ok(host) = host.to_str() else { return false };
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let address = name.trim_start_matches('[').trim_end_matches(']');
    let is_loopback = |address: std::net::IpAddr| address.is_loopback();
    name.eq_ignore_ascii_case("localhost") || address.parse().is_ok_and(is_loopback)
}

pub(super) async fn pass(guard: Arc<Guard>, request: Request, next: Next) -> Response {
    let refusal = guard.refusal(request.method(), request.headers());
    let mut response = match refusal {
        Some(StatusCode::METHOD_NOT_ALLOWED) => {
            (StatusCode::METHOD_NOT_ALLOWED, [(header::ALLOW, "GET, HEAD")]).into_response()
        }
        Some(status) => status.into_response(),
        None => match guard.room.acquire().await {
            Ok(_place) => next.run(request).await,
            Err(_) => StatusCode::SERVICE_UNAVAILABLE.into_response(),
        },
    };
    for (name, value) in HEADERS {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    response
}

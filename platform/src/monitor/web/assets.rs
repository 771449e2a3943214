//! The files of the page, part of the program.

use axum::http::{HeaderName, header};

/// A file with its type.
pub(super) type Asset = ([(HeaderName, &'static str); 1], &'static str);

const fn asset(kind: &'static str, text: &'static str) -> Asset {
    ([(header::CONTENT_TYPE, kind)], text)
}

pub(super) const PAGE: Asset = asset("text/html; charset=utf-8", include_str!("page/index.html"));
pub(super) const STYLE: Asset = asset("text/css; charset=utf-8", include_str!("page/monitor.css"));
pub(super) const SCRIPT: Asset = asset("text/javascript; charset=utf-8", include_str!("page/monitor.js"));
pub(super) const DRAWING: Asset = asset("text/javascript; charset=utf-8", include_str!("page/draw.js"));
pub(super) const ICON: Asset = asset("image/svg+xml", include_str!("page/icon.svg"));

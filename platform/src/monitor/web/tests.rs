#![allow(clippy::unwrap_used, reason = "tests")]

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Mutex;
use std::time::Duration;

use super::*;
use crate::monitor::tests::Stream;

struct Page {
    server: Server,
}

/// An answer: its first line and headers, and its body.
struct Answer {
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn status(&self) -> u16 {
        self.head.split(' ').nth(1).unwrap().parse().unwrap()
    }

    fn header(&self, name: &str) -> Option<&str> {
        let mut lines = self.head.lines();
        lines.find_map(|line| {
            let (found, value) = line.split_once(": ")?;
            found.eq_ignore_ascii_case(name).then_some(value)
        })
    }
}

impl Page {
    fn of(stream: Stream) -> Self {
        let state = Arc::new(Mutex::new(stream.state));
        let server = Server::start("127.0.0.1:0".parse().unwrap(), state).unwrap();
        Self { server }
    }

    fn with_limits(stream: Stream, limits: Limits) -> Self {
        let state = Arc::new(Mutex::new(stream.state));
        let server = Server::start_with("127.0.0.1:0".parse().unwrap(), state, limits).unwrap();
        Self { server }
    }

    /// What a request's bytes are answered.
    fn raw(&self, request: &str) -> Answer {
        let mut socket = TcpStream::connect(self.server.address()).unwrap();
        socket.write_all(request.as_bytes()).unwrap();
        let mut bytes = Vec::new();
        socket.read_to_end(&mut bytes).unwrap();
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        Answer {
            head: String::from_utf8(bytes[..end].to_vec()).unwrap(),
            body: bytes[end + 4..].to_vec(),
        }
    }

    fn ask(&self, method: &str, path: &str, host: &str) -> Answer {
        self.raw(&format!(
            "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        ))
    }

    fn get(&self, path: &str) -> Answer {
        self.ask("GET", path, "localhost:8642")
    }
}

#[test]
fn the_page_is_whole_and_loads_from_here_alone() {
    let page = Page::of(Stream::with_misses());
    for (path, kind) in [
        ("/", "text/html; charset=utf-8"),
        ("/monitor.css", "text/css; charset=utf-8"),
        ("/monitor.js", "text/javascript; charset=utf-8"),
        ("/draw.js", "text/javascript; charset=utf-8"),
        ("/icon.svg", "image/svg+xml"),
    ] {
        let answer = page.get(path);
        assert_eq!(
            (answer.status(), answer.header("content-type")),
            (200, Some(kind))
        );
        let policy = answer.header("content-security-policy").unwrap();
        assert!(policy.starts_with("default-src 'none'; script-src 'self'"));
        assert!(!policy.contains("unsafe") && policy.contains("frame-ancestors 'none'"));
        assert_eq!(answer.header("x-content-type-options"), Some("nosniff"));
        let text = String::from_utf8(answer.body).unwrap();
        assert!(!text.contains("style=\"") && !text.contains("onclick="), "{path}");
        let outside = text.replace("http://www.w3.org/2000/svg", "");
        assert!(
            !outside.contains("http://") && !outside.contains("https://"),
            "{path}"
        );
    }
}

#[test]
fn state_cells_picture_and_metrics_are_those_of_the_last_message() {
    let page = Page::of(Stream::with_misses());
    let state = page.get("/api/state");
    let json: serde_json::Value = serde_json::from_slice(&state.body).unwrap();
    assert_eq!(
        (&json["message"]["sequence"], &json["totals"]["misses"]),
        (&9.into(), &1.into())
    );
    let grid = page.get("/api/grid");
    assert_eq!(grid.header("freespace-sequence"), Some("9"));
    assert_eq!(grid.body.len(), 3 * 40 * 24);
    assert_eq!((grid.body[0], grid.body[8], grid.body[40 * 24 + 8]), (0xff, 5, 1));
    let picture = page.get("/api/picture?of=9");
    assert_eq!(
        (&picture.body[..], picture.header("content-type")),
        (&b"jpeg"[..], Some("image/jpeg"))
    );
    assert_eq!(picture.header("freespace-sequence"), Some("9"));
    let metrics = page.get("/metrics");
    assert!(
        metrics
            .header("content-type")
            .unwrap()
            .starts_with("text/plain; version=0.0.4")
    );
    assert!(
        String::from_utf8(metrics.body)
            .unwrap()
            .contains("freespace_deadline_misses_total")
    );
}

#[test]
fn a_picture_that_the_last_message_came_without_keeps_its_own_number() {
    let mut stream = Stream::with_misses();
    stream.publish(Stream::good());
    stream.show_without_picture();
    let restarted = {
        let mut stream = Stream::with_misses();
        stream.restart();
        stream.publish(Stream::good());
        Page::of(stream)
    };
    let page = Page::of(stream);
    let picture = page.get("/api/picture?of=9");
    assert_eq!(
        (&picture.body[..], picture.header("freespace-sequence")),
        (&b"jpeg"[..], Some("9"))
    );
    let json: serde_json::Value = serde_json::from_slice(&page.get("/api/state").body).unwrap();
    assert_eq!(
        (&json["module"]["sequence"], &json["picture_sequence"]),
        (&10.into(), &9.into())
    );
    // Numbers count anew after a restart: a picture of before would be taken for one of after.
    assert_eq!(restarted.get("/api/picture").status(), 404);
}

#[test]
fn before_the_first_message_there_is_a_state_and_neither_grid_nor_picture() {
    let page = Page::of(Stream::new());
    let state: serde_json::Value = serde_json::from_slice(&page.get("/api/state").body).unwrap();
    assert_eq!(state["link"], "waiting");
    assert_eq!(
        (page.get("/api/grid").status(), page.get("/api/picture").status()),
        (404, 404)
    );
    assert_eq!(page.get("/metrics").status(), 200);
}

#[test]
fn nothing_but_reading_is_allowed() {
    let page = Page::of(Stream::new());
    for method in ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"] {
        let answer = page.ask(method, "/api/state", "localhost");
        assert_eq!(
            (answer.status(), answer.header("allow")),
            (405, Some("GET, HEAD"))
        );
        assert!(answer.header("content-security-policy").is_some());
    }
    let head = page.ask("HEAD", "/metrics", "localhost");
    assert_eq!((head.status(), head.body.len()), (200, 0));
}

#[test]
fn paths_are_names_and_never_files() {
    let page = Page::of(Stream::new());
    for path in [
        "/../Cargo.toml",
        "/..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/monitor.js/..",
        "/api/",
        "/api/state/../../../etc/passwd",
        "/index.html%00",
    ] {
        assert_eq!(page.get(path).status(), 404, "{path}");
    }
    let answer = page.raw("GET /etc/passwd\r\n\r\nHTTP/1.1");
    assert!(matches!(answer.status(), 400 | 404 | 421));
}

#[test]
fn a_foreign_name_of_the_loopback_is_not_answered() {
    let page = Page::of(Stream::with_misses());
    for host in [
        "evil.example",
        "127.0.0.1.evil.example",
        "10.0.0.1:8642",
        "localhost.evil:80",
        "",
    ] {
        let answer = page.ask("GET", "/api/picture", host);
        assert_eq!(answer.status(), 421, "{host}");
        assert!(answer.body.is_empty());
    }
    for host in [
        "localhost",
        "LOCALHOST:1",
        "127.0.0.1:8642",
        "[::1]:8642",
        "127.0.0.2",
    ] {
        assert_eq!(page.ask("GET", "/api/picture", host).status(), 200, "{host}");
    }
}

#[test]
fn an_address_that_is_taken_is_named_and_a_server_ends_when_it_is_dropped() {
    let page = Page::of(Stream::new());
    let address = page.server.address();
    let state = Arc::new(Mutex::new(Stream::new().state));
    let error = Server::start(address, Arc::clone(&state)).err().unwrap();
    assert!(error.to_string().contains(&address.to_string()));
    // An idle connection does not keep it from ending.
    let _idle = TcpStream::connect(address).unwrap();
    drop(page);
    assert!(Server::start(address, state).is_ok());
}

#[test]
fn connections_that_hold_their_place_are_cut_and_those_that_wait_are_answered() {
    let limits = Limits {
        connections: 3,
        patience: Duration::from_millis(200),
    };
    let page = Page::with_limits(Stream::with_misses(), limits);
    let connect = || TcpStream::connect(page.server.address()).unwrap();
    // One says nothing, one half of a request, one a whole request and then no more; together they are all there is room for.
    let (mut silent, mut half, mut kept) = (connect(), connect(), connect());
    half.write_all(b"GET /api/state HTTP/1.1\r\nHost: loc").unwrap();
    kept.write_all(b"GET /icon.svg HTTP/1.1\r\nHost: localhost\r\n\r\n")
        .unwrap();
    assert_eq!(page.get("/api/state").status(), 200);
    let ended = |socket: &mut TcpStream| {
        let mut bytes = Vec::new();
        // An answer, a refusal, or nothing: then it is over.
        let _ = socket.read_to_end(&mut bytes);
        bytes
    };
    assert!(ended(&mut silent).is_empty());
    ended(&mut half);
    assert!(ended(&mut kept).starts_with(b"HTTP/1.1 200"));
}

#[test]
fn a_request_that_comes_in_drops_is_cut() {
    let limits = Limits {
        connections: 1,
        patience: Duration::from_millis(300),
    };
    let page = Page::with_limits(Stream::with_misses(), limits);
    let mut slow = TcpStream::connect(page.server.address()).unwrap();
    slow.write_all(b"GET /api/state HTTP/1.1\r\nHost: localhost\r\nX: ")
        .unwrap();
    // Until the server has closed its end.
    while slow.write_all(b"x").is_ok() {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(page.get("/api/state").status(), 200);
}

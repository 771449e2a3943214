//! Pages that stand alone: one file, no network, no file beside it; pictures as data URIs.
//!
//! Pieces of HTML from numbers and pictures; what comes from outside is escaped here. [`Page`] is the frame of those pages that
//! need no script; the page of a run ([`crate::sink::recording`]) has a player, and a frame of its own.

mod bars;
mod path;

pub(crate) use bars::latency_bars;
pub(crate) use path::paths;

use std::fmt::Write as _;

/// Colours and forms of all pages.
pub(crate) const STYLE: &str = include_str!("style.css");

/// Text that may stand in HTML, in an attribute too.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

/// A number with its name; `state` is `good`, `bad` or nothing.
pub(crate) fn card(out: &mut String, label: &str, value: &str, state: &str) {
    let _ = write!(
        out,
        "<div class=\"card {state}\"><b>{}</b><span>{}</span></div>",
        escaped(value),
        escaped(label)
    );
}

/// A picture within the page; `kind` is `png` or `jpeg`.
pub(crate) fn image(kind: &str, bytes: &[u8], alt: &str) -> String {
    format!(
        "<img alt=\"{}\" src=\"data:image/{kind};base64,{}\">",
        escaped(alt),
        base64(bytes)
    )
}

/// RFC 4648, section 4.
pub(crate) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let at = |i: usize| u32::from(group.get(i).copied().unwrap_or_default());
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i) & 63) as usize];
            out.push(if i <= group.len() { char::from(digit) } else { '=' });
        }
    }
    out
}

/// A page without a script, piece by piece.
pub(crate) struct Page {
    title: String,
    cards: String,
    panels: String,
}

impl Page {
    pub(crate) fn new(title: &str) -> Self {
        Self {
            title: escaped(title),
            cards: String::new(),
            panels: String::new(),
        }
    }

    pub(crate) fn card(&mut self, label: &str, value: &str, state: &str) {
        card(&mut self.cards, label, value, state);
    }

    /// A part of the page; `html` is put in as it is.
    pub(crate) fn panel(&mut self, heading: &str, html: &str) {
        let heading = escaped(heading);
        let _ = write!(self.panels, "<div class=\"panel\"><h2>{heading}</h2>{html}</div>");
    }

    /// A part with pictures, each of HTML and its caption as text.
    pub(crate) fn pictures(&mut self, heading: &str, pictures: &[(String, String)]) {
        let figures: String = (pictures.iter())
            .map(|(html, caption)| {
                format!(
                    "<figure>{html}<figcaption>{}</figcaption></figure>",
                    escaped(caption)
                )
            })
            .collect();
        self.panel(heading, &format!("<div class=\"pictures\">{figures}</div>"));
    }

    /// A part with a table of texts.
    pub(crate) fn table(&mut self, heading: &str, columns: &[&str], rows: &[Vec<String>]) {
        let line = |tag: &str, cells: &mut dyn Iterator<Item = &str>| {
            let cells: String = cells
                .map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell)))
                .collect();
            format!("<tr>{cells}</tr>")
        };
        let head = line("th", &mut columns.iter().copied());
        let body: String = (rows.iter())
            .map(|row| line("td", &mut row.iter().map(String::as_str)))
            .collect();
        self.panel(
            heading,
            &format!("<div class=\"wide\"><table>{head}{body}</table></div>"),
        );
    }

    /// The whole text.
    pub(crate) fn finish(&self) -> String {
        let Self { title, cards, panels } = self;
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>\n{STYLE}</style>\n<h1>{title}</h1>\n<div class=\"cards\">{cards}</div>\n{panels}\n</html>\n"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_as_in_the_rfc() {
        for (bytes, wanted) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
        ] {
            assert_eq!(base64(bytes.as_bytes()), wanted);
        }
    }

    #[test]
    fn a_page_stands_alone_and_puts_in_no_foreign_markup() {
        let mut page = Page::new("a <script>");
        page.card("a & b", "1", "");
        page.table("t", &["name"], &[vec!["<b>".to_owned()]]);
        page.pictures("p", &[(image("png", b"foo", "\"x\""), "<i>".to_owned())]);
        let text = page.finish();
        assert!(
            text.contains("<title>a &lt;script></title>") && text.contains("<td>&lt;b></td>"),
            "{text}"
        );
        assert!(
            text.contains("alt=\"&quot;x&quot;\" src=\"data:image/png;base64,Zm9v\"")
                && text.contains("&lt;i>")
        );
        assert!(!text.contains("http") && !text.contains("<script"));
    }
}

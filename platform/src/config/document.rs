//! A TOML text with its path: where a key stands, and what a user should write instead.

use std::ops::Range;
use std::path::Path;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use super::Invalid;
use crate::bad_input::{BadInput, closest};

pub(super) struct Document<'a> {
    pub(super) path: &'a Path,
    pub(super) text: &'a str,
}

impl Document<'_> {
    pub(super) fn deserialize<T: DeserializeOwned>(&self) -> Result<T, BadInput> {
        toml::from_str(self.text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            let (message, fix) = self.explain(error.message(), &span);
            BadInput::at_span(self.path, self.text, span, message, fix)
        })
    }

    /// An error of serde in the user's words, and its fix.
    fn explain(&self, message: &str, span: &Range<usize>) -> (String, String) {
        let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
        let table = self.table_at(span.start);
        if message.starts_with("unknown field") {
            let [name, known @ ..] = quoted.as_slice() else {
                return (message.to_owned(), "remove the key".to_owned());
            };
            let list = known.join(", ");
            let fix = closest(name, known.iter().copied()).map_or_else(
                || format!("remove it; known keys of {table}: {list}"),
                |meant| format!("did you mean `{meant}`? known keys of {table}: {list}"),
            );
            return (format!("unknown key `{name}` in {table}"), fix);
        }
        if message.starts_with("missing field") {
            let name = quoted.first().copied().unwrap_or_default();
            return (
                format!("key `{name}` is missing in {table}"),
                format!("add `{name}` to {table}; config/kitti.toml shows every key with its unit"),
            );
        }
        if message.starts_with("unknown variant") {
            let [name, known @ ..] = quoted.as_slice() else {
                return (message.to_owned(), "use a known word".to_owned());
            };
            return (
                format!("unknown value \"{name}\" in {table}"),
                format!("use one of: {}", known.join(", ")),
            );
        }
        (
            format!("{message} in {table}"),
            "write the value as config/kitti.toml shows it, or see config/freespace.schema.json".to_owned(),
        )
    }

    /// The error for a value out of range, at the line of its key or of the table that lacks it.
    pub(super) fn invalid(&self, invalid: &Invalid) -> BadInput {
        let span = self.span_of(invalid.key);
        BadInput::at_span(self.path, self.text, span, &invalid.message, invalid.fix.clone())
    }

    /// Where the value of a dotted key stands, or else the deepest table on the way there.
    fn span_of(&self, key: &str) -> Range<usize> {
        let Ok(root) = DeTable::parse(self.text) else {
            return 0..0;
        };
        let mut table = root.get_ref();
        let mut span = 0..0;
        for part in key.split('.') {
            let Some((name, value)) = table.iter().find(|(name, _)| name.get_ref() == part) else {
                break;
            };
            span = name.span().start..name.span().end.max(match value.get_ref() {
                DeValue::Table(_) => 0,
                _ => value.span().end,
            });
            match value.get_ref() {
                DeValue::Table(inner) => table = inner,
                _ => break,
            }
        }
        span
    }

    /// The name of the table around a byte, as a user writes it.
    fn table_at(&self, at: usize) -> String {
        let Ok(root) = DeTable::parse(self.text) else {
            return "the file".to_owned();
        };
        let mut path = Vec::new();
        deepest(root.get_ref(), at, &mut path);
        if path.is_empty() {
            "the file's top level".to_owned()
        } else {
            format!("[{}]", path.join("."))
        }
    }
}

/// Appends the tables that hold byte `at`, outermost first; whether there is one.
fn deepest(table: &DeTable<'_>, at: usize, path: &mut Vec<String>) -> bool {
    for (name, value) in table {
        let holds = |span: Range<usize>| span.contains(&at);
        if let DeValue::Table(inner) = value.get_ref() {
            path.push(name.get_ref().to_string());
            if deepest(inner, at, path) || holds(value.span()) {
                return true;
            }
            path.pop();
        } else if holds(name.span()) || holds(value.span()) {
            return true;
        }
    }
    false
}

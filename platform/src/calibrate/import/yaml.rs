//! YAML with line numbers, and the one way in which OpenCV's differs: its first line reads `%YAML:1.0`.
//!
//! Scalars stay texts: `1.` and `1e-3` are numbers to OpenCV and C, and not to every YAML schema.

use std::path::Path;

use saphyr::{LoadableYamlNode as _, MarkedYaml, Scalar, YamlData};

use crate::bad_input::BadInput;

/// A text and where it came from.
pub(super) struct Document<'a> {
    pub(super) path: &'a Path,
    pub(super) text: &'a str,
}

/// A value and the line, from zero, where it begins.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    pub(super) line: usize,
    pub(super) value: Value,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Text(String),
    List(Vec<Node>),
    Map(Vec<(String, Node)>),
}

/// A file nested deeper than this is no calibration.
const DEEPEST: usize = 16;

impl Document<'_> {
    /// The first document of the file.
    pub(super) fn root(&self) -> Result<Node, BadInput> {
        // Same length, so that lines and columns stay where they are.
        let text = self
            .text
            .strip_prefix("%YAML:")
            .map_or_else(|| self.text.to_owned(), |rest| format!("%YAML {rest}"));
        let documents = MarkedYaml::load_from_str(&text).map_err(|error| {
            let line = error.marker().line().saturating_sub(1);
            self.fault(
                line,
                format!("is no YAML: {}", error.info()),
                "save the calibration again as YAML",
            )
        })?;
        let first = documents
            .first()
            .ok_or_else(|| self.fault(0, "is empty".to_owned(), "give a calibration file"))?;
        Ok(node(first, DEEPEST))
    }

    /// A fault at a line, from zero.
    pub(super) fn fault(&self, line: usize, what: String, fix: &str) -> BadInput {
        BadInput::at_line(self.path, self.text, line, what, fix)
    }

    /// The numbers of a list, or of a matrix's `data`.
    pub(super) fn numbers(&self, node: &Node) -> Result<Vec<f64>, BadInput> {
        let list = node.get("data").unwrap_or(node);
        let Value::List(items) = &list.value else {
            return Err(self.fault(
                list.line,
                "a list of numbers is wanted here".to_owned(),
                "write [1.0, 2.0, ...]",
            ));
        };
        let mut numbers = Vec::with_capacity(items.len());
        for item in items {
            // A matrix may be written row by row.
            if let Value::List(_) = item.value {
                numbers.extend(self.numbers(item)?);
                continue;
            }
            let number = item
                .text()
                .and_then(|text| text.parse::<f64>().ok())
                .filter(|number| number.is_finite());
            numbers.push(number.ok_or_else(|| {
                self.fault(
                    item.line,
                    format!("`{}` is not a number", item.text().unwrap_or("...")),
                    "write a finite number",
                )
            })?);
        }
        Ok(numbers)
    }
}

impl Node {
    /// The value of a key of a mapping.
    pub(super) fn get(&self, key: &str) -> Option<&Self> {
        let Value::Map(entries) = &self.value else {
            return None;
        };
        entries.iter().find(|(name, _)| name == key).map(|(_, node)| node)
    }

    /// The value of the first of these keys that is there.
    pub(super) fn first(&self, keys: &[&str]) -> Option<&Self> {
        keys.iter().find_map(|key| self.get(key))
    }

    pub(super) fn text(&self) -> Option<&str> {
        match &self.value {
            Value::Text(text) => Some(text),
            Value::List(_) | Value::Map(_) => None,
        }
    }
}

fn node(yaml: &MarkedYaml<'_>, depth: usize) -> Node {
    Node {
        line: yaml.span.start.line().saturating_sub(1),
        value: value(&yaml.data, depth),
    }
}

fn value<'a>(data: &YamlData<'a, MarkedYaml<'a>>, depth: usize) -> Value {
    if depth == 0 {
        return Value::Text(String::new());
    }
    match data {
        YamlData::Sequence(items) => Value::List(items.iter().map(|item| node(item, depth - 1)).collect()),
        YamlData::Mapping(entries) => Value::Map(
            (entries.iter())
                .map(|(key, item)| (text(&key.data), node(item, depth - 1)))
                .collect(),
        ),
        YamlData::Tagged(_, inner) => value(&inner.data, depth - 1),
        other => Value::Text(text(other)),
    }
}

fn text<'a>(data: &YamlData<'a, MarkedYaml<'a>>) -> String {
    match data {
        YamlData::Representation(text, ..) => text.clone().into_owned(),
        YamlData::Value(Scalar::String(text)) => text.clone().into_owned(),
        YamlData::Value(Scalar::Integer(number)) => number.to_string(),
        YamlData::Value(Scalar::FloatingPoint(number)) => number.to_string(),
        YamlData::Value(Scalar::Boolean(flag)) => flag.to_string(),
        _ => String::new(),
    }
}

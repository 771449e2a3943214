//! Prometheus's own tool on metrics, alert rules and dashboard.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::BTreeSet;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use super::render_metrics;
use super::tests::Stream;

/// Runs promtool in `config/`; none, and told by name, where it is not installed.
fn promtool(arguments: &[&str], input: &str) -> Option<()> {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config");
    let child = Command::new("promtool")
        .args(arguments)
        .current_dir(config)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let Ok(mut child) = child else {
        eprintln!("SKIPPED: promtool {arguments:?}: apt-get install prometheus");
        return None;
    };
    // One that has seen enough may have closed its end.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    let output = child.wait_with_output().unwrap();
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    assert!(output.status.success(), "promtool {arguments:?}: {said}\n{input}");
    Some(())
}

#[test]
fn promtool_accepts_the_metrics() {
    for stream in [Stream::with_misses(), Stream::new()] {
        promtool(&["check", "metrics"], &render_metrics(&stream.state, stream.now));
    }
}

#[test]
fn promtool_accepts_the_alert_rules_and_they_fire_when_they_should() {
    promtool(&["check", "rules", "alerts.yml"], "");
    promtool(&["test", "rules", "alerts_test.yml"], "");
}

/// Words of a text that name a metric of ours.
fn names(text: &str) -> BTreeSet<&str> {
    text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_')
        .filter(|word| word.starts_with("freespace_"))
        .collect()
}

#[test]
fn alerts_and_dashboard_ask_for_metrics_that_there_are() {
    let stream = Stream::with_misses();
    let metrics = render_metrics(&stream.state, stream.now);
    let known = names(&metrics);
    for text in [
        include_str!("../../../config/alerts.yml"),
        include_str!("../../../config/grafana.json"),
    ] {
        let asked = names(text);
        assert!(asked.len() > 8);
        assert_eq!(asked.difference(&known).collect::<Vec<_>>(), Vec::<&&str>::new());
    }
    let dashboard: serde_json::Value =
        serde_json::from_str(include_str!("../../../config/grafana.json")).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    assert!(panels.iter().all(|panel| panel["targets"][0]["expr"].is_string()));
}

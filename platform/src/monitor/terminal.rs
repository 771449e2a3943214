//! The terminal view: the grid from above with the boundary, latency against the budget, misses, state.
//!
//! In: the shared state, keys. Out: frames of text, four a second. Invariant: the terminal is given back as it was found,
//! also after a fault; in a small window the bars are low, and the older misses are left out. Keys: `o`, `r`, `a` colour the grid by
//! occupancy, reason, age; `q`, Escape or Ctrl-C end.

mod birdseye;
mod histogram;

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ratatui::Frame;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout as Split, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph, Wrap};

use super::follow::{Shared, lock};
use super::snapshot::{Link, MessageView, Snapshot};
use super::state::{Layer, Now, State};

/// Between two frames, where no key is pressed.
const FRAME: Duration = Duration::from_millis(250);

const DIM: Style = Style::new().fg(Color::DarkGray);
const BOLD: Style = Style::new().add_modifier(Modifier::BOLD);

/// Shows the state until a key or `stop` ends it.
///
/// # Errors
/// The terminal cannot be read or written.
pub fn run(state: &Shared, note: &str, stop: &AtomicBool) -> io::Result<()> {
    // It also gives the terminal back where a panic ends the program.
    let mut terminal = ratatui::try_init()?;
    let mut layer = Layer::default();
    let shown = loop {
        if stop.load(Ordering::Relaxed) {
            break Ok(());
        }
        // A copy: a terminal that is slow, or stopped, must not hold up whoever else wants the state.
        let copy = lock(state).clone();
        if let Err(error) = terminal.draw(|frame| draw(frame, &copy, Now::read(), layer, note)) {
            break Err(error);
        }
        match pressed() {
            Err(error) => break Err(error),
            Ok(Some(Press::End)) => break Ok(()),
            Ok(Some(Press::Show(wanted))) => layer = wanted,
            Ok(None) => {}
        }
    };
    ratatui::try_restore()?;
    shown
}

enum Press {
    End,
    Show(Layer),
}

/// What was pressed within the time of a frame.
fn pressed() -> io::Result<Option<Press>> {
    if !event::poll(FRAME)? {
        return Ok(None);
    }
    Ok(match event::read()? {
        Event::Key(key) if key.kind == KeyEventKind::Press => press(key),
        _ => None,
    })
}

fn press(key: KeyEvent) -> Option<Press> {
    match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Some(Press::End),
        KeyCode::Char('q') | KeyCode::Esc => Some(Press::End),
        KeyCode::Char('o') => Some(Press::Show(Layer::Occupancy)),
        KeyCode::Char('r') => Some(Press::Show(Layer::Reason)),
        KeyCode::Char('a') => Some(Press::Show(Layer::Age)),
        _ => None,
    }
}

/// Draws the state as it is now; `note` stands in the last line.
pub fn draw(frame: &mut Frame<'_>, state: &State, now: Now, layer: Layer, note: &str) {
    let snapshot = Snapshot::of(state, now);
    let [head, body, foot] =
        Split::vertical([Constraint::Length(1), Constraint::Min(4), Constraint::Length(1)])
            .areas(frame.area());
    let [left, right] =
        Split::horizontal([Constraint::Percentage(48), Constraint::Percentage(52)]).areas(body);
    frame.render_widget(title(&snapshot), head);
    let block = Block::bordered().title(birdseye::title(layer));
    let inner = block.inner(left);
    frame.render_widget(block, left);
    match &state.last {
        Some(last) => birdseye::draw(frame.buffer_mut(), inner, last, layer),
        None => frame.render_widget(
            Paragraph::new(snapshot.reason.clone().unwrap_or_default()).wrap(Wrap { trim: true }),
            inner,
        ),
    }
    panels(frame, right, &snapshot);
    let keys = format!("o occupancy  r reason  a age  q end   {note}");
    frame.render_widget(Paragraph::new(keys).style(DIM), foot);
}

fn panels(frame: &mut Frame<'_>, area: Rect, snapshot: &Snapshot) {
    // In a window of 80 x 24 the bars are low, and the newest misses show.
    let [state, latency, misses] =
        Split::vertical([Constraint::Length(10), Constraint::Max(8), Constraint::Min(6)]).areas(area);
    let block = Block::bordered().title("State");
    let lines = match &snapshot.message {
        Some(message) => facts(message, snapshot),
        None => vec![
            Line::from("no message yet"),
            Line::from(format!("heat      {}", heat(snapshot))),
        ],
    };
    frame.render_widget(Paragraph::new(lines).block(block), state);
    let block = Block::bordered().title("Capture to publish");
    let inner = block.inner(latency);
    frame.render_widget(block, latency);
    histogram::draw(frame.buffer_mut(), inner, snapshot);
    let block = Block::bordered().title(format!("Misses: {}", snapshot.totals.misses));
    frame.render_widget(
        Paragraph::new(miss_lines(snapshot))
            .wrap(Wrap { trim: false })
            .block(block),
        misses,
    );
}

/// Green, yellow, red.
const fn colour(level: u8) -> Color {
    match level {
        0 => Color::Green,
        1..=3 => Color::Yellow,
        _ => Color::Red,
    }
}

fn title(snapshot: &Snapshot) -> Line<'static> {
    let link = match snapshot.link {
        Link::Live => Color::Green,
        Link::Waiting => Color::Yellow,
        Link::Silent | Link::Ended => Color::Red,
    };
    let mut spans = vec![
        Span::styled(format!(" freespace {} ", snapshot.service), BOLD),
        Span::styled(snapshot.link.name().to_uppercase(), BOLD.fg(link)),
    ];
    if let (Link::Silent, Some(silent_s)) = (snapshot.link, snapshot.silent_s) {
        spans.push(Span::styled(format!(" for {silent_s:.0} s"), BOLD.fg(link)));
    }
    if let Some(message) = &snapshot.message {
        spans.push(Span::raw(format!("  key frame {}  ", message.sequence)));
        let level = if snapshot.link == Link::Live {
            BOLD.fg(colour(message.level_number))
        } else {
            DIM
        };
        spans.push(Span::styled(message.level.to_owned(), level));
        spans.push(Span::raw(format!(
            "  {:.0} of {:.0} ms",
            message.used_ms, message.budget_ms
        )));
    }
    Line::from(spans)
}

fn facts(message: &MessageView, snapshot: &Snapshot) -> Vec<Line<'static>> {
    let fact = |name: &str, value: String, is_good: bool| {
        let style = if is_good { BOLD } else { BOLD.fg(Color::Yellow) };
        Line::from(vec![
            Span::styled(format!("{name:<10}"), DIM),
            Span::styled(value, style),
        ])
    };
    let faults = if message.faults.is_empty() {
        "none".to_owned()
    } else {
        message.faults.join(" ")
    };
    let scale_is_good = matches!(message.scale, "wheels" | "camera_height");
    let tracking_is_good = matches!(message.tracking, "good" | "standstill");
    let drops = snapshot.module.as_ref().map_or_else(
        || format!("{} messages", snapshot.totals.lost),
        |module| {
            format!(
                "{} of {} frames, {} messages",
                module.dropped_frames, module.frames, snapshot.totals.lost
            )
        },
    );
    vec![
        fact(
            "ahead",
            format!(
                "{:.1} m free, at {:.1} m/s",
                message.free_ahead_m, message.speed_mps
            ),
            true,
        ),
        fact(
            "tracking",
            format!("{}, scale {}", message.tracking, message.scale),
            tracking_is_good && scale_is_good,
        ),
        fact("camera", message.camera.to_owned(), message.camera == "good"),
        fact(
            "wheels",
            format!("{}; CAN {}", message.wheels, message.can),
            matches!(message.wheels, "good" | "not used") && message.can == "no fault",
        ),
        fact("dropped", drops, true),
        fact("faults", faults, message.faults.is_empty()),
        fact(
            "blame",
            message.blame.unwrap_or("-").to_owned(),
            message.blame.is_none(),
        ),
        fact("heat", heat(snapshot), !snapshot.temperatures.is_empty()),
    ]
}

/// The warmest sensors first, or why there is none.
fn heat(snapshot: &Snapshot) -> String {
    let mut warmest: Vec<_> = snapshot.temperatures.iter().collect();
    warmest.sort_by(|a, b| b.celsius.total_cmp(&a.celsius));
    if warmest.is_empty() {
        return snapshot.temperature_note.clone().unwrap_or_default();
    }
    let named = warmest
        .iter()
        .map(|read| format!("{:.0} C {}", read.celsius, read.zone));
    named.collect::<Vec<_>>().join(", ")
}

fn miss_lines(snapshot: &Snapshot) -> Vec<Line<'static>> {
    let counts = |counts: &[super::snapshot::Count]| {
        let named = counts
            .iter()
            .map(|count| format!("{} {}", count.name, count.count));
        named.collect::<Vec<_>>().join("  ")
    };
    let mut lines = vec![
        Line::from(vec![
            Span::styled("by stage  ", DIM),
            Span::raw(counts(&snapshot.totals.misses_by_blame)),
        ]),
        Line::from(vec![
            Span::styled("levels    ", DIM),
            Span::raw(counts(&snapshot.totals.levels)),
        ]),
    ];
    lines.extend(snapshot.misses.iter().map(|miss| {
        Line::from(format!(
            "{:>8}  {:>4.0} ms  {}  {}",
            miss.sequence,
            miss.used_ms,
            miss.level,
            miss.blame.unwrap_or("-")
        ))
    }));
    lines
}

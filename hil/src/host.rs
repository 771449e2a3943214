//! The machine's side: a fresh kernel for each case, two at a time, and the table of what they saw.

use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::Args;
use rustix::process::{Pid, Signal, kill_process};

use crate::case::{Case, Row, Verdict};
use crate::cases;
use crate::table;

/// What runs, and where.
#[derive(Args)]
pub(crate) struct RunArgs {
    /// Names of cases, `all`, or `quick`.
    #[arg(default_value = "quick")]
    cases: Vec<String>,
    /// Program that runs a command in a fresh kernel, and, repeated, its arguments; this machine's own devices without it.
    #[arg(long, value_name = "WORD", allow_hyphen_values = true)]
    kernel: Vec<String>,
    /// Kernels at a time.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// Arguments for each case.
    #[arg(last = true)]
    devices: Vec<String>,
    /// Where the rows go as JSON, one a line.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Runs the cases; whether none failed.
pub(crate) fn run(args: &RunArgs) -> bool {
    let chosen = match choose(&args.cases) {
        Ok(chosen) => chosen,
        Err(name) => {
            eprintln!("there is no case `{name}`; `list` names them");
            return false;
        }
    };
    // The longest first: the others run beside it.
    let queue: Mutex<Vec<&Case>> = Mutex::new(chosen.iter().rev().copied().collect());
    let rows = Mutex::new(Vec::new());
    let jobs = if args.kernel.is_empty() {
        1
    } else {
        args.jobs.max(1)
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let Some(case) = next(&queue) {
                    let row = run_until_undisturbed(args, case);
                    let mut rows = rows.lock().unwrap_or_else(PoisonError::into_inner);
                    match row.verdict {
                        Verdict::Passed => eprintln!("{:<18} {}", row.case, row.verdict),
                        _ => eprintln!("{:<18} {}: {}", row.case, row.verdict, row.seen),
                    }
                    rows.push(row);
                }
            });
        }
    });
    let mut rows = rows.into_inner().unwrap_or_else(PoisonError::into_inner);
    let place = |row: &Row| cases::all().position(|case| case.name == row.case);
    rows.sort_by_key(place);
    write_json(args, &rows);
    // A kernel of its own has all that the cases need.
    let is_whole = args.kernel.is_empty() || rows.iter().all(|row| row.verdict != Verdict::Skipped);
    table::print(&rows) && is_whole
}

fn next<'a>(queue: &Mutex<Vec<&'a Case>>) -> Option<&'a Case> {
    queue.lock().unwrap_or_else(PoisonError::into_inner).pop()
}

/// The cases by name, the soak first.
fn choose(names: &[String]) -> Result<Vec<&'static Case>, String> {
    let mut chosen: Vec<&Case> = Vec::new();
    for name in names {
        let before = chosen.len();
        chosen.extend(cases::all().filter(|case| match name.as_str() {
            // The short soak is part of the long one.
            "all" => case.name != "soak-short",
            "quick" => case.is_quick,
            name => case.name == name,
        }));
        if chosen.len() == before {
            return Err(name.clone());
        }
    }
    chosen.sort_by_key(|case| !case.name.starts_with("soak"));
    Ok(chosen)
}

/// Times that a case is run which failed on a machine that stood still meanwhile.
const TRIES: usize = 3;

fn run_until_undisturbed(args: &RunArgs, case: &Case) -> Row {
    let mut row = run_case(args, case);
    let mut earlier = String::new();
    for again in 1..TRIES {
        if row.verdict != Verdict::Failed || !row.is_disturbed {
            break;
        }
        eprintln!("{:<18} is run again ({again}): {}", row.case, row.seen);
        earlier = format!(
            "{earlier}; try {again} on a machine that stood still: {}",
            row.seen
        );
        row = run_case(args, case);
    }
    if row.verdict == Verdict::Failed && row.is_disturbed && row.is_excusable {
        row.verdict = Verdict::Passed;
        row.seen = format!("excused, for the machine stood still each time: {}", row.seen);
    }
    row.seen += &earlier;
    row
}

fn run_case(args: &RunArgs, case: &Case) -> Row {
    let begin = Instant::now();
    let failed = |why: String| case.with(Verdict::Failed, why, None, begin.elapsed().as_secs_f64());
    let program = match std::env::current_exe() {
        Ok(program) => program,
        Err(error) => return failed(error.to_string()),
    };
    let mut command = match args.kernel.split_first() {
        None => Command::new(&program),
        Some((kernel, words)) => {
            let mut command = Command::new(kernel);
            command
                .args(words)
                .arg("-t")
                .arg(limit_s(case).to_string())
                .arg("--")
                .arg(&program);
            command
        }
    };
    command
        .args(["case", case.name])
        .args(&args.devices)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    match output(&mut command, case) {
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stdout);
            let row = text
                .lines()
                .rev()
                .find_map(|line| serde_json::from_str::<Row>(line).ok());
            row.unwrap_or_else(|| {
                let words = String::from_utf8_lossy(&output.stderr);
                failed(format!(
                    "no row: {} {}",
                    output.status,
                    words.lines().last().unwrap_or_default()
                ))
            })
        }
        Err(error) => failed(error.to_string()),
    }
}

/// Runs it; a kernel keeps the time limit itself, and on this machine it is kept here.
fn output(command: &mut Command, case: &Case) -> std::io::Result<Output> {
    let child = command.spawn()?;
    let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    let (over, is_over) = mpsc::channel::<()>();
    let limit = Duration::from_secs(limit_s(case) + SPARE_S);
    let watch = std::thread::spawn(move || {
        if is_over.recv_timeout(limit) == Err(RecvTimeoutError::Timeout)
            && let Some(pid) = pid
        {
            let _ = kill_process(pid, Signal::KILL);
        }
    });
    let output = child.wait_with_output();
    drop(over);
    let _ = watch.join();
    output
}

/// What a kernel may take to start and to end.
const SPARE_S: u64 = 30;

/// Time limit of a case, so that one which hangs fails.
fn limit_s(case: &Case) -> u64 {
    if case.name == "soak" { 720 } else { 150 }
}

fn write_json(args: &RunArgs, rows: &[Row]) {
    let Some(path) = &args.json else { return };
    let lines: Vec<String> = rows
        .iter()
        .filter_map(|row| serde_json::to_string(row).ok())
        .collect();
    if let Err(error) = std::fs::write(path, lines.join("\n") + "\n") {
        eprintln!("{}: cannot be written: {error}", path.display());
    }
}

//! From `publish()` in the module to a reader awake in another process, and what `publish()` itself costs the publisher.
//!
//! `cargo bench -p freespace-reader`. The publisher sends a grid of 200 x 100 cells [`MESSAGES`] times, [`PERIOD`] apart, so
//! that all sleep in between; once with the reader at normal priority, once at `SCHED_FIFO` where that is permitted. The reader
//! is this program again. The load of the machine is printed with the result: beside other work, the normal reader shows it.

#![allow(clippy::unwrap_used, reason = "a benchmark may stop")]

#[path = "../tests/module/mod.rs"]
mod module;

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use freespace_platform::runtime::rights::{RealTimeConfig, ThreadRole, enter};
use freespace_reader::{Reader, monotonic_now};
use module::Module;

const MESSAGES: usize = 1500;
const PERIOD: Duration = Duration::from_millis(10);
/// What *emit* takes to make a message, which it says before.
const MAKING: Duration = Duration::from_micros(100);
/// Messages before the reader counts: it is being connected.
const WARM: u64 = 50;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, role, name, priority] = arguments.as_slice()
        && role == "reader"
    {
        return read(name, priority == "fifo");
    }
    println!(
        "load {}",
        std::fs::read_to_string("/proc/loadavg").unwrap().trim()
    );
    for priority in ["normal", "fifo"] {
        publish(priority);
    }
}

fn publish(priority: &str) {
    let name = module::name(priority);
    // As the publisher's thread: above the thread that it hands over to.
    let entered = enter(ThreadRole::Publisher, &RealTimeConfig::default());
    let mut module = Module::open(&name, 4).unwrap();
    let mut reader: Child = Command::new(std::env::current_exe().unwrap())
        .args(["reader", &name, priority])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut costs = Vec::with_capacity(1 << 20);
    let mut refused = 0;
    while reader.try_wait().unwrap().is_none() {
        module.prepare();
        let making = Instant::now();
        while making.elapsed() < MAKING {
            std::hint::spin_loop();
        }
        let begin = Instant::now();
        refused += u32::from(module.publish().is_err());
        costs.push(begin.elapsed().as_nanos());
        std::thread::sleep(PERIOD);
    }
    let output = reader.wait_with_output().unwrap();
    print!("{}", String::from_utf8_lossy(&output.stdout));
    costs.sort_unstable();
    let at = |part: f64| costs[index(costs.len(), part)] as f64 * 1e-3;
    println!(
        "publish() at {}: p50 {:.1} us  p99 {:.1} us  max {:.1} us  ({} messages, {refused} refused)",
        entered.scheduling,
        at(0.5),
        at(0.99),
        at(1.0),
        costs.len()
    );
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "ranks in a list"
)]
fn index(length: usize, part: f64) -> usize {
    ((length as f64 * part) as usize).min(length - 1)
}

fn read(name: &str, is_real_time: bool) {
    let mut reader = Reader::open(name).unwrap();
    let scheduling = if is_real_time {
        enter(ThreadRole::Sharing, &RealTimeConfig::default())
            .scheduling
            .to_string()
    } else {
        "normal priority".to_owned()
    };
    let mut micros = Vec::with_capacity(MESSAGES);
    let mut missed = 0;
    let mut last = None;
    while micros.len() < MESSAGES {
        let Some(message) = reader.next(Duration::from_secs(5)).unwrap() else {
            continue;
        };
        let latency = monotonic_now().since(freespace::space::Micros(message.publish_micros));
        if message.sequence >= WARM {
            micros.push(latency);
            missed += last.map_or(0, |last: u64| message.sequence - last - 1);
            last = Some(message.sequence);
        }
    }
    micros.sort_unstable();
    let at = |part: f64| micros[index(micros.len(), part)];
    println!(
        "reader at {scheduling}: p50 {} us  p99 {} us  max {} us  ({MESSAGES} messages, {missed} missed)",
        at(0.5),
        at(0.99),
        at(1.0)
    );
}

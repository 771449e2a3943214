//! Prints what the module publishes: `cargo run -p freespace-reader --example read [NAME [MESSAGES]]`.

use std::process::ExitCode;
use std::time::Duration;

use freespace_reader::{Reader, ReaderError, SharedMessage, monotonic_now, service};

const LEVELS: [&str; 6] = [
    "full",
    "no_refinement",
    "no_fresh_network",
    "no_fresh_map",
    "moved",
    "invalid",
];

/// Half the width of the way ahead, as a bearing.
const AHEAD_RAD: f32 = 0.05;

fn open(name: &str) -> Result<Reader, ReaderError> {
    loop {
        match Reader::open(name) {
            Err(ReaderError::NoModule) => {
                eprintln!("waiting for a module that publishes {name}");
                std::thread::sleep(Duration::from_secs(1));
            }
            opened => return opened,
        }
    }
}

fn print(message: &SharedMessage) {
    let level = LEVELS.get(usize::from(message.level)).unwrap_or(&"unknown");
    let unknown = message.occupancy[..message.cells()]
        .iter()
        .filter(|cell| **cell < 0)
        .count();
    #[expect(clippy::cast_precision_loss, reason = "a time to print")]
    let age_ms = message.age_micros(monotonic_now()) as f64 * 1e-3;
    println!(
        "{:>6} {level:<16} age {age_ms:6.1} ms, free ahead {:5.1} m, {unknown} of {} cells unknown (not free)",
        message.sequence,
        message.free_ahead_m(AHEAD_RAD),
        message.cells(),
    );
}

/// Name of the service, and after how many messages to end; none where they were not understood.
fn arguments() -> Option<(String, usize)> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments
        .next()
        .unwrap_or_else(|| service::DEFAULT_NAME.to_owned());
    let messages = arguments
        .next()
        .map_or(Some(usize::MAX), |text| text.parse().ok())?;
    (!name.starts_with('-')).then_some((name, messages))
}

fn main() -> ExitCode {
    let Some((name, messages)) = arguments() else {
        eprintln!("usage: read [NAME [MESSAGES]]: NAME is that of the module's [shared_memory]");
        return ExitCode::from(2);
    };
    match read(&name, messages) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{name}: {error}");
            ExitCode::FAILURE
        }
    }
}

fn read(name: &str, messages: usize) -> Result<(), ReaderError> {
    let mut reader = open(name)?;
    let mut seen = 0;
    while seen < messages {
        if let Some(message) = reader.next(Duration::from_secs(1))? {
            print(&message);
            seen += 1;
        } else {
            println!("no message for 1 s: nothing is known to be free");
        }
    }
    Ok(())
}

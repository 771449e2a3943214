//! How warm this computer is: the kernel's thermal zones, and sensors that no zone speaks for.
//!
//! In: `thermal/thermal_zone*/{type,temp}` and `hwmon/hwmon*/{name,temp*_input,temp*_label}` below a folder, `/sys/class`
//! unless told otherwise; they are readable by everyone. Out: [`Temperatures`] in the shared state, once a second, from a
//! thread of the monitor's own: nobody of the module waits for it. Invariant: names are unique, of [`LONGEST_NAME`] characters
//! at most, and hold no control character; a value that no sensor of a computer can mean is left out. Cost: two file reads a
//! sensor. When full: sensors beyond [`MOST`] are left out, and counted.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use freespace::space::Micros;

use super::follow::{Shared, lock};
use super::state::Now;

/// Where the kernel shows its sensors.
pub const SENSORS: &str = "/sys/class";
/// Between two readings.
const PERIOD: Duration = Duration::from_secs(1);
/// Sensors shown.
pub(super) const MOST: usize = 32;
/// Characters of a name.
const LONGEST_NAME: usize = 60;
/// Millidegrees that a part of a computer that runs can have; drivers say -274000 and the like for "not now".
const CREDIBLE: std::ops::RangeInclusive<i64> = -60_000..=200_000;

/// One sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Zone {
    /// What it measures, in the kernel's words.
    pub name: String,
    /// Degrees Celsius.
    pub celsius: f64,
}

/// All sensors at an instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Temperatures {
    /// Those that could be read, by name.
    pub zones: Vec<Zone>,
    /// Sensors that gave no value.
    pub unreadable: usize,
    /// Sensors beyond the 32 that are read.
    pub left_out: usize,
    /// When they were read.
    pub at: Micros,
}

/// Reads all sensors below `root`.
#[must_use]
pub fn read(root: &Path, at: Micros) -> Temperatures {
    let mut found = zones(root);
    let types: BTreeSet<String> = found.iter().map(|sensor| sensor.name.clone()).collect();
    // A zone shows up as a sensor of its type once more.
    found.extend(
        chips(root)
            .into_iter()
            .filter(|sensor| !types.contains(&sensor.chip)),
    );
    let mut temperatures = Temperatures {
        left_out: found.len().saturating_sub(MOST),
        at,
        ..Temperatures::default()
    };
    // By name; a sensor has its name whether or not it, or another one, can be read this time.
    let mut named: BTreeMap<String, Sensor> = BTreeMap::new();
    for sensor in found.into_iter().take(MOST) {
        let name = if named.contains_key(&sensor.name) {
            with_place(&sensor.name, &sensor.place)
        } else {
            sensor.name.clone()
        };
        named.insert(name, sensor);
    }
    for (name, sensor) in named {
        match sensor.celsius() {
            Some(celsius) => temperatures.zones.push(Zone { name, celsius }),
            None => temperatures.unreadable += 1,
        }
    }
    temperatures
}

/// Sensors of one name are told apart by their place.
fn with_place(name: &str, place: &str) -> String {
    let room = LONGEST_NAME.saturating_sub(place.chars().count() + 1);
    let name: String = name.chars().take(room).collect();
    format!("{name} {place}").chars().take(LONGEST_NAME).collect()
}

/// A sensor that is there, whether or not it can be read.
struct Sensor {
    name: String,
    /// Of a sensor that is no zone.
    chip: String,
    /// The kernel's own name of the place.
    place: String,
    file: PathBuf,
}

impl Sensor {
    #[expect(clippy::cast_precision_loss, reason = "within the credible range")]
    fn celsius(&self) -> Option<f64> {
        let text = fs::read_to_string(&self.file).ok()?;
        let millidegrees: i64 = text.trim().parse().ok()?;
        CREDIBLE
            .contains(&millidegrees)
            .then(|| millidegrees as f64 / 1e3)
    }
}

/// Entries of a folder whose names begin with `prefix` and a number, by that number.
fn numbered(folder: &Path, prefix: &str) -> Vec<(String, PathBuf)> {
    let mut entries: Vec<(u32, String, PathBuf)> = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(Result::ok)
        .filter_map(|entry| {
            let name = entry.file_name().to_str()?.to_owned();
            let number = name.strip_prefix(prefix)?.parse().ok()?;
            Some((number, name, entry.path()))
        })
        .collect();
    entries.sort();
    entries.into_iter().map(|(_, name, path)| (name, path)).collect()
}

/// A name from a file, fit to be shown; `otherwise` where there is none.
fn name(file: &Path, otherwise: &str) -> String {
    let text = fs::read_to_string(file).unwrap_or_default();
    let plain = |c: char| if c.is_control() { ' ' } else { c };
    let name: String = text.trim().chars().take(LONGEST_NAME).map(plain).collect();
    if name.is_empty() {
        otherwise.to_owned()
    } else {
        name
    }
}

fn zones(root: &Path) -> Vec<Sensor> {
    let zones = numbered(&root.join("thermal"), "thermal_zone");
    zones
        .into_iter()
        .map(|(place, folder)| Sensor {
            name: name(&folder.join("type"), &place),
            chip: String::new(),
            file: folder.join("temp"),
            place,
        })
        .collect()
}

fn chips(root: &Path) -> Vec<Sensor> {
    let mut sensors = Vec::new();
    for (place, folder) in numbered(&root.join("hwmon"), "hwmon") {
        let chip = name(&folder.join("name"), &place);
        // No chip has as many; one that says so does not hold up the monitor.
        for input in 1..=MOST {
            let file = folder.join(format!("temp{input}_input"));
            if file.exists() {
                let label = name(
                    &folder.join(format!("temp{input}_label")),
                    &format!("temp{input}"),
                );
                sensors.push(Sensor {
                    name: format!("{chip} {label}").chars().take(LONGEST_NAME).collect(),
                    chip: chip.clone(),
                    place: format!("{place} temp{input}"),
                    file,
                });
            }
        }
    }
    sensors
}

/// The thread that reads; it ends when this is dropped.
pub struct Thermometer {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// Reads the sensors below `root` at once, and then each second, into `state`.
///
/// # Errors
/// The system gave no thread.
pub fn measure(root: &Path, state: Shared) -> io::Result<Thermometer> {
    let (stop, stopped) = channel();
    let root = root.to_owned();
    let thread = std::thread::Builder::new()
        .name("temperatures".to_owned())
        .spawn(move || {
            loop {
                let temperatures = read(&root, Now::read().monotonic);
                lock(&state).temperatures(temperatures);
                if stopped.recv_timeout(PERIOD) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
        })?;
    Ok(Thermometer {
        stop: Some(stop),
        thread: Some(thread),
    })
}

impl Drop for Thermometer {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
#[path = "temperatures_tests.rs"]
mod tests;

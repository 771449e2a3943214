//! The processor: its clock, and who else is served by the cores that the loop is bound to.

use std::collections::BTreeSet;

use super::{Check, System};
use crate::runtime::rights::{Cpus, RealTimeConfig};

const CPUS: &str = "sys/devices/system/cpu";

/// Frequency governor and clock.
#[must_use]
pub fn governor(system: &System) -> Check {
    const NAME: &str = "processor clock";
    let scaling: Vec<String> = (system.list(CPUS).into_iter())
        .filter(|name| {
            name.strip_prefix("cpu")
                .is_some_and(|number| number.parse::<u32>().is_ok())
        })
        .map(|name| format!("{CPUS}/{name}/cpufreq"))
        .filter(|folder| system.path(folder).exists())
        .collect();
    let of = |file: &str| -> BTreeSet<String> {
        (scaling.iter())
            .filter_map(|folder| system.read(&format!("{folder}/{file}")))
            .collect()
    };
    if scaling.is_empty() {
        let mhz = system.read("proc/cpuinfo").and_then(|text| {
            let line = text.lines().find(|line| line.starts_with("cpu MHz"))?;
            line.split_once(':').map(|(_, mhz)| mhz.trim().to_owned())
        });
        let clock = mhz.map_or_else(String::new, |mhz| format!("{mhz} MHz, "));
        return Check::ok(NAME, format!("{clock}not scaled by this kernel"));
    }
    let mhz = |file: &str| -> Option<i64> {
        let values = of(file);
        values
            .iter()
            .filter_map(|value| value.parse::<i64>().ok())
            .min()
            .map(|khz| khz / 1000)
    };
    let clock = match (mhz("scaling_cur_freq"), mhz("cpuinfo_max_freq")) {
        (Some(now), Some(most)) => format!(", {now} of {most} MHz"),
        _ => String::new(),
    };
    let governors: Vec<String> = of("scaling_governor").into_iter().collect();
    let seen = format!("governor {}{clock}", governors.join(", "));
    if governors == ["performance"] {
        return Check::ok(NAME, seen);
    }
    Check::warning(
        NAME,
        format!("{seen}: each wake-up begins on a slow clock"),
        "cpupower frequency-set -g performance, or \
         echo performance | tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
    )
}

/// Whether the cores that threads are bound to are kept for them.
#[must_use]
pub fn interrupts(system: &System, config: &RealTimeConfig) -> Check {
    const NAME: &str = "cores";
    let online = system.read(&format!("{CPUS}/online")).unwrap_or_default();
    let isolated = system.read(&format!("{CPUS}/isolated")).unwrap_or_default();
    let bound = config.threads.iter().fold(0, |all, thread| all | thread.cpus.0);
    if bound == 0 {
        return Check::ok(NAME, format!("{online} online; threads run on any of them"));
    }
    let missing = bound & !set_of(&online);
    let bound_text = text_of(bound);
    if missing != 0 {
        return Check::fails(
            NAME,
            format!("{online} online, but threads are bound to {}", text_of(missing)),
            "correct `cpus` in [runtime]",
        );
    }
    if bound & !set_of(&isolated) != 0 {
        return Check::warning(
            NAME,
            format!("threads are bound to {bound_text}, which other programs and interrupts use too"),
            format!("boot with isolcpus={bound_text} nohz_full={bound_text} irqaffinity=<the other cores>"),
        );
    }
    Check::ok(NAME, format!("threads are bound to {bound_text}, isolated"))
}

/// The set that the kernel writes as `0-2,5`.
fn set_of(text: &str) -> u64 {
    let mut set = 0_u64;
    for range in text.split(',') {
        let (from, to) = range.split_once('-').unwrap_or((range, range));
        if let (Ok(from), Ok(to)) = (from.trim().parse::<u32>(), to.trim().parse::<u32>()) {
            (from..=to.min(Cpus::LIMIT - 1)).for_each(|cpu| set |= 1_u64.checked_shl(cpu).unwrap_or(0));
        }
    }
    set
}

fn text_of(set: u64) -> String {
    let cpus: Vec<String> = (0..Cpus::LIMIT)
        .filter(|cpu| Cpus(set).has(*cpu))
        .map(|cpu| cpu.to_string())
        .collect();
    cpus.join(",")
}

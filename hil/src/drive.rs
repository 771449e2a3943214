//! A drive with one fault in it: steady, then the fault, then the recovery, then the end as a service ends.

use std::process::ExitStatus;
use std::time::Duration;

use freespace::health::{Faults, QualityLevel};
use freespace_platform::world::Slip;

use crate::bench::{Bench, BenchError, Rig, STANDING, late_once, ordinary};
use crate::case::Seen;
use crate::clock::now_micros;
use crate::listener::{Heard, candump};
use crate::promise::{Blind, judge};
use crate::truth;

/// Something done to the bench.
pub(crate) type Action = Box<dyn Fn(&mut Bench) -> Result<(), BenchError>>;

/// What is done to the drive, and what of it must be seen.
pub(crate) struct Script {
    /// How long the fault lasts.
    pub(crate) fault_s: f64,
    /// Begins the fault.
    pub(crate) begin: Action,
    /// Ends it.
    pub(crate) end: Action,
    /// Faults, all of which the answers must name from its begin until the recovery.
    pub(crate) named: Faults,
    /// Faults that the answers may name besides while it lasts.
    pub(crate) allowed: Faults,
    /// Best level that an answer may claim once the fault was named.
    pub(crate) best: QualityLevel,
    /// Answers that claim more all the same: a loopback device that is opened gives the picture that it kept, newly stamped.
    pub(crate) kept_pictures: usize,
    /// Time from its end to a good answer.
    pub(crate) recovers_s: f64,
    pub(crate) slips: &'static [Slip],
    pub(crate) blind: Blind,
}

impl Default for Script {
    fn default() -> Self {
        Self {
            fault_s: 4.0,
            begin: Box::new(|_| Ok(())),
            end: Box::new(|_| Ok(())),
            named: Faults::NONE,
            allowed: Faults::NONE,
            best: QualityLevel::Full,
            kept_pictures: 0,
            recovers_s: 3.0,
            slips: &[],
            blind: Blind::default(),
        }
    }
}

/// A picture may be sent so much after its time: a picture's period.
const LATE_MS: u64 = 33;

/// A steady drive before the fault, and after the recovery.
const STEADY: Duration = Duration::from_secs(2);

/// Drives through a script.
pub(crate) fn drive(rig: &Rig, script: &Script) -> Result<Seen, BenchError> {
    let mut bench = Bench::start(rig, script.slips, None)?;
    let mut seen = Seen::default();
    std::thread::sleep(STEADY);
    let begin = now_micros();
    (script.begin)(&mut bench)?;
    std::thread::sleep(Duration::from_secs_f64(script.fault_s));
    seen.require(bench.module.is_running(), "the module ended");
    let end = now_micros();
    (script.end)(&mut bench)?;
    recover(&bench, script, end, &mut seen);
    std::thread::sleep(STEADY);
    let heard = bench.listener.heard();
    let during: Vec<_> = heard
        .iter()
        .filter(|heard| (begin..end).contains(&heard.at_micros))
        .collect();
    let since = heard.iter().filter(|heard| heard.at_micros >= begin);
    let named = since.fold(Faults::NONE, |all, heard| all | heard.faults);
    let missing = Faults(script.named.0 & !named.0);
    seen.require(missing.is_empty(), format!("no answer named {}", names(missing)));
    let named = during.iter().fold(Faults::NONE, |all, heard| all | heard.faults);
    let allowed = script.named | script.allowed | ordinary(&during) | late_once(&during);
    let strange = Faults(named.0 & !allowed.0);
    seen.require_in_peace(strange.is_empty(), format!("{} was named", names(strange)));
    let marked = during
        .iter()
        .skip_while(|heard| heard.faults.0 & script.named.0 == 0);
    let proud = marked.filter(|heard| heard.level < script.best).count();
    seen.require(
        proud <= script.kept_pictures,
        format!("{proud} answers better than {}", script.best.name()),
    );
    let worst = during.iter().map(|heard| heard.level).max();
    if let Some(worst) = worst {
        seen.note(format!(
            "{} answers meanwhile, {} at worst, named {}",
            during.len(),
            worst.name(),
            names(named)
        ));
    }
    finish(bench, script.blind, Ending::Well, seen)
}

/// How the program is to end when it is told to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// With exit code 0.
    Well,
    /// By itself too, but with an error that it told.
    WithError,
}

fn recover(bench: &Bench, script: &Script, end: u64, seen: &mut Seen) {
    let at_most = Duration::from_secs_f64(script.recovers_s);
    match bench.listener.wait_for(at_most, |heard| heard.is_good(STANDING)) {
        Some(heard) => {
            #[expect(clippy::cast_precision_loss, reason = "seconds")]
            let seconds = (heard.at_micros - end) as f64 * 1e-6;
            seen.recovery_s = Some(seconds);
        }
        None => {
            let last = bench
                .listener
                .heard()
                .last()
                .map(|heard| (heard.level.name(), names(heard.faults)));
            seen.require_in_peace(
                false,
                format!("no good answer within {} s: {last:?}", script.recovers_s),
            );
        }
    }
}

/// Ends the module as a service would be ended, and looks at the whole drive.
pub(crate) fn finish(bench: Bench, blind: Blind, ending: Ending, mut seen: Seen) -> Result<Seen, BenchError> {
    let Bench {
        rig,
        road,
        listener,
        feed,
        module,
        ..
    } = bench;
    let words = module.last_words();
    let status = module.end();
    std::thread::sleep(Duration::from_millis(100));
    let frames = listener.frames();
    let heard = listener.heard();
    last_word(status, ending, &heard, &words, &mut seen);
    let kept = judge(&heard, blind);
    seen.note(format!(
        "{} answers, latest {:.0} ms",
        kept.answers, kept.latest_ms
    ));
    seen.broken.extend(kept.broken);
    let grids = truth::judge(&frames, &road, &feed, &mut seen);
    std::fs::write(rig.file("grids.csv"), grids)?;
    let late_ms = feed.lateness_micros(road.rate_hz) / 1000;
    seen.note(format!("pictures at most {late_ms} ms late"));
    seen.was_late = late_ms > LATE_MS;
    std::fs::write(rig.file("bus.candump"), candump(&frames, &rig.interface))?;
    Ok(seen)
}

/// The module ended as it should, and its last message says so.
pub(crate) fn last_word(
    status: Option<ExitStatus>,
    ending: Ending,
    heard: &[Heard],
    words: &str,
    seen: &mut Seen,
) {
    // A program that was killed has no code, one that hung no status.
    let code = status.and_then(|status| status.code());
    seen.require(
        match ending {
            Ending::Well => code == Some(0),
            Ending::WithError => code == Some(1),
        },
        format!("SIGTERM ended it with {status:?}: {words}"),
    );
    let is_last_word = heard.last().is_some_and(|last| {
        last.level == QualityLevel::Invalid && last.faults.contains(Faults::SHUTTING_DOWN)
    });
    seen.require(
        is_last_word,
        "the last message is not the invalid one of a shut-down",
    );
}

/// Names of faults, for the table.
pub(crate) fn names(faults: Faults) -> String {
    let names: Vec<_> = Faults(faults.0 & !STANDING.0).names().collect();
    if names.is_empty() {
        "nothing".to_owned()
    } else {
        names.join(", ")
    }
}

//! What must hold in every case: an answer for each key frame, in time, and none that is wrong without saying so.

use freespace::health::Faults;

use crate::listener::Heard;

/// Latest answer: the deadline and the time that a frame takes to be sent and read.
const LATEST_MS: f64 = 505.0;
/// Longest silence: a key frame's period, and a fallback after a prompt answer.
const LONGEST_SILENCE_MICROS: u64 = 1_000_000;

/// Which of the promises cannot be seen from the bus in this case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Blind {
    /// The bus is down, or the module is not running, for a time: what is sent then is not heard.
    pub(crate) spots: bool,
}

/// How the promises were kept.
#[derive(Clone, Debug, Default)]
pub(crate) struct Kept {
    pub(crate) answers: usize,
    pub(crate) latest_ms: f64,
    pub(crate) faults: Faults,
    pub(crate) broken: Vec<String>,
}

/// Looks at all publications of a drive; the last one is the module's last word, which answers no key frame.
pub(crate) fn judge(heard: &[Heard], blind: Blind) -> Kept {
    let answers = &heard[..heard.len().saturating_sub(1)];
    let mut kept = Kept {
        answers: answers.len(),
        ..Kept::default()
    };
    for answer in answers {
        kept.faults |= answer.faults;
        let ms = answer.latency_ms();
        kept.latest_ms = kept.latest_ms.max(ms);
        if ms > LATEST_MS {
            kept.broken.push(format!(
                "answer {} came {ms:.0} ms after capture",
                answer.sequence
            ));
        }
    }
    if !blind.spots {
        for pair in heard.windows(2) {
            kept.broken.extend(silence(&pair[0], &pair[1]));
        }
        for pair in answers.windows(2) {
            kept.broken.extend(lost(&pair[0], &pair[1]));
        }
    }
    kept
}

fn lost(before: &Heard, after: &Heard) -> Option<String> {
    (after.sequence != before.sequence.wrapping_add(1))
        .then(|| format!("answer {} follows answer {}", after.sequence, before.sequence))
}

fn silence(before: &Heard, after: &Heard) -> Option<String> {
    let silence = after.at_micros.saturating_sub(before.at_micros);
    (silence > LONGEST_SILENCE_MICROS).then(|| {
        format!(
            "silence of {} ms before answer {}",
            silence / 1000,
            after.sequence
        )
    })
}

#[cfg(test)]
mod tests {
    use freespace::health::QualityLevel;

    use super::*;

    fn heard(sequence: u8, at_ms: u64, latency_ms: f64) -> Heard {
        Heard {
            at_micros: at_ms * 1000,
            level: QualityLevel::Full,
            faults: Faults::NONE,
            sequence,
            capture_to_publish_ms: latency_ms,
            capture_to_bus_ms: None,
        }
    }

    #[test]
    fn a_prompt_drive_keeps_every_promise() {
        let drive = [
            heard(254, 0, 40.0),
            heard(255, 500, 45.0),
            heard(0, 1000, 400.0),
            heard(9, 1300, 0.0),
        ];
        let kept = judge(&drive, Blind::default());
        assert!(kept.broken.is_empty(), "{:?}", kept.broken);
        assert_eq!(kept.answers, 3);
    }

    #[test]
    fn lateness_silence_and_a_lost_answer_are_each_noticed() {
        let end = |at_ms| heard(7, at_ms, 0.0);
        let sat_on = Heard {
            capture_to_bus_ms: Some(510.0),
            ..heard(0, 0, 40.0)
        };
        let late = judge(&[heard(0, 0, 506.0), end(100)], Blind::default());
        let late_on_bus = judge(&[sat_on, end(100)], Blind::default());
        let silent = judge(
            &[heard(0, 0, 40.0), heard(1, 1100, 40.0), end(1200)],
            Blind::default(),
        );
        let silent_at_end = judge(&[heard(0, 0, 40.0), end(1200)], Blind::default());
        let lost = judge(
            &[heard(0, 0, 40.0), heard(2, 600, 40.0), end(700)],
            Blind::default(),
        );
        for kept in [late, late_on_bus, silent, silent_at_end, lost] {
            assert_eq!(kept.broken.len(), 1, "{:?}", kept.broken);
        }
    }
}

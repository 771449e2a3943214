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

/// Looks at all publications of a drive.
pub(crate) fn judge(heard: &[Heard], blind: Blind) -> Kept {
    let mut kept = Kept {
        answers: heard.len(),
        ..Kept::default()
    };
    for answer in heard {
        kept.faults |= answer.faults;
        kept.latest_ms = kept.latest_ms.max(answer.capture_to_publish_ms);
        if answer.capture_to_publish_ms > LATEST_MS {
            let ms = answer.capture_to_publish_ms;
            kept.broken.push(format!(
                "answer {} came {ms:.0} ms after capture",
                answer.sequence
            ));
        }
    }
    if !blind.spots {
        for pair in heard.windows(2) {
            kept.broken.extend(gap(&pair[0], &pair[1]));
        }
    }
    kept
}

fn gap(before: &Heard, after: &Heard) -> Option<String> {
    let silence = after.at_micros.saturating_sub(before.at_micros);
    if after.sequence != before.sequence.wrapping_add(1) {
        return Some(format!(
            "answer {} follows answer {}",
            after.sequence, before.sequence
        ));
    }
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
        }
    }

    #[test]
    fn a_prompt_drive_keeps_every_promise() {
        let drive = [heard(254, 0, 40.0), heard(255, 500, 45.0), heard(0, 1000, 400.0)];
        let kept = judge(&drive, Blind::default());
        assert!(kept.broken.is_empty(), "{:?}", kept.broken);
        assert_eq!(kept.answers, 3);
    }

    #[test]
    fn lateness_silence_and_a_lost_answer_are_each_noticed() {
        let late = judge(&[heard(0, 0, 506.0)], Blind::default());
        let silent = judge(&[heard(0, 0, 40.0), heard(1, 1100, 40.0)], Blind::default());
        let lost = judge(&[heard(0, 0, 40.0), heard(2, 600, 40.0)], Blind::default());
        for kept in [late, silent, lost] {
            assert_eq!(kept.broken.len(), 1, "{:?}", kept.broken);
        }
    }
}

#![allow(clippy::unwrap_used, clippy::cast_possible_wrap, reason = "tests")]

use alloc::collections::BTreeMap;
use alloc::string::{String, ToString};

use super::*;
use crate::health::{Faults, QualityLevel, ScaleState, TrackingState};
use crate::space::Micros;
use proptest::prelude::*;

const DBC: &str = include_str!("../../../config/freespace.dbc");

struct Signal {
    start: u32,
    bits: u32,
    is_signed: bool,
    unit: f64,
}

/// The `BO_` and `SG_` lines of the DBC file.
fn layout() -> BTreeMap<(u32, String), Signal> {
    let mut signals = BTreeMap::new();
    let mut id = 0;
    for line in DBC.lines() {
        let words: alloc::vec::Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["BO_", number, ..] => id = number.parse().unwrap(),
            // The grid's frames are longer than a word; they have a test of their own.
            ["SG_", ..] if id >= crate::emit::grid_frames::GRID_HEAD_ID => {}
            ["SG_", name, ":", place, factor, ..] => {
                let (start, rest) = place.split_once('|').unwrap();
                let (bits, order) = rest.split_once('@').unwrap();
                let unit = factor.trim_start_matches('(').split(',').next().unwrap();
                let signal = Signal {
                    start: start.parse().unwrap(),
                    bits: bits.parse().unwrap(),
                    is_signed: order == "1-",
                    unit: unit.parse().unwrap(),
                };
                assert!(order.starts_with('1'), "little-endian");
                signals.insert((id, (*name).to_string()), signal);
            }
            _ => {}
        }
    }
    signals
}

fn decode(frames: &[CanFrame], id: u32, name: &str) -> f64 {
    let layout = layout();
    let signal = &layout[&(id, name.to_string())];
    let frame = frames.iter().find(|f| f.id == id).unwrap();
    let payload = u64::from_le_bytes(frame.data.as_slice().try_into().unwrap());
    let raw = (payload >> signal.start) & ((1 << signal.bits) - 1);
    if signal.is_signed {
        let shift = 64 - signal.bits;
        ((raw << shift) as i64 >> shift) as f64 * signal.unit
    } else {
        raw as f64 * signal.unit
    }
}

proptest! {
    #[test]
    fn every_signal_reads_back_by_the_dbc(
        faults: u32,
        level in 0u8..6,
        late_micros in 0u64..900_000,
        speed in -50.0..80.0f32,
        yaw_rate in -1.5..1.5f32,
        heading in -3.1..3.1f64,
        height in 0.5..3.0f32,
        pitch in -0.3..0.3f32,
        free in prop::array::uniform32(0.0..80.0f32),
    ) {
        let header = Header {
            sequence: 513,
            capture: Micros(1_000_000),
            publish: Micros(1_000_000 + late_micros),
            deadline: Micros(1_500_000),
            budget_micros: 500_000,
            used_micros: 87_600,
            level: QualityLevel::from_wire(level).unwrap(),
            faults: Faults(faults),
            scale: ScaleState::CameraHeight,
            tracking: TrackingState::DeadReckoning,
            orientation: [0.0, 0.0, (0.5 * heading).sin(), (0.5 * heading).cos()],
            speed_mps: speed,
            yaw_rate_radps: yaw_rate,
            plane_normal: [0.0, -pitch.cos(), -pitch.sin()],
            plane_offset_m: height,
            free_m: free,
            ..Header::default()
        };
        let frames = CanEncoder::default().encode(&header);
        let near = |id, name: &str, value: f64, unit: f64| (decode(&frames, id, name) - value).abs() <= 0.51 * unit;
        prop_assert!(near(STATUS_ID, "Quality", f64::from(level), 0.0));
        prop_assert!(near(STATUS_ID, "Faults", f64::from(faults), 0.0));
        prop_assert!(near(STATUS_ID, "Scale", 2.0, 0.0));
        prop_assert!(near(STATUS_ID, "Tracking", 0.0, 0.0));
        prop_assert!(near(STATUS_ID, "Sequence", 1.0, 0.0));
        prop_assert!(near(TIMING_ID, "CaptureToPublish", late_micros as f64 * 1e-3, 0.1));
        prop_assert!(near(TIMING_ID, "Used", 87.6, 0.1));
        prop_assert!(near(TIMING_ID, "Budget", 500.0, 0.1));
        prop_assert!(near(TIMING_ID, "Late", f64::from(u8::from(late_micros > 500_000)), 0.0));
        prop_assert!(near(EGO_ID, "Speed", f64::from(speed), 0.01));
        prop_assert!(near(EGO_ID, "YawRate", f64::from(yaw_rate), 1e-4));
        prop_assert!(near(EGO_ID, "Heading", heading, 1e-4));
        prop_assert!(near(PLANE_ID, "Height", f64::from(height), 1e-3));
        prop_assert!(near(PLANE_ID, "Pitch", f64::from(pitch), 1e-4));
        prop_assert!(near(PLANE_ID, "Roll", 0.0, 1e-4));
        prop_assert!(near(PLANE_ID, "Held", 1.0, 0.0));
        for (sector, free_m) in free.iter().enumerate() {
            let id = SECTORS_ID + (sector / 4) as u32;
            let name = alloc::format!("Free{sector:02}");
            prop_assert!(near(id, &name, f64::from(*free_m), 0.02));
        }
    }

    #[test]
    fn damage_and_mix_ups_are_noticed(byte in 0usize..8, bit in 0u32..8, frame in 0usize..FRAMES) {
        let mut frames = CanEncoder::default().encode(&Header::default());
        prop_assert_eq!(check(&frames[frame]), Ok(0));
        let mut swapped = frames[frame].clone();
        swapped.id ^= 0x20;
        prop_assert!(check(&swapped).is_err());
        frames[frame].data[byte] ^= 1 << bit;
        prop_assert_eq!(check(&frames[frame]), Err(CanCheckError::WrongChecksum));
    }
}

#[test]
fn signals_do_not_overlap_and_fill_their_frames() {
    let mut used: BTreeMap<u32, u64> = BTreeMap::new();
    for ((id, name), signal) in layout() {
        let bits = ((1u64 << signal.bits) - 1) << signal.start;
        let taken = used.entry(id).or_default();
        assert_eq!(*taken & bits, 0, "{id} {name}");
        *taken |= bits;
    }
    assert_eq!(used.len(), FRAMES);
}

#[test]
fn dbc_names_every_fault() {
    for (_, name) in Faults::NAMED {
        assert!(DBC.contains(name), "{name}");
    }
}

#[test]
fn counter_runs_from_0_to_14_and_values_are_clamped() {
    let mut encoder = CanEncoder::default();
    let mut header = Header::default();
    header.free_m[0] = f32::INFINITY;
    header.free_m[1] = f32::NAN;
    header.speed_mps = f32::NAN;
    for round in 0..32u8 {
        let frames = encoder.encode(&header);
        assert!(frames.iter().all(|f| check(f) == Ok(round % 15)));
        assert!((decode(&frames, SECTORS_ID, "Free00") - 81.88).abs() < 1e-9);
        assert!((decode(&frames, SECTORS_ID, "Free01") - 81.90).abs() < 1e-9);
        assert!((decode(&frames, EGO_ID, "Speed") + 327.68).abs() < 1e-9);
    }
}

/// The example of the AUTOSAR protocol specification for profile 11A: data id 0x123, eight zero bytes, counter 0.
#[test]
fn profile_11a_reference() {
    assert_eq!(crc8(crc8(0, &0x123u16.to_le_bytes()), &[0; 7]), 0xCC);
}

//! The module's frames, checked by another implementation of AUTOSAR's E2E profiles.

use autosar_e2e::profile5::{Profile5, Profile5Config};
use autosar_e2e::profile11::{Profile11, Profile11Config, Profile11IdMode};
use autosar_e2e::{E2EProfile as _, E2EStatus};
use freespace::emit::grid_frames::{GRID_CELLS_ID, GRID_HEAD_ID};
use freespace::emit::{CanEncoder, FreeSpaceMessage, GridEncoder};

use super::rig::publication;

const DATA_ID_BASE: u16 = 0x4600;

fn data_id(id: u32) -> u16 {
    DATA_ID_BASE + u16::try_from(id).unwrap()
}

#[test]
fn classic_frames_are_profile_11a() {
    let mut encoder = CanEncoder::default();
    let (_, first) = publication(&mut encoder, 0);
    let mut receivers: Vec<Profile11> = (first.iter())
        .map(|frame| {
            let config = Profile11Config {
                mode: Profile11IdMode::Both,
                data_id: data_id(frame.id),
                data_length: 64,
                ..Profile11Config::default()
            };
            Profile11::new(config).unwrap()
        })
        .collect();
    for (receiver, frame) in receivers.iter_mut().zip(&first) {
        assert_eq!(receiver.check(&frame.data), Ok(E2EStatus::Ok), "{:#X}", frame.id);
    }
    for round in 1..40 {
        let (_, frames) = publication(&mut encoder, round);
        for (receiver, frame) in receivers.iter_mut().zip(&frames) {
            assert_eq!(receiver.check(&frame.data), Ok(E2EStatus::Ok), "{:#X}", frame.id);
            let mut damaged = frame.data.clone();
            damaged[5] ^= 0x10;
            assert_eq!(receiver.check(&damaged), Ok(E2EStatus::CrcError));
        }
    }
}

#[test]
fn grid_frames_are_profile_5() {
    let receiver = |id| {
        let config = Profile5Config {
            data_id: data_id(id),
            data_length: 512,
            ..Profile5Config::default()
        };
        Profile5::new(config).unwrap()
    };
    let (mut head, mut cells) = (receiver(GRID_HEAD_ID), receiver(GRID_CELLS_ID));
    let mut encoder = GridEncoder::default();
    for round in 0..3 {
        let (message, _) = publication(&mut CanEncoder::default(), round);
        encoder.encode(&FreeSpaceMessage::decode(&message).unwrap(), &mut |frame| {
            let receiver = if frame.id == GRID_HEAD_ID {
                &mut head
            } else {
                &mut cells
            };
            assert_eq!(receiver.check(&frame.data), Ok(E2EStatus::Ok), "{:#X}", frame.id);
        });
    }
}

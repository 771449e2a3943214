#![allow(clippy::unwrap_used, reason = "tests")]

use super::picture::Painter;
use super::*;
use crate::sink::shared_memory::SharingConfig;

fn status(sequence: u64) -> ViewStatus {
    ViewStatus {
        sequence,
        stage_micros: [1, 2, 3, 4, 5, 6, 7, 8],
        dropped_frames: 3,
        events: vec!["a line".to_owned()],
        ..ViewStatus::default()
    }
}

#[test]
fn a_view_is_read_as_it_was_written_and_damaged_bytes_are_none() {
    let mut bytes = Vec::new();
    assert!(encode(&status(7), b"jpeg", &mut bytes));
    let view = decode(&bytes).unwrap();
    assert_eq!((view.status, &view.picture[..]), (status(7), &b"jpeg"[..]));
    for end in 0..bytes.len() - b"jpeg".len() {
        assert_eq!(decode(&bytes[..end]), None, "cut at {end}");
    }
    bytes[8..12].fill(0xff);
    assert_eq!(decode(&bytes), None);
}

#[test]
fn a_picture_that_has_no_room_is_left_out() {
    let mut bytes = Vec::new();
    assert!(encode(&status(1), &vec![0; MAX_VIEW_BYTES], &mut bytes));
    assert_eq!(decode(&bytes).unwrap().picture.len(), 0);
}

#[test]
fn the_road_is_tinted_and_large_frames_are_shrunk() {
    let (width, height) = (1300, 40);
    let pixels = vec![100; 3 * width * height];
    let mut labels = vec![0; 130 * 4];
    labels[2 * 130..].fill(1);
    let mut painter = Painter::default();
    let jpeg = painter.paint(&PictureSource {
        size: (width, height),
        pixels: &pixels,
        labels_size: (130, 4),
        labels: &labels,
    });
    let image = image::load_from_memory(jpeg).unwrap().into_rgb8();
    assert_eq!(image.dimensions(), (433, 13));
    let (above, road) = (image.get_pixel(200, 2), image.get_pixel(200, 11));
    assert!(above[0].abs_diff(100) < 8 && road[0] > 140, "{above:?} {road:?}");
    let wrong = PictureSource {
        size: (4, 4),
        pixels: &[],
        labels_size: (1, 1),
        labels: &[1],
    };
    assert!(painter.paint(&wrong).is_empty());
}

#[test]
fn a_reader_gets_the_newest_view_and_pictures_are_drawn_for_readers_alone() {
    let config = SharingConfig {
        name: format!("freespace/test/view/{}", std::process::id()),
        max_readers: 2,
    };
    let mut writer = ViewWriter::open(&config).unwrap();
    let source = PictureSource {
        size: (8, 8),
        pixels: &[90; 192],
        labels_size: (2, 2),
        labels: &[1; 4],
    };
    assert!(!writer.is_watched());
    writer.write(&status(1), Some(&source)).unwrap();
    let reader = ViewReader::open(&config.name).unwrap();
    assert!(writer.is_watched());
    assert_eq!(reader.newest().unwrap(), None);
    writer.write(&status(2), Some(&source)).unwrap();
    writer.write(&status(3), Some(&source)).unwrap();
    let newest = reader.newest().unwrap().unwrap();
    assert_eq!(newest.status.sequence, 3);
    assert!(image::load_from_memory(&newest.picture).is_ok());
    assert_eq!(reader.newest().unwrap(), None);
    drop(reader);
    assert!(!writer.is_watched());
}

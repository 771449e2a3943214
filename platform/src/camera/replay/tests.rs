#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "tests"
)]

use std::fs;
use std::path::Path;

use super::*;

fn png(path: &Path, width: u32, height: u32) {
    image::GrayImage::from_fn(width, height, |x, y| image::Luma([(7 * x + 13 * y) as u8]))
        .save(path)
        .unwrap();
}

/// A KITTI folder with those frames and that many lines of times at 10 Hz.
fn kitti(frames: impl IntoIterator<Item = usize>, times: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("image_0")).unwrap();
    for frame in frames {
        png(&frame_path(&folder, frame), 96, 64);
    }
    let lines: String = (0..times).map(|i| format!("{:.6e}\n", 0.1 * i as f64)).collect();
    fs::write(folder.path().join("times.txt"), lines).unwrap();
    folder
}

fn frame_path(folder: &tempfile::TempDir, frame: usize) -> PathBuf {
    folder.path().join(format!("image_0/{frame:06}.png"))
}

fn open(folder: &tempfile::TempDir) -> Result<ReplayCamera, BadInput> {
    ReplayCamera::open(folder.path(), 10.0, None)
}

fn stamps(camera: &mut ReplayCamera) -> Vec<(usize, u64)> {
    let mut seen = Vec::new();
    while let Some(Ok(frame)) = camera.next_frame() {
        seen.push((frame.index, frame.stamp.0));
    }
    seen
}

#[test]
fn frame_missing_in_mid_sequence_is_counted_and_shifts_no_other() {
    let folder = kitti([0, 1, 3, 4], 6);
    let mut camera = open(&folder).unwrap();
    assert_eq!(camera.missing(), [2]);
    let wanted = [(0, 0), (1, 100_000), (3, 300_000), (4, 400_000)];
    assert_eq!(stamps(&mut camera), wanted);
}

#[test]
fn numbered_images_without_times_keep_their_places() {
    let folder = tempfile::tempdir().unwrap();
    for number in [7959, 7961, 7965, 7967] {
        png(&folder.path().join(format!("0016E5_{number:05}.png")), 96, 64);
    }
    let mut camera = ReplayCamera::open(folder.path(), 10.0, None).unwrap();
    assert_eq!(camera.missing(), [2]);
    assert_eq!(stamps(&mut camera).last(), Some(&(4, 400_000)));
}

#[test]
fn names_that_are_no_numbers_are_taken_in_order() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["b", "a", "c7"] {
        png(&folder.path().join(format!("{name}.png")), 96, 64);
    }
    let mut camera = ReplayCamera::open(folder.path(), 10.0, None).unwrap();
    assert_eq!(
        camera.listing().map(|(_, name, _)| name).collect::<Vec<_>>(),
        ["a", "b", "c7"]
    );
    assert_eq!(stamps(&mut camera), [(0, 0), (1, 100_000), (2, 200_000)]);
}

#[test]
fn pixels_are_those_of_the_file_and_colour_stays_colour() {
    let gray = kitti([0], 1);
    let mut camera = open(&gray).unwrap();
    let frame = camera.next_frame().unwrap().unwrap();
    assert_eq!((frame.format, frame.bytes.len()), (PixelFormat::Grey, 96 * 64));
    assert_eq!(frame.bytes[5 * 96 + 3], 7 * 3 + 13 * 5);

    let folder = tempfile::tempdir().unwrap();
    image::RgbImage::from_pixel(80, 64, image::Rgb([10, 20, 30]))
        .save(folder.path().join("a.png"))
        .unwrap();
    let mut camera = ReplayCamera::open(folder.path(), 10.0, None).unwrap();
    let frame = camera.next_frame().unwrap().unwrap();
    assert_eq!(
        (frame.format, &frame.bytes[..4]),
        (PixelFormat::Rgb24, &[10, 20, 30, 10][..])
    );
}

#[test]
fn undecodable_file_in_mid_sequence_is_dropped_and_named() {
    let folder = kitti(0..3, 3);
    let path = frame_path(&folder, 1);
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 8].fill(0xA5);
    fs::write(&path, bytes).unwrap();
    let mut camera = open(&folder).unwrap();
    let mut warnings = Vec::new();
    let mut frames = 0;
    while let Some(next) = camera.next_frame() {
        match next {
            Ok(_) => frames += 1,
            Err(warning) => warnings.push(warning),
        }
    }
    assert_eq!((frames, camera.undecodable()), (2, 1));
    assert!(
        warnings.len() == 1 && warnings[0].contains("000001.png"),
        "{warnings:?}"
    );
}

fn times(folder: &tempfile::TempDir, text: &str) {
    fs::write(folder.path().join("times.txt"), text).unwrap();
}

fn truncate(path: &Path) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..bytes.len() * 2 / 3]).unwrap();
}

#[test]
fn bad_folders_are_refused_with_file_line_and_fix() {
    type Spoil = fn(&tempfile::TempDir);
    let cases: [(&str, Spoil, &str, &str); 9] = [
        (
            "truncated",
            |f| truncate(&frame_path(f, 1)),
            "000001.png: is truncated",
            "copy the file again",
        ),
        (
            "empty file",
            |f| fs::write(frame_path(f, 2), "").unwrap(),
            "000002.png: is no PNG or JPEG",
            "copy",
        ),
        (
            "size",
            |f| png(&frame_path(f, 1), 80, 64),
            "000001.png: is 80x64, but ",
            "one size",
        ),
        (
            "back",
            |f| times(f, "0\n0.2\n0.1\n0.3\n"),
            "times.txt:3: time goes backwards: 0.1 s after 0.2 s",
            "increase",
        ),
        (
            "word",
            |f| times(f, "0\nnoon\n"),
            "times.txt:2: `noon` is not a time",
            "one number a line",
        ),
        (
            "infinite",
            |f| times(f, "0\ninf\n"),
            "times.txt:2: time inf is out of range",
            "seconds",
        ),
        (
            "few times",
            |f| times(f, "0\n0.1\n"),
            "000002.png: has no time",
            "times.txt holds a line",
        ),
        (
            "no times",
            |f| times(f, "\n"),
            "times.txt: is empty",
            "write a time",
        ),
        (
            "no images",
            |f| (0..3).for_each(|i| fs::remove_file(frame_path(f, i)).unwrap()),
            "image_0: holds no PNG or JPEG image",
            "SOURCE is",
        ),
    ];
    for (name, spoil, message, fix) in cases {
        let folder = kitti(0..3, 3);
        spoil(&folder);
        let error = open(&folder).unwrap_err();
        assert!(error.message().contains(message), "{name}: {error}");
        assert!(error.fix().contains(fix), "{name}: {}", error.fix());
    }
    let error = ReplayCamera::open(Path::new("no/such/folder"), 10.0, None).unwrap_err();
    assert!(
        error.message().contains("no/such/folder: cannot be listed"),
        "{error}"
    );
}

#[test]
fn size_must_be_the_configured_one() {
    let size = ImageSize {
        width: 128,
        height: 64,
    };
    let error = ReplayCamera::open(kitti([0], 1).path(), 10.0, Some(size)).unwrap_err();
    assert!(
        error
            .message()
            .contains("is 96x64, but the config's [camera] has 128x64"),
        "{error}"
    );
}

fn key_frames(rule: &KeyFrameRule, camera: &ReplayCamera) -> Vec<usize> {
    let mut schedule = KeyFrameSchedule::new(rule, 0.5, 10.0, camera).unwrap();
    camera
        .listing()
        .filter(|(index, _, stamp)| schedule.is_key_frame(*index, *stamp))
        .map(|(index, _, _)| index)
        .collect()
}

#[test]
fn key_frames_keep_their_cadence_over_gaps_and_jitter() {
    let folder = kitti((0..22).filter(|i| *i != 5), 22);
    let jittered: String = (0..22)
        .map(|i| format!("{}\n", 0.1 * f64::from(i) + if i % 3 == 0 { 0.004 } else { 0.0 }))
        .collect();
    times(&folder, &jittered);
    let camera = open(&folder).unwrap();
    assert_eq!(key_frames(&KeyFrameRule::Interval, &camera), [0, 6, 10, 15, 20]);
    assert_eq!(
        key_frames(&KeyFrameRule::Every(4), &camera),
        [0, 4, 8, 12, 16, 20]
    );
}

#[test]
fn listed_frames_are_key_frames_besides_the_cadence() {
    let folder = kitti(0..12, 12);
    let camera = open(&folder).unwrap();
    let list = folder.path().join("list.txt");
    fs::write(&list, "# labelled\n000003\n000007.png\n\n").unwrap();
    let rule: KeyFrameRule = list.to_str().unwrap().parse().unwrap();
    assert_eq!(key_frames(&rule, &camera), [0, 3, 5, 7, 10]);
    fs::write(&list, "000003\n000033\n").unwrap();
    let error = KeyFrameSchedule::new(&rule, 0.5, 10.0, &camera).unwrap_err();
    assert!(
        error
            .message()
            .contains("list.txt:2: the sequence has no frame `000033`"),
        "{error}"
    );
    assert!("every=0".parse::<KeyFrameRule>().is_err());
}

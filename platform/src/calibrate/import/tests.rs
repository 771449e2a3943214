#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use freespace::frame::{BrownConrady, KannalaBrandt, Lens};

use super::*;

const OPENCV: &str = "%YAML:1.0
---
calibration_time: \"Tue 01 Oct 2024\"
image_width: 640
image_height: 480
flags: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.2000000000000000e+02, 0., 3.3000000000000000e+02, 0.,
       5.1500000000000000e+02, 2.3500000000000000e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.8e-01, 9.0e-02, 8.0e-04, -5.0e-04, -1.2e-02 ]
avg_reprojection_error: 2.1e-01
";

const ROS: &str = "image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [520.0, 0, 330.0, 0, 515.0, 235.0, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.09, 0.0008, -0.0005, -0.012]
";

const KALIBR: &str = "cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.02, 0.006, -0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [285.0, 286.0, 316.0, 243.0]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.09, 0.0008, -0.0005]
  distortion_model: radtan
  intrinsics: [520.0, 515.0, 330.0, 235.0]
  resolution: [640, 480]
";

fn brown_conrady(k3: f64) -> Lens {
    Lens::BrownConrady(BrownConrady {
        fx: 520.0,
        fy: 515.0,
        cx: 330.0,
        cy: 235.0,
        k: [-0.28, 0.09, k3],
        p: [0.0008, -0.0005],
    })
}

fn fisheye() -> Lens {
    Lens::KannalaBrandt(KannalaBrandt {
        fx: 285.0,
        fy: 286.0,
        cx: 316.0,
        cy: 243.0,
        k: [-0.02, 0.006, -0.003, 0.0004],
    })
}

fn import(text: &str, choice: &Choice) -> Result<Imported, BadInput> {
    parse(Path::new("lens.yaml"), text, choice)
}

#[test]
fn each_format_gives_its_lens_and_size() {
    let any = Choice::default();
    let second = Choice {
        camera: Some("cam1".to_owned()),
        ..Choice::default()
    };
    let wide = ROS
        .replace("plumb_bob", "equidistant")
        .replace(
            "[-0.28, 0.09, 0.0008, -0.0005, -0.012]",
            "[-0.02, 0.006, -0.003, 0.0004]",
        )
        .replace(
            "[520.0, 0, 330.0, 0, 515.0, 235.0, 0, 0, 1]",
            "[285.0, 0, 316.0, 0, 286.0, 243.0, 0, 0, 1]",
        );
    for (text, choice, lens, format) in [
        (OPENCV, &any, brown_conrady(-0.012), Format::OpenCv),
        (ROS, &any, brown_conrady(-0.012), Format::RosCameraInfo),
        (&wide, &any, fisheye(), Format::RosCameraInfo),
        (KALIBR, &any, fisheye(), Format::Kalibr),
        (KALIBR, &second, brown_conrady(0.0), Format::Kalibr),
    ] {
        let imported = import(text, choice).unwrap();
        assert_eq!((imported.lens, imported.format), (lens, format));
        assert_eq!(
            imported.size,
            Some(ImageSize {
                width: 640,
                height: 480
            })
        );
    }
}

#[test]
fn opencv_fisheye_is_told_by_its_flag_or_by_the_user() {
    let fisheye_text = OPENCV.replace("rows: 5", "rows: 4").replace(
        "-2.8e-01, 9.0e-02, 8.0e-04, -5.0e-04, -1.2e-02",
        "-0.02, 0.006, -0.003, 0.0004",
    );
    let told = Choice {
        model: Some(LensModel::KannalaBrandt),
        ..Choice::default()
    };
    let flagged = fisheye_text.replace("flags: 0", "fisheye_model: 1");
    for (text, choice) in [(&fisheye_text, told), (&flagged, Choice::default())] {
        let imported = import(text, &choice).unwrap();
        assert!(matches!(imported.lens, Lens::KannalaBrandt(l) if l.k == [-0.02, 0.006, -0.003, 0.0004]));
    }
}

#[test]
fn what_no_lens_expresses_is_refused_by_name_and_line() {
    let eight = |k4: &str| OPENCV.replace("-1.2e-02 ]", &format!("-1.2e-02, {k4}, 0., 0. ]"));
    assert_eq!(
        import(&eight("0."), &Choice::default()).unwrap().lens,
        brown_conrady(-0.012)
    );
    for (text, wanted) in [
        (eight("0.1"), "k4"),
        (
            KALIBR.replacen("pinhole", "omni", 1),
            "lens.yaml:2: the camera model `omni`",
        ),
        (
            KALIBR.replacen("equidistant", "fov", 1),
            "lens.yaml:4: the distortion model `fov`",
        ),
        (
            KALIBR.replacen("[285.0, 286.0,", "[285.0,", 1),
            "3 numbers, not 4",
        ),
        (
            ROS.replace("plumb_bob", "double_sphere"),
            "lens.yaml:8: the distortion model `double_sphere`",
        ),
        (ROS.replace("520.0", "5x0"), "lens.yaml:7: `5x0` is not a number"),
        (ROS.replace("520.0", "-520.0"), "are no lens"),
        (ROS.replace("camera_matrix", "matrix"), "no `camera_matrix`"),
        ("a: [1, 2".to_owned(), "is no YAML"),
        ("<?xml version=\"1.0\"?>".to_owned(), "is XML"),
        (String::new(), "is empty"),
    ] {
        let error = import(&text, &Choice::default()).unwrap_err();
        assert!(error.message().contains(wanted), "no `{wanted}` in {error}");
        assert!(!error.fix().is_empty());
    }
    let wrong = Choice {
        camera: Some("cam7".to_owned()),
        ..Choice::default()
    };
    assert!(
        import(KALIBR, &wrong)
            .unwrap_err()
            .message()
            .contains("cam0, cam1")
    );
}

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::cast_precision_loss,
    reason = "tests"
)]

use freespace::frame::{BrownConrady, KannalaBrandt, Lens};
use freespace::space::Pose;
use nalgebra::{Point3, Vector2, Vector3};

use super::folder::{Outcome, look};
use super::refine::calibrate;
use super::render::{Random, Scene, careful_poses, pose, render};
use super::report::judge;
use super::{Board, Picture, View};
use crate::config::{ImageSize, LensModel};

fn brown_conrady() -> Lens {
    Lens::BrownConrady(BrownConrady {
        fx: 520.0,
        fy: 515.0,
        cx: 330.0,
        cy: 235.0,
        k: [-0.28, 0.09, -0.012],
        p: [0.0008, -0.0005],
    })
}

fn kannala_brandt() -> Lens {
    Lens::KannalaBrandt(KannalaBrandt {
        fx: 285.0,
        fy: 286.0,
        cx: 316.0,
        cy: 243.0,
        k: [-0.02, 0.006, -0.003, 0.0004],
    })
}

fn scene(lens: Lens) -> Scene {
    Scene {
        lens,
        size: ImageSize {
            width: 640,
            height: 480,
        },
        board: Board { columns: 9, rows: 6 },
        square_m: 0.025,
        blur_px: 0.7,
        noise: 2.0,
    }
}

fn pictures(scene: &Scene, poses: &[Pose], random: &mut Random) -> Vec<Picture> {
    (poses.iter().enumerate())
        .map(|(i, pose)| {
            let image = render(scene, Some(pose), random);
            look(&format!("{i:02}.png"), &image, &scene.board)
        })
        .collect()
}

/// Largest distance, in pixels, between where two lenses see the same directions, over the image.
fn apart_px(found: &Lens, truth: &Lens, size: ImageSize) -> f64 {
    let mut worst: f64 = 0.0;
    for y in (0..size.height).step_by(40) {
        for x in (0..size.width).step_by(40) {
            let pixel = Vector2::new(x as f64, y as f64);
            let ray = truth.unproject(&pixel).unwrap();
            worst = worst.max((found.project(&ray).unwrap() - pixel).norm());
        }
    }
    worst
}

/// The distance of a corner found from the nearest true one.
fn corner_errors(scene: &Scene, pose: &Pose, view: &View) -> Vec<f64> {
    let mut truth = Vec::new();
    for column in 0..scene.board.columns {
        for row in 0..scene.board.rows {
            let point = pose * Point3::new(column as f64 * scene.square_m, row as f64 * scene.square_m, 0.0);
            truth.extend(scene.lens.project(&point.coords));
        }
    }
    (view.sightings.iter())
        .map(|s| {
            truth
                .iter()
                .map(|t| (t - s.pixel).norm())
                .fold(f64::INFINITY, f64::min)
        })
        .collect()
}

#[test]
fn corners_are_found_to_a_few_hundredths_of_a_pixel() {
    let mut random = Random(7);
    for (lens, blur_px, noise, bound_px) in [
        (brown_conrady(), 0.7, 2.0, 0.06),
        (brown_conrady(), 2.5, 4.0, 0.2),
        (kannala_brandt(), 0.7, 2.0, 0.06),
    ] {
        let scene = Scene {
            blur_px,
            noise,
            ..scene(lens)
        };
        let poses = careful_poses(&scene, 6, 0.18, &mut random);
        let mut complete = 0;
        let mut errors = Vec::new();
        for (picture, pose) in pictures(&scene, &poses, &mut random).iter().zip(&poses) {
            complete += usize::from(matches!(picture.outcome, Outcome::Complete(_)));
            errors.extend(corner_errors(&scene, pose, picture.view().unwrap()));
        }
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        println!("blur {blur_px}: {complete} of 6 complete, rms {rms:.4} px");
        assert!(complete >= 5, "{complete} of 6 complete");
        assert!(rms < bound_px, "{rms} px");
    }
}

#[test]
fn the_lens_comes_back_from_its_pictures() {
    for (lens, model, bound_px) in [
        (brown_conrady(), LensModel::BrownConrady, 0.6),
        (
            Lens::pinhole(700.0, 700.0, 319.5, 239.5),
            LensModel::BrownConrady,
            0.6,
        ),
        (kannala_brandt(), LensModel::KannalaBrandt, 1.2),
    ] {
        let mut random = Random(11);
        let scene = scene(lens);
        let poses = careful_poses(&scene, 18, 0.28, &mut random);
        let pictures = pictures(&scene, &poses, &mut random);
        let views: Vec<View> = pictures.iter().filter_map(|p| p.view().cloned()).collect();
        assert!(views.len() >= 15, "{}", views.len());
        let calibration = calibrate(&views, scene.square_m, scene.size, model).unwrap();
        let apart = apart_px(&calibration.lens, &lens, scene.size);
        println!(
            "{apart:.3} px apart, rms {:.3}: {:?}",
            calibration.rms_px, calibration.lens
        );
        assert!(calibration.rms_px < 0.12, "{}", calibration.rms_px);
        assert!(apart < bound_px, "{apart} px: {:?}", calibration.lens);
        let report = judge(&pictures, &views, &calibration, scene.size, model, &scene.board);
        assert_ne!(report.verdict(), "poor: do not use it", "{:?}", report.findings);
        // The truth lies within what the standard deviations say.
        let fx = calibration.parameters[0];
        let true_fx = if let Lens::BrownConrady(l) = lens {
            l.fx
        } else {
            285.0
        };
        assert!((fx.value - true_fx).abs() < 5.0 * fx.sigma + 0.2, "{fx:?}");
    }
}

#[test]
fn a_board_partly_outside_is_used_and_none_is_invented() {
    let mut random = Random(3);
    let scene = scene(brown_conrady());
    let outside = pose(
        &scene,
        Vector3::new(-0.21, 0.0, 0.35),
        Vector3::new(0.1, 0.2, 0.1),
    );
    let image = render(&scene, Some(&outside), &mut random);
    let picture = look("partly.png", &image, &scene.board);
    let Outcome::Partial(view) = &picture.outcome else {
        panic!("{picture:?}");
    };
    let worst = corner_errors(&scene, &outside, view)
        .into_iter()
        .fold(0.0, f64::max);
    assert!(worst < 0.5, "{worst} px");

    let blank = render(&scene, None, &mut random);
    assert_eq!(look("blank.png", &blank, &scene.board).outcome, Outcome::Nothing);
    let mut texture = blank.clone();
    for value in texture.pixels_mut() {
        *value = if random.unit() < 0.5 { 30 } else { 220 };
    }
    assert_eq!(
        look("noise.png", &texture, &scene.board).outcome,
        Outcome::Nothing
    );
}

#[test]
fn a_larger_board_than_said_is_told() {
    let mut random = Random(5);
    let larger = Scene {
        board: Board { columns: 10, rows: 7 },
        ..scene(brown_conrady())
    };
    let place = pose(&larger, Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.3, 0.1, 0.0));
    let image = render(&larger, Some(&place), &mut random);
    let picture = look("larger.png", &image, &Board { columns: 9, rows: 6 });
    assert_eq!(picture.outcome, Outcome::OtherBoard(10, 7));
}

#[test]
fn too_few_and_frontal_views_are_told_in_words() {
    let mut random = Random(9);
    let scene = scene(brown_conrady());
    let poses: Vec<Pose> = (0..5)
        .map(|i| {
            let at = Vector3::new(0.02 * f64::from(i) - 0.04, 0.01, 0.45 + 0.05 * f64::from(i));
            pose(&scene, at, Vector3::new(0.02, 0.03 * f64::from(i) - 0.06, 0.0))
        })
        .collect();
    let pictures = pictures(&scene, &poses, &mut random);
    let views: Vec<View> = pictures.iter().filter_map(|p| p.view().cloned()).collect();
    let Ok(calibration) = calibrate(&views, scene.square_m, scene.size, LensModel::BrownConrady) else {
        return;
    };
    let report = judge(
        &pictures,
        &views,
        &calibration,
        scene.size,
        LensModel::BrownConrady,
        &scene.board,
    );
    let told: String = report
        .findings
        .iter()
        .map(|f| format!("{} -> {}\n", f.what, f.fix))
        .collect();
    for wanted in [
        "too few views: 5",
        "not turned enough",
        "no board corner was seen",
    ] {
        assert!(told.contains(wanted), "no `{wanted}` in\n{told}");
    }
}

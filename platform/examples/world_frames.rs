//! Writes frames of the simulated road with their labels, each from another world and camera, to train a network.
//!
//! `cargo run --release -p freespace-platform --example world_frames -- --out DIR --count 1000 --first-seed 1000`

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use freespace::frame::{BrownConrady, Camera, Lens, RgbImage};
use freespace::space::Mount;
use freespace_platform::world::{Drive, Sensor, SimCamera, Textures, World, WorldConfig};
use image::{GrayImage, RgbImage as Picture};

/// Frames of the simulated road with labels: NNNNNN.png and NNNNNN_label.png.
#[derive(Parser)]
struct Arguments {
    /// Folder to write to.
    #[arg(long)]
    out: PathBuf,
    /// Number of frames.
    #[arg(long, default_value_t = 100)]
    count: u64,
    /// Seed of the first frame; each frame has the next one.
    #[arg(long, default_value_t = 1000)]
    first_seed: u64,
    /// Width in pixels.
    #[arg(long, default_value_t = 480)]
    width: u32,
    /// Height in pixels.
    #[arg(long, default_value_t = 360)]
    height: u32,
}

/// A small seeded sequence of shares in `[0, 1)`.
struct Shares(u64);

impl Shares {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        #[expect(clippy::cast_precision_loss, reason = "40 bits fit an f64")]
        let share = (self.0 >> 24) as f64 / (1_u64 << 40) as f64;
        low + (high - low) * share
    }
}

fn camera(shares: &mut Shares, width: u32, height: u32) -> Camera {
    let (w, h) = (f64::from(width), f64::from(height));
    let focal = 0.5 * w / (0.5 * shares.between(50.0, 90.0).to_radians()).tan();
    let k1 = shares.between(-0.12, 0.02);
    Camera {
        lens: Lens::BrownConrady(BrownConrady {
            fx: focal,
            fy: focal,
            cx: 0.5 * w - 0.5 + shares.between(-8.0, 8.0),
            cy: 0.5 * h - 0.5 + shares.between(-8.0, 8.0),
            k: [k1, 0.0, 0.0],
            p: [0.0; 2],
        }),
        width: width as usize,
        height: height as usize,
        mount: Mount {
            height_m: shares.between(1.2, 1.8),
            ahead_m: shares.between(0.5, 2.0),
            left_m: shares.between(-0.3, 0.3),
            pitch_rad: shares.between(-1.0, 4.0).to_radians(),
            yaw_rad: shares.between(-6.0, 6.0).to_radians(),
            roll_rad: shares.between(-1.0, 1.0).to_radians(),
        },
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "factors near one lose nothing that shows"
)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.out)?;
    let textures = Arc::new(Textures::new());
    let started = Instant::now();
    let mut drawing_s = 0.0;
    for i in 0..arguments.count {
        let seed = arguments.first_seed + i;
        let mut shares = Shares(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        shares.between(0.0, 1.0);
        let world = World::new(
            &WorldConfig {
                seed,
                length_m: 220.0,
                drive: Drive {
                    start_mps: 8.0,
                    ..Drive::default()
                },
                ..WorldConfig::default()
            },
            &textures,
        );
        let sensor = Sensor {
            seed: seed as u32,
            read_noise: shares.between(0.5, 3.0) as f32,
            shot_noise: shares.between(0.5, 4.0) as f32,
            shutter_s: shares.between(0.0, 0.006) as f32,
            vignette: shares.between(0.0, 0.5) as f32,
            soft: shares.between(0.0, 1.0) < 0.7,
            exposure: shares.between(0.65, 1.5) as f32,
            ..Sensor::default()
        };
        let camera = camera(&mut shares, arguments.width, arguments.height);
        let mut frame = RgbImage::new(camera.width, camera.height);
        let mut sim = SimCamera::new(&camera, &sensor);
        let before = Instant::now();
        sim.render(&world, shares.between(0.0, 20.0), &mut frame);
        drawing_s += before.elapsed().as_secs_f64();
        let size = (arguments.width, arguments.height);
        let picture = Picture::from_raw(size.0, size.1, frame.pixels().to_vec()).ok_or("frame size")?;
        let labels = GrayImage::from_raw(size.0, size.1, sim.labels().to_vec()).ok_or("label size")?;
        // The labels first: who waits for a picture then finds both.
        labels.save(arguments.out.join(format!("{seed:06}_label.png")))?;
        picture.save(arguments.out.join(format!("{seed:06}.png")))?;
        if (i + 1) % 50 == 0 {
            println!(
                "{} of {} in {:.1} s",
                i + 1,
                arguments.count,
                started.elapsed().as_secs_f64()
            );
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "a count of frames")]
    let mean_ms = 1e3 * drawing_s / arguments.count.max(1) as f64;
    println!("{mean_ms:.1} ms a frame to draw, the first of its world");
    Ok(())
}

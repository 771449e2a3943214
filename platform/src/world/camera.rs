//! The simulated camera: draws what the ego car sees, with the faults of a real sensor.
//!
//! In: a [`World`], a time. Out: an RGB or luma frame, and of the same rays the labels and depths. Order: parts into the
//! depth buffer, then every pixel is shaded once, then lens softness and noise. Motion blurs the road along the way it
//! runs past. All buffers are allocated by [`SimCamera::new`], but for one that only gray pictures need; a clone shares the rays.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    clippy::cast_possible_wrap,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use std::sync::Arc;

use freespace::frame::{Camera, GrayImage, RayTable, RgbImage};
use freespace::space::Pose;

use super::World;
use super::decal::{Decal, decals};
use super::lanes::{Colours, LANES, Lanes, lanes, put, ray};
use super::light::{lit, lit_foliage};
use super::meeting::{Eye, Met, Shutter};
use super::noise::{hash, wave};
use super::raster::{DepthBuffer, Extent, Frame, View, nearest_m};
use super::scene::{NEAR_M, Scene};
use super::shape::{Material, Part, Seen};
use super::style::Style;
use super::truth::Label;
use super::window::Window;

/// How far ahead of the camera the window is centred.
const WINDOW_AHEAD_M: f32 = 88.0;
const TONES: usize = 4096;

/// The sensor's faults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Seed of the noise.
    pub seed: u32,
    /// Read noise, standard deviation in grey levels.
    pub read_noise: f32,
    /// Shot noise at full scale, standard deviation in grey levels.
    pub shot_noise: f32,
    /// Time the shutter is open, which blurs the moving road.
    pub shutter_s: f32,
    /// Slow change of the exposure, as a share.
    pub exposure_drift: f32,
    /// A sudden change of the exposure: from this time on, by this factor.
    pub exposure_step: Option<(f64, f32)>,
    /// Share of light missing in the corners.
    pub vignette: f32,
    /// Whether the lens spreads each point over its neighbours, as real ones do.
    pub soft: bool,
    /// Factor on the exposure that suits the world.
    pub exposure: f32,
}

impl Default for Sensor {
    fn default() -> Self {
        Self {
            seed: 1,
            read_noise: 1.2,
            shot_noise: 2.2,
            shutter_s: 0.004,
            exposure_drift: 0.08,
            exposure_step: None,
            vignette: 0.25,
            soft: true,
            exposure: 1.0,
        }
    }
}

/// A camera on the ego car.
#[derive(Clone, Debug)]
pub struct SimCamera {
    camera: Camera,
    sensor: Sensor,
    frame: Frame,
    /// Unit rays in camera space of each span of pixels; turned to world space where they are needed, which costs less than to
    /// keep them. Spans run on from row to row; the last repeats the last pixel, and everything kept for pixels is as long as
    /// all spans.
    rays: Arc<[[Lanes; 3]]>,
    gain: Arc<[f32]>,
    buffer: DepthBuffer,
    hidden: Box<[[u8; 2]]>,
    labels: Box<[u8]>,
    depth_m: Box<[f32]>,
    window: Window,
    movers: Scene,
    order: Vec<(f32, u32)>,
    decals: Vec<Decal>,
    raw: RgbImage,
    /// Only a gray picture is developed here; empty until one is asked for.
    developed: RgbImage,
    tones: Box<[u8; TONES]>,
    noise: Box<[i16]>,
    column: Box<[i16]>,
    pose: Pose,
    world_seed: Option<u64>,
}

impl SimCamera {
    /// Prepares the ray of every pixel.
    #[must_use]
    pub fn new(camera: &Camera, sensor: &Sensor) -> Self {
        let (width, height) = (camera.width, camera.height);
        let table = RayTable::new(&camera.lens, width, height);
        let rays: Box<[[f32; 3]]> = table.rays().iter().map(|r| [r.x, r.y, r.z]).collect();
        let mut extent = Extent {
            low: [f32::MAX; 2],
            high: [f32::MIN; 2],
        };
        for ray in rays.iter().filter(|r| r[2] > 0.05) {
            for k in 0..2 {
                extent.low[k] = extent.low[k].min(ray[k] / ray[2]);
                extent.high[k] = extent.high[k].max(ray[k] / ray[2]);
            }
        }
        let pixels = width * height;
        let spans = pixels.div_ceil(LANES);
        let spanned = (0..spans)
            .map(|span| {
                let of = |k: usize| lanes(|i| rays[(span * LANES + i).min(pixels - 1)][k]);
                [of(0), of(1), of(2)]
            })
            .collect();
        let gain = (0..spans * LANES)
            .map(|i| {
                let x = (i % width) as f32 / width as f32 - 0.5;
                let y = (i / width) as f32 / height as f32 - 0.5;
                1.0 - sensor.vignette * 2.0 * (x * x + y * y)
            })
            .collect();
        let mut tones = Box::new([0; TONES]);
        for (i, tone) in tones.iter_mut().enumerate() {
            let linear = (i as f32 + 0.5) / TONES as f32;
            // Gamma with a soft shoulder, as cameras develop their frames.
            let shoulder = linear * (1.6 - 0.6 * linear);
            *tone = (255.0 * shoulder.min(1.0).powf(0.48) + 0.5) as u8;
        }
        Self {
            camera: *camera,
            sensor: *sensor,
            frame: Frame {
                lens: camera.lens,
                width,
                height,
                extent,
            },
            rays: spanned,
            gain,
            buffer: DepthBuffer::new(spans * LANES),
            hidden: vec![[0; 2]; spans * LANES].into_boxed_slice(),
            labels: vec![0; spans * LANES].into_boxed_slice(),
            depth_m: vec![0.0; spans * LANES].into_boxed_slice(),
            window: Window::new(),
            movers: Scene::default(),
            order: Vec::new(),
            decals: Vec::new(),
            raw: RgbImage::new(width, height),
            developed: RgbImage::new(0, 0),
            tones,
            noise: noise(sensor, 3 * width),
            column: vec![0; 3 * width].into_boxed_slice(),
            pose: Pose::identity(),
            world_seed: None,
        }
    }

    /// The camera this one simulates.
    #[must_use]
    pub const fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Labels of the last frame, `[height, width] u8`, see [`Label`].
    #[must_use]
    pub fn labels(&self) -> &[u8] {
        &self.labels[..self.camera.width * self.camera.height]
    }

    /// Depth of the last frame in metres along the optical axis, `[height, width] f32`, infinite for the sky.
    #[must_use]
    pub fn depth_m(&self) -> &[f32] {
        &self.depth_m[..self.camera.width * self.camera.height]
    }

    /// Pose of the last frame.
    #[must_use]
    pub const fn world_from_camera(&self) -> &Pose {
        &self.pose
    }

    /// Draws the world at a time into `out`, which has the camera's size.
    pub fn render(&mut self, world: &World, seconds: f64, out: &mut RgbImage) {
        self.see(world, seconds);
        self.develop(seconds, out);
    }

    /// Finds labels and depths at a time without developing a picture.
    pub fn see(&mut self, world: &World, seconds: f64) {
        self.place(world, seconds);
        self.draw_parts(world, seconds);
        self.shade(world, seconds);
    }

    /// Draws the world at a time as luma.
    pub fn render_gray(&mut self, world: &World, seconds: f64, out: &mut GrayImage) {
        let mut developed = std::mem::replace(&mut self.developed, RgbImage::new(0, 0));
        if developed.pixels().is_empty() {
            developed = RgbImage::new(self.camera.width, self.camera.height);
        }
        self.render(world, seconds, &mut developed);
        for (luma, p) in out
            .pixels_mut()
            .iter_mut()
            .zip(developed.pixels().chunks_exact(3))
        {
            *luma = ((77 * u32::from(p[0]) + 150 * u32::from(p[1]) + 29 * u32::from(p[2]) + 128) >> 8) as u8;
        }
        self.developed = developed;
    }

    /// Moves the camera and turns its rays.
    fn place(&mut self, world: &World, seconds: f64) {
        if self.world_seed != Some(world.config.seed) {
            self.window = Window::new();
            self.world_seed = Some(world.config.seed);
        }
        self.pose = world.world_from_camera(seconds, &self.camera.mount);
        let view = View::new(&self.pose);
        let ahead = view.axes[2];
        let flat = WINDOW_AHEAD_M / ahead[0].hypot(ahead[1]).max(0.2);
        self.window.centre(
            world,
            view.origin[0] + flat * ahead[0],
            view.origin[1] + flat * ahead[1],
        );
    }

    /// Fills the depth buffer and the dark patches under vehicles and people.
    fn draw_parts(&mut self, world: &World, seconds: f64) {
        let view = View::new(&self.pose);
        let ego_s = world.ego(seconds).road_m;
        world
            .traffic
            .fill(&mut self.movers, &world.road, &world.style, ego_s, seconds);
        self.buffer.clear();
        self.hidden.fill([0; 2]);
        self.order.clear();
        self.decals.clear();
        let s = ego_s as f32;
        let fixed = world.scene.parts.len();
        let reach = s - NEAR_M..=s + NEAR_M;
        let still = world
            .scene
            .between(*reach.start(), *reach.end())
            .iter()
            .map(|o| (o, &world.scene.parts, 0, false));
        let moving = self
            .movers
            .objects
            .iter()
            .map(|o| (o, &self.movers.parts, fixed, true));
        for (object, parts, offset, moves) in still.chain(moving) {
            let (dx, dy) = (
                object.centre[0] - view.origin[0],
                object.centre[1] - view.origin[1],
            );
            let ahead = dx * view.axes[2][0] + dy * view.axes[2][1];
            if ahead < -object.radius - 1.0 || dx.hypot(dy) - object.radius > NEAR_M {
                continue;
            }
            for i in object.first..object.first + object.count {
                self.order
                    .push((nearest_m(&parts[i], view.origin), (offset + i) as u32));
            }
            decals(
                &parts[object.first..object.first + object.count],
                moves,
                world.style.sun,
                &mut self.decals,
            );
        }
        self.order
            .sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for &(_, index) in &self.order {
            let part = part_at(world, &self.movers, index);
            self.buffer
                .draw(part, index + 1, &self.frame, &view, &self.rays, &world.textures);
        }
        for decal in &self.decals {
            let reach = decal.half.map(|h| h + decal.soft);
            let Some(bounds) = self.frame.bounds(&view, decal.base, decal.turn, reach, 0.01) else {
                continue;
            };
            for y in bounds.y[0]..bounds.y[1] {
                for i in y * self.camera.width + bounds.x[0]..y * self.camera.width + bounds.x[1] {
                    let ray = ray(&view.to_world(&self.rays[i / LANES]), i % LANES);
                    decal.darken(&view, ray, &mut self.hidden[i]);
                }
            }
        }
    }

    /// Gives every pixel its colour, label and depth.
    fn shade(&mut self, world: &World, seconds: f64) {
        let view = View::new(&self.pose);
        let style = &world.style;
        let shutter = Shutter {
            pixel_rad: 1.0 / self.camera.lens.focal_px() as f32,
            blur_m: world.ego(seconds).speed_mps as f32 * self.sensor.shutter_s,
        };
        let drift = 1.0 + self.sensor.exposure_drift * wave(self.sensor.seed ^ 77, seconds as f32 * 0.25);
        let step = match self.sensor.exposure_step {
            Some((from, factor)) if seconds >= from => factor,
            _ => 1.0,
        };
        let exposure = style.exposure * self.sensor.exposure * drift * step;
        let eye = Eye {
            world,
            window: &self.window,
            view: &view,
        };
        let mut tones = Tones {
            table: &self.tones,
            gain: &self.gain,
            scale: exposure * TONES as f32,
            pixels: self.raw.pixels_mut(),
        };
        let (mut last, mut part) = (0, None);
        let (hidden, _) = self.hidden.as_chunks::<LANES>();
        let (limits, _) = self.buffer.distance.as_chunks::<LANES>();
        let (parts, _) = self.buffer.part.as_chunks::<LANES>();
        let (labels_out, _) = self.labels.as_chunks_mut::<LANES>();
        let (depths_out, _) = self.depth_m.as_chunks_mut::<LANES>();
        for (span, rays) in self.rays.iter().enumerate() {
            let rays = &view.to_world(rays);
            let (limits, hidden, parts) = (&limits[span], &hidden[span], &parts[span]);
            let mut labels = [Label::Sky as u8; LANES];
            let mut distance = *limits;
            let mut rgb: Colours = [[0.0; LANES]; 3];
            let mut met = [Met::Nothing; LANES];
            if let Some(meetings) = eye.meet(rays, limits) {
                met = meetings.met;
                rgb = meetings.shade(world, rays, &shutter, hidden);
                for i in 0..LANES {
                    if met[i] != Met::Nothing {
                        distance[i] = meetings.distance[i];
                        let road = met[i] == Met::Road;
                        labels[i] = if road { Label::Road } else { Label::NonDrivable } as u8;
                    }
                }
            }
            let mut sky = [false; LANES];
            for i in 0..LANES {
                sky[i] = met[i] == Met::Nothing && parts[i] == 0;
            }
            for i in 0..LANES {
                if met[i] != Met::Nothing || sky[i] {
                    continue;
                }
                if parts[i] != last {
                    last = parts[i];
                    part = Some(Seen::new(part_at(world, &self.movers, last - 1), view.origin));
                }
                let Some(seen) = &part else { continue };
                let leafy = seen.part.material == Material::Foliage;
                if leafy && (0..LANES).all(|k| parts[k] == last) {
                    let hits = std::array::from_fn(|k| seen.met(ray(rays, k), limits[k]));
                    let leaves = lit_foliage(seen.part, &hits, style, &world.textures, shutter.pixel_rad);
                    for k in (0..LANES).filter(|&k| met[k] == Met::Nothing) {
                        put(&mut rgb, k, ray(&leaves, k));
                        labels[k] = seen.part.label;
                    }
                    break;
                }
                let hit = seen.met(ray(rays, i), limits[i]);
                let colour = lit(seen.part, &hit, style, &world.textures, shutter.pixel_rad);
                put(&mut rgb, i, colour);
                labels[i] = seen.part.label;
            }
            haze(&mut rgb, &distance, style);
            if sky.contains(&true) {
                let (colours, far) = world.sky.seen(rays, style, &world.textures);
                for i in 0..LANES {
                    if sky[i] {
                        put(&mut rgb, i, ray(&colours, i));
                        labels[i] = if far[i] { Label::Far } else { Label::Sky } as u8;
                        distance[i] = f32::INFINITY;
                    }
                }
            }
            tones.emit(span, &rgb);
            labels_out[span] = labels;
            depths_out[span] = lanes(|i| distance[i] * self.rays[span][2][i]);
        }
    }

    /// Lens softness and noise.
    fn develop(&mut self, seconds: f64, out: &mut RgbImage) {
        let (width, height) = (self.camera.width, self.camera.height);
        let stamp = hash(self.sensor.seed, (seconds * 1e4).round() as i64 as u32);
        let side = if self.sensor.soft { 1 } else { 0 };
        // Weights 1 6 1 both ways, or the pixel alone, in 64ths.
        let middle = 8 - 2 * side;
        let bytes = 3 * width;
        for y in 0..height {
            let above = self.raw.row(y.saturating_sub(1));
            let here = self.raw.row(y);
            let below = self.raw.row((y + 1).min(height - 1));
            let column = &mut self.column;
            let start = hash(stamp, y as u32) as usize % (self.noise.len() - bytes);
            let noise = &self.noise[start..start + bytes];
            for (sum, ((a, h), b)) in column.iter_mut().zip(above.iter().zip(here).zip(below)) {
                *sum = side * (i16::from(*a) + i16::from(*b)) + middle * i16::from(*h);
            }
            let target = out.row_mut(y);
            // All but the outermost columns, which have no neighbours on one side.
            let inner = bytes - 6;
            let (left, middles) = (&column[..inner], &column[3..3 + inner]);
            let (right, noisy) = (&column[6..6 + inner], &noise[3..3 + inner]);
            let inside = target[3..3 + inner].iter_mut();
            for ((to, (l, m)), (r, n)) in inside.zip(left.iter().zip(middles)).zip(right.iter().zip(noisy)) {
                let tone = side * (l + r) + middle * m + n + 32;
                *to = (tone >> 6).clamp(0, 255) as u8;
            }
            for i in (0..3).chain(bytes - 3..bytes) {
                target[i] = ((8 * column[i] + noise[i] + 32) >> 6).clamp(0, 255) as u8;
            }
        }
    }
}

/// Radiance to grey levels.
struct Tones<'a> {
    table: &'a [u8; TONES],
    gain: &'a [f32],
    scale: f32,
    pixels: &'a mut [u8],
}

impl Tones<'_> {
    #[inline]
    fn emit(&mut self, span: usize, rgb: &Colours) {
        let first = span * LANES;
        let gain = &self.gain[first..first + LANES];
        // Adding this rounds to a whole number in the low bits.
        const WHOLE: f32 = 8_388_608.0;
        let mut levels = [[0_u32; LANES]; 3];
        for (levels, channel) in levels.iter_mut().zip(rgb) {
            for i in 0..LANES {
                let tone = channel[i] * self.scale * gain[i] - 0.5;
                levels[i] = (tone.clamp(0.0, (TONES - 1) as f32) + WHOLE).to_bits();
            }
        }
        let end = (3 * (first + LANES)).min(self.pixels.len());
        for (i, pixel) in self.pixels[3 * first..end].chunks_exact_mut(3).enumerate() {
            for k in 0..3 {
                pixel[k] = self.table[levels[k][i] as usize & (TONES - 1)];
            }
        }
    }
}

/// Fades colours into the horizon's with distance.
#[inline]
fn haze(rgb: &mut Colours, distance: &Lanes, style: &Style) {
    let haze = lanes(|i| distance[i] / (distance[i] + 1.4 * style.haze_m));
    for (k, channel) in rgb.iter_mut().enumerate() {
        *channel = lanes(|i| channel[i] + haze[i] * (0.8 * style.horizon_rgb[k] - channel[i]));
    }
}

/// Nearly normal noise in 64ths of a grey level, read from a random place in each row.
fn noise(sensor: &Sensor, bytes: usize) -> Box<[i16]> {
    // Shot noise grows with the root of the light; after the gamma it is about level.
    let sigma = sensor.read_noise.hypot(0.7 * sensor.shot_noise);
    (0..bytes + 16_384)
        .map(|i| {
            let bits = hash(sensor.seed, i as u32);
            let sum = (bits & 255) + (bits >> 8 & 255) + (bits >> 16 & 255) + (bits >> 24);
            // Four bytes summed have the standard deviation 147.8.
            ((sum as f32 - 510.0) / 147.8 * sigma * 64.0) as i16
        })
        .collect()
}

fn part_at<'a>(world: &'a World, movers: &'a Scene, index: u32) -> &'a Part {
    let index = index as usize;
    let fixed = world.scene.parts.len();
    if index < fixed {
        &world.scene.parts[index]
    } else {
        &movers.parts[index - fixed]
    }
}

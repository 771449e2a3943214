//! The simulated road: a seeded world, the camera and the wheels of a car that drives through it, and the truth.
//!
//! In: a seed, a camera, a time. Out: frames ([`SimCamera`]), wheel readings ([`SimWheels`]), poses, depths, labels and
//! free-space grids from the same geometry. World space is the vehicle's at time 0; the road is the plane z = 0,
//! pavements stand over it. Invariant: the same seed and the same calls give the same bytes. Cost: memory grows with the
//! length of the road (about 5 kB a metre) and is allocated by [`World::new`]; a frame costs about the same everywhere.

mod build;
mod camera;
mod decal;
mod drive;
mod ground;
mod lanes;
mod light;
mod meeting;
mod noise;
mod raster;
mod road;
mod scene;
mod shadow;
mod shape;
mod style;
#[cfg(test)]
mod tests;
mod texture;
mod truth;
mod wheels;
mod window;

pub use camera::{Sensor, SimCamera};
pub use drive::Drive;
pub use style::Kind;
pub use texture::Textures;
pub use truth::{GridSpec, Label};
pub use wheels::{Encoders, SimWheels, Slip};

use std::sync::Arc;

use freespace::space::{Mount, Pose};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use noise::wave;

/// What makes a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldConfig {
    /// Names the world; everything is drawn from it.
    pub seed: u64,
    /// Kind of road; the seed picks one where none is given.
    pub kind: Option<Kind>,
    /// Length of the drive; the car stands still at its end.
    pub length_m: f64,
    /// How the ego car drives.
    pub drive: Drive,
    /// Distance between the wheels of an axle.
    pub track_m: f64,
    /// Distance between the axles.
    pub wheelbase_m: f64,
    /// Largest pitching of the body while driving.
    pub body_pitch_rad: f64,
}

impl Default for WorldConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            kind: None,
            length_m: 1500.0,
            drive: Drive::default(),
            track_m: 1.54,
            wheelbase_m: 2.7,
            body_pitch_rad: 0.003,
        }
    }
}

/// The ego car at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ego {
    /// Pose of the vehicle.
    pub world_from_vehicle: Pose,
    /// Path of the rear axle's centre since time 0.
    pub distance_m: f64,
    /// Path of each wheel since time 0: front left, front right, rear left, rear right.
    pub wheel_m: [f64; 4],
    /// Speed of the rear axle's centre.
    pub speed_mps: f64,
    /// Place along the road's centre line.
    pub road_m: f64,
}

/// One seeded road with all that stands and moves on it.
#[derive(Clone, Debug)]
pub struct World {
    config: WorldConfig,
    style: style::Style,
    road: road::Road,
    path: drive::Path,
    scene: scene::Scene,
    traffic: scene::Traffic,
    ground: ground::Ground,
    shadow: shadow::Shadow,
    sky: light::Sky,
    textures: Arc<Textures>,
}

impl World {
    /// Builds the whole world.
    #[must_use]
    pub fn new(config: &WorldConfig, textures: &Arc<Textures>) -> Self {
        let WorldConfig { seed, length_m, .. } = *config;
        let length_m = length_m.max(1.0);
        let style = style::Style::new(seed, config.kind);
        let road = road::Road::new(seed, length_m, &style);
        let path = drive::Path::new(
            &road,
            f64::from(style.ego_d),
            length_m,
            config.track_m,
            config.wheelbase_m,
        );
        let scene = scene::Scene::new(seed, &road, &style, length_m);
        let sunny = style.sun_rgb[1] > 0.0;
        let nothing = scene::Scene::default();
        let casting = if sunny { &scene } else { &nothing };
        Self {
            config: *config,
            traffic: scene::Traffic::new(seed, &road, &style, length_m),
            ground: ground::Ground::new(seed, &style, length_m),
            shadow: shadow::Shadow::new(casting, &road, style.sun, length_m, textures),
            sky: light::Sky::new(noise::hash(7, noise::Seeded::new(seed, 6).word()), &style),
            textures: Arc::clone(textures),
            style,
            road,
            path,
            scene,
        }
    }

    /// What the world was made from.
    #[must_use]
    pub const fn config(&self) -> &WorldConfig {
        &self.config
    }

    /// The ego car at a time.
    #[must_use]
    pub fn ego(&self, seconds: f64) -> Ego {
        let (wanted, speed) = self.config.drive.at(seconds);
        let end = self.path.length_m();
        let distance_m = wanted.min(end);
        let (road_m, wheel_m) = self.path.at(distance_m);
        Ego {
            world_from_vehicle: self.path.world_from_vehicle(&self.road, road_m),
            distance_m,
            wheel_m,
            speed_mps: if wanted < end { speed } else { 0.0 },
            road_m,
        }
    }

    /// Pose of a camera on the ego car at a time; the body pitches a little while it rolls.
    #[must_use]
    pub fn world_from_camera(&self, seconds: f64, mount: &Mount) -> Pose {
        let ego = self.ego(seconds);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "noise is drawn in single precision"
        )]
        let nod = |metres: f64| 0.7 * wave(91, metres as f32 / 6.0) + 0.3 * wave(92, metres as f32 / 1.7);
        let pitch = self.config.body_pitch_rad * f64::from(nod(ego.distance_m) - nod(0.0));
        let body = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch);
        ego.world_from_vehicle
            * Pose::from_parts(Translation3::identity(), body)
            * mount.vehicle_from_camera()
    }
}

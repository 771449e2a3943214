//! The last stage, *emit*: what is published for a key frame, as bytes and CAN frames.

use super::KeyFrameOutput;
use crate::deadline::Slices;
use crate::emit::{CanEncoder, Header, Publication};
use crate::frame::Camera;
use crate::port::Clock;
use crate::space::Micros;
use crate::stage::Stage;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

/// Turns outputs, fallbacks among them, into messages; keeps the counters of their protection.
#[derive(Clone, Debug)]
pub struct EmitTask {
    camera: Camera,
    deadline_micros: u64,
    can: CanEncoder,
    last: Option<(Micros, f64)>,
}

impl EmitTask {
    /// An encoder for the camera's vehicle and the deadline.
    #[must_use]
    pub fn new(camera: &Camera, slices: &Slices) -> Self {
        Self {
            camera: *camera,
            deadline_micros: slices.deadline_micros,
            can: CanEncoder::default(),
            last: None,
        }
    }

    /// Fills `output.message` and `output.can_frames`, to leave at `publish`.
    pub fn step(&mut self, output: &mut KeyFrameOutput, publish: Micros, clock: &impl Clock) {
        let begin = clock.now();
        let header = self.header(output, publish);
        let publication = Publication {
            header,
            grid: &output.grid,
        };
        // Cannot fail: the message was sized for this grid.
        output.message_len = publication.encode_into(&mut output.message).unwrap_or(0);
        output.can_frames = self.can.encode(&header);
        output.times.add(Stage::Emit, clock.now().since(begin));
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "metres, radians and microseconds of one deadline"
    )]
    fn header(&mut self, output: &KeyFrameOutput, publish: Micros) -> Header {
        let vehicle = self.camera.world_from_vehicle(&output.world_from_camera);
        let rotation = vehicle.rotation.coords;
        let plane = output.priors.plane;
        Header {
            sequence: output.publication,
            capture: output.stamp,
            publish,
            deadline: output.stamp.plus(self.deadline_micros),
            budget_micros: self.deadline_micros.min(u64::from(u32::MAX)) as u32,
            used_micros: publish.since(output.stamp).min(u64::from(u32::MAX)) as u32,
            level: output.level,
            faults: output.faults,
            blame: output.blame,
            scale: output.scale,
            tracking: output.tracking,
            position_m: vehicle.translation.vector.into(),
            orientation: rotation.into(),
            speed_mps: output.speed_mps as f32,
            yaw_rate_radps: self.yaw_rate(output.stamp, vehicle.rotation.euler_angles().2) as f32,
            plane_normal: output.plane_in_camera.normal.cast::<f32>().into(),
            plane_offset_m: output.plane_in_camera.offset_m as f32,
            plane_inliers: plane.map_or(0, |plane| plane.inliers),
            plane_sigma_m: plane.map_or(0.0, |plane| plane.sigma_m),
            sector_first_rad: output.boundary.first_rad,
            sector_rad: output.boundary.sector_rad,
            free_m: output.boundary.free_m,
        }
    }

    /// Mean yaw rate since the last publication.
    fn yaw_rate(&mut self, stamp: Micros, yaw_rad: f64) -> f64 {
        let Some((last_stamp, last_yaw_rad)) = self.last.replace((stamp, yaw_rad)) else {
            return 0.0;
        };
        let seconds = stamp.seconds_since(last_stamp);
        if seconds <= 0.0 {
            return 0.0;
        }
        let turned = yaw_rad - last_yaw_rad;
        let whole_turns = core::f64::consts::TAU * (turned / core::f64::consts::TAU).round();
        (turned - whole_turns) / seconds
    }
}

//! Stage 4, priors: landmarks in; road plane, obstacle boxes and, by ray casting, `I(p)` out.

pub mod belief;
pub mod boxes;
mod ground;
pub mod plane;
mod ray_cast;
mod stage;

pub use belief::BeliefConfig;
pub use boxes::{BoxBuilder, BoxConfig};
pub use ground::{Ground, vehicle_forward};
pub use plane::{PlaneConfig, ScaleEstimate, SupportPoint};
pub use ray_cast::{RayCaster, Surface};
pub use stage::{PriorsConfig, PriorsStage};

use nalgebra::{Matrix3, Point3, Vector3};

use crate::budget::MAX_BOXES;
use crate::space::{Micros, Plane, Pose};

/// A box around a cluster of landmarks above the road.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObstacleBox {
    /// Centre.
    pub centre: Point3<f64>,
    /// Orthonormal axes as columns: two along the plane, the last along its normal.
    pub axes: Matrix3<f64>,
    /// Half of the edge lengths along the axes.
    pub half_m: Vector3<f64>,
}

impl ObstacleBox {
    /// The same box in space `a`, this one being in space `b`.
    #[must_use]
    pub fn moved(&self, a_from_b: &Pose) -> Self {
        Self {
            centre: a_from_b * self.centre,
            axes: a_from_b.rotation.to_rotation_matrix() * self.axes,
            half_m: self.half_m,
        }
    }
}

/// The road plane and the boxes of one key frame, all in world space.
#[derive(Clone, Debug, Default)]
pub struct Priors {
    /// Capture stamp of the key frame.
    pub stamp: Micros,
    /// Road plane and how well it is known; none before the first one was found.
    pub plane: Option<PlaneEstimate>,
    /// Obstacle boxes.
    pub boxes: heapless::Vec<ObstacleBox, MAX_BOXES>,
}

/// A road plane with its support.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneEstimate {
    /// The plane; its normal points up.
    pub plane: Plane,
    /// Landmarks that support it; zero where it was held from the mount or an earlier key frame.
    pub inliers: u32,
    /// Robust standard deviation of the inliers' heights.
    pub sigma_m: f32,
}

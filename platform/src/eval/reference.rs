//! The truth that lies beside a replayed folder, or is named for it, and a run's comparison with it.

use std::path::{Path, PathBuf};

use freespace::space::Pose;

use super::masks::{self, TruthKind};
use super::{Truth, trajectory};
use crate::bad_input::BadInput;
use crate::config::ImageSize;

/// A run compared with the truth.
#[derive(Clone, Debug, Default)]
pub struct Judged {
    /// All of it together; none where there is no truth.
    pub truth: Option<Truth>,
    /// Intersection over union of road of each labelled frame that has a mask, by name.
    pub road_iou: Vec<(String, f64)>,
}

/// Truth of a replay, checked before the run.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    poses: Option<Vec<Pose>>,
    masks: Option<(PathBuf, TruthKind)>,
}

impl Reference {
    /// The named files, or else `poses.txt` and `labels/` of `source`, where they exist; the latter are KITTI's. `size` is that
    /// of the frames.
    ///
    /// # Errors
    /// Where one is named but missing, or is malformed.
    pub fn open(
        source: &Path,
        poses: Option<&Path>,
        masks: Option<&Path>,
        kind: TruthKind,
        size: ImageSize,
    ) -> Result<Self, BadInput> {
        let beside = |name: &str| Some(source.join(name)).filter(|path| path.exists());
        let poses = poses.map(Path::to_owned).or_else(|| beside("poses.txt"));
        let masks = masks.map(|dir| (dir.to_owned(), kind));
        let masks = masks.or_else(|| beside("labels").map(|dir| (dir, TruthKind::Kitti)));
        if let Some((folder, kind)) = &masks {
            masks::check_truth(folder, *kind, size.width, size.height)?;
        }
        let poses = poses.map(|path| trajectory::read(&path)).transpose()?;
        Ok(Self {
            poses: poses.map(|file| file.poses),
            masks,
        })
    }

    /// True poses by index in the sequence; none where they are not known.
    #[must_use]
    pub fn poses(&self) -> &[Pose] {
        self.poses.as_deref().unwrap_or_default()
    }

    /// Compares a run: its poses by index in the sequence, and the folder of its masks.
    ///
    /// # Errors
    /// Where a truth mask is malformed or has another size than the frames.
    pub fn compare(
        &self,
        estimate: impl IntoIterator<Item = (usize, Pose)>,
        mask_folder: &Path,
    ) -> Result<Judged, BadInput> {
        let mut road_iou = Vec::new();
        let mut truth = Truth::default();
        if let Some(poses) = &self.poses {
            let (run, wanted): (Vec<Pose>, Vec<Pose>) = estimate
                .into_iter()
                .filter_map(|(index, pose)| Some((pose, *poses.get(index)?)))
                .unzip();
            if let Some(score) = trajectory::compare(&run, &wanted) {
                truth = truth.with_trajectory(&score);
            }
        }
        if let Some((folder, kind)) = &self.masks {
            let score = masks::compare_common(mask_folder, folder, *kind)?;
            if !score.frames.is_empty() {
                truth = truth.with_road(&score.pooled, score.frames.len());
            }
            let frames = score.frames.into_iter();
            road_iou = frames.map(|(name, count)| (name, count.iou())).collect();
        }
        Ok(Judged {
            truth: (truth != Truth::default()).then_some(truth),
            road_iou,
        })
    }
}

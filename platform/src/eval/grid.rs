//! Free-space grids against truth: intersection over union of the free cells.
//!
//! In: `[rows, columns] int8` grids in the convention of nav_msgs/OccupancyGrid, -1 unknown, 0 free to 100 occupied, row 0
//! nearest the car; `NAME.json` beside `NAME.npy` says where the rows lie. Only cells that the truth has seen count; a cell
//! that is unknown in the prediction is not free.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::masks::{any_files_by_stem, files_by_stem};
use super::npy;
use crate::bad_input::{BadInput, read_text};

/// A known cell below this is free: the grid stage calls no other free.
pub const FREE_BELOW: i8 = freespace::grid::Grid::FREE_AT_MOST + 1;

/// Default range of the comparison, metres ahead of the vehicle origin.
pub const RANGE_M: Range<f64> = 0.0..30.0;

/// Where the cells of a grid lie; unknown keys of the JSON header are left alone.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq)]
pub struct GridLayout {
    /// Rows, ahead.
    pub rows: usize,
    /// Columns, to the left.
    pub columns: usize,
    /// Edge of a cell.
    pub cell_m: f64,
    /// Corner nearest the car and to its right: metres ahead and left of the vehicle origin.
    pub origin_in_vehicle_m: [f64; 2],
}

impl GridLayout {
    /// Distance of the centre of a row ahead of the vehicle origin.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "rows of a grid")]
    pub fn row_ahead_m(&self, row: usize) -> f64 {
        self.origin_in_vehicle_m[0] + (row as f64 + 0.5) * self.cell_m
    }
}

/// Counted cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellCount {
    /// Free in both.
    pub both: u64,
    /// Free in one of them at least.
    pub either: u64,
    /// Called free, but occupied in truth: what a user must fear.
    pub falsely_free: u64,
    /// Cells that the truth has seen.
    pub seen: u64,
}

impl CellCount {
    /// Counts the cells of one key frame between `range_m` ahead; both grids have the layout.
    pub fn add(&mut self, layout: &GridLayout, predicted: &[i8], truth: &[i8], range_m: &Range<f64>) {
        let free = |value: i8| (0..FREE_BELOW).contains(&value);
        for row in (0..layout.rows).filter(|&row| range_m.contains(&layout.row_ahead_m(row))) {
            let cells = row * layout.columns..(row + 1) * layout.columns;
            for (&called, &value) in predicted[cells.clone()].iter().zip(&truth[cells]) {
                if value < 0 {
                    continue;
                }
                self.seen += 1;
                self.both += u64::from(free(called) && free(value));
                self.either += u64::from(free(called) || free(value));
                self.falsely_free += u64::from(free(called) && !free(value));
            }
        }
    }

    /// Adds another count.
    pub const fn merge(&mut self, other: &Self) {
        self.both += other.both;
        self.either += other.either;
        self.falsely_free += other.falsely_free;
        self.seen += other.seen;
    }

    /// Intersection over union; zero where nothing was free.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "cell counts")]
    pub fn iou(&self) -> f64 {
        if self.either == 0 {
            return 0.0;
        }
        self.both as f64 / self.either as f64
    }
}

/// The comparison of two folders.
#[derive(Clone, Debug, Default)]
pub struct GridScore {
    /// All key frames together.
    pub pooled: CellCount,
    /// Each key frame, by name.
    pub frames: Vec<(String, CellCount)>,
    /// Truth grids without a prediction.
    pub missing: Vec<String>,
}

/// Compares the grids of `predictions` with those of the same stem in `truth`, of which there may be none.
///
/// # Errors
/// A folder that cannot be listed, a truth without grids, a malformed file, or layouts that differ.
pub fn compare_common(predictions: &Path, truth: &Path, range_m: &Range<f64>) -> Result<GridScore, BadInput> {
    let predicted = any_files_by_stem(predictions, "npy")?;
    let mut score = GridScore::default();
    for (name, truth_path) in &files_by_stem(truth, "npy")? {
        let Some(path) = predicted.get(name) else {
            score.missing.push(name.clone());
            continue;
        };
        let (layout, values) = read(path)?;
        let (truth_layout, truth_values) = read(truth_path)?;
        if layout != truth_layout {
            return Err(BadInput::of_file(
                path,
                format!(
                    "its layout {layout:?} is not that of {}: {truth_layout:?}",
                    truth_path.display()
                ),
                "compare grids of the same rows, columns, cell size and origin",
            ));
        }
        let mut count = CellCount::default();
        count.add(&layout, &values, &truth_values, range_m);
        score.pooled.merge(&count);
        score.frames.push((name.clone(), count));
    }
    Ok(score)
}

/// The same, where at least one name must be common.
///
/// # Errors
/// As [`compare_common`], and no common name.
pub fn compare_folders(
    predictions: &Path,
    truth: &Path,
    range_m: &Range<f64>,
) -> Result<GridScore, BadInput> {
    let score = compare_common(predictions, truth, range_m)?;
    if score.frames.is_empty() {
        return Err(BadInput::of_file(
            predictions,
            format!(
                "none of the {} grids in {} has its counterpart here",
                score.missing.len(),
                truth.display()
            ),
            "grids are matched by file name",
        ));
    }
    Ok(score)
}

pub(super) fn read(path: &Path) -> Result<(GridLayout, Vec<i8>), BadInput> {
    let (rows, columns, values) = npy::read_i8(path)?;
    let header = path.with_extension("json");
    let text = read_text(
        &header,
        "each grid NAME.npy has its layout in NAME.json beside it",
    )?;
    let layout: GridLayout = serde_json::from_str(&text).map_err(|error| {
        BadInput::at_line(
            &header,
            &text,
            error.line().saturating_sub(1),
            error,
            "the header has rows, columns, cell_m and origin_in_vehicle_m [ahead, left]",
        )
    })?;
    if (layout.rows, layout.columns) != (rows, columns) {
        return Err(BadInput::of_file(
            &header,
            format!(
                "says {}x{} cells, but {} has {rows}x{columns}",
                layout.rows,
                layout.columns,
                path.display()
            ),
            "write both files of a grid together",
        ));
    }
    Ok((layout, values))
}

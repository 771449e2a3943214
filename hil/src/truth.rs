//! The grids that came over the bus against the world that was driven through.

use std::fmt::Write as _;

use freespace::budget::MAX_CELLS;
use freespace::emit::CanFrame;
use freespace::emit::grid_frames::{GridReader, GridStep, ReceivedGrid};
use freespace::health::QualityLevel;
use freespace_platform::eval::grid::{CellCount, GridLayout, RANGE_M};
use freespace_platform::world::GridSpec;

use crate::case::Seen;
use crate::feed::Feed;
use crate::listener::Frame;
use crate::road::Road;

/// Free space of good grids, pooled over a drive: what an undisturbed drive reaches, less what a few seconds cost.
const IOU: f64 = 0.75;
/// Cells called free that are not, of all that a good grid calls free: more is a wrong answer that does not say so. The worst
/// grid of an undisturbed drive has 0.13, far away.
const FALSELY_FREE: f64 = 0.20;

/// Compares every grid of the drive that claims to be good; each is a line of the table that comes back.
pub(crate) fn judge(frames: &[Frame], road: &Road, feed: &Feed, seen: &mut Seen) -> String {
    let mut table = "grid,drive_s,level,iou,falsely_free\n".to_owned();
    let mut reader = GridReader::new(MAX_CELLS);
    let (mut grids, mut refused) = (0, 0);
    let mut good = CellCount::default();
    let mut worst = 0.0_f64;
    for frame in frames {
        match reader.take(&can_frame(frame)) {
            Ok(GridStep::Complete) => {}
            Ok(GridStep::Ignored | GridStep::Taken) => continue,
            Err(_) => {
                refused += 1;
                continue;
            }
        }
        let Some(grid) = reader.grid() else { continue };
        grids += 1;
        let drive_s = feed.seconds_at(grid.capture.0);
        let is_lap_new = road.is_lap_new(drive_s);
        if grid.level <= QualityLevel::NoRefinement && !is_lap_new {
            let count = compare(&grid, road, feed);
            let share = falsely_free(&count);
            worst = worst.max(share);
            let (level, iou) = (grid.level.name(), count.iou());
            // A string takes all that is written to it.
            let _ = writeln!(
                table,
                "{},{drive_s:.2},{level},{iou:.3},{share:.3}",
                grid.sequence
            );
            seen.require(
                share <= FALSELY_FREE,
                format!(
                    "grid {}: {:.0} % of what it calls free is not",
                    grid.sequence,
                    100.0 * share
                ),
            );
            good.both += count.both;
            good.either += count.either;
        }
    }
    seen.note(format!(
        "{grids} grids over the bus, free space IoU {:.3}, {:.0} % falsely free at worst",
        good.iou(),
        100.0 * worst
    ));
    seen.require(grids > 0, "no grid came over the bus");
    seen.require(
        good.iou() >= IOU,
        format!("free space IoU is {:.3} only", good.iou()),
    );
    if refused > 0 {
        seen.note(format!("{refused} grids incomplete"));
    }
    table
}

#[expect(clippy::cast_precision_loss, reason = "counts of cells")]
fn falsely_free(count: &CellCount) -> f64 {
    count.falsely_free as f64 / (count.both + count.falsely_free).max(1) as f64
}

fn compare(grid: &ReceivedGrid<'_>, road: &Road, feed: &Feed) -> CellCount {
    let cell_m = f64::from(grid.cell_mm) * 1e-3;
    #[expect(clippy::cast_precision_loss, reason = "sizes of a grid")]
    let (rows, columns) = (grid.rows as f64, grid.columns as f64);
    let spec = GridSpec {
        cell_m,
        ahead_m: rows * cell_m,
        side_m: 0.5 * columns * cell_m,
    };
    let layout = GridLayout {
        rows: grid.rows,
        columns: grid.columns,
        cell_m,
        origin_in_vehicle_m: [0.0, -spec.side_m],
    };
    let seconds = road.world_seconds(feed.seconds_at(grid.capture.0));
    let truth = road.world.free_space_truth(&road.camera, seconds, &spec);
    let mut count = CellCount::default();
    if truth.len() == grid.occupancy.len() {
        count.add(&layout, grid.occupancy, &truth, &RANGE_M);
    }
    count
}

fn can_frame(frame: &Frame) -> CanFrame {
    CanFrame {
        id: frame.id,
        extended: false,
        // A frame on the bus has 64 bytes at most.
        data: frame.data.iter().copied().take(64).collect(),
    }
}

//! The grid from above, two pixels a character: ahead up, left to the left, the boundary in yellow.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the window"
)]

use std::ops::Range;

use freespace::grid::Grid;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;

use crate::monitor::state::{Last, Layer};

const FREE: Color = Color::Rgb(66, 178, 104);
const OCCUPIED: Color = Color::Rgb(200, 60, 60);
const UNKNOWN: Color = Color::Rgb(60, 64, 72);
const BOUNDARY: Color = Color::Rgb(250, 250, 120);
/// Unseen, plane, box, network, previous.
const REASONS: [Color; 5] = [
    UNKNOWN,
    FREE,
    OCCUPIED,
    Color::Rgb(230, 150, 50),
    Color::Rgb(90, 140, 220),
];

pub(super) const fn title(layer: Layer) -> &'static str {
    match layer {
        Layer::Occupancy => "Grid: free green, occupied red, unknown gray",
        Layer::Reason => "Reason: plane green, box red, network orange, previous blue",
        Layer::Age => "Age: fresh bright, 5 s dark",
    }
}

/// Draws into `area`, as large as fits.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, last: &Last, layer: Layer) {
    let (rows, columns) = (last.header.rows, last.header.columns);
    let (width, height) = (usize::from(area.width), 2 * usize::from(area.height));
    if width == 0 || height == 0 || rows * columns == 0 || last.occupancy.len() < rows * columns {
        return;
    }
    let pixels = Pixels::fitting((rows, columns), (height, width));
    let (wide, high) = (pixels.wide, pixels.high);
    let left = area.x + ((width - wide) / 2) as u16;
    let boundary = boundary(last, &pixels);
    for line in 0..high.div_ceil(2) {
        for x in 0..wide {
            let pixel = |y: usize| {
                if boundary.contains(&(x, y)) {
                    return BOUNDARY;
                }
                let (Some(row), column) = (high.checked_sub(y + 1), wide - 1 - x) else {
                    return Color::Reset;
                };
                block(
                    last,
                    layer,
                    pixels.cells(row, rows),
                    pixels.cells(column, columns),
                )
            };
            let cell = &mut buffer[(left + x as u16, area.y + line as u16)];
            cell.set_char('▀')
                .set_fg(pixel(2 * line))
                .set_bg(pixel(2 * line + 1));
        }
    }
}

/// How cells come to pixels.
struct Pixels {
    /// Cells a pixel, along each axis; at least one.
    step: f32,
    wide: usize,
    high: usize,
}

impl Pixels {
    /// The largest picture of `(rows, columns)` cells that fits `(height, width)` pixels.
    fn fitting((rows, columns): (usize, usize), (height, width): (usize, usize)) -> Self {
        let (along, across) = (rows as f32 / height as f32, columns as f32 / width as f32);
        let step = along.max(across).max(1.0);
        let pixels = |cells: usize, room: usize| ((cells as f32 / step) as usize).clamp(1, room);
        Self {
            step,
            wide: pixels(columns, width),
            high: pixels(rows, height),
        }
    }

    /// Cells of a pixel along an axis that has `cells` of them.
    fn cells(&self, pixel: usize, cells: usize) -> Range<usize> {
        let end = ((pixel + 1) as f32 * self.step).ceil() as usize;
        (pixel as f32 * self.step) as usize..end.min(cells)
    }
}

/// Pixels, from the top left, where free space ends.
fn boundary(last: &Last, pixels: &Pixels) -> Vec<(usize, usize)> {
    let header = &last.header;
    let (wide, high) = (pixels.wide, pixels.high);
    let edge_m = header.cell_m * pixels.step;
    let sectors = header.free_m.iter().enumerate();
    sectors
        .filter(|(_, free_m)| **free_m > 0.0)
        .filter_map(|(sector, free_m)| {
            let bearing = header.sector_first_rad + (sector as f32 + 0.5) * header.sector_rad;
            let ahead = ((free_m * bearing.cos() - header.origin_m[0]) / edge_m).floor();
            let left = ((free_m * bearing.sin() - header.origin_m[1]) / edge_m).floor();
            let is_inside = ahead >= 0.0 && left >= 0.0 && left < wide as f32;
            is_inside.then(|| {
                (
                    wide - 1 - left as usize,
                    high - 1 - (ahead as usize).min(high - 1),
                )
            })
        })
        .collect()
}

/// Colour of the cells of one pixel: of the worst of them, and free only where half of them are.
fn block(last: &Last, layer: Layer, rows: Range<usize>, columns: Range<usize>) -> Color {
    let width = last.header.columns;
    let cells = rows.flat_map(|row| row * width + columns.start..row * width + columns.end);
    let (mut cells_seen, mut free, mut occupied, mut worst, mut youngest) = (0, 0, 0, 0, u8::MAX);
    for cell in cells {
        cells_seen += 1;
        match last.occupancy[cell] {
            0..=Grid::FREE_AT_MOST => free += 1,
            ..0 => {}
            _ => occupied += 1,
        }
        worst = worst.max(last.reason[cell]);
        youngest = youngest.min(last.age[cell]);
    }
    match layer {
        Layer::Occupancy if occupied > 0 => OCCUPIED,
        Layer::Occupancy if 2 * free >= cells_seen => FREE,
        Layer::Occupancy => UNKNOWN,
        Layer::Reason => REASONS.get(usize::from(worst)).copied().unwrap_or(Color::Magenta),
        Layer::Age => {
            let light = 230 - 4 * youngest.min(50);
            Color::Rgb(light / 3, light / 2, light)
        }
    }
}

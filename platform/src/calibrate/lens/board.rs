//! The board, and what was seen of it.

use std::str::FromStr;

use nalgebra::{Vector2, Vector3};

/// Fewer inner corners along a side say nothing of the lens, and more is no board that one can carry.
const SIDES: std::ops::RangeInclusive<usize> = 3..=50;

/// A chessboard by its inner corners: where four squares meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Inner corners along the longer or first side.
    pub columns: usize,
    /// Inner corners along the other side.
    pub rows: usize,
}

impl Board {
    /// Inner corners.
    #[must_use]
    pub const fn corners(&self) -> usize {
        self.columns * self.rows
    }

    /// Whether so many columns and rows lie on it, either way round.
    #[must_use]
    pub const fn holds(&self, columns: usize, rows: usize) -> bool {
        (columns <= self.columns && rows <= self.rows) || (columns <= self.rows && rows <= self.columns)
    }
}

impl std::fmt::Display for Board {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{}x{}", self.columns, self.rows)
    }
}

impl FromStr for Board {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides = text
            .split_once(['x', 'X'])
            .and_then(|(columns, rows)| Some((columns.trim().parse().ok()?, rows.trim().parse().ok()?)));
        match sides {
            Some((columns, rows)) if SIDES.contains(&columns) && SIDES.contains(&rows) => {
                Ok(Self { columns, rows })
            }
            _ => Err(format!(
                "`{text}` is no board: give its INNER corners, columns x rows, such as 9x6 for a board of 10x7 squares"
            )),
        }
    }
}

/// An inner corner in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Its place on the board, in squares from a corner of what was seen.
    pub place: (i32, i32),
    /// Where it was seen, pixels.
    pub pixel: Vector2<f64>,
}

/// All corners seen in one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The picture.
    pub name: String,
    /// Its corners, by their place.
    pub sightings: Vec<Sighting>,
}

impl Sighting {
    /// The corner in board space, in metres: the board is the plane z = 0.
    #[must_use]
    pub fn point_m(&self, square_m: f64) -> Vector3<f64> {
        Vector3::new(
            f64::from(self.place.0) * square_m,
            f64::from(self.place.1) * square_m,
            0.0,
        )
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn a_board_is_read_and_a_wrong_one_told() {
        assert_eq!("9x6".parse(), Ok(Board { columns: 9, rows: 6 }));
        for wrong in ["9", "9x", "2x6", "axb", "9x6x2", "-9x6"] {
            assert!(wrong.parse::<Board>().unwrap_err().contains("INNER"), "{wrong}");
        }
        let board = Board { columns: 9, rows: 6 };
        assert!(board.holds(5, 9) && !board.holds(7, 7));
    }
}

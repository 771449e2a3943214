//! Drives of many cars, evaluated in shards and joined into one table with exact totals.
//!
//! In: a list of drives ([`DriveList`]), of which a [`Shard`] takes every Nth. Out: a [`Part`] a shard, as a file; of all parts
//! together a [`Fleet`]. Invariant: the fleet of N parts is that of one, byte for byte: what adds up is integers (counts,
//! histogram bins, microseconds, millimetres), added in the order of the list, and a ratio is made of the sums alone. A sum
//! that does not fit 64 bits is refused, and so are parts that do not make one whole. Cost: memory for the counts of each
//! drive, some kilobytes.

mod driven;
mod list;
mod merge;
mod part;
mod run;
mod tally;
#[cfg(test)]
mod tests;

pub use driven::as_driven;
pub use list::{Drive, DriveKind, DriveList, ListDigest, Shard};
pub use merge::{Fleet, Ratios, Totals, merge, part_files};
pub use part::{FailedDrive, Part, Settings};
pub use run::score_run;
pub use tally::{DriveScore, GridTally, PathTally, RoadTally, Tally, TrajectoryRow};

//! The cases of the rig, one file a subject.

mod bus;
mod camera;
mod process;
mod vivid;

use crate::case::Case;

/// All cases, in the order of the table.
pub(crate) fn all() -> impl Iterator<Item = &'static Case> {
    process::BOOT
        .iter()
        .chain(camera::CASES)
        .chain(vivid::CASES)
        .chain(bus::CASES)
        .chain(process::CASES)
}

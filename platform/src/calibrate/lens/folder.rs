//! Pictures of a board in a folder.
//!
//! In: a folder of PNG and JPEG files of one size. Out: for each what was found. Cost: that of [`corners::find`] a picture.

use std::path::Path;

use freespace::frame::GrayImage;

use super::{Board, View, corners, start};
use crate::bad_input::BadInput;
use crate::config::ImageSize;

/// What became of a picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// All of the board.
    Complete(View),
    /// Some of its corners: usable.
    Partial(View),
    /// A lattice with so many columns and rows, more than the board has.
    OtherBoard(usize, usize),
    /// No board, or too little of one.
    Nothing,
}

/// A picture and what was found in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// File name with its ending.
    pub name: String,
    /// What was found.
    pub outcome: Outcome,
    /// Columns and rows of the lattice found, the longer side first; zero without one.
    pub extent: (usize, usize),
}

impl Picture {
    /// What a calibration can use of it.
    #[must_use]
    pub const fn view(&self) -> Option<&View> {
        match &self.outcome {
            Outcome::Complete(view) | Outcome::Partial(view) => Some(view),
            Outcome::OtherBoard(..) | Outcome::Nothing => None,
        }
    }
}

/// Looks for the board in one picture.
pub(super) fn look(name: &str, image: &GrayImage, board: &Board) -> Picture {
    let found = corners::find(image, board.corners());
    let (columns, rows) = found.extent;
    let view = View {
        name: name.to_owned(),
        sightings: found.sightings,
    };
    let outcome = if !start::usable(&view, board) || columns.min(rows) < 3 {
        Outcome::Nothing
    } else if !board.holds(columns, rows) {
        Outcome::OtherBoard(columns.max(rows), columns.min(rows))
    } else if view.sightings.len() == board.corners() {
        Outcome::Complete(view)
    } else {
        Outcome::Partial(view)
    };
    let extent = if outcome == Outcome::Nothing {
        (0, 0)
    } else {
        (columns.max(rows), columns.min(rows))
    };
    Picture {
        name: name.to_owned(),
        outcome,
        extent,
    }
}

/// Looks for the board in every picture of a folder, calling `seen` after each with its number and how many there are.
///
/// # Errors
/// A folder without pictures, a picture that cannot be read or has another size than the first; most boards being of another
/// size than `board`.
pub fn read_folder(
    folder: &Path,
    board: &Board,
    seen: &mut dyn FnMut(usize, usize),
) -> Result<(Vec<Picture>, ImageSize), BadInput> {
    let files = files_in(folder)?;
    let mut size = None;
    let mut pictures = Vec::with_capacity(files.len());
    for (number, name) in files.iter().enumerate() {
        let image = read_gray(&folder.join(name))?;
        let own = ImageSize {
            width: image.width(),
            height: image.height(),
        };
        let first = *size.get_or_insert(own);
        if own != first {
            return Err(BadInput::of_file(
                &folder.join(name),
                format!(
                    "is {}x{}, but {} is {}x{}",
                    own.width, own.height, files[0], first.width, first.height
                ),
                "calibrate with pictures of one size, that of the frames later on",
            ));
        }
        pictures.push(look(name, &image, board));
        seen(number + 1, files.len());
    }
    check_size(folder, board, &pictures)?;
    // There is a first file, or `files_in` had failed.
    Ok((pictures, size.unwrap_or(ImageSize { width: 0, height: 0 })))
}

fn files_in(folder: &Path) -> Result<Vec<String>, BadInput> {
    let fix = "FOLDER holds PNG or JPEG pictures of the board, 15 to 30 of them";
    let listing = std::fs::read_dir(folder)
        .map_err(|error| BadInput::of_file(folder, format!("cannot be listed: {error}"), fix))?;
    let mut files: Vec<String> = listing
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| {
            let ending = name
                .rsplit_once('.')
                .map(|(_, ending)| ending.to_ascii_lowercase());
            matches!(ending.as_deref(), Some("png" | "jpg" | "jpeg"))
        })
        .collect();
    files.sort();
    if files.is_empty() {
        return Err(BadInput::of_file(folder, "holds no PNG or JPEG picture", fix));
    }
    Ok(files)
}

/// A picture in gray.
///
/// # Errors
/// Where it cannot be read or decoded.
pub(super) fn read_gray(path: &Path) -> Result<GrayImage, BadInput> {
    let fault = |error: &dyn std::fmt::Display| {
        let fix = "copy the file again from its source, or take it out of the folder";
        BadInput::of_file(path, format!("cannot be read: {error}"), fix)
    };
    let decoded = image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(|error| fault(&error))?
        .decode()
        .map_err(|error| fault(&error))?
        .into_luma8();
    let mut image = GrayImage::new(decoded.width() as usize, decoded.height() as usize);
    image.pixels_mut().copy_from_slice(decoded.as_raw());
    Ok(image)
}

/// Where most boards found have a size that the board has not, it was given wrong: commonly its squares were counted.
fn check_size(folder: &Path, board: &Board, pictures: &[Picture]) -> Result<(), BadInput> {
    let mut sizes: Vec<(usize, usize)> = pictures.iter().map(|picture| picture.extent).collect();
    sizes.retain(|size| *size != (0, 0));
    sizes.sort_unstable();
    let Some(most) = sizes.chunk_by(|a, b| a == b).max_by_key(|same| same.len()) else {
        return Ok(());
    };
    let wanted = (board.columns.max(board.rows), board.columns.min(board.rows));
    let fits = sizes.iter().filter(|size| **size == wanted).count();
    if most[0] == wanted || fits > 0 || 2 * most.len() <= sizes.len() {
        return Ok(());
    }
    let (columns, rows) = most[0];
    Err(BadInput::of_file(
        folder,
        format!(
            "its boards have {columns}x{rows} inner corners ({} of {} pictures), not {board}",
            most.len(),
            sizes.len()
        ),
        format!(
            "give --board {columns}x{rows}: inner corners are counted, where four squares meet, not squares"
        ),
    ))
}

//! NumPy's `.npy` files (format 1.0) of `[rows, columns] int8`.

use std::path::Path;

use crate::bad_input::BadInput;

const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";

/// The bytes of a file that holds `values`, row by row.
#[must_use]
pub fn encode_i8(rows: usize, columns: usize, values: &[i8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '|i1', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    // Magic, length and header together are a multiple of 64, the header ends with a line feed.
    let unpadded = MAGIC.len() + 2 + header.len() + 1;
    header.extend(std::iter::repeat_n(' ', unpadded.next_multiple_of(64) - unpadded));
    header.push('\n');
    let length = u16::try_from(header.len()).unwrap_or(u16::MAX);
    let mut bytes = Vec::with_capacity(MAGIC.len() + 2 + header.len() + values.len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend(values.iter().map(|value| value.to_ne_bytes()[0]));
    bytes
}

/// Rows, columns and values of a file.
///
/// # Errors
/// Where the file cannot be read or holds anything but a row-major `[rows, columns] int8` array.
pub fn read_i8(path: &Path) -> Result<(usize, usize, Vec<i8>), BadInput> {
    let fix = "write it with numpy.save(path, grid.astype(numpy.int8)), rows first";
    let fault = |what: &str| BadInput::of_file(path, what, fix);
    let bytes = std::fs::read(path).map_err(|error| fault(&format!("cannot be read: {error}")))?;
    let (header, data) = split_header(&bytes).ok_or_else(|| fault("is no .npy file"))?;
    if !header.contains("'|i1'") && !header.contains("'i1'") || header.contains("'fortran_order': True") {
        return Err(fault("is no row-major int8 array"));
    }
    let shape = header.split_once("'shape':").and_then(|(_, rest)| {
        let inside = rest.split_once('(')?.1.split_once(')')?.0;
        let mut sizes = inside.split(',').map(str::trim).filter(|size| !size.is_empty());
        let shape: (usize, usize) = (sizes.next()?.parse().ok()?, sizes.next()?.parse().ok()?);
        sizes.next().is_none().then_some(shape)
    });
    let Some((rows, columns)) = shape else {
        return Err(fault("is no array of two dimensions"));
    };
    if rows.checked_mul(columns) != Some(data.len()) {
        return Err(fault("is truncated: fewer values than its shape says"));
    }
    Ok((
        rows,
        columns,
        data.iter().map(|&byte| i8::from_ne_bytes([byte])).collect(),
    ))
}

fn split_header(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let rest = bytes.strip_prefix(MAGIC)?;
    let (length, rest) = rest.split_first_chunk::<2>()?;
    let (header, data) = rest.split_at_checked(usize::from(u16::from_le_bytes(*length)))?;
    Some((std::str::from_utf8(header).ok()?, data))
}

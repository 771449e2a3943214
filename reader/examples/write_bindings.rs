//! Writes `include/freespace.h` and `include/freespace.py` anew, after a change of the message:
//! `cargo run -p freespace-reader --example write_bindings`.

use std::path::Path;

use freespace_reader::bindings;

fn main() -> std::io::Result<()> {
    let include = Path::new(env!("CARGO_MANIFEST_DIR")).join("../include");
    std::fs::create_dir_all(&include)?;
    std::fs::write(include.join("freespace.h"), bindings::c_header())?;
    std::fs::write(include.join("freespace.py"), bindings::python_module())
}

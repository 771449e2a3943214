//! The program `freespace`.

fn main() {}

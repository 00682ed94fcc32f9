//! The datum program.
fn main() {}

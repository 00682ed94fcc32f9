//! `datum registers`: what the command prints is what is under version control.

use std::process::Command;

#[test]
fn the_command_prints_page_list_and_function_block() {
    for (arguments, file) in [
        (&["registers"][..], "md"),
        (&["registers", "--format", "markdown"], "md"),
        (&["registers", "--format", "csv"], "csv"),
        (&["registers", "--format", "st"], "st"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_datum")).args(arguments).output().expect("datum runs");
        let golden = std::fs::read(format!("{}/tests/data/registers.{file}", env!("CARGO_MANIFEST_DIR")));
        assert!(output.status.success() && output.stdout == golden.expect("it is tracked"), "{arguments:?}");
    }
}

//! `datum registers`: the PLC interface as a page, a tag list or a function block.

use super::{Status, print};
use crate::plc;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// A page, a tag list, or a function block in Structured Text
    #[arg(long, value_enum, default_value = "markdown")]
    format: Format,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Format {
    Markdown,
    Csv,
    St,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    print(&match a.format {
        Format::Markdown => plc::page(),
        Format::Csv => plc::csv(),
        Format::St => plc::function_block(),
    })?;
    Ok(Status::Done)
}

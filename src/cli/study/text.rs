//! A study's outcome for a terminal: figures beside the published ones and their targets, then the tables.

use crate::study::{Cell, Figure, Outcome, Study, Table};

/// The figures as a table, for every kind of report.
pub(super) fn figures(outcome: &Outcome) -> Table {
    let mut table = Table::new("", &["figure", "here", "", "published", "must", ""]);
    for f in &outcome.figures {
        let passed = match f.passed() {
            Some(true) => "ok",
            Some(false) => "MISSED",
            None => "",
        };
        table.row(vec![
            Cell::text(&f.name),
            value(f),
            Cell::text(f.unit),
            Cell::text(f.published.as_deref().unwrap_or("")),
            Cell::text(f.must.map(|m| m.to_string()).unwrap_or_default()),
            Cell::text(passed),
        ]);
    }
    table
}

fn value(f: &Figure) -> Cell {
    Cell::number(f.value, f.digits)
}

pub(super) fn report(study: &Study, outcome: &Outcome) -> String {
    let mut out = format!("{}: {}\n{}\n\n{}", study.name, study.about, outcome.setting, aligned(&figures(outcome)));
    for t in &outcome.tables {
        out += &format!("\n{}\n{}", t.title, aligned(t));
    }
    for remark in &outcome.remarks {
        out += &format!("\n{remark}");
    }
    if !outcome.remarks.is_empty() {
        out += "\n";
    }
    out + "\n"
}

/// Words to the left, numbers to the right.
fn aligned(table: &Table) -> String {
    let columns = table.columns.len();
    let shown: Vec<Vec<String>> = table.rows.iter().map(|r| r.iter().map(Cell::to_string).collect()).collect();
    let width = |c: usize| {
        let cells = shown.iter().map(|r| r[c].chars().count());
        cells.chain([table.columns[c].chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let is_number = |c: usize| table.rows.iter().any(|r| matches!(r[c], Cell::Number(..)));
    let line = |cells: &[String]| {
        let cell = |(c, text): (usize, &String)| {
            let (w, pad) = (widths[c], widths[c].saturating_sub(text.chars().count()));
            debug_assert!(w >= pad);
            if is_number(c) { " ".repeat(pad) + text } else { text.clone() + &" ".repeat(pad) }
        };
        let joined = cells.iter().enumerate().map(cell).collect::<Vec<_>>().join("  ");
        format!("  {}\n", joined.trim_end())
    };
    line(&table.columns) + &shown.iter().map(|r| line(r)).collect::<String>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::Must;

    #[test]
    fn numbers_stand_below_each_other_and_a_missed_target_shows() {
        let figures_ = vec![
            Figure::new("step", 0.00812, "°", 4).published("< 0.12").must(Must::AtMost(0.01)),
            Figure::new("over the range", 12.5, "°", 1).must(Must::AtMost(0.03)),
        ];
        let outcome = Outcome { figures: figures_, ..Outcome::default() };
        let text = aligned(&figures(&outcome));
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[1], "  step            0.0081  °  < 0.12     ≤ 0.01  ok");
        assert_eq!(lines[2], "  over the range    12.5  °             ≤ 0.03  MISSED");
    }
}

//! Outcomes as one HTML page that needs no other file: tables, plots as SVG, pictures as data.

use super::Done;
use super::{plot, text};
use crate::cli::overlay;
use crate::image::png_rgb;
use crate::study::{Cell, Given, Seen, Table};

/// Pictures are made smaller until they are no wider than this, px.
const WIDEST: usize = 700;

const STYLE: &str = "body{font:15px/1.4 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}\
table{border-collapse:collapse;margin:.7em 0}th,td{padding:.15em .7em;text-align:left;border-bottom:1px solid #ddd}\
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}.ok{color:#060}.missed{color:#b00;font-weight:bold}\
figure{margin:1em 0}figcaption,caption{font-weight:bold;text-align:left}svg,img{max-width:100%;height:auto}";

pub(super) fn page(given: &Given, done: &[Done]) -> String {
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>datum study</title><style>{STYLE}</style>\
         </head><body>\n<h1>How well datum measures</h1>\n<p>datum {}, scale {}, seed {}{}. Published figures are those of \
         Scientific Reports (2025), s41598-025-07269-y.</p>\n",
        env!("CARGO_PKG_VERSION"),
        given.scale,
        given.seed,
        if given.quick { ", quick form: too few vehicles to judge by" } else { "" }
    );
    for Done { study, outcome } in done {
        out += &format!(
            "<h2>{}</h2>\n<p>{}.</p>\n<p>{}</p>\n",
            study.name,
            escaped(study.about),
            escaped(&outcome.setting)
        );
        out += &table(&text::figures(outcome));
        for remark in &outcome.remarks {
            out += &format!("<p>{}</p>\n", escaped(remark));
        }
        for p in &outcome.plots {
            if let Some(svg) = plot::svg(p) {
                out += &format!("<figure><figcaption>{}</figcaption>{svg}</figure>\n", escaped(&p.title));
            }
        }
        for t in &outcome.tables {
            out += &table(t);
        }
        for seen in &outcome.pictures {
            out += &picture(seen);
        }
    }
    out + "</body></html>\n"
}

fn table(t: &Table) -> String {
    let is_number = |c: usize| t.rows.iter().any(|r| matches!(r[c], Cell::Number(..)));
    let cell = |tag: &str, c: usize, text: &str| {
        let class = match text {
            "ok" => " class=\"ok\"",
            "MISSED" => " class=\"missed\"",
            _ if is_number(c) => " class=\"n\"",
            _ => "",
        };
        format!("<{tag}{class}>{}</{tag}>", escaped(text))
    };
    let row = |tag: &str, texts: Vec<String>| {
        let cells: String = texts.iter().enumerate().map(|(c, text)| cell(tag, c, text)).collect();
        format!("<tr>{cells}</tr>\n")
    };
    let caption = if t.title.is_empty() { String::new() } else { format!("<caption>{}</caption>", escaped(&t.title)) };
    let rows: String = t.rows.iter().map(|r| row("td", r.iter().map(Cell::to_string).collect())).collect();
    format!("<table>{caption}\n{}{rows}</table>\n", row("th", t.columns.clone()))
}

fn picture(seen: &Seen) -> String {
    let shrink = seen.red.width.div_ceil(WIDEST);
    let drawn = overlay::picture(&seen.red, seen.white, &seen.measurement, &seen.drawing, shrink);
    let data = base64(&png_rgb(&drawn));
    let caption = escaped(&seen.caption);
    format!(
        "<figure><figcaption>{caption}</figcaption><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\"></figure>\n"
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// RFC 4648, §4.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let n = (0..3).fold(0usize, |n, k| n << 8 | usize::from(three.get(k).copied().unwrap_or(0)));
        for k in 0..4 {
            let digit = char::from(DIGITS[n >> (18 - 6 * k) & 63]);
            out.push(if k <= three.len() { digit } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_become_base64_as_the_rfc_says() {
        let said = ["", "f", "fo", "foo", "foob", "fooba", "foobar"].map(|s| base64(s.as_bytes()));
        assert_eq!(said, ["", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"]);
    }

    #[test]
    fn what_is_said_cannot_break_the_page() {
        let mut t = Table::new("a < b", &["<c>"]);
        t.row(vec![Cell::text("\"x\" & y")]);
        let html = table(&t);
        assert!(
            html.contains("a &lt; b") && html.contains("&lt;c&gt;") && html.contains("&quot;x&quot; &amp; y"),
            "{html}"
        );
    }
}

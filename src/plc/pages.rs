//! The register table for people and their tools. In: the table, the bits, the codes. Out: a page in Markdown, a tag list
//! in CSV, a function block in Structured Text (IEC 61131-3) that does the handshake.
//! Not here: the table.

use super::bits::{Bit, control, status};
use super::registers::{COMMAND, CRC_BLOCK, HOLDING, INPUT, MAP_MAJOR, MAP_MINOR, MIRROR, Read, Row, STATUS};
use crate::code::CODES;
use std::fmt::Write;

/// What cannot fail: writing into a `String`.
const TEXT: &str = "a String takes any text";

/// The page, in Markdown.
pub fn page() -> String {
    let mut s = format!(
        "# The PLC interface: Modbus TCP\n\n\
         Map {MAP_MAJOR}.{MAP_MINOR}. Made by `datum registers`. Addresses are 0-based; the 3xxxx or 4xxxx number is the \
         address + 1.\n32- and 64-bit values have the high word first unless `word_order` says otherwise; ASCII has the \
         first character in the high byte.\nWhat is unknown reads as the invalid value of its type: u16 0xFFFF, i16 0x8000, \
         u32 0xFFFF_FFFF, i32 0x8000_0000, u64 0.\nGaps read 0. Function codes 1, 2, 3, 4, 5, 6, 15, 16, 22, 23 and 43/14; \
         unit ids 0, 1 and 255.\n"
    );
    let mut section = |title: &str, rows: &mut dyn Iterator<Item = &Row>| {
        write!(s, "\n## {title}\n| address | type | name | meaning |\n|--:|---|---|---|\n").expect(TEXT);
        for row in rows {
            for (address, name, _) in row.each() {
                let span = match row.read.words() {
                    1 => address.to_string(),
                    words => format!("{address}–{}", address + words - 1),
                };
                let (kind, bits) = (row.read.type_name(), bits_in_words(row.bits));
                writeln!(s, "| {span} | {kind} | {name} | {}{bits} |", row.doc).expect(TEXT);
            }
        }
    };
    let command = format!("Holding registers 0–{}: commands, PLC to appliance", HOLDING - 1);
    section(&command, &mut COMMAND.iter());
    let mirror = format!("mirrored at holding {}–{}", MIRROR.start, MIRROR.end - 1);
    let titles = [&format!("status and result, {mirror}"), "counters", "identity and test block", "environment"];
    for (block, title) in INPUT.into_iter().zip(titles) {
        let title = format!("Input registers {}–{}: {title}", block.start, block.end - 1);
        section(&title, &mut STATUS.iter().filter(|row| block.contains(&row.address)));
    }
    s += "\nHolding registers 17–63 are reserved: write 0. Coils 0–15 are the bits of CONTROL, discrete inputs 0–15 those \
          of STATUS.\n\n## Codes\n| code | what happened | what to do |\n|--:|---|---|\n";
    for code in CODES {
        writeln!(s, "| {} | {} | {} |", code.number, code.sentence, code.remedy).expect(TEXT);
    }
    s
}

fn bits_in_words(bits: &[Bit]) -> String {
    bits.iter().enumerate().map(|(i, bit)| format!("<br>b{i} {}: {}", bit.name, bit.doc)).collect()
}

/// The tag list, in CSV: one line a register or bit.
pub fn csv() -> String {
    let mut s = "table,address,number,bit,name,type,words,access,description\n".to_owned();
    let mut line = |table, first: u32, address: u16, bit: &str, name: &str, kind: &str, words, access, doc: &str| {
        let number = first + u32::from(address);
        let doc = doc.replace('"', "\"\"");
        writeln!(s, "{table},{address},{number:05},{bit},{name},{kind},{words},{access},\"{doc}\"").expect(TEXT);
    };
    for (table, first, access, rows) in [("holding", 40001, "rw", COMMAND), ("input", 30001, "r", STATUS)] {
        for row in rows {
            for (address, name, _) in row.each() {
                line(table, first, address, "", name, &row.read.type_name(), row.read.words(), access, row.doc);
                for (i, bit) in row.bits.iter().enumerate() {
                    let name = format!("{name}.{}", bit.name);
                    line(table, first, address, &i.to_string(), &name, "bool", 0, access, bit.doc);
                }
            }
        }
    }
    for (table, first, access, bits) in [("coil", 1, "rw", control::BITS), ("discrete", 10001, "r", status::BITS)] {
        for (address, bit) in (0..).zip(bits) {
            line(table, first, address, "", bit.name, "bool", 0, access, bit.doc);
        }
    }
    s
}

/// A function block in Structured Text that measures one vehicle per rising edge of `Execute`.
pub fn function_block() -> String {
    let mut constants = String::new();
    for (prefix, bits) in [("C", control::BITS), ("S", status::BITS)] {
        for (i, bit) in bits.iter().enumerate() {
            let (name, mask) = (bit.name, 1u16 << i);
            writeln!(constants, "    {prefix}_{name} : WORD := 16#{mask:04X}; (* {} *)", bit.doc).expect(TEXT);
        }
    }
    let (mut outputs, mut copies) = (String::new(), String::new());
    for row in STATUS.iter().filter(|row| (15..CRC_BLOCK.end).contains(&row.address)) {
        for (address, name, _) in row.each().filter(|r| !r.1.starts_with("RESERVED")) {
            let a = address;
            let double = format!("DATUM_DWORD(In[{a}], In[{}], LowFirst)", a + 1);
            let (kind, value) = match row.read {
                Read::U16(_) => ("UINT", format!("WORD_TO_UINT(In[{a}])")),
                Read::I16(_) => ("INT", format!("WORD_TO_INT(In[{a}])")),
                Read::U32(_) => ("UDINT", format!("DWORD_TO_UDINT({double})")),
                Read::I32(_) => ("DINT", format!("DWORD_TO_DINT({double})")),
                // not needed for the handshake; In has them
                Read::U64(_) | Read::F32(_) | Read::Text(..) => continue,
            };
            writeln!(outputs, "    {name} : {kind}; (* {} *)", row.doc).expect(TEXT);
            writeln!(copies, "        {name} := {value};").expect(TEXT);
        }
    }
    let block = include_str!("function_block.st");
    let echo = find("TRIGGER_ID_ECHO");
    let words = [
        ("{map}", format!("{MAP_MAJOR}.{MAP_MINOR}")),
        ("{constants}", constants),
        ("{outputs}", outputs),
        ("{copies}", copies),
        ("{STATUS}", find("STATUS").to_string()),
        ("{ERROR_CODE}", find("ERROR_CODE").to_string()),
        ("{ERROR_SEQ}", find("ERROR_SEQ").to_string()),
        ("{ERROR_SEQ_2}", (find("ERROR_SEQ") + 1).to_string()),
        ("{HEAD}", find("RESULT_SEQ_HEAD").to_string()),
        ("{TAIL}", find("RESULT_SEQ_TAIL").to_string()),
        ("{ECHO}", echo.to_string()),
        ("{ECHO_2}", (echo + 1).to_string()),
        ("{CONTROL}", find("CONTROL").to_string()),
        ("{PLC_HEARTBEAT}", find("PLC_HEARTBEAT").to_string()),
        ("{TRIGGER_ID}", find("TRIGGER_ID").to_string()),
        ("{TRIGGER_ID_2}", (find("TRIGGER_ID") + 1).to_string()),
        ("{JOB_REQ}", find("JOB_REQ").to_string()),
        ("{MODEL_CODE}", find("MODEL_CODE").to_string()),
        ("{VIN}", find("VIN").to_string()),
    ];
    let text = words.iter().fold(block.to_owned(), |text, (key, value)| text.replace(key, value));
    // some PLCs' tools know ASCII only
    let ascii = [("µ", "u"), ("°", " deg"), ("×", "x "), ("‰", "per mille"), ("…", "...")];
    ascii.iter().fold(text, |text, (from, to)| text.replace(from, to))
}

/// The address of a register.
fn find(name: &str) -> u16 {
    let mut all = COMMAND.iter().chain(STATUS).flat_map(Row::each);
    all.find(|r| r.1 == name).expect("a name of the table").0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_the_table() {
        for (name, text) in [("md", page()), ("csv", csv()), ("st", function_block())] {
            let path = format!("{}/tests/data/registers.{name}", env!("CARGO_MANIFEST_DIR"));
            if std::env::var_os("REGENERATE").is_some() {
                std::fs::write(&path, &text).expect("tests/data is writable");
            }
            let golden = std::fs::read_to_string(&path).expect("the page is tracked");
            assert!(text.len() > 1000 && golden == text, "{path}: REGENERATE=1 cargo test, then read the diff");
        }
    }

    #[test]
    fn every_register_and_bit_is_on_the_page_and_in_the_list() {
        let (page, csv) = (page(), csv());
        for row in COMMAND.iter().chain(STATUS) {
            for (address, name, _) in row.each() {
                assert!(page.contains(&format!("| {name} | ")), "{name}");
                assert!(csv.lines().any(|l| l.contains(&format!(",{address},")) && l.contains(name)), "{name}");
            }
        }
        assert!(csv.lines().all(|l| l.split('"').next().is_some_and(|head| head.matches(',').count() == 8)));
    }

    #[test]
    fn nothing_is_left_to_fill_in_in_the_function_block() {
        let text = function_block();
        assert!(text.is_ascii() && !text.contains('{') && !text.contains('}'), "{text}");
        assert!(text.contains("X := DWORD_TO_DINT(DATUM_DWORD(In[17], In[18], LowFirst));"));
    }
}

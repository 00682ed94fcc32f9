//! A time that a person wrote, in UTC. In: text. Out: ms since 1970. The other way is [`crate::time::moment`].
//! Howard Hinnant, "chrono-compatible low-level date algorithms": `days_from_civil`.

const DAY_MS: u64 = 86_400_000;

/// The time in `text`: a day (its beginning), or a day and a time to minutes, seconds or fractions, with or without the
/// Z of UTC. None before 1970 or of another form.
pub fn parse_time(text: &str) -> Option<u64> {
    let text = text.strip_suffix('Z').unwrap_or(text);
    let (day, time) = text.split_once(['T', ' ']).map_or((text, None), |(day, time)| (day, Some(time)));
    let mut parts = day.split('-');
    let mut part = |digits| parts.next().and_then(|p| number(p, digits));
    let (y, m, d) = (part(4)?, part(2)?, part(2)?);
    let leap = y % 4 == 0 && (y % 100 != 0 || y % 400 == 0);
    let longest = match m {
        2 => 28 + u64::from(leap),
        4 | 6 | 9 | 11 => 30,
        1..=12 => 31,
        _ => return None,
    };
    if parts.next().is_some() || y < 1970 || !(1..=longest).contains(&d) {
        return None;
    }
    let (shifted, month) = if m > 2 { (y, m - 3) } else { (y - 1, m + 9) }; // years from 1 March on
    let (era, year) = (shifted / 400, shifted % 400);
    let days = era * 146_097 + year * 365 + year / 4 - year / 100 + (153 * month + 2) / 5 + d - 1 - 719_468;
    Some(days * DAY_MS + time.map_or(Some(0), time_of_day)?)
}

fn time_of_day(text: &str) -> Option<u64> {
    let mut parts = text.split(':');
    let (h, min) = (number(parts.next()?, 2)?, number(parts.next()?, 2)?);
    let (s, fraction) = parts.next().map_or(("00", ""), |s| s.split_once('.').unwrap_or((s, "")));
    let s = number(s, 2)?;
    let ms = if fraction.is_empty() { 0 } else { number(&format!("{fraction:0<3}")[..3], 3)? };
    let whole = parts.next().is_none() && fraction.bytes().all(|b| b.is_ascii_digit());
    (whole && h < 24 && min < 60 && s < 60).then_some(((h * 60 + min) * 60 + s) * 1000 + ms)
}

/// A number of exactly so many digits.
fn number(text: &str, digits: usize) -> Option<u64> {
    (text.len() == digits && text.bytes().all(|b| b.is_ascii_digit())).then(|| text.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::moment as time_text;

    #[test]
    fn known_times_are_written_and_read() {
        for (ms, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400_000, "2000-02-29T00:00:00.000Z"),
            (1_795_564_800_123, "2026-11-25T00:00:00.123Z"),
            (4_107_542_399_999, "2100-02-28T23:59:59.999Z"),
        ] {
            assert_eq!((time_text(ms).as_str(), parse_time(text)), (text, Some(ms)));
        }
        assert_eq!(parse_time("1970-01-02"), Some(DAY_MS));
        assert_eq!(parse_time("1970-01-01 00:01"), Some(60_000));
        assert_eq!(parse_time("1970-01-01T00:00:01.5Z"), Some(1500));
        for wrong in [
            "",
            "2026",
            "2026-02-29",
            "2026-13-01",
            "1969-12-31",
            "2026-1-1",
            "2026-01-01T24:00",
            "1970-01-01T1",
            "2026-01-01T00:00:00+01:00",
            "2026-01-01-01",
            "2026-01-01T00:00:00.é",
            "2026-01-01T00:00:00:00",
        ] {
            assert_eq!(parse_time(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn every_time_reads_back() {
        arbtest::arbtest(|u| {
            let ms = u.int_in_range(0..=253_402_300_799_999u64)?; // to the end of 9999
            assert_eq!(parse_time(&time_text(ms)), Some(ms));
            Ok(())
        });
    }
}

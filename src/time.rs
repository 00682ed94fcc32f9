//! The date in words. In: time since 1970. Out: the day, or the moment, as files state it.
//! Not here: any clock but the system's.

use std::time::{SystemTime, UNIX_EPOCH};

/// Since 1970, by the system's clock; 0 where it is set to before.
pub fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| u64::try_from(d.as_millis()).unwrap_or(u64::MAX))
}

/// The UTC day, as "2026-11-22". Howard Hinnant, "chrono-compatible low-level date algorithms", `civil_from_days`.
pub fn date(seconds_since_1970: u64) -> String {
    let z = seconds_since_1970 / 86_400 + 719_468; // days since 0000-03-01
    let (era, doe) = (z / 146_097, z % 146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let (day, month) = (doy - (153 * mp + 2) / 5 + 1, if mp < 10 { mp + 3 } else { mp - 9 });
    format!("{:04}-{month:02}-{day:02}", yoe + era * 400 + u64::from(month <= 2))
}

/// The moment in UTC, RFC 3339, as "2026-11-22T05:00:00.000Z".
pub fn moment(unix_ms: u64) -> String {
    let (seconds, ms) = (unix_ms / 1000, unix_ms % 1000);
    let of_day = seconds % 86_400;
    let day = date(seconds);
    format!("{day}T{:02}:{:02}:{:02}.{ms:03}Z", of_day / 3600, of_day / 60 % 60, of_day % 60)
}

#[cfg(test)]
mod tests {
    use super::{date, moment};

    #[test]
    fn days_are_named_as_the_calendar_does() {
        // from `date -u -d @N +%F`
        for (seconds, day) in [
            (0, "1970-01-01"),
            (951_782_399, "2000-02-28"),
            (951_782_400, "2000-02-29"),
            (951_868_800, "2000-03-01"),
            (1_795_305_600, "2026-11-22"),
            (4_107_542_400, "2100-03-01"),
        ] {
            assert_eq!(date(seconds), day);
        }
    }

    #[test]
    fn a_moment_is_a_date_that_toml_reads() {
        assert_eq!(moment(1_795_323_600_007), "2026-11-22T05:00:00.007Z");
        assert!(moment(0).parse::<toml::value::Datetime>().is_ok());
    }
}

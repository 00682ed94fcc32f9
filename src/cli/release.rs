//! `datum release`: a taught vehicle model in, the same with its fingerprint out.

use super::{Status, print};
use crate::VehicleFile;
use crate::vehicle::{Release, fingerprint};
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The vehicle model
    #[arg(value_name = "VEHICLE")]
    vehicle: PathBuf,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let mut model = VehicleFile::read(&a.vehicle)?;
    let templates = model.read_templates()?;
    let fingerprint = fingerprint(&model, &templates);
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    model.release = Some(Release { fingerprint, date: date(seconds) });
    model.write(&a.vehicle)?;
    print(&format!("{}: job {} released, fingerprint {fingerprint}\n", a.vehicle.display(), model.job))?;
    Ok(Status::Done)
}

/// The UTC day, as "2026-11-22". Howard Hinnant, "chrono-compatible low-level date algorithms", `civil_from_days`.
fn date(seconds_since_1970: u64) -> String {
    let z = seconds_since_1970 / 86_400 + 719_468; // days since 0000-03-01
    let (era, doe) = (z / 146_097, z % 146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let (day, month) = (doy - (153 * mp + 2) / 5 + 1, if mp < 10 { mp + 3 } else { mp - 9 });
    format!("{:04}-{month:02}-{day:02}", yoe + era * 400 + u64::from(month <= 2))
}

#[cfg(test)]
mod tests {
    use super::date;

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
}

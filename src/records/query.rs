//! Looking records up. In: a journal's folder and what is asked for. Out: the records, the oldest first, and what was
//! found damaged on the way.

use super::{Damage, Event, Found, Reader, Record, Verdict};
use crate::document::Error;
use std::collections::VecDeque;
use std::path::Path;

/// What is asked for; everything that is stated must hold. VIN, verdict and job are of vehicles only.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Filter {
    /// From this time on, ms since 1970.
    pub since: Option<u64>,
    /// Before this time, ms since 1970.
    pub until: Option<u64>,
    /// A part of the VIN, in small or capital letters.
    pub vin: Option<String>,
    /// One of these; empty: any.
    pub verdicts: Vec<Verdict>,
    /// The vehicle model.
    pub job: Option<u16>,
    /// One of these; empty: any.
    pub ids: Vec<u64>,
    /// Of those that remain the last so many.
    pub last: Option<usize>,
}

impl Filter {
    /// Whether a record is asked for, [`Filter::last`] apart.
    pub fn matches(&self, record: &Record) -> bool {
        let of_vehicles = self.vin.is_some() || !self.verdicts.is_empty() || self.job.is_some();
        let vehicle = match &record.event {
            Event::Vehicle(v) => {
                let vin = |part: &String| v.vin.to_ascii_uppercase().contains(&part.to_ascii_uppercase());
                self.vin.as_ref().is_none_or(vin)
                    && (self.verdicts.is_empty() || self.verdicts.contains(&v.verdict))
                    && self.job.is_none_or(|job| job == v.job)
            }
            _ => !of_vehicles,
        };
        vehicle
            && self.since.is_none_or(|since| record.at_ms >= since)
            && self.until.is_none_or(|until| record.at_ms < until)
            && (self.ids.is_empty() || self.ids.contains(&record.id))
    }
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// The oldest first.
    pub records: Vec<Record>,
    /// What is no whole record, anywhere in the journal.
    pub damage: Vec<Damage>,
    /// Records that a later version of the program wrote: they may have been asked for.
    pub later: usize,
}

/// The records in `folder` that are asked for.
pub fn select(folder: &Path, filter: &Filter) -> Result<Selection, Error> {
    let mut records = VecDeque::new();
    let mut selection = Selection::default();
    for found in Reader::open(folder)? {
        match found? {
            Found::Record(record) if filter.matches(&record) => {
                records.push_back(*record);
                if filter.last.is_some_and(|last| records.len() > last) {
                    records.pop_front();
                }
            }
            Found::Record(_) => {}
            Found::Later { .. } => selection.later += 1,
            Found::Damage(damage) => selection.damage.push(damage),
        }
    }
    selection.records = records.into();
    Ok(selection)
}

#[cfg(test)]
mod tests {
    use super::super::report::samples;
    use super::*;

    #[test]
    fn each_condition_narrows_the_choice() {
        let records = samples();
        let ids = |filter: Filter| records.iter().filter(|r| filter.matches(r)).map(|r| r.id).collect::<Vec<_>>();
        assert_eq!(ids(Filter::default()), [1, 2, 3, 4, 5]);
        assert_eq!(ids(Filter { vin: Some("wdatum".into()), ..Filter::default() }), [2, 3]);
        assert_eq!(ids(Filter { vin: Some("0043".into()), ..Filter::default() }), [3]);
        assert_eq!(ids(Filter { verdicts: vec![Verdict::NotMeasurable], ..Filter::default() }), [3]);
        assert_eq!(ids(Filter { verdicts: vec![Verdict::NotMeasurable, Verdict::Ok], ..Filter::default() }), [2, 3]);
        assert_eq!(ids(Filter { job: Some(12), ..Filter::default() }), [2, 3]);
        assert_eq!(ids(Filter { job: Some(13), ..Filter::default() }), [0; 0]);
        assert_eq!(ids(Filter { ids: vec![1, 5], ..Filter::default() }), [1, 5]);
        let (since, until) = (Some(records[1].at_ms), Some(records[3].at_ms));
        assert_eq!(ids(Filter { since, until, ..Filter::default() }), [2, 3]);
    }
}

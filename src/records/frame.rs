//! Framing: a payload and its id in, bytes of which every later reader can tell whether they are whole; and back.
//! Not here: what a payload means; files.
//!
//! `marker 4 | payload's length u32 | id u64 | payload | CRC-32 of all but the marker`, numbers little-endian. After
//! damage the next marker that begins a whole frame is looked for, so that one bad spot costs one record.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use std::ops::Range;

/// Begins every frame. 0xFF and 0xFE are in no UTF-8 text, so that no text in a payload looks like one.
pub(super) const MARKER: [u8; 4] = [0xFF, 0xD7, 0x0A, 0xFE];
/// Longer ones are not believed: a record with four features and some targets has 6 kB.
pub(super) const MAX_PAYLOAD: usize = 1 << 20;
/// The smallest frame.
pub(super) const LEAST: usize = HEAD + TAIL;
const HEAD: usize = 16;
const TAIL: usize = 4;
/// Sixteen bytes at a time: at start-up a whole segment is checked.
const CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

/// A run of bytes, as read back.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Piece<'a> {
    /// A whole frame.
    Whole { id: u64, payload: &'a [u8] },
    /// Bytes that are no whole frame, up to the next one or the end.
    Lost(Range<usize>),
}

/// Appends the frame of `payload`, which has at most [`MAX_PAYLOAD`] bytes, to `out`.
pub(super) fn encode(id: u64, payload: &[u8], out: &mut Vec<u8>) {
    let length = u32::try_from(payload.len()).expect("the caller keeps to MAX_PAYLOAD");
    out.extend_from_slice(&MARKER);
    let checked = out.len();
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(&id.to_le_bytes());
    out.extend_from_slice(payload);
    let crc = CRC.checksum(&out[checked..]);
    out.extend_from_slice(&crc.to_le_bytes());
}

/// The piece at `*at`, which moves behind it; none at the end. Ids only ever grow: a frame whose id is not above
/// `*above`, which becomes that of the piece, is a stale one and as good as lost.
pub(super) fn next<'a>(bytes: &'a [u8], at: &mut usize, above: &mut u64) -> Option<Piece<'a>> {
    let begun = *at;
    if begun >= bytes.len() {
        return None;
    }
    if let Some((id, payload)) = frame_at(bytes, begun, *above) {
        *at = begun + LEAST + payload.len();
        *above = id;
        return Some(Piece::Whole { id, payload });
    }
    *at = (begun + 1..bytes.len()).find(|&k| frame_at(bytes, k, *above).is_some()).unwrap_or(bytes.len());
    Some(Piece::Lost(begun..*at))
}

fn frame_at(bytes: &[u8], at: usize, above: u64) -> Option<(u64, &[u8])> {
    let head = bytes.get(at..at + HEAD)?;
    if head[..4] != MARKER {
        return None;
    }
    let length = u32::from_le_bytes(head[4..8].try_into().expect("four bytes")) as usize;
    let id = u64::from_le_bytes(head[8..16].try_into().expect("eight bytes"));
    if length > MAX_PAYLOAD || id <= above {
        return None;
    }
    let end = at + HEAD + length;
    let crc = bytes.get(end..end + TAIL)?;
    (CRC.checksum(&bytes[at + 4..end]).to_le_bytes() == crc).then(|| (id, &bytes[at + HEAD..end]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pieces(bytes: &[u8]) -> Vec<Piece<'_>> {
        let (mut at, mut above) = (0, 0);
        std::iter::from_fn(|| next(bytes, &mut at, &mut above)).collect()
    }

    #[test]
    fn the_bytes_of_a_frame_are_frozen() {
        let mut out = Vec::new();
        encode(0x0102, b"datum", &mut out);
        let frozen = [
            0xFF, 0xD7, 0x0A, 0xFE, 5, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, b'd', b'a', b't', b'u', b'm', 0x24, 0xF5, 0x23,
            0x1B,
        ];
        assert_eq!(out, frozen);
    }

    #[test]
    fn damage_costs_the_frame_it_hits_and_no_other() {
        let mut out = Vec::new();
        let mut ends = vec![0];
        for id in 1..=3 {
            encode(id, &[id as u8; 40], &mut out);
            ends.push(out.len());
        }
        for hit in 0..out.len() {
            for bit in [0x01, 0x80] {
                let mut bytes = out.clone();
                bytes[hit] ^= bit;
                let of = ends.iter().filter(|&&e| e <= hit).count();
                let read = pieces(&bytes);
                let whole: Vec<u64> = read
                    .iter()
                    .filter_map(|p| if let Piece::Whole { id, .. } = p { Some(*id) } else { None })
                    .collect();
                assert_eq!(whole, (1..=3).filter(|&id| id != of as u64).collect::<Vec<_>>(), "byte {hit}");
                assert!(read.contains(&Piece::Lost(ends[of - 1]..ends[of])), "byte {hit}: {read:?}");
            }
        }
    }

    #[test]
    fn a_frame_that_repeats_an_id_is_lost() {
        let mut out = Vec::new();
        for id in [5, 5, 6] {
            encode(id, b"", &mut out);
        }
        let whole = |id| Piece::Whole { id, payload: b"" };
        assert_eq!(pieces(&out), [whole(5), Piece::Lost(LEAST..2 * LEAST), whole(6)]);
    }
}

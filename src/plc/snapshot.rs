//! One moment's registers, immutable. In: the handshake. Out: what every request of that moment is answered from, and
//! the place from which the newest is taken by one pointer swap.
//! Not here: the protocol.

use super::handshake::Handshake;
use super::registers::{BITS, CONTROL, CRC_BLOCK, HOLDING, INPUT, MIRROR, RESULT_CRC16, STATUS};
use super::words::crc16;
use std::sync::{Arc, Mutex, PoisonError};

/// Input registers from 0 up to the end of the last block; the gaps between blocks are unused.
const INPUTS: usize = INPUT[INPUT.len() - 1].end as usize;

/// All registers at one moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Snapshot {
    input: [u16; INPUTS],
    holding: [u16; HOLDING as usize],
}

/// There is no such register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NoSuchRegister;

impl Snapshot {
    pub(super) fn new(h: &Handshake) -> Self {
        let mut input = [0; INPUTS];
        for row in STATUS {
            for (address, _, place) in row.each() {
                let words = row.read.value(h, place);
                input[usize::from(address)..][..words.len()].copy_from_slice(&words);
            }
        }
        let block = usize::from(CRC_BLOCK.start)..usize::from(CRC_BLOCK.end);
        input[usize::from(RESULT_CRC16)] = crc16(&input[block]);
        Self { input, holding: h.holding }
    }

    /// Input registers; all of them within one block.
    pub(super) fn input(&self, address: u16, quantity: u16) -> Result<&[u16], NoSuchRegister> {
        let end = address.checked_add(quantity).ok_or(NoSuchRegister)?;
        let inside = INPUT.iter().any(|b| b.start <= address && end <= b.end);
        inside.then(|| &self.input[usize::from(address)..usize::from(end)]).ok_or(NoSuchRegister)
    }

    /// Holding registers: the command block or the mirror of status and result.
    pub(super) fn holding(&self, address: u16, quantity: u16) -> Result<&[u16], NoSuchRegister> {
        if let Some(mirrored) = address.checked_sub(MIRROR.start) {
            let size = MIRROR.end - MIRROR.start;
            let inside = mirrored.checked_add(quantity).is_some_and(|end| end <= size);
            return if inside { self.input(mirrored, quantity) } else { Err(NoSuchRegister) };
        }
        let end = address.checked_add(quantity).filter(|end| *end <= HOLDING).ok_or(NoSuchRegister)?;
        Ok(&self.holding[usize::from(address)..usize::from(end)])
    }

    /// Coils: the bits of CONTROL.
    pub(super) fn coils(&self, address: u16, quantity: u16) -> Result<Vec<bool>, NoSuchRegister> {
        bits(self.holding[usize::from(CONTROL)], address, quantity)
    }

    /// Discrete inputs: the bits of STATUS.
    pub(super) fn discrete_inputs(&self, address: u16, quantity: u16) -> Result<Vec<bool>, NoSuchRegister> {
        bits(self.input[0], address, quantity)
    }
}

fn bits(word: u16, address: u16, quantity: u16) -> Result<Vec<bool>, NoSuchRegister> {
    let end = address.checked_add(quantity).filter(|end| *end <= BITS).ok_or(NoSuchRegister)?;
    Ok((address..end).map(|bit| word >> bit & 1 == 1).collect())
}

/// The newest snapshot. The lock is held for a pointer's time only.
pub(super) struct Newest(Mutex<Arc<Snapshot>>);

impl Newest {
    pub(super) fn new(snapshot: Snapshot) -> Self {
        Self(Mutex::new(Arc::new(snapshot)))
    }

    pub(super) fn get(&self) -> Arc<Snapshot> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn put(&self, snapshot: Snapshot) {
        let new = Arc::new(snapshot);
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = new;
    }
}

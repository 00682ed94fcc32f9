//! A PLC: one Modbus TCP connection that owns the station. In: orders. Out: what the registers say.
//! Not here: what they mean beyond the handshake (`datum registers` prints them all).

use anyhow::{Context, bail, ensure};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

const ENABLE: u16 = 1;
const TRIGGER: u16 = 2;
const RESULT_ACK: u16 = 4;
const CLEAR_ERROR: u16 = 16;
/// Bits of STATUS.
pub(crate) const READY: u16 = 1;
const TRIGGER_ACK: u16 = 2;
const BUSY: u16 = 4;
const RESULT_VALID: u16 = 0x10;
const CMD_DONE: u16 = 0x40;

/// Registers of STATUS are asked for this often.
const LOOK: Duration = Duration::from_millis(20);

/// What one vehicle came to, as the PLC reads it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Outcome {
    /// 1: ok.
    pub(crate) result: u16,
    /// 0: none.
    pub(crate) code: u16,
    /// mm and degrees; none unless measured.
    pub(crate) pose: Option<[f64; 6]>,
    /// Counts results.
    pub(crate) sequence: u16,
}

pub(crate) struct Plc {
    stream: TcpStream,
    beat: u16,
    held: u16,
}

impl Plc {
    /// Connects to a datum on this machine.
    pub(crate) fn connect() -> anyhow::Result<Self> {
        let stream = TcpStream::connect("127.0.0.1:5020").context("datum's Modbus server")?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(Duration::from_secs(10)))?;
        Ok(Self { stream, beat: 0, held: 0 })
    }

    fn ask(&mut self, pdu: &[u8]) -> anyhow::Result<Vec<u8>> {
        self.beat = self.beat.wrapping_add(1);
        let mut frame = self.beat.to_be_bytes().to_vec();
        frame.extend([0, 0]);
        frame.extend((1 + pdu.len() as u16).to_be_bytes());
        frame.push(1);
        frame.extend(pdu);
        self.stream.write_all(&frame)?;
        let mut header = [0; 7];
        self.stream.read_exact(&mut header).context("no answer")?;
        let mut answer = vec![0; usize::from(u16::from_be_bytes([header[4], header[5]])) - 1];
        self.stream.read_exact(&mut answer)?;
        ensure!(answer[0] == pdu[0], "exception {} to {pdu:?}", answer[1]);
        Ok(answer)
    }

    /// Input registers.
    pub(crate) fn input(&mut self, address: u16, quantity: u16) -> anyhow::Result<Vec<u16>> {
        let pdu = [&[4][..], &address.to_be_bytes(), &quantity.to_be_bytes()].concat();
        Ok(self.ask(&pdu)?[2..].chunks(2).map(|w| u16::from_be_bytes([w[0], w[1]])).collect())
    }

    /// CONTROL, PLC_HEARTBEAT and what follows.
    fn control(&mut self, bits: u16, parameters: &[u16]) -> anyhow::Result<()> {
        self.held = bits;
        let words: Vec<u16> = [&[bits, self.beat][..], parameters].concat();
        let mut pdu = vec![16, 0, 0, 0, words.len() as u8, 2 * words.len() as u8];
        pdu.extend(words.iter().flat_map(|w| w.to_be_bytes()));
        self.ask(&pdu).map(drop)
    }

    /// Waits until these bits of STATUS are set and those are not; how long that took.
    pub(crate) fn until(&mut self, set: u16, clear: u16, patience: Duration) -> anyhow::Result<Duration> {
        let began = Instant::now();
        loop {
            let seen = self.input(0, 5)?;
            if seen[0] & set == set && seen[0] & clear == 0 {
                return Ok(began.elapsed());
            }
            if began.elapsed() > patience {
                let [status, _, state, reason, code] = seen[..] else { unreachable!("five were asked for") };
                bail!(
                    "STATUS is {status:#06x} after {patience:?}, wanted {set:#06x} without {clear:#06x}; state {state}, \
                     not ready for {reason:#06x}, error {code}"
                );
            }
            self.control(self.held, &[])?; // a heartbeat
            std::thread::sleep(LOOK);
        }
    }

    /// Owns the station, and waits until it is ready.
    pub(crate) fn own(&mut self, patience: Duration) -> anyhow::Result<()> {
        self.control(ENABLE, &[])?;
        self.until(READY, 0, patience).map(drop)
    }

    /// Orders a vehicle of `job` to be measured; BUSY from then on.
    pub(crate) fn trigger(&mut self, id: u16, job: u16) -> anyhow::Result<()> {
        self.control(ENABLE | TRIGGER, &[0, id, job])?;
        self.until(TRIGGER_ACK, 0, Duration::from_secs(10))?;
        self.control(ENABLE, &[])
    }

    /// What the vehicle that was ordered, or that came by itself, came to; acknowledged.
    pub(crate) fn result(&mut self, patience: Duration) -> anyhow::Result<Outcome> {
        self.until(RESULT_VALID, TRIGGER_ACK | BUSY, patience)?;
        let r = self.input(0, 120)?;
        self.control(ENABLE | RESULT_ACK, &[])?;
        self.until(0, RESULT_VALID, Duration::from_secs(10))?;
        self.control(ENABLE, &[])?;
        let value = |k: usize| ((u32::from(r[k]) << 16) | u32::from(r[k + 1])).cast_signed();
        let pose = std::array::from_fn(|k| f64::from(value(17 + 2 * k)) * if k < 3 { 1e-3 } else { 1e-6 });
        let known = (0..6).all(|k| value(17 + 2 * k) != i32::MIN);
        Ok(Outcome { result: r[15], code: r[4], pose: known.then_some(pose), sequence: r[12] })
    }

    /// One vehicle through the whole handshake.
    pub(crate) fn measure(&mut self, id: u16, job: u16) -> anyhow::Result<Outcome> {
        if self.input(0, 1)?[0] & 0x100 != 0 {
            self.clear()?;
        }
        self.until(READY, 0, Duration::from_secs(30))?;
        self.trigger(id, job)?;
        self.result(Duration::from_secs(60))
    }

    /// Clears a latched error.
    pub(crate) fn clear(&mut self) -> anyhow::Result<()> {
        self.control(ENABLE | CLEAR_ERROR, &[])?;
        self.until(CMD_DONE, 0, Duration::from_secs(30))?;
        self.control(ENABLE, &[])?;
        self.until(0, CMD_DONE, Duration::from_secs(10)).map(drop)
    }

    /// What is in ERROR_CODE.
    pub(crate) fn error(&mut self) -> anyhow::Result<u16> {
        Ok(self.input(4, 1)?[0])
    }
}

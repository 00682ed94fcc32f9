//! Seven clients send random and mutated frames beside a well-behaved owner. By default some thousands, so that the
//! test stays short; `DATUM_FRAMES=1000000 cargo test --release --test modbus_fuzz -- --nocapture` for all of them.

#![expect(clippy::print_stdout, reason = "the owner's longest wait is to be read")]

#[path = "common/plc.rs"]
mod plc;

use plc::{Client, ENABLE, READY, RESULT_ACK, RESULT_VALID, TRIGGER, TRIGGER_ACK, good_station, patient, serve};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

const FRAMES: usize = 20_000;
const CLIENTS: usize = 7;

static PANICS: AtomicUsize = AtomicUsize::new(0);

#[test]
fn random_frames_beside_an_owner_panic_nothing_hang_nothing_and_write_nothing() {
    let told = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        PANICS.fetch_add(1, Ordering::Relaxed);
        told(info);
    }));
    let frames = std::env::var("DATUM_FRAMES").map_or(FRAMES, |n| n.parse().expect("DATUM_FRAMES is a number"));
    let server = serve(patient(), good_station);
    let address = server.local_addr();
    let mut owner = Client::connect(address);
    owner.write(0, &[ENABLE]);
    let fuzzers: Vec<_> = (0..CLIENTS as u64)
        .map(|seed| std::thread::spawn(move || fuzz(address, seed, frames.div_ceil(CLIENTS))))
        .collect();
    let (mut longest, mut asked, mut id) = (Duration::ZERO, 0, 0u32);
    while fuzzers.iter().any(|f| !f.is_finished()) {
        id += 1;
        let mut timed = |ask: &mut dyn FnMut(&mut Client)| {
            let began = Instant::now();
            ask(&mut owner);
            longest = longest.max(began.elapsed());
            asked += 1;
        };
        let [high, low] = [(id >> 16) as u16, id as u16];
        let words = [ENABLE | TRIGGER, low, high, low, 7];
        timed(&mut |o| assert_eq!(o.write(0, &words), 0));
        timed(&mut |o| assert_eq!(o.input(0, 1)[0] & TRIGGER_ACK, TRIGGER_ACK));
        timed(&mut |o| assert_eq!(o.holding(0, 64), [&words[..], &[0; 59]].concat()));
        timed(&mut |o| assert_eq!(o.write(0, &[ENABLE]), 0));
        // what the owner waits for here is the station, answer by answer
        while {
            let mut status = 0;
            timed(&mut |o| status = o.input(0, 1)[0]);
            status & RESULT_VALID == 0
        } {}
        timed(&mut |o| assert_eq!(o.input(13, 6), [high, low, 1, 0, high, low]));
        timed(&mut |o| assert_eq!(o.write(0, &[ENABLE | RESULT_ACK]), 0));
        timed(&mut |o| assert_eq!(o.write(0, &[ENABLE]), 0));
        timed(&mut |o| assert_eq!(o.input(0, 1)[0] & (READY | RESULT_VALID), READY));
    }
    let sent: usize = fuzzers.into_iter().map(|f| f.join().expect("a fuzzer does not panic")).sum();
    println!("{sent} frames; the owner asked {asked} times and waited at most {longest:?}");
    assert!(sent >= frames);
    assert_eq!(PANICS.load(Ordering::Relaxed), 0);
}

/// Sends `frames` frames over as many connections as that takes; returns how many were sent.
fn fuzz(address: SocketAddr, seed: u64, frames: usize) -> usize {
    let mut random = Random((seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let mut sent = 0;
    while sent < frames {
        let Ok(mut stream) = TcpStream::connect(address) else { continue };
        let mut back = stream.try_clone().expect("a second handle");
        let sink = std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while back.read(&mut buffer).is_ok_and(|n| n > 0) {}
        });
        while sent < frames {
            let frame = random.frame();
            sent += 1;
            if stream.write_all(&frame).is_err() {
                break;
            }
        }
        let _ = stream.shutdown(std::net::Shutdown::Both);
        sink.join().expect("a sink does not panic");
    }
    sent
}

/// Xorshift64* (Vigna 2016).
struct Random(u64);

impl Random {
    fn next(&mut self, below: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) % below
    }

    fn byte(&mut self) -> u8 {
        self.next(256) as u8
    }

    /// Mostly frames whose header is right, as others end the connection.
    fn frame(&mut self) -> Vec<u8> {
        let mut pdu = self.request();
        match self.next(4) {
            0 => {
                for _ in 0..=self.next(3) {
                    let at = self.next(pdu.len() as u64) as usize;
                    pdu[at] = self.byte();
                }
            }
            1 => pdu.truncate(1 + self.next(pdu.len() as u64) as usize),
            2 => pdu.extend((0..self.next(20)).map(|_| self.byte()).collect::<Vec<_>>()),
            _ => {}
        }
        pdu.truncate(253);
        let unit = [1, 1, 1, 0, 255, self.byte()][self.next(6) as usize];
        let length = (1 + pdu.len() as u16).to_be_bytes();
        let mut frame = vec![self.byte(), self.byte(), 0, 0, length[0], length[1], unit];
        frame.extend(pdu);
        if self.next(200) == 0 {
            match self.next(4) {
                0 => frame.truncate(self.next(frame.len() as u64) as usize), // what follows is its rest
                1 => frame = (0..self.next(300)).map(|_| self.byte()).collect(),
                _ => {
                    let at = 2 + self.next(4) as usize;
                    frame[at] = self.byte();
                }
            }
        }
        frame
    }

    fn request(&mut self) -> Vec<u8> {
        let address = [self.next(130), self.next(130), 1000 + self.next(130), self.next(65536)][self.next(4) as usize];
        let address = (address as u16).to_be_bytes();
        let quantity = [1, self.next(8), self.next(130), self.next(65536)][self.next(4) as usize] as u16;
        let [q0, q1] = quantity.to_be_bytes();
        let function = [1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43, self.byte()][self.next(12) as usize];
        let mut pdu = vec![function, address[0], address[1]];
        match function {
            5 => pdu.extend([[0, 0xFF][self.next(2) as usize], 0]),
            15 | 16 => {
                let bytes = if function == 15 { quantity.div_ceil(8) } else { 2 * (quantity & 0x7F) };
                pdu.extend([q0, q1, bytes as u8]);
                pdu.extend((0..bytes.min(255)).map(|_| self.byte()).collect::<Vec<_>>());
            }
            22 => pdu.extend([self.byte(), self.byte(), self.byte(), self.byte()]),
            23 => pdu.extend([q0, q1, 0, 0, 0, 1, 2, self.byte(), self.byte()]),
            43 => pdu = vec![43, 14, 1 + self.next(5) as u8, self.byte()],
            _ => pdu.extend([q0, q1]),
        }
        pdu
    }
}

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
    owner.wait(READY, 0); // the station has told how it is
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

/// How many frames a client sends before it waits until the server has answered them all.
const BATCH: usize = 64;
/// A sound read with a transaction number of its own: when it is answered, all before it has been dealt with.
const MARK: [u8; 12] = [0xFF, 0xFF, 0, 0, 0, 6, 1, 4, 1, 44, 0, 1];

/// Sends `frames` frames over as many connections as that takes, and sees all of them dealt with; returns how many.
fn fuzz(address: SocketAddr, seed: u64, frames: usize) -> usize {
    let mut random = Random((seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let mut sent = 0;
    while sent < frames {
        let mut stream = TcpStream::connect(address).expect("the server listens");
        stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
        let mut whole = true; // until a frame breaks the framing: then the server closes
        while whole && sent < frames {
            let mut batch = Vec::new();
            for _ in 0..BATCH {
                let (frame, sound) = random.frame();
                batch.extend(frame);
                sent += 1;
                whole = sound;
                if !whole {
                    break;
                }
            }
            batch.extend(MARK);
            let written = stream.write_all(&batch);
            assert!(written.is_ok() || !whole, "{written:?}");
            if !whole {
                let _ = stream.shutdown(std::net::Shutdown::Write);
            }
            let open = answered(&mut stream);
            assert!(open || !whole, "a connection whose frames are whole stays open");
            if !whole {
                let _ = stream.read_to_end(&mut Vec::new()); // until it is off the server's list
            }
        }
    }
    sent
}

/// Reads responses up to that to [`MARK`]; false: the server closed before.
fn answered(stream: &mut TcpStream) -> bool {
    let mut header = [0; 7];
    loop {
        match stream.read_exact(&mut header) {
            Ok(()) => {}
            Err(e) if e.kind() == std::io::ErrorKind::WouldBlock => panic!("the server hangs"),
            Err(_) => return false,
        }
        let mut body = vec![0; usize::from(u16::from_be_bytes([header[4], header[5]])) - 1];
        if stream.read_exact(&mut body).is_err() {
            return false;
        }
        if header[..2] == MARK[..2] {
            return true;
        }
    }
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

    /// A frame, and whether its header is right, as most are: others end the connection.
    fn frame(&mut self) -> (Vec<u8>, bool) {
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
        let mut frame = vec![self.byte() & 0x7F, self.byte(), 0, 0, length[0], length[1], unit];
        frame.extend(pdu);
        let sound = self.next(200) != 0;
        if !sound {
            match self.next(4) {
                0 => frame.truncate(self.next(frame.len() as u64) as usize), // what follows is its rest
                1 => frame = (0..self.next(300)).map(|_| self.byte()).collect(),
                _ => {
                    let at = 2 + self.next(4) as usize;
                    frame[at] = self.byte();
                }
            }
        }
        (frame, sound)
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

//! What tests of the PLC's side share: a raw Modbus client, and a station that is a thread and a function.

#![allow(dead_code, reason = "each test file uses a part")]

use datum::plc::{
    Config, Identity, ORDERS, Order, OrderKind, Outcome, PoseOutcome, Pulse, Report, ResultCode, Server, State, Status,
    Trigger,
};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

/// Longer than any answer takes, however loaded the machine.
const PATIENCE: Duration = Duration::from_secs(20);

pub(crate) const ENABLE: u16 = 1;
pub(crate) const TRIGGER: u16 = 2;
pub(crate) const RESULT_ACK: u16 = 4;
pub(crate) const READY: u16 = 1;
pub(crate) const TRIGGER_ACK: u16 = 2;
pub(crate) const BUSY: u16 = 4;
pub(crate) const RESULT_VALID: u16 = 0x10;
pub(crate) const PASS: u16 = 0x20;
pub(crate) const OWNER_OK: u16 = 0x400;

/// A client that sends bytes and nothing else.
pub(crate) struct Client {
    pub(crate) stream: TcpStream,
    transaction: u16,
}

impl Client {
    pub(crate) fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).expect("the server listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        stream.set_nodelay(true).expect("a socket");
        Self { stream, transaction: 0 }
    }

    pub(crate) fn send(&mut self, bytes: &[u8]) {
        self.stream.write_all(bytes).expect("the connection is open");
    }

    /// The unit and PDU of the next response; `None`: the server closed.
    pub(crate) fn receive(&mut self) -> Option<(u8, Vec<u8>)> {
        let mut header = [0; 7];
        match self.stream.read_exact(&mut header) {
            Ok(()) => {}
            Err(e) if matches!(e.kind(), std::io::ErrorKind::WouldBlock) => panic!("no answer in {PATIENCE:?}"),
            Err(_) => return None,
        }
        assert_eq!((&header[..2], &header[2..4]), (&self.transaction.to_be_bytes()[..], &[0, 0][..]));
        let mut pdu = vec![0; usize::from(u16::from_be_bytes([header[4], header[5]])) - 1];
        self.stream.read_exact(&mut pdu).expect("a whole response");
        Some((header[6], pdu))
    }

    /// A request to unit 1, and its response.
    pub(crate) fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        self.transaction = self.transaction.wrapping_add(1);
        let mut frame = self.transaction.to_be_bytes().to_vec();
        frame.extend([0, 0]);
        frame.extend((1 + pdu.len() as u16).to_be_bytes());
        frame.push(1);
        frame.extend(pdu);
        self.send(&frame);
        self.receive().expect("the connection stays").1
    }

    /// The exception that answers a request; 0: none.
    pub(crate) fn exception(&mut self, pdu: &[u8]) -> u8 {
        let answer = self.ask(pdu);
        if answer[0] == pdu[0] | 0x80 { answer[1] } else { 0 }
    }

    fn read(&mut self, function: u8, address: u16, quantity: u16) -> Vec<u16> {
        let pdu = [&[function][..], &address.to_be_bytes(), &quantity.to_be_bytes()].concat();
        let answer = self.ask(&pdu);
        assert_eq!((answer[0], usize::from(answer[1])), (function, 2 * usize::from(quantity)));
        answer[2..].chunks(2).map(|w| u16::from_be_bytes([w[0], w[1]])).collect()
    }

    pub(crate) fn input(&mut self, address: u16, quantity: u16) -> Vec<u16> {
        self.read(4, address, quantity)
    }

    pub(crate) fn holding(&mut self, address: u16, quantity: u16) -> Vec<u16> {
        self.read(3, address, quantity)
    }

    /// FC 16; the exception, 0: none.
    pub(crate) fn write(&mut self, address: u16, words: &[u16]) -> u8 {
        let mut pdu = vec![16];
        pdu.extend(address.to_be_bytes());
        pdu.extend((words.len() as u16).to_be_bytes());
        pdu.push(2 * words.len() as u8);
        pdu.extend(words.iter().flat_map(|w| w.to_be_bytes()));
        self.exception(&pdu)
    }

    /// Reads STATUS until these bits are set and those are not.
    pub(crate) fn wait(&mut self, set: u16, clear: u16) {
        let began = Instant::now();
        loop {
            let status = self.input(0, 1)[0];
            if status & set == set && status & clear == 0 {
                return;
            }
            assert!(began.elapsed() < PATIENCE, "STATUS stays {status:016b}, not {set:016b} without {clear:016b}");
            std::thread::yield_now();
        }
    }

    /// Parameters and TRIGGER in one write.
    pub(crate) fn trigger(&mut self, id: u32) {
        assert_eq!(self.write(0, &[ENABLE | TRIGGER, id as u16, (id >> 16) as u16, id as u16, 7]), 0);
    }

    /// One vehicle through the whole handshake, from READY to READY: the result's block.
    pub(crate) fn measure(&mut self, id: u32) -> Vec<u16> {
        self.wait(READY, TRIGGER_ACK);
        self.trigger(id);
        self.wait(TRIGGER_ACK, 0);
        self.write(0, &[ENABLE]);
        self.wait(RESULT_VALID, TRIGGER_ACK | BUSY);
        let block = self.input(0, 120);
        self.write(0, &[ENABLE | RESULT_ACK]);
        self.wait(0, RESULT_VALID);
        self.write(0, &[ENABLE]);
        self.wait(READY, RESULT_VALID);
        block
    }
}

/// What the station's thread says to an order.
pub(crate) fn good_station(order: &Order) -> Vec<Report> {
    match order {
        Order::Measure(trigger) => vec![Report::Acquired, Report::Finished(Box::new(outcome(trigger)))],
        Order::LoadJob { .. } => vec![Report::Done(OrderKind::LoadJob)],
        Order::Verify => vec![Report::Done(OrderKind::Verify)],
        Order::Abort => vec![Report::Done(OrderKind::Abort)],
        Order::ClearError => vec![Report::Done(OrderKind::ClearError)],
        Order::StandBy(_) | Order::Own(_) => vec![],
    }
}

/// A good result; x is the vehicle's id, in µm.
pub(crate) fn outcome(trigger: &Trigger) -> Outcome {
    Outcome {
        result: ResultCode::Ok,
        code: None,
        detail: 0,
        trigger: trigger.clone(),
        job: trigger.job,
        pose: Some(PoseOutcome {
            position_mm: [f64::from(trigger.id) * 1e-3, 2.0, 3.0],
            angles_deg: [0.1, 0.2, 0.3],
            u_position_mm: [0.05; 3],
            u_angles_deg: [0.01; 3],
            u_target_mm: Some(0.2),
            residual_rms_mm: 0.03,
        }),
        features: [None; 4],
        distance_deviation_mm: None,
        surface_vs_point_mm: None,
        depth_coverage: None,
        calibration_health_px: None,
        light: None,
        ambient: None,
        camera_celsius: None,
        projector_celsius: None,
        acquisition: None,
        total: None,
        taken_at_ms: 0,
        record: u64::from(trigger.id),
    }
}

/// A server on a free port over a station that is a function; the station's thread ends with the server.
pub(crate) fn serve(config: Config, mut station: impl FnMut(&Order) -> Vec<Report> + Send + 'static) -> Server {
    let (orders, to_do) = mpsc::sync_channel::<Order>(ORDERS);
    let (tell, reports) = mpsc::channel();
    let pulse = Arc::new(Pulse::default());
    let status = Status { state: State::Ready, calibration_valid: true, warm: true, ..Status::default() };
    tell.send(Report::Status(Box::new(status))).expect("the channel is open");
    let heart = pulse.clone();
    std::thread::spawn(move || {
        loop {
            heart.beat();
            match to_do.recv_timeout(Duration::from_millis(100)) {
                Ok(order) => station(&order).into_iter().for_each(|r| drop(tell.send(r))),
                Err(mpsc::RecvTimeoutError::Timeout) => {}
                Err(mpsc::RecvTimeoutError::Disconnected) => return,
            }
        }
    });
    let config = Config { listen: SocketAddr::from(([127, 0, 0, 1], 0)), ..config };
    let identity = Identity { serial: "SN-1".into(), version: "0.1.0".into(), ..Identity::default() };
    Server::start(config, identity, orders, reports, pulse).expect("a free port")
}

/// As [`serve`], with a heartbeat that a loaded machine keeps.
pub(crate) fn patient() -> Config {
    Config { heartbeat_timeout: Duration::from_secs(30), ..Config::default() }
}

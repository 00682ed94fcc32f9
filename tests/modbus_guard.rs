//! What a client can do wrong, through a socket: broken frames, too many connections, wrong addresses.

#[path = "common/plc.rs"]
mod plc;

use datum::plc::{CLIENTS, Config};
use plc::{Client, ENABLE, READY, good_station, patient, serve};
use std::time::{Duration, Instant};

/// A name; the bytes; the exception's PDU, or none: the connection is closed.
type Case = (&'static str, &'static [u8], Option<[u8; 2]>);

#[test]
fn broken_frames_are_answered_or_end_their_connection_and_nothing_else() {
    let server = serve(patient(), good_station);
    let mut owner = Client::connect(server.local_addr());
    owner.write(0, &[ENABLE]);
    let cases: [Case; 14] = [
        (
            "more coils than bytes, at which tokio-modbus panics",
            &[0, 1, 0, 0, 0, 8, 1, 0x0f, 0, 0, 0, 0x10, 1, 0xff],
            Some([0x8f, 3]),
        ),
        ("more registers than bytes", &[0, 1, 0, 0, 0, 9, 1, 0x10, 0, 0, 0, 2, 2, 0, 1], Some([0x90, 3])),
        ("a quantity that overflows", &[0, 1, 0, 0, 0, 9, 1, 0x10, 0, 0, 0x80, 1, 2, 0, 1], Some([0x90, 3])),
        ("a read of nothing", &[0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 0], Some([0x84, 3])),
        ("a read of 200 registers", &[0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 200], Some([0x84, 3])),
        ("a coil that is neither on nor off", &[0, 1, 0, 0, 0, 6, 1, 5, 0, 0, 0, 1], Some([0x85, 3])),
        ("a request cut short", &[0, 1, 0, 0, 0, 4, 1, 6, 0, 0], Some([0x86, 3])),
        ("an unknown function", &[0, 1, 0, 0, 0, 2, 1, 0x41], Some([0xC1, 1])),
        ("another protocol", &[0, 1, 0, 5, 0, 6, 1, 4, 0, 0, 0, 1], None),
        ("a length of 1", &[0, 1, 0, 0, 0, 1, 1], None),
        ("a length of 65535", &[0, 1, 0, 0, 0xFF, 0xFF, 1, 4], None),
        ("half a frame", &[0, 1, 0, 0, 0, 6, 1, 4, 0], None), // after a second
        ("TLS", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", None),
        ("text", b"GET / HTTP/1.1\r\n\r\n", None),
    ];
    for (name, bytes, answer) in cases {
        let mut client = Client::connect(server.local_addr());
        client.input(0, 1);
        client.send(bytes);
        let got = client.receive().map(|(_, pdu)| pdu);
        assert_eq!(got.as_deref(), answer.as_ref().map(|a| &a[..]), "{name}");
        if answer.is_some() {
            client.input(0, 1);
        }
    }
    assert_eq!(owner.holding(0, 64), [vec![ENABLE], vec![0; 63]].concat());
    owner.measure(5);
}

#[test]
fn many_requests_in_one_segment_are_answered_in_their_order() {
    let server = serve(patient(), good_station);
    let mut client = Client::connect(server.local_addr());
    let read = |address: u8| [0, 0, 0, 0, 0, 6, 1, 4, 1, address, 0, 1];
    let frames: Vec<u8> = (44..48).flat_map(read).collect(); // input 300 to 303
    let (head, tail) = frames.split_at(31);
    client.send(head);
    client.send(tail);
    let words = [0x5643u16, 1, 0, 0x1234];
    for word in words {
        let [high, low] = word.to_be_bytes();
        assert_eq!(client.receive(), Some((1, vec![4, 2, high, low])));
    }
}

#[test]
fn units_0_1_and_255_are_answered_and_others_are_not() {
    let server = serve(patient(), good_station);
    let mut client = Client::connect(server.local_addr());
    for unit in [0, 2, 7, 1, 247, 254, 255] {
        client.send(&[0, 0, 0, 0, 0, 6, unit, 4, 1, 44, 0, 1]);
    }
    for unit in [0, 1, 255] {
        assert_eq!(client.receive().map(|r| r.0), Some(unit));
    }
}

#[test]
fn what_does_not_exist_is_exception_2_and_a_gap_reads_0() {
    let server = serve(patient(), good_station);
    let mut client = Client::connect(server.local_addr());
    client.write(0, &[ENABLE]);
    for pdu in [
        &[4, 0, 0, 0, 121][..],
        &[4, 0, 120, 0, 1],
        &[4, 0xFF, 0xFF, 0, 2],
        &[3, 0, 63, 0, 2],
        &[3, 0, 64, 0, 1],
        &[3, 4, 0x5F, 0, 2],
        &[1, 0, 16, 0, 1],
        &[2, 0, 8, 0, 9],
        &[5, 0, 16, 0, 0],
        &[6, 0, 64, 0, 0],
        &[6, 3, 0xE8, 0, 0],
        &[15, 0, 15, 0, 2, 1, 0],
        &[16, 0, 63, 0, 2, 4, 0, 0, 0, 0],
        &[22, 0, 64, 0, 0, 0, 0],
        &[23, 0, 64, 0, 1, 0, 0, 0, 1, 2, 0, 0],
        &[23, 0, 0, 0, 1, 0, 64, 0, 1, 2, 0, 0],
        &[0x2B, 14, 4, 99],
    ] {
        assert_eq!(client.exception(pdu), 2, "{pdu:?}");
    }
    assert_eq!((client.input(110, 8), client.holding(17, 47)), (vec![0; 8], vec![0; 47]));
    assert_eq!(client.write(17, &[0; 47]), 0, "a gap takes zeros");
    assert_eq!((client.write(17, &[1]), client.input(4, 1)), (0, vec![103]));
}

#[test]
fn the_device_says_what_it_is() {
    let server = serve(patient(), good_station);
    let mut client = Client::connect(server.local_addr());
    let basic = b"\x2b\x0e\x01\x82\x00\x00\x03\x00\x05datum\x01\x05datum\x02\x050.1.0";
    assert_eq!(client.ask(&[0x2B, 14, 1, 0]), basic);
    let regular = client.ask(&[0x2B, 14, 2, 0]);
    assert_eq!((&regular[..7], regular[6]), (&b"\x2b\x0e\x02\x82\x00\x00\x07"[..], 7));
    assert_eq!(client.ask(&[0x2B, 14, 4, 5]), b"\x2b\x0e\x04\x82\x00\x00\x01\x05\x04SN-1");
}

#[test]
fn a_ninth_client_takes_the_place_of_the_longest_idle_that_is_not_the_owner() {
    let server = serve(patient(), good_station);
    let mut owner = Client::connect(server.local_addr());
    owner.write(0, &[ENABLE]);
    let mut others: Vec<Client> = (1..CLIENTS).map(|_| Client::connect(server.local_addr())).collect();
    for other in &mut others {
        other.input(0, 1);
    }
    others[0].input(0, 1); // now the second is the longest idle, but for the owner
    let mut ninth = Client::connect(server.local_addr());
    ninth.input(0, 1);
    assert_eq!(others[1].receive(), None);
    assert_eq!(server.view().clients.len(), CLIENTS);
    others.remove(1);
    owner.wait(READY, 0);
    for client in others.iter_mut().chain([&mut ninth, &mut owner]) {
        client.input(0, 1);
    }
}

#[test]
fn who_is_not_allowed_is_not_served() {
    let config = Config { allow: vec!["127.0.0.2".parse().expect("an address")], ..patient() };
    let server = serve(config, good_station);
    let mut client = Client::connect(server.local_addr());
    assert_eq!(client.receive(), None);
}

#[test]
fn what_cannot_be_served_is_told() {
    let server = serve(patient(), good_station);
    let start = |config: Config| {
        let (orders, _to_do) = std::sync::mpsc::sync_channel(1);
        let (_tell, reports) = std::sync::mpsc::channel();
        let pulse = std::sync::Arc::default();
        datum::plc::Server::start(config, datum::plc::Identity::default(), orders, reports, pulse).err()
    };
    let listen = server.local_addr();
    let said = start(Config { listen, ..patient() }).expect("the port is taken").to_string();
    assert_eq!(said, format!("plc.listen = {listen}: cannot listen there"));
    let said = start(Config { heartbeat_timeout: Duration::from_millis(499), ..patient() }).expect("too short");
    assert_eq!(said.to_string(), "plc.heartbeat_timeout = 499ms, allowed: 0.5 s to 30 s");
}

#[test]
fn a_client_that_sends_byte_by_byte_is_served() {
    let server = serve(patient(), good_station);
    let mut client = Client::connect(server.local_addr());
    let began = Instant::now();
    for byte in [0, 0, 0, 0, 0, 6, 1, 4, 1, 44, 0, 1] {
        client.send(&[byte]);
    }
    let answer = client.receive();
    assert!(answer == Some((1, vec![4, 2, 0x56, 0x43])) || began.elapsed() > Duration::from_secs(1), "{answer:?}");
}

//! The handshake through a socket: a client of bytes on one side, a station's thread on the other.

#[path = "common/plc.rs"]
mod plc;

use datum::plc::{Config, Order, Report, WordOrder};
use plc::{BUSY, Client, ENABLE, OWNER_OK, PASS, READY, RESULT_ACK, RESULT_VALID, TRIGGER_ACK};
use plc::{good_station, patient, serve};
use std::sync::mpsc;
use std::time::Duration;

#[test]
fn a_vehicle_goes_through_the_whole_handshake() {
    let server = serve(patient(), good_station);
    let mut client = Client::connect(server.local_addr());
    client.wait(READY, OWNER_OK);
    assert_eq!(client.write(0, &[ENABLE]), 0);
    client.wait(READY | OWNER_OK, 0);
    for id in [0x0001_0005, 6, 7] {
        let (block, [high, low]) = (client.measure(id), [(id >> 16) as u16, id as u16]);
        assert_eq!(block[0] & (RESULT_VALID | PASS), RESULT_VALID | PASS);
        assert_eq!([block[13], block[14], block[17], block[18]], [high, low, high, low]);
        assert_eq!((block[12], block[15]), (block[119], 1));
        let bytes: Vec<u8> = block[12..109].iter().flat_map(|w| w.to_be_bytes()).collect();
        assert_eq!(block[118], crc::Crc::<u16>::new(&crc::CRC_16_MODBUS).checksum(&bytes));
    }
    assert_eq!(client.holding(1012, 107), client.input(12, 107));
}

#[test]
fn the_answer_to_a_trigger_is_there_with_the_response_to_its_write() {
    let (go, wait) = mpsc::channel::<()>();
    let server = serve(patient(), move |order| {
        if matches!(order, Order::Measure(_)) {
            wait.recv().expect("the test is there");
        }
        good_station(order)
    });
    let mut client = Client::connect(server.local_addr());
    client.write(0, &[ENABLE]);
    client.wait(READY, 0);
    client.trigger(5);
    let status = client.input(0, 1)[0];
    assert_eq!(status & (TRIGGER_ACK | BUSY | READY), TRIGGER_ACK | BUSY, "however long the station takes");
    go.send(()).expect("the station is there");
    client.wait(RESULT_VALID, BUSY);
}

#[test]
fn a_plc_that_lost_the_reply_reconnects_and_acknowledges_its_vehicle() {
    let server = serve(patient(), good_station);
    let mut client = Client::connect(server.local_addr());
    client.write(0, &[ENABLE]);
    client.wait(READY, 0);
    client.trigger(5);
    drop(client);
    let mut client = Client::connect(server.local_addr());
    client.wait(RESULT_VALID, OWNER_OK | BUSY);
    let before = client.input(12, 97);
    assert_eq!(before[1..3], [0, 5]);
    // its outputs still hold the trigger: that counts for nothing; the same trigger again starts nothing
    client.trigger(5);
    client.wait(OWNER_OK, TRIGGER_ACK | BUSY);
    client.write(0, &[ENABLE]);
    client.trigger(5);
    client.wait(TRIGGER_ACK | RESULT_VALID | PASS, BUSY);
    assert_eq!(client.input(12, 97), before);
    client.write(0, &[ENABLE | RESULT_ACK]);
    client.write(0, &[ENABLE]);
    client.wait(READY, RESULT_VALID);
}

#[test]
fn of_two_clients_the_first_that_enables_owns_and_the_other_reads() {
    let server = serve(patient(), good_station);
    let [mut one, mut two] = [0; 2].map(|_| Client::connect(server.local_addr()));
    assert_eq!(two.write(2, &[0, 9]), 6, "nobody owns, and it does not enable");
    assert_eq!(one.write(0, &[ENABLE]), 0);
    assert_eq!(two.write(0, &[ENABLE]), 6);
    for write in [
        &[5, 0, 1, 0xFF, 0][..],
        &[6, 0, 0, 0, 3],
        &[15, 0, 0, 0, 2, 1, 3],
        &[22, 0, 0, 0, 0, 0, 3],
        &[23, 0, 0, 0, 1, 0, 0, 0, 1, 2, 0, 3],
    ] {
        assert_eq!(two.exception(write), 6);
    }
    assert_eq!(two.holding(0, 1), [ENABLE]);
    assert_eq!(server.view().owner, Some(one.stream.local_addr().expect("connected")));
    let block = one.measure(5);
    assert_eq!(two.input(12, 97), block[12..109]);
    drop(one);
    two.wait(0, OWNER_OK);
    assert_eq!(two.write(0, &[ENABLE]), 0);
    assert_eq!(two.measure(6)[14], 6);
}

#[test]
fn coils_masks_and_single_registers_drive_the_same_handshake() {
    let server = serve(patient(), good_station);
    let mut client = Client::connect(server.local_addr());
    assert_eq!(client.exception(&[5, 0, 0, 0xFF, 0]), 0); // coil 0: ENABLE
    client.wait(OWNER_OK | READY, 0);
    assert_eq!(client.write(2, &[0, 5]), 0);
    assert_eq!(client.ask(&[15, 0, 1, 0, 1, 1, 1]), [15, 0, 1, 0, 1]); // coil 1: TRIGGER
    client.wait(RESULT_VALID | TRIGGER_ACK, BUSY);
    assert_eq!(client.ask(&[2, 0, 4, 0, 1]), [2, 1, 1]); // discrete input 4: RESULT_VALID
    assert_eq!(client.ask(&[1, 0, 0, 0, 16]), [1, 2, 3, 0]);
    assert_eq!(client.ask(&[22, 0, 0, 0xFF, 0xFD, 0, 4]), [22, 0, 0, 0xFF, 0xFD, 0, 4]);
    client.wait(RESULT_VALID, TRIGGER_ACK);
    assert_eq!(client.ask(&[6, 0, 0, 0, 5]), [6, 0, 0, 0, 5]); // RESULT_ACK
    let answer = client.ask(&[23, 3, 0xE8, 0, 1, 0, 0, 0, 1, 2, 0, 1]); // ENABLE alone, and STATUS of the mirror
    assert_eq!(answer[..2], [23, 2]);
    client.wait(READY, RESULT_VALID);
}

#[test]
fn a_station_whose_pulse_stops_stops_the_heartbeat_and_the_server_lives() {
    let (go, wait) = mpsc::channel::<()>();
    let config = Config { patience: Duration::from_millis(300), ..patient() };
    let server = serve(config, move |order| {
        if matches!(order, Order::Measure(_)) {
            wait.recv().expect("the test is there"); // hangs
        }
        good_station(order)
    });
    let mut client = Client::connect(server.local_addr());
    client.write(0, &[ENABLE]);
    client.wait(READY, 0);
    let differs = |client: &mut Client, from: u16| {
        let began = std::time::Instant::now();
        while began.elapsed() < Duration::from_secs(20) {
            if client.input(1, 1)[0] != from {
                return;
            }
            std::thread::yield_now();
        }
        panic!("DEVICE_HEARTBEAT stays {from}");
    };
    differs(&mut client, 0);
    client.trigger(5);
    let mut quiet = (client.input(1, 1)[0], std::time::Instant::now());
    while quiet.1.elapsed() < Duration::from_millis(600) {
        let beat = client.input(1, 1)[0]; // until it has stood still for three beats
        if beat != quiet.0 {
            quiet = (beat, std::time::Instant::now());
        }
    }
    go.send(()).expect("the station is there");
    differs(&mut client, quiet.0);
    client.wait(RESULT_VALID, BUSY);
}

#[test]
fn a_lost_heartbeat_releases_the_ownership_through_the_socket_too() {
    let config = Config { heartbeat_timeout: Duration::from_millis(500), ..Config::default() };
    let server = serve(config, good_station);
    let mut client = Client::connect(server.local_addr());
    client.write(0, &[ENABLE]);
    client.wait(0, OWNER_OK);
    assert_eq!(client.input(4, 1), [123]);
    assert_eq!((client.write(0, &[ENABLE]), client.write(0, &[ENABLE, 9])), (6, 0));
    assert_eq!(server.view().heartbeat_losses, 1);
}

#[test]
fn the_word_order_is_the_configured_one_and_the_test_block_shows_it() {
    let server = serve(Config { word_order: WordOrder::LowFirst, ..patient() }, good_station);
    let mut client = Client::connect(server.local_addr());
    let block = [0x5643, 1, 0, 0x1234, 0x0304, 0x0102, 0x1DC0, 0xFFFE, 0xE979, 0x42F6, 0x4142, 0x4344];
    assert_eq!(client.input(300, 12), block);
    client.write(0, &[ENABLE]);
    client.wait(READY, 0);
    client.write(0, &[ENABLE | plc::TRIGGER, 1, 5, 1]); // id 0x00010005
    client.wait(RESULT_VALID, BUSY);
    assert_eq!(client.input(13, 6), [5, 1, 1, 0, 5, 1], "id, code, mask, x in µm");
}

#[test]
fn dropping_the_server_ends_the_station_and_frees_the_port() {
    let (gone, ended) = mpsc::channel::<()>();
    let server = serve(patient(), move |order: &Order| -> Vec<Report> {
        let _held = &gone; // dropped with the station
        good_station(order)
    });
    let address = server.local_addr();
    let mut client = Client::connect(address);
    client.write(0, &[ENABLE]);
    client.measure(5);
    drop(server);
    assert_eq!(client.receive(), None);
    assert_eq!(ended.recv(), Err(mpsc::RecvError), "the station's thread has ended");
    std::net::TcpListener::bind(address).expect("the port is free");
}

//! File descriptors run out, and come back. In a process of its own, as the limit is the process's.

#[path = "common/plc.rs"]
mod plc;

use plc::{Client, ENABLE, good_station, patient, serve};
use std::fs::File;
use std::process::Command;

const CHILD: &str = "DATUM_TEST_FEW_DESCRIPTORS";

#[test]
fn the_server_comes_back_when_file_descriptors_were_exhausted() {
    let this = std::env::current_exe().expect("this program");
    let child = Command::new("sh")
        .args(["-c", "ulimit -n 64; exec \"$0\" --exact few_descriptors --nocapture"])
        .arg(this)
        .env(CHILD, "1")
        .output()
        .expect("a shell");
    let said = String::from_utf8_lossy(&child.stdout);
    assert!(child.status.success() && said.contains("1 passed"), "{said}{}", String::from_utf8_lossy(&child.stderr));
}

/// Passes at once unless it is run as above.
#[test]
fn few_descriptors() {
    if std::env::var_os(CHILD).is_none() {
        return;
    }
    let server = serve(patient(), good_station);
    let mut owner = Client::connect(server.local_addr());
    owner.write(0, &[ENABLE]);
    let mut files = Vec::new();
    while let Ok(file) = File::open("/dev/null") {
        files.push(file);
    }
    assert!(files.len() > 10, "the limit is higher than the server needs");
    files.pop(); // one for the client's end; none is left for the server's
    let mut waits = Client::connect(server.local_addr());
    assert!(File::open("/dev/null").is_err());
    waits.send(&[0, 0, 0, 0, 0, 6, 1, 4, 1, 44, 0, 1]);
    for id in 1..100 {
        owner.measure(id); // who is connected is served
    }
    assert_eq!(server.view().clients.len(), 1, "the other could not be taken");
    drop(files);
    assert_eq!(waits.receive(), Some((1, vec![4, 2, 0x56, 0x43])));
    Client::connect(server.local_addr()).input(0, 1);
}

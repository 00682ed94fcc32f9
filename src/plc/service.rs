//! What a sound request is answered. In: a request, the newest snapshot, who asks. Out: the PDU of the response, or an
//! exception; writes go to the handshake.
//! Not here: soundness of the request (the guard), what a write means (the handshake).

use super::exchange::Identity;
use super::guard::{Frame, HEADER, request};
use super::handshake::ClientId;
use super::registers::{BITS, CONTROL, HOLDING};
use super::shared::{NotOwner, Shared};
use super::snapshot::NoSuchRegister;
use tokio_modbus::{ExceptionCode, Request};

impl From<NoSuchRegister> for ExceptionCode {
    fn from(_: NoSuchRegister) -> Self {
        Self::IllegalDataAddress
    }
}

impl From<NotOwner> for ExceptionCode {
    fn from(_: NotOwner) -> Self {
        Self::ServerDeviceBusy
    }
}

/// The frame that answers `frame`; and whether it is the exception for a write by who does not own the command block.
pub(super) fn reply(shared: &Shared, client: ClientId, frame: &Frame) -> (Vec<u8>, bool) {
    let answer = request(&frame.pdu).and_then(|r| answer(shared, client, r));
    let function = frame.pdu[0];
    let not_owner = answer == Err(ExceptionCode::ServerDeviceBusy);
    let pdu = match answer {
        Ok(data) => [&[function], &data[..]].concat(),
        Err(exception) => vec![function | 0x80, exception.into()],
    };
    let length = u16::try_from(1 + pdu.len()).expect("a PDU has at most 253 bytes").to_be_bytes();
    let mut bytes = Vec::with_capacity(HEADER + pdu.len());
    bytes.extend([frame.transaction, [0, 0], length].concat());
    bytes.push(frame.unit);
    bytes.extend(pdu);
    (bytes, not_owner)
}

/// The response's data, after the function code.
fn answer(shared: &Shared, client: ClientId, request: Request) -> Result<Vec<u8>, ExceptionCode> {
    let newest = shared.newest();
    Ok(match request {
        Request::ReadCoils(address, quantity) => of_bits(&newest.coils(address, quantity)?),
        Request::ReadDiscreteInputs(address, quantity) => of_bits(&newest.discrete_inputs(address, quantity)?),
        Request::ReadHoldingRegisters(address, quantity) => of_words(newest.holding(address, quantity)?),
        Request::ReadInputRegisters(address, quantity) => of_words(newest.input(address, quantity)?),
        Request::WriteSingleCoil(address, on) => {
            write_coils(shared, client, address, &[on])?;
            data([address, if on { 0xFF00 } else { 0 }])
        }
        Request::WriteMultipleCoils(address, coils) => {
            write_coils(shared, client, address, &coils)?;
            data([address, coils.len() as u16])
        }
        Request::WriteSingleRegister(address, word) => {
            write(shared, client, address, &[word])?;
            data([address, word])
        }
        Request::WriteMultipleRegisters(address, words) => {
            write(shared, client, address, &words)?;
            data([address, words.len() as u16])
        }
        Request::MaskWriteRegister(address, and, or) => {
            writable(address, 1, HOLDING)?;
            shared.modify(client, address, |word| (word & and) | (or & !and))?;
            data([address, and, or])
        }
        Request::ReadWriteMultipleRegisters(address, quantity, write_address, words) => {
            newest.holding(address, quantity)?; // nothing is written if it cannot be read
            write(shared, client, write_address, &words)?;
            of_words(shared.newest().holding(address, quantity)?)
        }
        Request::ReadDeviceIdentification(code, object) => identification(shared.identity(), code.value(), object)?,
        Request::ReportServerId | Request::Custom(..) => return Err(ExceptionCode::IllegalFunction),
    })
}

fn writable(address: u16, quantity: usize, end: u16) -> Result<(), NoSuchRegister> {
    if usize::from(address) + quantity <= usize::from(end) { Ok(()) } else { Err(NoSuchRegister) }
}

fn write(shared: &Shared, client: ClientId, address: u16, words: &[u16]) -> Result<(), ExceptionCode> {
    writable(address, words.len(), HOLDING)?;
    Ok(shared.write(client, address, words)?)
}

fn write_coils(shared: &Shared, client: ClientId, address: u16, coils: &[bool]) -> Result<(), ExceptionCode> {
    writable(address, coils.len(), BITS)?;
    let set = |word, (bit, on): (u16, &bool)| if *on { word | 1 << bit } else { word & !(1 << bit) };
    Ok(shared.modify(client, CONTROL, |word| (address..).zip(coils).fold(word, set))?)
}

/// Words, high byte first.
fn data<const N: usize>(words: [u16; N]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_be_bytes()).collect()
}

/// A byte count and the registers; at most 125.
fn of_words(words: &[u16]) -> Vec<u8> {
    let count = std::iter::once((2 * words.len()) as u8);
    count.chain(words.iter().flat_map(|w| w.to_be_bytes())).collect()
}

/// A byte count and the bits, the first in the lowest place.
fn of_bits(bits: &[bool]) -> Vec<u8> {
    let byte = |eight: &[bool]| eight.iter().rev().fold(0, |byte, on| byte << 1 | u8::from(*on));
    std::iter::once(bits.len().div_ceil(8) as u8).chain(bits.chunks(8).map(byte)).collect()
}

/// Device identification, basic and regular objects. Application Protocol §6.21.
fn identification(identity: &Identity, code: u8, object: u8) -> Result<Vec<u8>, ExceptionCode> {
    const BASIC: u8 = 1;
    const INDIVIDUAL: u8 = 4;
    const BASIC_OBJECTS: usize = 3;
    /// Regular identification, as a stream and one by one.
    const CONFORMITY: u8 = 0x82;
    let objects: [&str; 7] = [
        "datum", // vendor
        "datum", // product code
        &identity.version,
        "", // vendor's address: none
        "datum vehicle-frame appliance",
        &identity.serial, // model name: this appliance's own
        "",
    ];
    let from = usize::from(object);
    let range = match (code, from < objects.len()) {
        (INDIVIDUAL, true) => from..from + 1,
        (INDIVIDUAL, false) => return Err(ExceptionCode::IllegalDataAddress),
        _ => {
            let end = if code == BASIC { BASIC_OBJECTS } else { objects.len() };
            if from < end { from..end } else { 0..end }
        }
    };
    // all fit one frame, so none follow
    let mut bytes = vec![14, code, CONFORMITY, 0, 0, range.len() as u8];
    for id in range {
        let text = &objects[id].as_bytes()[..objects[id].len().min(64)];
        bytes.extend([id as u8, text.len() as u8]);
        bytes.extend(text);
    }
    Ok(bytes)
}

//! The guard before the protocol: whole frames and sound requests only.
//! In:  bytes from a client. Out: frames; of each its request, or the exception that answers it.
//! Not here: which addresses exist, who may write (the service).
//!
//! tokio-modbus decodes a request only after everything here has been checked: its decoder panics or closes the
//! connection on counts that do not agree (tokio-modbus issue 298). Its server is not used: it ends when `accept` fails,
//! and takes every connection with it.
//! Modbus Messaging on TCP/IP V1.0b §3.1.3; Modbus Application Protocol V1.1b3 §6.

use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio_modbus::{ExceptionCode, Request, bytes::Bytes};

/// A frame that has begun must be whole in this time.
const WHOLE: Duration = Duration::from_secs(1);
/// Transaction, protocol, length, unit.
pub(super) const HEADER: usize = 7;
/// The largest frame: header and a PDU of 253 bytes.
const FRAME: usize = HEADER + 253;
/// What FC 43 is for here: read device identification.
const DEVICE_IDENTIFICATION: u8 = 14;

/// A whole frame.
#[derive(Debug, PartialEq)]
pub(super) struct Frame {
    pub(super) transaction: [u8; 2],
    pub(super) unit: u8,
    /// 1 to 253 bytes.
    pub(super) pdu: Bytes,
}

/// Why a connection cannot go on: where the next frame begins is no longer known.
#[derive(Debug, thiserror::Error)]
pub(super) enum Broken {
    #[error("protocol id {0}, allowed: 0")]
    Protocol(u16),
    #[error("length {0}, allowed: 2 to 254")]
    Length(u16),
    #[error("{0} bytes of a frame, and no more for {WHOLE:?}")]
    Partial(usize),
    #[error("closed after {0} bytes of a frame")]
    Closed(usize),
    #[error("reading failed")]
    Read(#[from] std::io::Error),
}

/// Cuts a stream into frames.
pub(super) struct Reader {
    buffer: [u8; FRAME],
    filled: usize,
}

impl Reader {
    pub(super) fn new() -> Self {
        Self { buffer: [0; FRAME], filled: 0 }
    }

    /// The next frame; `None`: the client closed between two frames.
    pub(super) async fn next(&mut self, stream: &mut (impl AsyncRead + Unpin)) -> Result<Option<Frame>, Broken> {
        if self.filled == 0 && self.fill(stream).await? == 0 {
            return Ok(None);
        }
        match tokio::time::timeout(WHOLE, self.complete(stream)).await {
            Ok(frame) => frame.map(Some),
            Err(_) => Err(Broken::Partial(self.filled)),
        }
    }

    async fn complete(&mut self, stream: &mut (impl AsyncRead + Unpin)) -> Result<Frame, Broken> {
        loop {
            if let Some((frame, used)) = cut(&self.buffer[..self.filled])? {
                self.buffer.copy_within(used..self.filled, 0);
                self.filled -= used;
                return Ok(frame);
            }
            if self.fill(stream).await? == 0 {
                return Err(Broken::Closed(self.filled));
            }
        }
    }

    async fn fill(&mut self, stream: &mut (impl AsyncRead + Unpin)) -> Result<usize, Broken> {
        let read = stream.read(&mut self.buffer[self.filled..]).await?;
        self.filled += read;
        Ok(read)
    }
}

/// The frame at the beginning of `bytes` and its length; `None`: more is to come.
fn cut(bytes: &[u8]) -> Result<Option<(Frame, usize)>, Broken> {
    let [t0, t1, p0, p1, l0, l1, rest @ ..] = bytes else { return Ok(None) };
    let (protocol, length) = (u16::from_be_bytes([*p0, *p1]), u16::from_be_bytes([*l0, *l1]));
    if protocol != 0 {
        return Err(Broken::Protocol(protocol));
    }
    if !(2..=254).contains(&length) {
        return Err(Broken::Length(length));
    }
    let Some(body) = rest.get(..usize::from(length)) else { return Ok(None) };
    let frame = Frame { transaction: [*t0, *t1], unit: body[0], pdu: Bytes::copy_from_slice(&body[1..]) };
    Ok(Some((frame, bytes.len() - rest.len() + body.len())))
}

/// The request in a PDU, if all its numbers agree with each other and with the protocol's limits.
pub(super) fn request(pdu: &Bytes) -> Result<Request<'static>, ExceptionCode> {
    let word = |at: usize| Some(u16::from_be_bytes([*pdu.get(at)?, *pdu.get(at + 1)?]));
    let quantity = |at: usize, most: u16| word(at).filter(|q| (1..=most).contains(q)).map(usize::from);
    // a byte count at `at` that says `bytes`, and as many bytes after it
    let followed_by = |at: usize, bytes: usize| {
        pdu.get(at).is_some_and(|count| usize::from(*count) == bytes) && pdu.len() == at + 1 + bytes
    };
    let sound = match pdu.first().copied().unwrap_or(0) {
        1 | 2 => pdu.len() == 5 && quantity(3, 2000).is_some(),
        3 | 4 => pdu.len() == 5 && quantity(3, 125).is_some(),
        5 => pdu.len() == 5 && matches!(word(3), Some(0 | 0xFF00)),
        6 => pdu.len() == 5,
        15 => quantity(3, 1968).is_some_and(|q| followed_by(5, q.div_ceil(8))),
        16 => quantity(3, 123).is_some_and(|q| followed_by(5, 2 * q)),
        22 => pdu.len() == 7,
        23 => quantity(3, 125).and(quantity(7, 121)).is_some_and(|q| followed_by(9, 2 * q)),
        0x2B if pdu.get(1) == Some(&DEVICE_IDENTIFICATION) => pdu.len() == 4 && (1..=4).contains(&pdu[2]),
        _ => return Err(ExceptionCode::IllegalFunction),
    };
    if !sound {
        return Err(ExceptionCode::IllegalDataValue);
    }
    Request::try_from(pdu.clone()).map_err(|_| ExceptionCode::IllegalDataValue)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stream that is read a few bytes at a time.
    async fn frames(bytes: &[u8], at_once: usize) -> (Vec<Frame>, Option<Broken>) {
        let mut stream = tokio_pieces(bytes, at_once);
        let (mut reader, mut frames) = (Reader::new(), Vec::new());
        loop {
            match reader.next(&mut stream).await {
                Ok(Some(frame)) => frames.push(frame),
                Ok(None) => return (frames, None),
                Err(e) => return (frames, Some(e)),
            }
        }
    }

    fn tokio_pieces(bytes: &[u8], at_once: usize) -> impl AsyncRead + Unpin + '_ {
        struct Pieces<'a>(&'a [u8], usize);
        impl AsyncRead for Pieces<'_> {
            fn poll_read(
                mut self: std::pin::Pin<&mut Self>,
                _: &mut std::task::Context<'_>,
                into: &mut tokio::io::ReadBuf<'_>,
            ) -> std::task::Poll<std::io::Result<()>> {
                let (now, later) = self.0.split_at(self.1.min(self.0.len()).min(into.remaining()));
                into.put_slice(now);
                self.0 = later;
                std::task::Poll::Ready(Ok(()))
            }
        }
        Pieces(bytes, at_once)
    }

    fn run<T>(future: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build();
        runtime.expect("a runtime").block_on(future)
    }

    const READ: [u8; 12] = [0, 7, 0, 0, 0, 6, 1, 4, 0, 0, 0, 120];

    #[test]
    fn frames_are_cut_however_the_bytes_come() {
        let stream = [READ, READ, READ].concat();
        for at_once in [1, 5, 12, 13, 36] {
            let (frames, end) = run(frames(&stream, at_once));
            assert!(frames.len() == 3 && end.is_none(), "{at_once}: {frames:?} {end:?}");
            assert_eq!((frames[2].transaction, frames[2].unit, &frames[2].pdu[..]), ([0, 7], 1, &READ[7..]));
        }
    }

    #[test]
    fn a_header_that_cannot_be_true_ends_the_connection_at_once() {
        for (bytes, message) in [
            ([0, 0, 0, 9, 0, 6], "protocol id 9, allowed: 0"),
            ([0, 0, 0, 0, 0, 1], "length 1, allowed: 2 to 254"),
            ([0, 0, 0, 0, 0, 0], "length 0, allowed: 2 to 254"),
            ([0, 0, 0, 0, 0xFF, 0xFF], "length 65535, allowed: 2 to 254"),
            ([0, 0, 0, 0, 0, 255], "length 255, allowed: 2 to 254"),
            ([0, 0, 0, 0, 0, 6], "closed after 6 bytes of a frame"),
        ] {
            let (frames, end) = run(frames(&bytes, 100));
            assert!(frames.is_empty() && end.is_some_and(|e| e.to_string() == message), "{message}");
        }
    }

    #[test]
    fn a_request_whose_numbers_disagree_is_answered_by_an_exception() {
        use ExceptionCode::{IllegalDataValue, IllegalFunction};
        let of = |bytes: &[u8]| request(&Bytes::copy_from_slice(bytes));
        for (bytes, exception) in [
            (&[0x0f, 0, 0, 0, 0x10, 1, 0xff][..], IllegalDataValue), // the frame that makes tokio-modbus panic
            (&[0x0f, 0, 0, 0, 0, 0], IllegalDataValue),
            (&[0x10, 0, 0, 0x80, 0, 0], IllegalDataValue), // quantity · 2 overflows
            (&[0x10, 0, 0, 0, 2, 4, 0, 1], IllegalDataValue),
            (&[0x10, 0, 0, 0, 1, 2, 0, 1, 9], IllegalDataValue),
            (&[3, 0, 0, 0, 0], IllegalDataValue),
            (&[4, 0, 0, 0, 200], IllegalDataValue),
            (&[4, 0, 0, 0], IllegalDataValue),
            (&[1, 0, 0, 0x07, 0xD1], IllegalDataValue),
            (&[5, 0, 0, 0, 1], IllegalDataValue),
            (&[6, 0, 0], IllegalDataValue),
            (&[22, 0, 0, 0, 0], IllegalDataValue),
            (&[23, 0, 0, 0, 1, 0, 0, 0, 1, 3, 0, 1], IllegalDataValue),
            (&[23, 0, 0, 0, 126, 0, 0, 0, 1, 2, 0, 1], IllegalDataValue),
            (&[0x2B, 14, 5, 0], IllegalDataValue),
            (&[0x2B, 13, 0, 0], IllegalFunction),
            (&[0x2B], IllegalFunction),
            (&[0], IllegalFunction),
            (&[7], IllegalFunction),
            (&[17], IllegalFunction),
            (&[0x90, 0, 0], IllegalFunction),
        ] {
            assert_eq!(of(bytes), Err(exception), "{bytes:02x?}");
        }
        assert_eq!(of(&[0x0f, 0, 1, 0, 2, 1, 3]), Ok(Request::WriteMultipleCoils(1, vec![true, true].into())));
        assert_eq!(
            of(&[23, 0, 0, 0, 125, 0, 1, 0, 1, 2, 0, 9]),
            Ok(Request::ReadWriteMultipleRegisters(0, 125, 1, vec![9].into()))
        );
    }

    #[test]
    fn whatever_passes_is_decoded_and_nothing_panics() {
        arbtest::arbtest(|u| {
            let mut pdu: Vec<u8> = u.arbitrary()?;
            pdu.truncate(253);
            if let Some(first) = pdu.first_mut() {
                *first = *u.choose(&[1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43, *first])?;
            }
            let pdu = Bytes::from(pdu);
            if let Ok(request) = request(&pdu) {
                assert_eq!(request.function_code().value(), pdu[0], "{pdu:02x?}");
            }
            Ok(())
        });
    }
}

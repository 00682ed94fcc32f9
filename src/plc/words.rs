//! Values as 16-bit words. In: numbers and texts. Out: words in the order the PLC wants, and back; CRC-16.
//! Not here: which register has which value.

/// Which word of a 32- or 64-bit value comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum WordOrder {
    /// The high word.
    #[default]
    HighFirst,
    /// The low word.
    LowFirst,
}

impl WordOrder {
    /// `words`, high word first, in this order; and back.
    fn arrange<const N: usize>(self, mut words: [u16; N]) -> [u16; N] {
        if self == Self::LowFirst {
            words.reverse();
        }
        words
    }

    /// Two words.
    pub(super) fn of_u32(self, value: u32) -> [u16; 2] {
        self.arrange([(value >> 16) as u16, value as u16])
    }

    /// Four words.
    pub(super) fn of_u64(self, value: u64) -> [u16; 4] {
        self.arrange([48, 32, 16, 0].map(|shift| (value >> shift) as u16))
    }

    /// What two words say.
    pub(super) fn u32(self, words: [u16; 2]) -> u32 {
        let [high, low] = self.arrange(words);
        u32::from(high) << 16 | u32::from(low)
    }
}

/// `text` as words, the first character in the high byte, cut or filled with NUL.
pub(super) fn of_text(text: &str, words: usize) -> Vec<u16> {
    let mut bytes = text.bytes().map(u16::from).chain(std::iter::repeat(0));
    let mut next = || bytes.next().expect("repeats without end");
    (0..words).map(|_| next() << 8 | next()).collect()
}

/// The text in `words` up to its first NUL, at most `N` characters; what is not printable ASCII becomes '?'.
pub(super) fn text<const N: usize>(words: &[u16]) -> heapless::String<N> {
    let bytes = words.iter().flat_map(|w| w.to_be_bytes()).take_while(|b| *b != 0).take(N);
    bytes.map(|b| if (0x20..0x7F).contains(&b) { char::from(b) } else { '?' }).collect()
}

/// A quantity as a whole number of `unit`s; saturates at 65534, as 65535 means unknown. A number that is none is unknown.
pub(super) fn count(value: f64, unit: f64) -> Option<u16> {
    let n = (value / unit).round();
    (n >= 0.0).then(|| n.min(65534.0) as u16)
}

/// A quantity as a whole number of `unit`s, unknown where it does not fit.
pub(super) fn signed32(value: f64, unit: f64) -> Option<i32> {
    let n = (value / unit).round();
    (n.abs() <= f64::from(i32::MAX)).then_some(n as i32)
}

/// A quantity as a whole number of `unit`s, unknown where it does not fit.
pub(super) fn signed16(value: f64, unit: f64) -> Option<i16> {
    let n = (value / unit).round();
    (n.abs() <= f64::from(i16::MAX)).then_some(n as i16)
}

/// CRC-16/MODBUS over words, each high byte first.
pub(super) fn crc16(words: &[u16]) -> u16 {
    const CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_MODBUS);
    let mut digest = CRC.digest();
    for w in words {
        digest.update(&w.to_be_bytes());
    }
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_word_orders_go_there_and_back() {
        assert_eq!(WordOrder::HighFirst.of_u32(0x0102_0304), [0x0102, 0x0304]);
        assert_eq!(WordOrder::LowFirst.of_u32(0x0102_0304), [0x0304, 0x0102]);
        assert_eq!(WordOrder::HighFirst.of_u64(0x0001_0002_0003_0004), [1, 2, 3, 4]);
        assert_eq!(WordOrder::LowFirst.of_u64(0x0001_0002_0003_0004), [4, 3, 2, 1]);
        for order in [WordOrder::HighFirst, WordOrder::LowFirst] {
            assert_eq!(order.u32(order.of_u32(0xDEAD_BEEF)), 0xDEAD_BEEF);
        }
    }

    #[test]
    fn a_text_is_cut_filled_and_read_up_to_its_nul() {
        assert_eq!(of_text("ABCD", 3), [0x4142, 0x4344, 0]);
        assert_eq!(of_text("ABCDE", 2), [0x4142, 0x4344]);
        assert_eq!(text::<17>(&[0x4142, 0x4300, 0x4444]), "ABC");
        assert_eq!(text::<17>(&[0x41FF, 0x0A42, 0]), "A??B");
        assert_eq!(text::<17>(&[0x4141; 9]).len(), 17);
    }

    #[test]
    fn what_does_not_fit_is_the_largest_or_unknown() {
        assert_eq!(count(0.0124, 1e-3), Some(12));
        assert_eq!(count(1e9, 1e-3), Some(65534));
        assert_eq!((count(-1.0, 1.0), count(f64::NAN, 1.0)), (None, None));
        assert_eq!((signed32(-1.5, 1e-3), signed32(1e9, 1e-3), signed32(f64::NAN, 1.0)), (Some(-1500), None, None));
        assert_eq!((signed16(-12.34, 0.1), signed16(1e4, 0.1)), (Some(-123), None));
    }

    #[test]
    fn the_crc_is_the_one_of_the_catalogue() {
        // the check value of CRC-16/MODBUS is that of "123456789"; here of its first eight characters
        assert_eq!(crc16(&of_text("12345678", 4)), 0x37DD, "by hand, bit by bit");
        assert_eq!(crc16(&[]), 0xFFFF);
    }
}

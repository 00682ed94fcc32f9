//! How grey samples lie in libcamera's buffers. In: what a camera offers, a buffer's bytes. Out: the format to take, samples.
//! Formats are DRM's (drm_fourcc.h): `R10 ` has a sample in the lowest 10 bits of a little-endian word, and with MIPI's
//! modifier four samples in five bytes, as they come over CSI-2 (MIPI Alliance, CSI-2, data formats RAW10 and RAW12). Pure.

use crate::image::Image;

/// A pixel format: DRM's code and modifier.
pub(super) type Format = (u32, u64);

/// fourcc_mod_code(MIPI, 1)
const CSI2_PACKED: u64 = 0x0b << 56 | 1;

/// How samples lie in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    /// A byte each.
    Bytes,
    /// A word each, the lower byte first.
    Words,
    /// Four in five bytes: the upper eight bits of each, then the lower two of all, the first one's lowest.
    Fives,
    /// Two in three bytes: the upper eight bits of each, then the lower four of both, the first one's lowest.
    Threes,
}

/// The formats that hold samples of so many bits, the easiest to read first.
fn holding(bits: u8) -> Vec<(Format, Packing)> {
    let code = |name: &[u8; 4], modifier| (u32::from_le_bytes(*name), modifier);
    match bits {
        8 => vec![(code(b"R8  ", 0), Packing::Bytes)],
        10 => vec![(code(b"R10 ", 0), Packing::Words), (code(b"R10 ", CSI2_PACKED), Packing::Fives)],
        12 => vec![(code(b"R12 ", 0), Packing::Words), (code(b"R12 ", CSI2_PACKED), Packing::Threes)],
        _ => vec![(code(b"R16 ", 0), Packing::Words)],
    }
}

/// The names under which libcamera knows them.
#[cfg(feature = "libcamera")]
pub(super) fn names(bits: u8) -> &'static str {
    match bits {
        8 => "R8",
        10 => "R10 or R10_CSI2P",
        12 => "R12 or R12_CSI2P",
        _ => "R16",
    }
}

/// Which of the formats on offer to take for grey samples of so many bits.
pub(super) fn choose(bits: u8, offered: &[Format]) -> Option<(Format, Packing)> {
    holding(bits).into_iter().find(|(format, _)| offered.contains(format))
}

/// Where an image lies in its buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) packing: Packing,
    /// Bytes from one row to the next.
    stride: usize,
}

impl Layout {
    /// `stride`: as the camera took it; 0 where it does not say, which means that rows follow each other.
    pub(super) fn new((width, height): (usize, usize), packing: Packing, stride: usize) -> Self {
        let layout = Self { width, height, packing, stride: 0 };
        Self { stride: stride.max(layout.row()), ..layout }
    }

    /// Bytes of a row's samples.
    fn row(&self) -> usize {
        match self.packing {
            Packing::Bytes => self.width,
            Packing::Words => 2 * self.width,
            Packing::Fives => 5 * self.width.div_ceil(4),
            Packing::Threes => 3 * self.width.div_ceil(2),
        }
    }

    /// Bytes of an image.
    pub(super) fn bytes(&self) -> usize {
        self.stride * (self.height - 1) + self.row()
    }

    /// A buffer's samples, into an image of that size. `bytes` has at least [`Self::bytes`].
    pub(super) fn copy(&self, bytes: &[u8], image: &mut Image<u16>) {
        for (to, from) in image.pixels.chunks_exact_mut(self.width).zip(bytes.chunks(self.stride)) {
            let from = &from[..self.row()];
            match self.packing {
                Packing::Bytes => to.iter_mut().zip(from).for_each(|(to, from)| *to = u16::from(*from)),
                Packing::Words => {
                    let sample = |(to, from): (&mut u16, &[u8])| *to = u16::from_le_bytes([from[0], from[1]]);
                    to.iter_mut().zip(from.chunks_exact(2)).for_each(sample);
                }
                Packing::Fives => unpack::<4>(to, from, 2),
                Packing::Threes => unpack::<2>(to, from, 4),
            }
        }
    }
}

/// Samples whose upper eight bits come first, `N` of them, and then their lower `low` bits in one byte.
fn unpack<const N: usize>(to: &mut [u16], from: &[u8], low: u32) {
    for (to, from) in to.chunks_mut(N).zip(from.chunks_exact(N + 1)) {
        let rest = u16::from(from[N]);
        for (k, to) in (0..).zip(to) {
            *to = u16::from(from[k as usize]) << low | (rest >> (low * k)) & ((1 << low) - 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(name: &[u8; 4]) -> u32 {
        u32::from_le_bytes(*name)
    }

    #[test]
    fn what_is_easiest_to_read_is_taken_and_nothing_that_is_not_grey() {
        let (ten, twelve) = (code(b"R10 "), code(b"R12 "));
        let bgr = (code(b"RG24"), 0);
        assert_eq!(choose(10, &[bgr, (ten, CSI2_PACKED), (ten, 0)]), Some(((ten, 0), Packing::Words)));
        assert_eq!(choose(10, &[bgr, (ten, CSI2_PACKED)]), Some(((ten, CSI2_PACKED), Packing::Fives)));
        assert_eq!(choose(12, &[(ten, 0), (twelve, CSI2_PACKED)]), Some(((twelve, CSI2_PACKED), Packing::Threes)));
        assert_eq!(choose(8, &[(ten, 0), (code(b"R8  "), 0)]), Some(((code(b"R8  "), 0), Packing::Bytes)));
        assert_eq!(choose(16, &[(code(b"R16 "), 0)]), Some(((code(b"R16 "), 0), Packing::Words)));
        assert_eq!(choose(8, &[bgr, (ten, 0)]), None);
        // a compressed one is another format, although its code is that of a plain one
        assert_eq!(choose(16, &[(code(b"R16 "), 0x0b << 56 | 2)]), None);
    }

    #[test]
    fn rows_are_taken_from_where_the_stride_puts_them() {
        let mut image = Image::filled(3, 2, 0);
        Layout::new((3, 2), Packing::Bytes, 4).copy(&[1, 2, 3, 99, 4, 5, 6], &mut image);
        assert_eq!(image.pixels, [1, 2, 3, 4, 5, 6]);
        let words = Layout::new((3, 2), Packing::Words, 8);
        words.copy(&[1, 0, 255, 3, 3, 0, 9, 9, 4, 0, 5, 0, 6, 1], &mut image);
        assert_eq!(image.pixels, [1, 1023, 3, 4, 5, 262]);
        assert_eq!(words.bytes(), 14);
        assert_eq!(Layout::new((3, 2), Packing::Words, 0).bytes(), 12, "a stride that is not told");
    }

    #[test]
    fn packed_samples_come_apart() {
        // 0x3ff, 0x001, 0x155, 0x2aa | 0x000, 0x3fc, 0x003, 0x200, and one byte of nothing behind each row
        let bytes = [
            0xff,
            0x00,
            0x55,
            0xaa,
            0b10_01_01_11,
            99, //
            0x00,
            0xff,
            0x00,
            0x80,
            0b00_11_00_00,
        ];
        let mut image = Image::filled(4, 2, 0);
        let layout = Layout::new((4, 2), Packing::Fives, 6);
        assert_eq!(layout.bytes(), bytes.len());
        layout.copy(&bytes, &mut image);
        assert_eq!(image.pixels, [0x3ff, 0x001, 0x155, 0x2aa, 0x000, 0x3fc, 0x003, 0x200]);
        let mut image = Image::filled(2, 2, 0);
        let layout = Layout::new((2, 2), Packing::Threes, 0);
        layout.copy(&[0xab, 0x12, 0x3c, 0xff, 0x00, 0x0f], &mut image);
        assert_eq!(image.pixels, [0xabc, 0x123, 0xfff, 0x000]);
    }

    #[test]
    fn a_row_may_end_within_a_group() {
        let mut image = Image::filled(5, 1, 0);
        let layout = Layout::new((5, 1), Packing::Fives, 0);
        assert_eq!(layout.bytes(), 10);
        layout.copy(&[1, 2, 3, 4, 0, 0x80, 9, 9, 9, 0b11], &mut image);
        assert_eq!(image.pixels, [4, 8, 12, 16, 0x203]);
    }
}

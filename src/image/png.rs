//! Grey PNG files. In: a path. Out: samples of 8 or 16 bits, the smaller ones widened; and back.
//! Not here: colour to read; what the grey levels mean.

use super::Image;
use png::{BitDepth, ColorType, Compression};
use std::fs::File;
use std::io::{self, BufReader, BufWriter};
use std::path::{Path, PathBuf};

/// No camera or projector of this product has more columns or rows; a header that says so is not believed.
pub const MAX_SIDE: usize = 10_000;

/// Why a PNG was not read or written.
#[derive(Debug, thiserror::Error)]
pub enum PngError {
    /// The file cannot be opened or made.
    #[error("{}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// No PNG, or a truncated or corrupt one.
    #[error("{}: not a whole PNG", file.display())]
    Broken {
        /// The file.
        file: PathBuf,
        /// Where it breaks.
        source: png::DecodingError,
    },
    /// A PNG of another kind.
    #[error("{}: {found}, allowed: grey without alpha, 8 or 16 bits, up to {MAX_SIDE}×{MAX_SIDE}", file.display())]
    Kind {
        /// The file.
        file: PathBuf,
        /// What its header says.
        found: String,
    },
    /// Writing failed.
    #[error("{}: cannot be written", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// Why.
        source: png::EncodingError,
    },
}

/// What a PNG's header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PngHeader {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bits per sample: 8 or 16.
    pub bits: u8,
}

/// Size and depth of a grey PNG, without its pixels.
pub fn read_png_header(file: &Path) -> Result<PngHeader, PngError> {
    open(file).map(|(_, header)| header)
}

/// A grey PNG's samples as stored: 8-bit files give 0..=255, 16-bit files 0..=65535.
pub fn read_png(file: &Path) -> Result<Image<u16>, PngError> {
    let (mut reader, header) = open(file)?;
    let broken = |source| PngError::Broken { file: file.into(), source };
    let mut bytes = vec![0; header.width * header.height * usize::from(header.bits / 8)];
    reader.next_frame(&mut bytes).map_err(broken)?;
    reader.finish().map_err(broken)?; // a file cut after its last row is still cut
    let pixels = match header.bits {
        8 => bytes.into_iter().map(u16::from).collect(),
        _ => bytes.as_chunks().0.iter().map(|&b| u16::from_be_bytes(b)).collect(),
    };
    Ok(Image { width: header.width, height: header.height, pixels })
}

fn open(file: &Path) -> Result<(png::Reader<BufReader<File>>, PngHeader), PngError> {
    let data = File::open(file).map_err(|source| PngError::Io { file: file.into(), source })?;
    let broken = |source| PngError::Broken { file: file.into(), source };
    let mut decoder = png::Decoder::new(BufReader::new(data));
    let info = decoder.read_header_info().map_err(broken)?;
    let header = PngHeader { width: info.width as usize, height: info.height as usize, bits: info.bit_depth as u8 };
    let fits = header.width <= MAX_SIDE && header.height <= MAX_SIDE;
    if info.color_type != ColorType::Grayscale || header.bits < 8 || !fits {
        let colour = match info.color_type {
            ColorType::Grayscale => "grey",
            ColorType::GrayscaleAlpha => "grey with alpha",
            ColorType::Rgb => "RGB",
            ColorType::Rgba => "RGB with alpha",
            ColorType::Indexed => "palette",
        };
        let found = format!("{colour}, {} bits, {}×{}", header.bits, header.width, header.height);
        return Err(PngError::Kind { file: file.into(), found });
    }
    Ok((decoder.read_info().map_err(broken)?, header))
}

/// Writes an 8-bit grey PNG.
pub fn write_png(file: &Path, image: &Image<u8>) -> Result<(), PngError> {
    write(file, (image.width, image.height), ColorType::Grayscale, BitDepth::Eight, &image.pixels)
}

/// Writes a 16-bit grey PNG.
pub fn write_png_16(file: &Path, image: &Image<u16>) -> Result<(), PngError> {
    let bytes: Vec<u8> = image.pixels.iter().flat_map(|v| v.to_be_bytes()).collect();
    write(file, (image.width, image.height), ColorType::Grayscale, BitDepth::Sixteen, &bytes)
}

/// Writes an 8-bit colour PNG; a pixel is red, green, blue.
pub fn write_png_rgb(file: &Path, image: &Image<[u8; 3]>) -> Result<(), PngError> {
    write(file, (image.width, image.height), ColorType::Rgb, BitDepth::Eight, image.pixels.as_flattened())
}

/// An 8-bit colour PNG's bytes; a pixel is red, green, blue. Panics where a side is larger than a PNG may have.
pub fn png_rgb(image: &Image<[u8; 3]>) -> Vec<u8> {
    let mut out = Vec::new();
    let size = (image.width, image.height);
    encode(&mut out, size, ColorType::Rgb, BitDepth::Eight, image.pixels.as_flattened()).expect("memory takes all");
    out
}

fn write(file: &Path, size: (usize, usize), colour: ColorType, depth: BitDepth, bytes: &[u8]) -> Result<(), PngError> {
    let out = File::create(file).map_err(|source| PngError::Io { file: file.into(), source })?;
    encode(&mut BufWriter::new(out), size, colour, depth, bytes)
        .map_err(|source| PngError::Write { file: file.into(), source })
}

fn encode(
    out: &mut dyn io::Write,
    (width, height): (usize, usize),
    colour: ColorType,
    depth: BitDepth,
    bytes: &[u8],
) -> Result<(), png::EncodingError> {
    // a side beyond u32 saturates, and the encoder then refuses the number of bytes
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let mut encoder = png::Encoder::new(out, side(width), side(height));
    encoder.set_color(colour);
    encoder.set_depth(depth);
    encoder.set_compression(Compression::Fast); // noise hardly compresses: 5 % smaller for 10 times the work
    encoder.write_header().and_then(|mut w| w.write_image_data(bytes).and_then(|()| w.finish()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn in_folder(name: &str, test: impl FnOnce(&Path)) {
        let dir = std::env::temp_dir().join(format!("datum-png-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&dir).expect("temporary folder");
        test(&dir);
        std::fs::remove_dir_all(&dir).expect("just made");
    }

    fn encode(file: &Path, colour: ColorType, depth: BitDepth, bytes: &[u8]) {
        let out = File::create(file).expect("temporary file");
        let mut encoder = png::Encoder::new(out, 4, 2);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        if colour == ColorType::Indexed {
            encoder.set_palette([0; 768].as_slice());
        }
        encoder.write_header().and_then(|mut w| w.write_image_data(bytes)).expect("valid PNG");
    }

    #[test]
    fn both_depths_come_back_as_stored() {
        in_folder("depths", |dir| {
            let eight = Image { width: 3, height: 2, pixels: vec![0u8, 1, 127, 128, 254, 255] };
            write_png(&dir.join("8.png"), &eight).expect("writable");
            let own = Image { width: 2, height: 1, pixels: vec![0x1234u16, 65535] };
            write_png_16(&dir.join("own.png"), &own).expect("writable");
            assert_eq!(read_png(&dir.join("own.png")).expect("grey"), own);
            assert_eq!(read_png(&dir.join("8.png")).expect("grey").pixels, [0, 1, 127, 128, 254, 255]);
            let samples = [0u16, 1, 255, 256, 4095, 65535, 0x1234, 7];
            encode(
                &dir.join("16.png"),
                ColorType::Grayscale,
                BitDepth::Sixteen,
                &samples.map(u16::to_be_bytes).concat(),
            );
            let sixteen = read_png(&dir.join("16.png")).expect("grey");
            assert_eq!((sixteen.width, sixteen.height, sixteen.pixels), (4, 2, samples.to_vec()));
            let header = read_png_header(&dir.join("16.png")).expect("grey");
            assert_eq!(header, PngHeader { width: 4, height: 2, bits: 16 });
        });
    }

    #[test]
    fn other_kinds_are_refused_by_name() {
        in_folder("kinds", |dir| {
            let file = dir.join("x.png");
            for (colour, depth, bytes, name) in [
                (ColorType::Rgb, BitDepth::Eight, 24, "RGB, 8 bits, 4×2"),
                (ColorType::Rgba, BitDepth::Eight, 32, "RGB with alpha, 8 bits"),
                (ColorType::GrayscaleAlpha, BitDepth::Eight, 16, "grey with alpha, 8 bits"),
                (ColorType::Indexed, BitDepth::Eight, 8, "palette, 8 bits"),
                (ColorType::Grayscale, BitDepth::Four, 4, "grey, 4 bits"),
            ] {
                encode(&file, colour, depth, &vec![0; bytes]);
                let e = read_png(&file).expect_err(name).to_string();
                assert!(e.contains("x.png") && e.contains(name) && e.contains("allowed: grey without alpha"), "{e}");
            }
        });
    }

    #[test]
    fn every_truncation_and_every_flipped_byte_is_an_error_or_an_image_but_no_panic() {
        in_folder("broken", |dir| {
            let file = dir.join("x.png");
            write_png(&file, &Image { width: 5, height: 4, pixels: (0..20).collect() }).expect("writable");
            let whole = std::fs::read(&file).expect("just written");
            for n in 0..whole.len() {
                std::fs::write(&file, &whole[..n]).expect("writable");
                assert!(read_png(&file).is_err(), "cut after {n} of {} bytes", whole.len());
                let mut flipped = whole.clone();
                flipped[n] ^= 0xff;
                std::fs::write(&file, &flipped).expect("writable");
                let _ = read_png(&file);
            }
            assert!(read_png(dir).is_err() && read_png(&dir.join("none.png")).is_err());
        });
    }

    #[test]
    fn an_absurd_size_is_refused_before_memory_is_asked_for() {
        in_folder("size", |dir| {
            let file = dir.join("x.png");
            let out = File::create(&file).expect("temporary file");
            let mut encoder = png::Encoder::new(out, 60_000, 60_000);
            encoder.set_color(ColorType::Grayscale);
            drop(encoder.write_header().expect("header").write_chunk(png::chunk::IDAT, &[0x78, 0x9c]));
            let e = read_png(&file).expect_err("absurd").to_string();
            assert!(e.contains("60000×60000"), "{e}");
        });
    }

    #[test]
    fn colour_is_written_in_order() {
        in_folder("rgb", |dir| {
            let file = dir.join("x.png");
            write_png_rgb(&file, &Image { width: 2, height: 1, pixels: vec![[255, 0, 1], [2, 3, 4]] })
                .expect("writable");
            let mut reader =
                png::Decoder::new(BufReader::new(File::open(&file).expect("just written"))).read_info().expect("PNG");
            let mut bytes = [0; 6];
            reader.next_frame(&mut bytes).expect("whole");
            assert_eq!(bytes, [255, 0, 1, 2, 3, 4]);
        });
    }
}

//! Finished pictures.

use crate::{Rgb, font};

/// PNG's own word for the program that made a picture.
const SOFTWARE: &str = "Software";

/// Whether a PNG that starts like this, with its first 256 bytes, says that riglab made it.
pub fn is_own_png(start: &[u8]) -> bool {
    let said = [SOFTWARE.as_bytes(), b"\0riglab "].concat();
    start.windows(said.len()).take(256).any(|bytes| bytes == said)
}

/// A picture: rows of sRGB pixels from the top left.
#[derive(Clone, PartialEq)]
pub struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

impl Picture {
    /// One colour all over; at least one pixel.
    pub fn filled(width: usize, height: usize, color: Rgb) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Self { width, height, pixels: vec![color.0; width * height] }
    }

    pub(crate) fn from_pixels(width: usize, height: usize, pixels: Vec<[u8; 3]>) -> Self {
        debug_assert_eq!(pixels.len(), width * height);
        Self { width, height, pixels }
    }

    /// Pixels to the right.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[[u8; 3]] {
        &self.pixels
    }

    /// The picture as a PNG file, which says that riglab made it ([`is_own_png`]).
    pub fn to_png(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_filter(png::Filter::Adaptive);
        let said = encoder.add_text_chunk(SOFTWARE.into(), concat!("riglab ", env!("CARGO_PKG_VERSION")).into());
        said.and_then(|()| encoder.write_header())
            .and_then(|mut writer| writer.write_image_data(self.pixels.as_flattened()))
            .expect("sizes agree, and memory can be written");
        out
    }

    /// Copies another picture onto this one; what lies outside is cut off.
    pub fn paste(&mut self, other: &Self, left: usize, top: usize) {
        let columns = other.width.min(self.width.saturating_sub(left));
        if columns == 0 {
            return;
        }
        for row in 0..other.height.min(self.height.saturating_sub(top)) {
            let to = (top + row) * self.width + left;
            let from = row * other.width;
            self.pixels[to..to + columns].copy_from_slice(&other.pixels[from..from + columns]);
        }
    }

    /// Fills a rectangle; what lies outside is cut off.
    pub fn fill(&mut self, left: usize, top: usize, width: usize, height: usize, color: Rgb) {
        for row in top..top.saturating_add(height).min(self.height) {
            let columns = left.min(self.width)..left.saturating_add(width).min(self.width);
            self.pixels[row * self.width..][columns].fill(color.0);
        }
    }

    /// Writes a line of text whose letters are 5 by 8 squares of `size` pixels; what is not ASCII as ASCII writes it.
    pub fn write(&mut self, text: &str, left: usize, top: usize, size: usize, color: Rgb) {
        for (at, c) in font::drawn(text).chars().enumerate() {
            let origin = left + at * font::ADVANCE * size;
            for (row, bits) in font::glyph(c).iter().enumerate() {
                for column in (0..font::WIDTH).filter(|column| bits >> column & 1 == 1) {
                    self.fill(origin + column * size, top + row * size, size, size, color);
                }
            }
        }
    }
}

impl std::fmt::Debug for Picture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Picture({} x {})", self.width, self.height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_outside_is_cut_off() {
        let (white, black) = (Rgb([255; 3]), Rgb([0; 3]));
        let mut picture = Picture::filled(8, 8, white);
        let blank = picture.clone();
        let stamp = Picture::filled(5, 5, black);
        for (left, top) in [(8, 7), (100, 0), (0, 100), (usize::MAX, 7)] {
            picture.paste(&stamp, left, top);
            picture.fill(left, top, 3, usize::MAX, black);
        }
        assert_eq!(picture, blank);
        picture.paste(&stamp, 6, 7);
        picture.write("far too long a line", 4, 6, 3, white);
        assert_eq!(picture.pixels().iter().filter(|p| **p == black.0).count(), 2);
    }
}

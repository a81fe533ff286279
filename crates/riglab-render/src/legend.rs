//! Colour bars.

use crate::{Palette, Picture, Theme, font};

impl Picture {
    /// Writes a bar into the lower margin that says what the colours of `palette` from `low` to
    /// `high` mean.
    pub fn legend(&mut self, palette: Palette, low: f32, high: f32, theme: Theme) {
        let size = text_size(self.width());
        let (line, gap) = (font::CAPITAL * size, 3 * size);
        let (low, high) = (number(low), number(high));
        let [low_width, high_width] = [&low, &high].map(|text| font::width(text) * size);
        // The bar takes the middle third where the numbers leave room.
        let room = self.width().saturating_sub(low_width + high_width + 4 * gap);
        let bar = room.min(self.width() / 3);
        let left = (self.width() - bar) / 2;
        let top = self.height().saturating_sub(line + gap);
        for column in 0..bar {
            let color = palette.color(column as f32 / (bar.max(2) - 1) as f32);
            self.fill(left + column, top, 1, line, color);
        }
        self.write(&low, left.saturating_sub(low_width + gap), top, size, theme.ink());
        self.write(&high, left + bar + gap, top, size, theme.ink());
    }
}

/// Pixels of a letter's squares in a picture of some width: about forty letters fit.
pub(crate) fn text_size(width: usize) -> usize {
    (width / 240).max(1)
}

/// A number in few letters.
fn number(x: f32) -> String {
    let text = if x != 0.0 && (x.abs() < 1e-3 || x.abs() >= 1e5) { format!("{x:.1e}") } else { format!("{x:.3}") };
    if text.contains('e') { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let cases = [
            (0.0, "0"),
            (1.0, "1"),
            (0.25, "0.25"),
            (100.0, "100"),
            (2.5e-5, "2.5e-5"),
            (1e9, "1.0e9"),
            (f32::NAN, "NaN"),
        ];
        for (x, text) in cases {
            assert_eq!(number(x), text);
        }
    }

    #[test]
    fn a_legend_fits_pictures_of_any_width() {
        for width in [1, 7, 40, 512] {
            let mut picture = Picture::filled(width, width, Theme::Light.background());
            picture.legend(Palette::Ember, 0.0, 0.125, Theme::Light);
            assert_eq!(picture.pixels().len(), width * width);
        }
    }
}

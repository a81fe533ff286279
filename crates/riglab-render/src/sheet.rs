//! Many pictures on one.

use crate::legend::text_size;
use crate::{Picture, Theme, font};

/// Lays pictures out in rows of `columns`, each with its caption of one or several lines below. Cells have the size of the
/// largest picture, smaller ones stand in the middle; what is wider than its cell is cut in the middle of the line: names
/// that begin alike end otherwise.
pub fn contact_sheet(cells: &[(impl AsRef<str>, Picture)], columns: usize, theme: Theme) -> Picture {
    let columns = columns.clamp(1, cells.len().max(1));
    let rows = cells.len().div_ceil(columns);
    let largest = |side: fn(&Picture) -> usize| cells.iter().map(|(_, picture)| side(picture)).max().unwrap_or(0);
    let (width, height) = (largest(Picture::width), largest(Picture::height));
    let size = text_size(width);
    let gap = 4 * size;
    let lines = cells.iter().map(|(caption, _)| caption.as_ref().lines().count()).max().unwrap_or(0);
    let line = if lines > 0 { lines * font::HEIGHT * size + gap } else { 0 };
    let mut sheet =
        Picture::filled(columns * (width + gap) + gap, rows * (height + line + gap) + gap, theme.background());
    for (at, (caption, picture)) in cells.iter().enumerate() {
        let left = gap + at % columns * (width + gap);
        let top = gap + at / columns * (height + line + gap);
        sheet.paste(picture, left + (width - picture.width()) / 2, top + (height - picture.height()) / 2);
        for (k, line) in caption.as_ref().lines().enumerate() {
            let line = cut(&font::drawn(line), width / size);
            let indent = (width.saturating_sub(font::width(&line) * size)) / 2;
            sheet.write(&line, left + indent, top + height + gap / 2 + k * font::HEIGHT * size, size, theme.ink());
        }
    }
    sheet
}

/// A line that fits into `squares`, with `..` for what is left out of its middle.
fn cut(line: &str, squares: usize) -> String {
    if font::width(line) <= squares {
        return line.to_owned();
    }
    let letters = (squares + 1) / font::ADVANCE;
    let (all, kept) = (line.chars().count(), letters.saturating_sub(2));
    let (first, last) = (kept.div_ceil(2), kept / 2);
    let ends = line.chars().take(first).chain("..".chars()).chain(line.chars().skip(all - last));
    ends.take(letters).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rgb;

    const RED: Rgb = Rgb([255, 0, 0]);

    #[test]
    fn pictures_stand_in_their_cells() {
        let cells = [
            ("a", Picture::filled(20, 10, RED)),
            ("", Picture::filled(10, 10, RED)),
            ("c", Picture::filled(20, 4, RED)),
        ];
        let sheet = contact_sheet(&cells, 2, Theme::Light);
        assert_eq!((sheet.width(), sheet.height()), (2 * 24 + 4, 2 * (10 + 8 + 4 + 4) + 4));
        let at = |x: usize, y: usize| sheet.pixels()[y * sheet.width() + x];
        assert_eq!(sheet.pixels().iter().filter(|p| **p == RED.0).count(), 200 + 100 + 80);
        assert_eq!((at(4, 4), at(23, 13), at(33, 4), at(32, 4)), (RED.0, RED.0, RED.0, [255; 3]));
    }

    #[test]
    fn odd_sheets_are_pictures_too() {
        let none: [(&str, Picture); 0] = [];
        assert!(contact_sheet(&none, 0, Theme::Dark).width() > 0);
        let cells = [("a caption longer than its cell \u{e9}\n\nof three lines", Picture::filled(3, 3, RED))];
        contact_sheet(&cells, 9, Theme::Dark);
    }

    #[test]
    fn long_captions_are_cut() {
        assert_eq!(cut("abcdef", 35), "abcdef");
        assert_eq!(cut("abcdef", 34), "ab..f");
        assert_eq!(cut("abcdefgh", 41), "abc..gh");
        assert_eq!(cut("abcdef", 3), "");
    }
}

//! Many pictures on one.

use crate::legend::text_size;
use crate::{Picture, Theme, font};

/// Lays pictures out in rows of `columns`, each with its caption below. Cells have the size of the
/// largest picture, smaller ones stand in the middle; captions are cut to their cell.
pub fn contact_sheet(cells: &[(impl AsRef<str>, Picture)], columns: usize, theme: Theme) -> Picture {
    let columns = columns.clamp(1, cells.len().max(1));
    let rows = cells.len().div_ceil(columns);
    let largest = |side: fn(&Picture) -> usize| cells.iter().map(|(_, picture)| side(picture)).max().unwrap_or(0);
    let (width, height) = (largest(Picture::width), largest(Picture::height));
    let size = text_size(width);
    let gap = 4 * size;
    let captioned = cells.iter().any(|(caption, _)| !caption.as_ref().is_empty());
    let line = if captioned { font::HEIGHT * size + gap } else { 0 };
    let mut sheet =
        Picture::filled(columns * (width + gap) + gap, rows * (height + line + gap) + gap, theme.background());
    for (at, (caption, picture)) in cells.iter().enumerate() {
        let left = gap + at % columns * (width + gap);
        let top = gap + at / columns * (height + line + gap);
        sheet.paste(picture, left + (width - picture.width()) / 2, top + (height - picture.height()) / 2);
        let caption = cut(caption.as_ref(), width / size);
        let indent = (width.saturating_sub(font::width(&caption) * size)) / 2;
        sheet.write(&caption, left + indent, top + height + gap / 2, size, theme.ink());
    }
    sheet
}

/// A caption that fits into `squares`, with `..` for what is left out.
fn cut(caption: &str, squares: usize) -> String {
    if font::width(caption) <= squares {
        return caption.to_owned();
    }
    let letters = (squares + 1) / font::ADVANCE;
    caption.chars().take(letters.saturating_sub(2)).chain("..".chars()).take(letters).collect()
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
        let cells = [("a caption longer than its cell \u{e9}\n", Picture::filled(3, 3, RED))];
        contact_sheet(&cells, 9, Theme::Dark);
    }

    #[test]
    fn long_captions_are_cut() {
        assert_eq!(cut("abcdef", 35), "abcdef");
        assert_eq!(cut("abcdef", 34), "abc..");
        assert_eq!(cut("abcdef", 3), "");
    }
}

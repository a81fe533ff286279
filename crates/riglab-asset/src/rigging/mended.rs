//! What some vertices of a part lack: texture coordinates and colours.

use super::SubjectNote;

/// What colours are that are not told.
const WHITE: [f32; 4] = [1.0; 4];

/// What vertices lacked that others have.
#[derive(Default)]
pub(super) struct Mender {
    coordinates: usize,
    colours: usize,
}

impl Mender {
    /// Texture coordinates, 0 where they are no finite numbers; none where none are.
    pub(super) fn coordinates(&mut self, all: &[[f32; 2]]) -> Vec<[f32; 2]> {
        mended(all, [0.0; 2], &mut self.coordinates)
    }

    /// Colours, white where they are no finite numbers; none where none are.
    pub(super) fn colours(&mut self, all: &[[f32; 4]]) -> Vec<[f32; 4]> {
        mended(all, WHITE, &mut self.colours)
    }

    pub(super) fn tell(self, notes: &mut Vec<SubjectNote>) {
        let Self { coordinates, colours } = self;
        if coordinates + colours > 0 {
            notes.push(SubjectNote::Mended { coordinates, colours });
        }
    }
}

pub(super) fn is_sound(numbers: &[f32]) -> bool {
    numbers.iter().all(|x| x.is_finite())
}

fn mended<const N: usize>(all: &[[f32; N]], instead: [f32; N], count: &mut usize) -> Vec<[f32; N]> {
    let broken = all.iter().filter(|own| !is_sound(&own[..])).count();
    if broken == all.len() {
        return Vec::new();
    }
    *count += broken;
    all.iter().map(|own| if is_sound(&own[..]) { *own } else { instead }).collect()
}

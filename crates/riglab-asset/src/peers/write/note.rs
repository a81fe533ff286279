//! What a format does not hold of an asset, or its loaders refuse.

use std::fmt;

/// Something about a written file that a person may want to know. Its text is a sentence without a full stop.
#[derive(Clone, Debug, PartialEq)]
pub enum WriteNote {
    /// Assets reach out of the cube that the format's own loaders expect.
    Beyond {
        /// Half a side of it.
        half: f32,
        /// How many assets are in the file.
        assets: usize,
        /// How many of them reach beyond it.
        beyond: usize,
        /// The largest coordinate of these.
        most: f32,
    },
    /// No file of the format holds this of any asset.
    Lacks(&'static str),
    /// Assets have more joints than the format's own readers take.
    ManyJoints {
        /// How many do.
        assets: usize,
        /// The one with the most.
        asset: String,
        /// Its joints.
        joints: usize,
        /// As many as the readers take.
        most: usize,
    },
    /// Names of joints had blanks, at which words of the text end.
    Blanks {
        /// How many joints.
        joints: usize,
    },
}

impl WriteNote {
    /// What tells the worst of several notes of a kind; `None` of those that say the same of every asset.
    pub fn figure(&self) -> Option<f64> {
        match self {
            Self::Beyond { most, .. } => Some(f64::from(*most)),
            Self::Lacks(_) => None,
            Self::ManyJoints { joints, .. } | Self::Blanks { joints } => Some(*joints as f64),
        }
    }

    /// Adds it to those of a file, one a kind.
    pub(super) fn put(self, notes: &mut Vec<Self>) {
        let same = notes.iter_mut().find(|note| std::mem::discriminant(*note) == std::mem::discriminant(&self));
        match (same, self) {
            (
                Some(Self::ManyJoints { assets, asset, joints, .. }),
                Self::ManyJoints { asset: other, joints: more, .. },
            ) => {
                *assets += 1;
                if more > *joints {
                    (*asset, *joints) = (other, more);
                }
            }
            (_, note) => notes.push(note),
        }
    }
}

impl fmt::Display for WriteNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Beyond { half, assets, beyond, most } => {
                let whose = if *assets == 1 { "it reaches".into() } else { format!("{beyond} assets reach") };
                write!(
                    f,
                    "{whose} beyond the {half} from the origin that the format's own loaders expect, to {most}; `--fit` moves \
                     and scales vertices and joints together"
                )
            }
            Self::Lacks(what) => f.write_str(what),
            Self::ManyJoints { assets: 1, asset, joints, most } => {
                write!(f, "`{asset}` has {joints} joints, the format's own readers take up to {most}")
            }
            Self::ManyJoints { assets, asset, joints, most } => write!(
                f,
                "{assets} assets have more joints than the {most} that the format's own readers take, `{asset}` the most: \
                 {joints}"
            ),
            Self::Blanks { joints } => {
                write!(f, "blanks in the names of {joints} joints became `_`: words of the text end at blanks")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_beyond_what_is_read_are_told_once_of_a_file() {
        let of = |asset: &str, joints| WriteNote::ManyJoints { assets: 1, asset: asset.into(), joints, most: 70 };
        let mut notes = vec![WriteNote::Lacks("x")];
        for (asset, joints) in [("a", 80), ("b", 99), ("c", 71)] {
            of(asset, joints).put(&mut notes);
        }
        assert_eq!(notes.len(), 2);
        let wanted = "3 assets have more joints than the 70 that the format's own readers take, `b` the most: 99";
        assert_eq!((notes[1].to_string().as_str(), notes[1].figure()), (wanted, Some(99.0)));
    }
}

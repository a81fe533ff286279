//! What to know of a model before it is rigged.

use std::fmt;

use super::UpAxis;
use crate::warning::of_number;
use crate::{ExportNote, Shaped, Warning};

/// Something about a model that a person may want to know. Its text is a sentence without a full stop.
#[derive(Clone, Debug, PartialEq)]
pub enum SubjectNote {
    /// What the importer says.
    Read(Warning),
    /// What taking the old rig out says.
    Stripped(ExportNote),
    /// The rig of the file is not looked at.
    RigIgnored {
        /// How many joints it has.
        joints: usize,
    },
    /// The model stands as if another axis were up than was given.
    LiesDown {
        /// Which, in the file.
        axis: UpAxis,
        /// What was given.
        given: UpAxis,
    },
    /// The format says that the model faces -z.
    FacesBack,
    /// Large parts stand apart, as those of several characters do.
    StandApart {
        /// How many.
        groups: usize,
    },
    /// Closed surfaces face inwards.
    InsideOut {
        /// Triangles of those.
        triangles: usize,
        /// Of how many.
        of: usize,
    },
    /// Triangles without area.
    Flat {
        /// How many.
        triangles: usize,
    },
    /// Meshes are shown with blend shapes, without which they are looked at.
    Shaped(Vec<Shaped>),
    /// A file that the model names is not there.
    FileMissing(String),
    /// A picture that the model names is of no kind that is read.
    OtherPicture(String),
    /// Parts have a material with a picture, but no texture coordinates to lay it on them by.
    Unplaced {
        /// How many.
        parts: usize,
    },
    /// Vertices lack what others of their part have, or it is no finite number for them.
    Mended {
        /// How many texture coordinates are 0 now.
        coordinates: usize,
        /// How many colours are white now.
        colours: usize,
    },
    /// Materials name pictures for what is not taken over, by the words of the format.
    MapsLeft(Vec<String>),
    /// Other things of the file are not taken over: what and how many.
    ThingsLeft(Vec<String>),
}

impl fmt::Display for SubjectNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read(warning) => warning.fmt(f),
            Self::Stripped(note) => note.fmt(f),
            Self::RigIgnored { joints } => {
                let joints = of_number(*joints, "joint", "joints");
                write!(f, "the file already has a rig ({joints}), which was removed for the new one")
            }
            Self::LiesDown { axis, given } => {
                write!(f, "{axis} seems to be up in the file, not {given}; if so, give `--up {axis}`")
            }
            Self::FacesBack => {
                f.write_str("VRM 0.x models face -z: it was turned to +z for rigging, and is written as it stood")
            }
            Self::StandApart { groups } => write!(
                f,
                "{groups} large parts stand apart, as several characters do; one skeleton is made for all: \
                 rig them one by one if they are not one"
            ),
            Self::InsideOut { triangles, of } => write!(
                f,
                "closed surfaces face inwards ({triangles} of {of} triangles); they were flipped for rigging only, and are \
                 written as they were"
            ),
            Self::Flat { triangles } => {
                let flat = of_number(
                    *triangles,
                    "triangle has no area; it is kept, but ignored for rigging",
                    "triangles have no area; they are kept, but ignored for rigging",
                );
                f.write_str(&flat)
            }
            Self::Shaped(meshes) => {
                let first = meshes.first().map_or(("", 0, 0), |m| (m.mesh.as_str(), m.weighted, m.shapes));
                let (mesh, weighted, shapes) = (short(first.0), first.1, first.2);
                let more = match meshes.len() {
                    0 | 1 => String::new(),
                    many => format!(", and {} more likewise", many - 1),
                };
                write!(
                    f,
                    "`{mesh}` is shown with blend shapes at {weighted} of {shapes} weights{more}; it was rigged without \
                     them: if it fits badly, apply them in the program that it comes from"
                )
            }
            Self::FileMissing(name) => {
                write!(
                    f,
                    "`{}` is not in the model's folder or one of its subfolders (or in several of them); the model is written \
                     without it",
                    short(name)
                )
            }
            Self::OtherPicture(name) => {
                let name = short(name);
                write!(
                    f,
                    "texture `{name}` is no picture that can be read (BMP, DDS of DXT, JPEG, PNG, TGA, TIFF, WebP); the model is written \
                     without it"
                )
            }
            Self::Unplaced { parts } => {
                let have = of_number(
                    *parts,
                    "part has a material with a texture, but no texture coordinates (UVs); it is",
                    "parts have a material with a texture, but no texture coordinates (UVs); they are",
                );
                write!(f, "{have} written without the texture")
            }
            Self::Mended { coordinates, colours } => {
                let parts = [
                    (coordinates, "texture coordinate was set to 0", "texture coordinates were set to 0"),
                    (colours, "colour was set to white", "colours were set to white"),
                ];
                let told = parts.iter().filter(|(n, ..)| **n > 0).map(|(n, one, many)| of_number(**n, one, many));
                let told: Vec<_> = told.collect();
                write!(f, "of vertices that have none, or no finite number, while others do, {}", told.join(", "))
            }
            Self::MapsLeft(words) => {
                write!(f, "textures of its materials that are not taken over: {}", words.join(", "))
            }
            Self::ThingsLeft(things) => write!(f, "not taken over from the file: {}", things.join(", ")),
        }
    }
}

/// The beginning of a name from a file.
fn short(name: &str) -> String {
    name.chars().take(120).collect()
}

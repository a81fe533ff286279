//! Clips: a stack with one layer each, a node of curves for whatever moves, and a curve for each of its numbers.

use std::ops::Range;

use fbxcel::writer::v7400::binary::Error;

use super::curves::{self, Keys, Room};
use super::{Kind, id, shapes};
use crate::fbx::file::Value::{Double, Floats, Int, Ints, Longs};
use crate::fbx::file::{Class, File, Property};
use crate::gltf::contents::{Contents, Move, Path};

/// Of a key: the line to the next is straight.
const STRAIGHT: i32 = 24836;
/// Of a key: its value stays until the next.
const STAYS: i32 = 2;

/// All clips as curves.
#[derive(Default)]
pub(super) struct Motions {
    clips: Vec<Clip>,
    groups: Vec<Group>,
    curves: Vec<Curve>,
    /// How many splines are straight lines between their keys.
    pub(super) straightened: usize,
}

struct Clip {
    name: String,
    /// In ticks.
    start: i64,
    end: i64,
}

/// Numbers that belong together.
struct Group {
    clip: usize,
    name: &'static str,
    /// What has the property that they move.
    of: i64,
    property: &'static str,
    /// Among all.
    curves: Range<usize>,
}

struct Curve {
    group: usize,
    /// Which of the numbers.
    name: &'static str,
    times: Vec<i64>,
    values: Vec<f32>,
    flag: i32,
}

impl Motions {
    pub(super) fn new(contents: &Contents) -> Self {
        let (mut all, mut room) = (Self::default(), Room::new());
        let firsts = shapes::firsts(contents);
        for (clip, motion) in contents.clips.iter().enumerate() {
            all.clips.push(Clip { name: motion.name.clone(), start: i64::MAX, end: i64::MIN });
            for moved in &motion.moves {
                match moved {
                    Move::Node(node, track) => {
                        let (name, property) = match track.path() {
                            Path::Translation => ("T", "Lcl Translation"),
                            Path::Rotation => ("R", "Lcl Rotation"),
                            Path::Scale => ("S", "Lcl Scaling"),
                        };
                        let what = (name, id(Kind::Model, *node), property);
                        all.add(clip, what, ["d|X", "d|Y", "d|Z"], &curves::place(track, &mut room));
                    }
                    Move::Shapes(node, tracks) => {
                        let first = contents.nodes[*node].mesh.map_or(0, |mesh| firsts[mesh]);
                        for (track, shape) in tracks.iter().zip(first..) {
                            let what = ("DeformPercent", id(Kind::Channel, shape), "DeformPercent");
                            all.add(clip, what, ["d|DeformPercent"], &curves::percent(track, &mut room));
                        }
                    }
                }
            }
        }
        all.straightened = room.straightened;
        all
    }

    /// Adds keys of a property, given by its group's name, what has it, and its own name.
    fn add<const N: usize>(
        &mut self,
        number: usize,
        (name, of, property): (&'static str, i64, &'static str),
        names: [&'static str; N],
        keys: &Keys<N>,
    ) {
        let clip = &mut self.clips[number];
        clip.start = clip.start.min(keys.times.first().copied().unwrap_or(0));
        clip.end = clip.end.max(keys.times.last().copied().unwrap_or(0));
        let first = self.curves.len();
        for (k, name) in names.into_iter().enumerate() {
            let values = keys.values.iter().map(|value| value[k] as f32 + 0.0).collect();
            let flag = if keys.steps { STAYS } else { STRAIGHT };
            self.curves.push(Curve { group: self.groups.len(), name, times: keys.times.clone(), values, flag });
        }
        self.groups.push(Group { clip: number, name, of, property, curves: first..self.curves.len() });
    }

    /// How many stacks (and layers), nodes of curves and curves there are.
    pub(super) fn count(&self) -> [usize; 3] {
        [self.clips.len(), self.groups.len(), self.curves.len()]
    }

    pub(super) fn write(&self, file: &mut File) -> Result<(), Error> {
        for (number, clip) in self.clips.iter().enumerate() {
            file.object(Class::Stack, (id(Kind::Stack, number), &clip.name, ""), |file| {
                let times = [("Local", clip), ("Reference", clip)];
                let times =
                    times.map(|(kind, of)| [(format!("{kind}Start"), of.start), (format!("{kind}Stop"), of.end)]);
                let times = times.as_flattened().iter().map(|(name, time)| (&name[..], Property::Time(*time)));
                file.properties(&times.collect::<Vec<_>>())
            })?;
            file.object(Class::Layer, (id(Kind::Layer, number), &clip.name, ""), |_| Ok(()))?;
        }
        for (number, group) in self.groups.iter().enumerate() {
            let own = self.curves[group.curves.clone()].iter();
            let first: Vec<_> = own.map(|curve| (curve.name, Property::Number(curve.first()))).collect();
            file.object(Class::CurveNode, (id(Kind::CurveNode, number), group.name, ""), |file| {
                file.properties(&first)
            })?;
        }
        self.curves.iter().enumerate().try_for_each(|(number, curve)| curve.write(file, number))
    }

    pub(super) fn connect(&self, file: &mut File) -> Result<(), Error> {
        for clip in 0..self.clips.len() {
            file.connect(id(Kind::Layer, clip), id(Kind::Stack, clip))?;
        }
        for (number, group) in self.groups.iter().enumerate() {
            let own = id(Kind::CurveNode, number);
            file.connect(own, id(Kind::Layer, group.clip))?;
            file.connect_property(own, group.of, group.property)?;
        }
        for (number, curve) in self.curves.iter().enumerate() {
            file.connect_property(id(Kind::Curve, number), id(Kind::CurveNode, curve.group), curve.name)?;
        }
        Ok(())
    }
}

impl Curve {
    fn first(&self) -> f64 {
        self.values.first().copied().unwrap_or(0.0).into()
    }

    fn write(&self, file: &mut File, number: usize) -> Result<(), Error> {
        file.object(Class::Curve, (id(Kind::Curve, number), "", ""), |file| {
            file.leaf("Default", &[Double(self.first())])?;
            file.leaf("KeyVer", &[Int(4008)])?;
            file.leaf("KeyTime", &[Longs(&self.times)])?;
            file.leaf("KeyValueFloat", &[Floats(&self.values)])?;
            // One for all keys.
            file.leaf("KeyAttrFlags", &[Ints(&[self.flag])])?;
            file.leaf("KeyAttrDataFloat", &[Floats(&[0.0; 4])])?;
            file.leaf("KeyAttrRefCount", &[Ints(&[self.times.len() as i32])])
        })
    }
}

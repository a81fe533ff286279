//! Animations, sampled at a steady rate, as those of glTF are: for each frame the map of every joint from rest to pose.
//!
//! Rest is where the skin was bound. A vertex that a joint holds wholly goes from there to world(joint, t) * frame⁻¹, where
//! `frame` is the joint's place in the world when it was bound. ufbx poses the scene: pivots, the orders of angles, layers of
//! an animation and how nodes inherit scales are its concern.

use std::ops::RangeInclusive;

use glam::DAffine3;
use riglab_core::{Clip, JointMap};
use ufbx::{AnimProp, AnimRoot, AnimStack, ElementType, EvaluateOpts, InheritMode, Scene};

use super::allocator;
use super::held::held;
use super::joints::Joints;
use super::scene::{Nodes, affine};
use super::shown;
use crate::{Resample, Warning};

/// Joints of all clips of a file, frame by frame: 100 MB. Files claim long times in few bytes.
const MAX_MAPS: usize = 1 << 21;

/// Elements of the scene that are posed, frame by frame: seconds.
const MAX_ELEMENTS: usize = 1 << 24;

/// The clips of a file that move its joints, by joint of the reading, or only the first of the name that is `wanted`. A clip
/// that cannot be read is left out, with a warning.
pub(super) fn read(
    scene: &Scene,
    nodes: &Nodes<'_>,
    joints: &Joints,
    (resample, wanted): (Resample, Option<&str>),
    memory: usize,
    warnings: &mut Vec<Warning>,
) -> Vec<Clip> {
    let moving = joints.movers(nodes);
    let (mut clips, mut left_out, mut cut) = (Vec::new(), Vec::new(), Vec::new());
    let mut room = [MAX_MAPS, MAX_ELEMENTS];
    for (number, stack) in (&scene.anim_stacks).into_iter().enumerate() {
        let Some(time) = time(stack, &moving) else { continue };
        let time = begin(stack, &moving).unwrap_or(*time.start())..=*time.end();
        let name = called(stack, number);
        if wanted.is_some_and(|wanted| wanted != name || !clips.is_empty()) {
            continue;
        }
        match clip(scene, stack, (nodes, joints), (time, resample), (memory, &mut room), &name) {
            Ok((clip, whole)) => {
                cut.extend((!whole).then(|| shown(&name)));
                clips.push(clip);
            }
            Err(reason) => left_out.push(format!("`{}` ({reason})", shown(&name))),
        }
    }
    if !cut.is_empty() {
        warnings.push(Warning::ClipsCut { clips: cut, frames: resample.frames });
    }
    if !left_out.is_empty() {
        warnings.push(Warning::ClipsLeftOut { clips: left_out });
    }
    clips
}

/// The name of an animation, by its number where it has none.
pub(super) fn called(stack: &AnimStack, number: usize) -> String {
    match &*stack.element.name {
        "" => format!("animation {number}"),
        name => name.to_owned(),
    }
}

/// From the first to the last key of what moves joints, as [`span`] has it.
pub(super) fn time(stack: &AnimStack, moving: &[bool]) -> Option<RangeInclusive<f64>> {
    span(stack, |prop| {
        prop.element.type_ == ElementType::Node && moving.get(prop.element.typed_id as usize) == Some(&true)
    })
}

/// From the first to the last key of what moves blend shapes, as [`span`] has it.
pub(super) fn time_of_shapes(stack: &AnimStack) -> Option<RangeInclusive<f64>> {
    span(stack, is_of_shape)
}

/// Whether a property moves a blend shape.
pub(super) fn is_of_shape(prop: &AnimProp) -> bool {
    prop.element.type_ == ElementType::BlendChannel
}

/// When what an animation says of joints and of blend shapes begins: with the first key of either, so that both are sampled at
/// the same times.
pub(super) fn begin(stack: &AnimStack, moving: &[bool]) -> Option<f64> {
    let times = [time(stack, moving), time_of_shapes(stack)];
    times.iter().flatten().map(|time| *time.start()).reduce(f64::min)
}

/// From the first to the last key of some properties, within what the stack says of its time; `None` where none has keys.
fn span(stack: &AnimStack, is_own: impl Fn(&AnimProp) -> bool) -> Option<RangeInclusive<f64>> {
    let props = (&stack.layers).into_iter().flat_map(|layer| &layer.anim_props);
    let own = props.filter(|prop| is_own(prop));
    let curves = own.flat_map(|prop| prop.anim_value.curves.iter().flatten());
    let mut keys = (f64::INFINITY, f64::NEG_INFINITY);
    for curve in curves.filter(|curve| !curve.keyframes.is_empty()) {
        keys = (keys.0.min(curve.min_time), keys.1.max(curve.max_time));
    }
    let (first, last) = keys;
    if !(first.is_finite() && last.is_finite()) {
        return None;
    }
    let within = (first.max(stack.time_begin), last.min(stack.time_end));
    // Takes of nothing: writers that do not say the time.
    Some(if within.0 < within.1 { within.0..=within.1 } else { first..=last })
}

/// A clip, and whether it is whole.
fn clip(
    scene: &Scene,
    stack: &AnimStack,
    (nodes, joints): (&Nodes<'_>, &Joints),
    (time, resample): (RangeInclusive<f64>, Resample),
    (memory, room): (usize, &mut [usize; 2]),
    name: &str,
) -> Result<(Clip, bool), String> {
    // The last frame is the last whole one; a thousandth of one for rounding of key times.
    let whole = ((time.end() - time.start()) * f64::from(resample.rate) + 1e-3).floor();
    let frames = (whole as usize).saturating_add(1).min(resample.frames.max(1));
    let to_joints = joints.to_joints().ok_or("a joint is flat at rest")?;
    let poser = Poser::new(scene, stack, (nodes, joints), memory)?;
    // One that is refused takes nothing from those behind it.
    let each = [to_joints.len(), poser.cost()];
    let left = [0, 1].map(|k| room[k].checked_sub(frames.saturating_mul(each[k])));
    let [Some(maps), Some(elements)] = left else {
        return Err("the clips of the file are longer than is read".into());
    };
    *room = [maps, elements];
    let back = nodes.space.inverse();
    let mut maps: Vec<JointMap> = Vec::with_capacity(frames * to_joints.len());
    let mut worlds: Vec<DAffine3> = (0..nodes.all.len()).map(|node| nodes.world(node)).collect();
    for frame in 0..frames {
        let at = time.start() + frame as f64 / f64::from(resample.rate);
        poser.pose(at, memory, &mut worlds)?;
        maps.extend(to_joints.iter().map(|&(node, to_joint)| {
            let map = nodes.space * worlds[node] * to_joint * back;
            [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis, map.translation].map(|v| v.as_vec3().into())
        }));
    }
    let clip = Clip::new(name.to_owned(), resample.rate, to_joints.len(), maps).map_err(|e| e.to_string())?;
    Ok((clip, whole < frames as f64))
}

/// What poses nodes.
struct Poser<'a> {
    scene: &'a Scene,
    anim: AnimRoot,
    nodes: &'a Nodes<'a>,
    /// Nodes at and above joints, parents first, with whether the stack says something of them; `None` where one of them
    /// inherits scales otherwise than by its parent's place, which ufbx does for whole scenes alone.
    chain: Option<Vec<(usize, bool)>>,
}

impl<'a> Poser<'a> {
    fn new(
        scene: &'a Scene,
        stack: &AnimStack,
        (nodes, joints): (&'a Nodes<'a>, &Joints),
        memory: usize,
    ) -> Result<Self, String> {
        let mut told = vec![false; nodes.all.len()];
        for prop in (&stack.layers).into_iter().flat_map(|layer| &layer.anim_props) {
            if prop.element.type_ == ElementType::Node
                && let Some(told) = told.get_mut(prop.element.typed_id as usize)
            {
                *told = true;
            }
        }
        let moving = joints.movers(nodes);
        let of_chain = || nodes.order.iter().copied().filter(|&node| moving[node] && nodes.parent(node).is_some());
        let plain = of_chain().all(|node| nodes.all[node].inherit_mode == InheritMode::Normal);
        let chain = plain.then(|| of_chain().map(|node| (node, told[node])).collect());
        Ok(Self { scene, anim: held(scene, stack, memory)?, nodes, chain })
    }

    /// How many elements it looks at for a frame.
    fn cost(&self) -> usize {
        self.chain.as_ref().map_or(self.scene.elements.len(), Vec::len)
    }

    /// Where nodes at and above joints stand at a time.
    fn pose(&self, at: f64, memory: usize, worlds: &mut [DAffine3]) -> Result<(), String> {
        let Some(chain) = &self.chain else {
            let options = EvaluateOpts {
                temp_allocator: allocator(memory),
                result_allocator: allocator(memory),
                ..EvaluateOpts::default()
            };
            let posed = ufbx::evaluate_scene(self.scene, &self.anim, at, options);
            let posed = posed.map_err(|e| e.description.to_string())?;
            worlds.iter_mut().zip(&posed.nodes).for_each(|(world, node)| *world = affine(&node.node_to_world));
            return Ok(());
        };
        for &(number, told) in chain {
            let node = self.nodes.all[number];
            let local = match told {
                true => affine(&ufbx::transform_to_matrix(&ufbx::evaluate_transform(&self.anim, node, at))),
                false => affine(&node.node_to_parent),
            };
            let above = self.nodes.parent(number).map_or(DAffine3::IDENTITY, |parent| worlds[parent]);
            worlds[number] = above * local;
        }
        Ok(())
    }
}

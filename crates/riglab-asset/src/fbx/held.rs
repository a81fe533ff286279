//! An animation in which what it does not move stays where it is.

use std::collections::{BTreeMap, BTreeSet};

use ufbx::{AnimOpts, AnimRoot, AnimStack, ElementType, PropOverrideDesc, Scene};

use super::allocator;

/// What a motion moves of a node.
const MOVED: [&str; 3] = ["Lcl Rotation", "Lcl Scaling", "Lcl Translation"];

/// The animation of a stack. Of a node that it says something of, what it has no keys for is held at rest: ufbx, up to version
/// 0.11.5 at least, goes on into the keys of the next element, and takes those of the same name if they are the first there.
///
/// # Errors
/// What ufbx says.
pub(super) fn held(scene: &Scene, stack: &AnimStack, memory: usize) -> Result<AnimRoot, String> {
    let mut keyed: BTreeMap<u32, BTreeSet<&str>> = BTreeMap::new();
    for prop in (&stack.layers).into_iter().flat_map(|layer| &layer.anim_props) {
        if prop.element.type_ == ElementType::Node {
            keyed.entry(prop.element.element_id).or_default().insert(&prop.prop_name);
        }
    }
    let at_rest = keyed.iter().flat_map(|(&element_id, keyed)| {
        let rest = &scene.elements[element_id as usize].props;
        MOVED.into_iter().filter(|name| !keyed.contains(name)).filter_map(move |name| {
            let value = ufbx::find_prop(rest, name)?.value_vec4;
            Some(PropOverrideDesc { element_id, prop_name: name.into(), value, ..PropOverrideDesc::default() })
        })
    });
    let layers: Vec<u32> = (&stack.layers).into_iter().map(|layer| layer.element.typed_id).collect();
    let options = AnimOpts {
        layer_ids: layers.into(),
        prop_overrides: at_rest.collect::<Vec<_>>().into(),
        result_allocator: allocator(memory),
        ..AnimOpts::default()
    };
    ufbx::create_anim(scene, options).map_err(|e| e.description.to_string())
}

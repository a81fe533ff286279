//! A model of another format turned so that it stands.

use glam::{DAffine3, DMat3, DVec3};

use super::UpAxis;
use crate::gltf::export::model::Model;

/// Turns a model that is made into a document, since a document of ours has y up.
pub(super) fn stand(model: &mut Model, up: UpAxis) {
    if up == UpAxis::Y {
        return;
    }
    for patch in model.objects.iter_mut().flat_map(|object| &mut object.patches) {
        patch.positions.iter_mut().chain(&mut patch.normals).for_each(|v| *v = up.to_y(*v));
    }
    for shape in model.objects.iter_mut().flat_map(|object| &mut object.shapes) {
        let all = shape.offsets.iter_mut().chain(&mut shape.normals).flatten();
        all.for_each(|(_, by)| *by = up.to_y(*by));
    }
    turn_groups(model, up);
}

/// Turns the places of groups, and what would hang there with them. Groups of meshes stay in the scene's space, as meshes are.
fn turn_groups(model: &mut Model, up: UpAxis) {
    let [x, y, z] =
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| DVec3::from(up.to_y(axis).map(f64::from)));
    let turn = DAffine3::from_mat3(DMat3::from_cols(x, y, z));
    let mut holds_mesh = vec![false; model.groups.len()];
    model.objects.iter().filter_map(|object| object.group).for_each(|group| holds_mesh[group] = true);
    // What a group hangs on comes before it.
    for (at, group) in model.groups.iter().enumerate().rev() {
        if let Some(parent) = group.parent {
            holds_mesh[parent] |= holds_mesh[at];
        }
    }
    // In the scene, before and after.
    let (mut old, mut new): (Vec<DAffine3>, Vec<DAffine3>) = (Vec::new(), Vec::new());
    for (group, holds_mesh) in model.groups.iter_mut().zip(holds_mesh) {
        let above = |all: &[DAffine3]| group.parent.map_or(DAffine3::IDENTITY, |parent| all[parent]);
        let (place, back) = (above(&old) * group.place, above(&new).inverse());
        let turned = if holds_mesh { place } else { turn * place };
        group.place = back * turned;
        old.push(place);
        new.push(turned);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gltf::export::model::{Group, Object, Patch, Shape};

    #[test]
    fn sockets_turn_with_the_model_that_they_are_of() {
        let tip = DVec3::new(1.0, 2.0, 3.0);
        let group = |parent, place| Group { name: String::new(), parent, place };
        let turn = DAffine3::from_rotation_translation(glam::DQuat::from_rotation_x(0.5), tip);
        // A group of the mesh with a socket, and a socket of the scene with another one on it.
        let groups = || {
            let on = DAffine3::from_translation(DVec3::X);
            vec![group(None, DAffine3::IDENTITY), group(Some(0), turn), group(None, turn), group(Some(2), on)]
        };
        for up in UpAxis::ALL {
            let patch = Patch { positions: vec![[1.0, 2.0, 3.0]], normals: vec![[0.0, 0.0, 1.0]], ..Patch::default() };
            let by = vec![vec![(0, [0.0, 0.0, 2.0])]];
            let shape = Shape { offsets: by.clone(), normals: by, ..Shape::default() };
            let body = Object {
                name: String::new(),
                group: Some(0),
                hidden: false,
                patches: vec![patch],
                shapes: vec![shape],
            };
            let mut model = Model { objects: vec![body], groups: groups(), ..Model::default() };
            stand(&mut model, up);
            let at = |at: DVec3| DVec3::from(up.to_y(at.as_vec3().to_array()).map(f64::from));
            let patch = &model.objects[0].patches[0];
            assert_eq!(patch.positions[0], up.to_y([1.0, 2.0, 3.0]));
            assert_eq!(patch.normals[0], up.to_y([0.0, 0.0, 1.0]));
            let shape = &model.objects[0].shapes[0];
            assert_eq!([shape.offsets[0][0].1, shape.normals[0][0].1], [up.to_y([0.0, 0.0, 2.0]); 2]);
            assert_eq!(model.groups[0].place, DAffine3::IDENTITY, "{up}");
            // What hangs on each stands where it would have been turned to.
            let hung = DVec3::new(0.25, 0.5, 1.0);
            for socket in [1, 2] {
                let is = model.groups[socket].place.transform_point3(hung);
                assert!(is.distance(at(turn.transform_point3(hung))) < 1e-6, "{up}: {is}");
            }
            let is = (model.groups[2].place * model.groups[3].place).transform_point3(hung);
            assert!(is.distance(at(turn.transform_point3(hung + DVec3::X))) < 1e-6, "{up}: {is}");
        }
    }
}

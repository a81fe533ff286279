//! Numbers that are not finite do not go on into what is written, and all others do.

mod common;

use common::Tiny;
use riglab_asset::export::{self, ExportNote, ExportOptions, Exported};
use riglab_asset::{ImportOptions, Resample, import_bytes};
use serde_json::{Value, json};

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// The tiny rig with normals, tangents, coordinates, colours, a morph target and a motion of two channels; `bad` is one number of
/// each but the second channel.
fn full(bad: f32) -> Tiny {
    let normals = [[0.0, 0.0, 2.0], [bad, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3]];
    let tangents = [[1.0, 0.0, 0.0, bad], [1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0]];
    let coordinates = [[0.5, 0.25], [0.5, bad], [0.0, 1.0], [1.0, 1.0]];
    let offsets = [[0.0, 0.1, 0.0], [0.0; 3], [0.0, bad, 0.0], [0.0; 3]];
    let turns = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, bad, 1.0]];
    let colours = [[0.5, 0.5, 0.5, 1.0], [1.0, 0.0, 0.0, 0.5], [0.0, 0.0, bad, 0.0], [0.0; 4]];
    let shifts = [[0.0, 1.0, 0.0], [0.0, 1.5, 0.0]];
    let tiny = Tiny::new()
        .with_accessor(5126, "VEC3", 4, &floats(normals.as_flattened()))
        .with_accessor(5126, "VEC4", 4, &floats(tangents.as_flattened()))
        .with_accessor(5126, "VEC2", 4, &floats(coordinates.as_flattened()))
        .with_accessor(5126, "VEC3", 4, &floats(offsets.as_flattened()))
        .with_accessor(5126, "SCALAR", 2, &floats(&[0.0, 1.0]))
        .with_accessor(5126, "VEC4", 2, &floats(turns.as_flattened()))
        .with_accessor(5126, "VEC3", 2, &floats(shifts.as_flattened()))
        .with_accessor(5126, "VEC4", 4, &floats(colours.as_flattened()));
    let channel = |sampler: usize, path: &str| json!({"sampler": sampler, "target": {"node": 2, "path": path}});
    let samplers = json!([{"input": 9, "output": 10}, {"input": 9, "output": 11}]);
    let mut tiny = tiny
        .with(
            "/animations",
            json!([{"channels": [channel(0, "rotation"), channel(1, "translation")], "samplers": samplers}]),
        )
        .with("/meshes/0/primitives/0/targets", json!([{"POSITION": 8, "TEXCOORD_0": 7, "COLOR_0": 12}]));
    for (name, accessor) in [("NORMAL", 5), ("TANGENT", 6), ("TEXCOORD_0", 7), ("COLOR_0", 12)] {
        tiny = tiny.with(&format!("/meshes/0/primitives/0/attributes/{name}"), json!(accessor));
    }
    tiny
}

/// The file written again with its own rig.
fn again(tiny: &Tiny) -> Exported {
    let imported = import_bytes("a.glb", &tiny.glb(), &ImportOptions::default()).unwrap();
    let rig = imported.rig().unwrap();
    export::onto_bytes("a.glb", &tiny.glb(), None, &imported, rig, &ExportOptions::default()).unwrap()
}

/// The JSON of a GLB, and the floats of an accessor.
fn parts(glb: &[u8]) -> (Value, impl Fn(&Value) -> Vec<f32> + '_) {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    let (document, binary) = (json.clone(), &glb[28 + length..]);
    let read = move |number: &Value| {
        let accessor = &document["accessors"][number.as_u64().unwrap() as usize];
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let from =
            [&view["byteOffset"], &accessor["byteOffset"]].iter().filter_map(|x| x.as_u64()).sum::<u64>() as usize;
        let to = from + view["byteLength"].as_u64().unwrap() as usize;
        binary[from..to].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
    };
    (json, read)
}

const TOLD: ExportNote =
    ExportNote::NotFinite { normals: 1, coordinates: 1, colours: 1, offsets: 3, tangents: 1, channels: 1 };

#[test]
fn what_is_not_finite_is_mended_and_told_and_the_rest_stays() {
    let sound = again(&full(0.0));
    assert_eq!(sound.notes, []);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let exported = again(&full(bad));
        assert_eq!(exported.notes, [TOLD]);
        let (json, read) = parts(&exported.bytes);
        let primitive = &json["meshes"][0]["primitives"][0];
        let normals = read(&primitive["attributes"]["NORMAL"]);
        let length = normals[3..6].iter().map(|x| x * x).sum::<f32>().sqrt();
        assert!((length - 1.0).abs() < 1e-6, "{normals:?}");
        // The others are no unit vectors, and no matter of this.
        assert_eq!((&normals[..3], &normals[6..]), (&[0.0, 0.0, 2.0][..], &[0.0, 1.0, 0.0, 0.0, 0.0, 0.0][..]));
        assert_eq!(read(&primitive["attributes"]["TEXCOORD_0"]), [0.5, 0.25, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        let colours = [0.5, 0.5, 0.5, 1.0, 1.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(read(&primitive["attributes"]["COLOR_0"]), colours);
        // Nothing is added to them, which is not what they are.
        let added = read(&primitive["targets"][0]["COLOR_0"]);
        assert_eq!((&added[..8], &added[8..]), (&colours[..8], &[0.0; 8][..]));
        assert_eq!(read(&primitive["targets"][0]["TEXCOORD_0"]), [0.5, 0.25, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        let offsets = read(&primitive["targets"][0]["POSITION"]);
        assert_eq!((offsets[1], offsets.iter().filter(|x| **x != 0.0).count()), (0.1, 1));
        assert!(primitive["attributes"].get("TANGENT").is_none());
        let animation = &json["animations"][0];
        assert_eq!(
            (animation["channels"].as_array().unwrap().len(), animation["samplers"].as_array().unwrap().len()),
            (1, 1)
        );
        assert_eq!(animation["channels"][0]["target"]["path"], "translation");
        // What was mended needs no mending.
        let back = import_bytes("a.glb", &exported.bytes, &ImportOptions::default()).unwrap();
        let twice =
            export::onto_bytes("a.glb", &exported.bytes, None, &back, back.rig().unwrap(), &ExportOptions::default());
        assert_eq!(twice.unwrap().notes, []);
    }
    assert_eq!(
        TOLD.to_string(),
        "numbers in it are not finite (NaN or infinity), which glTF does not allow: 1 normal was made anew, 1 texture \
         coordinate was set to 0, 1 colour was set to white, 3 offsets of morph targets were set to 0, 1 primitive lost \
         its tangents, 1 animation channel was left out"
    );
}

#[test]
fn it_is_mended_where_a_motion_is_added_and_where_the_rig_goes() {
    let bytes = full(f32::NAN).glb();
    let clips = ImportOptions { clips: Some(Resample::default()), ..ImportOptions::default() };
    let sound = import_bytes("a.glb", &full(0.0).glb(), &clips).unwrap();
    let imported = import_bytes("a.glb", &bytes, &ImportOptions::default()).unwrap();
    let skeleton = imported.rig().unwrap().skeleton();
    let moved = export::animate(&bytes, None, &imported, skeleton, &sound.clips[0]).unwrap();
    assert_eq!(moved.notes, [TOLD]);
    let bare = export::strip_bytes("a.glb", &bytes, None, &ImportOptions::default()).unwrap();
    assert_eq!(bare.notes, [TOLD, ExportNote::MotionDropped { channels: 1 }]);
}

#[test]
fn morph_targets_lose_what_they_add_to_tangents_that_go() {
    let targets = json!([{"POSITION": 8, "TANGENT": 8}, {"TANGENT": 8}]);
    let exported = again(&full(f32::NAN).with("/meshes/0/primitives/0/targets", targets));
    let json = parts(&exported.bytes).0;
    let targets = json["meshes"][0]["primitives"][0]["targets"].as_array().unwrap();
    assert!(targets.iter().all(|own| own.get("TANGENT").is_none() && own.get("POSITION").is_some()), "{targets:?}");
    let still = &json["accessors"][targets[1]["POSITION"].as_u64().unwrap() as usize];
    assert_eq!((&still["count"], &still["max"], still.get("bufferView")), (&json!(4), &json!([0.0, 0.0, 0.0]), None));
}

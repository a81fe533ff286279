//! What tests of several tasks need.

use std::path::Path;
use std::sync::Arc;

use riglab_augment::{CubeConfig, Recipe, ScaleConfig, Shift};
use riglab_core::{Asset, Bounds, Joint, JointId, Mesh, Provenance, Rig, Skeleton, SkinWeights};
use riglab_data::CorpusWriter;
use riglab_nn::fsq_cvae::{Extensions, FsqCvaeConfig, SkinQueries};
use riglab_nn::tokenrig::{Head, TokenRigConfig};
use riglab_token::Limits;
use tch::Device;

use super::{Rigger, TokenRigTaskConfig};
use crate::assets::Assets;
use crate::fsq_cvae::{Frozen, FsqCvaeTask, FsqCvaeTaskConfig};

/// A model that has learnt nothing, of the smallest sizes.
pub(crate) fn untrained(head: Head, empty: bool) -> Rigger {
    of(head, empty, Extensions::default())
}

/// The same, whose auto-encoder is told what geometry alone says.
pub(crate) fn with_prior(head: Head) -> Rigger {
    of(head, true, Extensions { bone_geometry: true, prior: true, ..Extensions::default() })
}

fn of(head: Head, empty: bool, extensions: Extensions) -> Rigger {
    let model = FsqCvaeConfig {
        extensions,
        encoder_width: 16,
        decoder_width: 16,
        heads: 2,
        encoder_layers: 1,
        decoder_layers: 1,
        latent: 8,
        levels: vec![4, 3],
        shape_tokens: 4,
        skin_tokens: 4,
        skin_queries: SkinQueries::Learned,
        ..FsqCvaeConfig::default()
    };
    let mut auto = FsqCvaeTaskConfig { model, ..FsqCvaeTaskConfig::default() };
    auto.sampling.shape_points = 32;
    let (net, params) = FsqCvaeTask::network(&auto, Device::Cpu).unwrap();
    let vae = Arc::new(Frozen::new(auto, net, params, Device::Cpu));
    let told = head == Head::Levels;
    let mut model = TokenRigConfig { head, tell_joint: told, tell_region: told, ..TokenRigConfig::default() };
    (model.tell_rule, model.tell_place) = (told, told);
    let mut config = TokenRigTaskConfig { model, ..TokenRigTaskConfig::default() };
    config.model.shape.tokens = 4;
    config.model.shape.layers = 1;
    (config.model.shape.width, config.model.shape.heads) = (16, 2);
    let d = &mut config.model.decoder;
    (d.width, d.layers, d.heads, d.kv_heads, d.head_width, d.ffn) = (16, 2, 2, 1, 8, 32);
    config.sampling.cloud.points = 64;
    config.limits = Limits { joints: 6, tokens: 48 };
    (config.skin.codes, config.skin.empty) = (2, empty);
    config.validate().unwrap();
    Rigger::new(config, vae, Device::Cpu).unwrap()
}

/// A closed mesh of four vertices.
pub(crate) fn tetrahedron() -> Mesh {
    let corners = vec![[-1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]];
    Mesh::new(corners, vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]).unwrap()
}

/// A corpus whose only asset, to train on, is [`tetrahedron`] with a root in its middle and a tip above.
pub(crate) fn corpus_of_one(folder: &Path) -> Arc<Assets> {
    let path = folder.join("one.h5");
    let joint = |name: &str, parent, y| Joint { name: name.into(), parent, head: [0.0, y, 0.0] };
    let skeleton = Skeleton::new(vec![joint("root", None, 0.0), joint("tip", Some(JointId(0)), 0.5)]).unwrap();
    let weights = SkinWeights::normalized((0..4).map(|v| [(v % 2, 1.0)])).unwrap();
    let rig = Rig::new(skeleton, tetrahedron(), weights).unwrap();
    let mut writer = CorpusWriter::create(&path).unwrap();
    writer.add(&Asset { name: "a".into(), rig, clips: Vec::new(), provenance: Provenance::default() }).unwrap();
    writer.finish(&["train"]).unwrap();
    Arc::new(Assets::open(&[path]).unwrap())
}

/// That clouds of batches of [`corpus_of_one`], with its vertices in them, lie where recipes leave the rig.
pub(crate) fn assert_placed(cloud: impl Fn(Recipe) -> Vec<f32>) {
    let bounds = |recipe| {
        let cloud = cloud(recipe);
        let (rows, _) = cloud.as_chunks::<6>();
        Bounds::of(rows.iter().map(|&[x, y, z, ..]| [x, y, z])).unwrap()
    };
    let near = |sides: [f32; 3], wanted: f32| sides.iter().all(|side| (side - wanted).abs() < 1e-4);
    let cube = |scale, most| CubeConfig {
        scale_probability: 1.0,
        scale: [scale; 2],
        shift_probability: 1.0,
        shift: Shift::UpTo(most),
        ..CubeConfig::default()
    };
    let small = bounds(Recipe { cube: cube(0.5, 0.2), ..Recipe::default() });
    assert!(near(small.size(), 1.0) && small.center().iter().all(|x| *x != 0.0 && x.abs() <= 0.2), "{small:?}");
    // Joints outside are written at the border.
    let far = bounds(Recipe { cube: cube(3.0, 2.0), ..Recipe::default() });
    assert!(near(far.size(), 6.0), "{far:?}");
    let off = CubeConfig { enabled: false, ..CubeConfig::default() };
    let scale = ScaleConfig { probability: 1.0, range: [3.0, 3.0], uniform: true };
    let set = bounds(Recipe { cube: off, scale, ..Recipe::default() });
    assert!(near(set.size(), 2.0) && near(set.center(), 0.0), "{set:?}");
}

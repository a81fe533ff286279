//! What tests of several tasks need.

use std::sync::Arc;

use riglab_core::Mesh;
use riglab_nn::fsq_cvae::{Extensions, FsqCvaeConfig, SkinQueries};
use riglab_nn::tokenrig::{Head, TokenRigConfig};
use riglab_token::Limits;
use tch::Device;

use super::{Rigger, TokenRigTaskConfig};
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

//! Which model a checkpoint holds, by the names of its tensors.

use std::collections::BTreeMap;
use std::str::FromStr;

/// A model that was published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// UniRig's skin stage, task `unirig_skin`.
    UnirigSkin,
    /// SkinTokens' TokenRig, task `tokenrig`.
    TokenRig,
    /// UniRig's skeleton stage, task `unirig_skeleton`.
    UnirigSkeleton,
    /// SkinTokens' auto-encoder, task `fsq_cvae`.
    FsqCvae,
}

impl Model {
    /// All of them; those that hold others within come first.
    pub const ALL: [Self; 4] = [Self::UnirigSkin, Self::TokenRig, Self::UnirigSkeleton, Self::FsqCvae];

    /// The task's name.
    pub fn task(self) -> &'static str {
        match self {
            Self::UnirigSkin => "unirig_skin",
            Self::TokenRig => "tokenrig",
            Self::UnirigSkeleton => "unirig_skeleton",
            Self::FsqCvae => "fsq_cvae",
        }
    }

    /// What it is called where it was published.
    pub fn title(self) -> &'static str {
        match self {
            Self::UnirigSkin => "UniRig's skin stage",
            Self::TokenRig => "SkinTokens' TokenRig",
            Self::UnirigSkeleton => "UniRig's skeleton stage",
            Self::FsqCvae => "SkinTokens' auto-encoder",
        }
    }

    /// The end of a name that no other model has.
    pub fn sign(self) -> &'static str {
        match self {
            Self::UnirigSkin => "bone_encoder.bone_encoder.1.weight",
            Self::TokenRig => "transformer.model.embed_tokens.weight",
            Self::UnirigSkeleton => "transformer.model.decoder.embed_tokens.weight",
            Self::FsqCvae => "cond_encoder.proj_in.weight",
        }
    }
}

impl FromStr for Model {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|m| m.task() == text);
        known.ok_or_else(|| format!("`{text}` is none of {}", Self::ALL.map(Self::task).join(", ")))
    }
}

/// A model in a checkpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundModel {
    /// Which.
    pub model: Model,
    /// What stands before its names: `model.` where Lightning kept it.
    pub prefix: String,
}

/// Finds a model by the names of tensors: the one asked for, or the one that holds most. Of several copies (a moving
/// average may stand beside), the one with the shortest names.
pub fn recognise<'a>(names: impl Iterator<Item = &'a String> + Clone, wanted: Option<Model>) -> Option<FoundModel> {
    let of = |model: Model| {
        let before = names.clone().filter_map(move |name| {
            let plain = plain(name);
            let prefix = plain.strip_suffix(model.sign())?;
            (prefix.is_empty() || prefix.ends_with('.')).then(|| prefix.to_string())
        });
        let prefix = before.min_by_key(|prefix| (prefix.len(), prefix.clone()))?;
        Some(FoundModel { model, prefix })
    };
    match wanted {
        Some(model) => of(model),
        None => Model::ALL.into_iter().find_map(of),
    }
}

impl FoundModel {
    /// By the networks' name that of the checkpoint, of all tensors below the prefix.
    pub(super) fn names<'a>(&self, all: impl Iterator<Item = &'a String>) -> BTreeMap<String, String> {
        let own = |name: &String| Some((plain(name).strip_prefix(&self.prefix)?.to_string(), name.clone()));
        all.filter_map(own).collect()
    }
}

/// A name without what wrappers add: `torch.compile` within, data parallelism before it.
pub fn plain(name: &str) -> String {
    let name = name.replace("_orig_mod.", "");
    let mut rest = name.as_str();
    while let Some(shorter) = rest.strip_prefix("module.").or_else(|| rest.strip_prefix("_forward_module.")) {
        rest = shorter;
    }
    rest.to_string()
}

/// What a tensor is that no parameter needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KnownAs {
    /// The head, which is the table of embeddings.
    Tied,
    /// Made anew from the settings, or counted while training.
    Derived,
    /// Of a part that inference passes by.
    Unused,
}

/// The table of embeddings that a model's head is.
pub(super) fn tied(model: Model) -> &'static str {
    model.sign()
}

/// Of the checkpoint's tensors, those that are known and not needed.
pub(super) fn known(model: Model, names: &BTreeMap<String, String>) -> Vec<(String, KnownAs)> {
    let tails = [
        "inv_freq",
        "position_ids",
        "num_batches_tracked",
        "._levels",
        "._basis",
        ".implicit_codebook",
        ".frequencies",
        ".freqs",
        ".phases",
        "_extra_state",
    ];
    let of = |own: &String| {
        if matches!(model, Model::TokenRig | Model::UnirigSkeleton) && own == "transformer.lm_head.weight" {
            return Some((own.clone(), KnownAs::Tied));
        }
        if tails.iter().any(|tail| own.ends_with(tail)) {
            return Some((own.clone(), KnownAs::Derived));
        }
        // The auto-encoder is read by itself; what changes the number of its tokens is passed by where it stays.
        let passed_by = model == Model::TokenRig && own.starts_with("vae.");
        passed_by.then(|| (own.clone(), KnownAs::Unused))
    };
    names.keys().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(names: &[&str], wanted: Option<Model>) -> Option<(Model, String)> {
        let names: Vec<String> = names.iter().map(|n| (*n).to_string()).collect();
        recognise(names.iter(), wanted).map(|f| (f.model, f.prefix))
    }

    #[test]
    fn models_are_known_by_their_names_whatever_stands_before() {
        let rig = "transformer.model.embed_tokens.weight";
        let vae = "vae.model._orig_mod.cond_encoder.proj_in.weight";
        assert_eq!(found(&[rig, vae], None), Some((Model::TokenRig, String::new())));
        assert_eq!(found(&[rig, vae], Some(Model::FsqCvae)), Some((Model::FsqCvae, "vae.model.".into())));
        assert_eq!(found(&["model.cond_encoder.proj_in.weight"], None), Some((Model::FsqCvae, "model.".into())));
        let compiled = ["module.model.transformer._orig_mod.model.decoder.embed_tokens.weight"];
        assert_eq!(found(&compiled, None), Some((Model::UnirigSkeleton, "model.".into())));
        let copies = ["ema_model.bone_encoder.bone_encoder.1.weight", "model.bone_encoder.bone_encoder.1.weight"];
        assert_eq!(found(&copies, None), Some((Model::UnirigSkin, "model.".into())));
        assert_eq!(found(&copies, Some(Model::TokenRig)), None);
        assert_eq!(found(&["xcond_encoder.proj_in.weight"], None), None);
    }

    #[test]
    fn names_come_without_prefix_and_wrappers() {
        let found = FoundModel { model: Model::TokenRig, prefix: "model.".into() };
        let names = ["model._orig_mod.a.b".to_string(), "other.c".into()];
        assert_eq!(found.names(names.iter()), BTreeMap::from([("a.b".into(), names[0].clone())]));
    }
}

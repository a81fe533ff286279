//! What the settings of every task that writes skeletons as tokens must hold.

use riglab_geom::CloudConfig;
use riglab_nn::generate::GenerateConfig;
use riglab_nn::perceiver::PerceiverConfig;
use riglab_token::{EncodeFault, Grammar, Limits, Merge, Parents, Tokenizer, TokenizerConfig, Vocabulary};

use crate::assets::{AssetId, Assets, DataConfig};

/// The settings that such tasks share, by the keys they have in all of them.
pub(crate) struct Sequences<'a> {
    pub class: &'a str,
    pub tokenizer: &'a TokenizerConfig,
    pub limits: Limits,
    pub shape: &'a PerceiverConfig,
    pub cloud: &'a CloudConfig,
    pub rigs: usize,
    pub class_dropout: f32,
    pub generate: &'a GenerateConfig,
    pub parents: Parents,
    pub rows: usize,
    pub retrieval_points: usize,
    pub spread: f64,
}

impl Sequences<'_> {
    /// Checks ranges and relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        let bad = |key: &str, message: String| Err((key.to_owned(), message));
        drawable(self.generate, self.parents, self.tokenizer)?;
        if !self.class.is_empty() && !self.tokenizer.classes.iter().any(|c| c == self.class) {
            let there = self.tokenizer.classes.join(", ");
            return bad("class", format!("the tokenizer has no class `{}`; there are: {there}", self.class));
        }
        for (key, rigs) in [("sampling.rigs", self.rigs), ("eval.rows", self.rows)] {
            if rigs == 0 {
                return bad(key, "it takes at least 1 rig at a time".into());
            }
        }
        if !(0.0..=1.0).contains(&self.class_dropout) {
            return bad("sampling.class_dropout", format!("{} must lie in [0, 1]", self.class_dropout));
        }
        let (points, asked) = (self.cloud.points, self.shape.tokens * self.shape.drawn);
        if points < asked {
            let of = format!("{} tokens × {} drawn", self.shape.tokens, self.shape.drawn);
            return bad("sampling.cloud.points", format!("{points} points are too few for model.shape: {of}"));
        }
        let [low, high] = self.tokenizer.range;
        if self.tokenizer.bins < 2 {
            return bad("tokenizer.bins", "a coordinate takes 2 bins or more".into());
        }
        if !((-WIDEST..=-1.0).contains(&low) && (1.0..=WIDEST).contains(&high)) {
            let message = format!(
                "[{low:?}, {high:?}]: rigs are set between -1 and 1, and the range must hold that; it may reach \
                 {WIDEST} either way"
            );
            return bad("tokenizer.range", message);
        }
        named("tokenizer.parts", &self.tokenizer.parts)?;
        named("tokenizer.classes", &self.tokenizer.classes)?;
        if let Merge::Within(distance) = self.tokenizer.merge
            && (distance.is_nan() || distance < 0.0)
        {
            return bad("tokenizer.merge", format!("within = {distance:?} is a distance: give 0 or more"));
        }
        let least = self.tokenizer.least_joints.max(1);
        let shortest = shortest(least);
        if self.limits.joints < least {
            return bad("limits.joints", format!("a skeleton takes at least {least}"));
        }
        if self.limits.tokens < shortest {
            return bad("limits.tokens", format!("a skeleton takes at least {shortest} tokens"));
        }
        if !(1..=MOST_COMPARED).contains(&self.retrieval_points) {
            let message = format!("shapes are compared by 1 to {MOST_COMPARED} points, not {}", self.retrieval_points);
            return bad("eval.retrieval_points", message);
        }
        if !(self.spread >= 0.0 && self.spread < 64.0) {
            return bad("loss.spread", format!("{} must lie in [0, 64)", self.spread));
        }
        self.fits_class().map_err(|message| ("class".into(), message))
    }

    /// Checks that there is room for the joints that every sequence of the class has.
    fn fits_class(&self) -> Result<(), String> {
        if self.class.is_empty() {
            return Ok(());
        }
        let tokenizer = Tokenizer::new(self.tokenizer.clone());
        // The end of a sequence is not counted among what is drawn.
        let tokens = self.limits.tokens.min(self.generate.tokens.saturating_add(1));
        let limits = Limits { tokens, ..self.limits };
        let may_begin = |ids: &[u32]| may_begin(&tokenizer, limits, self.parents, ids);
        of_class(tokenizer.vocabulary(), self.class, limits, may_begin).map(drop)
    }
}

/// Points by which shapes are compared at most: all training shapes' are held, and each is compared with each.
const MOST_COMPARED: usize = 100_000;

/// How far the range of coordinates may reach: cells of a much wider one hold whole rigs.
const WIDEST: f32 = 10.0;

/// Checks names that become tokens: each has one of its own.
///
/// # Errors
/// (key, message).
fn named(key: &str, names: &[String]) -> Result<(), (String, String)> {
    match (1..names.len()).find(|&k| names[..k].contains(&names[k])) {
        Some(k) => Err((key.into(), format!("`{}` is named twice, and is one token: name it once", names[k]))),
        None if names.iter().any(String::is_empty) => Err((key.into(), "an empty name is none of anything".into())),
        None => Ok(()),
    }
}

/// The tokens of the shortest skeleton of so many joints: start, class, a spring token, joints, end.
fn shortest(joints: usize) -> usize {
    3 * joints.max(1) + 4
}

/// Checks how evaluation draws sequences of a tokenizer.
///
/// # Errors
/// (key, message) of the first fault.
pub(crate) fn drawable(
    generate: &GenerateConfig,
    parents: Parents,
    tokenizer: &TokenizerConfig,
) -> Result<(), (String, String)> {
    let bad = |key: &str, message: String| Err((format!("eval.{key}"), message));
    if let Err((key, message)) = generate.validate() {
        return bad(&format!("generate.{key}"), message);
    }
    let shortest = shortest(tokenizer.least_joints);
    if generate.tokens < shortest {
        return bad("generate.tokens", format!("a skeleton takes at least {shortest} tokens"));
    }
    if parents == Parents::Anywhere && matches!(tokenizer.merge, Merge::Within(_)) {
        return bad("parents", "`anywhere` needs tokenizer.merge = \"nearest\"".into());
    }
    Ok(())
}

/// Whether an asset may have a sequence within limits, whatever is done to it.
pub(crate) fn may_fit(assets: &Assets, limits: Limits, id: AssetId) -> bool {
    let joints = assets.counts(id)[2];
    limits.hold(joints, 3 * joints + 3)
}

/// Assets of the training splits that are not trained on.
#[derive(Clone, Copy, Default)]
pub(crate) struct LeftOut {
    out: usize,
    all: usize,
    /// Whether nothing is left of a corpus.
    whole: bool,
    /// What sequences have to fit, where they have to.
    limits: Option<Limits>,
}

impl LeftOut {
    /// Takes out of `training` what cannot fit; augmentation may still make others too long.
    ///
    /// # Errors
    /// A sentence: when a column cannot be read.
    pub fn take(
        assets: &Assets,
        data: &DataConfig,
        limits: Limits,
        training: &mut [(f32, Vec<AssetId>)],
    ) -> Result<Self, String> {
        let none: Vec<bool> = training.iter().map(|(_, ids)| ids.is_empty()).collect();
        training.iter_mut().for_each(|(_, ids)| ids.retain(|&id| may_fit(assets, limits, id)));
        // Where there was nothing, nothing is trained on.
        let whole = training.iter().zip(none).any(|((_, ids), none)| ids.is_empty() && !none);
        Ok(Self { whole, limits: Some(limits), ..Self::of(assets, data, training)? })
    }

    /// What `training`, as of [`Assets::training`], is without: whatever has too many joints.
    ///
    /// # Errors
    /// A sentence: when a column cannot be read.
    pub fn of(assets: &Assets, data: &DataConfig, training: &[(f32, Vec<AssetId>)]) -> Result<Self, String> {
        let mut all = 0;
        for split in &data.train {
            let own = assets.split(split).map_err(|e| e.to_string())?;
            all += own.into_iter().filter(|&id| data.trains_on(id)).count();
        }
        Ok(Self {
            out: all - training.iter().map(|(_, ids)| ids.len()).sum::<usize>().min(all),
            all,
            ..Self::default()
        })
    }

    /// Why this cannot be trained on; evaluations need none of it.
    pub fn untrainable(self) -> Option<String> {
        let Limits { joints, tokens } = self.limits.filter(|_| self.whole)?;
        Some(format!("no asset of a corpus fits limits.joints = {joints} and limits.tokens = {tokens}; raise them"))
    }

    /// What someone who trains should know of it.
    pub fn notes(self, data: &DataConfig) -> Vec<String> {
        let Self { out, all, limits, .. } = self;
        let limits = limits.map_or(String::new(), |Limits { joints, tokens }| {
            format!(
                " or limits.joints = {joints}, or more tokens than limits.tokens = {tokens}; those that only augmentation makes \
                 too long are counted in train/skipped_assets"
            )
        });
        let most = data.max_joints;
        let note = || {
            format!(
                "{out} of {all} training assets are left out: they have more joints than data.max_joints = {most}{limits}"
            )
        };
        (out > 0).then(note).into_iter().collect()
    }
}

/// How often another asset is tried in place of one whose sequence is too long.
const TRIES: u64 = 256;
/// Far beyond the places of any run.
const ELSEWHERE: u64 = 1 << 40;

/// Why a rig has no sequence that a model reads.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Unfit {
    /// It has more joints or tokens than the limits allow.
    Long,
    /// It cannot be written as tokens, for this reason.
    Unwritten(String),
}

impl From<EncodeFault> for Unfit {
    fn from(fault: EncodeFault) -> Self {
        Self::Unwritten(fault.to_string())
    }
}

/// Fills batch `number` with `rigs` rigs: `add` takes the one of a place, or says why it has no sequence within `limits`;
/// another place is tried where it has none. How many have none.
///
/// # Errors
/// Those of `add`, and a sentence where none of many assets has one.
pub(crate) fn filled(
    number: u64,
    rigs: usize,
    limits: Limits,
    mut add: impl FnMut(u64) -> Result<Result<(), Unfit>, String>,
) -> Result<usize, String> {
    let (rigs, mut skipped) = (rigs as u64, 0);
    for place in number * rigs..(number + 1) * rigs {
        let (mut found, mut faults) = (false, Vec::new());
        for place in (0..TRIES).map(|t| t * ELSEWHERE + place) {
            match add(place)? {
                Ok(()) => found = true,
                Err(Unfit::Unwritten(fault)) => faults.push(fault),
                Err(Unfit::Long) => {}
            }
            if found {
                break;
            }
            skipped += 1;
        }
        if !found {
            return Err(none_of_them(limits, &faults));
        }
    }
    Ok(skipped)
}

/// What is said where none of the assets that were tried has a sequence, with the faults of those that cannot be written at
/// all.
fn none_of_them(Limits { joints, tokens }: Limits, faults: &[String]) -> String {
    let within =
        format!("of {TRIES} assets none has a sequence within limits.tokens = {tokens} and limits.joints = {joints}");
    match faults.first() {
        None => format!("{within}; raise them, or lower data.max_joints"),
        Some(first) => format!(
            "{within}: {} of them cannot be written as tokens, whatever the limits; the first: {first}. Change `tokenizer`, or \
             leave such assets out of the corpora",
            faults.len()
        ),
    }
}

/// What is said where none of the draws for a mesh is a skeleton.
pub(crate) const NO_SKELETON: &str = "no sample is a valid skeleton; try more --samples, or another --seed";

/// Whether a sequence may begin so, within limits.
pub(crate) fn may_begin(tokenizer: &Tokenizer, limits: Limits, parents: Parents, ids: &[u32]) -> bool {
    let mut grammar = Grammar::new(tokenizer, limits, parents);
    ids.iter().all(|&id| grammar.advance(id).is_ok())
}

/// The beginning of sequences of a class, as long as sequences may begin so.
///
/// # Errors
/// A sentence: the vocabulary has no such class, or there is no room for its joints.
pub(crate) fn of_class(
    ids: &Vocabulary,
    class: &str,
    limits: Limits,
    may_begin: impl Fn(&[u32]) -> bool,
) -> Result<Vec<u32>, String> {
    let known = || format!("there is no template `{class}`; there are: {}", ids.classes().join(", "));
    let begun = vec![ids.bos(), ids.class(ids.class_named(class).ok_or_else(known)?)];
    if may_begin(&begun) {
        return Ok(begun);
    }
    Err(format!(
        "the joints of `{class}` are more than this model writes ({} joints, {} tokens); leave the template out",
        limits.joints, limits.tokens
    ))
}

#[cfg(test)]
mod tests {
    use riglab_core::{Asset, Joint, JointId, Provenance, Rig, Skeleton, SkinWeights};
    use riglab_data::CorpusWriter;

    use super::*;
    use crate::tokenrig::TokenRigTaskConfig;
    use crate::tokenrig::testing::tetrahedron;

    #[test]
    fn only_assets_of_trained_corpora_are_left_out() {
        let dir = tempfile::tempdir().unwrap();
        // Rigs of a single joint, and of four.
        let corpora = ["a.h5", "b.h5"].map(|file| {
            let path = dir.path().join(file);
            let mut writer = CorpusWriter::create(&path).unwrap();
            for count in [1, 4] {
                let joint = |j: u16| Joint {
                    name: format!("j{j}"),
                    parent: j.checked_sub(1).map(JointId),
                    head: [f32::from(j), 0.0, 0.0],
                };
                let skeleton = Skeleton::new((0..count).map(joint).collect()).unwrap();
                let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
                let rig = Rig::new(skeleton, tetrahedron(), weights).unwrap();
                let name = format!("{file} {count}");
                writer.add(&Asset { name, rig, clips: Vec::new(), provenance: Provenance::default() }).unwrap();
            }
            writer.finish(&["train"; 2]).unwrap();
            path
        });
        let assets = Assets::open(&corpora).unwrap();
        let of = |weights: &[f32]| {
            let data = DataConfig { corpora: corpora.to_vec(), weights: weights.to_vec(), ..DataConfig::default() };
            let mut training = assets.training(&data).unwrap();
            let left = LeftOut::take(&assets, &data, Limits { joints: 2, tokens: 99 }, &mut training).unwrap();
            let none = LeftOut::take(&assets, &data, Limits { joints: 0, tokens: 99 }, &mut training.clone()).unwrap();
            assert!(left.untrainable().is_none());
            assert!(none.untrainable().unwrap().contains("limits.joints = 0"));
            assert!(
                left.notes(&data)[0].contains("= 1024 or limits.joints = 2, or more tokens than limits.tokens = 99;")
            );
            (left.out, left.all)
        };
        assert_eq!([of(&[]), of(&[1.0, 2.0]), of(&[1.0, 0.0])], [(2, 4), (2, 4), (1, 2)]);
        // Without sequences there is one limit.
        let told = |max_joints| {
            let data = DataConfig { corpora: corpora.to_vec(), max_joints, ..DataConfig::default() };
            let left = LeftOut::of(&assets, &data, &assets.training(&data).unwrap()).unwrap();
            assert!(left.untrainable().is_none());
            left.notes(&data)
        };
        assert_eq!(told(4), [""; 0]);
        let said = "2 of 4 training assets are left out: they have more joints than data.max_joints = 3";
        assert_eq!(told(3), [said]);
    }

    #[test]
    fn a_rig_without_a_sequence_makes_room_for_one_from_elsewhere() {
        let (mut taken, limits) = (Vec::new(), Limits { joints: 7, tokens: 9 });
        let skipped = filled(2, 3, limits, |place| {
            let fits = place != 7 && place != ELSEWHERE + 7;
            taken.extend(fits.then_some(place));
            Ok(if fits { Ok(()) } else { Err(Unfit::Long) })
        });
        assert_eq!((skipped, taken), (Ok(2), vec![6, 2 * ELSEWHERE + 7, 8]));
        let said = filled(0, 1, limits, |_| Ok(Err(Unfit::Long))).unwrap_err();
        assert!(
            said.contains("none has a sequence within limits.tokens = 9 and limits.joints = 7; raise them"),
            "{said}"
        );
        // What no limit helps is not told to be too long.
        let fault = |place| if place == 0 { Unfit::Long } else { EncodeFault::TwoOfOneName("hips".into()).into() };
        let said = filled(0, 1, limits, |place| Ok(Err(fault(place)))).unwrap_err();
        assert!(said.contains("255 of them cannot be written as tokens") && said.contains("named `hips`"), "{said}");
        assert!(!said.contains("raise them"), "{said}");
        assert_eq!(filled(0, 1, limits, |_| Err("x".into())), Err("x".into()));
    }

    #[test]
    fn limits_that_hold_no_skeleton_are_named_each() {
        let of = |change: fn(&mut TokenRigTaskConfig)| {
            let mut c = TokenRigTaskConfig::default();
            change(&mut c);
            c.validate().unwrap_err()
        };
        let (key, message) = of(|c| c.limits.joints = 0);
        assert!(key == "limits.joints" && message.contains("at least 1"), "{key}: {message}");
        assert_eq!(of(|c| c.limits.tokens = 3).0, "limits.tokens");
        assert_eq!([of(|c| c.eval.rows = 0).0, of(|c| c.sampling.rigs = 0).0], ["eval.rows", "sampling.rigs"]);
        assert_eq!(of(|c| c.eval.retrieval_points = 0).0, "eval.retrieval_points");
        assert_eq!(of(|c| c.eval.retrieval_points = 100_001).0, "eval.retrieval_points");
        assert_eq!(of(|c| c.tokenizer.bins = 1).0, "tokenizer.bins");
        assert_eq!(of(|c| c.tokenizer.range = [0.0, 1.0]).0, "tokenizer.range");
        assert_eq!(of(|c| c.tokenizer.range = [-1.0, 1e30]).0, "tokenizer.range");
    }

    #[test]
    fn a_class_whose_joints_have_no_room_is_refused() {
        let of = |class: &str, joints: usize, tokens: usize, drawn: usize| {
            let mut c = TokenRigTaskConfig { class: class.into(), ..TokenRigTaskConfig::default() };
            (c.limits, c.eval.generate.tokens) = (Limits { joints, tokens }, drawn);
            c.model.decoder.positions = 1 << 16;
            c.validate().map_err(|(key, message)| format!("{key}: {message}"))
        };
        assert_eq!([of("mixamo", 64, 400, 400), of("", 8, 400, 400)], [Ok(()), Ok(())]);
        for (joints, tokens, drawn) in [(8, 400, 400), (64, 40, 400), (64, 400, 40)] {
            let said = of("mixamo", joints, tokens, drawn).unwrap_err();
            assert!(said.starts_with("class: the joints of `mixamo` are more than this model writes"), "{said}");
        }
        assert!(of("mixamo", 8, 400, 400).unwrap_err().contains("(8 joints, 400 tokens)"));
    }

    #[test]
    fn names_of_tokens_are_told_apart_and_distances_are_some() {
        let of = |change: fn(&mut TokenRigTaskConfig)| {
            let mut c = TokenRigTaskConfig::default();
            change(&mut c);
            c.validate().map_err(|(key, _)| key)
        };
        let key = |key: &str| Err(key.to_owned());
        assert_eq!(
            of(|c| c.tokenizer.parts = vec!["body".into(), "hand".into(), "body".into()]),
            key("tokenizer.parts")
        );
        assert_eq!(of(|c| c.tokenizer.parts = vec![String::new()]), key("tokenizer.parts"));
        assert_eq!(of(|c| c.tokenizer.classes = vec!["x".into(), "x".into()]), key("tokenizer.classes"));
        for wrong in [-0.1, f32::NAN] {
            let mut c = TokenRigTaskConfig::default();
            c.tokenizer.merge = Merge::Within(wrong);
            assert_eq!(c.validate().unwrap_err().0, "tokenizer.merge");
        }
    }
}

//! What must hold for any skeleton and any sequence.

use riglab_random::{Draw, Stream, stream};
use riglab_token::{Bones, Grammar, Limits, Mask, Parents, Preset, Spring, Template, Tokenizer, TokenizerConfig};

/// A random tree whose joints often share a cell, some outside the range.
struct Tree {
    joints: Vec<[f64; 3]>,
    parents: Vec<Option<usize>>,
    names: Vec<String>,
}

impl Tree {
    fn new(random: &mut Stream) -> Self {
        let count = 1 + random.below(90);
        let coarse = [4.0, 30.0, 1e6][random.below(3)];
        let coordinate = |random: &mut Stream| {
            let x = 2.2 * f64::from(random.unit()) - 1.1;
            (x * coarse).round() / coarse
        };
        let joints = (0..count).map(|_| std::array::from_fn(|_| coordinate(random))).collect();
        let parents =
            (0..count).map(|j| (j > 0).then(|| if random.unit() < 0.6 { j - 1 } else { random.below(j) })).collect();
        let mut tree = Self { joints, parents, names: (0..count).map(|j| format!("j{j}")).collect() };
        if random.unit() < 0.3 {
            tree.as_made(&Template::ALL[random.below(2)], random);
        }
        tree
    }

    /// A body of a template, sometimes hands, and some joints more.
    fn as_made(&mut self, template: &Template, random: &mut Stream) {
        let parts = 1 + random.below(2);
        let named: Vec<_> = template.parts[..parts].iter().flat_map(|p| p.joints).map(|n| (*n).to_owned()).collect();
        let missing = usize::from(random.unit() < 0.2);
        self.names = named.into_iter().skip(missing).chain((0..random.below(5)).map(|k| format!("x{k}"))).collect();
        let count = self.names.len();
        self.parents = (0..count).map(|j| (j > 0).then(|| random.below(j))).collect();
        self.joints = (0..count).map(|_| std::array::from_fn(|_| f64::from(2.0 * random.unit() - 1.0))).collect();
    }

    fn bones(&self) -> Bones<'_> {
        Bones { joints: &self.joints, parents: &self.parents, names: &self.names }
    }
}

#[test]
fn any_tree_comes_back_and_the_grammar_takes_it() {
    let tokenizer = Tokenizer::new(Preset::Riglab.config());
    let limits = Limits { joints: 256, tokens: 2048 };
    let half = 1.0 / 256.0 + 1e-6;
    for case in 0..3_000 {
        let mut random = stream(5, "trees", &[case]);
        let tree = Tree::new(&mut random);
        let encoded = tokenizer.encode_bones(&tree.bones(), None).unwrap();
        let decoded = tokenizer.decode(&encoded.ids).unwrap();
        let mut place = vec![0; tree.joints.len()];
        encoded.order.iter().enumerate().for_each(|(at, &j)| place[j] = at);
        for (at, &joint) in encoded.order.iter().enumerate() {
            assert_eq!(decoded.parents[at], tree.parents[joint].map(|p| place[p]), "{case}: joint {joint}");
            if encoded.moved == 0 {
                for k in 0..3 {
                    let wanted = tree.joints[joint][k].clamp(-1.0, 1.0);
                    assert!((f64::from(decoded.joints[at][k]) - wanted).abs() <= half, "{case}");
                }
            }
            // What has a template's name keeps it.
            if decoded.class.is_some() && !decoded.names[at].starts_with("bone_") {
                assert_eq!(decoded.names[at], tree.names[joint]);
            }
        }
        let mut grammar = Grammar::new(&tokenizer, limits, Parents::Existing);
        for &id in &encoded.ids {
            grammar.advance(id).unwrap_or_else(|e| panic!("{case}: {e}"));
        }
        assert!(grammar.is_done());
        assert_eq!(grammar.joints(), tree.joints.len());
    }
}

#[test]
fn the_grammar_takes_what_any_configuration_writes() {
    let riglab = Preset::Riglab.config();
    let strict = |preset: Preset| TokenizerConfig { lenient: false, least_joints: 1, ..preset.config() };
    for config in [
        TokenizerConfig { spring: Spring::Never, ..riglab.clone() },
        TokenizerConfig { spring: Spring::Always, ..riglab.clone() },
        TokenizerConfig { classes: vec!["mixamo".into()], ..riglab.clone() },
        TokenizerConfig { classes: vec![], ..riglab.clone() },
        TokenizerConfig { templates: false, ..riglab.clone() },
        TokenizerConfig { own_parts: true, ..riglab },
        strict(Preset::Paper),
        strict(Preset::SkintokensReleased),
    ] {
        let tokenizer = Tokenizer::new(config);
        for case in 0..500 {
            let tree = Tree::new(&mut stream(6, "trees", &[case]));
            let class = Template::detect(&tree.names).map(|t| t.class);
            // Released order steps refuse bodies whose joints hang on each other in another order.
            let Ok(encoded) = tokenizer.encode_bones(&tree.bones(), class) else { continue };
            let limits = Limits { joints: 256, tokens: 2048 };
            let mut grammar = Grammar::new(&tokenizer, limits, Parents::Existing);
            for &id in &encoded.ids {
                grammar.advance(id).unwrap_or_else(|e| panic!("{case}: {e}: {:?}", tokenizer.config()));
            }
            assert!(grammar.is_done());
            tokenizer.decode(&encoded.ids).unwrap();
        }
    }
}

#[test]
fn the_order_of_joints_does_not_matter() {
    let tokenizer = Tokenizer::new(Preset::Riglab.config());
    let joints = [[0.0, 0.0, 0.0], [0.5, 0.1, 0.0], [-0.5, 0.2, 0.0], [0.0, 0.9, 0.0]];
    let parents = [None, Some(0), Some(0), Some(1)];
    let swapped = [0, 2, 1, 3];
    let other: Vec<_> = swapped.iter().map(|&j: &usize| joints[j]).collect();
    let names: Vec<_> = (0..4).map(|j| format!("j{j}")).collect();
    let ids = |joints: &[[f64; 3]], parents: &[Option<usize>]| {
        tokenizer.encode_bones(&Bones { joints, parents, names: &names }, None).unwrap().ids
    };
    assert_eq!(ids(&joints, &parents), ids(&other, &[None, Some(0), Some(0), Some(2)]));
}

/// Sequences of each kind; `RIGLAB_SEQUENCES` asks for more than a quick test draws.
fn sequences() -> u64 {
    std::env::var("RIGLAB_SEQUENCES").ok().and_then(|n| n.parse().ok()).unwrap_or(2_000)
}

#[test]
fn whoever_follows_the_grammar_ends_with_a_skeleton() {
    for (preset, parents, limits) in [
        (Preset::Riglab, Parents::Existing, Limits { joints: 60, tokens: 300 }),
        (Preset::Riglab, Parents::Anywhere, Limits { joints: 8, tokens: 1000 }),
        (Preset::Paper, Parents::Existing, Limits { joints: 100, tokens: 90 }),
        (Preset::UnirigReleased, Parents::Existing, Limits { joints: 40, tokens: 200 }),
        (Preset::SkintokensReleased, Parents::Existing, Limits { joints: 1, tokens: 6 }),
    ] {
        let mut config = preset.config();
        config.lenient = false;
        let tokenizer = Tokenizer::new(config);
        let mut mask = Mask::none(tokenizer.vocabulary().len());
        for case in 0..sequences() {
            let mut random = stream(7, "policy", &[case]);
            let mut grammar = Grammar::new(&tokenizer, limits, parents);
            let mut ids = Vec::new();
            while !grammar.is_done() {
                grammar.allowed(&mut mask);
                let id = mask.iter().nth(random.below(mask.count())).expect("a way on");
                grammar.accept(id);
                ids.push(id);
            }
            let found = tokenizer.decode(&ids).unwrap_or_else(|e| panic!("{preset:?} {case}: {e}: {ids:?}"));
            found.skeleton().unwrap();
            assert!(found.joints.len() <= limits.joints && ids.len() <= limits.tokens, "{preset:?} {case}");
            assert_eq!(found.joints.len(), grammar.joints());
        }
    }
}

#[test]
fn the_fewest_joints_are_always_reached() {
    for spring in [Spring::Never, Spring::AfterParts, Spring::WithClass, Spring::Always] {
        for least_joints in [1, 2, 5, 30] {
            let config = TokenizerConfig { spring, least_joints, ..Preset::Riglab.config() };
            let tokenizer = Tokenizer::new(config);
            let mut mask = Mask::none(tokenizer.vocabulary().len());
            for case in 0..sequences() / 10 {
                let mut random = stream(8, "fewest", &[case]);
                // From the tightest limits there are.
                let tokens = 3 * least_joints + 4 + random.below(12 * least_joints);
                let limits = Limits { joints: least_joints + random.below(30), tokens };
                let mut grammar = Grammar::new(&tokenizer, limits, Parents::Existing);
                while !grammar.is_done() {
                    grammar.allowed(&mut mask);
                    // Branches and parts as often as numbers, so that limits are met.
                    let (words, cells): (Vec<_>, Vec<_>) =
                        mask.iter().partition(|id| *id >= tokenizer.vocabulary().branch());
                    let of = if cells.is_empty() || !words.is_empty() && random.chance(0.5) { words } else { cells };
                    assert!(!of.is_empty(), "{spring:?}, {least_joints} joints, {limits:?}: no way on");
                    grammar.accept(of[random.below(of.len())]);
                }
                assert!(grammar.joints() >= least_joints && grammar.tokens() <= limits.tokens);
            }
        }
    }
}

#[test]
fn sequences_from_strangers_are_refused_without_a_panic() {
    let tokenizers = [Preset::Riglab, Preset::Paper, Preset::UnirigReleased, Preset::SkintokensReleased]
        .map(|preset| Tokenizer::new(preset.config()));
    for case in 0..20_000 {
        let mut random = stream(9, "noise", &[case]);
        let length = random.below(40);
        let mut ids: Vec<u32> = (0..length)
            .map(|_| if random.unit() < 0.7 { random.below(256) as u32 } else { 256 + random.below(20) as u32 })
            .collect();
        if random.unit() < 0.9 {
            ids.insert(0, 257);
            ids.push(258);
        }
        for tokenizer in &tokenizers {
            if let Ok(found) = tokenizer.decode(&ids) {
                found.skeleton().unwrap();
                found.tails();
            }
        }
    }
}

#[test]
fn joints_of_a_template_need_no_parents() {
    let tokenizer = Tokenizer::new(Preset::Riglab.config());
    for template in &Template::ALL {
        let names: Vec<String> = template.parts.iter().flat_map(|p| p.joints).map(|n| (*n).to_owned()).collect();
        let usual: Vec<Option<usize>> =
            template.parts.iter().flat_map(|p| p.parents).map(|p| p.map(usize::from)).collect();
        let mut random = stream(11, "template", &[]);
        let joints: Vec<[f64; 3]> =
            names.iter().map(|_| std::array::from_fn(|_| f64::from(2.0 * random.unit() - 1.0))).collect();
        let bones = Bones { joints: &joints, parents: &usual, names: &names };
        let encoded = tokenizer.encode_bones(&bones, None).unwrap();
        // Start, class, two parts, three coordinates a joint, end.
        assert_eq!(encoded.ids.len(), 5 + 3 * 52);
        assert_eq!(tokenizer.decode(&encoded.ids).unwrap().parents, usual);
        // One that hangs elsewhere is told, and one that is not there leaves the body alone.
        let mut other = usual.clone();
        other[6] = Some(2);
        let encoded = tokenizer.encode_bones(&Bones { parents: &other, ..bones }, None).unwrap();
        assert_eq!(encoded.ids.len(), 5 + 3 * 52 + 4);
        assert_eq!(tokenizer.decode(&encoded.ids).unwrap().parents, other);
        let bones = Bones { joints: &joints[..51], parents: &usual[..51], names: &names[..51] };
        let encoded = tokenizer.encode_bones(&bones, None).unwrap();
        let decoded = tokenizer.decode(&encoded.ids).unwrap();
        assert_eq!((decoded.parts.len(), decoded.joints.len()), (2, 51));
    }
}

//! TokenRig's released network and generation, against values recorded from the public code.

use std::collections::BTreeMap;

use riglab_nn::embed::{EmbedConfig, EmbedKind};
use riglab_nn::fsq_cvae::{FsqCvae, FsqCvaeConfig};
use riglab_nn::generate::{GenerateConfig, Grammar, argmax, beams, best, process, rows};
use riglab_nn::layers::{HeadSplit, Linear, RmsNorm};
use riglab_nn::optim::{OptimConfig, Optimizer};
use riglab_nn::params::{Builder, Role};
use riglab_nn::tokenrig::{Asked, Layout, Reader, Sequences};
use riglab_tests::{Golden, golden, tiny_tokenrig};
use riglab_token::{Mask, Preset, RigGrammar, SkinIds, SkinRule, Tokenizer, Walk};
use tch::{Device, Kind, Tensor};

const END: i64 = 258;

fn tokenizer() -> Tokenizer {
    Tokenizer::new(Preset::SkintokensReleased.config())
}

fn ids_of(t: &Tensor) -> Vec<i64> {
    Vec::<i64>::try_from(t).unwrap()
}

/// The real tokens of a padded row.
fn unpadded(ids: &Tensor, mask: &Tensor) -> Vec<i64> {
    ids_of(ids).into_iter().zip(ids_of(&mask.to_kind(Kind::Int64))).filter(|(_, m)| *m == 1).map(|(id, _)| id).collect()
}

#[test]
fn released_tokenrig() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    let all = golden("skintokens", &["tokenrig_forward", "tokenrig_train", "tokenrig_generate", "mesh_condition"]);
    let of = |kind: &str| all.iter().find(|(k, c)| *k == kind && c.name == kind).map(|(_, c)| c);
    for (kind, case) in &all {
        match *kind {
            "tokenrig_forward" => forward(case),
            "tokenrig_train" => train(case, of("tokenrig_forward").unwrap()),
            "tokenrig_generate" => tch::no_grad(|| generate(case, of("tokenrig_forward").unwrap())),
            _ => condition(case),
        }
        case.done();
    }
}

/// A case's sequences, one after another, with their lengths.
fn sequences(case: &Golden, layout: &Layout) -> (Vec<i64>, Vec<i64>) {
    let (mut ids, mut lengths) = (Vec::new(), Vec::new());
    let rows = case.get("in.skeleton_tokens").size()[0];
    let own = |name: &str, b: i64| {
        unpadded(&case.get(&format!("in.{name}_tokens")).get(b), &case.get(&format!("in.{name}_mask")).get(b))
    };
    for b in 0..rows {
        let skin = own("skin", b).into_iter().map(|code| if code < layout.codes() { layout.code(code) } else { code });
        let before = ids.len();
        ids.extend(own("skeleton", b).into_iter().chain(skin).chain([layout.end()]));
        lengths.push((ids.len() - before) as i64);
    }
    (ids, lengths)
}

fn forward(case: &Golden) {
    let (net, params) = tiny_tokenrig(case, case, Kind::Float);
    let w = params.weights();
    let prefix = case.get("in.cond").set_requires_grad(true);
    let (ids, lengths) = sequences(case, net.layout());
    // The assembled sequences are the released ones, without their padding.
    let (padded, mask) = (case.get("out.input_ids"), case.get("out.attention_mask"));
    let wanted: Vec<i64> = (0..lengths.len() as i64).flat_map(|b| unpadded(&padded.get(b), &mask.get(b))).collect();
    assert_eq!(ids, wanted, "{}: assembled sequences", case.name);
    let ids = Tensor::from_slice(&ids);
    let given = Sequences { ids: &ids, lengths: &lengths, told: None };
    let hidden = net.forward(w, &prefix, &given, true);
    let each = ids.split_with_sizes(&lengths, 0);
    let targets = Tensor::cat(&each.iter().map(|s| s.narrow(0, 1, s.size()[0] - 1)).collect::<Vec<_>>(), 0);
    let logits = net.logits(w, &hidden);
    // Where a token follows; the places of pads are taken from the case.
    let (all, ce) = (case.get("out.logits"), case.get("out.token_ce"));
    let own = logits.split_with_sizes(lengths.iter().map(|n| n - 1).collect::<Vec<_>>(), 0);
    let filled: Vec<Tensor> = own
        .iter()
        .enumerate()
        .map(|(b, own)| {
            let (n, wanted) = (own.size()[0], all.get(b as i64));
            Tensor::cat(&[own, &wanted.narrow(0, n, wanted.size()[0] - n)], 0)
        })
        .collect();
    case.check("out.logits", &Tensor::stack(&filled, 0));
    for (b, (own, ids)) in own.iter().zip(&each).enumerate() {
        let n = own.size()[0];
        let mine = -own.log_softmax(-1, Kind::Float).gather(1, &ids.narrow(0, 1, n).unsqueeze(1), false).squeeze_dim(1);
        let off = (mine - ce.get(b as i64).narrow(0, 0, n)).abs().max().double_value(&[]);
        assert!(off < 1e-4, "{}: token_ce of row {b} is off by {off}", case.name);
    }
    let parts = net.losses(w, &Asked { hidden: &hidden, targets: &targets, bins: 256, spread: 0.0 });
    let count = (parts.skeleton_tokens + parts.skin_tokens) as f64;
    let loss = (&parts.skeleton + &parts.skin) / count;
    case.check("out.loss", &loss);
    let [skeleton, skin] = parts.means();
    case.check("out.loss_skeleton", &skeleton);
    case.check("out.loss_skin", &skin);
    let wanted: Vec<_> = params
        .ids()
        .filter_map(|id| {
            let name = format!("grad.{}", params.name(id).strip_prefix("transformer.")?);
            case.tensors.contains_key(&name).then_some((id, name))
        })
        .collect();
    assert_eq!(wanted.len(), case.names("grad.model.").count(), "{}: gradients of unknown parameters", case.name);
    let mut inputs: Vec<&Tensor> = wanted.iter().map(|(id, _)| &w[*id]).collect();
    inputs.push(&prefix);
    let grads = Tensor::run_backward(&[loss], &inputs, false, false);
    for ((_, name), grad) in wanted.iter().zip(&grads) {
        case.check(name, grad);
    }
    case.check("grad.cond", &grads[wanted.len()]);
}

fn train(case: &Golden, start: &Golden) {
    let (net, params) = tiny_tokenrig(start, start, Kind::Double);
    let config = OptimConfig {
        muon_lr: case.number("lr"),
        adamw_lr: case.number("lr"),
        clip: 0.0,
        muon_bf16: false,
        ..OptimConfig::default()
    };
    let mut optimizer = Optimizer::new(&params, config);
    let w = params.weights();
    let prefix = start.get("in.cond").to_kind(Kind::Double);
    let (ids, lengths) = sequences(start, net.layout());
    let ids = Tensor::from_slice(&ids);
    let each = ids.split_with_sizes(&lengths, 0);
    let targets = Tensor::cat(&each.iter().map(|s| s.narrow(0, 1, s.size()[0] - 1)).collect::<Vec<_>>(), 0);
    let steps = case.get("out.losses").size()[0];
    let mut losses = Vec::new();
    // What the loss does not reach has no gradient.
    let reached: Vec<_> = params.ids().filter(|&id| params.name(id).starts_with("transformer.")).collect();
    for step in 0..steps {
        let given = Sequences { ids: &ids, lengths: &lengths, told: None };
        let hidden = net.forward(w, &prefix, &given, true);
        let parts = net.losses(w, &Asked { hidden: &hidden, targets: &targets, bins: 256, spread: 0.0 });
        let loss = (parts.skeleton + parts.skin) / (parts.skeleton_tokens + parts.skin_tokens) as f64;
        losses.push(loss.detach());
        if step + 1 < steps {
            let inputs: Vec<&Tensor> = reached.iter().map(|&id| &w[id]).collect();
            let found = Tensor::run_backward(&[loss], &inputs, false, false);
            let mut grads: Vec<Tensor> = w.tensors().iter().map(Tensor::zeros_like).collect();
            for (id, grad) in reached.iter().zip(found) {
                grads[id.index()] = grad;
            }
            optimizer.step(&params, grads, 1.0).unwrap();
        }
    }
    case.check("out.losses", &Tensor::stack(&losses, 0));
    for id in params.ids() {
        let Some(name) = params.name(id).strip_prefix("transformer.") else { continue };
        if name == "model.embed_tokens.weight" {
            let rows: Vec<i64> =
                case.config("embed_rows").as_array().unwrap().iter().map(|v| v.as_i64().unwrap()).collect();
            case.check("out.embed_rows", &w[id].index_select(0, &Tensor::from_slice(&rows)));
        } else if case.tensors.contains_key(&format!("out.{name}")) {
            case.check(&format!("out.{name}"), &w[id]);
        }
    }
}

fn condition(case: &Golden) {
    let mut b = Builder::default();
    let (mut at, width, hidden) = (b.root(), case.number("width") as usize, case.number("hidden") as usize);
    let mut proj = at.sub("output_proj");
    let linear = Linear::new(proj.sub(0), Role::Projection, width, hidden, true);
    let norm = RmsNorm::new(proj.sub(1), hidden, f64::from(f32::EPSILON));
    let params = b.finish(0, Kind::Float, Device::Cpu).unwrap();
    let mut own = case.below("w.");
    own.retain(|name, _| name.starts_with("output_proj."));
    params.load(&own).unwrap();
    let w = params.weights();
    let out = norm.forward(w, &linear.forward(w, &case.get("out.latent")));
    case.check("out.cond", &out);
    let pull = (out * case.get("in.g")).sum(None::<Kind>);
    let gain = params.ids().find(|&id| params.name(id) == "output_proj.1.weight").unwrap();
    case.check("grad.output_proj.1.weight", &Tensor::run_backward(&[pull], &[&w[gain]], false, false)[0]);
}

/// The grammar of whole rigs over the released one of skeletons.
#[derive(Clone)]
struct Rules(RigGrammar<Walk>, u32);

impl Grammar for Rules {
    fn allowed(&self) -> Vec<u64> {
        let mut mask = Mask::none(self.0.len());
        self.0.allowed(&mut mask);
        mask.words().to_vec()
    }

    fn accept(&mut self, id: u32) {
        self.0.accept(id);
    }

    fn ends(&self, id: u32) -> bool {
        id == self.1
    }
}

fn rules(layout: &Layout, codes: usize, rule: SkinRule) -> Rules {
    let ids = SkinIds { parts: layout.ranges(), end: layout.drawn_end(), empty: None, codes, len: layout.drawn() };
    let walk = Walk::new(tokenizer().vocabulary());
    Rules(RigGrammar::new(walk, END as u32, ids, rule), layout.drawn_end())
}

fn generate(case: &Golden, of: &Golden) {
    let (net, params) = tiny_tokenrig(case, of, Kind::Float);
    let (w, layout) = (params.weights(), net.layout().clone());
    let codes = case.number("tokens_per_skin") as usize;
    for name in case.names("out.ids.") {
        let run = &case.config("runs")[name];
        assert!(run.is_object(), "{}: no run `{name}`", case.name);
        let number = |key: &str, usual: f64| run[key].as_f64().unwrap_or(usual);
        let rule = if run["corrected"] == true { SkinRule::Exact } else { SkinRule::Released };
        let config = GenerateConfig {
            tokens: number("max_new_tokens", 0.0) as usize,
            beams: number("num_beams", 1.0) as usize,
            repetition_penalty: number("repetition_penalty", 1.0) as f32,
            ..GenerateConfig::default()
        };
        let prompt: Vec<u32> = ids_of(&case.get(&format!("in.start.{name}"))).iter().map(|&id| id as u32).collect();
        let mut grammar = rules(&layout, codes, rule);
        prompt.iter().for_each(|&id| grammar.accept(id));
        let prefix = case.get("in.cond").narrow(0, run["cond"].as_i64().unwrap(), 1);
        let told = |_: usize, _: &[u32]| Vec::new();
        let prompts = vec![prompt.clone(); config.beams];
        let start = (config.tokens, END as u32);
        let (mut reader, first) = Reader::start(&net, w, &prefix, &prompts, start, &told).unwrap();
        let wanted = format!("out.first_logits.{name}");
        if let Some(logits) = case.tensors.get(&wanted) {
            case.check(&wanted, &Tensor::from_slice(&first[0]).narrow(0, 0, logits.size()[0]));
        }
        let found = if config.beams > 1 {
            beams(&mut reader, &first[0], &grammar, &config, |_, sums| best(sums, 2 * config.beams)).remove(0).ids
        } else {
            rows(&mut reader, first, vec![grammar], &config, |_, _, scores| argmax(scores)).remove(0)
        };
        let whole: Vec<u32> = prompt.into_iter().chain(found).collect();
        let ids = layout.ids(&whole).unwrap();
        case.check(&format!("out.ids.{name}"), &Tensor::from_slice(&ids));
        decoded(case, name, &ids, codes);
    }
    let whole: Vec<u32> = ids_of(&case.get("out.ids.greedy_0")).iter().map(|&id| id as u32).collect();
    let allowed: Vec<Tensor> = ids_of(&case.get("in.switch_prefix_len"))
        .into_iter()
        .map(|n| {
            let mut grammar = rules(&layout, codes, SkinRule::Released);
            whole[..n as usize].iter().for_each(|&id| grammar.accept(id));
            let words = grammar.allowed();
            let bits: Vec<u8> = (0..=layout.end() as usize).map(|id| (words[id / 64] >> (id % 64) & 1) as u8).collect();
            Tensor::from_slice(&bits)
        })
        .collect();
    case.check("out.switch_allowed", &Tensor::stack(&allowed, 0));
}

/// The skeleton and the skin that a sequence says.
fn decoded(case: &Golden, name: &str, ids: &[i64], codes: usize) {
    if !case.tensors.contains_key(&format!("out.parents.{name}")) {
        return;
    }
    let at = ids.iter().position(|&id| id == END).unwrap();
    let skeleton: Vec<u32> = ids[..=at].iter().map(|&id| id as u32).collect();
    let decoded = tokenizer().decode(&skeleton).unwrap();
    let parents: Vec<i64> = decoded.parents.iter().map(|p| p.map_or(-1, |p| p as i64)).collect();
    case.check(&format!("out.parents.{name}"), &Tensor::from_slice(&parents));
    let flat: Vec<f32> = decoded.joints.iter().flatten().copied().collect();
    case.check(&format!("out.joints.{name}"), &Tensor::from_slice(&flat).view([-1, 3]));
    let skin: Vec<i64> = ids[at + 1..].iter().map(|id| id - 267).take(decoded.joints.len() * codes).collect();
    let skin = Tensor::from_slice(&skin);
    case.check(&format!("out.skin_code.{name}"), &skin);
    let n = |key: &str| case.number(&format!("vae.{key}")) as usize;
    let levels: Vec<i64> =
        case.config("vae.FSQ_dict.levels").as_array().unwrap().iter().map(|v| v.as_i64().unwrap()).collect();
    let config = FsqCvaeConfig {
        embed: EmbedConfig {
            kind: EmbedKind::PhaseModulated,
            frequencies: n("embed_frequency"),
            base: std::f64::consts::PI,
        },
        encoder_width: n("width_encoder"),
        decoder_width: n("width_decoder"),
        heads: n("num_attention_heads"),
        encoder_layers: n("num_layers_encoder"),
        decoder_layers: n("num_layers_decoder"),
        latent: n("latent_channels"),
        levels,
        head_split: HeadSplit::Fused,
        ..FsqCvaeConfig::default()
    };
    let mut b = Builder::default();
    let vae = FsqCvae::new(b.root(), &config).unwrap();
    let params = b.finish(0, Kind::Float, Device::Cpu).unwrap();
    let mut all: BTreeMap<String, Tensor> =
        params.named(params.weights()).map(|(n, t)| (n.to_string(), t.detach().copy())).collect();
    for (name, t) in case.below("w.vae.") {
        assert!(all.insert(name.clone(), t).is_some(), "{name} is unknown");
    }
    params.load(&all).unwrap();
    let values = vae.fsq().codes(&skin.view([decoded.joints.len() as i64, codes as i64]), Kind::Float);
    let (points, cond) = (case.get("in.points").unsqueeze(0), case.get("in.cond_latents").unsqueeze(0));
    let weights = vae.decode(params.weights(), &values, &cond, &points, None).sigmoid().transpose(0, 1);
    case.check(&format!("out.skin.{name}"), &weights.contiguous());
}

#[test]
fn released_filters() {
    for (_, case) in golden("skintokens", &["sampling_filters"]) {
        let rows: Vec<Vec<f32>> = case.get("in.scores").unbind(0).iter().map(|t| Vec::try_from(t).unwrap()).collect();
        let before: Vec<Vec<u32>> = case
            .get("in.previous")
            .unbind(0)
            .iter()
            .map(|t| ids_of(t).into_iter().map(|id| id as u32).collect())
            .collect();
        let plain = GenerateConfig { sample: true, ..GenerateConfig::default() };
        let chained = GenerateConfig { repetition_penalty: 2.0, ..plain.clone() };
        let cool = GenerateConfig { temperature: 0.7, ..chained.clone() };
        let five = GenerateConfig { top_k: 5, ..cool.clone() };
        let all = GenerateConfig { top_p: 0.95, ..five.clone() };
        for (name, config, keep) in [
            ("reppen2", chained, 1),
            ("then_temp07", cool, 1),
            ("then_topk5", five, 1),
            ("then_topp095", all, 1),
            ("topp090_alone", GenerateConfig { top_p: 0.9, ..plain.clone() }, 1),
            ("topp050_keep2", GenerateConfig { top_p: 0.5, ..plain.clone() }, 2),
        ] {
            let mine: Vec<Tensor> = rows
                .iter()
                .zip(&before)
                .map(|(row, before)| {
                    let mut scores = row.clone();
                    process(&mut scores, before, None, &config, keep);
                    Tensor::from_slice(&scores)
                })
                .collect();
            let (mine, wanted) = (Tensor::stack(&mine, 0), case.get(&format!("out.{name}")));
            assert!(mine.isneginf().equal(&wanted.isneginf()), "{}: {name} removes others", case.name);
            let off = (mine.nan_to_num(0.0, None, -1e3) - wanted.nan_to_num(0.0, None, -1e3)).abs().max();
            assert!(off.double_value(&[]) < 2e-5, "{}: {name}", case.name);
        }
    }
}

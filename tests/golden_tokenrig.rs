//! TokenRig's released network and generation, against values recorded from the public code.

use std::collections::BTreeMap;

use riglab_nn::decoder::Packed;
use riglab_nn::embed::{EmbedConfig, EmbedKind};
use riglab_nn::fsq_cvae::{FsqCvae, FsqCvaeConfig};
use riglab_nn::generate::{GenerateConfig, Grammar, argmax, beams, best, process, rows};
use riglab_nn::layers::{HeadSplit, Linear, RmsNorm};
use riglab_nn::optim::Optimizer;
use riglab_nn::params::{Builder, Role};
use riglab_nn::tokenrig::{Layout, NextTokens, Reader, Sequences};
use riglab_task::tokenrig::LossConfig;
use riglab_tests::{Golden, golden, optimizer, sizes, started, tiny_tokenrig};
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
    for (kind, case) in &all {
        match *kind {
            "tokenrig_forward" => forward(case),
            "tokenrig_train" => train(case, started(case.config("start").as_str().unwrap(), &all)),
            "tokenrig_generate" => tch::no_grad(|| generate(case, sizes(case, &all))),
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
    let skeleton = net.layout().skeleton();
    // The assembled sequences are the released ones, without their padding: that is taken from the case.
    let padded = |name: &str, of: &dyn Fn(&[i64]) -> Vec<i64>| {
        let wanted = case.get(name);
        let mut left = &ids[..];
        let rows = lengths.iter().enumerate().map(|(b, &n)| {
            let (own, rest) = left.split_at(n as usize);
            left = rest;
            let pads = wanted.get(b as i64).narrow(0, n, wanted.size()[1] - n).to_kind(Kind::Int64);
            Tensor::cat(&[Tensor::from_slice(&of(own)), pads], 0)
        });
        case.check(name, &Tensor::stack(&rows.collect::<Vec<_>>(), 0));
    };
    padded("out.input_ids", &|own| own.to_vec());
    let mask = case.get("out.attention_mask");
    assert_eq!(ids_of(&mask.sum_dim_intlist(-1, false, Kind::Int64)), lengths, "{}: pads", case.name);
    padded("out.attention_mask", &|own| vec![1; own.len()]);
    // Codes and the final end are the skin's, all before them the skeleton's.
    let part = |skin: bool| move |own: &[i64]| own.iter().map(|&id| i64::from((id >= skeleton) == skin)).collect();
    for (name, skin) in [("out.skeleton_part", false), ("out.skin_part", true)] {
        if case.has(name) {
            padded(name, &part(skin));
        }
    }
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
    let scored: Vec<Tensor> = own
        .iter()
        .zip(&each)
        .enumerate()
        .map(|(b, (own, ids))| {
            let (n, wanted) = (own.size()[0], ce.get(b as i64));
            let likely = own.log_softmax(-1, Kind::Float).gather(1, &ids.narrow(0, 1, n).unsqueeze(1), false);
            Tensor::cat(&[-likely.squeeze_dim(1), wanted.narrow(0, n, wanted.size()[0] - n)], 0)
        })
        .collect();
    case.check("out.token_ce", &Tensor::stack(&scored, 0));
    if case.has("out.logits_prefix_last") {
        // What follows the shape is always the beginning; nobody asks for it.
        let (b, p, d) = prefix.size3().unwrap();
        let shapes = net.decoder().forward(w, &prefix.view([b * p, d]), &Packed::new(vec![p; b as usize]), false);
        let last = shapes.view([b, p, d]).select(1, p - 1);
        case.check("out.logits_prefix_last", &net.decoder().logits(w, &last));
    }
    let parts = net.losses(w, &NextTokens { hidden: &hidden, targets: &targets, bins: 256, spread: 0.0 });
    let count = (parts.skeleton_tokens + parts.skin_tokens) as f64;
    let loss = (&parts.skeleton + &parts.skin) / count;
    case.check("out.loss", &loss);
    let [skeleton, skin] = parts.means();
    case.check_if_there("out.loss_skeleton", &skeleton);
    case.check_if_there("out.loss_skin", &skin);
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
    let config = optimizer(case);
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
        let parts = net.losses(w, &NextTokens { hidden: &hidden, targets: &targets, bins: 256, spread: 0.0 });
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
                case.config("embed_rows").as_array().into_iter().flatten().map(|v| v.as_i64().unwrap()).collect();
            case.check_if_there("out.embed_rows", &w[id].index_select(0, &Tensor::from_slice(&rows)));
        }
        case.check_if_there(&format!("out.{name}"), &w[id]);
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
    let inputs: Vec<&Tensor> = w.tensors().iter().collect();
    for (id, grad) in params.ids().zip(Tensor::run_backward(&[pull], &inputs, false, false)) {
        case.check_if_there(&format!("grad.{}", params.name(id)), &grad);
    }
    for encoder in ["out.latent", "out.query", "grad.encoder."] {
        case.aside(encoder, "compared with UniRig's encoder, which is the same");
    }
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
            let all = beams(&mut reader, &first[0], &grammar, &config, |_, sums| best(sums, 2 * config.beams));
            all.unwrap().remove(0).ids
        } else {
            rows(&mut reader, first, vec![grammar], &config, |_, _, scores| argmax(scores)).unwrap().remove(0)
        };
        let whole: Vec<u32> = prompt.into_iter().chain(found).collect();
        let ids = layout.ids(&whole).unwrap();
        case.check(&format!("out.ids.{name}"), &Tensor::from_slice(&ids));
        decoded(case, name, &ids, (codes, layout.skeleton()));
    }
    if !case.has("out.switch_allowed") {
        return;
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

/// The skeleton and the skin that a sequence says, with so many codes a joint, the first of which has that id.
fn decoded(case: &Golden, name: &str, ids: &[i64], (codes, first): (usize, i64)) {
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
    let skin: Vec<i64> = ids[at + 1..].iter().map(|id| id - first).take(decoded.joints.len() * codes).collect();
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
        // `reppen2_temp07` would be a chain; `then_` adds to the chain of those before.
        let plain = GenerateConfig { sample: true, ..GenerateConfig::default() };
        let names: Vec<String> = case.names("out.").filter(|name| *name != "warmup_rate").map(String::from).collect();
        for name in names {
            let mut config = plain.clone();
            for step in chain(&name) {
                set(&mut config, &step);
            }
            let keep = name.rsplit_once("_keep").map_or(1, |(_, n)| n.parse().unwrap());
            let mine: Vec<Tensor> = rows
                .iter()
                .zip(&before)
                .map(|(row, before)| {
                    let mut scores = row.clone();
                    process(&mut scores, before, None, &config, keep);
                    Tensor::from_slice(&scores)
                })
                .collect();
            case.check_scores(&format!("out.{name}"), &Tensor::stack(&mine, 0));
        }
        if case.has("out.warmup_rate") {
            let of = |key: &str| case.number(&format!("warmup.{key}"));
            // From the first step of one epoch to the last of another.
            let (from, to) =
                (of("start_epoch") * of("steps_per_epoch"), (of("end_epoch") + 1.0) * of("steps_per_epoch"));
            let loss = LossConfig { skin_warmup: [from / to, 1.0], ..LossConfig::default() };
            let rates: Vec<f64> = case
                .get("in.warmup_epoch_step")
                .unbind(0)
                .iter()
                .map(|row| loss.skin_weight(row.double_value(&[1]) / to))
                .collect();
            case.check("out.warmup_rate", &Tensor::from_slice(&rates));
        }
        case.done();
    }
}

/// The filters of a recorded chain, in the order of the release: `then_topk5` comes after penalty and temperature.
fn chain(name: &str) -> Vec<String> {
    const ORDER: [&str; 4] = ["reppen2", "temp07", "topk5", "topp095"];
    let Some(last) = name.strip_prefix("then_") else {
        return name.split('_').map(String::from).collect();
    };
    let stem = last.trim_end_matches(|c: char| c.is_ascii_digit());
    let at = ORDER.iter().position(|step| step.starts_with(stem)).unwrap_or_else(|| panic!("no filter {name}"));
    ORDER[..at].iter().copied().chain([last]).map(String::from).collect()
}

/// What `topk5`, `topp095`, `temp07` or `reppen2` stands for: digits after a 0 are decimals.
fn set(config: &mut GenerateConfig, step: &str) {
    let stem = step.trim_end_matches(|c: char| c.is_ascii_digit());
    let digits = &step[stem.len()..];
    let number = || match digits.strip_prefix('0') {
        Some(decimals) => format!("0.{decimals}").parse::<f32>().unwrap(),
        None => digits.parse().unwrap(),
    };
    match stem {
        "reppen" => config.repetition_penalty = number(),
        "temp" => config.temperature = number(),
        "topk" => config.top_k = digits.parse().unwrap(),
        "topp" => config.top_p = number(),
        "alone" | "keep" => {}
        other => panic!("no filter {other} in {step}"),
    }
}

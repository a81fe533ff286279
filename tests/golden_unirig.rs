//! UniRig's released skeleton model, against values recorded from the public code.

use std::collections::BTreeMap;

use riglab_geom::farthest_points;
use riglab_nn::decoder::{Cache, OptConfig, Packed};
use riglab_nn::embed::{EmbedConfig, EmbedKind, Embedding};
use riglab_nn::generate::{Decoder, GenerateConfig, Grammar, argmax, best, log_softmax, process};
use riglab_nn::optim::{OptimConfig, Optimizer, Pace};
use riglab_nn::params::{Builder, Init, Params, Role, Weights};
use riglab_nn::perceiver::{Perceiver, PerceiverConfig};
use riglab_nn::simulate::{
    Maps, Tree, quaternions_of_rotations, quaternions_of_vectors, rotations_of_quaternions, rotations_of_vectors, skin,
};
use riglab_nn::skeleton::{SkeletonModel, SkeletonModelConfig, coordinate_distance, cross_entropy};
use riglab_tests::{Golden, golden};
use riglab_token::{Mask, Preset, Tokenizer, Walk};
use riglab_train::{OneCycleConfig, ScheduleConfig, ScheduleKind, beta1, factor};
use tch::{Device, Kind, Tensor};

#[test]
fn released_skeleton_model() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (kind, case) in golden("unirig", &["fourier", "perceiver", "ar_loss", "ar_loss_"]) {
        match kind {
            "fourier" => fourier(&case),
            "perceiver" => perceiver(&case),
            _ => loss(&case),
        }
        case.done();
    }
}

#[test]
fn released_poses_and_skinning() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (_, case) in golden("unirig", &["lbs_fk"]) {
        poses(&case);
        case.done();
    }
}

#[test]
fn released_mesh_condition_of_tokenrig() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (_, case) in golden("skintokens", &["mesh_condition"]) {
        mesh_condition(&case);
        case.done();
    }
}

/// Forward kinematics with and without turns at rest, skinning with its gradients, rotations as others.
fn poses(case: &Golden) {
    let parents: Vec<Option<usize>> =
        rows_of(&case.get("in.parents")).iter().map(|p| usize::try_from(*p).ok()).collect();
    let (tree, heads, points) = (Tree::new(&parents), case.get("in.joints"), case.get("in.vertices"));
    let basis = Maps::of(&case.get("in.matrix_basis"));
    let turned = Maps::of(&case.get("in.matrix_local"));
    let still =
        Maps { matrix: Tensor::eye(3, (Kind::Float, Device::Cpu)).expand_as(&turned.matrix), shift: heads.copy() };
    let mut maps = Vec::new();
    for (frames, suffix) in [(turned, ""), (still, "_no_rest_rotation")] {
        // A basis is within the frame of its joint.
        let found = tree.compose(&frames.after(&basis).after(&frames.inverse()));
        let posed = found.after(&frames).rows();
        let last = Tensor::from_slice(&[0f32, 0.0, 0.0, 1.0]).expand([posed.size()[0], 1, 4], false);
        case.check(&format!("out.pose_matrix{suffix}"), &Tensor::cat(&[&posed, &last], 1));
        case.check(&format!("out.posed{suffix}.vertices"), &skin(&points, &case.get("in.skin"), &found));
        case.check(&format!("out.posed{suffix}.joints"), &found.apply(&heads));
        case.check(&format!("out.posed{suffix}.tails"), &found.apply(&case.get("in.tails")));
        maps.push(found);
    }
    let weights = case.get("in.skin_unnormalised").set_requires_grad(true);
    let places = points.copy().set_requires_grad(true);
    let found = skin(&places, &weights, &maps[0]);
    case.check("out.lbs_unnormalised", &found);
    let loss = (found * case.get("in.grad_out")).sum(None::<Kind>);
    let gradients = Tensor::run_backward(&[loss], &[&weights, &places], false, false);
    case.check("grad.skin", &gradients[0]);
    case.check("grad.vertices", &gradients[1]);

    let quaternions = quaternions_of_vectors(&case.get("in.axis_angle"));
    case.check("out.quaternion_wxyz", &quaternions);
    let rotations = rotations_of_quaternions(&quaternions);
    case.check("out.quaternion_matrix", &rotations);
    case.check("out.matrix_quaternion_wxyz", &quaternions_of_rotations(&rotations));
    case.check("out.basis_rotation", &rotations_of_vectors(&case.get("in.rotvec")));
}

/// Every variant that is recorded: octaves or even steps, with π or without, with the input or without.
fn fourier(case: &Golden) {
    let x = case.get("in.x");
    let of = |frequencies, base| Embedding::new(&EmbedConfig { kind: EmbedKind::Fourier, frequencies, base });
    for variant in case.names("out.f") {
        let parts: Vec<&str> = variant.split('_').collect();
        let frequencies: usize = parts[0].parse().unwrap();
        let base = if parts[1] == "pi1" { std::f64::consts::PI } else { 1.0 };
        let embedding = of(frequencies, base);
        let mut found = embedding.forward(&x);
        if parts[2] == "log0" {
            let steps =
                Tensor::linspace(1, 2i64.pow(frequencies as u32 - 1), frequencies as i64, (Kind::Float, Device::Cpu));
            found = embedding.with_tables(&x, &(steps * base), &Tensor::from_slice::<f32>(&[]));
        }
        if parts.get(3) == Some(&"noinput") {
            found = found.narrow(-1, 3, found.size().last().unwrap() - 3);
        }
        case.check(&format!("out.f{variant}"), &found);
    }
    if case.tensors.contains_key("out.skin_default") {
        case.check("out.skin_default", &of(6, std::f64::consts::PI).forward(&x));
    }
}

fn perceiver_config(of: impl Fn(&str) -> f64, qkv_bias: bool) -> PerceiverConfig {
    PerceiverConfig {
        tokens: of("token_num") as usize,
        drawn: 4,
        width: of("width") as usize,
        heads: of("heads") as usize,
        layers: of("num_encoder_layers") as usize,
        frequencies: of("num_freqs") as usize,
        sorted: false,
        qkv_bias,
        init_scale: of("init_scale"),
    }
}

fn loaded(builder: Builder, tensors: &BTreeMap<String, Tensor>) -> Params {
    let params = builder.finish(0, Kind::Float, Device::Cpu).unwrap();
    params.load(tensors).unwrap();
    params
}

/// Of each cloud, the points that are picked: the farthest among the rows drawn, the first of them first.
fn picks(cloud: &Tensor, rows: &[i64], tokens: usize) -> Tensor {
    let clouds = cloud.size()[0];
    let of = |b: i64| {
        let drawn: Vec<[f32; 3]> =
            rows.iter().map(|&r| std::array::from_fn(|k| cloud.double_value(&[b, r, k as i64]) as f32)).collect();
        farthest_points(&drawn, tokens, 0).into_iter().map(|i| rows[i]).collect::<Vec<_>>()
    };
    let all: Vec<i64> = (0..clouds).flat_map(of).collect();
    Tensor::from_slice(&all).view([clouds, tokens as i64])
}

fn rows_of(t: &Tensor) -> Vec<i64> {
    Vec::<i64>::try_from(t).unwrap()
}

fn perceiver(case: &Golden) {
    let config = perceiver_config(|key| case.number(key), case.config("qkv_bias") == true);
    let mut builder = Builder::default();
    let net = Perceiver::new(builder.root().sub("encoder"), &config);
    let params = loaded(builder, &case.below("w."));
    let cloud = Tensor::cat(&[&case.get("in.pc"), &case.get("in.normals")], -1);
    let drawn = rows_of(&case.get("in.rows"));
    let picks = picks(&cloud, &drawn, config.tokens);
    // The goldens count the picks over the rows drawn of all clouds.
    let in_drawn = |b: i64, p: i64| {
        let row = picks.int64_value(&[b, p]);
        b * drawn.len() as i64 + drawn.iter().position(|r| *r == row).unwrap() as i64
    };
    let found: Vec<i64> = (0..picks.size()[0])
        .flat_map(|b| (0..picks.size()[1]).map(move |p| (b, p)))
        .map(|(b, p)| in_drawn(b, p))
        .collect();
    case.check("out.fps", &Tensor::from_slice(&found));
    let latents = net.forward(params.weights(), &cloud, &picks);
    case.check("out.latents", &latents);
    gradients(case, &params, &(latents * case.get("in.grad_out")).sum(None::<Kind>));
}

/// Compares the gradients of a loss by all parameters that the case has.
fn gradients(case: &Golden, params: &Params, loss: &Tensor) {
    let wanted: Vec<_> =
        params.ids().filter(|&id| case.tensors.contains_key(&format!("grad.{}", params.name(id)))).collect();
    assert!(!wanted.is_empty(), "{}: no gradient is recorded", case.name);
    let inputs: Vec<&Tensor> = wanted.iter().map(|&id| &params.weights()[id]).collect();
    for (id, grad) in wanted.iter().zip(Tensor::run_backward(&[loss], &inputs, false, false)) {
        case.check(&format!("grad.{}", params.name(*id)), &grad);
    }
}

fn mesh_condition(case: &Golden) {
    let config = perceiver_config(|key| case.number(key), false);
    let mut builder = Builder::default();
    let net = Perceiver::new(builder.root().sub("encoder"), &config);
    let mut own = case.below("w.");
    own.retain(|name, _| name.starts_with("encoder."));
    let params = loaded(builder, &own);
    let cloud = case.get("in.cloud");
    let latents =
        net.forward(params.weights(), &cloud, &picks(&cloud, &rows_of(&case.get("in.choice")), config.tokens));
    case.check("out.latent", &latents);
    case.check("out.query", &picks(&cloud, &rows_of(&case.get("in.choice")), config.tokens));
}

/// The released model of a case, with its weights.
fn model(case: &Golden) -> (SkeletonModel, Params) {
    let of = |key: &str| case.number(&format!("llm.{key}"));
    let decoder = OptConfig {
        width: of("hidden_size") as usize,
        layers: of("num_hidden_layers") as usize,
        heads: of("num_attention_heads") as usize,
        ffn: of("ffn_dim") as usize,
        positions: of("max_position_embeddings") as usize,
        dropout: of("dropout"),
        init_std: of("init_std"),
        frozen_token: Some(of("pad_token_id") as u32),
    };
    let shape = perceiver_config(
        |key| case.number(&format!("mesh_encoder.{key}")),
        case.config("mesh_encoder.qkv_bias") == true,
    );
    let mut builder = Builder::default();
    let net = SkeletonModel::new(builder.root(), &SkeletonModelConfig { shape, decoder }, of("vocab_size") as usize);
    let params = loaded(builder, &case.below("w."));
    (net, params)
}

fn loss(case: &Golden) {
    let (net, params) = model(case);
    let w = params.weights();
    let cloud = Tensor::cat(&[&case.get("in.vertices"), &case.get("in.normals")], -1);
    let tokens = case.number("cond_tokens") as i64;
    let picks = picks(&cloud, &rows_of(&case.get("in.rows")), tokens as usize);
    let prefix = net.condition(w, &cloud, &picks);
    // Sequences without their padding, one after another.
    let mask = case.get("in.attention_mask").to_kind(Kind::Int64);
    let lengths = rows_of(&mask.sum_dim_intlist(-1, false, Kind::Int64));
    let padded = case.get("in.input_ids");
    let sequences: Vec<Tensor> =
        lengths.iter().enumerate().map(|(b, n)| padded.get(b as i64).narrow(0, 0, *n)).collect();
    let ids = Tensor::cat(&sequences, 0);
    // All rows, the prefix' too, in the places where the padded ones stand.
    let embedded = net.decoder().embed(w, &ids).split_with_sizes(&lengths, 0);
    let parts: Vec<Tensor> = embedded.into_iter().enumerate().flat_map(|(b, t)| [prefix.get(b as i64), t]).collect();
    let packed = Packed::new(lengths.iter().map(|n| n + tokens).collect());
    let all = net.decoder().logits(w, &net.decoder().forward(w, &Tensor::cat(&parts, 0), &packed, false));
    let wanted = case.get("out.logits");
    let filled: Vec<Tensor> = packed
        .apart(&all)
        .into_iter()
        .enumerate()
        .map(|(b, own)| {
            let n = own.size()[0];
            let rest = wanted.get(b as i64).narrow(0, n, wanted.size()[1] - n);
            Tensor::cat(&[own, rest], 0)
        })
        .collect();
    case.check("out.logits", &Tensor::stack(&filled, 0));
    let logits = net.logits(w, &prefix, &ids, &lengths, false);
    let targets = Tensor::cat(&sequences.iter().map(|s| s.narrow(0, 1, s.size()[0] - 1)).collect::<Vec<_>>(), 0);
    let ce = cross_entropy(&logits, &targets);
    case.check("out.ce_loss", &ce.view([1]));
    case.check("out.dis_loss", &coordinate_distance(&logits, &targets, 256).view([1]));
    gradients(case, &params, &ce);
}

/// The released grammar.
#[derive(Clone)]
struct Released(Walk, u32);

impl Grammar for Released {
    fn allowed(&self) -> Vec<u64> {
        let mut mask = Mask::none(267);
        self.0.allowed(&mut mask);
        mask.words().to_vec()
    }

    fn accept(&mut self, id: u32) {
        self.0.advance(id).unwrap();
    }

    fn ends(&self, id: u32) -> bool {
        id == self.1
    }
}

/// The model after a prompt.
struct Reader<'a> {
    net: &'a SkeletonModel,
    weights: &'a Weights,
    cache: Cache,
    /// Raw scores of every step.
    raw: Vec<Vec<f32>>,
}

fn floats(t: &Tensor) -> Vec<f32> {
    Vec::<f32>::try_from(t.contiguous().view([-1])).unwrap()
}

impl Decoder for Reader<'_> {
    fn next(&mut self, ids: &[u32]) -> Vec<Vec<f32>> {
        let ids: Vec<i64> = ids.iter().map(|&id| i64::from(id)).collect();
        let ids = Tensor::from_slice(&ids).view([ids.len() as i64, 1]);
        let scores = self.net.next(self.weights, &ids, &mut self.cache);
        let rows: Vec<Vec<f32>> = scores.unbind(0).iter().map(floats).collect();
        self.raw.push(rows[0].clone());
        rows
    }

    fn select(&mut self, rows: &[usize]) {
        self.cache.select(&rows.iter().map(|&r| r as i64).collect::<Vec<_>>());
    }
}

#[test]
fn released_generation() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    let all = golden("unirig", &["ar_loss", "ar_generate"]);
    for (_, case) in all.iter().filter(|(kind, _)| *kind == "ar_generate") {
        let (_, of) = all.iter().find(|(kind, c)| *kind == "ar_loss" && c.name == "ar_loss").unwrap();
        let (net, params) = model(of);
        tch::no_grad(|| generate(case, of, &net, params.weights()));
        case.done();
    }
}

fn generate(case: &Golden, of: &Golden, net: &SkeletonModel, w: &Weights) {
    let tokenizer = Tokenizer::new(Preset::UnirigReleased.config());
    let ids = tokenizer.vocabulary();
    let cloud = Tensor::cat(&[&case.get("in.vertices"), &case.get("in.normals")], -1);
    let tokens = of.number("cond_tokens") as usize;
    let prefix = net.condition(w, &cloud, &picks(&cloud, &rows_of(&of.get("in.rows")), tokens));
    let runs = case.config("runs").as_array().unwrap();
    for name in case.names("out.").filter_map(|name| name.strip_suffix(".ids")) {
        let run = runs.iter().find(|run| run["name"].as_str() == Some(name));
        let run = run.unwrap_or_else(|| panic!("{}: no run `{name}`", case.name));
        let kwargs = &run["kwargs"];
        let number = |key: &str, usual: f64| kwargs[key].as_f64().unwrap_or(usual);
        let config = GenerateConfig {
            tokens: number("max_new_tokens", 0.0) as usize,
            sample: kwargs["do_sample"] == true,
            beams: number("num_beams", 1.0) as usize,
            temperature: number("temperature", 1.0) as f32,
            top_k: number("top_k", 0.0) as usize,
            top_p: number("top_p", 1.0) as f32,
            repetition_penalty: number("repetition_penalty", 1.0) as f32,
        };
        let class = run["cls"].as_str().map(|c| ids.class(ids.class_named(c).unwrap()));
        let prompt: Vec<u32> = std::iter::once(ids.bos()).chain(class).collect();
        let mut grammar = Released(Walk::new(ids), ids.eos());
        prompt.iter().for_each(|&id| grammar.accept(id));
        let item = run["item"].as_i64().unwrap();
        let beams = config.beams as i64;
        let own = prefix.narrow(0, item, 1).expand([beams, -1, -1], false);
        let cache = net.start(w, &own, (prompt.len() + config.tokens) as i64);
        let mut reader = Reader { net, weights: w, cache, raw: vec![] };
        let first_ids: Vec<i64> = prompt.iter().map(|&id| i64::from(id)).collect();
        let first = Tensor::from_slice(&first_ids).unsqueeze(0).expand([beams, -1], false);
        let first = floats(&net.next(w, &first, &mut reader.cache).get(0));
        reader.raw.push(first.clone());
        let draws = case.tensors.get(&format!("in.{name}.draws"));
        let draw = |step: usize| rows_of(&draws.unwrap().get(step as i64));
        let mut processed = Vec::new();
        let found = if config.beams > 1 {
            let all = riglab_nn::generate::beams(&mut reader, &first, &grammar, &config, |step, sums| match draws {
                Some(_) => draw(step).into_iter().map(|place| place as usize).collect(),
                None => best(sums, 2 * config.beams),
            });
            all[0].ids.clone()
        } else {
            let mut all =
                riglab_nn::generate::rows(&mut reader, vec![first], vec![grammar], &config, |_, step, scores| {
                    processed.push(scores.to_vec());
                    if draws.is_some() { draw(step)[0] as u32 } else { argmax(scores) }
                });
            all.remove(0)
        };
        let whole: Vec<i64> = prompt.iter().chain(&found).map(|&id| i64::from(id)).collect();
        case.check(&format!("out.{name}.ids"), &Tensor::from_slice(&whole));
        for (kind, mine) in [("raw", &reader.raw), ("processed", &processed)] {
            let name = format!("out.{name}.{kind}");
            if let Some(wanted) = case.tensors.get(&name) {
                compare(&name, mine, wanted);
            }
        }
    }
}

/// Within the goldens' 1e-3, and impossible where they say so.
fn compare(name: &str, mine: &[Vec<f32>], wanted: &Tensor) {
    for (step, mine) in mine.iter().enumerate().take(wanted.size()[0] as usize) {
        for (id, (a, b)) in mine.iter().zip(floats(&wanted.get(step as i64))).enumerate() {
            assert!(a.is_finite() == b.is_finite(), "{name} step {step} id {id}: {a} {b}");
            assert!(!b.is_finite() || (a - b).abs() <= 1e-3, "{name} step {step} id {id}: {a} {b}");
        }
    }
}

#[test]
fn released_processors() {
    for (_, case) in golden("unirig", &["logits_processors"]) {
        let (scores, ids) = (case.get("in.scores"), case.get("in.ids"));
        let usual = GenerateConfig { sample: true, ..GenerateConfig::default() };
        let with = |change: &dyn Fn(&mut GenerateConfig)| {
            let mut config = usual.clone();
            change(&mut config);
            config
        };
        for (name, log, keep, config) in [
            ("repetition3", false, 1, with(&|c| c.repetition_penalty = 3.0)),
            ("temperature1.5", false, 1, with(&|c| c.temperature = 1.5)),
            ("top_k5", false, 1, with(&|c| c.top_k = 5)),
            ("top_k1_keep2", false, 2, with(&|c| c.top_k = 1)),
            ("top_p0.95", false, 1, with(&|c| c.top_p = 0.95)),
            ("top_p0.3", false, 1, with(&|c| c.top_p = 0.3)),
            ("top_p0.3_keep2", false, 2, with(&|c| c.top_p = 0.3)),
            ("chain_rep_temp_k_p", false, 1, with(&chain)),
            ("chain_beam", true, 2, with(&chain)),
        ] {
            let wanted = case.get(&format!("out.{name}"));
            for row in 0..scores.size()[0] {
                let mut mine = floats(&scores.get(row));
                if log {
                    log_softmax(&mut mine);
                }
                let before: Vec<u32> = rows_of(&ids.get(row)).into_iter().map(|id| id as u32).collect();
                process(&mut mine, &before, None, &config, keep);
                let wanted = floats(&wanted.get(row));
                // Which of tied scores survives is the sort's affair: the kept ones are compared as sets.
                let sorted = |v: &[f32]| {
                    let mut v = v.to_vec();
                    v.sort_by(f32::total_cmp);
                    v
                };
                for (a, b) in sorted(&mine).iter().zip(sorted(&wanted)) {
                    assert!(a == &b || (a - b).abs() <= 1e-5, "{name} row {row}: {a} {b}");
                }
                if row != 3 {
                    let differ = mine.iter().zip(&wanted).position(|(a, b)| a.is_finite() != b.is_finite());
                    assert_eq!(differ, None, "{name} row {row}");
                }
            }
        }
    }
}

/// Both set-ups: the schedule over all steps, and weights, momentum and clipping over the first.
#[test]
fn released_schedule_and_optimizer() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (_, case) in golden("unirig", &["schedule"]) {
        let steps = (case.number("epochs") * case.number("steps_per_epoch")) as u64;
        let setups: Vec<String> =
            case.names("in.").filter_map(|name| name.strip_suffix(".p0")).map(String::from).collect();
        for setup in &setups {
            let of = |key: &str| case.number(&format!("{setup}.{key}"));
            let (start, peak) = (1.0 / of("div_factor"), of("max_lr"));
            let one_cycle = OneCycleConfig { rise: of("pct_start"), start, ..OneCycleConfig::default() };
            let end = start / of("final_div_factor");
            let schedule = ScheduleConfig { kind: ScheduleKind::OneCycle, warmup: 0, end, one_cycle };
            let pace =
                |step: u64| Pace { factor: factor(&schedule, step, steps), beta1: beta1(&schedule, step, steps) };
            let rates: Vec<f64> = (0..steps).map(|step| peak * pace(step).factor).collect();
            let betas: Vec<f64> = (0..steps).filter_map(|step| pace(step).beta1).collect();
            case.check(&format!("out.{setup}.lr"), &Tensor::from_slice(&rates));
            case.check(&format!("out.{setup}.beta1"), &Tensor::from_slice(&betas));
            optimizer_steps(&case, setup, peak, pace);
        }
        case.done();
    }
}

fn optimizer_steps(case: &Golden, setup: &str, peak: f64, pace: impl Fn(u64) -> Pace) {
    let mut builder = Builder::default();
    for name in ["p", "b"] {
        let shape = case.get(&format!("in.{setup}.{name}0")).size();
        builder.root().add(name, Role::Projection, &shape, Init::Constant(0.0));
    }
    let params = builder.finish(0, Kind::Float, Device::Cpu).unwrap();
    params.load(&["p", "b"].map(|name| (name.to_string(), case.get(&format!("in.{setup}.{name}0")))).into()).unwrap();
    let config = OptimConfig {
        muon: vec![],
        adamw_lr: peak,
        adamw_betas: [0.9, 0.999],
        weight_decay: case.number(&format!("{setup}.weight_decay")),
        clip: 1.0,
        ..OptimConfig::default()
    };
    let mut optimizer = Optimizer::new(&params, config);
    let [p, b] = ["p", "b"].map(|name| case.get(&format!("in.{setup}.grad_{name}")));
    let (mut norms, mut seen) = (vec![], [vec![], vec![]]);
    for step in 0..p.size()[0] {
        let stats =
            optimizer.step_at(&params, vec![p.get(step).copy(), b.get(step).copy()], pace(step as u64)).unwrap();
        norms.push(stats.grad_norm);
        params.weights().tensors().iter().zip(&mut seen).for_each(|(t, all)| all.push(t.detach().copy()));
    }
    case.check(&format!("out.{setup}.grad_norm"), &Tensor::from_slice(&norms));
    for (name, all) in ["p", "b"].iter().zip(seen) {
        case.check(&format!("out.{setup}.{name}"), &Tensor::stack(&all, 0));
    }
}

fn chain(c: &mut GenerateConfig) {
    (c.repetition_penalty, c.temperature, c.top_k, c.top_p) = (3.0, 1.5, 5, 0.95);
}

#[test]
fn the_cache_reads_as_the_whole_sequence() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (_, case) in golden("unirig", &["ar_loss"]) {
        let (net, params) = model(&case);
        let w = params.weights();
        tch::no_grad(|| {
            tch::manual_seed(1);
            let prefix = Tensor::randn([2, 6, 32], (Kind::Float, Device::Cpu));
            let ids = Tensor::randint(267, [2, 9], (Kind::Int64, Device::Cpu));
            let whole = net.logits(w, &prefix, &ids.flatten(0, 1), &[9, 9], false).view([2, 8, 267]);
            let mut cache = net.start(w, &prefix, 9);
            // Two at once, then one by one; then the second row alone.
            let mut found = vec![net.next(w, &ids.narrow(1, 0, 2), &mut cache)];
            for at in 2..6 {
                found.push(net.next(w, &ids.narrow(1, at, 1), &mut cache));
            }
            cache.select(&[1]);
            for at in 6..8 {
                let next = net.next(w, &ids.narrow(0, 1, 1).narrow(1, at, 1), &mut cache);
                found.push(Tensor::cat(&[whole.get(0).narrow(0, at, 1), next], 0));
            }
            for (k, next) in found.iter().enumerate() {
                let off = (next - whole.select(1, k as i64 + 1)).abs().max().double_value(&[]);
                assert!(off < 1e-5, "step {k}: {off}");
            }
        });
    }
}

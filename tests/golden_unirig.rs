//! UniRig's released skeleton model, against values recorded from the public code.

use std::collections::{BTreeMap, BTreeSet};

use riglab_geom::farthest_points;
use riglab_nn::decoder::{Cache, OptConfig, Packed};
use riglab_nn::embed::{EmbedConfig, EmbedKind, Embedding};
use riglab_nn::generate::{Decoder, GenerateConfig, Grammar, argmax, best, log_softmax, process, softmax};
use riglab_nn::layers::{FusedBlock, FusedConfig, Linear, RmsNorm};
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
use serde_json::Value;
use tch::{Device, Kind, Tensor};

#[test]
fn released_skeleton_model() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (kind, case) in golden("unirig", &["fourier", "perceiver", "ar_loss"]) {
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
    let maps = |frames: &Maps| {
        // A basis is within the frame of its joint.
        let basis = Maps::of(&case.get("in.matrix_basis"));
        tree.compose(&frames.after(&basis).after(&frames.inverse()))
    };
    let turned = || Maps::of(&case.get("in.matrix_local"));
    let still = || {
        let matrix = Tensor::eye(3, (Kind::Float, Device::Cpu)).expand([tree.joints(), 3, 3], false);
        Maps { matrix, shift: heads.copy() }
    };
    for (frames, suffix) in [(&turned as &dyn Fn() -> Maps, ""), (&still, "_no_rest_rotation")] {
        let (matrix, posed) = (format!("out.pose_matrix{suffix}"), format!("out.posed{suffix}."));
        if !case.has(&matrix) && case.names(&posed).next().is_none() {
            continue;
        }
        let frames = frames();
        let found = maps(&frames);
        let rows = found.after(&frames).rows();
        let last = Tensor::from_slice(&[0f32, 0.0, 0.0, 1.0]).expand([rows.size()[0], 1, 4], false);
        let matrices = Tensor::cat(&[&rows, &last], 1);
        case.check_if_there(&matrix, &matrices);
        let check = |part: &str, got: &Tensor| case.check_if_there(&format!("{posed}{part}"), got);
        check("vertices", &skin(&points, &case.get("in.skin"), &found));
        check("joints", &found.apply(&heads));
        check("tails", &found.apply(&case.get("in.tails")));
        // The pose is the next rest.
        check("matrix_local", &matrices);
        for part in ["parents", "face_normals", "vertex_normals"] {
            case.aside(&format!("{posed}{part}"), "of a whole rig that is posed: see riglab-augment's tests");
        }
    }
    // The last of them has gradients.
    let kinds: Vec<&str> = case.names("in.skin").collect();
    for (k, kind) in kinds.iter().enumerate() {
        let weights = case.get(&format!("in.skin{kind}")).set_requires_grad(true);
        let places = points.copy().set_requires_grad(true);
        let found = skin(&places, &weights, &maps(&turned()));
        case.check_if_there(&format!("out.lbs{kind}"), &found);
        if let Some(pull) = case.tensors.get("in.grad_out").filter(|_| k + 1 == kinds.len()) {
            gradients_by(case, &[("skin", &weights), ("vertices", &places)], &(found * pull).sum(None::<Kind>));
        }
    }
    let vectors = case.tensors.get("in.axis_angle");
    if let Some(quaternions) = vectors.map(quaternions_of_vectors) {
        case.check_if_there("out.quaternion_wxyz", &quaternions);
        let rotations = rotations_of_quaternions(&quaternions);
        case.check_if_there("out.quaternion_matrix", &rotations);
        case.check_if_there("out.matrix_quaternion_wxyz", &quaternions_of_rotations(&rotations));
    }
    if let Some(vectors) = case.tensors.get("in.rotvec") {
        case.check_if_there("out.basis_rotation", &rotations_of_vectors(vectors));
    }
}

/// Every variant that is recorded: octaves or even steps, with π or without, with the input or without.
fn fourier(case: &Golden) {
    let x = case.get("in.x");
    for name in case.names("out.") {
        let unknown = || -> ! { panic!("{}: unknown output `{name}`", case.name) };
        let mut words = if name == "skin_default" { "f6_pi1" } else { name }.split('_');
        let frequencies = words.next().and_then(|word| word.strip_prefix('f')?.parse().ok());
        let frequencies: usize = frequencies.unwrap_or_else(|| unknown());
        let (mut base, mut octaves, mut input) = (1.0, true, true);
        for word in words {
            match word {
                "pi0" => base = 1.0,
                "pi1" => base = std::f64::consts::PI,
                "log0" => octaves = false,
                "log1" => octaves = true,
                "noinput" => input = false,
                _ => unknown(),
            }
        }
        let embedding = Embedding::new(&EmbedConfig { kind: EmbedKind::Fourier, frequencies, base });
        let mut found = if octaves {
            embedding.forward(&x)
        } else {
            let last = 2i64.pow(frequencies.max(1) as u32 - 1);
            let steps = Tensor::linspace(1, last, frequencies as i64, (Kind::Float, Device::Cpu));
            embedding.with_tables(&x, &(steps * base), &Tensor::from_slice::<f32>(&[]))
        };
        if !input {
            found = found.narrow(-1, 3, found.size().last().unwrap() - 3);
        }
        case.check(&format!("out.{name}"), &found);
    }
}

/// The shape encoder that stands below `at` in a case's config.
fn perceiver_config(case: &Golden, at: &str) -> PerceiverConfig {
    let of = |key: &str| case.number(&format!("{at}{key}"));
    let says = |key: &str, value: bool| case.config(&format!("{at}{key}")) == value;
    assert!(!says("include_pi", true) && !says("use_ln_post", false), "{}: no such shape encoder", case.name);
    PerceiverConfig {
        tokens: of("token_num") as usize,
        drawn: 4,
        width: of("width") as usize,
        heads: of("heads") as usize,
        layers: of("num_encoder_layers") as usize,
        frequencies: of("num_freqs") as usize,
        sorted: false,
        qkv_bias: says("qkv_bias", true),
        init_scale: of("init_scale"),
    }
}

fn loaded(builder: Builder, tensors: &BTreeMap<String, Tensor>) -> Params {
    let params = builder.finish(0, Kind::Float, Device::Cpu).unwrap();
    params.load(tensors).unwrap();
    params
}

/// Of each cloud, which of the rows drawn are picked: the farthest, the first of them first.
fn farthest(cloud: &Tensor, rows: &[i64], tokens: usize) -> Vec<Vec<usize>> {
    let of = |b: i64| {
        let drawn: Vec<[f32; 3]> =
            rows.iter().map(|&r| std::array::from_fn(|k| cloud.double_value(&[b, r, k as i64]) as f32)).collect();
        farthest_points(&drawn, tokens, 0)
    };
    (0..cloud.size()[0]).map(of).collect()
}

/// The same as rows of each cloud.
fn picks(found: &[Vec<usize>], rows: &[i64]) -> Tensor {
    let all: Vec<i64> = found.iter().flatten().map(|&i| rows[i]).collect();
    Tensor::from_slice(&all).view([found.len() as i64, -1])
}

/// The same as places among the rows drawn of all clouds: so the public code counts.
fn places(found: &[Vec<usize>], rows: &[i64]) -> Tensor {
    let all = found.iter().enumerate().flat_map(|(b, own)| own.iter().map(move |i| (b * rows.len() + i) as i64));
    Tensor::from_slice(&all.collect::<Vec<_>>())
}

/// As a check where there is such a tensor, of what the case tells no tolerance for.
fn near(case: &Golden, name: &str, got: &Tensor, within: f64) {
    let Some(wanted) = case.tensors.get(name) else { return };
    assert_eq!(got.size(), wanted.size(), "{}: shape of `{name}`", case.name);
    let off = (got - wanted).abs().max().double_value(&[]);
    assert!(off <= within, "{}: `{name}` is off by {off:.3e}", case.name);
    case.aside(name, &format!("no tolerance is told: compared within {within}"));
}

fn rows_of(t: &Tensor) -> Vec<i64> {
    Vec::<i64>::try_from(t).unwrap()
}

fn perceiver(case: &Golden) {
    let config = perceiver_config(case, "");
    let mut builder = Builder::default();
    let net = Perceiver::new(builder.root().sub("encoder"), &config);
    let params = loaded(builder, &case.below("w."));
    let [points, normals] = ["in.pc", "in.normals"].map(|name| case.get(name).set_requires_grad(true));
    let cloud = Tensor::cat(&[&points, &normals], -1);
    let drawn = rows_of(&case.get("in.rows"));
    let found = farthest(&cloud, &drawn, config.tokens);
    case.check_if_there("out.fps", &places(&found, &drawn));
    let picks = picks(&found, &drawn);
    let latents = net.forward(params.weights(), &cloud, &picks);
    case.check_if_there("out.latents", &latents);
    if let Some(pull) = case.tensors.get("in.grad_out") {
        gradients(case, &params, &[("pc", &points), ("normals", &normals)], &(latents * pull).sum(None::<Kind>));
    }
    before_the_blocks(case, &config, &cloud, &picks);
}

/// What the encoder has before its blocks read themselves, from its parts.
fn before_the_blocks(case: &Golden, c: &PerceiverConfig, cloud: &Tensor, picks: &Tensor) {
    let embedding = Embedding::new(&EmbedConfig { kind: EmbedKind::Fourier, frequencies: c.frequencies, base: 1.0 });
    let mut builder = Builder::default();
    let mut root = builder.root();
    let mut at = root.sub("encoder");
    let input = Linear::new(at.sub("input_proj"), Role::Projection, embedding.width() + 3, c.width, true);
    let block = FusedConfig { width: c.width, heads: c.heads, qkv_bias: c.qkv_bias, init_scale: c.init_scale };
    let cross = FusedBlock::new(at.sub("cross_attn"), block, true);
    let mut own = case.below("w.");
    own.retain(|name, _| ["encoder.input_proj.", "encoder.cross_attn."].iter().any(|start| name.starts_with(start)));
    let params = loaded(builder, &own);
    let w = params.weights();
    let features = Tensor::cat(&[&embedding.forward(&cloud.narrow(2, 0, 3)), &cloud.narrow(2, 3, 3)], -1);
    let data = input.forward(w, &features);
    let query = data.gather(1, &picks.unsqueeze(-1).expand([-1, -1, c.width as i64], false), false);
    case.check_if_there("out.data", &data);
    case.check_if_there("out.query", &query);
    case.check_if_there("out.after_cross", &cross.forward(w, &query, Some(&data)));
}

/// Compares the gradients of a loss by all inputs and parameters that the case has.
fn gradients(case: &Golden, params: &Params, inputs: &[(&str, &Tensor)], loss: &Tensor) {
    let own = params.ids().map(|id| (params.name(id), &params.weights()[id]));
    gradients_by(case, &inputs.iter().copied().chain(own).collect::<Vec<_>>(), loss);
}

fn gradients_by(case: &Golden, by: &[(&str, &Tensor)], loss: &Tensor) {
    let (names, tensors): (Vec<String>, Vec<&Tensor>) =
        by.iter().map(|(name, t)| (format!("grad.{name}"), *t)).filter(|(name, _)| case.has(name)).unzip();
    if names.is_empty() {
        return;
    }
    for (name, grad) in names.iter().zip(Tensor::run_backward(&[loss], &tensors, false, false)) {
        case.check(name, &grad);
    }
}

/// The encoder with the projection on top, through which its gradients come.
fn mesh_condition(case: &Golden) {
    let config = perceiver_config(case, "");
    let hidden = case.number("hidden") as usize;
    let mut builder = Builder::default();
    let mut root = builder.root();
    let net = Perceiver::new(root.sub("encoder"), &config);
    let mut to_decoder = root.sub("output_proj");
    let linear = Linear::new(to_decoder.sub(0), Role::Projection, config.width, hidden, true);
    let norm = RmsNorm::new(to_decoder.sub(1), hidden, f64::from(f32::EPSILON));
    let params = loaded(builder, &case.below("w."));
    let w = params.weights();
    let (cloud, drawn) = (case.get("in.cloud"), rows_of(&case.get("in.choice")));
    let picks = picks(&farthest(&cloud, &drawn, config.tokens), &drawn);
    case.check_if_there("out.query", &picks);
    let latents = net.forward(w, &cloud, &picks);
    case.check_if_there("out.latent", &latents);
    let out = norm.forward(w, &linear.forward(w, &latents));
    case.check_if_there("out.cond", &out);
    if let Some(pull) = case.tensors.get("in.g") {
        gradients(case, &params, &[], &(out * pull).sum(None::<Kind>));
    }
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
    let shape = perceiver_config(case, "mesh_encoder.");
    let mut builder = Builder::default();
    let net = SkeletonModel::new(builder.root(), &SkeletonModelConfig { shape, decoder }, of("vocab_size") as usize);
    let params = loaded(builder, &case.below("w."));
    (net, params)
}

fn loss(case: &Golden) {
    let (net, params) = model(case);
    let w = params.weights();
    let [points, normals] = ["in.vertices", "in.normals"].map(|name| case.get(name).set_requires_grad(true));
    let cloud = Tensor::cat(&[&points, &normals], -1);
    let (tokens, drawn) = (case.number("cond_tokens") as i64, rows_of(&case.get("in.rows")));
    let found = farthest(&cloud, &drawn, tokens as usize);
    case.check_if_there("out.fps", &places(&found, &drawn));
    let picks = picks(&found, &drawn);
    // As closely as the cases of the shape encoder alone.
    near(case, "out.mesh_latents", &net.shape().forward(w, &cloud, &picks), 2e-5);
    let prefix = net.condition(w, &cloud, &picks);
    // Sequences without their padding, one after another.
    let mask = case.get("in.attention_mask").to_kind(Kind::Int64);
    let lengths = rows_of(&mask.sum_dim_intlist(-1, false, Kind::Int64));
    let padded = case.get("in.input_ids");
    near(case, "out.inputs_embeds", &Tensor::cat(&[&prefix, &net.decoder().embed(w, &padded)], 1), 2e-5);
    let sequences: Vec<Tensor> =
        lengths.iter().enumerate().map(|(b, n)| padded.get(b as i64).narrow(0, 0, *n)).collect();
    let ids = Tensor::cat(&sequences, 0);
    // All rows, the prefix' too, in the places where the padded ones stand.
    let embedded = net.decoder().embed(w, &ids).split_with_sizes(&lengths, 0);
    let parts: Vec<Tensor> = embedded.into_iter().enumerate().flat_map(|(b, t)| [prefix.get(b as i64), t]).collect();
    let packed = Packed::new(lengths.iter().map(|n| n + tokens).collect());
    let whole = tokens + padded.size()[1];
    let read = packed.lengths().iter().map(|&n| Tensor::ones([n], (Kind::Float, Device::Cpu)));
    let read: Vec<Tensor> = read.map(|row| row.constant_pad_nd([0, whole - row.size()[0]])).collect();
    near(case, "out.full_attention_mask", &Tensor::stack(&read, 0), 0.0);
    if let Some(wanted) = case.tensors.get("out.logits") {
        let all = net.decoder().logits(w, &net.decoder().forward(w, &Tensor::cat(&parts, 0), &packed, false));
        let filled = packed.apart(&all).into_iter().enumerate().map(|(b, own)| {
            let n = own.size()[0];
            let rest = wanted.get(b as i64).narrow(0, n, wanted.size()[1] - n);
            Tensor::cat(&[own, rest], 0)
        });
        case.check("out.logits", &Tensor::stack(&filled.collect::<Vec<_>>(), 0));
    }
    let logits = net.logits(w, &prefix, &ids, &lengths, false);
    let targets = Tensor::cat(&sequences.iter().map(|s| s.narrow(0, 1, s.size()[0] - 1)).collect::<Vec<_>>(), 0);
    let ce = cross_entropy(&logits, &targets);
    case.check_if_there("out.ce_loss", &ce.view([1]));
    case.check_if_there("out.dis_loss", &coordinate_distance(&logits, &targets, 256).view([1]));
    gradients(case, &params, &[("vertices", &points), ("normals", &normals)], &ce);
}

/// The released grammar, or none.
#[derive(Clone)]
struct Released {
    walk: Walk,
    ids: usize,
    end: u32,
    free: bool,
}

impl Grammar for Released {
    fn allowed(&self) -> Vec<u64> {
        let mut mask = Mask::none(self.ids);
        if self.free {
            mask.allow_all(0..self.ids as u32);
        } else {
            self.walk.allowed(&mut mask);
        }
        mask.words().to_vec()
    }

    fn accept(&mut self, id: u32) {
        self.walk.advance(id).unwrap();
    }

    fn ends(&self, id: u32) -> bool {
        id == self.end
    }
}

/// The model after a prompt.
struct Reader<'a> {
    net: &'a SkeletonModel,
    weights: &'a Weights,
    cache: Cache,
    /// What each row has read behind the prompt.
    ids: Vec<Vec<u32>>,
    steps: Vec<Step>,
}

/// Of a step, what each row had read, and its raw scores.
type Step = (Vec<Vec<u32>>, Vec<Vec<f32>>);

fn floats(t: &Tensor) -> Vec<f32> {
    Vec::<f32>::try_from(t.contiguous().view([-1])).unwrap()
}

impl Decoder for Reader<'_> {
    fn next(&mut self, ids: &[u32]) -> Vec<Vec<f32>> {
        self.ids.iter_mut().zip(ids).for_each(|(row, id)| row.push(*id));
        let ids: Vec<i64> = ids.iter().map(|&id| i64::from(id)).collect();
        let ids = Tensor::from_slice(&ids).view([ids.len() as i64, 1]);
        let scores = self.net.next(self.weights, &ids, &mut self.cache);
        let rows: Vec<Vec<f32>> = scores.unbind(0).iter().map(floats).collect();
        self.steps.push((self.ids.clone(), rows.clone()));
        rows
    }

    fn select(&mut self, rows: &[usize]) {
        self.ids = rows.iter().map(|&row| self.ids[row].clone()).collect();
        self.cache.select(&rows.iter().map(|&r| r as i64).collect::<Vec<_>>());
    }
}

#[test]
fn released_generation() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    let all = golden("unirig", &["ar_loss", "ar_generate"]);
    for (_, case) in all.iter().filter(|(kind, _)| *kind == "ar_generate") {
        let of = weights_of(case, &all);
        let (net, params) = model(of);
        tch::no_grad(|| generate(case, of, &net, params.weights()));
        case.done();
    }
}

/// The case whose weights a case starts from: itself where it has some, else the one that it names.
fn weights_of<'a>(case: &'a Golden, all: &'a [(&str, Golden)]) -> &'a Golden {
    if case.names("w.").next().is_some() {
        return case;
    }
    let said = case.config("weights").as_str().unwrap_or("ar_loss");
    let named = all.iter().map(|(_, c)| c).filter(|c| said.contains(&c.name) && c.names("w.").next().is_some());
    named.max_by_key(|c| c.name.len()).unwrap_or_else(|| panic!("{}: no weights of `{said}`", case.name))
}

/// The released tokenizer with the classes that the case tells, else with those of a release that has as many ids as
/// the model.
fn tokenizer(case: &Golden, of: &Golden) -> Tokenizer {
    let ids = of.number("llm.vocab_size") as usize;
    let told = [case, of].into_iter().flat_map(|c| ["cls", "tokenizer.cls"].map(|path| c.config(path)));
    let told: Vec<Vec<String>> = told
        .filter_map(Value::as_object)
        .map(|table| {
            let mut classes: Vec<_> = table.iter().map(|(name, id)| (id.as_u64(), name.clone())).collect();
            classes.sort();
            classes.into_iter().map(|(_, name)| name).collect()
        })
        .collect();
    let rignet = ["rignet", "vroid"].map(String::from).to_vec();
    let released = Preset::UnirigReleased.config();
    let known = [released.classes.clone(), rignet];
    let all = if told.is_empty() { &known[..] } else { &told };
    all.iter()
        .map(|classes| Tokenizer::new(riglab_token::TokenizerConfig { classes: classes.clone(), ..released.clone() }))
        .find(|tokenizer| tokenizer.vocabulary().len() == ids)
        .unwrap_or_else(|| panic!("{}: no tokenizer of {ids} ids among {all:?}", case.name))
}

/// How a run draws, and whether under the grammar.
fn run_config(case: &Golden, run: &Value) -> (GenerateConfig, bool) {
    // Those of the standard library, in the order in which it asks them here.
    const ORDER: [&str; 5] = [
        "RepetitionPenaltyLogitsProcessor",
        "VocabSwitchingLogitsProcessor",
        "TemperatureLogitsWarper",
        "TopKLogitsWarper",
        "TopPLogitsWarper",
    ];
    let listed: Option<Vec<&str>> =
        run["processors"].as_array().map(|all| all.iter().map(|name| name.as_str().unwrap()).collect());
    if let Some(listed) = &listed {
        let places: Option<Vec<usize>> = listed.iter().map(|name| ORDER.iter().position(|o| o == name)).collect();
        assert!(places.is_some_and(|p| p.is_sorted()), "{}: other processors: {listed:?}", case.name);
    }
    let has = |name: &str, untold: bool| listed.as_ref().map_or(untold, |listed| listed.contains(&name));
    // What the standard library takes where it is told to draw and no more.
    let mut config =
        GenerateConfig { top_k: if has(ORDER[3], false) { 50 } else { 0 }, tokens: 0, ..GenerateConfig::default() };
    for (key, value) in run["kwargs"].as_object().expect("arguments of a run") {
        let number = || value.as_f64().unwrap_or_else(|| panic!("{}: `{key}` is no number", case.name));
        match key.as_str() {
            "max_new_tokens" => config.tokens = number() as usize,
            "do_sample" => config.sample = value == true,
            "num_beams" => config.beams = number() as usize,
            "temperature" => config.temperature = number() as f32,
            "top_k" => config.top_k = number() as usize,
            "top_p" => config.top_p = number() as f32,
            "repetition_penalty" => config.repetition_penalty = number() as f32,
            "num_return_sequences" | "length_penalty" if number() == 1.0 => {}
            "early_stopping" if value == false => {}
            "use_cache" | "bos_token_id" | "eos_token_id" | "pad_token_id" => {}
            _ => panic!("{}: {key} = {value} is not generated here", case.name),
        }
    }
    (config, has(ORDER[1], true))
}

fn generate(case: &Golden, of: &Golden, net: &SkeletonModel, w: &Weights) {
    let tokenizer = tokenizer(case, of);
    let cloud = Tensor::cat(&[&case.get("in.vertices"), &case.get("in.normals")], -1);
    let tokens = of.number("cond_tokens") as usize;
    let drawn = rows_of(&if case.has("in.rows") { case.get("in.rows") } else { of.get("in.rows") });
    let prefix = net.condition(w, &cloud, &picks(&farthest(&cloud, &drawn, tokens), &drawn));
    let runs = case.config("runs").as_array().unwrap();
    let names: BTreeSet<&str> = case.names("out.").filter_map(|name| Some(name.rsplit_once('.')?.0)).collect();
    for name in names {
        let run = runs.iter().find(|run| run["name"].as_str() == Some(name));
        let run = run.unwrap_or_else(|| panic!("{}: no run `{name}`", case.name));
        generate_run(case, name, run, (net, w, &prefix), &tokenizer);
    }
}

fn generate_run(
    case: &Golden,
    name: &str,
    run: &Value,
    (net, w, prefix): (&SkeletonModel, &Weights, &Tensor),
    tokenizer: &Tokenizer,
) {
    let ids = tokenizer.vocabulary();
    let (config, bound) = run_config(case, run);
    let class = run["cls"].as_str().map(|c| ids.class_named(c).map_or(ids.no_class(), |c| ids.class(c)));
    let prompt: Vec<u32> = std::iter::once(ids.bos()).chain(class).collect();
    let mut grammar = Released { walk: Walk::new(ids), ids: ids.len(), end: ids.eos(), free: !bound };
    prompt.iter().for_each(|&id| grammar.accept(id));
    let beams = config.beams;
    let own = prefix.narrow(0, run["item"].as_i64().unwrap(), 1).expand([beams as i64, -1, -1], false);
    let cache = net.start(w, &own, (prompt.len() + config.tokens) as i64);
    let mut reader = Reader { net, weights: w, cache, ids: vec![vec![]; beams], steps: vec![] };
    let first_ids: Vec<i64> = prompt.iter().map(|&id| i64::from(id)).collect();
    let first = Tensor::from_slice(&first_ids).unsqueeze(0).expand([beams as i64, -1], false);
    let first = floats(&net.next(w, &first, &mut reader.cache).get(0));
    reader.steps.push((reader.ids.clone(), vec![first.clone(); beams]));
    let draws = case.tensors.get(&format!("in.{name}.draws"));
    assert_eq!(draws.is_some(), config.sample, "{}: draws of {name}", case.name);
    let draw = |step: usize| rows_of(&draws.unwrap().get(step as i64));
    // Of every step, what is drawn from, and the scores that were made of the raw ones.
    let (mut shares, mut processed) = (Vec::new(), Vec::new());
    let found = if beams > 1 {
        let all = riglab_nn::generate::beams(&mut reader, &first, &grammar, &config, |step, sums| {
            shares.push(softmax(sums));
            match draws {
                Some(_) => draw(step).into_iter().map(|place| place as usize).collect(),
                None => best(sums, 2 * beams),
            }
        });
        for (before, raw) in &mut reader.steps {
            for (before, scores) in before.iter().zip(raw) {
                log_softmax(scores);
                let (mut own, mut grammar) = (scores.clone(), grammar.clone());
                before.iter().for_each(|&id| grammar.accept(id));
                process(&mut own, before, Some(&grammar.allowed()), &config, 2);
                processed.push(own);
            }
        }
        all.unwrap().remove(0).ids
    } else {
        let mut all = riglab_nn::generate::rows(&mut reader, vec![first], vec![grammar], &config, |_, step, scores| {
            shares.push(softmax(scores));
            processed.push(scores.to_vec());
            if draws.is_some() { draw(step)[0] as u32 } else { argmax(scores) }
        });
        all.as_mut().unwrap().remove(0)
    };
    let whole: Vec<i64> = prompt.iter().chain(&found).map(|&id| i64::from(id)).collect();
    case.check_if_there(&format!("out.{name}.ids"), &Tensor::from_slice(&whole));
    let raw: Vec<Vec<f32>> = reader.steps.iter().flat_map(|(_, raw)| raw.iter().cloned()).collect();
    for (what, mine) in [("raw", &raw), ("processed", &processed)] {
        let name = format!("out.{name}.{what}");
        if let Some(wanted) = case.tensors.get(&name) {
            case.check_scores(&name, &as_many(case, &name, mine, wanted));
        }
    }
    let running = format!("out.{name}.running_ids_last");
    if let Some(wanted) = case.tensors.get(&running) {
        let mine: Vec<Vec<i64>> = reader.ids.iter().map(|row| row.iter().map(|&id| i64::from(id)).collect()).collect();
        case.check(&running, &as_many(case, &running, &mine, wanted));
    }
    for first in case.names(&format!("out.{name}.probs_first")) {
        let name = format!("out.{name}.probs_first{first}");
        near(case, &name, &as_many(case, &name, &shares, &case.get(&name)), 1e-4);
    }
}

/// The first of these rows, as many as are recorded, in the shape of those.
fn as_many<T: tch::kind::Element + Copy>(case: &Golden, name: &str, rows: &[Vec<T>], wanted: &Tensor) -> Tensor {
    let mut all = rows.concat();
    assert!(all.len() >= wanted.numel(), "{}: {} numbers of `{name}`", case.name, all.len());
    all.truncate(wanted.numel());
    Tensor::from_slice(&all).view(wanted.size().as_slice())
}

/// What one recorded output has done to the scores.
struct Processor {
    config: GenerateConfig,
    keep: usize,
    /// Whether they are made logarithms of shares first.
    log: bool,
    /// Whether the shares of what is left are recorded.
    shares: bool,
}

/// The number right behind a word, whatever stands between them.
fn number_after(text: &str, word: &str) -> Option<f32> {
    let rest = text.split_once(word)?.1.trim_start_matches(|c: char| !c.is_ascii_digit());
    let end = rest.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(rest.len());
    rest[..end].trim_end_matches('.').parse().ok()
}

/// By its name: one of them and its number (`top_k5`, `top_p0.3_keep2`), or `chain` and which (all, or `rep_temp_k_p`),
/// whose numbers the config tells in words.
fn processor(case: &Golden, output: &str) -> Processor {
    let (name, shares) = output.strip_suffix("_probs").map_or((output, false), |name| (name, true));
    let bad = |why: &str| -> ! { panic!("{}: output `{output}`: {why}", case.name) };
    let mut config = GenerateConfig { sample: true, ..GenerateConfig::default() };
    let mut set = |which: &str, number: f32| match which {
        "repetition" => config.repetition_penalty = number,
        "temperature" => config.temperature = number,
        "top_k" => config.top_k = number as usize,
        "top_p" => config.top_p = number,
        _ => unreachable!("one of four"),
    };
    let all = [("repetition", "rep"), ("temperature", "temp"), ("top_k", "k"), ("top_p", "p")];
    let Some(chain) = name.strip_prefix("chain") else {
        let (name, keep) = name.split_once("_keep").map_or((name, Some(1)), |(name, keep)| (name, keep.parse().ok()));
        let one = all.iter().find_map(|(word, _)| Some((*word, name.strip_prefix(word)?.parse().ok()?)));
        let (Some((word, number)), Some(keep)) = (one, keep) else { bad("unknown") };
        set(word, number);
        return Processor { config, keep, log: false, shares };
    };
    let words: Vec<&str> = chain.split('_').filter(|word| !word.is_empty()).collect();
    // A chain that is told nowhere has the numbers of one that is.
    let texts = case.json["config"].as_object().into_iter().flatten();
    let mut texts = texts.filter(|(key, _)| key.starts_with("chain")).filter_map(|(_, text)| text.as_str());
    let text = case.config(name).as_str().or_else(|| texts.next());
    let text = text.unwrap_or_else(|| bad("the config does not tell its numbers"));
    let beam = words.contains(&"beam");
    let known = |word: &&str| *word == "beam" || all.iter().any(|(_, short)| word == short);
    if !words.iter().all(known) {
        bad("unknown");
    }
    let some = all.iter().any(|(_, short)| words.contains(short));
    for (word, short) in all {
        if !some || words.contains(&short) {
            set(word, number_after(text, word).unwrap_or_else(|| bad("a number is not told")));
        }
    }
    let keep = if beam { number_after(text, "min_tokens_to_keep").unwrap_or(2.0) as usize } else { 1 };
    Processor { config, keep, log: beam, shares }
}

/// `mine` with what stands at ids of one and the same score in the order in which `wanted` has it: which of them
/// survives is the affair of a sort.
fn tied_as(mine: &[f32], wanted: &[f32], scores: &[f32]) -> Vec<f32> {
    let mut out = mine.to_vec();
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_by(|&a, &b| scores[a].total_cmp(&scores[b]));
    for tied in order.chunk_by(|&a, &b| scores[a] == scores[b]) {
        let mut own: Vec<f32> = tied.iter().map(|&id| mine[id]).collect();
        own.sort_by(f32::total_cmp);
        let mut places = tied.to_vec();
        places.sort_by(|&a, &b| wanted[a].total_cmp(&wanted[b]));
        places.into_iter().zip(own).for_each(|(id, score)| out[id] = score);
    }
    out
}

#[test]
fn released_processors() {
    for (_, case) in golden("unirig", &["logits_processors"]) {
        let (scores, ids) = (case.get("in.scores"), case.get("in.ids"));
        for output in case.names("out.") {
            let Processor { config, keep, log, shares } = processor(&case, output);
            let output = format!("out.{output}");
            let wanted = case.get(&output);
            let rows = (0..scores.size()[0]).map(|row| {
                let mut start = floats(&scores.get(row));
                if log {
                    log_softmax(&mut start);
                }
                let before: Vec<u32> = rows_of(&ids.get(row)).into_iter().map(|id| id as u32).collect();
                let processed = |config: &GenerateConfig| {
                    let mut scores = start.clone();
                    process(&mut scores, &before, None, config, keep);
                    scores
                };
                let sorted = processed(&GenerateConfig { top_p: 1.0, ..config.clone() });
                let mine = tied_as(&processed(&config), &floats(&wanted.get(row)), &sorted);
                Tensor::from_slice(&if shares { softmax(&mine) } else { mine })
            });
            case.check_scores(&output, &Tensor::stack(&rows.collect::<Vec<_>>(), 0));
        }
        case.done();
    }
}

/// Every set-up: the schedule over all steps, and weights, momentum and clipping over the first.
#[test]
fn released_schedule_and_optimizer() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (_, case) in golden("unirig", &["schedule"]) {
        let setups: BTreeSet<&str> = case.names("out.").filter_map(|name| Some(name.split_once('.')?.0)).collect();
        for setup in setups {
            let own = |key: &str| case.config(&format!("{setup}.{key}")).as_f64();
            let of = |key: &str| case.number(&format!("{setup}.{key}"));
            let shared = |key: &str| own(key).unwrap_or_else(|| case.number(key));
            let steps = (shared("epochs") * shared("steps_per_epoch")) as u64;
            let (start, peak) = (1.0 / of("div_factor"), of("max_lr"));
            let usual = OneCycleConfig::default().beta1;
            let beta1s = [own("max_momentum").unwrap_or(usual[0]), own("base_momentum").unwrap_or(usual[1])];
            let one_cycle = OneCycleConfig { rise: of("pct_start"), start, beta1: beta1s };
            let end = start / of("final_div_factor");
            let schedule = ScheduleConfig { kind: ScheduleKind::OneCycle, warmup: 0, end, one_cycle };
            let pace =
                |step: u64| Pace { factor: factor(&schedule, step, steps), beta1: beta1(&schedule, step, steps) };
            let rates: Vec<f64> = (0..steps).map(|step| peak * pace(step).factor).collect();
            let betas: Vec<f64> = (0..steps).filter_map(|step| pace(step).beta1).collect();
            case.check_if_there(&format!("out.{setup}.lr"), &Tensor::from_slice(&rates));
            case.check_if_there(&format!("out.{setup}.beta1"), &Tensor::from_slice(&betas));
            optimizer_steps(&case, setup, peak, pace);
        }
        case.done();
    }
}

fn optimizer_steps(case: &Golden, setup: &str, peak: f64, pace: impl Fn(u64) -> Pace) {
    let prefix = format!("in.{setup}.grad_");
    let names: Vec<&str> = case.names(&prefix).collect();
    if names.is_empty() {
        return;
    }
    let starts: BTreeMap<String, Tensor> =
        names.iter().map(|name| (name.to_string(), case.get(&format!("in.{setup}.{name}0")))).collect();
    let mut builder = Builder::default();
    for (name, start) in &starts {
        builder.root().add(name, Role::Projection, &start.size(), Init::Constant(0.0));
    }
    let params = loaded(builder, &starts);
    let number = |key: &str, usual| case.config(&format!("{setup}.{key}")).as_f64().unwrap_or(usual);
    let config = OptimConfig {
        muon: vec![],
        adamw_lr: peak,
        adamw_betas: [0.9, number("beta2", 0.999)],
        weight_decay: case.number(&format!("{setup}.weight_decay")),
        clip: number("clip", 1.0),
        ..OptimConfig::default()
    };
    let mut optimizer = Optimizer::new(&params, config);
    let pulls: Vec<Tensor> = params.ids().map(|id| case.get(&format!("in.{setup}.grad_{}", params.name(id)))).collect();
    let mut norms = Vec::new();
    let mut seen: Vec<Vec<Tensor>> = pulls.iter().map(|_| Vec::new()).collect();
    for step in 0..pulls[0].size()[0] {
        let own = pulls.iter().map(|pull| pull.get(step).copy()).collect();
        norms.push(optimizer.step_at(&params, own, pace(step as u64)).unwrap().grad_norm);
        params.weights().tensors().iter().zip(&mut seen).for_each(|(t, all)| all.push(t.detach().copy()));
    }
    case.check_if_there(&format!("out.{setup}.grad_norm"), &Tensor::from_slice(&norms));
    for (id, all) in params.ids().zip(seen) {
        case.check_if_there(&format!("out.{setup}.{}", params.name(id)), &Tensor::stack(&all, 0));
    }
}

#[test]
fn the_cache_reads_as_the_whole_sequence() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (_, case) in golden("unirig", &["ar_loss"]) {
        let (net, params) = model(&case);
        let w = params.weights();
        tch::no_grad(|| {
            tch::manual_seed(1);
            let [width, vocabulary] = ["llm.hidden_size", "llm.vocab_size"].map(|key| case.number(key) as i64);
            let prefix = Tensor::randn([2, 6, width], (Kind::Float, Device::Cpu));
            let ids = Tensor::randint(vocabulary, [2, 9], (Kind::Int64, Device::Cpu));
            let whole = net.logits(w, &prefix, &ids.flatten(0, 1), &[9, 9], false).view([2, 8, vocabulary]);
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

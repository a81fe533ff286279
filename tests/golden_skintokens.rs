//! The released skin auto-encoder and its optimiser, against values recorded from the public code.

use std::collections::BTreeMap;

use riglab_nn::embed::{EmbedConfig, EmbedKind, Embedding};
use riglab_nn::fsq::{Fsq, ProjectedFsq};
use riglab_nn::fsq_cvae::{FsqCvae, FsqCvaeConfig, SkinCloud, SkinQueries};
use riglab_nn::layers::{Block, BlockConfig, Context, HeadSplit};
use riglab_nn::loss;
use riglab_nn::optim::{OptimConfig, Optimizer, newton_schulz};
use riglab_nn::params::{Builder, Init, ParamId, Params, Role};
use riglab_tests::{Golden, golden, muon_scale, optimizer};
use tch::{Device, Kind, Tensor};

const KINDS: [&str; 8] = ["fsq", "fsq_projected", "pmpe", "dit_block", "vae_fps", "vae_learned", "vae_train", "muon"];

#[test]
fn released_networks_and_optimiser() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    let all = golden("skintokens", &KINDS);
    for (kind, case) in &all {
        match *kind {
            "fsq" => fsq(case),
            "fsq_projected" => fsq_projected(case),
            "pmpe" => pmpe(case),
            "dit_block" => dit_block(case),
            "vae_fps" | "vae_learned" => vae(case),
            "vae_train" => {
                let start = case.config("start").as_str().expect("the case it starts from");
                let (_, start) = all.iter().find(|(_, c)| c.name == start).expect("the case it starts from");
                vae_train(case, start);
            }
            "muon" => muon(case),
            other => unreachable!("{other}"),
        }
        case.done();
    }
}

fn levels(v: &serde_json::Value) -> Vec<i64> {
    v.as_array().expect("levels").iter().map(|x| x.as_i64().expect("a level")).collect()
}

/// Gradients of Σ out g.
fn pull(out: &Tensor, g: &Tensor, inputs: &[&Tensor]) -> Vec<Tensor> {
    Tensor::run_backward(&[(out * g).sum(None::<Kind>)], inputs, false, false)
}

fn fsq(case: &Golden) {
    for name in case.names("out.index.") {
        let fsq = Fsq::new(&levels(&case.config("levels")[name])).unwrap();
        let at = |stem: &str| format!("{stem}.{name}");
        let z = case.get(&at("in.z")).set_requires_grad(true);
        let code = fsq.quantize(&z);
        case.check(&at("out.bound"), &fsq.bound(&z));
        case.check(&at("out.code"), &code);
        case.check(&at("out.index"), &fsq.ids(&code));
        case.check(&at("grad.z"), &pull(&code, &case.get(&at("in.g")), &[&z])[0]);
        let ids = case.get(&at("in.ids"));
        case.check(&at("out.level_index"), &fsq.levels_of(&ids));
        case.check(&at("out.code_of_id"), &fsq.codes(&ids, Kind::Float));
        case.check(&at("out.basis"), &Tensor::from_slice(&fsq.basis()));
        case.check(&at("out.levels"), &Tensor::from_slice(fsq.levels()));
    }
}

fn fsq_projected(case: &Golden) {
    let mut b = Builder::default();
    let fsq = ProjectedFsq::new(b.root(), &levels(case.config("levels")), case.number("dim") as usize, 0).unwrap();
    let params = loaded(b, case, Kind::Float);
    let w = params.weights();
    let z = case.get("in.z").set_requires_grad(true);
    let codes = fsq.encode(w, &z, None);
    let out = fsq.decode(w, &codes);
    case.check("out.index", &fsq.fsq().ids(&codes));
    case.check("out.out", &out);
    case.check("out.from_index", &fsq.decode(w, &fsq.fsq().codes(&case.get("out.index"), Kind::Float)));
    let inputs: Vec<&Tensor> = std::iter::once(&z).chain(w.tensors()).collect();
    let grads = pull(&out, &case.get("in.g"), &inputs);
    case.check("grad.z", &grads[0]);
    for id in params.ids() {
        case.check(&format!("grad.{}", params.name(id)), &grads[1 + id.index()]);
    }
}

fn pmpe(case: &Golden) {
    let x = case.get("in.x");
    for name in case.names("out.") {
        let (kind, rest) = match name.split_once('_') {
            Some(("pmpe", rest)) => (EmbedKind::PhaseModulated, rest),
            Some(("plain" | "fourier", rest)) => (EmbedKind::Fourier, rest),
            // Frequencies and phases are checked with their encoding.
            _ => continue,
        };
        let (size, bf16) = match rest.split_once('_') {
            Some((size, "bf16_tables")) => (size, true),
            _ => (rest, false),
        };
        let base = if size.starts_with("nopi") { 1.0 } else { std::f64::consts::PI };
        let frequencies = size.trim_start_matches(char::is_alphabetic).parse().expect("a count of frequencies");
        let embedding = Embedding::new(&EmbedConfig { kind, frequencies, base });
        let out = if bf16 {
            embedding.with_tables(&x, &case.get("out.freq_bf16"), &case.get("out.phase_bf16"))
        } else {
            embedding.forward(&x)
        };
        case.check(&format!("out.{name}"), &out);
        for (stem, table) in [("out.freq_", embedding.frequencies()), ("out.phase_", embedding.phases())] {
            let table = Tensor::from_slice(table);
            case.check_if_there(&format!("{stem}{size}"), &table);
            if bf16 {
                case.check(&format!("{stem}bf16"), &table.to_kind(Kind::BFloat16).to_kind(Kind::Float));
            }
        }
    }
    case.aside("out.cube", "learned frequencies, cosines first: what Cube published, and no option of ours");
}

fn dit_block(case: &Golden) {
    let (width, heads) = (case.number("dim") as usize, case.number("heads") as usize);
    let mlp_ratio = case.number("ff") / case.number("dim");
    let block = BlockConfig { width, context_width: width, heads, mlp_ratio, split: HeadSplit::Fused };
    let mut b = Builder::default();
    let own = Block::new(b.root().sub("self"), block, Context::Itself);
    let cross = Block::new(b.root().sub("cross"), block, Context::Other);
    let params = loaded(b, case, Kind::Float);
    let w = params.weights();
    let find = |name: &str| params.ids().find(|&id| params.name(id) == name).expect("a parameter");
    let (x, y, g) =
        (case.get("in.x").set_requires_grad(true), case.get("in.y").set_requires_grad(true), case.get("in.g"));

    let out = own.forward(w, &x, None);
    case.check("out.self", &out);
    let (q, k) = (find("self.attn1.to_q.weight"), find("self.attn1.to_k.weight"));
    let grads = pull(&out, &g, &[&x, &w[q], &w[k]]);
    for (name, grad) in ["grad.self_x", "grad.self_to_q", "grad.self_to_k"].iter().zip(&grads) {
        case.check(name, grad);
    }

    let out = cross.forward(w, &x, Some(&cross.keys(w, &y)));
    case.check("out.cross", &out);
    let grads = pull(&out, &g, &[&x, &y, &w[find("cross.attn2.to_k.weight")]]);
    for (name, grad) in ["grad.cross_x", "grad.cross_y", "grad.cross_to_k"].iter().zip(&grads) {
        case.check(name, grad);
    }
}

/// The network of a case, by its own config.
fn vae_config(case: &Golden) -> FsqCvaeConfig {
    let n = |key: &str| case.number(key) as usize;
    let base = if case.config("embed_include_pi").as_bool().expect("a switch") { std::f64::consts::PI } else { 1.0 };
    let kind = match case.config("use_pmpe").as_bool().expect("a switch") {
        true => EmbedKind::PhaseModulated,
        false => EmbedKind::Fourier,
    };
    let learned = case.tensors.contains_key("w.encoder.learned_queries");
    FsqCvaeConfig {
        embed: EmbedConfig { kind, frequencies: n("embed_frequency"), base },
        encoder_width: n("width_encoder"),
        decoder_width: n("width_decoder"),
        heads: n("num_attention_heads"),
        encoder_layers: n("num_layers_encoder"),
        decoder_layers: n("num_layers_decoder"),
        latent: n("latent_channels"),
        levels: levels(case.config("FSQ_dict.levels")),
        shape_tokens: n("T_W"),
        skin_tokens: n("T_D"),
        skin_queries: if learned { SkinQueries::Learned } else { SkinQueries::Farthest },
        head_split: HeadSplit::Fused,
        ..FsqCvaeConfig::default()
    }
}

struct Vae {
    net: FsqCvae,
    params: Params,
    uniform: Tensor,
    all: Tensor,
    weights: Tensor,
    shape_queries: Tensor,
    skin_queries: Option<Tensor>,
    lambda: [f64; 3],
}

impl Vae {
    fn new(case: &Golden, kind: Kind) -> Self {
        let mut b = Builder::default();
        let net = FsqCvae::new(b.root(), &vae_config(case)).unwrap();
        let params = loaded(b, case, kind);
        let widen = |name: &str| case.get(name).to_kind(kind);
        let uniform = widen("in.uniform");
        let all = Tensor::cat(&[&uniform, &widen("in.dense")], 1);
        let weights = Tensor::cat(&[widen("in.uniform_w"), widen("in.dense_w")], 1);
        let shape_queries = farthest(case, &uniform, "cond");
        let skin_queries = case.tensors.contains_key("in.choice_x").then(|| farthest(case, &all, "x"));
        let lambda = ["bce", "mse", "dice"].map(|k| case.number(&format!("lambda_.{k}")));
        Self { net, params, uniform, all, weights, shape_queries, skin_queries, lambda }
    }

    fn cond(&self) -> Tensor {
        self.net.encode_shape(self.params.weights(), &self.uniform, &self.shape_queries)
    }

    fn cloud(&self) -> SkinCloud {
        SkinCloud {
            points: self.all.shallow_clone(),
            weights: self.weights.shallow_clone(),
            queries: self.skin_queries.as_ref().map(Tensor::shallow_clone),
            regions: None,
            off: None,
        }
    }

    /// Logits for a prefix of codes, and [bce, mse, dice mean, total].
    fn losses(&self, codes: &Tensor, cond: &Tensor, k: i64) -> (Tensor, [Tensor; 4]) {
        let w = self.params.weights();
        let logits = self.net.decode(w, &codes.narrow(1, 0, k), cond, &self.all, None);
        let pred = logits.sigmoid();
        let (bce, mse) = (loss::bce(&logits, &self.weights), loss::mse(&pred, &self.weights));
        let dice = loss::dice(&pred, &self.weights).mean(None::<Kind>);
        let total = &bce * self.lambda[0] + &mse * self.lambda[1] + &dice * self.lambda[2];
        (logits, [bce, mse, dice, total])
    }
}

/// Farthest points among the case's pre-picks, as indices into the whole cloud.
fn farthest(case: &Golden, cloud: &Tensor, name: &str) -> Tensor {
    let choice = Vec::<i64>::try_from(case.get(&format!("in.choice_{name}"))).unwrap();
    let expected = case.get(&format!("out.query_{name}"));
    let count = expected.size()[1] as usize;
    let rows: Vec<Tensor> = (0..cloud.size()[0])
        .map(|b| {
            let points: Vec<f32> =
                Vec::try_from(cloud.get(b).narrow(1, 0, 3).contiguous().view([-1]).to_kind(Kind::Float)).unwrap();
            let at = |i: usize| [points[3 * i], points[3 * i + 1], points[3 * i + 2]];
            let candidates: Vec<[f32; 3]> = choice.iter().map(|&i| at(i as usize)).collect();
            let picks = riglab_geom::farthest_points(&candidates, count, 0);
            Tensor::from_slice(&picks.iter().map(|&i| choice[i]).collect::<Vec<_>>())
        })
        .collect();
    let picks = Tensor::stack(&rows, 0);
    case.check(&format!("out.query_{name}"), &picks);
    picks
}

fn vae(case: &Golden) {
    let vae = Vae::new(case, Kind::Float);
    let (net, w) = (&vae.net, vae.params.weights());
    let cond = vae.cond();
    case.check("out.cond", &cond);
    let tokens = net.config().skin_tokens;
    let latent = net.encode_skin(w, &vae.cloud(), tokens);
    case.check("out.latent", &latent);
    let codes = net.quantize(w, &latent, &vae.cloud());
    case.check("out.index", &net.fsq().ids(&codes));
    case.check("out.z", &net.dequantize(w, &codes));
    let (logits, [bce, mse, _, total]) = vae.losses(&codes, &cond, tokens as i64);
    case.check("out.pred", &logits.sigmoid());
    case.check("out.bce", &bce);
    case.check("out.mse", &mse);
    case.check("out.dice_per_bone", &loss::dice(&logits.sigmoid(), &vae.weights));
    case.check("out.total", &total);
    for k in case.names("out.pred_prefix_").map(|k| k.parse::<i64>().unwrap()).collect::<Vec<_>>() {
        let (logits, [bce, mse, dice, _]) = vae.losses(&codes, &cond, k);
        case.check(&format!("out.pred_prefix_{k}"), &logits.sigmoid());
        case.check(&format!("out.loss_prefix_{k}"), &Tensor::stack(&[bce, mse, dice], 0));
    }
    for k in case.names("out.latent_trunc_before_").map(|k| k.parse::<usize>().unwrap()).collect::<Vec<_>>() {
        case.check(&format!("out.latent_trunc_before_{k}"), &net.encode_skin(w, &vae.cloud(), k));
    }
    let between = [("cond", &cond), ("latent", &latent), ("codes", &codes)];
    let inputs: Vec<&Tensor> = w.tensors().iter().chain(between.iter().map(|(_, t)| *t)).collect();
    let grads = Tensor::run_backward(&[total], &inputs, true, false);
    let (own, between) = grads.split_at(w.tensors().len());
    let norms = case.config("grad_norms").as_object().expect("gradient norms");
    for id in vae.params.ids() {
        let (name, grad) = (vae.params.name(id), &own[id.index()]);
        case.check_if_there(&format!("grad.{name}"), grad);
        let (got, want) = (grad.norm().double_value(&[]), norms[name].as_f64().unwrap());
        assert!((got - want).abs() <= 2e-5 + 2e-3 * want, "{}: gradient norm of {name}: {got} / {want}", case.name);
    }
    case.check_if_there("grad.cond", &between[0]);
    case.check_if_there("grad.latent", &between[1]);
    if case.has("grad.z") {
        // Of what codes become within the decoder: by what it does to the codes.
        let pulled = &pull(&net.dequantize(w, &codes), &case.get("grad.z"), &[&codes])[0];
        let off = (pulled - &between[2]).abs() - between[2].abs() * 2e-3;
        assert!(off.max().double_value(&[]) <= 2e-5, "{}: grad.z", case.name);
        case.aside("grad.z", "compared through the projection");
    }
}

fn vae_train(case: &Golden, start: &Golden) {
    let vae = Vae::new(start, Kind::Double);
    // The case's Muon moves every attention projection, AdamW the rest, and all is decayed: the defaults.
    let config = optimizer(case);
    let mut optimizer = Optimizer::new(&vae.params, config);
    let w = vae.params.weights();
    let inputs: Vec<&Tensor> = w.tensors().iter().collect();
    let mut rows = Vec::new();
    let prefixes = Vec::<i64>::try_from(case.get("in.prefix")).unwrap();
    for (step, &k) in prefixes.iter().enumerate() {
        let cond = vae.cond();
        let latent = vae.net.encode_skin(w, &vae.cloud(), vae.net.config().skin_tokens);
        let codes = vae.net.quantize(w, &latent, &vae.cloud());
        let (_, [bce, mse, dice, total]) = vae.losses(&codes, &cond, k);
        rows.push(Tensor::stack(&[&total, &bce, &mse, &dice], 0).detach());
        if step + 1 < prefixes.len() {
            let grads = Tensor::run_backward(&[total], &inputs, false, false);
            assert!(optimizer.step(&vae.params, grads, 1.0).unwrap().taken);
        }
    }
    case.check("out.losses", &Tensor::stack(&rows, 0));
    for id in vae.params.ids() {
        case.check_if_there(&format!("out.{}", vae.params.name(id)), &w[id]);
    }
}

fn muon(case: &Golden) {
    if case.has("out.ns_zero") {
        case.check("out.ns_zero", &newton_schulz(&case.get("out.ns_zero").zeros_like()));
    }
    for name in case.names("in.w0.").map(String::from).collect::<Vec<_>>() {
        let grads = case.get(&format!("in.grads.{name}")).unbind(0);
        case.check_if_there(&format!("out.ns_once.{name}"), &newton_schulz(&grads[0]));
        let ending = format!(".{name}");
        let runs: Vec<&str> = case.names("out.w_").filter_map(|run| run.strip_suffix(&ending)).collect();
        for run in runs {
            // Plain is neither ahead by a step nor decayed.
            let plain = run.ends_with("_plain");
            let config = OptimConfig {
                muon_lr: case.number("lr"),
                muon_momentum: case.number("momentum"),
                muon_scale: muon_scale(run),
                muon_nesterov: !plain,
                weight_decay: if plain { 0.0 } else { case.number("weight_decay") },
                clip: 0.0,
                ..OptimConfig::default()
            };
            alone(case, (run, &name), &grads, config);
        }
    }
    if case.has("out.hybrid_losses") {
        hybrid(case);
    }
}

/// One matrix that Muon alone moves, step by step.
fn alone(case: &Golden, (run, name): (&str, &str), grads: &[Tensor], config: OptimConfig) {
    let mut b = Builder::default();
    let w0 = case.get(&format!("in.w0.{name}"));
    let id = b.root().add(name, Role::Attention, &w0.size(), Init::Constant(0.0));
    let params = b.finish(0, Kind::Double, Device::Cpu).unwrap();
    params.load(&BTreeMap::from([(name.to_owned(), w0.copy())])).unwrap();
    let mut optimizer = Optimizer::new(&params, config.clone());
    let (mut after, mut moved) = (Vec::new(), Vec::new());
    for g in grads {
        let before = params.weights()[id].detach().copy();
        optimizer.step(&params, vec![g.copy()], 1.0).unwrap();
        let now = params.weights()[id].detach().copy();
        moved.push(before * (1.0 - config.muon_lr * config.weight_decay) - &now);
        after.push(now);
    }
    case.check(&format!("out.w_{run}.{name}"), &Tensor::stack(&after, 0));
    if run == "keller" {
        case.check_if_there(&format!("out.buffer.{name}"), &optimizer.state(&params)[&format!("muon.{name}")]);
        // Before it is scaled by the shape (Keller Jordan's rule).
        let shape = w0.size();
        let scale = (shape[0] as f64 / shape[1] as f64).max(1.0).sqrt();
        case.check_if_there(&format!("out.update.{name}"), &(Tensor::stack(&moved, 0) / (config.muon_lr * scale)));
    }
}

/// Muon and AdamW side by side on the case's tiny model.
fn hybrid(case: &Golden) {
    let list = |key: &str| -> Vec<String> {
        case.config(key).as_array().unwrap().iter().map(|v| v.as_str().unwrap().to_string()).collect()
    };
    let mut b = Builder::default();
    let start = case.below("w.");
    let muon = list("hybrid.muon");
    for (name, t) in &start {
        let role = if muon.contains(name) { Role::Attention } else { Role::Projection };
        b.root().add(name, role, &t.size(), Init::Constant(0.0));
    }
    let params = b.finish(0, Kind::Double, Device::Cpu).unwrap();
    params.load(&start).unwrap();
    let lr = case.number("hybrid.lr");
    let beta = |k: usize| case.config("hybrid.betas")[k].as_f64().unwrap();
    let config = OptimConfig {
        muon_lr: lr,
        muon_momentum: case.number("hybrid.muon_momentum"),
        muon_scale: muon_scale(case.config("hybrid.scale").as_str().unwrap()),
        adamw_lr: lr,
        adamw_betas: [beta(0), beta(1)],
        adamw_eps: case.number("hybrid.eps"),
        weight_decay: case.number("hybrid.wd"),
        clip: 0.0,
        ..OptimConfig::default()
    };
    let mut optimizer = Optimizer::new(&params, config);
    let w = |name: &str| {
        let id: ParamId = params.ids().find(|&id| params.name(id) == name).unwrap();
        params.weights()[id].shallow_clone()
    };
    let inputs: Vec<&Tensor> = params.weights().tensors().iter().collect();
    let mut losses = Vec::new();
    for step in 0..case.get("out.hybrid_losses").size()[0] {
        let tokens = case.get("in.tokens");
        let width = w("embed").size()[1];
        let size = [tokens.size(), vec![width]].concat();
        let x = w("embed").index_select(0, &tokens.view([-1])).view(&size[..]);
        let h = &x * (x.square().mean_dim([-1i64].as_slice(), true, None::<Kind>) + 1e-6).rsqrt() * w("norm.w");
        let scores = h.matmul(&w("attn.q")).matmul(&h.transpose(-2, -1)) / (width as f64).sqrt();
        let s = scores.softmax(-1, None::<Kind>).matmul(&h).matmul(&w("attn.o"));
        let m = s.matmul(&w("mlp.w").transpose(0, 1)).tanh().matmul(&w("mlp.w"));
        let loss = (x + s + m - case.get("in.target")).square().mean(None::<Kind>);
        losses.push(loss.detach());
        let grads = Tensor::run_backward(&[loss], &inputs, false, false);
        if step == 0 {
            for id in params.ids() {
                case.check_if_there(&format!("grad.hybrid.{}", params.name(id)), &grads[id.index()]);
            }
        }
        optimizer.step(&params, grads, 1.0).unwrap();
    }
    case.check("out.hybrid_losses", &Tensor::stack(&losses, 0));
    for id in params.ids() {
        case.check_if_there(&format!("out.hybrid.{}", params.name(id)), &params.weights()[id]);
    }
}

fn loaded(b: Builder, case: &Golden, kind: Kind) -> Params {
    let params = b.finish(0, kind, Device::Cpu).unwrap();
    params.load(&case.below("w.")).unwrap_or_else(|e| panic!("{}: {e}", case.name));
    params
}

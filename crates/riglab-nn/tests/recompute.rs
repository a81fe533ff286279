//! Networks whose blocks are computed again in the backward pass give the same losses and gradients, bit for bit;
//! scores that are computed in runs give the same within rounding.

use std::sync::{Mutex, PoisonError};

use riglab_nn::decoder::{OptConfig, QwenConfig};
use riglab_nn::embed::{EmbedConfig, EmbedKind};
use riglab_nn::fsq_cvae::{FsqCvae, FsqCvaeConfig, SkinCloud};
use riglab_nn::params::{Builder, Params, Weights};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::skeleton::{SkeletonModel, SkeletonModelConfig, cross_entropy};
use riglab_nn::tokenrig::{Choices, Head, Layout, NextTokens, Sequences, TokenRig, TokenRigConfig};
use tch::{Device, Kind, Tensor};

/// libtorch's generator is the process's.
static ONE_BY_ONE: Mutex<()> = Mutex::new(());

const FLOAT: (Kind, Device) = (Kind::Float, Device::Cpu);

fn shape() -> PerceiverConfig {
    PerceiverConfig { tokens: 8, width: 32, heads: 2, layers: 2, frequencies: 2, ..PerceiverConfig::default() }
}

/// Loss and gradients under these weights.
fn step(w: &Weights, loss: impl Fn(&Weights) -> Tensor) -> (f64, Vec<Tensor>) {
    tch::manual_seed(9);
    let loss = loss(w);
    let leaves: Vec<&Tensor> = w.tensors().iter().collect();
    (loss.double_value(&[]), Tensor::run_backward(&[loss], &leaves, false, false))
}

/// In both precisions.
fn same(params: &Params, loss: impl Fn(&Weights) -> Tensor) {
    for kind in [Kind::Float, Kind::BFloat16] {
        let w = params.weights().cast(kind);
        let (plain, grads) = step(&w, &loss);
        let (again, other) = step(&w.recomputing(true), &loss);
        assert!(plain.is_finite() && plain == again, "{kind:?}: {plain} and {again}");
        for (id, (a, b)) in params.ids().zip(grads.iter().zip(&other)) {
            let name = params.name(id);
            assert_eq!(a.defined(), b.defined(), "{kind:?}: {name}");
            assert!(!a.defined() || a.equal(b), "{kind:?}: the gradient of {name} differs");
        }
    }
}

fn cloud(rows: i64, points: i64) -> (Tensor, Tensor) {
    tch::manual_seed(1);
    let picks =
        Tensor::stack(&(0..rows).map(|_| Tensor::arange(8, (Kind::Int64, Device::Cpu)) * 3).collect::<Vec<_>>(), 0);
    (Tensor::rand([rows, points, 6], FLOAT) * 2.0 - 1.0, picks)
}

#[test]
fn skeleton_model_with_dropout() {
    let _alone = ONE_BY_ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let decoder = OptConfig { width: 32, layers: 3, heads: 2, ffn: 64, positions: 64, ..OptConfig::default() };
    assert!(decoder.dropout > 0.0);
    let mut builder = Builder::default();
    let net = SkeletonModel::new(builder.root(), &SkeletonModelConfig { shape: shape(), decoder }, 50);
    let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
    let (cloud, picks) = cloud(2, 40);
    let ids = Tensor::randint(50, [17], (Kind::Int64, Device::Cpu));
    let targets = Tensor::randint(50, [15], (Kind::Int64, Device::Cpu));
    same(&params, |w| {
        let prefix = net.condition(w, &cloud, &picks);
        cross_entropy(&net.logits(w, &prefix, &ids, &[10, 7], true), &targets)
    });
}

#[test]
fn skin_auto_encoder() {
    let _alone = ONE_BY_ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let config = FsqCvaeConfig {
        embed: EmbedConfig { kind: EmbedKind::Fourier, frequencies: 2, base: 1.0 },
        encoder_width: 32,
        decoder_width: 32,
        heads: 2,
        encoder_layers: 2,
        decoder_layers: 2,
        latent: 8,
        levels: vec![4, 3],
        shape_tokens: 8,
        skin_tokens: 4,
        ..FsqCvaeConfig::default()
    };
    let mut builder = Builder::default();
    let net = FsqCvae::new(builder.root(), &config).unwrap();
    let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
    let (cloud, picks) = cloud(2, 40);
    let skin = SkinCloud {
        points: Tensor::rand([6, 20, 6], FLOAT),
        weights: Tensor::rand([6, 20], FLOAT),
        queries: Some(Tensor::arange(4, (Kind::Int64, Device::Cpu)).repeat([6, 1])),
        regions: None,
        off: None,
    };
    let asked = Tensor::rand([2, 30, 6], FLOAT);
    same(&params, |w| {
        let shape = net.encode_shape(w, &cloud, &picks);
        let codes = net.quantize(w, &net.encode_skin(w, &skin, 4), &skin);
        net.decode(w, &codes, &shape, &asked, None).square().mean(Kind::Float)
    });
}

/// A model of 267 ids and 64 codes, its parameters, a batch of two sequences.
struct Rigs {
    net: TokenRig,
    params: Params,
    cloud: (Tensor, Tensor),
    ids: Tensor,
}

const LENGTHS: [i64; 2] = [14, 9];

fn rigs(head: Head, scored_at_once: usize) -> Rigs {
    let decoder = QwenConfig {
        width: 32,
        layers: 3,
        heads: 4,
        kv_heads: 2,
        head_width: 8,
        ffn: 64,
        positions: 64,
        ..QwenConfig::default()
    };
    let layout = Layout::new(267, &[4, 4, 4], head);
    let config = TokenRigConfig { shape: shape(), decoder, head, scored_at_once, ..TokenRigConfig::default() };
    let mut builder = Builder::default();
    let net = TokenRig::new(builder.root(), &config, &layout, 4);
    let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
    let cloud = cloud(2, 40);
    // Each a skeleton, codes and the end.
    let one = |n: i64| {
        let skeleton = Tensor::randint(256, [n - 5], (Kind::Int64, Device::Cpu));
        let codes = Tensor::randint(64, [4], (Kind::Int64, Device::Cpu)) + layout.skeleton();
        Tensor::cat(&[skeleton, codes, Tensor::from_slice(&[layout.end()])], 0)
    };
    let ids = Tensor::cat(&LENGTHS.map(one), 0);
    Rigs { net, params, cloud, ids }
}

impl Rigs {
    /// Vectors before what is asked, and the ids that follow.
    fn asked(&self, w: &Weights) -> (Tensor, Tensor) {
        let prefix = self.net.condition(w, &self.cloud.0, &self.cloud.1);
        let sequences = Sequences { ids: &self.ids, lengths: &LENGTHS, told: None };
        let each = self.ids.split_with_sizes(LENGTHS, 0);
        let targets: Vec<Tensor> = each.iter().zip(LENGTHS).map(|(ids, n)| ids.narrow(0, 1, n - 1)).collect();
        (self.net.forward(w, &prefix, &sequences, true), Tensor::cat(&targets, 0))
    }

    fn loss(&self, w: &Weights) -> Tensor {
        let (hidden, targets) = self.asked(w);
        let parts = self.net.losses(w, &NextTokens { hidden: &hidden, targets: &targets, bins: 256, spread: 0.8 });
        let [skeleton, skin] = parts.means();
        skeleton + skin
    }

    /// Log-probabilities and entropies, with a grammar that allows everything and without one.
    fn likelihood(&self, w: &Weights, grammar: bool) -> [Tensor; 2] {
        let (hidden, targets) = self.asked(w);
        let count = |mask: Tensor| mask.sum(Kind::Int64).int64_value(&[]);
        let skeleton = count(targets.lt(267));
        let (skeleton, empty) =
            (Tensor::ones([skeleton, 267], (Kind::Bool, Device::Cpu)), Tensor::zeros([8], (Kind::Bool, Device::Cpu)));
        let choices = grammar.then_some(Choices { skeleton: &skeleton, empty: &empty });
        let asked = NextTokens { hidden: &hidden, targets: &targets, bins: 256, spread: 0.0 };
        let found = self.net.likelihood(w, &asked, choices.as_ref(), 0.7);
        [found.log, found.entropy]
    }
}

#[test]
fn tokenrig_with_both_heads() {
    let _alone = ONE_BY_ONE.lock().unwrap_or_else(PoisonError::into_inner);
    for (head, at_once) in [(Head::Flat, 0), (Head::Flat, 5), (Head::Levels, 0)] {
        let rigs = rigs(head, at_once);
        same(&rigs.params, |w| rigs.loss(w));
    }
}

#[test]
fn scores_in_runs_are_those_of_all_at_once() {
    let _alone = ONE_BY_ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let (whole, runs) = (rigs(Head::Flat, 0), rigs(Head::Flat, 3));
    let close = |a: &Tensor, b: &Tensor| {
        let size = a.abs().max().double_value(&[]).max(1e-3);
        (a - b).abs().max().double_value(&[]) < 1e-5 * size
    };
    let ((a, ga), (b, gb)) =
        (step(whole.params.weights(), |w| whole.loss(w)), step(runs.params.weights(), |w| runs.loss(w)));
    assert!((a - b).abs() < 1e-5 * a, "{a} and {b}");
    assert!(ga.iter().zip(&gb).all(|(a, b)| a.defined() == b.defined() && (!a.defined() || close(a, b))));
    for grammar in [false, true] {
        let of = |rigs: &Rigs| {
            let ([_, entropy], (log, grads)) = (
                rigs.likelihood(rigs.params.weights(), grammar),
                step(rigs.params.weights(), |w| rigs.likelihood(w, grammar)[0].sum(Kind::Float)),
            );
            assert!(!entropy.requires_grad());
            (entropy, log, grads)
        };
        let ((a, la, ga), (b, lb, gb)) = (of(&whole), of(&runs));
        assert!(close(&a, &b) && (la - lb).abs() < 1e-5 * la.abs(), "{la} and {lb}");
        assert!(ga.iter().zip(&gb).all(|(a, b)| a.defined() == b.defined() && (!a.defined() || close(a, b))));
    }
}

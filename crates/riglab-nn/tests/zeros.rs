//! Why decoders refuse to begin with weights that are all 0: no gradient ever comes to any of them.

use riglab_nn::decoder::{OptConfig, QwenConfig};
use riglab_nn::params::{Builder, Params};
use riglab_nn::skeleton::{SkeletonModel, SkeletonModelConfig, cross_entropy};
use riglab_nn::tokenrig::{GEOMETRY, Layout, Sequences, TokenRig, TokenRigConfig};
use tch::{Device, Kind, Tensor};

const FLOAT: (Kind, Device) = (Kind::Float, Device::Cpu);
const LENGTHS: [i64; 2] = [9, 5];

/// The largest part of a gradient, of the scores [M, v] of ids as a loss.
fn steepest(params: &Params, prefix: &Tensor, scores: &Tensor) -> f64 {
    let targets = Tensor::randint(scores.size()[1], [scores.size()[0]], (Kind::Int64, Device::Cpu));
    let inputs: Vec<&Tensor> = std::iter::once(prefix).chain(params.weights().tensors()).collect();
    let grads = Tensor::run_backward(&[cross_entropy(scores, &targets)], &inputs, false, false);
    grads.iter().filter(|g| g.defined()).map(|g| g.abs().max().double_value(&[])).fold(0.0, f64::max)
}

#[test]
fn weights_that_begin_with_zero_learn_nothing() {
    tch::manual_seed(1);
    let prefix = Tensor::randn([2, 6, 16], FLOAT).set_requires_grad(true);
    let ids = Tensor::randint(40, [LENGTHS.iter().sum()], (Kind::Int64, Device::Cpu));
    let of_opt = |init_std| {
        let decoder =
            OptConfig { width: 16, layers: 2, heads: 2, ffn: 32, positions: 32, init_std, ..OptConfig::default() };
        let mut builder = Builder::default();
        let net = SkeletonModel::new(builder.root(), &SkeletonModelConfig { decoder, ..Default::default() }, 40);
        let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
        steepest(&params, &prefix, &net.logits(params.weights(), &prefix, &ids, &LENGTHS, false))
    };
    let of_qwen = |init_std| {
        let (width, layers, heads, ffn) = (16, 2, 2, 32);
        let sizes = QwenConfig { width, layers, heads, ffn, kv_heads: 1, head_width: 8, ..QwenConfig::default() };
        let decoder = QwenConfig { positions: 32, init_std, ..sizes };
        // What tells tokens more begins with 0, too.
        let told = TokenRigConfig { tell_joint: true, tell_place: true, ..TokenRigConfig::default() };
        let (config, layout) = (TokenRigConfig { decoder, ..told }, Layout::new(20, &[4, 4], Default::default()));
        let mut builder = Builder::default();
        let net = TokenRig::new(builder.root(), &config, &layout.clone().with_bins(8), 2);
        let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
        let told = Tensor::rand([ids.size()[0], config.told(&layout, 2) as i64], FLOAT);
        let _ = told.select(1, GEOMETRY as i64).fill_(1.0);
        let sequences = Sequences { ids: &ids.remainder(30), lengths: &LENGTHS, told: Some(&told) };
        let hidden = net.forward(params.weights(), &prefix, &sequences, false);
        steepest(&params, &prefix, &net.logits(params.weights(), &hidden))
    };
    assert_eq!([of_opt(0.0), of_qwen(0.0)], [0.0; 2]);
    assert!(of_opt(1e-6) > 1e-6 && of_qwen(1e-6) > 1e-6, "{} {}", of_opt(1e-6), of_qwen(1e-6));
}

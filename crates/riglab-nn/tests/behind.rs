//! A prefix that several sequences have in common is read once, and gives what each gets that reads it by itself.

use riglab_nn::decoder::{OptConfig, QwenConfig};
use riglab_nn::params::{Builder, Params, Weights};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::skeleton::{SkeletonModel, SkeletonModelConfig};
use riglab_nn::tokenrig::{Head, Layout, Sequences, TOLD, TokenRig, TokenRigConfig};
use tch::{Device, Kind, Tensor};

const DOUBLE: (Kind, Device) = (Kind::Double, Device::Cpu);
const LENGTHS: [i64; 4] = [9, 5, 2, 12];
/// The prefix of each.
const OF: [usize; 4] = [1, 0, 1, 1];

/// The value of a scalar, and its gradients.
fn step(params: &Params, prefix: &Tensor, of: impl Fn(&Weights, &Tensor) -> Tensor) -> Vec<Tensor> {
    let w = params.weights();
    let prefix = prefix.detach().set_requires_grad(true);
    let out = of(w, &prefix);
    let weigh = Tensor::arange(out.numel() as i64, DOUBLE).sin().view(out.size().as_slice());
    let mut inputs = vec![&prefix];
    inputs.extend(w.tensors());
    let loss = (&out * weigh).sum(Kind::Double);
    let grads = Tensor::run_backward(&[loss], &inputs, false, false);
    std::iter::once(out.detach()).chain(grads).collect()
}

fn same(a: &[Tensor], b: &[Tensor]) {
    assert!(a[1].abs().max().double_value(&[]) > 0.0, "the prefix matters");
    for (a, b) in a.iter().zip(b).filter(|(a, _)| a.defined()) {
        let size = a.abs().max().double_value(&[]).max(1e-6);
        assert!((a - b).abs().max().double_value(&[]) < 1e-9 * size);
    }
    assert!(a.iter().zip(b).all(|(a, b)| a.defined() == b.defined()));
}

/// The prefix that each reads by itself.
fn each(prefix: &Tensor) -> Tensor {
    prefix.index_select(0, &Tensor::from_slice(&OF.map(|k| k as i64)))
}

#[test]
fn of_tokenrig() {
    tch::manual_seed(1);
    let sizes = (32, 2, 4, 2);
    let decoder = QwenConfig {
        width: sizes.0,
        layers: sizes.1,
        heads: sizes.2,
        kv_heads: sizes.3,
        head_width: 8,
        ffn: 64,
        positions: 64,
        ..QwenConfig::default()
    };
    let config = TokenRigConfig { decoder, head: Head::Levels, ..TokenRigConfig::default() };
    let mut builder = Builder::default();
    let net = TokenRig::new(builder.root(), &config, &Layout::new(267, &[4, 4, 4], Head::Levels), 4);
    let params = builder.finish(1, Kind::Double, Device::Cpu).unwrap();
    let (prefix, total) = (Tensor::randn([2, 6, 32], DOUBLE), LENGTHS.iter().sum());
    let ids = Tensor::randint(331, [total], (Kind::Int64, Device::Cpu));
    let told = Tensor::rand([total, TOLD as i64], DOUBLE).floor();
    let sequences = Sequences { ids: &ids, lengths: &LENGTHS, told: Some(&told) };
    let apart = step(&params, &prefix, |w, prefix| net.forward(w, &each(prefix), &sequences, false));
    let once = step(&params, &prefix, |w, prefix| net.forward_behind(w, prefix, &OF, &sequences));
    same(&apart, &once);
}

#[test]
fn of_the_skeleton_model() {
    tch::manual_seed(1);
    let decoder = OptConfig { width: 32, layers: 2, heads: 4, ffn: 64, positions: 64, ..OptConfig::default() };
    let config = SkeletonModelConfig { shape: PerceiverConfig::default(), decoder };
    let mut builder = Builder::default();
    let net = SkeletonModel::new(builder.root(), &config, 50);
    let params = builder.finish(1, Kind::Double, Device::Cpu).unwrap();
    let prefix = Tensor::randn([2, 6, 32], DOUBLE);
    let ids = Tensor::randint(50, [LENGTHS.iter().sum()], (Kind::Int64, Device::Cpu));
    let apart = step(&params, &prefix, |w, prefix| net.logits(w, &each(prefix), &ids, &LENGTHS, false));
    let once = step(&params, &prefix, |w, prefix| net.logits_behind(w, prefix, &OF, &ids, &LENGTHS));
    same(&apart, &once);
}

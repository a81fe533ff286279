//! A prefix that several sequences have in common is read once, and gives what each gets that reads it by itself.

use riglab_nn::decoder::{OptConfig, QwenConfig};
use riglab_nn::generate::Decoder;
use riglab_nn::params::{Builder, Params, Weights};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::skeleton::{SkeletonModel, SkeletonModelConfig};
use riglab_nn::tokenrig::{GEOMETRY, Head, Layout, Reader, Sequences, TokenRig, TokenRigConfig};
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
    let extensions = TokenRigConfig { tell_joint: true, tell_region: true, ..TokenRigConfig::default() };
    let config = TokenRigConfig { decoder, head: Head::Levels, tell_rule: true, tell_place: true, ..extensions };
    let mut builder = Builder::default();
    let layout = Layout::new(267, &[4, 4, 4], Head::Levels).with_bins(256);
    let net = TokenRig::new(builder.root(), &config, &layout, 4);
    let params = builder.finish(1, Kind::Double, Device::Cpu).unwrap();
    let (prefix, total) = (Tensor::randn([2, 6, 32], DOUBLE), LENGTHS.iter().sum());
    let ids = Tensor::randint(331, [total], (Kind::Int64, Device::Cpu));
    let told = Tensor::rand([total, config.told(&layout, 4) as i64], DOUBLE);
    told.select(1, GEOMETRY as i64).copy_(&Tensor::randint(5, [total], DOUBLE));
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

#[test]
fn places_are_told_in_drawing_as_in_training() {
    tch::manual_seed(1);
    let decoder = QwenConfig {
        width: 32,
        layers: 2,
        heads: 4,
        kv_heads: 2,
        head_width: 8,
        ffn: 64,
        positions: 64,
        ..QwenConfig::default()
    };
    let [plain, told] = [false, true].map(|tell_place| {
        let config = TokenRigConfig { decoder: decoder.clone(), tell_place, ..TokenRigConfig::default() };
        let layout = Layout::new(20, &[4, 3], Head::Flat).with_bins(8);
        let mut builder = Builder::default();
        let net = TokenRig::new(builder.root(), &config, &layout, 2);
        let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
        let (prefix, w) = (Tensor::ones([1, 6, 32], (Kind::Float, Device::Cpu)), params.weights());
        // A begin, two joints, a branch that names the first, and two numbers of the next.
        let all = [9u32, 0, 1, 2, 3, 4, 5, 10, 0, 1, 2, 7, 7];
        let after = |first: usize| {
            let no_joints = |_: usize, _: &[u32]| Vec::new();
            let (mut reader, mut scores) =
                Reader::start(&net, w, &prefix, &[all[..first].to_vec()], (16, 11), &no_joints).unwrap();
            for &id in &all[first..] {
                scores = reader.next(&[id]);
            }
            scores.pop().unwrap()
        };
        let ids = Tensor::from_slice(&all.map(i64::from));
        // What follows the last of them is not asked in training: one more.
        let ids = Tensor::cat(&[ids, Tensor::from_slice(&[0i64])], 0);
        let sequences = Sequences { ids: &ids, lengths: &[ids.size()[0]], told: None };
        let hidden = net.forward(w, &prefix, &sequences, false);
        let trained: Vec<f32> =
            net.logits(w, &hidden.narrow(0, all.len() as i64 - 1, 1)).view([-1]).try_into().unwrap();
        for first in [1, 5, 9, all.len()] {
            for (drawn, trained) in after(first).iter().zip(&trained) {
                assert!((drawn - trained).abs() < 1e-4, "{first}: {drawn} {trained}");
            }
        }
        trained
    });
    assert!(plain.iter().zip(&told).any(|(a, b)| (a - b).abs() > 1e-3), "places are told");
}

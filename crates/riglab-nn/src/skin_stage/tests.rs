use tch::{Device, Kind, Tensor};

use super::loss::{attributes, divergence, lbs, log_shares, over_bones, released};
use super::ptv3::{Layout, Places, Ptv3Config};
use super::*;
use crate::params::{Builder, Params};
use crate::perceiver::PerceiverConfig;

fn config(encoder: PointEncoder) -> SkinModelConfig {
    let shape =
        PerceiverConfig { tokens: 3, width: 8, heads: 2, layers: 1, frequencies: 2, ..PerceiverConfig::default() };
    let bones = BoneConfig { embed: 4, layers: 1, frequencies: 2, ..BoneConfig::default() };
    let ptv3 = Ptv3Config {
        grid: 0.3,
        depths: vec![1, 2],
        channels: vec![4, 8],
        heads: vec![1, 2],
        patch: 4,
        ..Ptv3Config::default()
    };
    let points = PointConfig { encoder, frequencies: 2, ptv3, layers: 2 };
    let base = SkinModelConfig { width: 8, heads: 2, mlp: 6, mlp_layers: 2, pair: 2, ..SkinModelConfig::default() };
    // The extension with one of the two.
    let pair_width = if encoder == PointEncoder::Light { 3 } else { 0 };
    SkinModelConfig { shape, bones, points, pair_width, ..base }
}

fn built(c: &SkinModelConfig, kind: Kind) -> (SkinModel, Params) {
    c.validate().unwrap();
    let mut builder = Builder::default();
    let net = SkinModel::new(builder.root(), c);
    (net, builder.finish(3, kind, Device::Cpu).unwrap())
}

/// A rig of 7 points and 4 bones with random numbers, and what is asked of it.
struct Case {
    cloud: Tensor,
    bones: Tensor,
    pairs: Tensor,
    truth: Tensor,
    frozen: Tensor,
    springs: Tensor,
    maps: Tensor,
    layout: Layout,
}

fn case() -> Case {
    tch::manual_seed(5);
    let double = (Kind::Double, Device::Cpu);
    let cloud = Tensor::rand([1, 7, 6], double) * 2.0 - 1.0;
    let truth = (Tensor::randn([7, 4], double) * 2.0).softmax(-1, None::<Kind>);
    // Bone 2 holds nothing of point 0.
    let _ = truth.get(0).get(2).fill_(0.0);
    let truth = &truth / truth.sum_dim_intlist(-1, true, None::<Kind>);
    let points: Vec<f32> =
        Vec::<f32>::try_from(cloud.get(0).narrow(1, 0, 3).to_kind(Kind::Float).flatten(0, 1)).unwrap();
    Case {
        layout: Layout::new(points.as_chunks::<3>().0, &[7], 0.3),
        bones: Tensor::rand([1, 4, 6], double) - 0.5,
        pairs: Tensor::rand([1, 7, 4, 2], double),
        frozen: Tensor::from_slice(&[false, true, false, false]),
        springs: Tensor::rand([4, 7], double),
        maps: Tensor::randn([4, 3, 4], double),
        cloud,
        truth,
    }
}

/// All losses of a case at once.
fn loss(net: &SkinModel, c: &SkinModelConfig, w: &Weights, case: &Case) -> Tensor {
    let picks = Tensor::from_slice(&[0i64, 3, 5]).view([1, 3]);
    let places = Places::new(&case.layout, &c.points.ptv3, [2, 0, 1, 3], Device::Cpu);
    let read = net.read(w, &case.cloud, &picks, &case.bones);
    let points = net.points(w, &read, &net.encode(w, &case.cloud, Some(&places)));
    let logits = net.logits(w, &read, &points, &case.pairs).get(0);
    let logs = log_shares(&logits, &case.truth, Some(&case.frozen));
    let skin = over_bones(&divergence(&logs, &case.truth), &case.truth, Some(&case.frozen.logical_not()));
    let old = released(&logits.softmax(-1, None::<Kind>), &case.truth, &case.maps, &case.cloud.get(0).narrow(1, 0, 3));
    let predicted = net.attributes(w, &read, &points).unwrap().get(0);
    let has = Tensor::from_slice(&[true, true, false, true]);
    let springs = attributes(&predicted, &case.springs, &has, &Tensor::from_slice(&[1.0f64; 7]));
    skin + springs + old.vertex + old.normalization + old.l1 + old.bce + old.zero_l1 + old.non_zero_l1
}

/// Gradients by parameters and inputs along a random direction, against central differences in double precision.
#[test]
fn blocks_computed_again_give_the_same_gradients() {
    for encoder in [PointEncoder::Light, PointEncoder::Ptv3] {
        let c = config(encoder);
        let ((net, params), case) = (built(&c, Kind::Double), case());
        let of = |w: &Weights| {
            let leaves: Vec<&Tensor> = w.tensors().iter().collect();
            Tensor::run_backward(&[loss(&net, &c, w, &case)], &leaves, false, false)
        };
        let (plain, again) = (of(params.weights()), of(&params.weights().recomputing(true)));
        assert!(plain.iter().zip(&again).all(|(a, b)| a.defined() == b.defined() && (!a.defined() || a.equal(b))));
    }
}

#[test]
fn gradients_match_finite_differences() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for encoder in [PointEncoder::Light, PointEncoder::Ptv3] {
        let c = config(encoder);
        let (net, params) = built(&c, Kind::Double);
        let w = params.weights();
        let case = case();
        let inputs = [&case.cloud, &case.bones, &case.pairs].map(|t| t.set_requires_grad(true));
        let named: Vec<(String, Tensor)> = params
            .named(w)
            .map(|(n, t)| (n.to_string(), t.shallow_clone()))
            .chain(["cloud", "bones", "pairs"].iter().map(|n| n.to_string()).zip(inputs))
            .collect();
        let all: Vec<&Tensor> = named.iter().map(|(_, t)| t).collect();
        let grads = Tensor::run_backward(&[loss(&net, &c, w, &case)], &all, false, false);
        tch::manual_seed(7);
        for ((name, t), grad) in named.iter().zip(grads) {
            let _guard = tch::no_grad_guard();
            let direction = t.randn_like();
            let along = (&grad * &direction).sum(None::<Kind>).double_value(&[]);
            let step = 1e-5;
            let at = |by: f64| {
                let _ = t.shallow_clone().g_add_(&(&direction * by));
                let value = loss(&net, &c, w, &case).double_value(&[]);
                let _ = t.shallow_clone().g_add_(&(&direction * -by));
                value
            };
            let slope = (8.0 * (at(step) - at(-step)) - (at(2.0 * step) - at(-2.0 * step))) / (12.0 * step);
            // Below, rounding of the loss itself is what is seen.
            let off = (slope - along).abs() / along.abs().max(1e-3);
            assert!(off <= 1e-6, "{encoder:?} {name}: {slope} by differences, {along}: {off:.1e}");
        }
    }
}

#[test]
fn frozen_bones_keep_their_weights_and_have_no_gradient() {
    let case = case();
    tch::manual_seed(1);
    let logits = Tensor::randn([7, 4], (Kind::Double, Device::Cpu)).set_requires_grad(true);
    let shares = log_shares(&logits, &case.truth, Some(&case.frozen)).exp();
    let off = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]);
    assert!(off(&shares.select(1, 1), &case.truth.select(1, 1)) < 1e-12);
    assert!(
        off(&shares.sum_dim_intlist(-1, false, None::<Kind>), &Tensor::ones([7], (Kind::Double, Device::Cpu))) < 1e-9
    );
    let each = divergence(&shares.log(), &case.truth);
    assert!(each.min().double_value(&[]) > -1e-9, "a divergence is no less than 0");
    let grads = Tensor::run_backward(&[each.sum(None::<Kind>)], &[&logits], false, false);
    assert_eq!(grads[0].select(1, 1).abs().max().double_value(&[]), 0.0);
    assert!(grads[0].select(1, 0).abs().max().double_value(&[]) > 0.0);
    assert_eq!(off(&log_shares(&logits, &case.truth, None), &logits.log_softmax(-1, None::<Kind>)), 0.0);
}

#[test]
fn the_divergence_is_least_at_the_true_weights() {
    let truth = Tensor::from_slice(&[0.5, 0.5, 0.0, 1.0, 0.0, 0.0]).view([2, 3]);
    let own = divergence(&truth.clamp_min(1e-12).log(), &truth);
    assert!(own.abs().max().double_value(&[]) < 1e-9);
    let even = Tensor::full([2, 3], (1.0f64 / 3.0).ln(), (Kind::Double, Device::Cpu));
    let found = divergence(&even, &truth);
    assert!((found.double_value(&[0]) - (1.5f64).ln()).abs() < 1e-12);
    assert!((found.double_value(&[1]) - 3f64.ln()).abs() < 1e-12);
}

#[test]
fn every_bone_counts_alike() {
    // Bone 0 holds points 0 to 2, bone 1 point 2, bone 2 none.
    let truth = Tensor::from_slice(&[1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5, 0.5, 0.0]).view([3, 3]);
    let each = Tensor::from_slice(&[1.0, 2.0, 6.0]);
    assert!((over_bones(&each, &truth, None).double_value(&[]) - (3.0 + 6.0) / 2.0).abs() < 1e-12);
    let second = Tensor::from_slice(&[false, true, true]);
    assert!((over_bones(&each, &truth, Some(&second)).double_value(&[]) - 6.0).abs() < 1e-12);
    let none = Tensor::from_slice(&[false, false, true]);
    assert_eq!(over_bones(&each, &truth, Some(&none)).double_value(&[]), 0.0);
}

#[test]
fn maps_that_move_nothing_move_nothing() {
    let rest = Tensor::from_slice(&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]).view([1, 3, 4]);
    let p = Tensor::randn([5, 3], (Kind::Double, Device::Cpu));
    let weights = Tensor::full([5, 2], 0.5, (Kind::Double, Device::Cpu));
    let moved = lbs(&weights, &rest.expand([2, -1, -1], false), &p);
    assert!((moved - &p).abs().max().double_value(&[]) < 1e-7);
}

/// Whatever they are told in, attributes come out in their own units.
#[test]
fn attributes_are_divided_by_their_scale() {
    let case = case();
    let of = |attribute_scale: [f64; ATTRIBUTES]| {
        let (net, params) = built(&SkinModelConfig { attribute_scale, ..config(PointEncoder::Light) }, Kind::Double);
        let w = params.weights();
        let picks = Tensor::from_slice(&[0i64, 3, 5]).view([1, 3]);
        let read = net.read(w, &case.cloud, &picks, &case.bones);
        net.attributes(w, &read, &net.points(w, &read, &net.encode(w, &case.cloud, None))).unwrap()
    };
    let scale = [2.0, 0.5, 1.0, 4.0, 8.0, 0.25, 16.0];
    assert!((of(scale) * Tensor::from_slice(&scale)).equal(&of([1.0; ATTRIBUTES])));
    for wrong in [0.0, -1.0, f64::NAN] {
        let c = SkinModelConfig { attribute_scale: [wrong; ATTRIBUTES], ..SkinModelConfig::default() };
        assert_eq!(c.validate().unwrap_err().0, "attribute_scale");
    }
}

/// Bones without length, far outside or all in one place; points all in one place: weights are finite and sum to 1,
/// and the same every time, whatever the share of memory.
#[test]
fn anything_gets_weights() {
    for encoder in [PointEncoder::Light, PointEncoder::Ptv3] {
        let c = config(encoder);
        let (net, params) = built(&c, Kind::Float);
        let w = params.weights();
        let float = (Kind::Float, Device::Cpu);
        for (spread, bones) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1e6), (0.0, 1e6)] {
            tch::manual_seed(2);
            let cloud = Tensor::randn([1, 9, 6], float) * spread;
            let bones = Tensor::randn([1, 5, 6], float) * bones;
            let picks = Tensor::from_slice(&[0i64, 0, 0]).view([1, 3]);
            let points: Vec<f32> =
                Vec::<f32>::try_from(cloud.get(0).narrow(1, 0, 3).contiguous().flatten(0, 1)).unwrap();
            let layout = Layout::new(points.as_chunks::<3>().0, &[9], 0.01);
            let places = Places::new(&layout, &c.points.ptv3, [0, 1, 2, 3], Device::Cpu);
            let found = |at_once| {
                let read = net.read(w, &cloud, &picks, &bones);
                let points = net.points(w, &read, &net.encode(w, &cloud, Some(&places)));
                let pairs = |_, n| Tensor::full([n, 5, 2], 1e9, float);
                net.predict(w, &read, &points.get(0), pairs, None, at_once)
            };
            let all = found(1 << 20);
            let sums = all.sum_dim_intlist(-1, false, None::<Kind>);
            assert!((sums - 1.0).abs().max().double_value(&[]) < 1e-5, "{encoder:?} {spread}");
            assert!(found(1 << 20).equal(&all), "the same on every run");
            assert!((found(10) - all).abs().max().double_value(&[]) < 1e-5);
        }
    }
}

#[test]
fn an_order_that_nothing_reads_is_refused() {
    let mut c = config(PointEncoder::Light);
    c.shape.sorted = true;
    assert_eq!(c.validate().unwrap_err().0, "shape.sorted");
}

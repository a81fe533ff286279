//! UniRig's released skin model, against values recorded from the public code.

use std::collections::{BTreeMap, BTreeSet};

use riglab_geom::{Nearby, ReskinConfig, farthest_points, reskin};
use riglab_metric::{Rows, SkinConvention, Skins};
use riglab_nn::params::{Builder, Params, Weights};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::skin_stage::loss::{Released, lbs, released};
use riglab_nn::skin_stage::ptv3::{
    Curve, Layout, Norm, Patches, Places, Pool, Pooled, Ptv3, Ptv3Config, Reduce, SubmConv, TapTensors, Taps, Unpool,
};
use riglab_nn::skin_stage::{
    ATTRIBUTE_SCALE, BoneConfig, BoneInput, EncodedRig, PointConfig, PointEncoder, SkinModel, SkinModelConfig, masked,
    shares, with_children,
};
use riglab_tests::{Golden, golden};
use tch::{Device, Kind, Tensor};

#[test]
fn released_skin_stage() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    let kinds = ["skin", "reskin", "curves", "subm_conv", "ptv3", "ptv3_pooling"];
    for (kind, case) in golden("unirig", &kinds) {
        match kind {
            "skin" => skin(&case),
            "reskin" => transfer(&case),
            "curves" => curves(&case),
            "subm_conv" => convolution(&case),
            "ptv3" => backbone(&case),
            _ => pooling(&case),
        }
        case.done();
    }
}

fn ints(t: &Tensor) -> Vec<i64> {
    Vec::<i64>::try_from(t.to_kind(Kind::Int64).flatten(0, -1)).unwrap()
}

fn floats(t: &Tensor) -> Vec<f32> {
    Vec::<f32>::try_from(t.to_kind(Kind::Float).contiguous().flatten(0, -1)).unwrap()
}

fn cells(t: &Tensor) -> Vec<[u32; 3]> {
    ints(t).as_chunks::<3>().0.iter().map(|c| c.map(|x| x as u32)).collect()
}

fn triples(t: &Tensor) -> Vec<[f32; 3]> {
    floats(t).as_chunks::<3>().0.to_vec()
}

fn curve(name: &str) -> Curve {
    match name {
        "z" => Curve::Z,
        "z-trans" => Curve::ZTrans,
        "hilbert" => Curve::Hilbert,
        "hilbert-trans" => Curve::HilbertTrans,
        _ => panic!("unknown curve {name}"),
    }
}

fn curves(case: &Golden) {
    for name in case.names("out.") {
        let (which, depth) = name.rsplit_once('_').unwrap_or_else(|| panic!("{}: output `{name}`", case.name));
        // A depth, or all cells of a cube, which has no clouds.
        let bits = depth.strip_prefix('d').and_then(|bits| bits.parse().ok());
        let at = if bits.is_some() { format!("in.coord_{depth}") } else { format!("in.{depth}") };
        let coords = cells(&case.get(&at));
        let bits = bits.unwrap_or_else(|| u32::BITS - coords.iter().flatten().max().unwrap().leading_zeros());
        let batch = case.tensors.get(&format!("in.batch_{depth}")).map_or_else(|| vec![0; coords.len()], ints);
        let codes: Vec<i64> = coords.iter().zip(batch).map(|(c, b)| curve(which).code(*c, b as usize, bits)).collect();
        case.check(&format!("out.{name}"), &Tensor::from_slice(&codes));
    }
}

fn loaded(builder: Builder, tensors: &BTreeMap<String, Tensor>) -> Params {
    let params = builder.finish(0, Kind::Float, Device::Cpu).unwrap();
    params.load(tensors).unwrap();
    params
}

/// How many rows each cloud has, of the cloud's number of each row.
fn sizes(batch: &[i64]) -> Vec<usize> {
    batch.chunk_by(|a, b| a == b).map(<[i64]>::len).collect()
}

fn convolution(case: &Golden) {
    let (coord, batch) = (cells(&case.get("in.coord")), ints(&case.get("in.batch")));
    let sizes = sizes(&batch);
    let last = *sizes.last().unwrap() as i64;
    let kernels: BTreeSet<usize> = case.names("w.k").filter_map(|name| name.split_once('.')?.0.parse().ok()).collect();
    for side in kernels {
        let own = case.below(&format!("w.k{side}."));
        let mut builder = Builder::default();
        let bias = own.contains_key("bias");
        let conv = SubmConv::new(builder.root(), case.number("cin") as usize, case.number("cout") as usize, side, bias);
        let params = loaded(builder, &own);
        let feat = case.get("in.feat").set_requires_grad(true);
        let taps = TapTensors::new(&Taps::new(&coord, &sizes, side), Device::Cpu);
        let out = conv.forward(params.weights(), &feat, &taps);
        case.check_if_there(&format!("out.k{side}"), &out);
        // Gradients are of the last cloud alone, which has no cell twice.
        let loss = out.narrow(0, out.size()[0] - last, last).square().sum(None::<Kind>);
        gradients(case, &format!("grad.k{side}."), &params, &loss, &[("feat", &feat)]);
    }
}

fn numbers(case: &Golden, key: &str) -> Vec<usize> {
    case.config(key).as_array().unwrap().iter().map(|n| n.as_u64().unwrap() as usize).collect()
}

fn backbone(case: &Golden) {
    let ends = ints(&case.get("in.offset"));
    let sizes: Vec<usize> =
        ends.iter().scan(0, |last, &end| Some((end - std::mem::replace(last, end)) as usize)).collect();
    let norm = if case.config("layer_norm") == true { Norm::Layer } else { Norm::Batch };
    // The public code cuts a cloud into patches once, of the size that its first stage has; where it does without flash
    // attention, of the smallest cloud's size at most.
    let patch = numbers(case, "enc_patch_size")[0];
    let most = if case.config("enable_flash") == false { *sizes.iter().min().unwrap() } else { patch };
    let config = Ptv3Config {
        grid: case.number("grid_size") as f32,
        depths: numbers(case, "enc_depths"),
        channels: numbers(case, "enc_channels"),
        heads: numbers(case, "enc_num_head"),
        patch: patch.min(most),
        mlp_ratio: case.number("mlp_ratio") as usize,
        qk_norm: case.config("enable_qknorm") == true,
        norm,
        skip: case.config("res_linear") == true,
        shuffle: case.config("shuffle_orders") == true,
    };
    config.validate().unwrap();
    let told = orders(case);
    let turns: Vec<usize> = told.iter().map(|c| Curve::ALL.iter().position(|own| own == c).unwrap()).collect();
    assert!(
        Curve::ALL.len().is_multiple_of(turns.len()),
        "{}: {} orders take no turns of four",
        case.name,
        turns.len()
    );
    let layout = Layout::new(&triples(&case.get("in.coord")), &sizes, config.grid);
    let cells: Vec<i64> = layout.cells.iter().flatten().map(|&c| i64::from(c)).collect();
    case.check_if_there("out.grid_coord", &Tensor::from_slice(&cells).view([-1, 3]));
    let own: Vec<Vec<i64>> = turns.iter().map(|&turn| layout.orders[turn].clone()).collect();
    case.check_if_there("out.order", &stacked(&own));
    let inverse = |order: &Vec<i64>| {
        let mut back = vec![0; order.len()];
        order.iter().enumerate().for_each(|(place, &point)| back[point as usize] = place as i64);
        back
    };
    case.check_if_there("out.inverse", &stacked(&own.iter().map(inverse).collect::<Vec<_>>()));
    let patches = Patches::new(&sizes, config.patch);
    case.check_if_there("out.pad", &Tensor::from_slice(&patches.pad));
    case.check_if_there("out.unpad", &Tensor::from_slice(&patches.unpad));
    let starts = patches.lengths.iter().scan(0, |sum, n| {
        *sum += n;
        Some(*sum)
    });
    let starts: Vec<i64> = std::iter::once(0).chain(starts).collect();
    case.check_if_there("out.cu_seqlens", &Tensor::from_slice(&starts));

    let feat = case.get("in.feat").set_requires_grad(true);
    let mut builder = Builder::default();
    let net = Ptv3::new(builder.root(), &config, feat.size()[1] as usize);
    let params = loaded(builder, &case.below("w."));
    let turns = std::array::from_fn(|k| turns[k % turns.len()]);
    let (w, places) = (params.weights(), Places::new(&layout, &config, turns, Device::Cpu));
    let embedded = net.embed(w, &feat, &places);
    case.check_if_there("out.embedding", &embedded);
    let mut x = embedded;
    for (k, block) in net.blocks(0).iter().enumerate() {
        let placed = block.placed(w, &x, &places);
        case.check_if_there(&format!("out.block{k}_cpe"), &placed);
        case.check_if_there(&format!("out.block{k}_attn"), &block.attended(w, &(&x + &placed), &places));
        x = block.forward(w, &x, &places);
        case.check_if_there(&format!("out.block{k}"), &x);
    }
    let out = net.forward(w, &feat, &places);
    case.check_if_there("out.feat", &out);
    if let Some(pull) = case.tensors.get("in.grad_out") {
        gradients(case, "grad.", &params, &(out * pull).sum(None::<Kind>), &[("feat", &feat)]);
    }
}

/// The curves that a case takes, in turn.
fn orders(case: &Golden) -> Vec<Curve> {
    case.config("order").as_array().unwrap().iter().map(|n| curve(n.as_str().unwrap())).collect()
}

fn stacked(rows: &[Vec<i64>]) -> Tensor {
    Tensor::stack(&rows.iter().map(|r| Tensor::from_slice(r)).collect::<Vec<_>>(), 0)
}

/// Compares the gradients of a loss by all inputs and parameters that the case has, by their names below `at`.
fn gradients(case: &Golden, at: &str, params: &Params, loss: &Tensor, inputs: &[(&str, &Tensor)]) {
    let own = params.ids().map(|id| (params.name(id), &params.weights()[id]));
    let all = inputs.iter().copied().chain(own).map(|(name, t)| (format!("{at}{name}"), t));
    let (names, tensors): (Vec<String>, Vec<&Tensor>) = all.filter(|(name, _)| case.has(name)).unzip();
    if names.is_empty() {
        return;
    }
    for (name, grad) in names.iter().zip(Tensor::run_backward(&[loss], &tensors, false, false)) {
        case.check(name, &grad);
    }
}

fn pooling(case: &Golden) {
    let channels = numbers(case, "channels");
    let ends = ints(&case.get("in.offset"));
    let batch = (0..*ends.last().unwrap()).map(|i| ends.partition_point(|&e| e <= i)).collect();
    let fine = Pooled::finest(cells(&case.get("in.grid_coord")), batch, &orders(case));
    let stride = case.number("stride") as u32;
    assert!(stride.is_power_of_two(), "{}: stride {stride} is no power of two", case.name);
    let coarse = fine.coarser(stride.ilog2());
    case.check_if_there("out.cluster", &Tensor::from_slice(&coarse.cluster));
    case.check_if_there("out.pooled_code", &stacked(&coarse.codes));
    case.check_if_there("out.pooled_order", &stacked(&coarse.orders));
    let batch: Vec<i64> = coarse.batch.iter().map(|&b| b as i64).collect();
    case.check_if_there("out.pooled_batch", &Tensor::from_slice(&batch));
    let cells: Vec<i64> = coarse.cells.iter().flatten().map(|&c| i64::from(c)).collect();
    case.check_if_there("out.pooled_grid_coord", &Tensor::from_slice(&cells).view([-1, 3]));
    case.check_if_there("out.pooled_coord", &Pool::positions(&case.get("in.coord"), &coarse));
    let reduce = match case.config("reduce").as_str() {
        Some("max") | None => Reduce::Max,
        Some("min") => Reduce::Min,
        Some("mean") => Reduce::Mean,
        Some("sum") => Reduce::Sum,
        Some(other) => panic!("{}: points are not joined by `{other}`", case.name),
    };
    let mut builder = Builder::default();
    let pool = Pool::new(builder.root().sub("pool"), channels[0], channels[1], reduce);
    let unpool = Unpool::new(builder.root().sub("unpool"), channels[1], channels[0], channels[2]);
    let params = loaded(builder, &case.below("w."));
    let feat = case.get("in.feat").set_requires_grad(true);
    let pooled = pool.forward(params.weights(), &feat, &coarse);
    case.check_if_there("out.pooled_feat", &pooled);
    let unpooled = unpool.forward(params.weights(), &pooled, &feat, &coarse);
    case.check_if_there("out.unpooled_feat", &unpooled);
    if let Some(pull) = case.tensors.get("in.grad_out") {
        gradients(case, "grad.", &params, &(unpooled * pull).sum(None::<Kind>), &[("feat", &feat)]);
    }
}

fn transfer(case: &Golden) {
    let parents: Vec<Option<usize>> =
        ints(&case.get("in.parents")).into_iter().map(|p| usize::try_from(p).ok()).collect();
    let faces: Vec<[u32; 3]> = cells(&case.get("in.faces"));
    let (points, weights) = (triples(&case.get("in.sampled_vertices")), floats(&case.get("in.sampled_skin")));
    for name in case.names("out.") {
        assert!(case.config(name).is_object(), "{}: the config does not tell of `{name}`", case.name);
        let of = |key: &str| case.config(&format!("{name}.{key}"));
        let number = |key: &str, usual: f64| of(key).as_f64().unwrap_or(usual);
        let config = ReskinConfig {
            nearest: number("nearest_samples", 7.0) as usize,
            nearby: match of("sample_method").as_str() {
                Some("median") => Nearby::Median,
                Some("mean") | None => Nearby::Mean,
                Some(other) => panic!("{}: unknown method `{other}`", case.name),
            },
            falloff: number("alpha", 2.0) as f32,
            steps: number("iter_steps", 1.0) as usize,
            threshold: number("threshold", 0.01) as f32,
        };
        let found = reskin(&points, &weights, &parents, &triples(&case.get("in.vertices")), &faces, &config);
        case.check(&format!("out.{name}"), &Tensor::from_slice(&found).view([-1, parents.len() as i64]));
    }
}

/// The released model of a case, but for the backbone: its output is an input of the case. The light encoder
/// stands in its place without being asked, so its layer is as wide as the backbone's.
fn model(case: &Golden) -> (SkinModel, Params) {
    let of = |key: &str| case.number(key) as usize;
    let says = |key: &str, value: bool| case.config(&format!("global_encoder.{key}")) == value;
    assert!(!says("include_pi", true) && !says("use_ln_post", false), "{}: no such shape encoder", case.name);
    // What no key tells: layers of the last network, frequencies of the joints' places.
    let layers = case.names("w.skinweight_pred.net.").filter_map(|name| name.split_once('.')?.0.parse::<usize>().ok());
    let mlp_layers = layers.max().expect("a network") / 3;
    let frequencies = (case.get("w.bone_encoder.bone_encoder.1.weight").size()[1] as usize - 3) / 6;
    let shape = |key: &str| case.number(&format!("global_encoder.{key}"));
    let shape = PerceiverConfig {
        tokens: shape("token_num") as usize,
        drawn: 4,
        width: shape("width") as usize,
        heads: shape("heads") as usize,
        layers: shape("num_encoder_layers") as usize,
        frequencies: shape("num_freqs") as usize,
        sorted: false,
        qkv_bias: says("qkv_bias", true),
        init_scale: shape("init_scale"),
    };
    let backbone =
        Ptv3Config { depths: vec![1], channels: vec![of("point_channels")], heads: vec![1], ..released_backbone() };
    let config = SkinModelConfig {
        width: of("feat_dim"),
        heads: of("num_heads"),
        mlp: of("mlp_dim"),
        mlp_layers,
        pair: 1,
        pair_width: 0,
        shape,
        bones: BoneConfig {
            seen: BoneInput::Joint,
            from_corner: true,
            frequencies,
            embed: of("bone_embed_dim"),
            layers: of("num_bone_attn"),
        },
        points: PointConfig {
            encoder: PointEncoder::Ptv3,
            frequencies: 6,
            ptv3: backbone,
            layers: of("num_mesh_bone_attn"),
        },
        attributes: false,
        attribute_scale: ATTRIBUTE_SCALE,
        mask_power: case.number("voxel_mask"),
    };
    config.validate().unwrap();
    let mut builder = Builder::default();
    let net = SkinModel::new(builder.root(), &config);
    let params = builder.finish(0, Kind::Float, Device::Cpu).unwrap();
    // The backbone's own weights are no part of the case.
    let mut tensors = case.below("w.");
    for (name, tensor) in params.named(params.weights()).filter(|(name, _)| name.starts_with("mesh_encoder.")) {
        tensors.insert(name.into(), tensor.detach().copy());
    }
    params.load(&tensors).unwrap();
    (net, params)
}

fn released_backbone() -> Ptv3Config {
    SkinModelConfig::released().points.ptv3
}

fn skin(case: &Golden) {
    let (net, params) = model(case);
    let w = params.weights();
    let cloud = Tensor::cat(&[&case.get("in.vertices"), &case.get("in.normals")], -1);
    let clouds = cloud.size()[0];
    let drawn = ints(&case.get("in.rows"));
    let tokens = case.number("global_encoder.token_num") as usize;
    // Of each cloud, the farthest of the rows drawn.
    let found: Vec<usize> = (0..clouds)
        .flat_map(|b| {
            let all = triples(&cloud.get(b).narrow(1, 0, 3));
            let own: Vec<[f32; 3]> = drawn.iter().map(|&r| all[r as usize]).collect();
            farthest_points(&own, tokens, 0)
        })
        .collect();
    // The public code counts them over the rows drawn of all clouds.
    let counted = found.iter().enumerate().map(|(k, i)| (k / tokens * drawn.len() + i) as i64);
    case.check_if_there("out.fps", &Tensor::from_slice(&counted.collect::<Vec<_>>()));
    let picks: Vec<i64> = found.iter().map(|&i| drawn[i]).collect();
    let picks = Tensor::from_slice(&picks).view([clouds, tokens as i64]);
    let joints = case.get("in.joints");
    let read = net.read(w, &cloud, &picks, &joints);
    case.check_if_there("out.global_latents", &read.shape);
    case.check_if_there("out.bone_embed", &read.embedded.flatten(0, 1));
    case.check_if_there("out.bone_feat", &read.bones);
    let encoded = case.get("in.point_feat").view([clouds, cloud.size()[1], -1]);
    case.check_if_there("out.mesh_feat_mapped", &net.map(w, &encoded).flatten(0, 1));
    let points = net.points(w, &read, &encoded);
    case.check_if_there("out.mesh_feat", &points);

    let voxel = case.get("in.voxel_skin");
    let counts = ints(&case.get("in.num_bones"));
    let unmasked = shares(&net.logits(w, &read, &points, &voxel.unsqueeze(-1)), &counts);
    case.check_if_there("out.skin_eval_unmasked", &unmasked);
    evaluated(case, &net, w, &read, &points, &unmasked);

    let rows = case.get("in.train_rows");
    let own = |t: &Tensor| t.index_select(1, &rows);
    let logits = net.logits(w, &read, &net.points(w, &read, &own(&encoded)), &own(&voxel).unsqueeze(-1));
    let trained = shares(&logits, &counts);
    case.check_if_there("out.skin_train", &trained);
    losses(case, &params, &trained, &own(&case.get("in.skin")), &own(&case.get("in.vertices")));
}

/// The losses of weights [b, n, j] where the model is trained, and what is logged beside them.
fn losses(case: &Golden, params: &Params, trained: &Tensor, truth: &Tensor, places: &Tensor) {
    let counts = ints(&case.get("in.num_bones"));
    let clouds = counts.len() as i64;
    let maps = case.get("in.pose_matrix").matmul(&case.get("in.matrix_local").inverse()).narrow(2, 0, 3);
    let moved = |skin: &Tensor| {
        Tensor::stack(&(0..clouds).map(|b| lbs(&skin.get(b), &maps.get(b), &places.get(b))).collect::<Vec<_>>(), 0)
    };
    case.check_if_there("out.vertices_pred", &moved(trained));
    let rows_to_one = truth / (truth.sum_dim_intlist(-1, true, None::<Kind>) + 1e-6);
    case.check_if_there("out.vertices_gt", &moved(&rows_to_one));
    let of_bones = |t: &Tensor, b: i64| t.get(b).narrow(1, 0, counts[b as usize]);
    let each: Vec<Released> = (0..clouds)
        .map(|b| {
            let maps = maps.get(b).narrow(0, 0, counts[b as usize]);
            released(&of_bones(trained, b), &of_bones(truth, b), &maps, &places.get(b))
        })
        .collect();
    let mean = |of: fn(&Released) -> &Tensor| {
        Tensor::stack(&each.iter().map(|r| of(r).shallow_clone()).collect::<Vec<_>>(), 0).mean(None::<Kind>)
    };
    let weights = case.config("loss_weights").as_object().expect("weights of losses");
    let mut sum = Tensor::from(0f32);
    let mut weighed = 0;
    for (name, of) in [
        ("vertex_loss", (|r| &r.vertex) as fn(&Released) -> &Tensor),
        ("normalization_loss", |r| &r.normalization),
        ("skin_l1_loss", |r| &r.l1),
        ("bce_loss", |r| &r.bce),
        ("skin_zero_l1_loss", |r| &r.zero_l1),
        ("skin_non_zero_l1_loss", |r| &r.non_zero_l1),
    ] {
        let value = mean(of);
        case.check_if_there(&format!("out.loss.{name}"), &value.view([1]));
        if let Some(weight) = weights.get(name) {
            sum += value * weight.as_f64().expect("a number");
            weighed += 1;
        }
    }
    assert_eq!(weighed, weights.len(), "{}: other losses: {weights:?}", case.name);
    case.check_if_there("out.loss.loss_sum", &sum.view([1]));
    gradients(case, "grad.", params, &sum, &[]);

    // The figures of each rig, of its own bones; what is recorded is their mean.
    let figures: Vec<_> = (0..clouds)
        .map(|b| {
            let rows = |t: &Tensor| Rows::dense(&floats(&of_bones(t, b)), counts[b as usize] as usize);
            let (truth, predicted) = (rows(&rows_to_one), rows(&trained.detach()));
            SkinConvention::Unirig.figures(&Skins { truth: &truth, predicted: &predicted, edges: &[] })
        })
        .collect();
    for (k, (name, _)) in figures[0].iter().enumerate() {
        let mean = figures.iter().map(|own| own[k].1).sum::<f64>() / clouds as f64;
        let name = match name.split_once('_') {
            Some(("mask", limit)) => format!("mask_accu_{limit}"),
            Some(("iou", _)) => name.to_string(),
            _ => match *name {
                "bce" => "bce_loss".into(),
                "nonzero_l1" => "skin_non_zero_l1_loss".into(),
                other => format!("skin_{other}_loss"),
            },
        };
        case.check_if_there(&format!("out.loss.{name}"), &Tensor::from_slice(&[mean]));
    }
}

/// Weights where the model is used: with the mask, rig by rig and bit by bit.
fn evaluated(case: &Golden, net: &SkinModel, w: &Weights, read: &EncodedRig, points: &Tensor, unmasked: &Tensor) {
    let (voxel, counts) = (case.get("in.voxel_skin"), ints(&case.get("in.num_bones")));
    let parents = ints(&case.get("in.parents"));
    let (rigs, bones) = (counts.len(), voxel.size()[2]);
    let masks: Vec<Tensor> = (0..rigs as i64)
        .map(|b| {
            let own = &parents[(b * bones) as usize..((b + 1) * bones) as usize];
            let own: Vec<_> = own.iter().map(|&p| usize::try_from(p).ok()).take(counts[b as usize] as usize).collect();
            let mask = with_children(&voxel.get(b).narrow(1, 0, counts[b as usize]), &own);
            mask.constant_pad_nd([0, bones - counts[b as usize]])
        })
        .collect();
    let mask = Tensor::stack(&masks, 0);
    let weights = masked(unmasked, &mask, case.number("voxel_mask"));
    case.check_if_there("out.skin_eval", &weights);
    for (b, &count) in counts.iter().enumerate().filter(|(_, c)| **c == bones) {
        let one = |t: &Tensor| t.narrow(0, b as i64, 1);
        let own = EncodedRig {
            shape: one(&read.shape),
            embedded: one(&read.embedded),
            bones: one(&read.bones),
            context: one(&read.context),
        };
        let pairs = |start, n| voxel.get(b as i64).narrow(0, start, n).unsqueeze(-1);
        for at_once in [1, 3 * count as usize, 1 << 20] {
            let found = net.predict(w, &own, &points.get(b as i64), pairs, Some(&masks[b]), at_once);
            let off = (found - weights.get(b as i64)).abs().max().double_value(&[]);
            assert!(off <= 1e-5, "{} at once: {off}", at_once);
        }
    }
}

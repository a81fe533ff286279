//! `riglab checkpoint import`: weights under the names they were published with, through a checkpoint of torch, give
//! what the public code gave.
//!
//! The golden cases' networks are the published ones in miniature; their checkpoints are written here.

mod binary;

use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use binary::{must, refusal, riglab, text};
use riglab_config::Config;
use riglab_nn::params::{Params, Weights};
use riglab_nn::skeleton::cross_entropy;
use riglab_nn::skin_stage::shares;
use riglab_nn::tokenrig::Sequences;
use riglab_task::bundle::Stored;
use riglab_task::fsq_cvae::{Frozen, FsqCvaeTask, FsqCvaeTaskConfig};
use riglab_task::tokenrig::Rigger;
use riglab_task::unirig_skeleton::{SkeletonTask, SkeletonTaskConfig};
use riglab_task::unirig_skin::{SkinTask, SkinTaskConfig};
use riglab_tests::{Golden, golden};
use serde::de::DeserializeOwned;
use tch::{Device, Kind, Tensor};

type Tensors = BTreeMap<String, Tensor>;

/// A checkpoint as Lightning writes it: a table of tensors among other things, each tensor with a storage of its own.
fn checkpoint(tensors: &Tensors) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let plain = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut member = |name: String, bytes: &[u8]| {
        zip.start_file(name, plain).unwrap();
        zip.write_all(bytes).unwrap();
    };
    let word = |s: &str| [b"X", &(s.len() as u32).to_le_bytes()[..], s.as_bytes()].concat();
    let number = |n: i64| [&b"J"[..], &(n as i32).to_le_bytes()].concat();
    let numbers = |all: &[i64]| [&b"("[..], &all.iter().flat_map(|n| number(*n)).collect::<Vec<_>>(), b"t"].concat();
    let mut pickle = b"\x80\x02}(".to_vec();
    pickle.extend([word("global_step"), number(1400), word("state_dict")].concat());
    pickle.extend(b"ccollections\nOrderedDict\n)R(");
    for (at, (name, t)) in tensors.iter().enumerate() {
        let kind = match t.kind() {
            Kind::Float => "Float",
            Kind::BFloat16 => "BFloat16",
            other => panic!("{other:?}"),
        };
        let (size, count) = (t.size(), t.numel());
        let mut bytes = vec![0; count * t.kind().elt_size_in_bytes()];
        t.contiguous().copy_data_u8(&mut bytes, count);
        member(format!("x/data/{at}"), &bytes);
        let strides: Vec<i64> = (0..size.len()).map(|axis| size[axis + 1..].iter().product()).collect();
        pickle.extend(word(name));
        pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        pickle
            .extend([word("storage"), format!("ctorch\n{kind}Storage\n").into_bytes(), word(&at.to_string())].concat());
        pickle.extend([word("cuda:0"), number(count as i64), b"tQK\0".to_vec()].concat());
        pickle.extend([numbers(&size), numbers(&strides), b"\x89ccollections\nOrderedDict\n)RtR".to_vec()].concat());
    }
    pickle.extend(b"u");
    // What else a trainer keeps: a dictionary of a class that is nowhere, with a state.
    pickle.extend([word("hyper_parameters"), b"csettings\nAttributeDict\n)\x81(".to_vec()].concat());
    pickle.extend([word("tokens_per_skin"), number(2), b"u}b".to_vec(), b"u.".to_vec()].concat());
    member("x/data.pkl".into(), &pickle);
    zip.finish().unwrap().into_inner()
}

fn under(prefix: &str, tensors: Tensors) -> Tensors {
    tensors.into_iter().map(|(name, t)| (format!("{prefix}{name}"), t)).collect()
}

/// Imports tensors, with some settings that shapes do not tell; gives the file and what was said.
fn imported(dir: &Path, name: &str, tensors: &Tensors, sets: &[&str]) -> (PathBuf, String) {
    let (file, out) = (dir.join(format!("{name}.ckpt")), dir.join(format!("{name}.safetensors")));
    fs::write(&file, checkpoint(tensors)).unwrap();
    let mut args = vec!["checkpoint", "import", text(&file), "-o", text(&out)];
    sets.iter().for_each(|set| args.extend(["--set", set]));
    let said = String::from_utf8(must(&args).stdout).unwrap();
    (out, said)
}

/// A file's settings and tensors.
fn opened<C: DeserializeOwned>(file: &Path, kind: &str) -> (C, Tensors) {
    let stored = Stored::open(file).unwrap();
    assert_eq!((stored.kind.as_str(), stored.card.state.step), (kind, 1400));
    (Config::from_toml_str("file", &stored.settings).unwrap().get().unwrap(), riglab_nn::io::read(file).unwrap())
}

fn case(sub: &str, name: &'static str) -> Option<Golden> {
    golden(sub, &[name]).into_iter().map(|(_, case)| case).find(|case| case.name == name)
}

fn ints(t: &Tensor) -> Vec<i64> {
    Vec::<i64>::try_from(t.to_kind(Kind::Int64).contiguous().view([-1])).unwrap()
}

#[test]
fn the_auto_encoder() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["vae_learned", "vae_fps"] {
        let Some(case) = case("skintokens", name) else { return };
        let levels = format!("model.levels={}", case.config("FSQ_dict.levels"));
        let heads = format!("model.heads={}", case.number("num_attention_heads"));
        let mut sets = vec![levels.as_str(), &heads, "model.skin_tokens=8", "model.shape_tokens=12"];
        let pi = case.config("embed_include_pi") == true;
        let base = format!("model.embed.base={}", if pi { std::f64::consts::PI } else { 1.0 });
        let kind = if case.config("use_pmpe") == true { "phase_modulated" } else { "fourier" };
        let kind = format!("model.embed.kind='{kind}'");
        sets.extend([base.as_str(), &kind]);
        let (file, said) = imported(dir.path(), name, &under("model.", case.below("w.")), &sets);
        assert!(said.starts_with("SkinTokens' auto-encoder (names after `model.`)"), "{said}");
        assert!(!said.contains("left over"), "{said}");
        let (config, tensors): (FsqCvaeTaskConfig, _) = opened(&file, "fsq_cvae");
        let (net, params) = FsqCvaeTask::network(&config, Device::Cpu).unwrap();
        params.load(&tensors).unwrap();
        let w = params.weights();
        let cond = net.encode_shape(w, &case.get("in.uniform"), &case.get("out.query_cond"));
        case.check("out.cond", &cond);
        let codes = net.fsq().codes(&case.get("out.index"), Kind::Float);
        let all = Tensor::cat(&[case.get("in.uniform"), case.get("in.dense")], 1);
        case.check("out.pred", &net.decode(w, &codes, &cond, &all, None).sigmoid());
        // As other tasks take it.
        assert_eq!(Frozen::open(&file, Device::Cpu).unwrap().levels(), net.fsq().levels());
        case.done_in_part();
    }
}

/// Of each cloud, the points that are picked: the farthest among the rows drawn.
fn picks(cloud: &Tensor, rows: &[i64], tokens: usize) -> Tensor {
    let each = |b: i64| {
        let place = |r: i64| std::array::from_fn(|k| cloud.double_value(&[b, r, k as i64]) as f32);
        let drawn: Vec<[f32; 3]> = rows.iter().map(|&r| place(r)).collect();
        riglab_geom::farthest_points(&drawn, tokens, 0).into_iter().map(|i| rows[i]).collect::<Vec<_>>()
    };
    let all: Vec<i64> = (0..cloud.size()[0]).flat_map(each).collect();
    Tensor::from_slice(&all).view([cloud.size()[0], tokens as i64])
}

#[test]
fn the_skeleton_stage() {
    let dir = tempfile::tempdir().unwrap();
    let Some(case) = case("unirig", "ar_loss") else { return };
    let mut tensors = under("model._orig_mod.", case.below("w."));
    let head = tensors["model._orig_mod.transformer.model.decoder.embed_tokens.weight"].shallow_clone();
    tensors.insert("model.transformer.lm_head.weight".into(), head);
    let sets = ["model.shape.heads=2", "model.shape.tokens=6", "model.decoder.heads=4"];
    let (file, said) = imported(dir.path(), "skeleton", &tensors, &sets);
    assert!(said.contains("not needed: 1") && said.contains("the same as the embedding"), "{said}");
    let (config, tensors): (SkeletonTaskConfig, _) = opened(&file, "unirig_skeleton");
    assert_eq!((config.model.decoder.positions, config.model.decoder.ffn), (128, 64));
    // Drawn as published.
    let how = &config.eval.generate;
    assert_eq!((how.sample, how.beams, how.temperature, how.top_k), (true, 15, 1.5, 5));
    assert_eq!((how.top_p, how.repetition_penalty), (0.95, 3.0));
    let (net, params) = SkeletonTask::network(&config, Device::Cpu).unwrap();
    params.load(&tensors).unwrap();
    let w = params.weights();
    let cloud = Tensor::cat(&[case.get("in.vertices"), case.get("in.normals")], -1);
    let prefix = net.condition(w, &cloud, &picks(&cloud, &ints(&case.get("in.rows")), 6));
    let lengths = ints(&case.get("in.attention_mask").to_kind(Kind::Int64).sum_dim_intlist(-1, false, Kind::Int64));
    let padded = case.get("in.input_ids");
    let rows: Vec<Tensor> = (0..).zip(&lengths).map(|(b, n)| padded.get(b).narrow(0, 0, *n)).collect();
    let logits = net.logits(w, &prefix, &Tensor::cat(&rows, 0), &lengths, false);
    let targets: Vec<Tensor> = rows.iter().map(|r| r.narrow(0, 1, r.size()[0] - 1)).collect();
    let wanted: Vec<Tensor> =
        (0..).zip(&lengths).map(|(b, n)| case.get("out.logits").get(b).narrow(0, 6, n - 1)).collect();
    near("logits", &logits, &Tensor::cat(&wanted, 0), 1e-4);
    case.check("out.ce_loss", &cross_entropy(&logits, &Tensor::cat(&targets, 0)).view([1]));
    case.done_in_part();
}

fn near(what: &str, found: &Tensor, wanted: &Tensor, tolerance: f64) {
    assert_eq!(found.size(), wanted.size(), "{what}");
    let off = (found - wanted).abs().max().double_value(&[]);
    assert!(off <= tolerance, "{what}: off by {off}");
}

#[test]
fn the_skin_stage() {
    let dir = tempfile::tempdir().unwrap();
    let (Some(case), Some(backbone)) = (case("unirig", "skin"), case("unirig", "ptv3")) else { return };
    let mut tensors = case.below("w.");
    tensors.extend(under("mesh_encoder.", backbone.below("w.")));
    let counted = Tensor::from(7i64).to_kind(Kind::Float);
    tensors.insert("mesh_encoder.embedding.stem.norm.num_batches_tracked".into(), counted);
    let sets = [
        "model.shape.heads=2",
        "model.shape.tokens=6",
        "model.points.ptv3.heads=[2,4]",
        "model.points.ptv3.patch=16",
        "model.points.ptv3.grid=0.1",
    ];
    let (file, said) = imported(dir.path(), "skin", &under("model.", tensors), &sets);
    assert!(said.contains("num_batches_tracked`: made from the settings"), "{said}");
    let (config, tensors): (SkinTaskConfig, _) = opened(&file, "unirig_skin");
    assert_eq!((config.model.heads, config.model.mask_power), (4, 3.0));
    assert_eq!(config.model.points.ptv3.depths, [4, 1]);
    let (net, params) = SkinTask::network(&config, Device::Cpu).unwrap();
    params.load(&tensors).unwrap();
    let w = params.weights();
    let cloud = Tensor::cat(&[case.get("in.vertices"), case.get("in.normals")], -1);
    let picks = picks(&cloud, &ints(&case.get("in.rows")), 6);
    let read = net.read(w, &cloud, &picks, &case.get("in.joints"));
    case.check("out.bone_feat", &read.bones);
    let encoded = case.get("in.point_feat").view([cloud.size()[0], cloud.size()[1], -1]);
    let points = net.points(w, &read, &encoded);
    let logits = net.logits(w, &read, &points, &case.get("in.voxel_skin").unsqueeze(-1));
    case.check("out.skin_eval_unmasked", &shares(&logits, &ints(&case.get("in.num_bones"))));
    // The backbone beside it.
    for (name, wanted) in backbone.below("w.") {
        let own = &params_of(&params)[&format!("mesh_encoder.{name}")];
        assert!(own.equal(&wanted), "{name}");
    }
    case.done_in_part();
}

/// A run's weights as they are trained, not their moving average.
fn weights_of(run: &Path) -> Tensors {
    riglab_nn::io::read(&run.join("checkpoints/last/model.safetensors")).unwrap()
}

#[test]
fn a_training_begins_with_a_published_backbone_or_with_another_run() {
    let Some(backbone) = case("unirig", "ptv3") else { return };
    let dir = tempfile::tempdir().unwrap();
    let corpus = binary::corpus(dir.path(), 12);
    let published = dir.path().join("backbone.pth");
    fs::write(&published, checkpoint(&under("module.backbone.", backbone.below("w.")))).unwrap();
    let config = dir.path().join("config.toml");
    // Rates that change nothing: what it begins with stays.
    let told = format!(
        "extends = 'quickstart/unirig_skin.toml'\n[data]\ncorpora = ['{}']\n\
         [model]\nextends = 'model/unirig_skin/tiny.toml'\n[model.points]\nencoder = 'ptv3'\n\
         [model.points.ptv3]\ndepths = [4, 1]\nchannels = [8, 16]\nheads = [2, 4]\npatch = 16\ngrid = 0.1\n\
         norm = 'batch'\n[sampling]\nrigs = 2\npoints = 64\nqueries = 32\npool = 128\nresolution = 32\n\
         [train]\nsteps = 2\naccumulate = 1\nema = 0.0\nvalidate_every = 0\nsave_every = 0\n\
         [train.optim]\nmuon_lr = 1e-30\nadamw_lr = 1e-30\n\
         [eval]\nbaseline_resolution = 32\nvalidation_assets = 1\n",
        corpus.display()
    );
    fs::write(&config, told).unwrap();
    let train = |name: &str, sets: &[&str]| {
        let run = dir.path().join(name);
        let mut args = vec!["train".to_string(), text(&config).into(), "--run".into(), text(&run).into()];
        sets.iter().for_each(|set| args.extend(["--set".into(), (*set).to_string()]));
        (run, args)
    };
    let start = |path: &Path| format!("train.start.from='{}'", path.display());
    let said = |args: &[String]| {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        String::from_utf8(must(&args).stderr).unwrap()
    };

    let (run, args) = train("backbone", &[&start(&published), "train.start.parts=['mesh_encoder']"]);
    let notes = said(&args);
    assert!(notes.contains("note: `mesh_encoder` begins with") && notes.contains("below `backbone.`"), "{notes}");
    let own = weights_of(&run);
    for (name, wanted) in backbone.below("w.") {
        near(&name, &own[&format!("mesh_encoder.{name}")], &wanted, 1e-20);
    }
    let (drawn, args) = train("drawn", &[]);
    said(&args);
    let drawn = weights_of(&drawn);
    let rest = own.iter().filter(|(name, _)| !name.starts_with("mesh_encoder."));
    rest.for_each(|(name, t)| near(name, t, &drawn[name], 1e-20));

    // All of a run.
    let (whole, args) = train("whole", &[&start(&run), "train.seed=5"]);
    assert!(said(&args).contains("note: the network begins with"));
    let same = || weights_of(&whole).iter().for_each(|(name, t)| near(name, t, &own[name], 1e-20));
    same();
    // Killed before it saved anything, it begins with them again.
    fs::remove_dir_all(whole.join("checkpoints")).unwrap();
    fs::create_dir(whole.join("checkpoints")).unwrap();
    let info = whole.join("run.json");
    let ended = fs::read_to_string(&info).unwrap();
    assert!(ended.contains("\"outcome\": \"finished\""));
    fs::write(&info, ended.replace("\"outcome\": \"finished\"", "\"outcome\": \"\"")).unwrap();
    must(&["train", "--resume", text(&whole)]);
    same();
    // Where it came from is not asked for again.
    fs::remove_dir_all(&run).unwrap();
    must(&["train", "--resume", text(&whole)]);

    // What does not fit is said, and nothing is left behind.
    let (none, args) = train("none", &[&start(&published)]);
    let refused = refusal(&mut riglab(&args.iter().map(String::as_str).collect::<Vec<_>>()));
    assert!(refused.contains("backbone.pth: does not have all of this network") && !none.exists(), "{refused}");
    let (_, args) = train("none", &[&start(&run)]);
    let refused = refusal(&mut riglab(&args.iter().map(String::as_str).collect::<Vec<_>>()));
    assert!(refused.contains("train.start.from") && !none.exists(), "{refused}");
}

fn params_of(params: &Params) -> Tensors {
    params.named(params.weights()).map(|(n, t)| (n.to_string(), t.detach())).collect()
}

/// A whole TokenRig of golden parts: the decoder and its codes' meaning are the cases', the rest is made up.
fn tokenrig() -> Option<(Golden, Tensors)> {
    let (forward, shape) = (case("skintokens", "tokenrig_forward")?, case("skintokens", "mesh_condition")?);
    let vae = case("skintokens", "tokenrig_generate")?;
    let mut tensors = under("transformer.model.", forward.below("w.model."));
    tensors.extend(under("mesh_encoder.encoder.", shape.below("w.encoder.")));
    let made = |shape: &[i64]| Tensor::randn(shape, (Kind::Float, Device::Cpu)) * 0.1;
    for (name, shape) in [("0.weight", &[32, 32][..]), ("0.bias", &[32]), ("1.weight", &[32])] {
        tensors.insert(format!("output_proj.{name}"), made(shape));
    }
    let head = tensors["transformer.model.embed_tokens.weight"].shallow_clone();
    tensors.insert("transformer.lm_head.weight".into(), head);
    let mut own = under("vae.model.", vae.below("w.vae."));
    for (name, t) in tiny_vae() {
        own.entry(format!("vae.model.{name}")).or_insert(t);
    }
    tensors.extend(own);
    tensors.insert("vae.up_perceiver.weight".into(), made(&[2, 2]));
    Some((forward, tensors))
}

/// An auto-encoder of the golden's sizes, untrained.
fn tiny_vae() -> Tensors {
    let mut config = FsqCvaeTaskConfig::default();
    let m = &mut config.model;
    (m.encoder_width, m.decoder_width, m.heads, m.latent) = (12, 16, 2, 8);
    (m.encoder_layers, m.decoder_layers, m.levels, m.embed.frequencies) = (1, 1, vec![3, 4], 4);
    let (_, params) = FsqCvaeTask::network(&config, Device::Cpu).unwrap();
    params_of(&params)
}

const SIZES: [&str; 5] = [
    "model.shape.heads=4",
    "model.shape.tokens=8",
    "limits.tokens=60",
    "auto_encoder.model.heads=2",
    "auto_encoder.model.levels=[3,4]",
];

#[test]
fn a_whole_tokenrig_rigs_and_has_the_goldens_logits() {
    let Some((case, tensors)) = tokenrig() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (file, said) = imported(dir.path(), "tokenrig", &tensors, &SIZES);
    assert!(
        said.contains("SkinTokens' TokenRig: ") && said.contains("auto-encoder (names after `vae.model.`)"),
        "{said}"
    );
    let (rigger, card) = Rigger::open(&file, Device::Cpu).unwrap();
    // Told by the checkpoint's settings.
    assert_eq!((rigger.config().skin.codes, card.state.step), (2, 1400));
    logits(&case, &rigger, rigger.params().weights());
    // Drawn as published, from as many points.
    let how = &rigger.config().eval.generate;
    assert_eq!((how.sample, how.beams, how.temperature, how.top_k), (true, 10, 1.0, 5));
    assert_eq!((how.top_p, how.repetition_penalty), (0.95, 2.0));
    assert_eq!(rigger.vae().config().sampling.shape_points, rigger.config().sampling.cloud.points);
    let shown = String::from_utf8(must(&["checkpoint", "show", text(&file)]).stdout).unwrap();
    assert!(shown.starts_with("tokenrig\n") && shown.contains("as its authors published it"), "{shown}");

    // The model stands, though it sees others lying.
    let bare = dir.path().join("box.obj");
    fs::write(&bare, "v 0 0 0\nv 1 0 0\nv 0 3 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n").unwrap();
    let rigged = dir.path().join("box.glb");
    must(&["rig", text(&bare), "-o", text(&rigged), "--checkpoint", text(&file)]);
    let other = dir.path().join("other.glb");
    let plain = ["rig", text(&bare), "-o", text(&other), "--checkpoint", text(&file), "--beams", "1", "--json"];
    let made: serde_json::Value = serde_json::from_slice(&must(&plain).stdout).unwrap();
    assert!(made["joints"].as_u64().unwrap() > 0, "{made}");
    let found: serde_json::Value = serde_json::from_slice(&must(&["inspect", text(&rigged), "--json"]).stdout).unwrap();
    for joint in found["joints"].as_array().unwrap() {
        let head: Vec<f64> = joint["head"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        // In the cube around a body of height 3.
        assert!((-1.1..=2.1).contains(&head[0]) && (-0.1..=3.1).contains(&head[1]), "{head:?}");
    }

    // As a run's folder, with the auto-encoder in one of its own.
    let (ckpt, run) = (dir.path().join("tokenrig.ckpt"), dir.path().join("run"));
    let mut args = vec!["checkpoint", "import", text(&ckpt), "-o", text(&run)];
    SIZES.iter().for_each(|set| args.extend(["--set", set]));
    must(&args);
    let (again, _) = Rigger::open(&run, Device::Cpu).unwrap();
    for (name, own) in params_of(again.params()) {
        assert!(own.equal(&params_of(rigger.params())[&name]), "{name}");
    }
    // What is there is told before the file is read.
    let cut = dir.path().join("cut.ckpt");
    fs::write(&cut, b"PK cut").unwrap();
    let said = refusal(&mut riglab(&["checkpoint", "import", text(&cut), "-o", text(&run)]));
    assert!(said.contains("exists; give the name of a new folder"), "{said}");
    // What is asked for wins over what the file says.
    let (one, _) = imported(dir.path(), "one_code", &tensors, &[&SIZES[..], &["skin.codes=1"]].concat());
    assert_eq!(Rigger::open(&one, Device::Cpu).unwrap().0.config().skin.codes, 1);
    // A part of it by itself, in bfloat16 as published.
    let half: Tensors = tensors.iter().map(|(n, t)| (n.clone(), t.to_kind(Kind::BFloat16))).collect();
    fs::write(&ckpt, checkpoint(&half)).unwrap();
    let part = dir.path().join("part.safetensors");
    let sets = ["--set", "model.heads=2", "--set", "model.levels=[3,4]"];
    must(&[&["checkpoint", "import", text(&ckpt), "--as", "fsq_cvae", "-o", text(&part)], &sets[..]].concat());
    let shown = String::from_utf8(must(&["checkpoint", "show", text(&part)]).stdout).unwrap();
    assert!(shown.contains("of task fsq_cvae"), "{shown}");
    let again = refusal(&mut riglab(&["checkpoint", "import", text(&part)]));
    let axis = "data.up = \"z\"";
    assert!(shown.contains(axis) && again.contains(&format!("trains with it, with {axis}")), "{shown}{again}");
    let standing = dir.path().join("standing.safetensors");
    let others = ["--as", "fsq_cvae", "-o", text(&standing), "--set", "data.up=y"];
    must(&[&["checkpoint", "import", text(&ckpt)], &others[..], &sets[..]].concat());
    let stored = riglab_nn::io::read(&part).unwrap();
    assert!(stored.values().all(|t| t.kind() == Kind::BFloat16));
    // Beside the rest it goes by its own settings.
    let rest: Tensors = half.into_iter().filter(|(name, _)| !name.starts_with("vae.")).collect();
    fs::write(&ckpt, checkpoint(&rest)).unwrap();
    let whole = dir.path().join("whole.safetensors");
    let mut args = vec!["checkpoint", "import", text(&ckpt), "--skin", text(&part), "-o", text(&whole)];
    SIZES.iter().filter(|set| !set.starts_with("auto_encoder.")).for_each(|set| args.extend(["--set", set]));
    let told = |args: &[&str]| String::from_utf8(must(args).stderr).unwrap();
    assert!(!told(&args).contains("warning"));
    let (rigger, _) = Rigger::open(&whole, Device::Cpu).unwrap();
    let lying = dir.path().join("lying.safetensors");
    (args[4], args[6]) = (text(&standing), text(&lying));
    let said = told(&args);
    assert!(said.contains("warning: data.up = \"z\", but the auto-encoder") && said.contains("--skin"), "{said}");
    let vae = &rigger.vae().config().model;
    assert_eq!((vae.heads, &vae.levels), (2, &vec![3, 4]));
    // What has no effect is refused.
    let said =
        refusal(&mut riglab(&["checkpoint", "import", text(&ckpt), "-o", text(&dir.path().join("x")), "--name", "y"]));
    assert!(said.contains("--name is for files"), "{said}");
    let args = ["checkpoint", "import", text(&ckpt), "--as", "fsq_cvae", "--skin", text(&part)];
    assert!(!riglab(&args).output().unwrap().status.success());
}

fn logits(case: &Golden, rigger: &Rigger, w: &Weights) {
    let _no_grad = tch::no_grad_guard();
    let (mask, ids) = (case.get("out.attention_mask"), case.get("out.input_ids"));
    let lengths = ints(&mask.to_kind(Kind::Int64).sum_dim_intlist(-1, false, Kind::Int64));
    let rows: Vec<Tensor> = (0..).zip(&lengths).map(|(b, n)| ids.get(b).narrow(0, 0, *n)).collect();
    let given = Sequences { ids: &Tensor::cat(&rows, 0), lengths: &lengths, told: None };
    let hidden = rigger.net().forward(w, &case.get("in.cond"), &given, false);
    let wanted: Vec<Tensor> =
        (0..).zip(&lengths).map(|(b, n)| case.get("out.logits").get(b).narrow(0, 0, n - 1)).collect();
    near("logits", &rigger.net().logits(w, &hidden), &Tensor::cat(&wanted, 0), 1e-4);
}

#[test]
fn what_does_not_fit_is_listed_and_refused() {
    let Some((_, mut tensors)) = tokenrig() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("a.ckpt"), dir.path().join("a.safetensors"));
    let refuse = |tensors: &Tensors, more: &[&str]| {
        fs::write(&file, checkpoint(tensors)).unwrap();
        let mut args = vec!["checkpoint", "import", text(&file), "-o", text(&out)];
        SIZES.iter().for_each(|set| args.extend(["--set", set]));
        args.extend(more);
        let run = riglab(&args).output().unwrap();
        let said = refusal(&mut riglab(&args));
        assert!(!out.exists() && said.contains("a.ckpt"), "{said}");
        String::from_utf8_lossy(&run.stdout).into_owned() + &said
    };
    let whole = tensors.clone_all();
    tensors.remove("transformer.model.norm.weight");
    let said = refuse(&tensors, &[]);
    assert!(said.contains("missing: 1") && said.contains("`transformer.model.norm.weight` [32]"), "{said}");
    tensors = whole.clone_all();
    tensors.insert("output_proj.1.weight".into(), Tensor::zeros([31], (Kind::Float, Device::Cpu)));
    let said = refuse(&tensors, &[]);
    assert!(said.contains("`output_proj.1.weight` is [31], expected [32]"), "{said}");
    tensors = whole.clone_all();
    tensors.insert("transformer.lm_head.weight".into(), whole["transformer.lm_head.weight"].zeros_like());
    assert!(refuse(&tensors, &[]).contains("is not `transformer.model.embed_tokens.weight`"));
    assert!(refuse(&whole, &["--as", "unirig_skin"]).contains("no UniRig's skin stage is in it"));
    tensors = whole.clone_all();
    tensors.retain(|name, _| !name.starts_with("vae."));
    assert!(refuse(&tensors, &[]).contains("--skin FILE"));
    // Numbers that are no weights.
    tensors = whole.clone_all();
    let norm = "transformer.model.norm.weight";
    for (wrong, told) in [
        (whole[norm].full_like(f64::NAN), "holds NaN or infinity"),
        (whole[norm].full_like(f64::INFINITY), "holds NaN or infinity"),
    ] {
        tensors.insert(norm.into(), wrong);
        let said = refuse(&tensors, &[]);
        assert!(said.contains(&format!("`{norm}` {told}")) && said.contains("fetch it again"), "{said}");
    }
    let whole_numbers = dir.path().join("a.ckpt.safetensors");
    tensors.insert(norm.into(), whole[norm].to_kind(Kind::Int64));
    riglab_nn::io::write(&whole_numbers, tensors.iter().map(|(n, t)| (n.as_str(), t))).unwrap();
    let mut args = vec!["checkpoint", "import", text(&whole_numbers), "--set", "skin.codes=2"];
    SIZES.iter().for_each(|set| args.extend(["--set", set]));
    let said = refusal(&mut riglab(&args));
    assert!(said.contains(&format!("`{norm}` holds whole numbers (Int64)")), "{said}");
    // Sizes that do not go with the release's heads.
    let said = refuse(&whole, &["--set", "auto_encoder.model.heads=7"]);
    assert!(said.contains("is not divisible by heads = 7; sizes are those of the tensors' shapes"), "{said}");
    let said = refuse(&whole, &["--set", "auto_encoder.model.encoder_width=24"]);
    assert!(said.contains("the tensors' shapes say model.encoder_width = 12; leave it out"), "{said}");
    // Half of it below another prefix.
    tensors = whole.clone_all();
    let moved: Vec<String> = tensors.keys().filter(|n| n.starts_with("transformer.model.layers.")).cloned().collect();
    moved.iter().for_each(|name| drop(tensors.remove(name).map(|t| tensors.insert(format!("net.{name}"), t))));
    let said = refuse(&tensors, &["--set", "model.decoder.layers=2"]);
    assert!(said.contains(&format!("{} of them stand after `net.`", moved.len())), "{said}");
    let other = BTreeMap::from([("a.weight".to_string(), Tensor::zeros([2], (Kind::Float, Device::Cpu)))]);
    assert!(refuse(&other, &[]).contains("none of the published models"));
    // Cut short, and no checkpoint at all.
    let bytes = checkpoint(&whole);
    for (bytes, wanted) in [
        (&bytes[..bytes.len() / 2], "cut short"),
        (&b"version https://git-lfs.github.com/spec/v1"[..], "git lfs pull"),
        (b"\x80\x02}.", "save it again"),
        (b"", "is empty"),
        (b"<!DOCTYPE html><title>Not found</title>\n", "is a text"),
    ] {
        fs::write(&file, bytes).unwrap();
        let said = refusal(&mut riglab(&["checkpoint", "import", text(&file)]));
        assert!(said.contains(wanted), "{said}");
    }
}

/// Copies of names with the same tensors.
trait CloneAll {
    fn clone_all(&self) -> Self;
}

impl CloneAll for Tensors {
    fn clone_all(&self) -> Self {
        self.iter().map(|(n, t)| (n.clone(), t.shallow_clone())).collect()
    }
}

#[test]
fn what_riglab_wrote_itself_is_not_imported() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("m.safetensors");
    must(&["checkpoint", "export", "-o", text(&file)]);
    let said = refusal(&mut riglab(&["checkpoint", "import", text(&file)]));
    assert!(said.contains("it is riglab's already"), "{said}");
    assert!(said.contains(&format!("--checkpoint {}`", file.display())), "{said}");
    assert!(said.contains(&format!("riglab checkpoint show {}", file.display())), "{said}");
}

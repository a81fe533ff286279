//! What the tests share: where reference data lies, and golden cases.
//!
//! Reference data is no part of the product. Tests look for it in the folders named by
//! `RIGLAB_GOLDEN`, `RIGLAB_RIGS`, ..., by default beside the workspace, and say "skipped" where
//! there is none.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use riglab_nn::decoder::QwenConfig;
use riglab_nn::optim::{MuonScale, OptimConfig};
use riglab_nn::params::{Builder, Params};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::tokenrig::{Head, Layout, TokenRig, TokenRigConfig};
use serde_json::Value;
use tch::{Device, Kind, Tensor};

/// A folder of reference data, `None` (with a line that says so) when this machine has none.
pub fn folder(variable: &str, default: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ is in the workspace");
    let path = std::env::var_os(variable).map_or_else(|| root.join("../shared").join(default), PathBuf::from);
    if path.is_dir() {
        return Some(path);
    }
    println!("skipped: no such folder: {} (set {variable})", path.display());
    None
}

/// The golden cases of a folder whose names start with one of `kinds`; the longest fitting kind is
/// the case's.
///
/// # Panics
/// Where the folder has no case of a kind: a test would compare nothing.
pub fn golden(sub: &str, kinds: &[&'static str]) -> Vec<(&'static str, Golden)> {
    let Some(dir) = folder("RIGLAB_GOLDEN", "golden").map(|d| d.join(sub)) else { return Vec::new() };
    let mut names: Vec<String> = std::fs::read_dir(&dir)
        .unwrap_or_else(|e| panic!("{}: {e}", dir.display()))
        .filter_map(|entry| entry.ok()?.path().file_name()?.to_str()?.strip_suffix(".safetensors").map(String::from))
        .collect();
    names.sort();
    for kind in kinds {
        assert!(names.iter().any(|name| name.starts_with(kind)), "{}: no case `{kind}`", dir.display());
    }
    let kind = |name: &str| kinds.iter().filter(|k| name.starts_with(**k)).max_by_key(|k| k.len()).copied();
    names.iter().filter_map(|name| Some((kind(name)?, Golden::load(&dir, name)))).collect()
}

/// One case: inputs, weights and expected outputs, with the tolerance of each.
pub struct Golden {
    /// File name without ending.
    pub name: String,
    /// The side file.
    pub json: Value,
    /// All tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// Names of what was compared, or is left out for a reason.
    seen: RefCell<BTreeSet<String>>,
}

impl Golden {
    fn load(dir: &Path, name: &str) -> Self {
        let json = std::fs::read_to_string(dir.join(format!("{name}.json"))).expect("a case has a side file");
        let json = serde_json::from_str(&json).expect("side files are JSON");
        let tensors = riglab_nn::io::read(&dir.join(format!("{name}.safetensors"))).expect("a readable case");
        Self { name: name.into(), json, tensors, seen: RefCell::default() }
    }

    /// A tensor that must be there.
    pub fn get(&self, name: &str) -> Tensor {
        self.tensors.get(name).unwrap_or_else(|| panic!("{}: no tensor `{name}`", self.name)).shallow_clone()
    }

    /// Names that start with `prefix`, without it.
    pub fn names<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = &'a str> {
        self.tensors.keys().filter_map(move |k| k.strip_prefix(prefix))
    }

    /// The tensors below `prefix`, by the rest of their names.
    pub fn below(&self, prefix: &str) -> BTreeMap<String, Tensor> {
        self.names(prefix).map(|n| (n.to_string(), self.get(&format!("{prefix}{n}")))).collect()
    }

    /// A number of the config.
    pub fn number(&self, key: &str) -> f64 {
        self.config(key).as_f64().unwrap_or_else(|| panic!("{}: `{key}` is no number", self.name))
    }

    /// A value of the config, by a path like `FSQ_dict.levels`.
    pub fn config(&self, path: &str) -> &Value {
        path.split('.').fold(&self.json["config"], |v, key| &v[key])
    }

    fn tolerance(&self, name: &str) -> (f64, f64) {
        let table = self.json["tolerance"].as_object().expect("a case has tolerances");
        let fits = |pattern: &str| match pattern.split_once('*') {
            Some((start, end)) => name.len() + 1 >= pattern.len() && name.starts_with(start) && name.ends_with(end),
            None => name == pattern,
        };
        let best = table.iter().filter(|(p, _)| fits(p)).max_by_key(|(p, _)| p.len());
        let Some((_, t)) = best else {
            let whole = self.tensors.get(name).is_some_and(|t| !t.is_floating_point());
            assert!(whole, "{}: no tolerance for `{name}`", self.name);
            // Whole numbers are equal or not.
            return (0.0, 0.0);
        };
        // Where one of the two is not told, the other alone counts.
        (t["abs"].as_f64().unwrap_or(0.0), t["rel"].as_f64().unwrap_or(0.0))
    }

    /// Compares with the expected tensor of that name: |got - want| <= abs + rel |want|, exact where
    /// both are 0.
    pub fn check(&self, name: &str, got: &Tensor) {
        self.compare(name, got, &self.get(name));
    }

    fn compare(&self, name: &str, got: &Tensor, want: &Tensor) {
        let (abs, rel) = self.tolerance(name);
        assert_eq!(got.size(), want.size(), "{}: shape of `{name}`", self.name);
        let (got, want) = (got.detach().to_kind(Kind::Double), want.to_kind(Kind::Double));
        let excess = (&got - &want).abs() - (want.abs() * rel + abs);
        if excess.numel() > 0 {
            let worst = excess.max().double_value(&[]);
            assert!(worst <= 0.0, "{}: `{name}` is off by {worst:.3e} beyond its tolerance", self.name);
        }
        self.seen.borrow_mut().insert(name.into());
    }

    /// As [`Self::check`] of plain numbers, in files of many cases (`case001.out.x`), whose tolerances are told for
    /// `out.x`. NaN is equal to NaN.
    pub fn check_numbers(&self, name: &str, got: &[f64]) {
        let want = Vec::<f64>::try_from(self.get(name).to_kind(Kind::Double).view([-1])).expect("numbers");
        let output = name.find("out.").map_or("out.", |at| &name[at..]);
        let (abs, rel) = self.tolerance(output);
        assert_eq!(got.len(), want.len(), "{}: length of `{name}`", self.name);
        for (k, (g, w)) in got.iter().zip(&want).enumerate() {
            let fits = (g.is_nan() && w.is_nan()) || (g - w).abs() <= abs + rel * w.abs();
            assert!(fits, "{} `{name}` column {k}: {g}, expected {w} within {abs} and {rel} of it", self.name);
        }
        self.seen.borrow_mut().insert(name.into());
    }

    /// The cases of a file of many: the parts of tensors' names before `.in.` and `.out`.
    pub fn ids(&self) -> BTreeSet<String> {
        let id = |name: &str| name.split_once(".in.").or(name.split_once(".out")).map(|(id, _)| id.to_string());
        self.tensors.keys().filter_map(|name| id(name)).collect()
    }

    /// Whether there is a tensor of that name.
    pub fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// As [`Self::check`], where the case has such a tensor.
    pub fn check_if_there(&self, name: &str, got: &Tensor) {
        if self.has(name) {
            self.check(name, got);
        }
    }

    /// As [`Self::check`] where each number that is recorded as infinite must be so, of the same sign: scores of what was
    /// removed.
    pub fn check_scores(&self, name: &str, got: &Tensor) {
        let want = self.get(name);
        for (kind, of) in [("-inf", Tensor::isneginf as fn(&Tensor) -> Tensor), ("inf", Tensor::isposinf)] {
            assert!(of(got).equal(&of(&want)), "{}: `{name}` is {kind} elsewhere", self.name);
        }
        let finite = |t: &Tensor| t.to_kind(Kind::Double).where_self(&want.isfinite(), &Tensor::from(0f64));
        self.compare(name, &finite(got), &finite(&want));
    }

    /// Counts what starts with `start` as compared, with a reason why it is not.
    pub fn aside(&self, start: &str, why: &str) {
        let names: Vec<&String> = self.tensors.keys().filter(|name| name.starts_with(start)).collect();
        if !names.is_empty() {
            println!("{}: {start}: {why}", self.name);
        }
        self.seen.borrow_mut().extend(names.into_iter().cloned());
    }

    /// Ends a case of which this test compares a part and others the rest.
    pub fn done_in_part(&self) {
        let seen = self.seen.borrow();
        assert!(!seen.is_empty(), "{}: nothing was compared", self.name);
        println!("{}: {} tensors agree", self.name, seen.len());
    }

    /// Ends a case: all of its outputs and gradients must have been compared.
    pub fn done(&self) {
        let seen = self.seen.borrow();
        let given = |name: &str| name.starts_with("in.") || name.starts_with("w.");
        let output = |name: &str| {
            name.starts_with("grad.") || name.starts_with("out.") || (!given(name) && name.contains(".out"))
        };
        let left: Vec<&String> = self.tensors.keys().filter(|name| output(name) && !seen.contains(*name)).collect();
        assert!(left.is_empty(), "{}: not compared: {left:?}", self.name);
        self.done_in_part();
    }
}

/// The optimiser that a case tells of: what stands in its config, in words (`momentum .95, nesterov,
/// 0.2*sqrt(max(m,n))`) or by key, over the defaults. Newton-Schulz in double precision, gradients as they are.
pub fn optimizer(case: &Golden) -> OptimConfig {
    let mut config = OptimConfig { clip: 0.0, muon_bf16: false, ..OptimConfig::default() };
    let number = |path: &str| case.config(path).as_f64();
    for path in ["lr", "adamw.lr"] {
        if let Some(lr) = number(path) {
            (config.muon_lr, config.adamw_lr) = (lr, lr);
        }
    }
    for path in ["weight_decay", "adamw.weight_decay"] {
        config.weight_decay = number(path).unwrap_or(config.weight_decay);
    }
    if let Some(betas) = case.config("adamw.betas").as_array() {
        config.adamw_betas = [0, 1].map(|k| betas[k].as_f64().expect("a number"));
    }
    config.adamw_eps = number("adamw.eps").unwrap_or(config.adamw_eps);
    let muon = case.config("muon");
    let (words, momentum, nesterov) = match muon.as_str() {
        Some(words) => {
            let said = words.split_once("momentum ").and_then(|(_, rest)| rest.split([',', ';', ' ']).next());
            (words.to_owned(), said.and_then(|n| n.parse().ok()), words.contains("nesterov"))
        }
        None if muon.is_object() => {
            let scale = muon["scale"].as_str().expect("a scale").to_owned();
            (scale, muon["momentum"].as_f64(), muon["nesterov"] == true)
        }
        None => {
            config.muon.clear();
            return config;
        }
    };
    config.muon_momentum = momentum.unwrap_or(config.muon_momentum);
    config.muon_nesterov = nesterov;
    config.muon_scale = muon_scale(&words);
    config
}

/// Muon's scale by its formula or the name of who proposed it.
pub fn muon_scale(words: &str) -> MuonScale {
    match words {
        w if w.contains("0.2*sqrt(max(") || w.contains("moonshot") => MuonScale::MatchAdamw,
        w if w.contains("sqrt(max(1") || w.contains("keller") => MuonScale::Spectral,
        other => panic!("no scale of Muon: {other}"),
    }
}

/// The case among others that tells the sizes of another's network: itself, the one that it is `as`, or starts from.
pub fn sizes<'a>(case: &'a Golden, all: &'a [(&str, Golden)]) -> &'a Golden {
    if case.config("hidden").is_number() {
        return case;
    }
    let named = |key: &str| case.config(key).as_str();
    let name = named("qwen").map(|q| q.trim_start_matches("as ")).or(named("start")).expect("sizes, or whose");
    sizes(started(name, all), all)
}

/// The case that is called so, with or without its folder.
pub fn started<'a>(name: &str, all: &'a [(&str, Golden)]) -> &'a Golden {
    let own = name.rsplit('/').next().expect("a name");
    all.iter().find(|(_, c)| c.name == own).map_or_else(|| panic!("no case {name}"), |(_, case)| case)
}

/// TokenRig's network as a golden case has it, with the case's weights and the sizes that `of` tells; the shape encoder
/// is not part of it.
pub fn tiny_tokenrig(case: &Golden, of: &Golden, kind: Kind) -> (TokenRig, Params) {
    let n = |key: &str| of.number(key) as usize;
    let decoder = QwenConfig {
        width: n("hidden"),
        layers: n("layers"),
        heads: n("heads"),
        kv_heads: n("kv_heads"),
        head_width: n("head_dim"),
        ffn: n("intermediate"),
        rope_theta: of.number("rope_theta"),
        rms_eps: of.number("rms_eps"),
        positions: 1024,
        dropout: 0.0,
        init_std: 0.02,
    };
    let shape = PerceiverConfig { tokens: 4, width: 8, heads: 2, layers: 1, ..PerceiverConfig::default() };
    let config = TokenRigConfig { shape, decoder, head: Head::Flat, ..TokenRigConfig::default() };
    config.validate().unwrap();
    let layout = Layout::new(n("skeleton_vocab"), &[n("skin_codes") as i64], Head::Flat);
    assert_eq!(layout.end(), of.number("eos") as i64);
    let mut b = Builder::default();
    let net = TokenRig::new(b.root(), &config, &layout, n("tokens_per_skin"));
    let params = b.finish(0, kind, Device::Cpu).unwrap();
    let mut all: BTreeMap<String, Tensor> =
        params.named(params.weights()).map(|(n, t)| (n.to_string(), t.detach().copy())).collect();
    for (name, t) in case.below("w.model.") {
        let name = format!("transformer.model.{name}");
        assert!(all.insert(name.clone(), t.to_kind(kind)).is_some(), "{}: {name} is unknown", case.name);
    }
    params.load(&all).unwrap();
    (net, params)
}

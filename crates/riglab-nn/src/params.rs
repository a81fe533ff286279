//! Parameters by name, role and number; the weights a forward pass reads.
//!
//! A network is built once against [`Params`] and keeps numbers ([`ParamId`]) only. A forward pass
//! reads [`Weights`]: the master weights, a bfloat16 copy of them, or their moving average. So one
//! network serves training and evaluation, and nothing is swapped in and out. Whether blocks of deep
//! stacks are computed again in the backward pass ([`Weights::block`]) goes with the weights, too.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use rayon::prelude::*;
use riglab_random::{Draw, stream};
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

use crate::NnError;
use crate::io::Reader;

/// The number of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ParamId(usize);

impl ParamId {
    /// For indexing lists in parameter order.
    pub fn index(self) -> usize {
        self.0
    }
}

/// What a parameter does: by this the optimizer of each is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Matrices of attention: query, key, value and output projections.
    Attention,
    /// Matrices of feed-forward layers.
    FeedForward,
    /// Matrices between a network's spaces: input, output and latent projections.
    Projection,
    /// Tables of learned vectors.
    Embedding,
    /// Gains and biases.
    Vector,
}

/// How a parameter starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Init {
    /// All one value.
    Constant(f64),
    /// Normal with mean 0.
    Normal {
        /// Standard deviation.
        std: f64,
    },
    /// Uniform in [-bound, bound].
    Uniform {
        /// Half the width.
        bound: f64,
    },
}

struct Entry {
    name: String,
    role: Role,
    shape: Vec<i64>,
    init: Init,
}

/// The parameters of a network: names, roles and master weights.
pub struct Params {
    entries: Vec<Entry>,
    weights: Weights,
}

/// One tensor per parameter, in parameter order.
pub struct Weights {
    tensors: Vec<Tensor>,
    /// Whether [`Self::block`] computes again.
    recompute: bool,
    /// What the blocks that are running have read, the innermost last.
    reads: RefCell<Vec<BTreeSet<usize>>>,
}

impl std::ops::Index<ParamId> for Weights {
    type Output = Tensor;
    fn index(&self, id: ParamId) -> &Tensor {
        if let Some(reads) = self.reads.borrow_mut().last_mut() {
            reads.insert(id.0);
        }
        &self.tensors[id.0]
    }
}

/// A part of a network in a form that outlasts the forward pass, for [`Weights::again`].
struct Held<F> {
    part: F,
    /// The parameters that it reads.
    ids: Vec<usize>,
}

impl Weights {
    fn new(tensors: Vec<Tensor>) -> Self {
        Self { tensors, recompute: false, reads: RefCell::default() }
    }

    /// In parameter order.
    pub fn tensors(&self) -> &[Tensor] {
        &self.tensors
    }

    /// The same tensors, with blocks of deep stacks computed again in the backward pass or not: see [`Self::block`].
    pub fn recomputing(&self, recompute: bool) -> Self {
        Self { recompute, ..Self::new(self.tensors.iter().map(Tensor::shallow_clone).collect()) }
    }

    /// Whether blocks of deep stacks are computed again in the backward pass.
    pub fn recomputes(&self) -> bool {
        self.recompute
    }

    /// A block of a deep stack: `part` of these weights and the inputs. What it computes on the way is kept for the
    /// backward pass, or computed again there if that was asked for ([`Self::recomputing`]); the numbers are the same.
    pub fn block(&self, inputs: &[&Tensor], part: impl Fn(&Self, &[Tensor]) -> Tensor + Send + 'static) -> Tensor {
        if self.recompute {
            return self.again(inputs, move |w, inputs| vec![part(w, inputs)]).remove(0);
        }
        part(self, &inputs.iter().map(|t| t.shallow_clone()).collect::<Vec<_>>())
    }

    /// As [`Self::block`], computed again in the backward pass whatever was asked for. `part` must give the same each
    /// time; tensors that it holds besides its inputs must need no gradient.
    ///
    /// # Panics
    /// Where libtorch refuses, as its operations do here.
    pub fn again(
        &self,
        inputs: &[&Tensor],
        part: impl Fn(&Self, &[Tensor]) -> Vec<Tensor> + Send + 'static,
    ) -> Vec<Tensor> {
        let (count, all, recompute) = (inputs.len(), self.tensors.len(), self.recompute);
        let held = Held { part, ids: Vec::new() };
        let out = riglab_torch::recompute(
            inputs,
            held,
            |held| {
                self.reads.borrow_mut().push(BTreeSet::new());
                let own: Vec<Tensor> = inputs.iter().map(|t| t.shallow_clone()).collect();
                let out = (held.part)(self, &own);
                let mut reads = self.reads.borrow_mut();
                let read = reads.pop().unwrap_or_default();
                // What is around it has read them too.
                if let Some(outer) = reads.last_mut() {
                    outer.extend(&read);
                }
                held.ids = read.into_iter().collect();
                (out, held.ids.iter().map(|&id| self.tensors[id].shallow_clone()).collect())
            },
            move |held, read| {
                let mut tensors: Vec<Tensor> = (0..all).map(|_| Tensor::new()).collect();
                for (&id, tensor) in held.ids.iter().zip(&read[count..]) {
                    tensors[id] = tensor.shallow_clone();
                }
                (held.part)(&Self { recompute, ..Self::new(tensors) }, &read[..count])
            },
        );
        out.expect("libtorch takes a block's inputs and outputs")
    }

    /// What each of some parts of a network gives of these weights, computed side by side, each on a thread of its own with
    /// its share of libtorch's threads, and so are gradients: [`riglab_torch::with_gradients`]. Give no more parts than
    /// there are threads; tensors that they hold must need no gradient.
    ///
    /// # Panics
    /// Where libtorch refuses, as its operations do, and when a part does.
    pub fn side_by_side<F>(&self, parts: Vec<F>) -> Vec<Vec<Tensor>>
    where
        F: FnOnce(&Self) -> Vec<Tensor> + Send,
    {
        if parts.len() == 1 {
            return parts.into_iter().map(|part| part(self)).collect();
        }
        let recompute = self.recompute;
        let parts = parts.into_iter().map(|part| -> riglab_torch::Part {
            Box::new(move |leaves| {
                let own = Self { recompute, ..Self::new(leaves) };
                own.reads.borrow_mut().push(BTreeSet::new());
                let found = part(&own);
                let read = own.reads.borrow_mut().pop().unwrap_or_default();
                (found, read.into_iter().collect())
            })
        });
        let found = riglab_torch::with_gradients(&self.tensors, parts.collect());
        found.expect("libtorch takes the outputs of parts")
    }

    /// Copies in another kind that collect gradients of their own, where these do: the compute weights of a mixed
    /// precision step.
    pub fn cast(&self, kind: Kind) -> Self {
        let cast = |t: &Tensor| t.detach().to_kind(kind).set_requires_grad(t.requires_grad());
        Self::new(self.tensors.iter().map(cast).collect())
    }

    /// Copies without gradients.
    pub fn detached_copy(&self) -> Self {
        Self::new(self.tensors.iter().map(|t| t.detach().copy()).collect())
    }

    /// The kind of the numbers.
    pub fn kind(&self) -> Kind {
        self.tensors.first().map_or(Kind::Float, Tensor::kind)
    }
}

/// Collects the parameters of a network while it is built.
#[derive(Default)]
pub struct Builder {
    entries: Vec<Entry>,
}

/// A place in the tree of names; `a/b` is written `a.b` as PyTorch does.
pub struct Scope<'a> {
    builder: &'a mut Builder,
    prefix: String,
}

impl Builder {
    /// The top of the tree.
    pub fn root(&mut self) -> Scope<'_> {
        Scope { builder: self, prefix: String::new() }
    }

    /// Names and shapes of what was added.
    pub fn shapes(&self) -> impl Iterator<Item = (&str, &[i64])> {
        self.entries.iter().map(|e| (e.name.as_str(), e.shape.as_slice()))
    }

    /// Draws the starting values. Each parameter has a stream of its own, keyed by its name, so
    /// adding a layer leaves the others' values alone.
    ///
    /// # Errors
    /// [`NnError::DuplicateName`], [`NnError::TooLarge`].
    pub fn finish(self, seed: u64, kind: Kind, device: Device) -> Result<Params, NnError> {
        self.check()?;
        let values: Vec<Vec<f32>> = self.entries.par_iter().map(|e| draw(seed, e)).collect();
        let tensors = self.entries.iter().zip(values).map(|(e, values)| {
            let t = Tensor::from_slice(&values).reshape(&e.shape).to_device(device).to_kind(kind);
            t.set_requires_grad(true)
        });
        let weights = Weights::new(tensors.collect());
        Ok(Params { entries: self.entries, weights })
    }

    /// Draws nothing: what the values are is left open until they are loaded ([`Params::load_each`]). Drawing those of a
    /// large network takes as long as reading them.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn blank(self, kind: Kind, device: Device) -> Result<Params, NnError> {
        self.check()?;
        let tensors = self.entries.iter().map(|e| Tensor::empty(&e.shape, (kind, device)).set_requires_grad(true));
        let weights = Weights::new(tensors.collect());
        Ok(Params { entries: self.entries, weights })
    }

    /// Whether there can be such a network.
    fn check(&self) -> Result<(), NnError> {
        let mut seen = HashMap::new();
        for e in &self.entries {
            if seen.insert(&e.name, ()).is_some() {
                return Err(NnError::DuplicateName(e.name.clone()));
            }
        }
        let number = |shape: &[i64]| shape.iter().fold(1u128, |n, k| n.saturating_mul((*k).max(0) as u128));
        let parameters = self.entries.iter().fold(0u128, |n, e| n.saturating_add(number(&e.shape)));
        if let Some(memory_gb) = riglab_torch::memory_gb("MemTotal")
            && parameters as f64 * 4e-9 > memory_gb
        {
            return Err(NnError::TooLarge { parameters, memory_gb });
        }
        Ok(())
    }
}

fn draw(seed: u64, e: &Entry) -> Vec<f32> {
    let n = e.shape.iter().product::<i64>() as usize;
    let mut random = stream(seed, &format!("init/{}", e.name), &[]);
    match e.init {
        Init::Constant(c) => vec![c as f32; n],
        Init::Normal { std } => (0..n).map(|_| random.normal() * std as f32).collect(),
        Init::Uniform { bound } => (0..n).map(|_| random.within(-bound as f32, bound as f32)).collect(),
    }
}

impl Scope<'_> {
    /// A place below this one.
    pub fn sub(&mut self, name: impl std::fmt::Display) -> Scope<'_> {
        let prefix = self.name(&name.to_string());
        Scope { builder: self.builder, prefix }
    }

    /// Adds a parameter.
    pub fn add(&mut self, name: &str, role: Role, shape: &[i64], init: Init) -> ParamId {
        let name = self.name(name);
        self.builder.entries.push(Entry { name, role, shape: shape.to_vec(), init });
        ParamId(self.builder.entries.len() - 1)
    }

    fn name(&self, name: &str) -> String {
        if self.prefix.is_empty() { name.to_string() } else { format!("{}.{name}", self.prefix) }
    }
}

impl Params {
    /// The master weights.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// How many parameters (tensors).
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// How many numbers in all.
    pub fn numel(&self) -> usize {
        self.weights.tensors.iter().map(Tensor::numel).sum()
    }

    /// All parameters in order.
    pub fn ids(&self) -> impl ExactSizeIterator<Item = ParamId> + use<> {
        (0..self.entries.len()).map(ParamId)
    }

    /// The name of a parameter.
    pub fn name(&self, id: ParamId) -> &str {
        &self.entries[id.0].name
    }

    /// The role of a parameter.
    pub fn role(&self, id: ParamId) -> Role {
        self.entries[id.0].role
    }

    /// The shape of a parameter.
    pub fn shape(&self, id: ParamId) -> &[i64] {
        &self.entries[id.0].shape
    }

    /// Names with tensors, for writing.
    pub fn named<'a>(&'a self, weights: &'a Weights) -> impl Iterator<Item = (&'a str, &'a Tensor)> {
        self.entries.iter().map(|e| e.name.as_str()).zip(&weights.tensors)
    }

    /// Has the parameters whose names begin with one of `parts` stay as they are: they get no gradient from here on, so
    /// that no optimizer moves or decays them, and the backward pass does not go where only they would need it. Others go
    /// on learning. Gives how many numbers stay.
    ///
    /// # Errors
    /// [`NnError::Config`]: a part that no name begins with, or nothing left to learn.
    pub fn freeze(&self, parts: &[String]) -> Result<usize, NnError> {
        let within = |name: &str, part: &str| {
            name.strip_prefix(part.trim_end_matches('.')).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        if let Some(part) = parts.iter().find(|part| !self.entries.iter().any(|e| within(&e.name, part))) {
            return Err(self.no_part(part));
        }
        let frozen = |e: &Entry| parts.iter().any(|part| within(&e.name, part));
        if self.entries.iter().all(frozen) {
            return Err(NnError::Config("all parameters are frozen: nothing is left to learn".into()));
        }
        let held = self.entries.iter().zip(&self.weights.tensors).filter(|(entry, _)| frozen(entry));
        Ok(held.map(|(_, tensor)| tensor.set_requires_grad(false).numel()).sum())
    }

    /// Whether a parameter learns: it was not frozen.
    pub fn learns(&self, id: ParamId) -> bool {
        self.weights[id].requires_grad()
    }

    /// That no name begins with a part, and what names begin with.
    pub fn no_part(&self, part: &str) -> NnError {
        let heads: BTreeSet<&str> = self.entries.iter().filter_map(|e| e.name.split('.').next()).collect();
        let heads = heads.into_iter().collect::<Vec<_>>().join(", ");
        NnError::Config(format!("no parameter of this network begins with `{part}`; it has {heads}"))
    }

    /// Copies tensors by name into the master weights; every parameter must be there with its
    /// shape, and nothing else.
    ///
    /// # Errors
    /// [`NnError::Mismatch`], naming what is missing, too many or of another shape.
    pub fn load(&self, tensors: &BTreeMap<String, Tensor>) -> Result<(), NnError> {
        let shapes = tensors.iter().map(|(name, t)| (name.clone(), t.size())).collect();
        self.load_each(&shapes, |name| Ok(tensors[name].shallow_clone()))
    }

    /// As [`Self::load`], of tensors of these shapes that are read one at a time: they are never in memory beside the
    /// network.
    ///
    /// # Errors
    /// As [`Self::load`], before anything is read, and those of `read`.
    pub fn load_each(
        &self,
        shapes: &BTreeMap<String, Vec<i64>>,
        read: impl FnMut(&str) -> Result<Tensor, NnError>,
    ) -> Result<(), NnError> {
        self.fill(&self.weights, shapes, read)
    }

    /// As [`Self::load`], a tensor at a time from a file into these or other weights of this network: the file is never
    /// in memory beside the network.
    ///
    /// # Errors
    /// As [`Self::load`], and when a tensor cannot be read.
    pub fn load_from(&self, file: &Reader, weights: &Weights) -> Result<(), NnError> {
        self.fill(weights, &file.shapes(), |name| file.read(name))
    }

    fn fill(
        &self,
        weights: &Weights,
        shapes: &BTreeMap<String, Vec<i64>>,
        mut read: impl FnMut(&str) -> Result<Tensor, NnError>,
    ) -> Result<(), NnError> {
        self.check(shapes)?;
        let _no_grad = tch::no_grad_guard();
        for (name, own) in self.named(weights) {
            own.shallow_clone().copy_(&read(name)?);
        }
        Ok(())
    }

    /// Whether names and shapes are those of this network.
    fn check(&self, shapes: &BTreeMap<String, Vec<i64>>) -> Result<(), NnError> {
        let mut faults = Vec::new();
        for e in &self.entries {
            match shapes.get(&e.name) {
                None => faults.push(format!("`{}` is missing", e.name)),
                Some(s) if *s != e.shape => faults.push(format!("`{}` is {s:?}, expected {:?}", e.name, e.shape)),
                Some(_) => {}
            }
        }
        let known: HashSet<&str> = self.entries.iter().map(|e| e.name.as_str()).collect();
        faults.extend(shapes.keys().filter(|k| !known.contains(k.as_str())).map(|k| format!("`{k}` is unknown")));
        if faults.is_empty() {
            return Ok(());
        }
        let (count, tensors) = (faults.len(), self.entries.len());
        faults.truncate(3);
        Err(NnError::Mismatch { count, tensors, first: faults.join(", ") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two(extra: bool) -> Params {
        let mut b = Builder::default();
        let mut root = b.root();
        root.sub("a").add("weight", Role::Projection, &[2, 3], Init::Normal { std: 1.0 });
        if extra {
            root.sub("x").add("weight", Role::Projection, &[5], Init::Uniform { bound: 1.0 });
        }
        root.sub("b").sub(0).add("bias", Role::Vector, &[3], Init::Uniform { bound: 0.5 });
        b.finish(1, Kind::Float, Device::Cpu).unwrap()
    }

    #[test]
    fn a_new_layer_leaves_the_others_values_alone() {
        let (a, b) = (two(false), two(true));
        assert_eq!(a.name(ParamId(1)), "b.0.bias");
        assert!(a.weights()[ParamId(1)].equal(&b.weights()[ParamId(2)]));
    }

    #[test]
    fn what_memory_cannot_hold_is_refused() {
        let mut b = Builder::default();
        b.root().add("weight", Role::Projection, &[3_000_000, 2_000_000], Init::Constant(0.0));
        let Err(e) = b.finish(0, Kind::Float, Device::Cpu) else { panic!("6e12 parameters were made") };
        assert!(e.to_string().starts_with("the network has 6000.0 thousand million parameters, 24000 GB"), "{e}");
    }

    #[test]
    fn loading_names_what_does_not_fit() {
        let p = two(false);
        let tensors: BTreeMap<String, Tensor> = [
            ("a.weight".to_string(), Tensor::zeros([2, 3], (Kind::Float, Device::Cpu))),
            ("c".into(), Tensor::from(1.0)),
        ]
        .into();
        let text = p.load(&tensors).unwrap_err().to_string();
        assert!(text.contains("`b.0.bias` is missing") && text.contains("`c` is unknown"), "{text}");
    }

    #[test]
    fn what_is_loaded_needs_no_values_before() {
        let mut b = Builder::default();
        let wide = [3_000_000, 2_000_000];
        b.root().add("weight", Role::Projection, &wide, Init::Constant(0.0));
        assert!(matches!(b.blank(Kind::Float, Device::Cpu), Err(NnError::TooLarge { .. })));
        let mut b = Builder::default();
        b.root().add("weight", Role::Projection, &[2], Init::Constant(0.0));
        let p = b.blank(Kind::Float, Device::Cpu).unwrap();
        let shapes = |n| BTreeMap::from([("weight".to_string(), vec![n])]);
        let read = |_: &str| Ok(Tensor::from_slice(&[1i64, 2]));
        p.load_each(&shapes(2), read).unwrap();
        assert!(p.learns(ParamId(0)) && p.weights()[ParamId(0)].equal(&Tensor::from_slice(&[1.0f32, 2.0])));
        assert!(p.load_each(&shapes(3), |_| unreachable!("nothing is read of what does not fit")).is_err());
    }

    #[test]
    fn frozen_parts_get_no_gradient_in_any_copy() {
        let frozen = |parts: &[&str]| {
            let p = two(true);
            let numbers = p.freeze(&parts.iter().map(|p| (*p).to_string()).collect::<Vec<_>>())?;
            Ok::<_, NnError>((p, numbers))
        };
        let (p, numbers) = frozen(&["a", "b.0."]).unwrap();
        assert_eq!(numbers, 6 + 3);
        assert_eq!(p.ids().map(|id| p.learns(id)).collect::<Vec<_>>(), [false, true, false]);
        let half = p.weights().cast(Kind::BFloat16);
        assert_eq!(half.tensors().iter().map(Tensor::requires_grad).collect::<Vec<_>>(), [false, true, false]);
        let (p, numbers) = frozen(&[]).unwrap();
        assert!(numbers == 0 && p.ids().all(|id| p.learns(id)));
        let text = |parts| frozen(parts).err().unwrap().to_string();
        assert!(text(&["a", "wei"]).contains("begins with `wei`; it has a, b, x"), "{}", text(&["a", "wei"]));
        assert!(text(&["a", "b", "x"]).contains("nothing is left"));
    }

    #[test]
    fn blocks_find_their_parameters_and_those_of_blocks_within() {
        let p = two(true);
        let x = Tensor::ones([4, 3], (Kind::Float, Device::Cpu)).set_requires_grad(true);
        let of = |w: &Weights| {
            let y = w.block(&[&x], |w, t| {
                let y = w.block(&[&t[0]], |w, t| t[0].linear(&w[ParamId(0)], None::<&Tensor>).sin());
                y.sum(Kind::Float) * &w[ParamId(2)]
            });
            // Read outside of any block.
            let loss = (y + &w[ParamId(2)]).square().sum(Kind::Float);
            let inputs: Vec<&Tensor> = p.weights().tensors().iter().chain([&x]).collect();
            Tensor::run_backward(&[loss], &inputs, false, false)
        };
        let (plain, again) = (of(p.weights()), of(&p.weights().recomputing(true)));
        assert!(!plain[1].defined() && !again[1].defined(), "nobody read it");
        assert!([0, 2, 3].iter().all(|&k| plain[k].equal(&again[k]) && plain[k].abs().max().double_value(&[]) > 0.0));
    }

    #[test]
    fn parts_side_by_side_find_their_parameters_as_blocks_do() {
        let p = two(true);
        let x = Tensor::ones([4, 3], (Kind::Float, Device::Cpu));
        let part = |w: &Weights, x: Tensor| {
            let y = w.block(&[&x], |w, t| t[0].linear(&w[ParamId(0)], None::<&Tensor>).sin());
            vec![y.sum(Kind::Float) * &w[ParamId(2)]]
        };
        let of = |w: &Weights, found: Vec<Vec<Tensor>>| {
            let sum: Tensor = found.into_iter().flatten().sum();
            let loss = (sum + &w[ParamId(2)]).square().sum(Kind::Float);
            Tensor::run_backward(&[loss], p.weights().tensors(), false, false)
        };
        for recompute in [false, true] {
            let w = p.weights().recomputing(recompute);
            let plain = of(&w, vec![part(&w, x.narrow(0, 0, 1)), part(&w, x.narrow(0, 1, 3))]);
            let jobs: Vec<_> = [(0, 1), (1, 3)]
                .map(|(start, count)| {
                    let x = x.narrow(0, start, count);
                    move |w: &Weights| part(w, x)
                })
                .into();
            let beside = of(&w, w.side_by_side(jobs));
            assert!(!beside[1].defined(), "nobody read it");
            assert!([0, 2].iter().all(|&k| plain[k].allclose(&beside[k], 1e-6, 1e-6, false)));
        }
    }

    #[test]
    fn cast_copies_collect_gradients_of_their_own() {
        let p = two(false);
        let half = p.weights().cast(Kind::BFloat16);
        let loss = (half.tensors()[0].sum(Kind::Float)) * 2.0;
        let grads = Tensor::run_backward(&[loss], &[&half.tensors()[0]], false, false);
        assert_eq!((grads[0].kind(), grads[0].double_value(&[0, 0])), (Kind::BFloat16, 2.0));
    }
}

//! Parts of a network's work side by side, each on a thread of its own.
//!
//! A network of a laptop's size cannot keep two processors busy with one small product after another: between them
//! threads wait for each other at every op. Where the work falls into parts that do not look at each other, as the rigs
//! of a batch, each thread does a part of its own from the first op to the last, forwards and backwards.

use std::collections::HashSet;
use std::mem::ManuallyDrop;
use std::os::raw::{c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr::null_mut;
use std::sync::OnceLock;

use rayon::{ThreadPool, ThreadPoolBuilder};
use tch::{Device, Kind, Tensor};
use torch_sys::C_tensor;

use crate::error::{TorchError, check, said};
use crate::flops::counted_along;
use crate::recompute::grad_enabled;
use crate::settings::own_generator;
use crate::tensors::foreach_add;

type Back =
    extern "C" fn(*mut c_void, *const *mut C_tensor, usize, *mut *mut C_tensor, usize, *mut c_char, usize) -> c_int;

unsafe extern "C" {
    fn rl_gradients(
        outputs: *const *const C_tensor,
        grads: *const *const C_tensor,
        n: usize,
        leaves: *const *const C_tensor,
        m: usize,
        out: *mut *mut C_tensor,
    ) -> c_int;
    fn rl_parts(
        inputs: *const *const C_tensor,
        m: usize,
        out: *const *const C_tensor,
        n: usize,
        back: Back,
        forget: extern "C" fn(*mut c_void),
        parts: *mut c_void,
    ) -> c_int;
    fn rl_rng_draw(out: *mut u64) -> c_int;
}

/// Threads for all jobs but the first, which is its caller's.
fn threads() -> &'static ThreadPool {
    static THREADS: OnceLock<ThreadPool> = OnceLock::new();
    THREADS.get_or_init(|| {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let count = processors.max(tch::get_num_threads().max(1) as usize).max(2) - 1;
        let pool = ThreadPoolBuilder::new().num_threads(count).thread_name(|k| format!("part {}", k + 1)).build();
        pool.expect("threads can be started")
    })
}

/// As how many parts at a time something is best computed on a device: the threads that this one may take on the processor,
/// one elsewhere.
pub fn threads_on(device: Device) -> usize {
    if device == Device::Cpu { tch::get_num_threads().max(1) as usize } else { 1 }
}

/// Threads within an op of the thread that this was made on, which has them again when this goes.
struct Share {
    all: i32,
    each: i32,
}

impl Share {
    /// An equal one of so many parts.
    fn of(parts: usize) -> Self {
        Self::with((tch::get_num_threads() / parts.max(1) as i32).max(1))
    }

    fn with(each: i32) -> Self {
        let all = tch::get_num_threads().max(1);
        tch::set_num_threads(each);
        Self { all, each }
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        tch::set_num_threads(self.all);
    }
}

/// What work gives whose ops are each done by this thread alone: where they are so small that to wake others costs more. As
/// [`side_by_side`], for the thread that the others work for: not for those of a loader beside it.
pub fn alone<R>(work: impl FnOnce() -> R) -> R {
    let _share = Share::with(1);
    work()
}

/// What jobs give, in their order. The first is done by this thread, the others at the same time by threads of their own,
/// each with its share of the threads that libtorch takes within an op; give no more jobs than that are
/// (`tch::get_num_threads`). Whether gradients are kept is as it is here. A job's draws ([`crate::dropout`]) come from
/// this thread's generator in the first, from one that it seeds in the others, so that they are the same each time.
///
/// # Panics
/// When a job does.
pub fn side_by_side<R: Send, F: FnOnce() -> R + Send>(jobs: Vec<F>) -> Vec<R> {
    let mut jobs = jobs.into_iter();
    let (Some(first), rest) = (jobs.next(), jobs.len()) else { return Vec::new() };
    if rest == 0 {
        return vec![first()];
    }
    let (with_grad, seed) = (grad_enabled(), drawn());
    let share = Share::of(rest + 1);
    let each = share.each;
    let mut found: Vec<Option<R>> = (0..rest).map(|_| None).collect();
    let own = threads().in_place_scope(|scope| {
        for (k, (job, place)) in (1u64..).zip(jobs.zip(&mut found)) {
            scope.spawn(move |_| {
                // Only a thread that knows its number keeps the one that it is given.
                let _ = tch::get_num_threads();
                tch::set_num_threads(each);
                let _guard = (!with_grad).then(tch::no_grad_guard);
                own_generator(seed ^ k.wrapping_mul(0x9e37_79b9_7f4a_7c15)).expect("a generator is made");
                *place = Some(counted_along(job).expect("products are counted"));
            });
        }
        first()
    });
    drop(share);
    std::iter::once(own).chain(found.into_iter().map(|r| r.expect("every job has run"))).collect()
}

/// A number of this thread's generator.
fn drawn() -> u64 {
    let mut seed = 0;
    // SAFETY: a place for a number.
    check(unsafe { rl_rng_draw(&mut seed) }).expect("a generator draws");
    seed
}

/// A part of [`with_gradients`]: it is given the inputs, as leaves of its own, and gives its outputs with the places of the
/// inputs that it has read.
pub type Part<'a> = Box<dyn FnOnce(Vec<Tensor>) -> (Vec<Tensor>, Vec<usize>) + Send + 'a>;

/// The graph of a part: what its gradients are computed from.
struct Graph {
    /// Outputs that hang on leaves, by their places among all outputs that do.
    outputs: Vec<(usize, Tensor)>,
    /// The leaves that it has read, by their places among the inputs of the node.
    leaves: Vec<(usize, Tensor)>,
}

/// The graphs of all parts.
struct Graphs(Vec<Graph>);

/// Tensors that several threads read.
struct Shared<'a>(&'a [Tensor]);

// SAFETY: libtorch's tensors may be read by many threads, and nobody writes to these while parts are computed.
unsafe impl Sync for Shared<'_> {}

impl Shared<'_> {
    fn all(&self) -> &[Tensor] {
        self.0
    }
}

/// The outputs of each part of a network, computed [`side_by_side`]; so are gradients. Inputs get the sum of what the parts
/// give them, in their order. Whatever else parts hold must need no gradient.
///
/// Outputs are a graph's as any; there are no second derivatives, and one backward pass at most goes through.
///
/// # Errors
/// libtorch's message.
///
/// # Panics
/// When a part does.
pub fn with_gradients(inputs: &[Tensor], parts: Vec<Part<'_>>) -> Result<Vec<Vec<Tensor>>, TorchError> {
    let with_grad = grad_enabled();
    let shared = Shared(inputs);
    let jobs = parts.into_iter().map(|part| {
        let shared = &shared;
        move || {
            let leaf = |t: &Tensor| {
                if t.defined() { t.detach().set_requires_grad(t.requires_grad()) } else { Tensor::new() }
            };
            let leaves: Vec<Tensor> = shared.all().iter().map(leaf).collect();
            let own = leaves.iter().map(Tensor::shallow_clone).collect();
            let (outputs, read) = part(own);
            (outputs, read, leaves)
        }
    });
    let found = side_by_side(jobs.collect::<Vec<_>>());
    if !with_grad {
        return Ok(found.into_iter().map(|(outputs, ..)| outputs).collect());
    }
    let mut wanted: Vec<usize> = found.iter().flat_map(|(_, read, _)| read.iter().copied()).collect();
    wanted.sort_unstable();
    wanted.dedup();
    wanted.retain(|&k| inputs[k].defined() && inputs[k].requires_grad());
    let (mut behind, mut all, mut graphs) = (Vec::new(), Vec::new(), Vec::new());
    for (outputs, _, leaves) in found {
        let mut graph = Graph { outputs: Vec::new(), leaves: Vec::new() };
        graph.leaves = wanted.iter().map(|&k| leaves[k].shallow_clone()).enumerate().collect();
        let cut = outputs.into_iter().map(|t| {
            if !t.requires_grad() {
                return t;
            }
            let cut = t.detach();
            graph.outputs.push((behind.len(), t));
            behind.push(cut.shallow_clone());
            cut
        });
        all.push(cut.collect::<Vec<_>>());
        graphs.push(graph);
    }
    if behind.is_empty() || wanted.is_empty() {
        return Ok(all);
    }
    let asked: Vec<*const C_tensor> = wanted.iter().map(|&k| inputs[k].as_ptr()).collect();
    let out: Vec<*const C_tensor> = behind.iter().map(Tensor::as_ptr).collect();
    // SAFETY: two lists of live tensors; `parts` are `Graphs` of ours, which the node hands to `forget` exactly once, on
    // whichever thread: they are `Send`.
    check(unsafe {
        let parts = Box::into_raw(Box::new(Graphs(graphs))).cast();
        rl_parts(asked.as_ptr(), asked.len(), out.as_ptr(), out.len(), go_back, forget, parts)
    })?;
    Ok(all)
}

extern "C" fn forget(parts: *mut c_void) {
    // SAFETY: made by `Box::into_raw` in `with_gradients`, and given back once.
    drop(unsafe { Box::from_raw(parts.cast::<Graphs>()) });
}

extern "C" fn go_back(
    parts: *mut c_void,
    grads: *const *mut C_tensor,
    n: usize,
    out: *mut *mut C_tensor,
    m: usize,
    message: *mut c_char,
    room: usize,
) -> c_int {
    let work = || {
        // SAFETY: the node calls with the graphs it holds, `n` live tensors or nulls and `m` places.
        let (graphs, grads, out) = unsafe {
            let grads = std::slice::from_raw_parts(grads, n).iter();
            let grads: Vec<_> = grads.map(|&t| (!t.is_null()).then(|| Tensor::clone_from_ptr(t))).collect();
            (&mut *parts.cast::<Graphs>(), grads, std::slice::from_raw_parts_mut(out, m))
        };
        let jobs: Vec<_> = std::mem::take(&mut graphs.0)
            .into_iter()
            .map(|graph| {
                let seeds = graph.outputs.iter().map(|(k, _)| grads.get(*k)?.as_ref().map(Tensor::shallow_clone));
                let seeds: Vec<Option<Tensor>> = seeds.collect();
                move || graph.gradients(seeds)
            })
            .collect();
        let mut sums: Vec<Option<Tensor>> = (0..m).map(|_| None).collect();
        for found in side_by_side(jobs) {
            let (mut earlier, mut later) = (Vec::new(), Vec::new());
            for (place, gradient) in found? {
                match &sums[place] {
                    Some(sum) => {
                        earlier.push(sum.shallow_clone());
                        later.push(gradient);
                    }
                    None => sums[place] = Some(gradient),
                }
            }
            // Gradients of parts are nobody else's.
            foreach_add(&earlier, &later, 1.0)?;
        }
        for (place, sum) in out.iter_mut().zip(sums) {
            // The node takes it over.
            *place = sum.map_or(null_mut(), |sum| ManuallyDrop::new(sum).as_mut_ptr());
        }
        Ok::<(), TorchError>(())
    };
    let text = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(())) => return 0,
        Ok(Err(error)) => error.0,
        Err(panic) => format!("a part panicked in its backward pass: {}", said(&*panic)),
    };
    let bytes: Vec<u8> = text.bytes().filter(|b| *b != 0).take(room.saturating_sub(1)).collect();
    // SAFETY: `room` bytes at `message`, which were zero.
    unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), message.cast::<u8>(), bytes.len()) };
    1
}

impl Graph {
    /// Gradients of leaves by their places, from those of its outputs, where these have some; they are in single precision
    /// where others would be in bfloat16, so that sums keep what comes later.
    fn gradients(self, seeds: Vec<Option<Tensor>>) -> Result<Vec<(usize, Tensor)>, TorchError> {
        let roots: Vec<(&Tensor, &Tensor)> =
            self.outputs.iter().zip(&seeds).filter_map(|((_, t), seed)| Some((t, seed.as_ref()?))).collect();
        if roots.is_empty() {
            return Ok(Vec::new());
        }
        let pointers = |all: &mut dyn Iterator<Item = &Tensor>| all.map(Tensor::as_ptr).collect::<Vec<_>>();
        let outputs = pointers(&mut roots.iter().map(|(t, _)| *t));
        let grads = pointers(&mut roots.iter().map(|(_, seed)| *seed));
        let leaves = pointers(&mut self.leaves.iter().map(|(_, t)| t));
        let mut out = vec![null_mut(); leaves.len()];
        // SAFETY: lists of live tensors as long as they are said to be, and as many places as leaves.
        check(unsafe {
            let (n, m) = (outputs.len(), leaves.len());
            rl_gradients(outputs.as_ptr(), grads.as_ptr(), n, leaves.as_ptr(), m, out.as_mut_ptr())
        })?;
        // They are added to: what is another's, as the gradient of a sum is that of all its terms, is copied.
        let mut others: HashSet<usize> = roots.iter().map(|(_, seed)| seed.data_ptr() as usize).collect();
        let given = self.leaves.iter().zip(out).filter(|(_, t)| !t.is_null()).map(|((place, _), t)| {
            // SAFETY: made by `new` for the caller.
            let t = unsafe { Tensor::from_ptr(t) };
            let t = if t.kind() == Kind::BFloat16 { t.to_kind(Kind::Float) } else { t };
            let own = others.insert(t.data_ptr() as usize) && t.is_contiguous();
            (*place, if own { t } else { t.copy() })
        });
        Ok(given.collect())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{MutexGuard, PoisonError};

    use super::*;
    use crate::{count_flops, dropout};

    fn leaf(shape: &[i64], kind: Kind) -> Tensor {
        Tensor::randn(shape, (Kind::Float, Device::Cpu)).to_kind(kind).set_requires_grad(true)
    }

    /// Rows x through a layer and a second output of them.
    fn layer(t: &[Tensor], x: &Tensor) -> Vec<Tensor> {
        let y = x.to_kind(t[0].kind()).linear(&t[0], None::<&Tensor>).tanh();
        vec![y.linear(&t[1], None::<&Tensor>).to_kind(Kind::Float), y.square().mean_dim([1i64].as_slice(), false, None)]
    }

    fn parts_of(x: &Tensor, n: i64) -> Vec<Part<'static>> {
        let part = |x: Tensor| -> Part<'static> { Box::new(move |t| (layer(&t, &x), vec![0, 1])) };
        x.chunk(n, 0).into_iter().map(part).collect()
    }

    /// A loss that looks at all rows at once.
    fn loss(outputs: &[Tensor]) -> Tensor {
        outputs[0].square().mean(Kind::Float).log() + outputs[1].to_kind(Kind::Float).std(true)
    }

    fn joined(of: &[Vec<Tensor>]) -> Vec<Tensor> {
        (0..of[0].len()).map(|k| Tensor::cat(&of.iter().map(|own| &own[k]).collect::<Vec<_>>(), 0)).collect()
    }

    /// Parts count along where any thread counts: no test of them while another test does.
    fn uncounted() -> MutexGuard<'static, ()> {
        crate::flops::COUNTED.lock().unwrap_or_else(PoisonError::into_inner)
    }

    #[test]
    fn parts_give_what_the_whole_does_with_its_gradients() {
        let _alone = uncounted();
        tch::manual_seed(5);
        for kind in [Kind::Float, Kind::BFloat16] {
            let leaves = [leaf(&[12, 8], kind), leaf(&[4, 12], kind), leaf(&[3], kind)];
            let x = Tensor::randn([9, 8], (Kind::Float, Device::Cpu));
            let whole = layer(&leaves, &x);
            let want = Tensor::run_backward(&[loss(&whole)], &leaves[..2], false, false);
            for n in [1, 2, 3, 5] {
                let found = with_gradients(&leaves, parts_of(&x, n)).unwrap();
                let found = joined(&found);
                let near = |a: &Tensor, b: &Tensor, most: f64| {
                    let (a, b) = (a.to_kind(Kind::Double), b.to_kind(Kind::Double));
                    assert!(((a - &b).abs().max() / b.abs().max()).double_value(&[]) < most, "{kind:?} {n}");
                };
                let most = if kind == Kind::Float { 1e-5 } else { 0.03 };
                found.iter().zip(&whole).for_each(|(a, b)| near(a, b, most));
                let grads = Tensor::run_backward(&[loss(&found)], &leaves, false, false);
                assert_eq!((grads[0].kind(), grads[2].defined()), (kind, false), "nobody read it");
                grads.iter().zip(&want).for_each(|(a, b)| near(a, b, most));
            }
        }
    }

    #[test]
    fn gradients_that_are_shared_are_not_added_to_twice() {
        let _alone = uncounted();
        let leaves = [leaf(&[3], Kind::Float), leaf(&[3], Kind::Float), leaf(&[], Kind::Float)];
        let part = |k: f64| -> Part<'static> {
            // Both leaves have the gradient of the sum; that of the last is expanded on its way.
            Box::new(move |t| (vec![&t[0] + &t[1], (t[2].expand([3], false) * k), t[0].shallow_clone()], vec![0, 1, 2]))
        };
        let found = with_gradients(&leaves, vec![part(1.0), part(2.0), part(4.0)]).unwrap();
        let all: Tensor = found.into_iter().flatten().map(|t| t.sum(Kind::Float)).sum();
        let grads = Tensor::run_backward(&[all], &leaves, false, false);
        let numbers = |t: &Tensor| Vec::<f32>::try_from(t.view([-1])).unwrap();
        assert_eq!(grads.iter().map(numbers).collect::<Vec<_>>(), [vec![6.0; 3], vec![3.0; 3], vec![21.0]]);
    }

    #[test]
    fn the_same_bits_on_any_number_of_threads_and_each_time() {
        let _alone = uncounted();
        tch::manual_seed(6);
        let leaves = [leaf(&[32, 64], Kind::Float), leaf(&[16, 32], Kind::Float)];
        let x = Tensor::randn([300, 64], (Kind::Float, Device::Cpu));
        let pass = |threads: i32| {
            let before = tch::get_num_threads();
            tch::set_num_threads(threads);
            let found = joined(&with_gradients(&leaves, parts_of(&x, 3)).unwrap());
            assert_eq!(tch::get_num_threads(), threads);
            let grads = Tensor::run_backward(&[found[0].square().sum(Kind::Float)], &leaves, false, false);
            assert_eq!(tch::get_num_threads(), threads);
            tch::set_num_threads(before);
            found.into_iter().chain(grads).collect::<Vec<_>>()
        };
        let first = pass(3);
        for threads in [1, 2, 3, 3] {
            assert!(pass(threads).iter().zip(&first).all(|(a, b)| a.equal(b)));
        }
    }

    #[test]
    fn draws_and_the_state_of_gradients_are_the_callers() {
        let _alone = uncounted();
        let x = Tensor::ones([64], (Kind::Float, Device::Cpu));
        let draw = || {
            tch::manual_seed(9);
            let jobs = (0..3).map(|_| {
                let x = x.shallow_clone();
                move || (dropout(&x, 0.5).unwrap(), grad_enabled())
            });
            side_by_side(jobs.collect::<Vec<_>>())
        };
        let (a, b) = (draw(), tch::no_grad(draw));
        assert!(a.iter().zip(&b).all(|((a, with), (b, without))| a.equal(b) && *with && !without));
        assert!(!a[0].0.equal(&a[1].0) && !a[1].0.equal(&a[2].0));
    }

    #[test]
    fn without_gradients_there_is_no_graph() {
        let _alone = uncounted();
        let leaves = [leaf(&[12, 8], Kind::Float), leaf(&[4, 12], Kind::Float)];
        let x = Tensor::randn([9, 8], (Kind::Float, Device::Cpu));
        let found = tch::no_grad(|| with_gradients(&leaves, parts_of(&x, 2)).unwrap());
        assert!(found.iter().flatten().all(|t| !t.requires_grad()));
        let fixed = leaves.each_ref().map(Tensor::detach);
        assert!(with_gradients(&fixed, parts_of(&x, 2)).unwrap().iter().flatten().all(|t| !t.requires_grad()));
        assert!(with_gradients(&leaves, Vec::new()).unwrap().is_empty());
    }

    #[test]
    fn a_second_pass_is_refused_and_panics_come_back() {
        let _alone = uncounted();
        let leaves = [leaf(&[12, 8], Kind::Float), leaf(&[4, 12], Kind::Float)];
        let x = Tensor::randn([9, 8], (Kind::Float, Device::Cpu));
        let found = joined(&with_gradients(&leaves, parts_of(&x, 2)).unwrap());
        let sum = found[0].sum(Kind::Float);
        assert!(Tensor::f_run_backward(&[&sum], &leaves, false, false).is_ok());
        assert!(Tensor::f_run_backward(&[&sum], &leaves, false, false).is_err());
        let found = joined(&with_gradients(&leaves, parts_of(&x, 2)).unwrap());
        let error = Tensor::f_run_backward(&[found[0].sum(Kind::Float)], &leaves, true, true).unwrap_err();
        assert!(TorchError::from(error).to_string().contains("no second derivative"));
        let fell = catch_unwind(AssertUnwindSafe(|| {
            let part = |k: usize| -> Part<'static> {
                Box::new(move |t| if k == 1 { panic!("no more") } else { (vec![t[0].exp()], vec![0]) })
            };
            with_gradients(&leaves, vec![part(0), part(1)])
        }));
        assert_eq!(*fell.unwrap_err().downcast::<&str>().unwrap(), "no more");
    }

    #[test]
    fn products_of_all_parts_are_counted() {
        let _alone = uncounted();
        let leaves = [leaf(&[12, 8], Kind::Float), leaf(&[4, 12], Kind::Float)];
        let x = Tensor::randn([10, 8], (Kind::Float, Device::Cpu));
        let pass = |n: i64| {
            let pass = || {
                let found = joined(&with_gradients(&leaves, parts_of(&x, n)).unwrap());
                Tensor::run_backward(&[found[0].sum(Kind::Float)], &leaves, false, false)
            };
            count_flops(pass).unwrap().1
        };
        assert_eq!(pass(2), pass(1));
        assert!(pass(1) > 0);
    }
}

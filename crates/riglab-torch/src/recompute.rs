//! Blocks that are computed again in the backward pass (activation checkpointing).

use std::mem::ManuallyDrop;
use std::os::raw::{c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};

use tch::{Device, Tensor};
use torch_sys::C_tensor;

use crate::error::{TorchError, check, said};
use crate::settings::{rng_state, set_rng_state};

type Again =
    extern "C" fn(*mut c_void, *const *mut C_tensor, usize, *mut *mut C_tensor, usize, *mut c_char, usize) -> c_int;

unsafe extern "C" {
    fn rl_grad_enabled() -> c_int;
    fn rl_recompute(
        read: *const *const C_tensor,
        n: usize,
        out: *const *const C_tensor,
        made: usize,
        again: Again,
        forget: extern "C" fn(*mut c_void),
        block: *mut c_void,
    ) -> c_int;
}

/// Whether what this thread computes now keeps what gradients need.
pub fn grad_enabled() -> bool {
    // SAFETY: reads a flag of the thread.
    unsafe { rl_grad_enabled() != 0 }
}

/// What a block computes again.
type Compute = dyn Fn(&[Tensor]) -> Vec<Tensor> + Send;

/// A block as its node holds it.
struct Block {
    compute: Box<Compute>,
    /// The device's generator as the block found it, if it drew.
    generator: Option<(Device, Vec<u8>)>,
}

/// What `first` gives, with a backward pass that computes it again by `again`: between the passes only what was read is
/// held, not what was made of it on the way (Chen et al. 2016).
///
/// `first` runs once, without gradients, and gives the outputs and the parameters that it read, which a network may find
/// while it runs; it may note in `block` what `again` has to know. `again` is handed the block and `inputs` and these
/// parameters in one list, cut off from where they come from, and must give the same outputs. Gradients reach the inputs
/// and the parameters. Whatever else the closures hold must need no gradient: the backward pass fails if it does. What
/// the generator of the inputs' device gave the block ([`crate::dropout`]), it gives again.
///
/// The block goes with the graph: after the backward pass, or with the outputs if there is none. Where gradients are
/// off, or nothing needs one, only `first` runs.
///
/// # Errors
/// libtorch's message. A panic of `again` ends the backward pass with an error (`Tensor::f_run_backward`).
pub fn recompute<B: Send + 'static>(
    inputs: &[&Tensor],
    mut block: B,
    first: impl FnOnce(&mut B) -> (Vec<Tensor>, Vec<Tensor>),
    again: impl Fn(&B, &[Tensor]) -> Vec<Tensor> + Send + 'static,
) -> Result<Vec<Tensor>, TorchError> {
    if !grad_enabled() {
        return Ok(first(&mut block).0);
    }
    let device = inputs.first().map_or(Device::Cpu, |x| x.device());
    let before = rng_state(device)?;
    let (out, params) = tch::no_grad(|| first(&mut block));
    let generator = (rng_state(device)? != before).then_some((device, before));
    let block = Box::new(Block { compute: Box::new(move |read| again(&block, read)), generator });
    let read: Vec<*const C_tensor> = inputs.iter().copied().chain(&params).map(Tensor::as_ptr).collect();
    let slots: Vec<*const C_tensor> = out.iter().map(Tensor::as_ptr).collect();
    // SAFETY: two lists of live tensors; `block` is a `Block` of ours, which the node hands to `forget` exactly once,
    // on whichever thread: it is `Send`.
    check(unsafe {
        let block = Box::into_raw(block).cast();
        rl_recompute(read.as_ptr(), read.len(), slots.as_ptr(), slots.len(), compute_again, forget, block)
    })?;
    Ok(out)
}

extern "C" fn forget(block: *mut c_void) {
    // SAFETY: made by `Box::into_raw` in `recompute`, and given back once.
    let block = unsafe { Box::from_raw(block.cast::<Block>()) };
    // What a closure holds may panic when dropped; that must not reach C++.
    let _ = catch_unwind(AssertUnwindSafe(|| drop(block)));
}

extern "C" fn compute_again(
    block: *mut c_void,
    read: *const *mut C_tensor,
    n: usize,
    out: *mut *mut C_tensor,
    made: usize,
    message: *mut c_char,
    room: usize,
) -> c_int {
    let work = || {
        // SAFETY: the node calls with the block it holds, `n` live tensors and `made` places.
        let (block, read, out) = unsafe {
            let read = std::slice::from_raw_parts(read, n).iter().map(|&t| Tensor::clone_from_ptr(t));
            (&*block.cast::<Block>(), read.collect::<Vec<_>>(), std::slice::from_raw_parts_mut(out, made))
        };
        let tensors = block.again(&read)?;
        if tensors.len() != made {
            return Err(format!("a block gave {made} tensors first and {} again", tensors.len()));
        }
        for (place, tensor) in out.iter_mut().zip(tensors) {
            // The node takes it over.
            *place = ManuallyDrop::new(tensor).as_mut_ptr();
        }
        Ok(())
    };
    let text = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(())) => return 0,
        Ok(Err(text)) => text,
        Err(panic) => format!("a block panicked when it was computed again: {}", said(&*panic)),
    };
    let bytes: Vec<u8> = text.bytes().filter(|b| *b != 0).take(room.saturating_sub(1)).collect();
    // SAFETY: `room` bytes at `message`, which were zero.
    unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), message.cast::<u8>(), bytes.len()) };
    1
}

impl Block {
    fn again(&self, read: &[Tensor]) -> Result<Vec<Tensor>, String> {
        let Some((device, state)) = &self.generator else { return Ok((self.compute)(read)) };
        let now = rng_state(*device).map_err(|e| e.to_string())?;
        set_rng_state(*device, state).map_err(|e| e.to_string())?;
        let out = (self.compute)(read);
        set_rng_state(*device, &now).map_err(|e| e.to_string())?;
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tch::{Device, Kind};

    use super::*;

    fn of(shape: &[i64], kind: Kind) -> Tensor {
        Tensor::randn(shape, (Kind::Float, Device::Cpu)).to_kind(kind).set_requires_grad(true)
    }

    /// x + W₂ gelu(W₁ x), with W₁ used twice.
    fn layer(t: &[Tensor]) -> Vec<Tensor> {
        let inner = t[0].linear(&t[1], None::<&Tensor>).gelu("none").linear(&t[1].transpose(0, 1), None::<&Tensor>);
        vec![&t[0] + inner.linear(&t[2], None::<&Tensor>)]
    }

    fn twice(x: &Tensor, params: &[&Tensor], f: impl Fn(&[Tensor]) -> Vec<Tensor> + Send + 'static) -> Tensor {
        let params: Vec<Tensor> = params.iter().map(|p| p.shallow_clone()).collect();
        let all: Vec<Tensor> = std::iter::once(x).chain(&params).map(Tensor::shallow_clone).collect();
        recompute(&[x], f, |f| (f(&all), params), |f, t| f(t)).unwrap().remove(0)
    }

    fn gradients(out: &Tensor, of: &[&Tensor]) -> Vec<Tensor> {
        let loss = out.to_kind(Kind::Float).square().sum(Kind::Float);
        Tensor::f_run_backward(&[loss], of, false, false).unwrap()
    }

    fn same(a: &[Tensor], b: &[Tensor]) -> bool {
        a.iter().zip(b).all(|(a, b)| a.kind() == b.kind() && a.equal(b))
    }

    #[test]
    fn outputs_and_gradients_are_those_of_the_plain_pass() {
        for kind in [Kind::Float, Kind::BFloat16] {
            tch::manual_seed(7);
            let (x, a, b, c) = (of(&[5, 16], kind), of(&[32, 16], kind), of(&[16, 16], kind), of(&[16, 16], kind));
            let leaves = [&x, &a, &b, &c];
            let plain =
                |x: &Tensor, b: &Tensor| layer(&[x.shallow_clone(), a.shallow_clone(), b.shallow_clone()]).remove(0);
            let want = plain(&plain(&x, &b), &c);
            let got = twice(&twice(&x, &[&a, &b], layer), &[&a, &c], layer);
            assert!(got.equal(&want));
            // `a` is a parameter of both blocks, and used twice in each. What both give is added up once, where the
            // plain pass adds four terms: the order is another.
            let (got, want) = (gradients(&got, &leaves), gradients(&want, &leaves));
            let but_a = |g: &[Tensor]| [0, 2, 3].map(|k| g[k].shallow_clone());
            assert!(same(&but_a(&got), &but_a(&want)));
            let off = ((&got[1] - &want[1]).to_kind(Kind::Float).norm() / want[1].to_kind(Kind::Float).norm())
                .double_value(&[]);
            assert!(off < if kind == Kind::Float { 1e-6 } else { 1e-2 }, "{off}");
        }
    }

    #[test]
    fn blocks_may_hold_blocks_and_only_asked_gradients_come() {
        tch::manual_seed(3);
        let (x, a, b) = (of(&[5, 16], Kind::Float), of(&[32, 16], Kind::Float), of(&[16, 16], Kind::Float));
        let outer = |t: &[Tensor]| vec![twice(&t[0], &[&t[1], &t[2]], layer).sin()];
        let got = twice(&x, &[&a, &b], outer);
        let want = layer(&[x.shallow_clone(), a.shallow_clone(), b.shallow_clone()]).remove(0).sin();
        assert!(got.equal(&want));
        let asked = [&b, &x];
        let (got, want) = (gradients(&got, &asked), gradients(&want, &asked));
        assert!(same(&got, &want));
        let fixed = of(&[5, 16], Kind::Float).detach();
        let grads = gradients(&twice(&fixed, &[&a, &b], layer), &[&a, &b]);
        let want = gradients(&layer(&[fixed, a.shallow_clone(), b.shallow_clone()])[0], &[&a, &b]);
        assert!(same(&grads, &want));
    }

    #[test]
    fn closures_go_with_the_graph() {
        let (x, held) = (of(&[4], Kind::Float), Arc::new(()));
        let block = || {
            let held = held.clone();
            twice(&x, &[], move |t| {
                let _ = &held;
                vec![t[0].exp()]
            })
        };
        let out = block();
        assert_eq!(Arc::strong_count(&held), 2);
        drop(out);
        assert_eq!(Arc::strong_count(&held), 1, "no backward pass ran");
        let out = block().sum(Kind::Float);
        let _ = Tensor::run_backward(&[&out], &[&x], false, false);
        assert_eq!(Arc::strong_count(&held), 1, "the backward pass has let it go");
        assert!(Tensor::f_run_backward(&[&out], &[&x], false, false).is_err());
        let _ = tch::no_grad(block);
        let fixed = x.detach();
        let counted = held.clone();
        let _ = twice(&fixed, &[], move |t| {
            let _ = &counted;
            vec![t[0].exp()]
        });
        assert_eq!(Arc::strong_count(&held), 1, "no gradient is needed");
    }

    #[test]
    fn faults_of_a_block_end_the_backward_pass_with_an_error() {
        let (x, other) = (of(&[4], Kind::Float), of(&[4], Kind::Float));
        let fault = |again: Box<Compute>| {
            let out = recompute(&[&x], again, |_| (vec![x.exp()], vec![]), |again, t| again(t)).unwrap().remove(0);
            let error = Tensor::f_run_backward(&[out.sum(Kind::Float)], &[&x], false, false).unwrap_err();
            TorchError::from(error).to_string()
        };
        assert!(fault(Box::new(|_| panic!("no more"))).contains("panicked when it was computed again: no more"));
        assert!(fault(Box::new(|_| vec![])).contains("1 tensors first and 0 again"));
        // Its gradient would be lost.
        let text = fault(Box::new(move |t| vec![t[0].exp() * &other]));
        assert!(text.contains("was not handed in"), "{text}");
    }

    #[test]
    fn an_output_may_be_an_input() {
        let x = of(&[4], Kind::Float);
        let out = twice(&x, &[], |t| vec![t[0].shallow_clone(), t[0].ge(0.0)]);
        let grads = Tensor::run_backward(&[(out * 3.0).sum(Kind::Float)], &[&x], false, false);
        assert!(grads[0].equal(&x.full_like(3.0)));
    }
}

//! Gradients as they come.

use std::os::raw::{c_int, c_uint, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use tch::Tensor;
use torch_sys::C_tensor;

use crate::TorchError;
use crate::error::check;

type Told = extern "C" fn(*mut c_void, usize, *mut C_tensor) -> c_int;

unsafe extern "C" {
    fn rl_hook(leaf: *mut C_tensor, index: usize, told: Told, context: *mut c_void, handle: *mut c_uint) -> c_int;
    fn rl_unhook(leaf: *mut C_tensor, handle: c_uint) -> c_int;
}

/// The backward pass from a loss; `told` gets the gradient of a leaf, by its place, as soon as it is complete, while the
/// pass goes on. Leaves that the loss does not depend on, or that need no gradient, are not told of. The leaves should be
/// made for this pass: a tensor keeps an empty place for each hook that it ever had.
///
/// # Errors
/// libtorch's message.
///
/// # Panics
/// When `told` does.
pub fn backward(loss: &Tensor, leaves: &[Tensor], told: &mut dyn FnMut(usize, Tensor)) -> Result<(), TorchError> {
    if !loss.requires_grad() {
        return Ok(());
    }
    let mut listener = Listener { told, panic: None };
    let hooks = Hooks::set(leaves, &raw mut listener)?;
    let asked: Vec<&Tensor> = leaves.iter().filter(|leaf| leaf.requires_grad()).collect();
    let ended = Tensor::f_run_backward(&[loss], &asked, false, false);
    drop(hooks);
    if let Some(panic) = listener.panic {
        resume_unwind(panic);
    }
    ended.map(drop).map_err(TorchError::from)
}

struct Listener<'a> {
    told: &'a mut dyn FnMut(usize, Tensor),
    panic: Option<Box<dyn std::any::Any + Send>>,
}

extern "C" fn tell(context: *mut c_void, index: usize, gradient: *mut C_tensor) -> c_int {
    // SAFETY: the listener of `backward`, which outlives its hooks. A pass tells of one gradient at a time, and where it
    // goes on in a thread of libtorch's own (other devices than the CPU), the caller's waits for it.
    let listener = unsafe { &mut *context.cast::<Listener>() };
    let call = AssertUnwindSafe(|| {
        // SAFETY: a live tensor, of which this makes another handle.
        let gradient = unsafe { Tensor::clone_from_ptr(gradient) };
        (listener.told)(index, gradient);
    });
    match catch_unwind(call) {
        Ok(()) => 0,
        Err(panic) => {
            listener.panic = Some(panic);
            1
        }
    }
}

/// Hooks on leaves, taken off again when this goes.
struct Hooks<'a>(Vec<(&'a Tensor, c_uint)>);

impl<'a> Hooks<'a> {
    fn set(leaves: &'a [Tensor], listener: *mut Listener<'_>) -> Result<Self, TorchError> {
        let mut hooks = Self(Vec::with_capacity(leaves.len()));
        for (index, leaf) in leaves.iter().enumerate().filter(|(_, leaf)| leaf.requires_grad()) {
            let mut handle = 0;
            // SAFETY: a live leaf; the handle outlives the call, the listener the hook.
            check(unsafe { rl_hook(leaf.as_ptr().cast_mut(), index, tell, listener.cast(), &raw mut handle) })?;
            hooks.0.push((leaf, handle));
        }
        Ok(hooks)
    }
}

impl Drop for Hooks<'_> {
    fn drop(&mut self) {
        for &(leaf, handle) in &self.0 {
            // SAFETY: a live leaf with a hook of this handle.
            let _ = unsafe { rl_unhook(leaf.as_ptr().cast_mut(), handle) };
        }
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;

    fn leaf(values: &[f32]) -> Tensor {
        Tensor::from_slice(values).set_requires_grad(true)
    }

    #[test]
    fn each_gradient_is_told_once_complete_and_the_last_used_first() {
        let leaves = [leaf(&[2.0]), leaf(&[3.0]), leaf(&[5.0]), leaf(&[1.0]).set_requires_grad(false)];
        let [a, b, _unused, fixed] = &leaves;
        // a is used twice: it is told of when both parts are there.
        let loss = ((a * b).exp().log() + a * fixed).sum(Kind::Float);
        let mut told = Vec::new();
        backward(&loss, &leaves, &mut |k, g| told.push((k, g.double_value(&[0]).round()))).unwrap();
        told.sort_by_key(|t| t.0);
        assert_eq!(told, [(0, 4.0), (1, 2.0)]);
        backward(&fixed.sum(Kind::Float), &leaves, &mut |k, _| panic!("{k} has no part in it")).unwrap();
        let deep: Vec<Tensor> = (0..4).map(|_| leaf(&[1.0])).collect();
        let loss = deep.iter().fold(Tensor::ones([1], (Kind::Float, Device::Cpu)), |x, w| (x * w).tanh());
        let mut order = Vec::new();
        backward(&loss.sum(Kind::Float), &deep, &mut |k, _| order.push(k)).unwrap();
        assert_eq!(order, [3, 2, 1, 0]);
    }

    #[test]
    fn hooks_are_gone_after_the_pass_and_a_panic_comes_back() {
        let leaves = [leaf(&[2.0])];
        let pass = |told: &mut dyn FnMut(usize, Tensor)| backward(&leaves[0].square(), &leaves, told);
        let fell = catch_unwind(AssertUnwindSafe(|| pass(&mut |_, _| panic!("no more"))));
        assert_eq!(*fell.unwrap_err().downcast::<&str>().unwrap(), "no more");
        let mut times = 0;
        pass(&mut |_, _| times += 1).unwrap();
        pass(&mut |_, _| {}).unwrap();
        assert_eq!(times, 1);
    }
}

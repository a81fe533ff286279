//! Process-wide settings of libtorch.

use std::ffi::CStr;
use std::os::raw::{c_char, c_int};
use std::path::PathBuf;
use std::sync::{Once, OnceLock};

use tch::Device;

use crate::TorchError;
use crate::error::check;

unsafe extern "C" {
    fn rl_autocast_cpu(enabled: c_int, before: *mut c_int) -> c_int;
    fn rl_configure(deterministic: c_int, flush_denormal: c_int) -> c_int;
    fn rl_rng_get(gpu: c_int, out: *mut u8, room: usize, size: *mut usize) -> c_int;
    fn rl_rng_set(gpu: c_int, bytes: *const u8, size: usize) -> c_int;
    fn rl_rng_own(seed: u64) -> c_int;
    fn rl_keep_memory(most: usize) -> c_int;
    fn rl_cpu_capability() -> *const c_char;
    fn rl_version() -> *const c_char;
}

/// Bytes of freed tensors that are kept for the next ones at most. A step makes the same tensors as the one before; the
/// system would have to clear their pages anew.
const KEPT: usize = 512 << 20;

/// Memory in GB by a field of Linux' /proc/meminfo, such as `MemTotal`; `None` where the system does not say.
pub fn memory_gb(field: &str) -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(field)?.strip_prefix(':'))?;
    // The kernel's "kB" are 1024 bytes.
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? * 1.024 / 1e6)
}

/// What [`init`] sets.
#[derive(Clone, Copy, Debug, Default)]
pub struct Settings {
    /// Threads within an op; 0 for the number of processors this process may use.
    pub threads: usize,
}

/// Switches that libtorch reads once, where the environment does not set them.
///
/// Products in bfloat16 have a kernel for each shape, and a thousand of them are kept at two places. Where
/// sequences are of all lengths hardly any is used again: a step of UniRig's small skeleton model grew from 0.6
/// to 1.4 GB within 80 steps, where 256 of each end at 0.8 GB, with the same processor time.
///
/// The last lets cuBLAS compute the same bits in every run.
const SWITCHES: [(&str, &str); 4] = [
    ("THP_MEM_ALLOC_ENABLE", "1"),
    ("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "256"),
    ("LRU_CACHE_CAPACITY", "256"),
    ("CUBLAS_WORKSPACE_CONFIG", ":4096:8"),
];

/// Prepares libtorch; only the first call counts. Call it before any tensor is made and before any
/// thread is started.
///
/// Besides threads: huge pages for large tensors (5 to 9 % of a step), memory that is kept for the next tensor rather than
/// given back (`memory.cpp`), few kernels kept, denormals flushed to zero (they slow sums of tiny gradients down by an order
/// of magnitude), deterministic algorithms; as many threads, and two at least, for what is computed beside libtorch.
/// Gives the number of threads.
pub fn init(settings: Settings) -> usize {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        for (switch, value) in SWITCHES {
            if std::env::var_os(switch).is_none() {
                // SAFETY: called before other threads exist, as documented.
                unsafe { std::env::set_var(switch, value) };
            }
        }
        // SAFETY: a plain number; no tensor was made yet.
        let code = unsafe { rl_keep_memory(KEPT) };
        debug_assert_eq!(code, 0);
        let threads = match settings.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            n => n,
        };
        tch::set_num_threads(threads as i32);
        bound_rayon(threads);
        // One graph runs at a time: threads between ops would only compete.
        tch::set_num_interop_threads(1);
        // SAFETY: plain values.
        let code = unsafe { rl_configure(1, 1) };
        debug_assert_eq!(code, 0);
    });
    tch::get_num_threads() as usize
}

/// Lets rayon, which samples sequences and prepares assets, start no more threads than were asked for: of a sweep's jobs each
/// would start as many as there are processors. It has two at least: loaders prepare beside the step, on threads of their own,
/// and share rayon's. A pool that is there already is left alone.
fn bound_rayon(threads: usize) {
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads.max(2)).build_global();
}

/// Starts the program anew with threads that wait patiently, unless the environment says how they are
/// to wait. Call it first thing in a program that will compute on several threads.
///
/// Between the parts of an op, OpenMP's threads spin for milliseconds. With a core each that is the
/// fastest way; when another program wants one of the cores, most of the time is spent spinning (a
/// small network trained at 0.3 instead of 5 steps a second beside two busy programs). GNU's OpenMP
/// reads the switch when the library is loaded, which is before `main`, hence the new start.
pub fn wait_patiently() {
    const SPIN: &str = "GOMP_SPINCOUNT";
    if [SPIN, "OMP_WAIT_POLICY"].iter().any(|name| std::env::var_os(name).is_some()) {
        return;
    }
    if let Ok(program) = std::env::current_exe() {
        use std::os::unix::process::CommandExt;
        // Only a failure returns, and then all goes on as it would have.
        let failed = std::process::Command::new(program).args(std::env::args_os().skip(1)).env(SPIN, "1000").exec();
        drop(failed);
    }
}

/// Whether the processor multiplies in bfloat16 itself: told by what it has, so that results do not hang on how busy it is.
pub fn has_bf16() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        is_x86_feature_detected!("avx512bf16")
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        false
    }
}

/// Whether products of matrices in bfloat16 take less time than in f32 on this processor: told by what it is, so that
/// results do not hang on how busy it is. Without AMX Intel's have a unit for them that is as fast as f32's two, and MKL
/// is better at f32 (a third to half of the time more in bfloat16, Xeon of the sixth generation); AMD's have twice as fast
/// ones. AMX counts where the system keeps its registers, as Linux does since 5.16.
pub fn multiplies_bf16() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{__cpuid, __cpuid_count, _xgetbv};
        const AMX_BF16: u32 = 1 << 22;
        const TILES: u64 = 0b11 << 17;
        // In a virtual machine it takes a while to ask.
        static FOUND: OnceLock<bool> = OnceLock::new();
        *FOUND.get_or_init(|| {
            if !has_bf16() {
                return false;
            }
            // Every processor with AVX-512 knows leaf 7.
            // SAFETY: every processor of this kind tells what it is, and one whose AVX-512 the system lets programs use tells
            // what the system keeps.
            #[allow(unused_unsafe)] // of `__cpuid`, before Rust 1.94
            let (name, features, kept) = unsafe { (__cpuid(0).ecx, __cpuid_count(7, 0).edx, _xgetbv(0)) };
            let (amd, amx) = (name == u32::from_le_bytes(*b"cAMD"), features & AMX_BF16 != 0 && kept & TILES == TILES);
            amd || amx
        })
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        false
    }
}

/// While it lives, CPU ops of this thread compute in bfloat16 where libtorch thinks it safe.
///
/// tch's own `autocast` only reaches CUDA.
pub struct Autocast {
    // Not Send: the switch belongs to a thread.
    _thread: std::marker::PhantomData<*const ()>,
}

impl Autocast {
    /// Switches autocast on.
    ///
    /// # Errors
    /// libtorch's message, if it refuses.
    pub fn bf16() -> Result<Self, TorchError> {
        let mut before = 0;
        // SAFETY: `before` outlives the call.
        check(unsafe { rl_autocast_cpu(1, &mut before) })?;
        Ok(Self { _thread: std::marker::PhantomData })
    }
}

impl Drop for Autocast {
    fn drop(&mut self) {
        let mut before = 0;
        // SAFETY: as above; switching off does not fail.
        unsafe { rl_autocast_cpu(0, &mut before) };
    }
}

/// Gives this thread a CPU generator of its own, for what this crate draws ([`crate::dropout`]) and what
/// [`crate::recompute`] puts back: it gives what libtorch's would, seeded alike, whatever other threads draw meanwhile.
/// What libtorch itself draws is still everybody's.
///
/// # Errors
/// libtorch's message, if it refuses.
pub fn own_generator(seed: u64) -> Result<(), TorchError> {
    // SAFETY: a plain value.
    check(unsafe { rl_rng_own(seed) })
}

/// The state of the generator that a device draws from: of the CPU this thread's own ([`own_generator`]), or libtorch's.
///
/// # Errors
/// libtorch's message, if it refuses.
pub fn rng_state(of: Device) -> Result<Vec<u8>, TorchError> {
    let mut size = 0;
    // SAFETY: no room is claimed, so nothing is written.
    check(unsafe { rl_rng_get(gpu(of), std::ptr::null_mut(), 0, &mut size) })?;
    let mut bytes = vec![0; size];
    // SAFETY: `bytes` has the room claimed.
    check(unsafe { rl_rng_get(gpu(of), bytes.as_mut_ptr(), bytes.len(), &mut size) })?;
    Ok(bytes)
}

/// Sets what [`rng_state`] gives.
///
/// # Errors
/// libtorch's message, for bytes that are no state.
pub fn set_rng_state(of: Device, bytes: &[u8]) -> Result<(), TorchError> {
    // SAFETY: pointer and length belong together.
    check(unsafe { rl_rng_set(gpu(of), bytes.as_ptr(), bytes.len()) })
}

/// The number of a GPU; -1 for what is none.
fn gpu(device: Device) -> c_int {
    if let Device::Cuda(number) = device { number as c_int } else { -1 }
}

/// The instruction set libtorch chose: `AVX512`, `AVX2`, ...
pub fn cpu_capability() -> String {
    // SAFETY: a static string.
    unsafe { CStr::from_ptr(rl_cpu_capability()) }.to_string_lossy().into_owned()
}

/// The version of the libtorch this was compiled against.
pub fn libtorch_version() -> String {
    // SAFETY: a static string.
    unsafe { CStr::from_ptr(rl_version()) }.to_string_lossy().into_owned()
}

/// The device of a name: `cpu`, or `cuda` with the number of a GPU (`cuda:0`; 0 where it has none). What a GPU needs is
/// loaded. Call it before any tensor is made: libtorch asks once whether there are GPUs.
///
/// # Errors
/// A sentence: what the name may be, or what this machine lacks.
pub fn device(name: &str) -> Result<Device, String> {
    let name = name.to_ascii_lowercase();
    let (kind, number) = name.split_once(':').unwrap_or((&name, "0"));
    let number = match (kind, number.parse::<usize>()) {
        ("cpu", Ok(0)) => return Ok(Device::Cpu),
        ("cuda", Ok(number)) => number,
        _ => return Err("give `cpu`, or `cuda:0` and so on".into()),
    };
    let Some(library) = load_cuda().map_err(|e| e.to_string())? else {
        let beside = loaded_library("libtorch_cpu.so").and_then(|cpu| Some(cpu.parent()?.display().to_string()));
        return Err(format!(
            "the libtorch in {} knows no GPUs; start riglab with LD_LIBRARY_PATH naming the folder `torch/lib` of a PyTorch \
             {} with CUDA",
            beside.as_deref().unwrap_or("use"),
            libtorch_version()
        ));
    };
    match tch::Cuda::device_count() {
        0 => Err(format!("{} finds no GPU: does `nvidia-smi` list one?", library.display())),
        count if number as i64 >= count => Err(format!(
            "this machine's GPUs are {}",
            (0..count).map(|n| format!("cuda:{n}")).collect::<Vec<_>>().join(", ")
        )),
        _ => Ok(Device::Cuda(number)),
    }
}

/// Loads `libtorch_cuda.so` if it lies beside the libtorch that is in use, which registers its
/// kernels: one binary serves machines with and without CUDA. Gives its path when it was found.
///
/// # Errors
/// The loader's message when it is there but cannot be loaded.
pub fn load_cuda() -> Result<Option<PathBuf>, TorchError> {
    let Some(cpu) = loaded_library("libtorch_cpu.so") else { return Ok(None) };
    let cuda = cpu.with_file_name("libtorch_cuda.so");
    if !cuda.is_file() {
        return Ok(None);
    }
    let name = std::ffi::CString::new(cuda.to_string_lossy().as_bytes()).map_err(|e| TorchError(e.to_string()))?;
    // SAFETY: loading runs the library's initialisers, which is what is wanted.
    let handle = unsafe { libc::dlopen(name.as_ptr(), libc::RTLD_NOW | libc::RTLD_GLOBAL) };
    if handle.is_null() {
        // SAFETY: dlerror gives a string after a failure.
        let message = unsafe { CStr::from_ptr(libc::dlerror()) }.to_string_lossy().into_owned();
        return Err(TorchError(format!("{} cannot be loaded: {message}", cuda.display())));
    }
    Ok(Some(cuda))
}

/// Where a library of this process was loaded from.
fn loaded_library(name: &str) -> Option<PathBuf> {
    let maps = std::fs::read_to_string("/proc/self/maps").ok()?;
    let paths = maps.lines().filter_map(|line| line.find('/').map(|at| PathBuf::from(&line[at..])));
    paths.into_iter().find(|path| path.file_name().is_some_and(|n| n == name))
}

#[cfg(test)]
mod tests {
    use tch::{Kind, Tensor};

    use super::*;

    #[test]
    fn autocast_computes_linear_layers_in_bf16_and_ends_with_its_guard() {
        let (x, w) =
            (Tensor::ones([2, 8], (Kind::Float, Device::Cpu)), Tensor::ones([4, 8], (Kind::Float, Device::Cpu)));
        let inside = {
            let _autocast = Autocast::bf16().unwrap();
            x.linear(&w, None::<&Tensor>).kind()
        };
        assert_eq!((inside, x.linear(&w, None::<&Tensor>).kind()), (Kind::BFloat16, Kind::Float));
    }

    #[test]
    fn generator_state_round_trips() {
        let before = rng_state(Device::Cpu).unwrap();
        let draw = || f64::try_from(Tensor::rand([], (Kind::Double, Device::Cpu))).unwrap();
        let a = draw();
        set_rng_state(Device::Cpu, &before).unwrap();
        assert_eq!(a, draw());
        assert!(set_rng_state(Device::Cpu, &[1, 2, 3]).is_err());
    }

    #[test]
    fn devices_are_known_in_any_case() {
        assert!(["cpu", "CPU", "Cpu:0"].iter().all(|name| device(name) == Ok(Device::Cpu)));
        assert!(device("cpu:1").is_err() && device("gpu").is_err());
    }

    #[test]
    fn finds_the_library_in_use() {
        let _ = Tensor::zeros([1], (Kind::Float, Device::Cpu));
        assert!(loaded_library("libtorch_cpu.so").is_some());
        assert!(libtorch_version().starts_with("2.11"));
    }
}

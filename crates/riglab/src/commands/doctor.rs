//! `riglab doctor`

use std::process::ExitCode;
use std::time::Instant;

use anyhow::Result;
use serde_json::json;
use tch::{Cuda, Device, Kind, Tensor};

use riglab_report::counted;

/// Show what this machine offers: libtorch, threads, bfloat16, CUDA, HDF5, and what is missing.
#[derive(clap::Args)]
pub struct Args {
    /// Print as JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args, threads: usize) -> Result<ExitCode> {
    let cuda_library = riglab_torch::load_cuda();
    let threads = riglab_torch::init(riglab_torch::Settings { threads });
    let (fp32, bf16) = (speed(Kind::Float), speed(Kind::BFloat16));
    let flags = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let has = |flag: &str| flags.split_whitespace().any(|f| f == flag);
    let (avx512_bf16, amx) = (has("avx512_bf16"), has("amx_bf16"));
    let cuda = Cuda::device_count();
    let mut missing = Vec::new();
    if bf16 < fp32 {
        missing.push("bfloat16 is not faster than fp32 here: keep train.precision = \"fp32\"".to_string());
    }
    match &cuda_library {
        Ok(None) => missing.push("no libtorch_cuda.so beside libtorch_cpu.so: networks run on the processor".into()),
        Ok(Some(_)) if cuda == 0 => missing.push("libtorch for CUDA is there, but no device: check the driver".into()),
        Ok(Some(_)) => {}
        Err(e) => missing.push(e.to_string()),
    }
    if threads < std::thread::available_parallelism().map_or(1, usize::from) {
        missing.push(format!("only {threads} of the processors are used (--threads)"));
    }
    let gigabytes = |field: &str| riglab_torch::memory_gb(field).unwrap_or(f64::NAN);
    let value = json!({
        "riglab": crate::VERSION,
        "libtorch": riglab_torch::libtorch_version(),
        "cpu_capability": riglab_torch::cpu_capability(),
        "threads": threads,
        "fp32_gflops": fp32.round(),
        "bf16_gflops": bf16.round(),
        "avx512_bf16": avx512_bf16,
        "amx_bf16": amx,
        "cuda_devices": cuda,
        "mpi": riglab_ranks::library(),
        "hdf5": riglab_data::hdf5_version(),
        "memory_gb": gigabytes("MemTotal").round(),
        "memory_free_gb": gigabytes("MemAvailable").round(),
        "missing": missing,
    });
    if args.json {
        say!("{value}");
        return Ok(ExitCode::SUCCESS);
    }
    let yes = |b: bool| if b { "yes" } else { "no" };
    say!("riglab     {}", crate::VERSION);
    let threads = counted(threads, "thread");
    say!("libtorch   {}, {}, {threads}", riglab_torch::libtorch_version(), riglab_torch::cpu_capability());
    say!(
        "matmul     fp32 {fp32:.0} GFLOP/s, bf16 {bf16:.0} GFLOP/s (avx512_bf16: {}, amx: {})",
        yes(avx512_bf16),
        yes(amx)
    );
    say!("cuda       {cuda} devices");
    say!("mpi        {}", riglab_ranks::library().as_deref().unwrap_or("none (built without; see `cargo xtask mpi`)"));
    say!("hdf5       {}", riglab_data::hdf5_version());
    say!("memory     {:.0} GB, {:.0} GB free", gigabytes("MemTotal"), gigabytes("MemAvailable"));
    missing.iter().for_each(|m| say!("note       {m}"));
    Ok(ExitCode::SUCCESS)
}

/// Speed of a matrix product of 1024, best of a few.
fn speed(kind: Kind) -> f64 {
    let n = 1024;
    let a = Tensor::ones([n, n], (Kind::Float, Device::Cpu)).to_kind(kind);
    let once = || {
        let start = Instant::now();
        let _product = a.matmul(&a);
        2.0 * (n as f64).powi(3) / start.elapsed().as_secs_f64() / 1e9
    };
    (0..8).map(|_| once()).fold(0.0, f64::max)
}

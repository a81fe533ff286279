//! How much of the machine a step uses: the operations of its matrix products a second, over what
//! large matrix products reach on the same threads in the same run.
//!
//! Operations are counted once, on the twin, by PyTorch's own counter; both sides are given the same
//! number, whatever they compute besides.

use anyhow::Result;
use riglab_train::Precision;

use super::{Context, step};
use crate::recipe;
use crate::row::{Better, Row};

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (precision, name) in
        [(Precision::Fp32, "matmul_share/fsq_cvae"), (Precision::Bf16, "matmul_share/fsq_cvae/bf16")]
    {
        let Some(t) = step::measured(context, precision)? else {
            return Ok(vec![Row::skipped(name, recipe::NO_RIGS)]);
        };
        let share = |milliseconds: f64| t.flops / (1e-3 * milliseconds) / t.peak;
        let note = format!("{:.2} GFLOP a step, {:.0} GFLOP/s at most", t.flops / 1e9, t.peak / 1e9);
        rows.push(Row::new(name, share(t.ours), share(t.theirs), "share", Better::Higher).note(note));
    }
    Ok(rows)
}

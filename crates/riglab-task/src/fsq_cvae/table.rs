//! An evaluation as lines for a terminal.

use super::evaluate::{Report, Row};
use riglab_report::counted;

/// The tables of all splits.
pub fn lines(report: &Report) -> Vec<String> {
    let mut out = vec![format!("convention {}, decode rule: cut {}, top 4", report.convention, report.cut)];
    for (split, codes) in &report.codebook {
        let rows: Vec<&Row> = report.rows.iter().filter(|r| r.split == *split).collect();
        out.push(format!("\n{split} ({})", counted(rows.first().map_or(0, |r| r.assets), "asset")));
        out.push(format!(
            "{:34} {:>6} {:>7} {:>8} {:>8} {:>6} {:>6} {:>6}",
            "method", "tokens", "IoU", "per rig", "L1", "prec.", "recall", "mask"
        ));
        for r in rows {
            let tokens = if r.own() { r.tokens.to_string() } else { String::new() };
            let p = &r.pooled;
            out.push(format!(
                "{:34} {tokens:>6} {:>7.4} {:>8.4} {:>8.5} {:>6.3} {:>6.3} {:>6.3}",
                r.method, p.iou, r.per_rig.iou, p.l1, p.precision, p.recall, r.per_rig.mask_cover_bone
            ));
        }
        out.push("per rig, mask: means of each asset's own figures; the others pool all vertex-bone pairs".into());
        out.push(if codes.distinct == 0 && codes.tokens > 0 {
            format!("codes: {} of real numbers, {:.1} bits each", codes.tokens, codes.bits)
        } else {
            format!(
                "codes: {} of {} tokens differ, utilisation {:.4}, perplexity {:.0}, {:.1} bits each at most",
                codes.distinct, codes.tokens, codes.utilisation, codes.perplexity, codes.bits
            )
        });
    }
    out
}

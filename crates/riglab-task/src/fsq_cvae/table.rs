//! An evaluation as lines for a terminal.

use riglab_report::counted;

use super::evaluate::Report;

/// The tables of all splits.
pub fn lines(report: &Report) -> Vec<String> {
    let mut out = vec![format!("convention {}, decode rule: cut {}, top 4", report.convention, report.cut)];
    // As they were evaluated: the codebook has them by name.
    for rows in report.rows.chunk_by(|a, b| a.split == b.split) {
        let split = &rows[0].split;
        out.push(format!("\n{split} ({})", counted(rows[0].assets, "asset")));
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
        let Some(codes) = report.codebook.get(split) else { continue };
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use riglab_metric::SkinTally;

    use super::super::evaluate::{CodebookRow, Row};
    use super::*;

    #[test]
    fn splits_stand_in_the_order_in_which_they_were_evaluated() {
        let metrics = SkinTally::of(&[1.0, 0.0], &[1.0, 0.0], 2).metrics();
        let row = |split: &str, method: &str| Row {
            split: split.into(),
            method: method.into(),
            tokens: 1,
            assets: 1,
            pooled: metrics,
            per_rig: metrics,
        };
        let codes = CodebookRow {
            tokens: 2,
            distinct: 1,
            utilisation: 0.5,
            perplexity: 1.0,
            bits: 0.0,
            compression_ratio: 1.0,
            compression_ratio_16_bit: 1.0,
        };
        let report = Report {
            convention: "skintokens".into(),
            cut: 0.1,
            rows: vec![row("test_seen", "raw"), row("test_seen", "rule"), row("test_new", "raw")],
            assets: Vec::new(),
            // Earlier versions noted of a split without assets that it has no codes.
            codebook: BTreeMap::from(
                ["test_seen", "test_new", "without_assets"].map(|split| (split.into(), codes.clone())),
            ),
            codes: Vec::new(),
        };
        let lines = lines(&report);
        let heads: Vec<&str> = lines.iter().filter_map(|line| line.strip_prefix('\n')).collect();
        assert_eq!(heads, ["test_seen (1 asset)", "test_new (1 asset)"]);
        assert_eq!(lines.iter().filter(|line| line.starts_with("codes: ")).count(), 2);
    }
}

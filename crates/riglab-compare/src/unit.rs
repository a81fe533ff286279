//! Distances between skeletons in one unit: presets print them in three.

use riglab_metric::Preset;

/// What a preset's metric is multiplied by in a table, where it is a distance between skeletons: all are shown as shares
/// of the longest side × 100. `None` for other metrics, which are shown as they are.
pub(crate) fn factor(name: &str) -> Option<f64> {
    let (metric, preset) = name.split_once('@')?;
    if !matches!(metric, "j2j" | "j2b" | "b2b") {
        return None;
    }
    Some(match Preset::named(preset)? {
        // In percent by itself.
        Preset::Skintokens => 1.0,
        // In a cube of side 2.
        Preset::Anymate => 50.0,
        Preset::Unirig | Preset::Rignet | Preset::Magicarticulate | Preset::Puppeteer | Preset::Riglab => 100.0,
    })
}

/// What is said where distances are shown.
pub(crate) const SAID: &str = "Distances are 100 × their share of the longest side in every convention; --json and \
                               --csv have them as the convention prints them";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distance_is_the_same_number_under_each_preset() {
        // A twentieth of the longest side, as each prints it.
        for preset in Preset::ALL {
            let printed = match preset {
                Preset::Skintokens => 5.0,
                Preset::Anymate => 0.1,
                _ => 0.05,
            };
            for metric in ["j2j", "j2b", "b2b"] {
                let shown = printed * factor(&format!("{metric}@{}", preset.name())).unwrap();
                assert!((shown - 5.0).abs() < 1e-12, "{metric}@{}: {shown}", preset.name());
            }
            assert_eq!(factor(&format!("l1@{}", preset.name())), None);
        }
        assert_eq!((factor("j2j"), factor("j2j@nowhere")), (None, None));
    }
}

//! Skin weights against the true ones, by the formulas of each peer.

mod curve;
mod puppeteer;
mod skintokens;
mod unirig;
mod vertexwise;
mod worst;

pub use curve::PrecisionRecall;
pub use puppeteer::edges_of;
use serde::{Deserialize, Serialize};
pub use skintokens::{ACTIVE, SkinMetrics, SkinTally, nan_for_null};

pub(crate) use worst::farthest;

use crate::{Figures, Rows};

/// Weights of one asset: as many rows of as many bones on both sides.
#[derive(Clone, Copy, Debug)]
pub struct Skins<'a> {
    /// The true ones.
    pub truth: &'a Rows,
    /// Those predicted.
    pub predicted: &'a Rows,
    /// Pairs of vertices (from, to) for [`SkinConvention::PuppeteerOneRing`]; see [`edges_of`].
    pub edges: &'a [[u32; 2]],
}

/// Whose formulas. The formulas of a convention's columns stand at the head of its module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkinConvention {
    /// SkinTokens' tables as riglab reads them: see [`SkinMetrics`].
    Skintokens,
    /// UniRig's logged figures: L1 is a mean over the whole matrix, IoU by bone and smoothed.
    Unirig,
    /// RigNet: L1 summed over bones, precision and recall by vertex, active above 1e-4.
    Rignet,
    /// Puppeteer, shares below 0.15 of a row's largest dropped.
    Puppeteer,
    /// Puppeteer as evaluated on ModelsResource: below 0.35.
    PuppeteerModelsresource,
    /// Puppeteer with its one-ring mean, 0.15.
    PuppeteerOneRing,
    /// Anymate: as RigNet, active from 0.05; cosine and cross entropy.
    Anymate,
}

impl SkinConvention {
    /// All, the default one first.
    pub const ALL: [Self; 7] = [
        Self::Skintokens,
        Self::Unirig,
        Self::Rignet,
        Self::Puppeteer,
        Self::PuppeteerModelsresource,
        Self::PuppeteerOneRing,
        Self::Anymate,
    ];

    /// Its name in tables and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Skintokens => "skintokens",
            Self::Unirig => "unirig",
            Self::Rignet => "rignet",
            Self::Puppeteer => "puppeteer",
            Self::PuppeteerModelsresource => "puppeteer_modelsresource",
            Self::PuppeteerOneRing => "puppeteer_one_ring",
            Self::Anymate => "anymate",
        }
    }

    /// The figures of one asset, NaN where a ratio is over nothing.
    pub fn figures(self, skins: &Skins) -> Figures {
        match self {
            Self::Skintokens => SkinTally::of_rows(skins.truth, skins.predicted).metrics().columns().to_vec(),
            Self::Unirig => unirig::figures(skins),
            Self::Rignet => vertexwise::rignet(skins),
            Self::Puppeteer => puppeteer::figures(skins, 0.15, false),
            Self::PuppeteerModelsresource => puppeteer::figures(skins, 0.35, false),
            Self::PuppeteerOneRing => puppeteer::figures(skins, 0.15, true),
            Self::Anymate => vertexwise::anymate(skins),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of<'a>(figures: &'a Figures, name: &str) -> &'a f64 {
        &figures.iter().find(|(n, _)| *n == name).unwrap().1
    }

    #[test]
    fn one_name_two_formulas() {
        // Two vertices, four bones; the second vertex moves a fifth of its weight.
        let truth = Rows::dense(&[1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0], 4);
        let predicted = Rows::dense(&[1.0, 0.0, 0.0, 0.0, 0.5, 0.3, 0.2, 0.0], 4);
        let skins = Skins { truth: &truth, predicted: &predicted, edges: &[] };
        let (unirig, rignet) = (SkinConvention::Unirig.figures(&skins), SkinConvention::Rignet.figures(&skins));
        assert!((of(&unirig, "l1") - 0.4 / 8.0).abs() < 1e-7);
        assert!((of(&rignet, "l1") - 0.4 / 2.0).abs() < 1e-7);
        assert!((of(&rignet, "precision") - (1.0 + 2.0 / 3.0) / 2.0).abs() < 1e-7);
        // Of the fourth bone, which nobody uses, UniRig's IoU is 1.
        let iou = (1.0 + 1.0 + 0.001 / 1.001 + 1.0) / 4.0;
        assert!((of(&unirig, "iou_100") - iou).abs() < 1e-7);
    }

    #[test]
    fn puppeteer_drops_small_shares_and_vertices_that_do_not_sum_to_one() {
        let truth = Rows::dense(&[1.0, 0.0, 0.5, 0.0], 2);
        let predicted = Rows::dense(&[0.9, 0.1, 0.0, 1.0], 2);
        let skins = Skins { truth: &truth, predicted: &predicted, edges: &[[0, 1]] };
        let plain = SkinConvention::Puppeteer.figures(&skins);
        assert_eq!(plain, [("precision", 1.0), ("recall", 1.0), ("l1", 0.0), ("rows", 1.0)]);
        // The first vertex takes the second's row.
        let ring = SkinConvention::PuppeteerOneRing.figures(&skins);
        assert_eq!(ring, [("precision", 0.0), ("recall", 0.0), ("l1", 2.0), ("rows", 1.0)]);
    }

    #[test]
    fn nothing_to_compare_is_undefined_and_no_panic() {
        let none = Rows::dense(&[], 3);
        let skins = Skins { truth: &none, predicted: &none, edges: &[[0, 1]] };
        for convention in SkinConvention::ALL {
            assert!(convention.figures(&skins)[0].1.is_nan() || convention.figures(&skins)[0].1 == 0.0);
        }
    }
}

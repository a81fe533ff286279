//! The stages that look at one asset at a time: each lets it pass or says in a sentence why not.

use glam::Vec3;
use riglab_core::{Bounds, Rig};
use serde::{Deserialize, Serialize};

use crate::config::CurateConfig;
use crate::pieces::largest_gap;
use crate::read::ImportFindings;

/// A stage, by its name in the config.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StageName {
    /// Number of joints in range.
    Bones,
    /// One connected tree.
    Tree,
    /// Weights that can be learnt from.
    Weights,
    /// Size of the mesh in range.
    Size,
    /// A single object.
    Objects,
    /// Joints where the mesh is.
    Outside,
    /// Human bones and springs.
    Humanoid,
    /// No asset twice.
    Duplicates,
}

impl StageName {
    /// All of them, in the usual order.
    pub const ALL: [Self; 8] = [
        Self::Bones,
        Self::Tree,
        Self::Weights,
        Self::Size,
        Self::Objects,
        Self::Outside,
        Self::Humanoid,
        Self::Duplicates,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bones => "bones",
            Self::Tree => "tree",
            Self::Weights => "weights",
            Self::Size => "size",
            Self::Objects => "objects",
            Self::Outside => "outside",
            Self::Humanoid => "humanoid",
            Self::Duplicates => "duplicates",
        }
    }
}

/// The first stage that drops a rig, and why.
pub fn dropped(rig: &Rig, seen: &ImportFindings, config: &CurateConfig) -> Option<(StageName, String)> {
    config.stages.iter().find_map(|&stage| {
        let fault = match stage {
            StageName::Bones => bones(rig, config),
            StageName::Tree => tree(seen, config),
            StageName::Weights => weights(rig, seen, config),
            StageName::Size => size(rig, config),
            StageName::Objects => objects(rig, seen, config),
            StageName::Outside => outside(rig, config),
            StageName::Humanoid => humanoid(rig, config),
            // Of many assets, when all have been seen.
            StageName::Duplicates => None,
        };
        fault.map(|why| (stage, why))
    })
}

fn bones(rig: &Rig, config: &CurateConfig) -> Option<String> {
    let (n, c) = (rig.skeleton().len(), &config.bones);
    out_of_range(n, [c.min, c.max], "joint")
}

fn tree(seen: &ImportFindings, config: &CurateConfig) -> Option<String> {
    let c = &config.tree;
    if seen.skeletons > c.skeletons {
        return Some(format!("it holds {} separate skeletons, at most {} are kept", seen.skeletons, c.skeletons));
    }
    (seen.roots > c.roots).then(|| format!("its skeleton has {} roots, at most {} are kept", seen.roots, c.roots))
}

fn weights(rig: &Rig, seen: &ImportFindings, config: &CurateConfig) -> Option<String> {
    let c = &config.weights;
    let carrying = rig.skinned_joints(0.0).len();
    if carrying < c.joints {
        return Some(format!("{carrying} of its joints carry weight, at least {} are wanted", c.joints));
    }
    let share = |vertices: usize| vertices as f32 / rig.mesh().positions().len() as f32;
    let percent = |s: f32| 100.0 * s.min(1.0);
    if share(seen.unweighted) > c.unweighted {
        return Some(format!("{:.1} % of its vertices have no weight in the file", percent(share(seen.unweighted))));
    }
    if share(seen.unnormalised) > c.unnormalised {
        return Some(format!(
            "the weights of {:.1} % of its vertices do not sum to 1",
            percent(share(seen.unnormalised))
        ));
    }
    let far = seen.far.filter(|_| c.far)?;
    Some(format!("its vertices lie {far:.1} times as far from their heaviest bone as from the nearest"))
}

fn size(rig: &Rig, config: &CurateConfig) -> Option<String> {
    let c = &config.size;
    let (vertices, triangles) = (rig.mesh().positions().len(), rig.mesh().triangles().len());
    out_of_range(vertices, c.vertices, "vertex").or_else(|| out_of_range(triangles, c.triangles, "triangle"))
}

fn objects(rig: &Rig, seen: &ImportFindings, config: &CurateConfig) -> Option<String> {
    let c = &config.objects;
    if seen.left_out > c.left_out {
        return Some(format!("{} unskinned meshes are beside the rig, {} are allowed", seen.left_out, c.left_out));
    }
    if seen.parts > c.parts {
        return Some(format!("its mesh is on {} nodes, at most {} are kept", seen.parts, c.parts));
    }
    if c.gap >= 1.0 {
        return None;
    }
    let gap = largest_gap(rig.mesh());
    let percent = 100.0 * gap;
    (gap > c.gap).then(|| format!("a gap of {percent:.0} % of its diagonal splits its mesh into two objects"))
}

fn outside(rig: &Rig, config: &CurateConfig) -> Option<String> {
    let c = &config.outside;
    let skeleton = rig.skeleton();
    let mesh = Bounds::of(rig.mesh().positions().iter().copied())?;
    let reach = c.distance * mesh.diagonal();
    let far = |p: &[f32; 3]| {
        let p = Vec3::from(*p);
        p.distance(p.clamp(mesh.min.into(), mesh.max.into())) > reach
    };
    let joints = skeleton.len() - 1;
    let outside: Vec<&str> =
        skeleton.ids().skip(1).filter(|&j| far(&skeleton.head(j))).map(|j| skeleton.name(j)).collect();
    let share = outside.len() as f32 / joints.max(1) as f32;
    (share > c.share).then(|| {
        let first = outside.first().copied().unwrap_or_default();
        format!("{} of {joints} joints lie far outside the mesh, `{first}` for one", outside.len())
    })
}

fn humanoid(rig: &Rig, config: &CurateConfig) -> Option<String> {
    let c = &config.humanoid;
    if c.complete && !rig.humanoid().is_complete() {
        return Some(match rig.humanoid().len() {
            0 => "the file does not say which joints are human bones".into(),
            n => format!("the file names {n} human bones, but not all that VRM asks for"),
        });
    }
    let springs = rig.springs().springs().len();
    (springs < c.springs).then(|| format!("it has {springs} springs, at least {} are wanted", c.springs))
}

fn out_of_range(n: usize, [min, max]: [usize; 2], what: &str) -> Option<String> {
    let all = match (n, what) {
        (1, _) => format!("1 {what}"),
        (_, "vertex") => format!("{n} vertices"),
        _ => format!("{n} {what}s"),
    };
    match n {
        n if n < min => Some(format!("it has {all}, at least {min} are wanted")),
        n if n > max => Some(format!("it has {all}, at most {max} are kept")),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Mesh, Skeleton, SkinWeights};

    use super::*;
    use crate::config::*;

    /// A tetrahedron of size 1 on a chain of joints at the given heights, all weight on the first.
    fn rig(heights: &[f32]) -> Rig {
        let joints = heights.iter().enumerate().map(|(i, &y)| Joint {
            name: format!("j{i}"),
            parent: (i as u16).checked_sub(1).map(JointId),
            head: [0.0, y, 0.0],
        });
        let mesh = Mesh::new(
            vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]],
        );
        let weights = SkinWeights::normalized(vec![vec![(0u16, 1.0)]; 4]).unwrap();
        Rig::new(Skeleton::new(joints.collect()).unwrap(), mesh.unwrap(), weights).unwrap()
    }

    fn drops(rig: &Rig, seen: &ImportFindings, change: fn(&mut CurateConfig)) -> Option<(StageName, String)> {
        let mut config = CurateConfig::default();
        change(&mut config);
        config.validate().unwrap();
        dropped(rig, seen, &config)
    }

    #[test]
    fn each_stage_drops_what_it_is_for() {
        let seen = ImportFindings { skeletons: 1, roots: 1, parts: 1, ..ImportFindings::default() };
        let (plain, far) = (rig(&[0.0, 0.5]), rig(&[0.0, 0.5, 90.0]));
        type Case = (StageName, Rig, ImportFindings, fn(&mut CurateConfig), &'static str);
        let cases: [Case; 11] = [
            (StageName::Bones, plain.clone(), seen.clone(), |c| c.bones.min = 3, "2 joints, at least 3"),
            (StageName::Bones, plain.clone(), seen.clone(), |c| c.bones = BonesConfig { min: 1, max: 1 }, "at most 1"),
            (
                StageName::Tree,
                plain.clone(),
                ImportFindings { skeletons: 2, ..seen.clone() },
                |c| c.tree.skeletons = 1,
                "2 separate",
            ),
            (
                StageName::Tree,
                plain.clone(),
                ImportFindings { roots: 5, ..seen.clone() },
                |c| c.tree.roots = 4,
                "5 roots",
            ),
            (StageName::Weights, plain.clone(), seen.clone(), |c| c.weights.joints = 2, "1 of its joints"),
            (
                StageName::Weights,
                plain.clone(),
                ImportFindings { unweighted: 1, ..seen.clone() },
                |c| c.weights.unweighted = 0.1,
                "25.0 %",
            ),
            (
                StageName::Weights,
                plain.clone(),
                ImportFindings { far: Some(4.0), ..seen.clone() },
                |c| c.weights.far = true,
                "4.0 times",
            ),
            (StageName::Size, plain.clone(), seen.clone(), |c| c.size.vertices = [100, 200], "4 vertices"),
            (
                StageName::Objects,
                plain.clone(),
                ImportFindings { left_out: 3, ..seen.clone() },
                |c| c.objects.left_out = 2,
                "3 unskinned",
            ),
            (
                StageName::Outside,
                far,
                seen.clone(),
                |c| c.outside = OutsideConfig { distance: 0.5, share: 0.1 },
                "`j2`",
            ),
            (StageName::Humanoid, plain.clone(), seen.clone(), |c| c.humanoid.complete = true, "human bones"),
        ];
        for (stage, rig, seen, change, text) in cases {
            assert_eq!(dropped(&rig, &seen, &CurateConfig::default()), None);
            let (by, why) = drops(&rig, &seen, change).unwrap();
            assert!(by == stage && why.contains(text), "{by:?}: {why}");
        }
    }

    #[test]
    fn the_first_stage_of_the_list_counts() {
        let bad = |c: &mut CurateConfig| {
            c.bones.min = 3;
            c.size.vertices = [100, 200];
            c.stages = vec![StageName::Size, StageName::Bones];
        };
        let mut config = CurateConfig::default();
        bad(&mut config);
        assert_eq!(dropped(&rig(&[0.0]), &ImportFindings::default(), &config).unwrap().0, StageName::Size);
        config.stages.clear();
        assert_eq!(dropped(&rig(&[0.0]), &ImportFindings::default(), &config), None);
    }
}

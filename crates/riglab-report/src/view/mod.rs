//! Rigs that a reader of a page can turn, play and look through.
//!
//! The one idea: **a view is a file.** A task writes it beside its pictures ([`Turntable::to_bytes`]); a page takes the bytes
//! as they are, and a script (`viewer.js`) reads them. So reports need no corpus and no model.
//!
//! The script draws by a z-buffer of its own on a plain canvas: a browser without a graphics driver shows the same, and
//! a page may hold more views than a browser gives WebGL contexts.
//!
//! # The format
//!
//! `RGV1`, the length of a JSON text as u32, the text, and arrays, all little-endian. The text has `vertices`,
//! `triangles`, `low` and `size` (a cube: a coordinate q of 16 bits is `low + size · q / 65535`) and `versions`, each
//! with a `title`, the joints' `names` and `parents` (-1 of a root). The arrays: positions (u16, 3 a vertex), triangles
//! (u16, 3 each), then for each version the joints' heads (u16, 3 each), joints of the four largest weights of each
//! vertex (u16) and these weights (u8, 255 is 1).

mod small;

use riglab_core::Rig;
use riglab_render::{Palette, joint_color};
use serde_json::json;

/// A mesh with one or several rigs, such as the true one and a predicted one.
#[derive(Clone, Debug)]
pub struct Turntable {
    bytes: Vec<u8>,
}

const MAGIC: &[u8; 4] = b"RGV1";
/// Influences of a vertex.
const INFLUENCES: usize = 4;

impl Turntable {
    /// Of rigs of one mesh, each with a title; the mesh is that of the first, made smaller where it is large. `None`
    /// where there is no rig, or where one has another number of vertices than the first.
    pub fn of(versions: &[(&str, &Rig)]) -> Option<Self> {
        let ((_, first), all) = (versions.first()?, versions);
        let count = first.mesh().positions().len();
        if all.iter().any(|(_, rig)| rig.mesh().positions().len() != count || rig.weights().rows() != count) {
            return None;
        }
        let (kept, triangles) = small::small(first.mesh());
        // Joints may stand outside of the mesh.
        let points = kept.iter().map(|&v| first.mesh().positions()[v as usize]);
        let points = points.chain(all.iter().flat_map(|(_, rig)| rig.skeleton().heads().iter().copied()));
        let bounds = riglab_core::Bounds::of(points)?;
        let size = bounds.size().into_iter().fold(f32::MIN_POSITIVE, f32::max);
        let low = bounds.min;
        let place = |p: &riglab_core::Vec3| {
            let q = |k: usize| ((p[k] - low[k]) / size * 65535.0).round().clamp(0.0, 65535.0) as u16;
            [q(0), q(1), q(2)]
        };
        let shown = |(title, rig): &(&str, &Rig)| {
            let s = rig.skeleton();
            let parents: Vec<i32> = s.parents().iter().map(|p| p.map_or(-1, |p| i32::from(p.0))).collect();
            json!({"title": title, "names": s.names(), "parents": parents})
        };
        let head = json!({
            "vertices": kept.len(),
            "triangles": triangles.len(),
            "low": low,
            "size": size,
            "versions": all.iter().map(shown).collect::<Vec<_>>(),
        });
        let head = head.to_string();
        let mut bytes = MAGIC.to_vec();
        bytes.extend(u32::try_from(head.len()).ok()?.to_le_bytes());
        bytes.extend(head.as_bytes());
        let mut words = |values: &mut dyn Iterator<Item = u16>| values.for_each(|v| bytes.extend(v.to_le_bytes()));
        words(&mut kept.iter().flat_map(|&v| place(&first.mesh().positions()[v as usize])));
        words(&mut triangles.into_iter().flatten());
        for (_, rig) in all {
            bytes.extend(rig.skeleton().heads().iter().flat_map(place).flat_map(u16::to_le_bytes));
            let rows: Vec<_> = kept.iter().map(|&v| largest(rig, v as usize)).collect();
            bytes.extend(rows.iter().flat_map(|row| row.iter().flat_map(|(joint, _)| joint.to_le_bytes())));
            bytes.extend(rows.iter().flat_map(|row| row.iter().map(|(_, w)| *w)));
        }
        Some(Self { bytes })
    }

    /// As a file.
    pub fn to_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// A file's view; `None` for a file that is none.
    pub fn from_bytes(bytes: Vec<u8>) -> Option<Self> {
        let this = Self { bytes };
        let head = this.head()?;
        let count = |key: &str| head[key].as_u64().and_then(|n| usize::try_from(n).ok());
        let (vertices, triangles) = (count("vertices")?, count("triangles")?);
        let joints: usize = this.versions()?.iter().map(|(_, joints)| joints).sum();
        let versions = this.versions()?.len();
        let arrays = 6 * vertices + 6 * triangles + 6 * joints + versions * vertices * 3 * INFLUENCES;
        let start = 8 + u32::from_le_bytes(this.bytes.get(4..8)?.try_into().ok()?) as usize;
        (vertices <= 1 << 16 && triangles <= 1 << 20 && this.bytes.len() == start + arrays).then_some(this)
    }

    fn head(&self) -> Option<serde_json::Value> {
        let rest = self.bytes.strip_prefix(MAGIC)?;
        let length = u32::from_le_bytes(rest.get(..4)?.try_into().ok()?) as usize;
        serde_json::from_slice(rest.get(4..4usize.checked_add(length)?)?).ok()
    }

    /// Titles and numbers of joints.
    pub fn versions(&self) -> Option<Vec<(String, usize)>> {
        let head = self.head()?;
        let of = |v: &serde_json::Value| {
            let (names, parents) = (v["names"].as_array()?, v["parents"].as_array()?);
            (names.len() == parents.len()).then_some(())?;
            Some((v["title"].as_str()?.to_owned(), names.len()))
        };
        head["versions"].as_array()?.iter().map(of).collect()
    }

    /// Whether weights of the first two versions can be compared: their joints are the same.
    pub(crate) fn same_joints(&self) -> bool {
        let Some(head) = self.head() else { return false };
        let of = |k: usize| (&head["versions"][k]["names"], &head["versions"][k]["parents"]);
        head["versions"].as_array().is_some_and(|all| all.len() == 2) && of(0) == of(1)
    }
}

/// The four largest weights of a vertex, by joint; those that are left over weigh 0.
fn largest(rig: &Rig, vertex: usize) -> [(u16, u8); INFLUENCES] {
    let mut row: Vec<(u16, f32)> = rig.weights().row(vertex).map(|(joint, w)| (joint.0, w)).collect();
    row.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    row.truncate(INFLUENCES);
    let total: f32 = row.iter().map(|(_, w)| w).sum();
    let mut out = [(0, 0); INFLUENCES];
    for (out, (joint, w)) in out.iter_mut().zip(row) {
        *out = (joint, if total > 0.0 { (255.0 * w / total).round() as u8 } else { 0 });
    }
    out
}

/// The script of a page with views, its colours before it.
pub(crate) fn script() -> String {
    let hex = |c: riglab_render::Rgb| format!("#{:02x}{:02x}{:02x}", c.0[0], c.0[1], c.0[2]);
    let ramp = |p: Palette| (0..=16).map(|k| hex(p.color(k as f32 / 16.0))).collect::<Vec<_>>();
    let joints: Vec<String> = (0..96).map(|j| hex(joint_color(j))).collect();
    let palettes = json!({"dusk": ramp(Palette::Dusk), "ember": ramp(Palette::Ember), "joints": joints});
    format!("const PALETTES = {palettes};\n{}", include_str!("viewer.js"))
}

/// A view of a small rig in two versions.
#[cfg(test)]
pub(crate) fn tests_rig() -> Turntable {
    Turntable::of(&[("true", &tests::rig(0.25)), ("predicted", &tests::rig(0.5))]).expect("rigs of one mesh")
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, Mesh, Skeleton, SkinWeights};

    use super::*;

    pub(super) fn rig(moved: f64) -> Rig {
        let mesh = Mesh::new(
            vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]],
            vec![[0, 1, 2], [1, 2, 3]],
        );
        let joint = |name: &str, parent, x| Joint { name: name.into(), parent, head: [x, 0.0, 0.0] };
        let skeleton =
            Skeleton::new(vec![joint("a", None, 0.0), joint("b </script>", Some(riglab_core::JointId(0)), 2.0)]);
        let rows = vec![vec![(0, 1.0 - moved), (1, moved)], vec![(1, 1.0)], vec![(0, 1.0)], vec![(0, 1.0)]];
        Rig::new(skeleton.unwrap(), mesh.unwrap(), SkinWeights::normalized(rows).unwrap()).unwrap()
    }

    #[test]
    fn a_view_holds_both_rigs_and_is_read_back() {
        let (a, b) = (rig(0.25), rig(0.5));
        let view = Turntable::of(&[("true", &a), ("predicted", &b)]).unwrap();
        let read = Turntable::from_bytes(view.to_bytes().to_vec()).unwrap();
        assert_eq!(read.versions().unwrap(), [("true".to_owned(), 2), ("predicted".into(), 2)]);
        assert!(read.same_joints());
        // The last bytes are the second version's weights: the first vertex is half of each joint.
        let weights = &view.to_bytes()[view.to_bytes().len() - 16..];
        assert_eq!(weights[..4], [128, 128, 0, 0]);
        assert_eq!(weights[4..8], [255, 0, 0, 0]);
    }

    #[test]
    fn coordinates_are_within_half_a_step() {
        let a = rig(0.0);
        let view = Turntable::of(&[("true", &a)]).unwrap();
        let bytes = view.to_bytes();
        let start = 8 + u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
        let q = |k: usize| f32::from(u16::from_le_bytes(bytes[start + 2 * k..][..2].try_into().unwrap()));
        // The box reaches to the second joint at x = 2.
        for (k, want) in [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].into_iter().enumerate() {
            assert!((2.0 * q(k) / 65535.0 - want).abs() <= 2.0 / 65535.0, "{k}");
        }
        assert!(!view.same_joints());
    }

    #[test]
    fn what_is_no_view_is_refused() {
        let whole = Turntable::of(&[("true", &rig(0.0))]).unwrap().bytes;
        for cut in 0..whole.len() {
            assert!(Turntable::from_bytes(whole[..cut].to_vec()).is_none(), "{cut}");
        }
        assert!(Turntable::from_bytes(b"RGV1\xff\xff\xff\xff".to_vec()).is_none() && Turntable::of(&[]).is_none());
    }
}

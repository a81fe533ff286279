//! A rig as a GLB file.

use riglab_core::Asset;

use super::export;
use crate::{ExportOptions, Influences};

/// The asset as a binary glTF 2.0 file: one mesh with normals, one skin, a node a joint.
///
/// Nothing is lost or rounded; normals are made anew: the inverse bind matrices hold the
/// joints' heads, every influence stands in as many sets of four as it takes, units and axes stay.
/// Joints have no orientation of their own, as in [`riglab_core::Rig`].
pub fn to_glb(asset: &Asset) -> Vec<u8> {
    let options = ExportOptions { influences: Influences::All, ..ExportOptions::default() };
    let exported = export::alone(&asset.name, &asset.rig, &asset.provenance, &options);
    exported.expect("a rig in memory is smaller than 4 GiB").bytes
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Mesh, Provenance, Rig, Skeleton, SkinWeights};

    use super::*;
    use crate::{ImportOptions, Warning, import_bytes};

    #[test]
    fn what_is_written_is_read_back() {
        let joint =
            |name: &str, parent: Option<u16>, head| Joint { name: name.into(), parent: parent.map(JointId), head };
        let joints = vec![
            joint("root", None, [0.1, -0.2, 0.3]),
            joint("arm", Some(0), [0.7, 0.123, 0.3]),
            joint("hand", Some(1), [1.1, 0.2, 1e-7]),
            joint("tip", Some(2), [1.4, 0.2, 0.1]),
            // The importer's order is depth first.
            joint("leg", Some(0), [0.1, -0.9, 0.0]),
        ];
        let skeleton = Skeleton::new(joints).unwrap();
        let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.1, 0.2], [0.3, 1.0, 0.7]], vec![[0, 1, 2]]).unwrap();
        // Five influences take two sets.
        let rows: Vec<Vec<(u16, f64)>> =
            vec![vec![(0, 0.5), (1, 0.2), (2, 0.1), (3, 0.1), (4, 0.1)], vec![(1, 1.0)], vec![(2, 0.25), (3, 0.75)]];
        let rig = Rig::new(skeleton, mesh, SkinWeights::normalized(rows).unwrap()).unwrap();
        let provenance = Provenance { licence: "CC0-1.0".into(), ..Provenance::default() };
        let asset = Asset { name: "test".into(), rig, clips: vec![], provenance };
        let back = import_bytes("test.glb", &to_glb(&asset), &ImportOptions::default()).unwrap();
        assert_eq!(back.provenance.licence, "CC0-1.0");
        assert!(matches!(back.warnings(), [Warning::FewTriangles(1)]));
        let rig = back.rig().unwrap();
        assert_eq!((rig.skeleton(), rig.mesh()), (asset.rig.skeleton(), asset.rig.mesh()));
        assert_eq!(rig.weights().joints(), asset.rig.weights().joints());
        for (a, b) in rig.weights().weights().iter().zip(asset.rig.weights().weights()) {
            // Rows are divided by their sum once more.
            assert!((a - b).abs() < 1e-6);
        }
    }
}

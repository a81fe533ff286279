//! Turns as angles about x, then y, then z, in degrees.

use glam::{DQuat, DVec3, EulerRot};

/// The angles of a turn; that about y is between -90 and 90 degrees.
pub(super) fn of(turn: DQuat) -> DVec3 {
    let (z, y, x) = turn.to_euler(EulerRot::ZYX);
    let angles = DVec3::new(x, y, z);
    if angles.is_finite() { angles * (180.0 / std::f64::consts::PI) } else { DVec3::ZERO }
}

/// The way back.
pub(super) fn turn(angles: DVec3) -> DQuat {
    let [x, y, z] = (angles * (std::f64::consts::PI / 180.0)).to_array();
    DQuat::from_euler(EulerRot::ZYX, z, y, x)
}

/// The angles of a turn that are nearest to others, so that motions do not jump: each turn has many.
pub(super) fn near(turn: DQuat, to: DVec3) -> DVec3 {
    let own = of(turn);
    // Where x and z turn about one axis, only what they come to together is known.
    const POLE: f64 = 90.0 - 1e-4;
    let own = if own.y >= POLE {
        DVec3::new(to.x, own.y, own.z - own.x + to.x)
    } else if own.y <= -POLE {
        DVec3::new(to.x, own.y, own.z + own.x - to.x)
    } else {
        own
    };
    let other = DVec3::new(own.x + 180.0, 180.0 - own.y, own.z + 180.0);
    let [own, other] = [own, other].map(|angles| angles - ((angles - to) / 360.0).round() * 360.0);
    if (other - to).length_squared() < (own - to).length_squared() { other } else { own }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_turns_about_x_then_y_then_z() {
        let of_axis = |axis, degrees: f64| DQuat::from_axis_angle(axis, degrees.to_radians());
        for angles in [[30.0, 0.0, 0.0], [10.0, -70.0, 170.0], [-120.0, 45.0, -15.0], [20.0, 90.0, 0.0]] {
            let [x, y, z] = angles;
            let turn = of_axis(DVec3::Z, z) * of_axis(DVec3::Y, y) * of_axis(DVec3::X, x);
            let [x, y, z] = of(turn).to_array();
            let again = of_axis(DVec3::Z, z) * of_axis(DVec3::Y, y) * of_axis(DVec3::X, x);
            assert!(turn.dot(again).abs() > 1.0 - 1e-9, "{angles:?}: {x} {y} {z}");
        }
    }

    #[test]
    fn angles_follow_those_before_them() {
        let from = DVec3::new(10.0, 80.0, 20.0);
        // On over the pole, where the nearest range ends, and round once.
        for to in [DVec3::new(10.0, 100.0, 20.0), DVec3::new(150.0, 80.0, 20.0), DVec3::new(10.0, 90.0, 25.0)] {
            assert!((near(turn(to), from) - to).length() < 1e-3, "{to} is {}", near(turn(to), from));
        }
        let round = DVec3::new(370.0, 60.0, -340.0);
        assert!((near(turn(round), round) - round).length() < 1e-6);
        assert!(near(DQuat::from_xyzw(0.0, 0.0, 0.0, 1.0), DVec3::ZERO).length() < 1e-9);
    }
}

//! Spring bones: VRM's Verlet step, over all joints of a depth at once.

use tch::{Kind, Tensor};

use super::maps::turned;
use super::tree::Level;
use super::{Maps, Tree, dot, unit_or};

/// Numbers of a row of attributes: stiffness, drag, gravity's power and direction (x, y, z), hit radius; as VRM 1.0
/// and `riglab-core`'s `Swing` have them.
pub const ATTRIBUTES: i64 = 7;

/// Cosines nearer to -1 than this are of opposite directions.
const OPPOSITE: f64 = 1e-7;

/// What springs do not enter: all points within `radius` of the segment from `from` to `to`, at rest. One place for
/// both makes a ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// The joint whose motion it goes with.
    pub joint: usize,
    /// One end.
    pub from: [f64; 3],
    /// The other.
    pub to: [f64; 3],
    /// 0 and above.
    pub radius: f64,
}

/// Joints of which some swing.
#[derive(Debug)]
pub struct Springs {
    tree: Tree,
    heads: Tensor,
    /// From head to tail, and the same of length 1.
    axes: Tensor,
    directions: Tensor,
    swinging: Vec<bool>,
    /// Each with the joints it stops.
    obstacles: Vec<(Obstacle, Vec<bool>)>,
    /// By joint, whose motion it does not feel; itself numbers `j` for none.
    centers: Option<Tensor>,
}

impl Springs {
    /// Of joints whose bones go from `heads` to `tails` [j, 3] at rest, those swing that `swinging` names and that
    /// have a length; the others follow the motion.
    ///
    /// # Panics
    /// When there is not a head, a tail and a word for each joint.
    pub fn new(tree: Tree, heads: &Tensor, tails: &Tensor, swinging: &[bool]) -> Self {
        let joints = tree.joints();
        assert_eq!((heads.size(), tails.size(), swinging.len() as i64), (vec![joints, 3], vec![joints, 3], joints));
        let axes = tails - heads;
        let length = axes.square().sum_dim_intlist(-1, false, None::<Kind>);
        let long = Vec::<f64>::try_from(length.to_kind(Kind::Double)).unwrap_or_default();
        let least = super::tiny(axes.kind());
        let swinging = swinging.iter().zip(long).map(|(s, length)| *s && length > least).collect();
        let up = Tensor::from_slice(&[0f64, 1.0, 0.0]).to_kind(axes.kind()).to_device(axes.device());
        let directions = unit_or(&axes, &up);
        let heads = heads.shallow_clone();
        Self { tree, heads, axes, directions, swinging, obstacles: vec![], centers: None }
    }

    /// The tree.
    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    /// With what stops them: each obstacle with the joints that do not enter it, in the order in which a bone meets them.
    ///
    /// # Panics
    /// When there is not a word for each joint.
    pub fn with_obstacles(self, obstacles: Vec<(Obstacle, Vec<bool>)>) -> Self {
        assert!(obstacles.iter().all(|(o, stops)| stops.len() == self.swinging.len() && o.joint < stops.len()));
        Self { obstacles, ..self }
    }

    /// With the joint whose motion each does not feel.
    pub fn with_centers(mut self, centers: &[Option<usize>]) -> Self {
        let none = self.tree.joints();
        let numbers: Vec<i64> = centers.iter().map(|c| c.map_or(none, |c| c as i64)).collect();
        self.centers = Some(Tensor::from_slice(&numbers).to_device(self.heads.device()));
        self
    }

    /// The maps [t, j] of the poses of a motion [t + 1, j] but the first, in which all is at rest. Poses are `seconds`
    /// apart; `attributes` [j, 7] are looked at for joints that swing, with drag in 0 to 1 and the rest of any size.
    ///
    /// # Panics
    /// When shapes do not fit.
    pub fn run(&self, motion: &Maps, attributes: &Tensor, seconds: f64) -> Maps {
        assert_eq!(attributes.size(), [self.tree.joints(), ATTRIBUTES]);
        let frames = motion.shift.size()[0];
        let locals = self.locals(motion);
        let mut levels: Vec<Bones<'_>> = self.tree.levels.iter().map(|l| Bones::new(self, l, attributes)).collect();
        let mut all = Vec::with_capacity(frames as usize);
        for frame in 0..frames {
            let posed = motion.get(frame);
            let local = locals.get(frame);
            let centers = self.centers.as_ref().map(|of| centers(&posed, of));
            let mut maps: Vec<Maps> = Vec::with_capacity(levels.len());
            for bones in &mut levels {
                let above = match maps.last() {
                    Some(above) => above.select(-1, &bones.parents),
                    None => identity(&bones.heads),
                };
                let local = local.select(-1, &bones.joints);
                let carried = above.after(&local);
                // What does not swing costs no more than its motion.
                if bones.swings.is_none() {
                    maps.push(carried);
                    continue;
                }
                let centers =
                    centers.as_ref().map(|(to, back)| (to.select(-1, &bones.joints), back.select(-1, &bones.joints)));
                let hold = Hold { above, local, carried, centers };
                match frame {
                    0 => maps.push(bones.rest(hold)),
                    _ => maps.push(bones.step(&hold, &posed, seconds)),
                }
            }
            if frame > 0 {
                all.push(self.tree.in_order(&maps));
            }
        }
        Maps::stack(&all)
    }

    /// What the motion does to each joint within its parent.
    fn locals(&self, motion: &Maps) -> Maps {
        let levels = &self.tree.levels;
        let own = |at: &Tensor| motion.select(-1, &at.to_device(self.heads.device()));
        let all: Vec<Maps> = (0..levels.len())
            .map(|depth| match depth.checked_sub(1) {
                Some(above) => {
                    let parents = levels[above].joints.index_select(0, &levels[depth].parents);
                    own(&parents).inverse().after(&own(&levels[depth].joints))
                }
                None => own(&levels[0].joints),
            })
            .collect();
        self.tree.in_order(&all)
    }
}

/// From the space of each joint's center to the scene, and back; for joints without, no change.
fn centers(posed: &Maps, of: &Tensor) -> (Maps, Maps) {
    let with_none = Maps::cat(
        &[
            Maps { matrix: posed.matrix.shallow_clone(), shift: posed.shift.shallow_clone() },
            identity(&posed.shift.narrow(0, 0, 1)),
        ],
        -1,
    );
    let to = with_none.select(-1, of);
    let back = to.inverse();
    (to, back)
}

fn identity(like: &Tensor) -> Maps {
    let eye = Tensor::eye(3, (like.kind(), like.device()));
    Maps { matrix: eye.expand([like.size()[0], 3, 3], false), shift: like.zeros_like() }
}

/// What holds the bones of a depth in a pose.
struct Hold {
    above: Maps,
    /// What the motion does to each within its parent.
    local: Maps,
    /// Each as its parent carries it.
    carried: Maps,
    centers: Option<(Maps, Maps)>,
}

impl Hold {
    /// A place as the center sees it.
    fn seen(&self, place: &Tensor) -> Tensor {
        self.centers.as_ref().map_or_else(|| place.shallow_clone(), |(_, back)| back.apply(place))
    }
}

/// The bones of a depth, and where their tails are and were, as their centers see them [r, 3].
struct Bones<'a> {
    joints: Tensor,
    parents: Tensor,
    heads: Tensor,
    axes: Tensor,
    directions: Tensor,
    /// Which swing [r]; `None` where none does.
    swings: Option<Tensor>,
    /// What stops some of them, and whom [r, 1].
    obstacles: Vec<(&'a Obstacle, Tensor)>,
    attributes: Tensor,
    now: Tensor,
    before: Tensor,
}

impl<'a> Bones<'a> {
    fn new(springs: &'a Springs, level: &Level, attributes: &Tensor) -> Self {
        let device = springs.heads.device();
        let joints = level.joints.to_device(device);
        let numbers = Vec::<i64>::try_from(&level.joints).unwrap_or_default();
        let some = |all: &[bool]| {
            let own: Vec<bool> = numbers.iter().map(|j| all[*j as usize] && springs.swinging[*j as usize]).collect();
            own.contains(&true).then(|| Tensor::from_slice(&own).to_device(device))
        };
        let of = |all: &Tensor| all.index_select(0, &joints);
        let heads = of(&springs.heads);
        Self {
            parents: level.parents.to_device(device),
            axes: of(&springs.axes),
            directions: of(&springs.directions),
            swings: some(&springs.swinging),
            obstacles: springs
                .obstacles
                .iter()
                .filter_map(|(o, stops)| Some((o, some(stops)?.unsqueeze(-1))))
                .collect(),
            attributes: of(attributes),
            now: heads.zeros_like(),
            before: heads.zeros_like(),
            heads,
            joints,
        }
    }

    fn rest(&mut self, hold: Hold) -> Maps {
        self.now = hold.seen(&hold.carried.apply(&(&self.heads + &self.axes)));
        self.before = self.now.shallow_clone();
        hold.carried
    }

    /// As `riglab_simulate`'s bone; the names are the same.
    fn step(&mut self, hold: &Hold, posed: &Maps, seconds: f64) -> Maps {
        let part = |from: i64, count: i64| self.attributes.narrow(-1, from, count);
        let (stiffness, drag, radius) = (part(0, 1), part(1, 1), part(6, 1));
        let gravity = part(2, 1) * part(3, 3);
        let head = hold.carried.apply(&self.heads);
        let to_rest = unit_or(&turned(&hold.above.matrix, &self.directions), &self.directions);
        // What the motion scales a joint by, within its parent.
        let rows: Vec<Tensor> = (0..3).map(|k| hold.local.matrix.select(-2, k)).collect();
        let det = dot(&rows[0], &rows[1].cross(&rows[2], Some(-1)));
        let scale = det.abs().pow_tensor_scalar(1.0 / 3.0).detach();
        let length = dot(&(turned(&hold.above.matrix, &self.axes) * &scale), &to_rest);

        let kept = &self.now + (&self.now - &self.before) * (-drag + 1.0);
        let kept = hold.centers.as_ref().map_or_else(|| kept.shallow_clone(), |(to, _)| to.apply(&kept));
        let aim = kept + &to_rest * stiffness * seconds + gravity * seconds;
        let mut way = unit_or(&(aim - &head), &to_rest);
        for (obstacle, stopped) in &self.obstacles {
            let (out, depth) = obstacle.hit(&(&head + &way * &length), &radius, &way, posed);
            let moved = unit_or(&(&way * &length + out * &depth), &way);
            way = moved.where_self(&depth.gt(0.0).logical_and(stopped), &way);
        }
        let tail = &head + &way * &length;
        self.before = std::mem::replace(&mut self.now, hold.seen(&tail));

        // Turn and even scale: the transpose turns back.
        let to = unit_or(&turned(&hold.above.matrix.transpose(-2, -1), &way), &self.directions);
        let matrix = hold.above.matrix.matmul(&shortest(&self.directions, &to)) * scale.unsqueeze(-1);
        let shift = &head - turned(&matrix, &self.heads);
        let swung = Maps { matrix, shift };
        match &self.swings {
            Some(swings) => swung.or(swings, &hold.carried),
            None => swung,
        }
    }
}

impl Obstacle {
    /// Which way [r, 3] and how far [r, 1] balls at `tails` [r, 3] with `radii` [r, 1] have to go to be outside; those with
    /// 0 or less are. From the very middle it is `away`.
    fn hit(&self, tails: &Tensor, radii: &Tensor, away: &Tensor, posed: &Maps) -> (Tensor, Tensor) {
        let own = posed.get(self.joint as i64);
        let place = |p: [f64; 3]| own.apply(&Tensor::from_slice(&p).to_kind(tails.kind()).to_device(tails.device()));
        let (from, to) = (place(self.from), place(self.to));
        let rod = to - &from;
        let off = tails - from;
        let square = dot(&rod, &rod).clamp_min(super::tiny(tails.kind()));
        let share = (dot(&off, &rod) / square).clamp(0.0, 1.0);
        let off = off - share * &rod;
        let out = unit_or(&off, away);
        let depth = radii + self.radius - dot(&off, &out);
        (out, depth)
    }
}

/// The shortest turns [r, 3, 3] between unit vectors [r, 3]: 1 + [v]ₓ + [v]ₓ² / (1 + c); half a turn about some axis
/// across where they are opposite, with no gradient there.
fn shortest(from: &Tensor, to: &Tensor) -> Tensor {
    let v = from.cross(to, Some(-1));
    let c = dot(from, to).unsqueeze(-1);
    let [x, y, z] = [0, 1, 2].map(|k| v.select(-1, k));
    let o = x.zeros_like();
    let across = Tensor::stack(&[&o, &-&z, &y, &z, &o, &-&x, &-&y, &x, &o], -1).unflatten(-1, [3, 3]);
    let eye = Tensor::eye(3, (from.kind(), from.device()));
    let opposite = (&c + 1.0).le(OPPOSITE);
    let safe = (&c + 1.0).where_self(&opposite.logical_not(), &c.ones_like());
    let turn = &eye + &across + across.matmul(&across) / safe;
    // About (-y, x, 0) or (0, -z, y), whichever is longer.
    let [x, y, z] = [0, 1, 2].map(|k| from.select(-1, k).detach());
    let o = x.zeros_like();
    let flat = Tensor::stack(&[&-&y, &x, &o], -1);
    let steep = Tensor::stack(&[&o, &-&z, &y], -1);
    let axis = unit_or(&flat.where_self(&x.abs().gt_tensor(&z.abs()).unsqueeze(-1), &steep), &steep);
    let half = axis.unsqueeze(-1) * axis.unsqueeze(-2) * 2.0 - &eye;
    turn.where_self(&opposite.logical_not(), &half)
}

//! Tracks as curves of one number each.
//!
//! Curves of the format go straight from key to key, or stay until the next one. What does neither is sampled between its keys:
//! splines and turns, whose angles do not change steadily.

use glam::{DQuat, DVec3};

use super::euler;
use crate::gltf::contents::{Path, Track};

/// Keys a second between those of a track that is sampled.
const RATE: f64 = 30.0;

/// Degrees that a turn may be off between two keys.
const OFF: f64 = 0.1;

/// How often the time between two keys is halved for that.
const HALVED: usize = 5;

/// Ticks of the format in a second.
pub(super) const SECOND: f64 = 46_186_158_000.0;

/// Keys of several numbers over time.
pub(super) struct Keys<const N: usize> {
    /// Rising, in ticks.
    pub(super) times: Vec<i64>,
    pub(super) values: Vec<[f64; N]>,
    /// Whether a value stays until the next key.
    pub(super) steps: bool,
}

/// How many keys may still be made between those of tracks: files claim long times in few bytes.
pub(super) struct Room {
    left: usize,
    /// How many splines found none, and are straight lines from key to key.
    pub(super) straightened: usize,
}

impl Room {
    pub(super) fn new() -> Self {
        Self { left: 1 << 21, straightened: 0 }
    }

    /// The times at which a track is sampled.
    fn times(&mut self, track: &Track) -> Vec<f64> {
        let keys = track.times();
        let between = |pair: &[f64]| ((pair[1] - pair[0]) * RATE).ceil().max(1.0);
        let wanted: f64 = keys.windows(2).map(between).sum();
        let has_room = wanted <= self.left as f64;
        self.straightened += usize::from(track.is_spline() && !has_room);
        if track.is_stepped() || !has_room {
            return keys.to_vec();
        }
        self.left -= wanted as usize;
        let mut times = vec![keys[0]];
        for pair in keys.windows(2) {
            let parts = between(pair) as usize;
            let step = (pair[1] - pair[0]) / parts as f64;
            times.extend((1..parts).map(|n| pair[0] + n as f64 * step));
            times.push(pair[1]);
        }
        times
    }
}

impl<const N: usize> Keys<N> {
    fn new(track: &Track) -> Self {
        Self { times: Vec::new(), values: Vec::new(), steps: track.is_stepped() }
    }

    /// Of keys at one time the last counts.
    fn push(&mut self, seconds: f64, value: [f64; N]) {
        let time = (seconds * SECOND).round() as i64;
        if self.times.last() == Some(&time) {
            self.values.pop();
            self.times.pop();
        }
        self.times.push(time);
        self.values.push(value);
    }
}

/// Of a shape, in percent.
pub(super) fn percent(track: &Track, room: &mut Room) -> Keys<1> {
    sampled(track, room, |[weight, ..]| [super::shapes::FULL * weight])
}

/// Of a part of a node's place: angles in degrees where it is its turn.
pub(super) fn place(track: &Track, room: &mut Room) -> Keys<3> {
    match track.path() {
        Path::Rotation => angles(track, room),
        _ => sampled(track, room, |[x, y, z, _]| [x, y, z]),
    }
}

fn sampled<const N: usize>(track: &Track, room: &mut Room, value: impl Fn([f64; 4]) -> [f64; N]) -> Keys<N> {
    let mut keys = Keys::new(track);
    let times = if track.is_straight() { track.times().to_vec() } else { room.times(track) };
    times.into_iter().for_each(|time| keys.push(time, value(track.at(time))));
    keys
}

fn angles(track: &Track, room: &mut Room) -> Keys<3> {
    let mut keys = Keys::new(track);
    let turn = |time: f64| DQuat::from_array(track.at(time));
    let mut last: Option<(f64, DVec3)> = None;
    for time in room.times(track) {
        let own = turn(time);
        let own = match last {
            None => euler::of(own),
            Some((before, from)) if track.is_stepped() || before == time => euler::near(own, from),
            Some((before, from)) => between(&turn, (before, from), time, HALVED, &mut keys),
        };
        keys.push(time, own.to_array());
        last = Some((time, own));
    }
    keys
}

/// The angles at a time after those at another, with keys between where a straight line would be off.
fn between(
    turn: &impl Fn(f64) -> DQuat,
    (before, from): (f64, DVec3),
    time: f64,
    halved: usize,
    keys: &mut Keys<3>,
) -> DVec3 {
    let to = euler::near(turn(time), from);
    let middle = 0.5 * (before + time);
    let off = euler::turn(0.5 * (from + to)).angle_between(turn(middle)).to_degrees();
    if halved == 0 || off <= OFF || off.is_nan() {
        return to;
    }
    let own = between(turn, (before, from), middle, halved - 1, keys);
    keys.push(middle, own.to_array());
    between(turn, (middle, own), time, halved - 1, keys)
}
